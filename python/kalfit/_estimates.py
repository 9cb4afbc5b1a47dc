"""Single numbers of a fit, with their names: estimates, and the dynamic parameters among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Union, overload

from kalfit._numbers import number

__all__ = ["Estimate", "Parameter", "Parameters", "estimate_of", "parameter_of"]


@dataclass(frozen=True)
class Parameter:
    """A dynamic parameter, such as a noise level or a time constant: common to all tests, or at one level."""

    #: Name in ``[parameters]`` of the model.
    name: str
    #: Column whose levels have a value each; ``None`` for a common parameter.
    per: str | None
    #: Level of ``per`` that has this value; ``None`` for a common parameter.
    level: str | None
    #: Value, in ``unit``.
    estimate: float
    #: Standard error; ``None`` where the value is fixed, at a bound, or not determined by the data.
    std_error: float | None
    #: 95 % interval, lower and upper end; an end is ``None`` where no limit was found. ``None`` for a fixed value.
    interval95: tuple[float | None, float | None] | None
    #: Whether the value is fixed, not estimated.
    fixed: bool
    #: Whether the estimate is at a bound, such as a noise level at zero.
    at_bound: bool
    #: Unit label; ``None`` where the model has none.
    unit: str | None


@dataclass(frozen=True)
class Estimate:
    """One number of a fit: a mean, a standard deviation, a covariance, a correlation, a regression coefficient or a parameter."""

    #: ``mean[a]``, ``std_dev[a]``, ``covariance[a, b]``, ``correlation[a, b]``, ``regression[a, column]``, ``tau`` or ``tau[level]``.
    #: With several phases or levels the name of the phase or level comes first, as in ``coast: mean[a]``.
    name: str
    #: ``mean``, ``mean_scale``, ``regression``, ``std_dev``, ``covariance``, ``covariance_scale``, ``correlation`` or ``parameter``.
    kind: str
    #: Unit label of a mean, a standard deviation or a parameter; ``None`` where there is none.
    unit: str | None
    #: The number; ``None`` where it is not defined, such as a correlation with a variance of zero.
    estimate: float | None
    #: Standard error; ``None`` where the number is fixed, at a bound, or not determined by the data.
    std_error: float | None
    #: 95 % interval, lower and upper end; an end is ``None`` where no limit was found.
    interval95: tuple[float | None, float | None]
    #: ``estimated``, ``fixed``, ``at zero``, ``on the boundary``, ``not identified`` or ``undefined``; of a parameter also ``at lower
    #: bound``, ``at upper bound``, ``at the edge``, ``unbounded`` or ``without effect``.
    status: str
    #: Degrees of freedom of a mean or regression coefficient, under ``reml``; ``None`` of others.
    df: float | None = None
    #: t of a mean or regression coefficient that has ``df``: estimate over standard error.
    statistic: float | None = None
    #: Two-sided p-value of the hypothesis that this mean or coefficient is zero.
    p_value: float | None = None


class Parameters(Sequence[Parameter]):
    """The dynamic parameters of a fit: a sequence of :class:`kalfit.Parameter`, which also finds them by name.

    ``parameters["tau"]`` is the parameter of that name, ``parameters["sigma", "A"]`` the one at that level, ``parameters[0]`` the
    first. A name that does not exist, or has several levels, raises ``KeyError``.
    """

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
