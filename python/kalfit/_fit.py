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
    """Results of a fit. Made by :func:`kalfit.fit` and :func:`kalfit.lmm`, or from a file by :meth:`load`.

    ``print(fit)`` prints the summary, and a notebook shows tables and a forest plot of the tests. Two fits are equal if all
    their results are.

    The properties :attr:`states`, :attr:`mean`, :attr:`covariance`, :attr:`std_dev` and :attr:`correlation` are those of the
    only phase. A fit of several phases has them in :attr:`phases`, and raises ``ValueError`` here. In shapes, p is the number of
    estimated states.

    A fit that was made here knows its model, data and options. One that was read from a file knows its results only: methods
    that need the model take it as an argument, or raise ``TypeError``.
    """

    def __init__(self, results: str | _kalfit.Results, name: str = "the results") -> None:
        super().__init__(results, name)
        #: What the fit was made from, where it was made here.
        self._made: Made | None = None

    @classmethod
    def from_json(cls, text: str) -> Fit:
        """Reads the results of a fit from ``text``, their JSON as :meth:`to_json` and ``kalfit fit --out`` write it.

        Raises :class:`kalfit.DataError` if the text is something else.
        """
        return cls(text)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Fit:
        """Reads the results of a fit from the file ``path``, which ``kalfit fit --out`` or :meth:`save` wrote.

        Raises ``OSError`` if there is no such file, and :class:`kalfit.DataError` if it is something else.
        """
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
        """Writes all results to the file ``path``, as JSON, whole or not at all. Raises ``OSError`` if that is not possible."""
        self._results.save(path)

    def augment(self, by: Literal["test", "row"] = "test", *, measurement: str | None = None) -> Table:
        """What the fit says of each test, or of each row of the data, as a table.

        - ``by``: ``"test"`` has a row for each phase of each test, as ``kalfit fit --tests`` writes it: log-likelihood, distance
          from the population, innovations, influence, and mean and standard deviation of its own initial state. ``"row"`` has a
          row for each row of the data with a measured value, as broom's ``augment``: ``test``, ``phase``, ``measurement``,
          ``row`` (from 1), ``observed``, ``fitted`` and ``resid``, the last two by :meth:`fitted` and :meth:`resid`.
        - ``measurement``: with ``by="row"``, the name of the measurement, where the model has several.

        >>> import kalfit
        >>> fit = kalfit.fit("examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv")
        >>> fit.augment().columns[:7]
        ['test', 'group[station]', 'phase', 'log_likelihood', 'observations', 'steps', 'design_class']
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
        """The fitted value of each row of the data, given all measurements of its test and group: as lme4's ``fitted``, with the
        random effects.

        - ``measurement``: the name of the measurement, where the model has several.
        - ``data``: other data with the same columns; ``None`` takes those of the fit.

        Returns an array of shape (rows,) in the unit of the measurement and in the order of the data, NaN where a row has no
        measured value. Of a fit by formula, the rows are those of ``fit.formula.data``, whose places in the data that were given
        are ``fit.formula.rows``. Raises ``TypeError`` for a fit that was read from a file: see :meth:`apply`.
        """
        return self._measured(measurement, data).fitted

    def resid(self, measurement: str | None = None, *, data: Data | None = None) -> Array:
        """The residual of each row of the data: its measured value minus that of :meth:`fitted`, of shape (rows,).

        ``measurement`` and ``data`` are those of :meth:`fitted`.
        """
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
        crossed: Mapping[str, object] | None = None,
        **options: Any,
    ) -> Fit:
        """Fits again, with other data, options or constraints; what is not named stays as it was.

        - ``data``: other data.
        - ``formula``: another formula, for a fit by :func:`kalfit.lmm`.
        - ``mean``, ``covariance``, ``parameters``, ``levels``, ``crossed``: keys of these tables of the model file, which replace those of the
          model, as in a hypothesis; ``structure`` drops the other keys of its table.
        - ``options``: those of :func:`kalfit.fit`, ``set`` among them; and ``reml``, for a fit by :func:`kalfit.lmm`.

        Raises ``TypeError`` for a fit that was read from a file, or made on a Spark cluster.

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
        changes = {"mean": mean, "covariance": covariance, "parameters": parameters, "levels": levels, "crossed": crossed}
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
        """Draws of the estimates as an ``arviz.InferenceData``, for the tables and figures of ArviZ, which must be installed.

        kalfit has no priors, so these are no draws of a posterior, though ArviZ calls the group ``posterior``; its attribute ``law``
        says what they are.

        - ``draws``: number of draws.
        - ``law``: ``"normal"`` draws from the normal distribution of the estimates, of the logarithm of what is positive, and takes
          no time. ``"bootstrap"`` draws ensembles from the fit, fits the model to each, and takes these estimates.
        - ``seed``: seed of the draws.
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
        """Draws a figure by matplotlib, which must be installed, and returns the ``matplotlib.figure.Figure``.

        - ``what``: ``"forest"`` is estimates with 95 % intervals; ``"ellipses"`` is each pair of states, with the population and
          the tests in it; ``"influence"`` is how far the estimates move without each test.

        A notebook shows the figure; elsewhere ``fit.plot().savefig("forest.png")`` writes it.
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
        """Applies the fit to tests, old or new: :func:`kalfit.apply`, with the model of the fit.

        - ``data``: the tests.
        - ``model``: the model, for a fit that was read from a file.
        - ``states``, ``set``, ``out``, ``states_out``, ``threads``, ``progress``: as in :func:`kalfit.apply`; ``set`` is that of
          the fit if it is ``None``.
        """
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
        """Predicts tests that have not been made: :func:`kalfit.predict`, with the model of the fit.

        - ``design``: times and inputs of the tests.
        - ``model``: the model, for a fit that was read from a file.
        - ``outputs``, ``confidence``, ``content``, ``one_sided``, ``units``, ``profile``, ``set``, ``out``, ``threads``,
          ``progress``: as in :func:`kalfit.predict`; ``set`` is that of the fit if it is ``None``.
        """
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
        """Writes the report to the file ``path``: one HTML page that needs no other file, as ``kalfit report`` makes it."""
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
    """Ctrl-C ended a fit that had estimates by then. It is a ``KeyboardInterrupt``; no file was written."""

    def __init__(self, fit: Fit) -> None:
        super().__init__("the fit was interrupted; the best so far is in the attribute `fit` of this exception")
        #: The best fit so far. It has not converged, unless only what follows the search was missing.
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
    """Applies a fitted model to tests, old or new: whether they belong to the population, and what their states are.

    All parameters are taken from ``source``, and nothing is estimated.

    - ``model``: the model of the tests: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``states``: the states at every step are wanted: from all measurements of the test (``"smoothed"``), from those up to the
      step (``"filtered"``), or from those before it (``"predicted"``). ``None`` leaves them out.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for the table of the tests, in place of ``.tests`` of the result. Its ending is the format: ``.csv``,
      ``.tsv``, ``.parquet`` or ``.arrow``.
    - ``states_out``: a file for the table of the states, in place of ``.states`` of the result.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Applied`, and raises what :func:`kalfit.fit` raises.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> fit = kalfit.fit(model, data)
    >>> applied = kalfit.apply(model, data, fit)
    >>> len(applied.tests), round(applied.log_density, 4), round(fit.log_likelihood, 4)
    (28, 377.115, 377.115)
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
    """Predicts tests that have not been made: mean, standard deviation and limits of states and outputs at every row.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``design``: times and inputs of the tests: data of the model, of which the measurements may be missing.
    - ``outputs``: what else is predicted, linear in the states: equations by name, as in ``{"error": "bias + scale * 10"}``, or a
      file with tables ``[outputs.NAME]``.
    - ``confidence``: confidence of the limits of the mean and of the tolerance limits, from 0.5 to 0.999999.
    - ``content``: part of all tests that tolerance limits hold, and probability of the limits of one new test, in the same range.
    - ``one_sided``: ``False`` has that part of all tests between the tolerance limits; ``True`` has it below the upper one, and as
      much above the lower one.
    - ``units``: whether the tests are of units that are ``"new"`` or ``"known"`` to the fit, in a model with levels. Known units
      are named in the design.
    - ``profile``: the data of the fit: limits of the mean then come from the profile likelihood in place of standard errors.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for the table of all rows, in place of ``.table`` of the result. Its ending is the format: ``.csv``,
      ``.tsv``, ``.parquet`` or ``.arrow``.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Predicted`, and raises what :func:`kalfit.fit` raises.

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
