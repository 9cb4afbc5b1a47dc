"""A fit, and the functions that apply it and predict by it.

The functions take a fit, and a fit has methods that call them, so they stand in one file.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from kalfit import _arviz, _display, _kalfit, _plot, _toml
from kalfit._data import Data, Table, as_data
from kalfit._fit_tables import FitTables
from kalfit._found import found_instead
from kalfit._frames import table_of_columns
from kalfit._given import Set, file_name, model_text, outputs_text, source_text, table_of
from kalfit._made import Made, changed_model
from kalfit._model import ModelLike, Path, as_model
from kalfit._numbers import Array
from kalfit._progress import Progress, how
from kalfit._results import Applied, Predicted
from kalfit._rows import Measured, measured_rows
from kalfit._warnings import ConvergenceWarning, warn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Fit", "Interrupted", "apply", "predict", "warn_unless_converged"]


class Fit(FitTables):
    """Results of a fit. Made by :func:`kalfit.fit`, or from a file of the command by :meth:`load` and :meth:`from_json`.

    The properties :attr:`mean`, :attr:`covariance`, :attr:`std_dev`, :attr:`correlation` and :attr:`states` are those of the
    one phase there is; a fit of several phases has them in :attr:`phases`.
    """

    def __init__(self, results: str | _kalfit.Results, name: str = "the results") -> None:
        super().__init__(results, name)
        #: What the fit was made from, where it was made here.
        self._made: Made | None = None

    @classmethod
    def from_json(cls, text: str) -> Fit:
        """Reads the JSON of a fit, of this package or of the command."""
        return cls(text)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Fit:
        """Reads a file that ``kalfit fit --out`` or :meth:`save` wrote."""
        name = os.fspath(path)
        with open(path, "rb") as file:
            content = file.read()
        try:
            return cls(content.decode("utf-8"), name)
        except (_kalfit.Error, UnicodeDecodeError) as error:
            found = found_instead(content)
            if found is None:
                raise
            hint = "Fit.load reads what `kalfit fit --out` or Fit.save writes"
            raise _kalfit.DataError(f"`{name}` is not a result of `kalfit fit`: found {found}\n\nhint: {hint}") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes all results, as ``kalfit fit --out`` does."""
        self._results.save(path)

    def augment(self, by: Literal["test", "row"] = "test", *, measurement: str | None = None) -> Table:
        """The tests as a table, a row for each phase of each test: log-likelihood, distance from the population, innovations,
        influence, and the estimate of its initial state with standard deviations, as ``kalfit fit --tests`` writes them.

        ``by="row"`` has a row for each row of the data with a measured value, as broom does: ``test``, ``phase``, ``measurement``,
        ``row`` (from 1), ``observed``, ``fitted`` and ``resid``, those of :meth:`fitted` and :meth:`resid`.
        """
        if by not in ("test", "row"):
            raise ValueError(f"by is {by!r}, expected 'test' or 'row'")
        if by == "test":
            return Table(self._results.table("tests"))
        found = self._measured(measurement, None)
        at = np.flatnonzero(~np.isnan(found.fitted)).tolist()
        texts = {"test": [found.tests[k] for k in at], "phase": [found.phases[k] for k in at], "measurement": [found.measurement] * len(at)}
        columns = {"observed": found.observed, "fitted": found.fitted, "resid": found.observed - found.fitted}
        numbers = {name: values[at].tolist() for name, values in columns.items()}
        return table_of_columns(texts, {"row": [k + 1 for k in at], **numbers})

    def fitted(self, measurement: str | None = None, *, data: Data | None = None) -> Array:
        """What the fit says of each row of the data, given all measurements of its test and group: as lme4's ``fitted``, with the
        random effects. NaN where a row has no measured value.

        A model with several measurements is told which by ``measurement``. A fit that was read from a file does not know its model:
        see :meth:`apply`. Rows are in the order of the data; of a fit by formula they are those of ``fit.formula.data``, whose
        places in the data that were given are ``fit.formula.rows``.
        """
        return self._measured(measurement, data).fitted

    def resid(self, measurement: str | None = None, *, data: Data | None = None) -> Array:
        """Measured values minus :meth:`fitted`, row by row."""
        found = self._measured(measurement, data)
        return found.observed - found.fitted

    def _measured(self, measurement: str | None, data: Data | None) -> Measured:
        made = self._known()
        rows = made.data if data is None else data
        if rows is None:
            raise TypeError("this fit does not know its data: give them, as in data='data.csv'")
        model = as_model(made.model)
        states = self.apply(rows, model=model, set=made.set, states="smoothed").states
        assert states is not None, "no file was named"
        return measured_rows(_toml.loads(model.text), rows, states, measurement)

    def update(
        self,
        *,
        data: Data | None = None,
        formula: str | None = None,
        mean: Mapping[str, object] | None = None,
        covariance: Mapping[str, object] | None = None,
        parameters: Mapping[str, object] | None = None,
        levels: Mapping[str, object] | None = None,
        **options: Any,
    ) -> Fit:
        """Fits again, with other data, options or constraints; what is not named stays as it was.

        ``options`` are those of :func:`kalfit.fit`, ``set`` among them. Keys of ``mean``, ``covariance``, ``parameters`` and
        ``levels`` replace those of the model, as in a hypothesis; ``structure`` drops the other keys of its table. A fit by
        :func:`kalfit.lmm` takes another ``formula`` too, and ``reml``.

        >>> import kalfit
        >>> data = "examples/random-coefficients/sleepstudy.csv"
        >>> fit = kalfit.fit("examples/random-coefficients/sleepstudy.toml", data)
        >>> apart = fit.update(covariance={"structure": "diagonal"})
        >>> fit.free_parameters, apart.free_parameters
        (6, 5)
        """
        made = self._known()
        if made.again is None:
            raise TypeError("this fit was not made on this machine alone, and cannot be made again by update")
        if "reml" in options and self.formula is not None:
            options["criterion"] = "reml" if options.pop("reml") else "ml"
        settings = {"set": made.set, **made.options, **options}
        if options.get("criterion") == "ml" and "df" not in options:
            settings["df"] = None
        changes = {"mean": mean, "covariance": covariance, "parameters": parameters, "levels": levels}
        changes = {name: keys for name, keys in changes.items() if keys is not None}
        by_formula, model, rows = self.formula, made.model, made.data if data is None else data
        if by_formula is not None and (formula is not None or data is not None):
            by_formula = by_formula.again(formula, data)
            model, rows = by_formula.model, by_formula.data
        elif formula is not None:
            raise TypeError("this fit was not made by a formula: make it by kalfit.lmm")
        if changes:
            model = changed_model(model, {name: keys for name, keys in changes.items() if keys is not None})
        result = made.again(model, rows, **settings)
        result.formula = by_formula
        return result

    def to_arviz(self, draws: int = 1000, *, law: Literal["normal", "bootstrap"] = "normal", seed: int = 1) -> Any:
        """Draws of the estimates as an ``arviz.InferenceData``, for ArviZ's tables and figures; this takes arviz.

        They are no draws of a posterior, as kalfit has no priors, though ArviZ's group is called ``posterior``; its attribute ``law``
        says what they are. ``"normal"`` draws from the normal law of the estimates, of the logarithm of what is positive, and takes
        no time. ``"bootstrap"`` draws data from the fit, fits each, and has their estimates.
        """
        if draws < 1:
            raise ValueError(f"draws is {draws}, expected 1 or more")
        if law not in ("normal", "bootstrap"):
            raise ValueError(f"law is {law!r}, expected 'normal' or 'bootstrap'")
        about: dict[str, Any] = {"created_by": "kalfit", "title": self.title, "seed": seed}
        if law == "normal":
            words = "normal law of the estimates, no posterior"
            return _arviz.inference_data(_arviz.normal_draws(self, draws, seed), {**about, "law": words})
        made = self._known()
        if made.again is None or made.data is None:
            raise TypeError("this fit does not know its data, and cannot be made again")
        quick = {**made.options, "tests": False, "innovations": False, "deletion": "none", "intervals": "wald", "group_test": False}

        def again(draw: int) -> Fit:
            assert made.again is not None
            from kalfit._jobs import simulate

            drawn = simulate(made.model, self, made.data, seed=seed + draw, set=made.set).data
            return made.again(made.model, drawn, set=made.set, **quick)

        found, missed = _arviz.bootstrap_draws(self, draws, again)
        return _arviz.inference_data(found, {**about, "law": "parametric bootstrap, no posterior", "not_converged": missed})

    def plot(self, what: Literal["forest", "ellipses", "influence"] = "forest") -> Figure:
        """A figure of matplotlib, which must be installed: ``forest`` (estimates with 95 % intervals), ``ellipses`` (each pair of
        states: the population, and the tests in it) or ``influence`` (how far the estimates move without each test).

        Returns the ``matplotlib.figure.Figure``.
        """
        figure: Figure = _plot.plot(self, what)
        return figure

    def _known(self) -> Made:
        if self._made is None:
            raise TypeError("this fit does not know its model, as it was read from JSON: fit again, or see apply(…, model='model.toml')")
        return self._made

    def _model_of(self, model: ModelLike | None, set: Set) -> tuple[Any, Set]:
        """A model and what is set of it, or those of the fit."""
        if model is not None:
            return (model, set)
        if self._made is None:
            raise TypeError("this fit does not know its model, as it was read from JSON: give it, as in model='model.toml'")
        return (self._made.model, self._made.set if set is None else set)

    def apply(
        self,
        data: Data,
        *,
        model: ModelLike | None = None,
        states: Literal["smoothed", "filtered", "predicted"] | None = None,
        set: Set = None,
        out: Path | None = None,
        states_out: Path | None = None,
        threads: int | None = None,
        progress: Progress = False,
    ) -> Applied:
        """Applies the fit to tests, old or new: :func:`kalfit.apply` with the model of the fit, or with ``model``."""
        known, assigned = self._model_of(model, set)
        return apply(known, data, self, states=states, set=assigned, out=out, states_out=states_out, threads=threads, progress=progress)

    def predict(
        self,
        design: Data,
        *,
        model: ModelLike | None = None,
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
        """What tests that nobody has made will give: :func:`kalfit.predict` with the model of the fit, or with ``model``."""
        known, assigned = self._model_of(model, set)
        return predict(
            known,
            self,
            design,
            outputs=outputs,
            confidence=confidence,
            content=content,
            one_sided=one_sided,
            units=units,
            profile=profile,
            set=assigned,
            out=out,
            threads=threads,
            progress=progress,
        )

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


def warn_unless_converged(fit: Fit) -> None:
    """Warns of a fit whose estimates are no certified maximum."""
    if not fit.converged:
        warn(f"the fit did not converge: {fit.reason}; its estimates are the best that were found", ConvergenceWarning)


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
    with how(threads, progress) as told:
        made, tests, along, notes = _kalfit.apply(
            model_text(model, set), as_data(data), source_text(source), states, (file_name(out), file_name(states_out)), told
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
    with how(threads, progress) as told:
        made, table, notes = _kalfit.predict(
            model_text(model, set),
            source_text(source),
            (as_data(design, "design"), [] if profile is None else as_data(profile, "profile")),
            (None if outputs is None else outputs_text(outputs), confidence, content, one_sided, units),
            file_name(out),
            told,
        )
    return Predicted(made, notes, table_of(table))
