"""The functions, one for each command. Those that a class calls stand beside it, in `_fit` and `_fitting`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from kalfit import _kalfit
from kalfit._data import Data, Table, as_data
from kalfit._fit import Fit
from kalfit._given import Set, file_name, model_text, source_text, table_of, text_beside
from kalfit._model import ModelLike, Path
from kalfit._progress import How, Progress, how
from kalfit._results import Check, Comparison, Datasheet, Filter, Plan, RatioTest, Simulation, Validation

__all__ = [
    "check",
    "compare",
    "datasheet",
    "estimates",
    "export",
    "plan",
    "reduce",
    "simulate",
    "test",
    "validate",
]


def check(
    model: ModelLike, data: Data | None = None, *, set: Set = None, threads: int | None = None, progress: Progress = False
) -> Check:
    """Reads a model, and data if given, and fits nothing: the model in words, counts, what the data identify.

    >>> import kalfit
    >>> found = kalfit.check("examples/gyro-bench/bench.toml")
    >>> print(found.summary().splitlines()[0])
    Gyros on two bench stations
    """
    with how(threads, progress) as told:
        made, words, notes = _kalfit.check(model_text(model, set), as_data(data), told)
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
    model's. ``bootstrap`` draws that many ensembles from the hypothesis, with ``seed``; 0 draws none. ``None`` draws 999
    where at most 50 tests or units have known parameters.

    >>> import kalfit
    >>> found = kalfit.test(
    ...     "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv", {"mean": {"fixed": {"bias": 0}}}
    ... )
    >>> 0 < found.p_value < 0.01
    True
    """
    hypothesis = text_beside(null, "the hypothesis")
    if bootstrap is not None and not 0 <= bootstrap <= 1_000_000:
        raise ValueError(f"bootstrap is {bootstrap}, expected a number from 0 to 1000000, or None")
    with how(threads, progress) as told:
        made, notes = _kalfit.test(
            model_text(model, set),
            as_data(data),
            hypothesis,
            (bootstrap, seed, tolerance, max_iterations),
            file_name(out),
            told,
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
    with how(threads, progress) as told:
        data, count, rows, states, column, notes = _kalfit.simulate(
            model_text(model, set),
            source_text(source),
            as_data(design, "design"),
            (tests, seed),
            (file_name(out), file_name(truth)),
            told,
        )
    return Simulation(table_of(data), table_of(states), (count, rows), column, notes)


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
    with how(threads, progress) as told:
        made, notes = _kalfit.validate(
            model_text(model, set),
            as_data(data),
            (None if by is not None else (folds, seed), by, criterion),
            None if against is None else source_text(against),
            file_name(out),
            told,
        )
    return Validation(made, notes)


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
    made, notes = _kalfit.export(model_text(model, set), source_text(source), (step, fixed, phase), format, file_name(out))
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
    with how(threads, progress) as told:
        made, notes = _kalfit.datasheet(
            model_text(model, set),
            source_text(source),
            [] if data is None else as_data(data),
            (step, fixed),
            file_name(out),
            told,
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
        called, text, path = source_text(given)
        texts.append((name or (called if path else f"fit {number}"), text, path))
    return Comparison(_kalfit.compare(texts, file_name(out)))


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
    with how(threads, progress) as told:
        made, notes = _kalfit.plan(
            model_text(model, set),
            source_text(source),
            as_data(design, "design"),
            (counts, in_groups),
            file_name(out),
            told,
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
    with how(threads, progress) as told:
        return _exchange("reductions", (model, set), data, at, out, told)


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
    with how(threads, progress) as told:
        return _exchange("estimates", (model, set), data, at, out, told)


def _exchange(
    what: Literal["reductions", "estimates"],
    model: tuple[ModelLike, Set],
    data: Data,
    at: Fit | Path | None,
    out: Path | None,
    how: How,
) -> Table | None:
    source = None if at is None else source_text(at)
    table, *_ = _kalfit.exchange(what, model_text(*model), as_data(data), source, file_name(out), how)
    return table_of(table)
