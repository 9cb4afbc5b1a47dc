"""The functions, one for each command."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Union

from kalfit import _kalfit
from kalfit._arrays import Ensemble
from kalfit._data import Data, Table, as_data
from kalfit._fit import Fit, Interrupted
from kalfit._model import Model, ModelLike, Path, as_model, assignments
from kalfit._results import (
    Applied,
    Check,
    Comparison,
    Datasheet,
    Filter,
    Plan,
    Predicted,
    RatioTest,
    Simulation,
    Validation,
)

__all__ = [
    "Step",
    "apply",
    "check",
    "compare",
    "datasheet",
    "estimates",
    "export",
    "fit",
    "plan",
    "predict",
    "reduce",
    "simulate",
    "test",
    "validate",
]

Set = Union[Mapping[str, float], Sequence[str], None]
Progress = Union[bool, Callable[["Step"], object]]
_Text = tuple[str, str, Union[str, None]]
_How = tuple[Union[int, None], Union[Callable[[str, Union[int, None], Union[int, None]], object], None]]


class Step(str):
    """How far a job is, in words: a text, which also says how much of how much is done, where the end is known.

    >>> step = Step("reading", 30, 40)
    >>> step, step.done, step.of, step.share
    ('reading', 30, 40, 0.75)
    >>> Step("pass 4").share is None
    True
    """

    __slots__ = ("done", "of")

    #: Done so far; None where the end is not known.
    done: int | None
    #: All that is to be done.
    of: int | None

    def __new__(cls, words: str, done: int | None = None, of: int | None = None) -> Step:
        step = super().__new__(cls, words)
        step.done, step.of = done, of
        return step

    @property
    def share(self) -> float | None:
        """What part is done, from 0 to 1; None where the end is not known."""
        return None if self.done is None or not self.of else min(self.done / self.of, 1.0)


def _said(step: Step) -> None:
    share = "" if step.share is None else f", {100 * step.share:.0f} %"
    sys.stderr.write(f"\r{(step + share)[:110]:<110}")
    sys.stderr.flush()


def _how(threads: int | None, progress: Progress) -> _How:
    if threads is not None and not 1 <= threads <= 1024:
        raise ValueError(f"threads is {threads}, expected a number from 1 to 1024, or None for all processors")
    if progress is False:
        return (threads, None)
    told = _said if progress is True else progress
    return (threads, lambda words, done, of: told(Step(words, done, of)))


def _file(path: Path | None) -> str | None:
    return None if path is None else os.fspath(path)


def _table(made: _kalfit.Table | None) -> Table | None:
    return None if made is None else Table(made)


def _model(model: ModelLike, set: Set) -> tuple[_Text, list[str]]:
    return (as_model(model)._document(), assignments(set))


def _beside(document: Path | Mapping[str, object], name: str) -> _Text:
    """A file that is read with a model, or a dictionary of its tables."""
    if isinstance(document, Mapping):
        from kalfit import _toml

        return (name, _toml.dumps(document), None)
    path = os.fspath(document)
    with open(path, encoding="utf-8") as file:
        return (path, file.read(), path)


def _outputs(outputs: Path | Mapping[str, object]) -> _Text:
    """A file of outputs, or equations by name."""
    if not isinstance(outputs, Mapping):
        return _beside(outputs, "the outputs")
    tables = {name: {"equation": one} if isinstance(one, str) else one for name, one in outputs.items()}
    return _beside({"outputs": tables}, "the outputs")


def _source(source: Fit | ModelLike) -> _Text:
    """Results of a fit, or a model: as themselves, or in a file."""
    if isinstance(source, Fit):
        return ("the fit", source.to_json(), None)
    if isinstance(source, (str, os.PathLike)):
        path = os.fspath(source)
        if not path.lower().endswith(".toml"):
            with open(path, encoding="utf-8") as file:
                return (path, file.read(), path)
    return as_model(source)._document()


def fit(
    model: ModelLike | Ensemble,
    data: Data | None = None,
    *,
    set: Set = None,
    method: Literal["hybrid", "innovations", "em", "all"] = "hybrid",
    solver: Literal["newton", "em"] = "newton",
    criterion: Literal["ml", "reml"] = "ml",
    phases: Literal["chain", "marginal", "stacked"] = "chain",
    intervals: Literal["wald", "profile"] = "wald",
    std_errors: Literal["observed", "expected", "sandwich"] = "observed",
    deletion: Literal["auto", "all", "none"] = "auto",
    innovations: bool = True,
    tests: bool = True,
    group_test: bool = False,
    starts: int | None = None,
    seed: int | None = None,
    tolerance: float | None = None,
    max_iterations: int | None = None,
    threads: int | None = None,
    out: Path | None = None,
    report: Path | None = None,
    progress: Progress = False,
) -> Fit:
    """Fits a model to data by maximum likelihood.

    ``model`` is a :class:`kalfit.Model`, the path of a model file, or a dictionary; ``data`` a table of polars, pandas or
    pyarrow, a path or a pattern of paths, or a list of these. The options are those of ``kalfit fit``, under the same names:
    ``set={"tau": 90}`` fixes a parameter, ``out`` names a file for the results, ``report`` one for the HTML report. Made here, the
    report shows the records too, where they have times; :meth:`Fit.report` makes it from the results alone. ``tests=False`` leaves
    out all results of single tests, for millions of tests. ``progress=True`` writes a line to standard error; a function is called
    with a :class:`kalfit.Step` instead.

    The work is done without Python's lock. Ctrl-C ends it at once; if there is something to show by then, the exception is
    :class:`kalfit.Interrupted`, with the best fit so far.

    >>> import kalfit
    >>> fit = kalfit.fit("examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv")
    >>> fit.converged, round(fit.log_likelihood, 4)
    (True, 377.115)
    >>> fit.states
    ['bias', 'scale', 'g_sensitivity']
    >>> fit.mean.round(3).tolist()
    [0.618, 47.533, 0.271]
    """
    if isinstance(model, Ensemble):
        if data is not None:
            raise TypeError("an ensemble of arrays has its data in itself: leave `data` out")
        data = model
        model = model.model()
    if data is None:
        raise TypeError("there are no data: give a table, a path, or a list of these")
    if not tests and deletion == "all":
        raise ValueError("deletion is 'all', but tests is False: fits without each test are results of single tests")
    options: dict[str, object] = {
        "method": method,
        "solver": solver,
        "criterion": criterion,
        "phases": phases,
        "intervals": intervals,
        "std_errors": std_errors,
        "deletion": deletion,
        "innovations": innovations,
        "tests": tests,
        "group_test": group_test,
        "starts": starts,
        "seed": seed,
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "report": _file(report),
    }
    found, interrupted = _kalfit.fit(
        _model(model, set), as_data(data), _file(out), options, _how(threads, progress)
    )
    result = Fit(found)
    result._made_with = (model, set)
    if interrupted:
        raise Interrupted(result)
    return result


def check(
    model: ModelLike, data: Data | None = None, *, set: Set = None, threads: int | None = None, progress: Progress = False
) -> Check:
    """Reads a model, and data if given, and fits nothing: the model in words, counts, what the data identify.

    >>> import kalfit
    >>> found = kalfit.check("examples/gyro-bench/bench.toml")
    >>> print(found.summary().splitlines()[0])
    Gyros on two bench stations
    """
    made, words, notes = _kalfit.check(_model(model, set), as_data(data), _how(threads, progress))
    return Check(made, notes, words)


def test(
    model: ModelLike,
    data: Data,
    null: Path | Mapping[str, object],
    *,
    set: Set = None,
    bootstrap: int | None = None,
    seed: int = 1,
    tolerance: float | None = None,
    max_iterations: int | None = None,
    threads: int | None = None,
    out: Path | None = None,
    progress: Progress = False,
) -> RatioTest:
    """Tests a hypothesis within a model by the ratio of the likelihoods.

    ``null`` is a file with ``[mean]``, ``[covariance]`` or ``[parameters]``, or a dictionary of these: its keys replace the
    model's. ``bootstrap`` draws that many ensembles from the hypothesis, with ``seed``.

    >>> import kalfit
    >>> found = kalfit.test(
    ...     "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv", {"mean": {"fixed": {"bias": 0}}}
    ... )
    >>> 0 < found.p_value < 0.01
    True
    """
    hypothesis = _beside(null, "the hypothesis")
    if bootstrap is not None and not 1 <= bootstrap <= 1_000_000:
        raise ValueError(f"bootstrap is {bootstrap}, expected a number from 1 to 1000000, or None")
    made, notes = _kalfit.test(
        _model(model, set),
        as_data(data),
        hypothesis,
        (None if bootstrap is None else (bootstrap, seed), tolerance, max_iterations),
        _file(out),
        _how(threads, progress),
    )
    return RatioTest(made, notes)


test.__test__ = False  # type: ignore[attr-defined]  # it is no test of pytest's


def simulate(
    model: ModelLike,
    source: Fit | ModelLike,
    design: Data,
    *,
    seed: int,
    tests: int | None = None,
    set: Set = None,
    out: Path | None = None,
    truth: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Simulation:
    """Draws an ensemble from ``source``: a fit, its file, or a model with values.

    ``design`` gives times, inputs and which values are missing. The data are in ``.data`` of the result, and the initial states
    that were drawn in ``.states``, unless ``out`` names a file for the data (``truth`` one for the states).

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> kalfit.simulate(model, kalfit.fit(model, data), data, seed=7)
    <kalfit.Simulation: 28 tests, 614 rows>
    """
    if tests is not None and not 1 <= tests <= 1_000_000_000:
        raise ValueError(f"tests is {tests}, expected a number from 1 to 1000000000, or None")
    data, count, rows, states, column, notes = _kalfit.simulate(
        _model(model, set),
        _source(source),
        as_data(design, "design"),
        (tests, seed),
        (_file(out), _file(truth)),
        _how(threads, progress),
    )
    return Simulation(_table(data), _table(states), (count, rows), column, notes)


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
        _model(model, set), as_data(data), _source(source), states, (_file(out), _file(states_out)), _how(threads, progress)
    )
    return Applied(made, notes, _table(tests), _table(along))


def validate(
    model: ModelLike,
    data: Data,
    *,
    folds: int = 10,
    seed: int = 1,
    by: str | None = None,
    against: ModelLike | None = None,
    criterion: Literal["ml", "reml"] = "ml",
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Validation:
    """Predicts tests by fits that were made without them: how well does a model do, and does another one do better?

    Tests are drawn into ``folds`` with ``seed``; as many folds as tests leave each one out by itself. With ``by`` those with the
    same text in that column are a fold. ``against`` is another model of the same measurements.

    >>> import kalfit
    >>> model, data = "examples/random-coefficients/sleepstudy.toml", "examples/random-coefficients/sleepstudy.csv"
    >>> found = kalfit.validate(model, data, folds=6)
    >>> found.log_density < kalfit.fit(model, data).log_likelihood
    True
    """
    if folds < 2:
        raise ValueError(f"folds is {folds}, expected 2 or more")
    made, notes = _kalfit.validate(
        _model(model, set),
        as_data(data),
        (None if by is not None else (folds, seed), by, criterion),
        None if against is None else _source(against),
        _file(out),
        _how(threads, progress),
    )
    return Validation(made, notes)


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
        _model(model, set),
        _source(source),
        (as_data(design, "design"), [] if profile is None else as_data(profile, "profile")),
        (None if outputs is None else _outputs(outputs), confidence, content, one_sided, units),
        _file(out),
        _how(threads, progress),
    )
    return Predicted(made, notes, _table(table))


def export(
    model: ModelLike,
    source: Fit | ModelLike,
    *,
    step: float | None = None,
    at: Mapping[str, float | str] | None = None,
    phase: str | None = None,
    set: Set = None,
    format: Literal["json", "npz", "mat", "c", "python"] | None = None,
    out: Path | None = None,
) -> Filter:
    """The filter that follows from a fit, as constant matrices: all parameters are taken from ``source``.

    ``source`` is a fit, its file, or a model with values. ``step`` is the length of a step in the model's unit of time, where anything
    depends on it. Columns that multiply states, or that noise depends on, are given a value by ``at``: ``at={"temperature": 20}``.
    ``out`` names a file for the filter, of the ``format`` that its ending says unless one is given.

    >>> import kalfit
    >>> model, data = "examples/random-coefficients/sleepstudy.toml", "examples/random-coefficients/sleepstudy.csv"
    >>> filter = kalfit.export(model, kalfit.fit(model, data), at={"Days": 3})
    >>> filter.states, filter.H.tolist()
    (['intercept', 'slope'], [[1.0, 3.0]])
    """
    if format is not None and out is None:
        raise ValueError("format says what is written to a file, but out names none")
    fixed = [f"{column}={value}" for column, value in (at or {}).items()]
    made, notes = _kalfit.export(_model(model, set), _source(source), (step, fixed, phase), format, _file(out))
    return Filter(made, notes)


def datasheet(
    model: ModelLike,
    source: Fit | ModelLike,
    data: Data | None = None,
    *,
    step: float | None = None,
    at: Mapping[str, float | str] | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Datasheet:
    """The numbers of a datasheet, in its units: random walks, Gauss-Markov pairs, turn-on repeatability, Allan deviations.

    ``source`` is a fit, its file, or a model with values. With ``data`` the Allan deviation of their records stands beside that of the
    model; without, ``step`` is the time from a value to the next. Columns that noise or motion depend on are given a value by ``at``.

    >>> import kalfit
    >>> model, data = "examples/mimu4444/gyro_x.toml", "examples/mimu4444/gyro_x.csv"
    >>> sheet = kalfit.datasheet(model, kalfit.fit(model, data), data)
    >>> [(entry["name"], entry["unit"]) for entry in sheet.entries[:2]]
    [('angle random walk', 'deg/sqrt(h)'), ('rate random walk', 'deg/h/sqrt(h)')]
    """
    if step is not None and data is not None:
        raise ValueError("step is given beside data, whose records have steps of their own: leave one of them out")
    fixed = [f"{column}={value}" for column, value in (at or {}).items()]
    made, notes = _kalfit.datasheet(
        _model(model, set),
        _source(source),
        [] if data is None else as_data(data),
        (step, fixed),
        _file(out),
        _how(threads, progress),
    )
    return Datasheet(made, notes)


def compare(fits: Mapping[str, Fit | Path] | Sequence[Fit | Path], *, out: Path | None = None) -> Comparison:
    """Puts fits of the same data side by side: likelihoods, AIC and BIC, tests of one within another, what differs.

    ``fits`` is a list of fits or of their files, or a dictionary of these with names to call them by.

    >>> import kalfit
    >>> data = "examples/random-coefficients/sleepstudy.csv"
    >>> model = kalfit.Model.load("examples/random-coefficients/sleepstudy.toml")
    >>> apart = kalfit.Model.from_text(model.text + '\\n[covariance]\\nstructure = "diagonal"')
    >>> compared = kalfit.compare({"full": kalfit.fit(model, data), "diagonal": kalfit.fit(apart, data)})
    >>> [round(fit["delta_aic"], 2) for fit in compared.fits], compared.nested[0]["df"]
    ([1.94, 0.0], 1)
    """
    named = fits.items() if isinstance(fits, Mapping) else [(None, fit) for fit in fits]
    texts = []
    for number, (name, given) in enumerate(named, 1):
        called, text, path = _source(given)
        texts.append((name or (called if path else f"fit {number}"), text, path))
    return Comparison(_kalfit.compare(texts, _file(out)))


def plan(
    model: ModelLike,
    source: Fit | ModelLike,
    design: Data,
    tests: Sequence[int],
    *,
    groups: Mapping[str, Sequence[int]] | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Plan:
    """Expects standard errors against the number of tests, before any is run.

    Of a model with levels ``groups`` says how many groups of each level there are in each group of the one above, as in
    ``{"serial": [5, 10, 20]}``; ``tests`` is then how many tests there are in each group of the innermost level.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> plan = kalfit.plan(model, kalfit.fit(model, data), data, tests=[10, 20])
    >>> plan.to_dict()["tests"]
    [10, 20]
    """
    counts = [int(count) for count in tests]
    if not counts or not all(1 <= count <= 1_000_000_000 for count in counts):
        raise ValueError(f"tests is {list(tests)}, expected numbers from 1 to 1000000000")
    in_groups = [(str(level), [int(count) for count in own]) for level, own in (groups or {}).items()]
    if not all(own and all(1 <= count <= 1_000_000 for count in own) for _, own in in_groups):
        raise ValueError(f"groups is {groups!r}, expected numbers from 1 to 1000000")
    made, notes = _kalfit.plan(
        _model(model, set),
        _source(source),
        as_data(design, "design"),
        (counts, in_groups),
        _file(out),
        _how(threads, progress),
    )
    return Plan(made, notes)


def reduce(
    model: ModelLike,
    data: Data,
    *,
    at: Fit | Path | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Table | None:
    """Runs the filters once, at known parameters: all that a fit needs of the data, a row for each test and phase.

    Free parameters take their values from ``at``, a fit or its file, or from ``set``. The table goes to the Parquet file
    ``out``, or is handed back; it may stand wherever data stand.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> reductions = kalfit.reduce(model, data)
    >>> len(reductions)
    28
    >>> kalfit.fit(model, reductions).log_likelihood == kalfit.fit(model, data).log_likelihood
    True
    """
    return _exchange("reductions", (model, set), data, at, out, _how(threads, progress))


def estimates(
    model: ModelLike,
    data: Data,
    *,
    at: Fit | Path | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Table | None:
    """Runs the ``[filter]`` of each phase, optimal or not: its estimates with the errors they make.

    As :func:`reduce`, in the form that any filter's estimates can be given in.
    """
    return _exchange("estimates", (model, set), data, at, out, _how(threads, progress))


def _exchange(
    what: Literal["reductions", "estimates"],
    model: tuple[ModelLike, Set],
    data: Data,
    at: Fit | Path | None,
    out: Path | None,
    how: _How,
) -> Table | None:
    source = None if at is None else _source(at)
    table, *_ = _kalfit.exchange(what, _model(*model), as_data(data), source, _file(out), how)
    return _table(table)
