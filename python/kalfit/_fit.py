"""A fit, and the functions that apply it and predict by it.

The functions take a fit, and a fit has methods that call them, so they stand in one file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from kalfit import _display, _kalfit, _plot
from kalfit._data import Data, Table, as_data
from kalfit._fit_record import FitRecord
from kalfit._frames import data_frame, table_of_columns
from kalfit._given import Set, file_name, model_text, outputs_text, source_text, table_of
from kalfit._model import ModelLike, Path
from kalfit._progress import Progress, how
from kalfit._results import Applied, Predicted

__all__ = ["Fit", "Interrupted", "apply", "predict"]


class Fit(FitRecord):
    """Results of a fit. Made by :func:`kalfit.fit`, or from a file of the command by :meth:`load` and :meth:`from_json`.

    The properties :attr:`mean`, :attr:`covariance`, :attr:`std_dev`, :attr:`correlation` and :attr:`states` are those of the
    one phase there is; a fit of several phases has them in :attr:`phases`.
    """

    def __init__(self, results: str | _kalfit.Results, name: str = "the results") -> None:
        super().__init__(results, name)
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

    def tidy(self) -> Table:
        """Every estimate as a table, a row for each number: ``name``, ``kind``, ``phase``, ``level``, ``state``, ``other_state``,
        ``column``, ``unit``, ``estimate``, ``std_error``, ``lower`` and ``upper`` (95 %), ``status``, and of means with few
        tests (``reml``) ``df``, ``statistic`` and ``p_value``. For a data frame:
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
        return table_of_columns({name: [text] for name, text in texts.items()}, {name: [x] for name, x in numbers.items()})

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
        return table_of_columns({"name": [own.name for own in rows]}, ends)

    def plot(self, what: Literal["forest", "ellipses", "influence"] = "forest") -> Any:
        """A figure of matplotlib, which must be installed: ``forest`` (estimates with 95 % intervals), ``ellipses`` (each pair of
        states: the population, and the tests in it) or ``influence`` (how far the estimates move without each test).

        Returns the ``matplotlib.figure.Figure``.
        """
        return _plot.plot(self, what)

    def parameters_frame(self) -> Any:
        """All estimates as a ``pandas.DataFrame`` with a row for each number, as ``kalfit fit --parameters`` writes them: ``name``,
        ``kind`` (``mean``, ``regression``, ``std_dev``, ``covariance``, ``correlation``, ``parameter`` and more), ``phase``, ``level``,
        ``state``, ``other_state``, ``column``, ``unit``, ``estimate``, ``std_error``, ``lower`` and ``upper`` (95 %), ``status``:
        ``estimated``, ``fixed``, ``at zero``, ``not identified`` and more, and ``df``, ``statistic`` and ``p_value`` of means with
        few tests. This takes pandas.
        """
        rows = json.loads(self._results.quantities())
        texts = ["name", "kind", "phase", "level", "state", "other_state", "column", "unit"]
        return data_frame(rows, texts, ["estimate", "std_error", "lower", "upper", "df", "statistic", "p_value"], ["status"])

    def constraints_frame(self) -> Any:
        """What each constraint costs as a ``pandas.DataFrame`` with a row for each constrained element, as ``kalfit fit --constraints``
        writes it: ``element``, ``phase``, ``level``, ``value``, ``sensitivity``, ``score_statistic``, ``p_value``,
        ``expected_change``, ``likelihood_ratio`` and ``likelihood_ratio_p_value``. This takes pandas.
        """
        numbers = ["value", "sensitivity", "score_statistic", "p_value", "expected_change"]
        numbers += ["likelihood_ratio", "likelihood_ratio_p_value"]
        return data_frame(self._record["constraints"], ["element", "phase", "level"], numbers, [])

    def rows_frame(self) -> Any:
        """Measurements that contradict the others of their test as a ``pandas.DataFrame`` with a row for each, as ``kalfit fit --rows``
        writes them: ``test``, ``phase``, ``file``, ``measurement``, ``row``, ``time``, ``deviation``, ``std_dev``, ``p_value`` and
        ``adjusted_p_value``. This takes pandas.
        """
        if self.misfit is None:
            raise ValueError("this fit has no innovations, by which single measurements are examined")
        rows = self.misfit["wrong_rows"]
        numbers = ["row", "time", "deviation", "std_dev", "p_value", "adjusted_p_value"]
        return data_frame(rows, ["test", "phase", "file", "measurement"], numbers, [])

    def _model_of(self, model: Any) -> tuple[Any, Any]:
        """A model, or that of the fit with what was set of it."""
        if model is not None:
            return (model, None)
        if self._made_with is None:
            raise TypeError("this fit does not know its model, as it was read from JSON: give it, as in model='model.toml'")
        return self._made_with

    def apply(self, data: Any, *, model: Any = None, **options: Any) -> Any:
        """Applies the fit to tests, old or new: :func:`kalfit.apply` with the model of the fit, or with ``model``."""
        known, assigned = self._model_of(model)
        return apply(known, data, self, **{"set": assigned, **options})

    def predict(self, design: Any, *, model: Any = None, **options: Any) -> Any:
        """What tests that nobody has made will give: :func:`kalfit.predict` with the model of the fit, or with ``model``."""
        known, assigned = self._model_of(model)
        return predict(known, self, design, **{"set": assigned, **options})

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


def apply(
    model: ModelLike,
    data: Data,
    source: Fit | ModelLike,
    *,
    states: Literal["smoothed", "filtered", "predicted"] | None = None,
    set: Set = None,
    out: Path | None = None,
    states_out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Applied:
    """Applies a fitted model to tests, old or new: all parameters are taken from ``source``, and nothing is estimated.

    ``source`` is a fit, its file, or a model with values. What each test says is in ``.tests`` of the result, unless ``out``
    names a file for it. With ``states`` the states of every test at every step are in ``.states``, unless ``states_out`` names a
    file for them: ``"smoothed"`` from all of the test, ``"filtered"`` from what was measured up to the step, ``"predicted"``
    from what was measured before it.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> fit = kalfit.fit(model, data)
    >>> applied = kalfit.apply(model, data, fit)
    >>> len(applied.tests), abs(applied.log_density - fit.log_likelihood) < 1e-9 * abs(fit.log_likelihood)
    (28, True)
    """
    if states_out is not None and states is None:
        raise ValueError("states_out names a file for states, but states is None: say which ones")
    made, tests, along, notes = _kalfit.apply(
        model_text(model, set), as_data(data), source_text(source), states, (file_name(out), file_name(states_out)), how(threads, progress)
    )
    return Applied(made, notes, table_of(tests), table_of(along))


def predict(
    model: ModelLike,
    source: Fit | ModelLike,
    design: Data,
    *,
    outputs: Path | Mapping[str, object] | None = None,
    confidence: float = 0.9,
    content: float = 0.95,
    one_sided: bool = False,
    units: Literal["new", "known"] = "new",
    profile: Data | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Predicted:
    """Says what tests that nobody has made will give: mean, spread and limits of states and outputs at every row of ``design``.

    ``design`` has the times and inputs of the tests. ``source`` is a fit, its file, or a model with values. ``outputs`` is
    a file of ``[outputs.NAME]`` tables, or a dictionary of equations by name. Limits of the mean hold with ``confidence``; tolerance limits hold
    ``content`` of all tests with that confidence, between them or, if ``one_sided``, beyond neither by itself. Where tests stand
    in groups, ``units`` says whether those of the design are ``"new"`` or ``"known"`` to the fit. With ``profile``, the data that
    the fit was made from, limits of the mean come from the profile likelihood and not from standard errors. All rows are in ``.table`` of
    the result, unless ``out`` names a file for them.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> predicted = kalfit.predict(model, kalfit.fit(model, data), data)
    >>> [name for name in predicted.table.columns if name.startswith("std_dev")]
    ['std_dev', 'std_dev_population', 'std_dev_process', 'std_dev_estimation']
    """
    for name, value in (("confidence", confidence), ("content", content)):
        if not 0.5 <= value <= 1 - 1e-6:
            raise ValueError(f"{name} is {value}, expected a number from 0.5 to 0.999999")
    made, table, notes = _kalfit.predict(
        model_text(model, set),
        source_text(source),
        (as_data(design, "design"), [] if profile is None else as_data(profile, "profile")),
        (None if outputs is None else outputs_text(outputs), confidence, content, one_sided, units),
        file_name(out),
        how(threads, progress),
    )
    return Predicted(made, notes, table_of(table))
