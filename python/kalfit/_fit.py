"""Results of a fit."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, Union, overload

import numpy as np
from numpy.typing import NDArray

from kalfit import _display, _kalfit
from kalfit._data import Table

__all__ = ["Estimate", "Fit", "Interrupted", "Parameter", "Parameters", "Phase", "TestFit"]

Array = NDArray[np.float64]
#: Numbers of which some may be unknown: those are masked, print as ``--`` and become None in ``tolist()``.
MaskedArray: TypeAlias = "np.ma.MaskedArray[Any, np.dtype[np.float64]]"


def _array(values: Any) -> Array:
    """Numbers that are all known."""
    return np.array(values, dtype=np.float64)


def _masked(values: Any) -> MaskedArray:
    """Numbers of which some may be unknown."""
    numbers = np.array(values, dtype=np.float64)  # None becomes NaN, for the mask to cover
    unknown = np.isnan(numbers)
    return np.ma.array(np.where(unknown, 0.0, numbers), mask=unknown, fill_value=np.nan)


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


class _Spread:
    """A covariance of initial states, with all that is known of it. Arrays are in the order of :attr:`states`.

    What may be unknown, such as the standard error of a fixed element, comes in masked arrays: an unknown number is masked, and so
    is whatever is calculated from it. :meth:`why_unknown` says why. Whoever wants NaN asks for it: ``filled()``.
    """

    def __init__(self, record: dict[str, Any]) -> None:
        self._record = record
        #: Its name.
        self.name: str = record["name"]
        #: Names of the estimated states.
        self.states: list[str] = list(record["states"])

    @property
    def covariance(self) -> Array:
        """Covariance, shape (p, p)."""
        return _square(self._record["covariance"]["estimate"], len(self.states))

    @property
    def covariance_std_error(self) -> MaskedArray:
        """Standard errors of the covariance, shape (p, p)."""
        return _masked(self._record["covariance"]["std_error"]).reshape(len(self.states), len(self.states))

    @property
    def std_dev(self) -> Array:
        """Standard deviations, shape (p,)."""
        return _array(self._record["std_dev"]["estimate"])

    @property
    def std_dev_std_error(self) -> MaskedArray:
        """Standard errors of the standard deviations, shape (p,)."""
        return _masked(self._record["std_dev"]["std_error"])

    @property
    def covariance_interval95(self) -> MaskedArray:
        """95 % intervals of the covariance, shape (p, p, 2); ends that are not known are masked."""
        return _ends(self._record["covariance"], (len(self.states), len(self.states)))

    @property
    def std_dev_interval95(self) -> MaskedArray:
        """95 % intervals of the standard deviations, shape (p, 2); ends that are not known are masked."""
        return _ends(self._record["std_dev"], (len(self.states),))

    @property
    def correlation_interval95(self) -> MaskedArray:
        """95 % intervals of the correlations, shape (p, p, 2); ends that are not known are masked."""
        return _ends(self._record["correlation"], (len(self.states), len(self.states)))

    @property
    def correlation(self) -> MaskedArray:
        """Correlations, shape (p, p); masked beside a variance of zero."""
        return _masked(self._record["correlation"]["estimate"]).reshape(len(self.states), len(self.states))

    @property
    def correlation_std_error(self) -> MaskedArray:
        """Standard errors of the correlations, shape (p, p)."""
        return _masked(self._record["correlation"]["std_error"]).reshape(len(self.states), len(self.states))


class Phase(_Spread):
    """The initial state of one phase, over the population; named ``main`` in a model without phases."""

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__(record)
        #: Units of the states; None where the model has none.
        self.units: list[str | None] = list(record.get("units") or [None] * len(self.states))

    @property
    def mean(self) -> Array:
        """Mean, shape (p,)."""
        return _array(self._record["mean"]["estimate"])

    @property
    def mean_std_error(self) -> MaskedArray:
        """Standard errors of the mean, shape (p,)."""
        return _masked(self._record["mean"]["std_error"])

    @property
    def mean_interval95(self) -> MaskedArray:
        """95 % intervals of the mean, shape (p, 2); ends that are not known are masked."""
        return _ends(self._record["mean"], (len(self.states),))

    def why_unknown(
        self, what: Literal["mean", "std_dev", "covariance", "correlation"], state: str, other: str | None = None
    ) -> str | None:
        """Why a figure has no standard error, in words; None when it has one.

        ``what`` is the figure, ``state`` its state, and ``other`` the second one of a covariance or a correlation.
        """
        return _why_unknown(self._record, self.states, what, state, other)

    def __repr__(self) -> str:
        return f"<kalfit.Phase {self.name!r}: {', '.join(self.states)}>"


class Level(_Spread):
    """What varies from group to group of a level, or, at the last one, from test to test within the groups."""

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__(record)
        #: Column that names the groups; None for the tests' own level.
        self.column: str | None = record.get("column")
        #: Number of groups; of tests for their own level.
        self.groups: int = record["groups"]

    def why_unknown(
        self, what: Literal["std_dev", "covariance", "correlation"], state: str, other: str | None = None
    ) -> str | None:
        """Why a figure has no standard error, in words; None when it has one."""
        return _why_unknown(self._record, self.states, what, state, other)

    def __repr__(self) -> str:
        return f"<kalfit.Level {self.name!r}: {self.groups} groups, {', '.join(self.states)}>"


@dataclass(frozen=True)
class GroupFit:
    """What is known of one group of tests: the law of the mean of its members, given all data and the fit."""

    level: str
    #: Its name after those of the groups that it stands in, the outermost first.
    id: tuple[str, ...]
    tests: int
    log_likelihood: float
    #: Shape (p,).
    mean: Array
    #: Shape (p, p).
    covariance: Array
    #: How far the group lies from the population: chi-square under the model.
    distance: float | None
    degrees_of_freedom: int
    p_value: float | None


def _group(record: dict[str, Any]) -> GroupFit:
    mean = _array(record["mean"])
    return GroupFit(
        level=record["level"],
        id=tuple(record["id"]),
        tests=record["tests"],
        log_likelihood=record["log_likelihood"],
        mean=mean,
        covariance=_square(record["covariance"], len(mean)),
        distance=record.get("distance"),
        degrees_of_freedom=record["degrees_of_freedom"],
        p_value=record.get("p_value"),
    )


def _why_unknown(
    record: dict[str, Any], states: list[str], what: str, state: str, other: str | None
) -> str | None:
    if what not in ("mean", "std_dev", "covariance", "correlation"):
        raise ValueError(f"what is {what!r}, expected 'mean', 'std_dev', 'covariance' or 'correlation'")
    for name in (state, other):
        if name is not None and name not in states:
            raise KeyError(f"there is no state {name!r}, there are {', '.join(states)}")
    i = states.index(state)
    j = i if other is None else states.index(other)
    single = what in ("mean", "std_dev")
    error = record[what]["std_error"]
    if (error[i] if single else error[i][j]) is not None:
        return None
    if what == "correlation" and i == j:
        return "it is 1 by definition"
    if what == "correlation" and record[what]["estimate"][i][j] is None:
        return "a state that does not vary has no correlations"
    fixed = record["mean"]["fixed"][i] if what == "mean" else record["covariance"]["fixed"][i][j]
    if fixed:
        return "it is fixed"
    named = (states[i],) if what == "mean" else (states[i], states[j])
    kind = "mean" if what == "mean" else "covariance"
    for direction in record["unidentified"]:
        if direction["what"] == kind and _takes_part(direction, named):
            return direction.get("reason") or "the data do not determine it"
    for boundary in record["boundary"] if kind == "covariance" else []:
        if not boundary.get("states") or {*named} & {*boundary["states"]}:
            return f"it is on the boundary: the covariance is singular, of rank {boundary['rank']} of {boundary['of']}"
    return "it is not known"


def _takes_part(direction: dict[str, Any], named: tuple[str, ...]) -> bool:
    """Whether an unidentified direction moves a mean, or a covariance of these states."""
    elements = direction.get("elements", [])
    moved = [element for element, size in zip(elements, direction["direction"]) if abs(size) > 1e-6]
    texts = {named[0]} if len(named) == 1 else {f"{a}, {b}" for a, b in (named, named[::-1])}
    return not texts.isdisjoint(moved)


def _frame(rows: list[dict[str, Any]], texts: list[str], numbers: list[str], last: list[str]) -> Any:
    """Rows as a data frame; numbers that are not known are missing in it, and columns have their kind where there are no rows, too."""
    import pandas

    def column(name: str) -> list[Any]:
        return [row.get(name) for row in rows]

    kinds = [(name, "object") for name in texts] + [(name, "float64") for name in numbers] + [(name, "object") for name in last]
    return pandas.DataFrame({name: pandas.Series(column(name), dtype=kind) for name, kind in kinds})


def _ends(record: dict[str, Any], shape: tuple[int, ...]) -> MaskedArray:
    """Both ends of each interval of a vector or a matrix."""

    def pair(one: Any) -> list[Any]:
        return [None, None] if one is None else list(one)

    values = record.get("interval95") or []
    if len(shape) == 1:
        pairs = [pair(one) for one in values]
    else:
        pairs = [pair(one) for row in values for one in row]
    missing = [[None, None]] * (int(np.prod(shape)) - len(pairs))  # older records have none
    return _masked(pairs + missing).reshape(*shape, 2)


def _square(values: Any, p: int) -> Array:
    return _array(values).reshape(p, p)


@dataclass(frozen=True)
class TestFit:
    """What one test says: the law of its own initial state, given its data and the fit."""

    __test__ = False  # it is no test of pytest's

    id: str
    log_likelihood: float
    observations: int
    #: How far the test lies from the population: chi-square under the model.
    distance: float | None
    degrees_of_freedom: int | None
    p_value: float | None
    #: Mean by phase, each of shape (p,).
    means: dict[str, Array]
    #: Covariance by phase, each of shape (p, p).
    covariances: dict[str, Array]
    #: Its text in the column of ``[data] group``.
    group: str | None = None
    #: Names of its groups where the model has levels, the outermost first.
    groups: tuple[str, ...] = ()


class Fit:
    """Results of a fit. Made by :func:`kalfit.fit`, or from a file of the command by :meth:`load` and :meth:`from_json`.

    The properties :attr:`mean`, :attr:`covariance`, :attr:`std_dev`, :attr:`correlation` and :attr:`states` are those of the
    one phase there is; a fit of several phases has them in :attr:`phases`.
    """

    def __init__(self, results: str | _kalfit.Results, name: str = "the results") -> None:
        self._results = _kalfit.Results(name, results) if isinstance(results, str) else results
        #: The model and what was set of it, where the fit was made here.
        self._made_with: tuple[Any, Any] | None = None

    @classmethod
    def from_json(cls, text: str) -> Fit:
        """Reads the JSON of a fit, of this package or of the command."""
        return cls(text)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Fit:
        """Reads a file that ``kalfit fit --out`` or :meth:`save` wrote."""
        with open(path, encoding="utf-8") as file:
            return cls(file.read(), os.fspath(path))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes all results, as ``kalfit fit --out`` does."""
        self._results.save(path)

    def to_json(self) -> str:
        """All results as JSON, as ``kalfit fit --out`` writes it."""
        return self._results.json()

    def to_dict(self) -> dict[str, Any]:
        """All results, as the JSON has them. Each call makes a new dictionary."""
        result: dict[str, Any] = json.loads(self.to_json())
        return result

    @cached_property
    def _record(self) -> dict[str, Any]:
        """All but the tests, of which there may be very many."""
        record: dict[str, Any] = json.loads(self._results.head())
        return record

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """Each phase of the model; one, named ``main``, in a model without phases."""
        return tuple(Phase(phase) for phase in self._record["phases"])

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """What varies at each level of groups, the outermost first, and last from test to test; none without levels."""
        return tuple(Level(level) for level in self._record.get("levels", []))

    def level(self, name: str) -> Level:
        """The level of this name; ``tests`` is the tests' own."""
        for level in self.levels:
            if level.name == name:
                return level
        names = ", ".join(level.name for level in self.levels) or "none"
        raise KeyError(f"there is no level {name!r}, there are {names}")

    @cached_property
    def groups(self) -> list[GroupFit]:
        """What is known of each group, level by level from the outermost on."""
        return [_group(record) for record in self._record.get("groups", [])]

    def phase(self, name: str) -> Phase:
        """The phase of this name."""
        for phase in self.phases:
            if phase.name == name:
                return phase
        raise KeyError(f"there is no phase {name!r}, there are {', '.join(phase.name for phase in self.phases)}")

    @property
    def _only(self) -> Phase:
        if len(self.phases) == 1:
            return self.phases[0]
        names = ", ".join(repr(phase.name) for phase in self.phases)
        raise ValueError(f"the fit has phases {names}: ask one of them, as in fit.phase({self.phases[0].name!r}).mean")

    @property
    def states(self) -> list[str]:
        """Names of the estimated states, in the order of every array."""
        return self._only.states

    @property
    def mean(self) -> Array:
        """Mean of the initial state over the population, shape (p,)."""
        return self._only.mean

    @property
    def covariance(self) -> Array:
        """Covariance of the initial state over the population, shape (p, p)."""
        return self._only.covariance

    @property
    def std_dev(self) -> Array:
        """Standard deviations, shape (p,)."""
        return self._only.std_dev

    @property
    def correlation(self) -> MaskedArray:
        """Correlations, shape (p, p); masked beside a variance of zero."""
        return self._only.correlation

    @cached_property
    def parameters(self) -> Parameters:
        """Dynamic parameters: ``fit.parameters["tau"].estimate``."""
        return Parameters([_parameter(record) for record in self._record["parameters"]])

    @cached_property
    def tests(self) -> list[TestFit]:
        """What each test says."""
        return self._some_tests(1)

    def _some_tests(self, every: int) -> list[TestFit]:
        return [_test(record) for record in json.loads(self._results.tests(every))]

    def tests_frame(self) -> Any:
        """What each test says as a ``pandas.DataFrame`` with a row for each test: ``id``, ``group``, ``log_likelihood``,
        ``observations``, ``distance``, ``degrees_of_freedom``, ``p_value``, ``mean[STATE]`` and ``std_dev[STATE]``, the states of
        several phases after the phase's name. This takes pandas.
        """
        import pandas

        several = len(self.phases) > 1
        states = {phase.name: phase.states for phase in self.phases}
        levels = [level.name for level in self.levels][:-1]  # the last are the tests themselves
        rows = []
        for test in self.tests:
            row: dict[str, Any] = {"id": test.id, "group": test.group, **dict(zip(levels, test.groups, strict=False))}
            for name in ("log_likelihood", "observations", "distance", "degrees_of_freedom", "p_value"):
                row[name] = getattr(test, name)
            for phase, mean in test.means.items():
                named = [f"{phase}: {state}" if several else state for state in states[phase]]
                deviations = np.sqrt(np.diag(test.covariances[phase]).clip(min=0.0))
                row.update({f"mean[{state}]": value for state, value in zip(named, mean, strict=True)})
                row.update({f"std_dev[{state}]": value for state, value in zip(named, deviations, strict=True)})
            rows.append(row)
        return pandas.DataFrame(rows)

    @cached_property
    def estimates(self) -> dict[str, Estimate]:
        """Every number of the fit by its name: ``fit.estimates["mean[bias]"].interval95``."""
        return {row["name"]: _estimate(row) for row in json.loads(self._results.quantities())}

    def tidy(self) -> Table:
        """Every estimate as a table, a row for each number: ``name``, ``kind``, ``phase``, ``level``, ``state``, ``other_state``,
        ``column``, ``unit``, ``estimate``, ``std_error``, ``lower`` and ``upper`` (95 %), and ``status``. For a data frame:
        ``fit.tidy().to_polars()`` or ``.to_pandas()``.
        """
        return Table(self._results.table("parameters"))

    def glance(self) -> Table:
        """The fit as a table of one row: ``title``, ``criterion``, ``model_check``, ``tests``, ``observations``,
        ``free_parameters``, ``log_likelihood``, ``aic``, ``bic``, ``converged`` (1 or 0)."""
        data = self._record["data"]
        texts = {"title": self.title, "criterion": self._record["criterion"], "model_check": self.model_check["verdict"]}
        numbers = {
            "tests": data["tests"],
            "observations": data["observations"],
            "free_parameters": self.free_parameters,
            "log_likelihood": self.log_likelihood,
            "aic": self.aic,
            "bic": self.bic,
            "converged": self.converged,
        }
        return _columns({name: [text] for name, text in texts.items()}, {name: [x] for name, x in numbers.items()})

    def augment(self) -> Table:
        """The tests as a table, a row for each phase of each test: log-likelihood, distance from the population, innovations,
        influence, and the estimate of its initial state with standard deviations, as ``kalfit fit --tests`` writes them. For
        predictions and residuals of single measurements see :meth:`apply` with ``states="smoothed"``.
        """
        return Table(self._results.table("tests"))

    def conf_int(self) -> Table:
        """95 % intervals as a table: ``name``, ``lower`` and ``upper`` of every estimate that has one; an end that was not found is
        NaN."""
        rows = [own for own in self.estimates.values() if own.status != "fixed" and own.interval95 != (None, None)]
        ends = {"lower": [own.interval95[0] for own in rows], "upper": [own.interval95[1] for own in rows]}
        return _columns({"name": [own.name for own in rows]}, ends)

    def plot(self, what: Literal["forest", "ellipses", "influence"] = "forest") -> Any:
        """A figure of matplotlib, which must be installed: ``forest`` (estimates with 95 % intervals), ``ellipses`` (each pair of
        states: the population, and the tests in it) or ``influence`` (how far the estimates move without each test).

        Returns the ``matplotlib.figure.Figure``.
        """
        from kalfit import _plot

        return _plot.plot(self, what)

    def parameters_frame(self) -> Any:
        """All estimates as a ``pandas.DataFrame`` with a row for each number, as ``kalfit fit --parameters`` writes them: ``name``,
        ``kind`` (``mean``, ``regression``, ``std_dev``, ``covariance``, ``correlation``, ``parameter`` and more), ``phase``, ``level``,
        ``state``, ``other_state``, ``column``, ``unit``, ``estimate``, ``std_error``, ``lower`` and ``upper`` (95 %), and ``status``:
        ``estimated``, ``fixed``, ``at zero``, ``not identified`` and more. This takes pandas.
        """
        rows = json.loads(self._results.quantities())
        texts = ["name", "kind", "phase", "level", "state", "other_state", "column", "unit"]
        return _frame(rows, texts, ["estimate", "std_error", "lower", "upper"], ["status"])

    def constraints_frame(self) -> Any:
        """What each constraint costs as a ``pandas.DataFrame`` with a row for each constrained element, as ``kalfit fit --constraints``
        writes it: ``element``, ``phase``, ``level``, ``value``, ``sensitivity``, ``score_statistic``, ``p_value`` and
        ``expected_change``. This takes pandas.
        """
        numbers = ["value", "sensitivity", "score_statistic", "p_value", "expected_change"]
        return _frame(self._record["constraints"], ["element", "phase", "level"], numbers, [])

    def _model_of(self, model: Any) -> tuple[Any, Any]:
        """A model, or that of the fit with what was set of it."""
        if model is not None:
            return (model, None)
        if self._made_with is None:
            raise TypeError("this fit does not know its model, as it was read from JSON: give it, as in model='model.toml'")
        return self._made_with

    def apply(self, data: Any, *, model: Any = None, **options: Any) -> Any:
        """Applies the fit to tests, old or new: :func:`kalfit.apply` with the model of the fit, or with ``model``."""
        import kalfit

        known, assigned = self._model_of(model)
        return kalfit.apply(known, data, self, **{"set": assigned, **options})

    def predict(self, design: Any, *, model: Any = None, **options: Any) -> Any:
        """What tests that nobody has made will give: :func:`kalfit.predict` with the model of the fit, or with ``model``."""
        import kalfit

        known, assigned = self._model_of(model)
        return kalfit.predict(known, self, design, **{"set": assigned, **options})

    @property
    def constraints(self) -> list[dict[str, Any]]:
        """Each constrained element and what the constraint costs."""
        result: list[dict[str, Any]] = copy.deepcopy(self._record["constraints"])
        return result

    @property
    def title(self) -> str:
        """Title of the model."""
        return str(self._record["title"])

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood, every constant included."""
        return float(self._record["log_likelihood"])

    @property
    def aic(self) -> float | None:
        """Akaike's criterion; None where it has no meaning."""
        return _number(self._record["aic"])

    @property
    def bic(self) -> float | None:
        """Schwarz's criterion; None where it has no meaning."""
        return _number(self._record["bic"])

    @property
    def free_parameters(self) -> int:
        """Declared free quantities."""
        return int(self._record["free_parameters"])

    @property
    def converged(self) -> bool:
        """Whether the optimality conditions hold."""
        return bool(self._record["converged"])

    @property
    def reason(self) -> str:
        """Why the search ended, in words."""
        return str(self._record["reason"])

    @property
    def model_check(self) -> dict[str, Any]:
        """Whether the model describes the data: ``verdict`` (passed, doubtful, not checked), the ``findings`` that speak
        against it and ``remarks`` that limit its answer, each with ``kind`` and ``text``."""
        none: dict[str, Any] = {"verdict": "not checked", "findings": [], "remarks": []}
        return none | (self._record.get("model_check") or {})

    @property
    def by_group(self) -> list[dict[str, Any]]:
        """The tests of each group of ``[data] group`` together: ``group``, ``tests``, ``log_likelihood``,
        ``innovations_mean_square``, ``distance`` and more."""
        return [dict(group) for group in self._record.get("by_group") or []]

    @property
    def group_test(self) -> dict[str, Any] | None:
        """Whether the groups differ, where ``group_test=True`` was asked for."""
        found = self._record.get("group_test")
        return None if found is None else dict(found)

    @property
    def certificate(self) -> dict[str, float]:
        """How far the optimality conditions are from being met, part by part."""
        return dict(self._record["certificate"])

    @property
    def notes(self) -> list[str]:
        """Findings in plain words."""
        return list(self._record.get("notes", []))

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The results in words and tables, as the command prints them."""
        return self._results.summary(width, color)

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes the HTML report: one page that needs nothing else, as ``kalfit report`` makes it."""
        self._results.report(path)

    def __repr__(self) -> str:
        state = "converged" if self.converged else "NOT converged"
        title = f" {self.title!r}" if self.title else ""
        return f"<kalfit.Fit{title}: {state}, log-likelihood {self.log_likelihood:.2f}, {len(self._results)} tests>"

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return _display.html(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fit) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash(self._results.head())

    def __reduce__(self) -> tuple[object, ...]:
        return (Fit, (self.to_json(),))


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a fit that had something to show: :attr:`fit` is the best so far, not converged."""

    def __init__(self, fit: Fit) -> None:
        super().__init__("the fit was interrupted; the best so far is in the attribute `fit` of this exception")
        self.fit = fit


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def _columns(texts: dict[str, list[str]], numbers: dict[str, list[Any]]) -> Table:
    """A table of texts and numbers; numbers that are None become NaN."""
    values = [(name, np.array(column, dtype=np.float64).tobytes()) for name, column in numbers.items()]
    return Table(_kalfit.Table.columns(list(texts.items()), values))


def _estimate(row: dict[str, Any]) -> Estimate:
    return Estimate(
        name=row["name"],
        kind=row["kind"],
        unit=row["unit"],
        estimate=_number(row["estimate"]),
        std_error=_number(row["std_error"]),
        interval95=(_number(row["lower"]), _number(row["upper"])),
        status=row["status"],
    )


def _parameter(record: dict[str, Any]) -> Parameter:
    interval = record["interval95"]
    return Parameter(
        name=record["name"],
        per=record["per"],
        level=record["level"],
        estimate=float(record["estimate"]),
        std_error=_number(record["std_error"]),
        interval95=None if interval is None else (_number(interval[0]), _number(interval[1])),
        fixed=bool(record["fixed"]),
        at_bound=bool(record["at_bound"]),
        unit=record.get("unit"),
    )


def _test(record: dict[str, Any]) -> TestFit:
    phases = [phase for phase in record["phases"] if phase.get("mean") is not None]
    return TestFit(
        id=record["id"],
        log_likelihood=float(record["log_likelihood"]),
        observations=int(record["observations"]),
        distance=_number(record["distance"]),
        degrees_of_freedom=record["degrees_of_freedom"],
        p_value=_number(record["p_value"]),
        means={phase["name"]: _array(phase["mean"]) for phase in phases},
        covariances={phase["name"]: _square(phase["covariance"], len(phase["mean"])) for phase in phases},
        group=record.get("group"),
        groups=tuple(record.get("groups", ())),
    )
