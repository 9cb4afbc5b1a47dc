"""Single numbers of a fit, with their names: estimates, and the dynamic parameters among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Union, overload

from kalfit._numbers import number

__all__ = ["Estimate", "Parameter", "Parameters", "estimate_of", "parameter_of"]


@dataclass(frozen=True)
class Parameter:
    """A dynamic parameter, at one level or common to all tests."""

    name: str
    #: Column of levels, if the parameter has any.
    per: str | None
    #: The level.
    level: str | None
    estimate: float
    #: None where it is fixed, at a bound, or not determined by the data.
    std_error: float | None
    #: Lower and upper end; an end is None where no limit was found.
    interval95: tuple[float | None, float | None] | None
    fixed: bool
    at_bound: bool
    unit: str | None


@dataclass(frozen=True)
class Estimate:
    """One number of a fit: a mean, a standard deviation, a covariance, a correlation, a regression coefficient or a parameter."""

    #: ``mean[a]``, ``std_dev[a]``, ``covariance[a, b]``, ``correlation[a, b]``, ``regression[a, column]``, ``tau``, ``tau[level]``; with
    #: several phases or levels after their name, as in ``coast: mean[a]``.
    name: str
    kind: str
    unit: str | None
    estimate: float | None
    #: None where it is fixed, at a bound, or not determined by the data.
    std_error: float | None
    #: Lower and upper end; an end is None where no limit was found.
    interval95: tuple[float | None, float | None]
    #: ``estimated``, ``fixed``, ``at zero``, ``on the boundary``, ``not identified`` and more.
    status: str
    #: Degrees of freedom of a mean or regression coefficient with few tests, under ``reml``; None of others.
    df: float | None = None
    #: t of a mean or regression coefficient with few tests.
    statistic: float | None = None
    #: Two-sided p-value of the hypothesis that this mean or coefficient is zero.
    p_value: float | None = None


class Parameters(Sequence[Parameter]):
    """The dynamic parameters, by place, by name, or by name and level: ``parameters["sigma", "A"]``."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._all = list(parameters)

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._all)

    @overload
    def __getitem__(self, key: Union[int, str, tuple[str, str]]) -> Parameter: ...
    @overload
    def __getitem__(self, key: slice) -> list[Parameter]: ...
    def __getitem__(self, key: Union[int, str, tuple[str, str], slice]) -> Union[Parameter, list[Parameter]]:
        if isinstance(key, (int, slice)):
            return self._all[key]
        name, level = key if isinstance(key, tuple) else (key, None)
        found = [p for p in self._all if p.name == name and (level is None or p.level == level)]
        if len(found) == 1:
            return found[0]
        if found:
            levels = ", ".join(repr(p.level) for p in found)
            raise KeyError(f"{name!r} has a value for each of the levels {levels}: ask for parameters[{name!r}, level]")
        raise KeyError(f"there is no parameter {key!r}, there are {', '.join(sorted({p.name for p in self._all})) or 'none'}")

    def __repr__(self) -> str:
        return f"Parameters({self._all!r})"


def estimate_of(row: dict[str, Any]) -> Estimate:
    """The estimate that a row of the results describes."""
    return Estimate(
        name=row["name"],
        kind=row["kind"],
        unit=row["unit"],
        estimate=number(row["estimate"]),
        std_error=number(row["std_error"]),
        interval95=(number(row["lower"]), number(row["upper"])),
        status=row["status"],
        df=number(row.get("df")),
        statistic=number(row.get("statistic")),
        p_value=number(row.get("p_value")),
    )


def parameter_of(record: dict[str, Any]) -> Parameter:
    """The parameter that a part of the results describes."""
    interval = record["interval95"]
    return Parameter(
        name=record["name"],
        per=record["per"],
        level=record["level"],
        estimate=float(record["estimate"]),
        std_error=number(record["std_error"]),
        interval95=None if interval is None else (number(interval[0]), number(interval[1])),
        fixed=bool(record["fixed"]),
        at_bound=bool(record["at_bound"]),
        unit=record.get("unit"),
    )
