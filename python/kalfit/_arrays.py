"""The arrays of state-space models become a table, and the words of a model file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike

from kalfit import _kalfit
from kalfit._data import Table
from kalfit._numbers import Array

__all__ = ["Builder", "PerTest", "measured_tests", "per_row", "start_offsets_per_row"]

#: One array for all tests, or a list with an array for each: see :meth:`kalfit.Ensemble.from_arrays`.
PerTest = Union[ArrayLike, Sequence[ArrayLike]]


def measured_tests(measurements: Sequence[ArrayLike] | Array) -> list[Array]:
    """What each test measured, (steps, m)."""
    if isinstance(measurements, np.ndarray) and measurements.ndim != 3:
        raise ValueError(
            f"measurements is an array of shape {measurements.shape}, expected (tests, steps, m), or a list of arrays (steps, m)"
        )
    tests = [np.asarray(test, dtype=np.float64) for test in measurements]
    if not tests:
        raise ValueError("measurements has no tests")
    for index, test in enumerate(tests):
        if test.ndim != 2 or test.shape[0] == 0 or test.shape[1] != tests[0].shape[-1] or test.shape[1] == 0:
            m = tests[0].shape[-1] if tests[0].ndim == 2 else "m"
            raise ValueError(f"measurements[{index}] has shape {test.shape}, expected (steps, {m}) with at least one step")
    return tests


def per_row(name: str, given: PerTest, shape: tuple[int, ...], rows: list[int]) -> Array:
    """The values for every row of every test, one test after the other."""
    base = len(shape)
    if isinstance(given, (list, tuple)) and len(given) == len(rows) and not _is_one_step(given, shape):
        tests = [np.asarray(test, dtype=np.float64) for test in given]
        labels = [f"{name}[{index}]" for index in range(len(tests))]
    else:
        whole = np.asarray(given, dtype=np.float64)
        tests, labels = [whole] * len(rows), [name] * len(rows)
    width = {index: expected for index, expected in enumerate(shape) if expected >= 0}
    parts = []
    for label, test, count in zip(labels, tests, rows):
        inner = test.shape[test.ndim - base :] if test.ndim in (base, base + 1) else None
        if inner is None or any(inner[index] != expected for index, expected in width.items()):
            wanted = ", ".join("n" if expected < 0 else str(expected) for expected in shape)
            raise ValueError(f"{label} has shape {test.shape}, expected ({wanted}) or (steps, {wanted})")
        if test.ndim == base + 1 and len(test) < count:
            raise ValueError(f"{label} has {len(test)} steps, expected at least the {count} of its test")
        parts.append(np.broadcast_to(test, (count, *inner)) if test.ndim == base else test[:count])
    if len({part.shape[1:] for part in parts}) > 1:
        raise ValueError(f"{name} is not of the same shape in all tests")
    return np.concatenate(parts)


def _is_one_step(given: Sequence[Any], shape: tuple[int, ...]) -> bool:
    """True of nested lists that are one array: a list of arrays is one for each test."""
    if any(isinstance(part, np.ndarray) for part in given):
        return False
    try:
        whole = np.asarray(given, dtype=np.float64)
    except ValueError:
        return False
    return whole.ndim == len(shape)


def start_offsets_per_row(offsets: ArrayLike | None, n: int, rows: list[int]) -> Array:
    """The known amount of its test's initial state for every row, (rows, n)."""
    if offsets is None:
        return np.zeros((sum(rows), n))
    each = np.asarray(offsets, dtype=np.float64)
    if each.shape not in ((n,), (len(rows), n)):
        raise ValueError(f"start_offsets has shape {each.shape}, expected ({n},) or ({len(rows)}, {n})")
    return np.repeat(np.broadcast_to(each, (len(rows), n)), rows, axis=0)


class Builder:
    """Puts arrays into the words of a model file: a number where a value is always the same, a column where it is not."""

    def __init__(self, z: Array, names: list[str]) -> None:
        self._names = names
        self._columns: list[tuple[str, bytes]] = []
        self._states: dict[str, dict[str, object]] = {}
        self._measured: dict[str, dict[str, object]] = {}
        self._process: dict[str, str] = {}
        self._noise: dict[str, str] = {}
        self._z = z
        for index in range(z.shape[1]):
            self._column(f"z{index + 1}", z[:, index])

    def _column(self, name: str, values: Array) -> None:
        self._columns.append((name, np.ascontiguousarray(values, dtype=np.float64).tobytes()))

    def _term(self, name: str, values: Array) -> str | None:
        """An expression for the values of all rows; None for zero."""
        if (values == values[0]).all():
            value = float(values[0])
            return None if value == 0 else f"({value!r})"
        self._column(name, values)
        return f"`{name}`"

    def _sum(self, name: str, row: Array, known: str | None) -> str:
        terms = []
        for j, state in enumerate(self._names):
            factor = self._term(f"{name}, {state}]", row[:, j])
            if factor is not None:
                terms.append(state if factor == "(1.0)" else f"{factor} * {state}")
        if known is not None:
            terms.append(known)
        return " + ".join(terms) or f"0 * {self._names[0]}"

    def motion(self, f: Array, q: Array, u: Array) -> None:
        _symmetric("process_noise", q)
        still = np.eye(len(self._names))
        for i, state in enumerate(self._names):
            table: dict[str, object] = {}
            known = self._term(f"u[{state}]", u[:, i])
            spread = self._term(f"sqrt Q[{state}]", _root(f"the variance of {state} in process_noise", q[:, i, i]))
            if known is not None or spread is not None or not (f[:, i] == still[i]).all():
                table["next"] = self._sum(f"F[{state}", f[:, i], known)
                if spread is not None:
                    table["step_noise"] = spread
            self._states[state] = table
            for j in range(i):
                shared = self._term(f"Q[{state}, {self._names[j]}]", q[:, i, j])
                if shared is not None:
                    self._process[f"{self._names[j]}, {state}"] = shared

    def observed(self, h: Array, r: Array, d: Array) -> None:
        _symmetric("noise", r)
        for i in range(h.shape[1]):
            name = f"z{i + 1}"
            known = self._term(f"d[{i + 1}]", d[:, i])
            self._measured[name] = {
                "column": name,
                "equation": self._sum(f"H[{i + 1}", h[:, i], known),
                "variance": self._term(f"R[{i + 1}]", r[:, i, i]) or "0",
            }
            for j in range(i):
                shared = self._term(f"R[{i + 1}, {j + 1}]", r[:, i, j])
                if shared is not None:
                    self._noise[f"z{j + 1}, {name}"] = shared

    def starts(self, offsets: Array, known: dict[str, tuple[float, float]]) -> None:
        for i, state in enumerate(self._names):
            offset = self._term(f"x0[{state}]", offsets[:, i])
            if state in known:
                mean, sigma = known.pop(state)
                if offset is not None:
                    raise ValueError(f"the start of {state!r} is known: put its offset into known_start")
                self._states[state]["initial"] = {"mean": mean, "sigma": sigma}
            elif offset is not None:
                self._states[state]["offset"] = offset
        if known:
            raise ValueError(f"known_start names {', '.join(map(repr, known))}, expected some of {', '.join(self._names)}")

    def table(self, ids: Any) -> Table:
        return Table(_kalfit.Table.columns([("test", [str(label) for label in ids])], self._columns))

    def parts(self, step_first: bool) -> dict[str, object]:
        data: dict[str, object] = {"test": "test"}
        if step_first:
            data["step_first"] = True
        parts: dict[str, object] = {"data": data, "states": self._states, "measurements": self._measured}
        if self._process:
            parts["process_noise_covariance"] = self._process
        if self._noise:
            parts["noise_covariance"] = self._noise
        return parts


def _symmetric(name: str, values: Array) -> None:
    known = ~np.isnan(values).any(axis=(1, 2))
    wrong = np.flatnonzero(known & (np.abs(values - values.transpose(0, 2, 1)) > 1e-12 * np.abs(values).max(initial=0.0)).any(axis=(1, 2)))
    if len(wrong):
        raise ValueError(f"{name} is not symmetric in row {wrong[0] + 1}")


def _root(name: str, variance: Array) -> Array:
    if (variance < 0).any():
        raise ValueError(f"{name} is {float(np.nanmin(variance))}, expected no negative number")
    root: Array = np.sqrt(variance)
    return root
