"""The functions, one for each command. Those that a class calls stand beside it, in `_fit` and `_fitting`."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Literal

from kalfit import _kalfit
from kalfit._data import Data, Table, as_data
from kalfit._fit import Fit
from kalfit._fit_record import FitRecord
from kalfit._given import Set, file_name, model_text, outputs_text, source_text, table_of, text_beside
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
    """Checks a model, and data if given, without a fit: the model in words, counts, and what the data identify.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests; ``None`` checks the model alone.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Check`, and raises what :func:`kalfit.fit` raises.

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

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``null``: the hypothesis: a dictionary with ``mean``, ``covariance``, ``parameters`` or ``levels``, or a file with these
      tables. Its keys replace those of the model; ``structure`` drops the other keys of ``covariance``.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``bootstrap``: number of ensembles that are drawn from the hypothesis, for a p-value without large-sample theory; 0 draws
      none. ``None`` draws 999 where there are at most 50 tests or units and all parameters are known.
    - ``seed``: seed of the bootstrap.
    - ``tolerance``: each search ends within this many standard errors of the maximum; ``None`` is 1e-8.
    - ``max_iterations``: each search ends after this many iterations; ``None`` is 200.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``out``: a file for all results, as JSON.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.RatioTest`, and raises what :func:`kalfit.fit` raises.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> found = kalfit.test(model, data, {"mean": {"fixed": {"bias": 0}}})
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
    plan: Plan | Path | None = None,
    set: Set = None,
    out: Path | None = None,
    truth: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Simulation:
    """Draws an ensemble of tests from a fit, or from the values in a model.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``design``: data that give times, inputs and missing values; the measured values in them are not used.
    - ``seed``: the same seed draws the same ensemble.
    - ``tests``: number of tests; ``None`` is as many as the design has. The tests of the design are used in turn; from the second
      round on they have ids such as ``A#2``.
    - ``plan``: a best plan by :func:`kalfit.plan`, or its file: the tests of the design, which are its candidates, are drawn as
      often as it says.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for the data, in place of ``.data`` of the result. Its ending is the format: ``.csv``, ``.tsv``,
      ``.parquet`` or ``.arrow``.
    - ``truth``: a file for the true initial states, where ``out`` names one for the data.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Simulation`, and raises what :func:`kalfit.fit` raises.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> kalfit.simulate(model, kalfit.fit(model, data), data, seed=7)
    <kalfit.Simulation: 28 tests, 614 rows>
    """
    if tests is not None and not 1 <= tests <= 1_000_000_000:
        raise ValueError(f"tests is {tests}, expected a number from 1 to 1000000000, or None")
    if tests is not None and plan is not None:
        raise ValueError("a plan is given, expected no number of tests")
    with how(threads, progress) as told:
        data, count, rows, states, column, notes = _kalfit.simulate(
            model_text(model, set),
            source_text(source),
            as_data(design, "design"),
            (tests, plan_text(plan), seed),
            (file_name(out), file_name(truth)),
            told,
        )
    return Simulation(table_of(data), table_of(states), (count, rows), column, notes)


def plan_text(plan: Plan | Path | None) -> tuple[str, str, str | None] | None:
    """A plan with its name: as itself, or in a file."""
    if plan is None or isinstance(plan, Plan):
        return None if plan is None else ("the plan", plan.to_json(), None)
    path = os.fspath(plan)
    with open(path, encoding="utf-8") as file:
        return (path, file.read(), path)


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
    """Cross-validates a model: how well it predicts tests that were left out of the fit, and whether another model does better.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``folds``: number of folds, 2 or more, into which the tests are drawn, or in a model with levels the groups of the outermost
      one; as many folds as tests leave out each test by itself.
    - ``seed``: seed of that draw.
    - ``by``: a column of the data: tests with the same text in it are a fold, in place of a draw.
    - ``against``: another model of the same measurements, for a comparison on the same folds; ``set`` does not apply to it.
    - ``criterion``: what the fits maximise: the likelihood (``"ml"``) or the restricted likelihood (``"reml"``).
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for all results, as JSON.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Validation`, and raises what :func:`kalfit.fit` raises.

    >>> import kalfit
    >>> folder = "examples/random-coefficients"
    >>> model, data = f"{folder}/sleepstudy.toml", f"{folder}/sleepstudy.csv"
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
    """Makes the Kalman filter that follows from a fit, as constant matrices for other programs.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``step``: length of a step in the model's unit of time; it is needed where anything depends on it.
    - ``at``: values of columns on which coefficients of states, or noise, depend: ``{"temperature": 20}``.
    - ``phase``: the phase whose filter it is, for a model with several.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``format``: what is written to ``out``: JSON (``"json"``), arrays of numpy (``"npz"``), variables of Matlab and Octave
      (``"mat"``), a header for C and C++ (``"c"``) or a module of Python (``"python"``). ``None`` goes by the ending of the file:
      ``.json``, ``.npz``, ``.mat``, ``.h`` or ``.py``.
    - ``out``: a file for the filter.

    Returns a :class:`kalfit.Filter`, and raises :class:`kalfit.ModelError` if the matrices depend on ``step`` or on a column
    that has no value.

    >>> import kalfit
    >>> folder = "examples/random-coefficients"
    >>> model, data = f"{folder}/sleepstudy.toml", f"{folder}/sleepstudy.csv"
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
    """Computes the numbers of a datasheet in their usual units: random walks, turn-on repeatability, Allan deviations.

    Numbers in deg/h, deg/s and rad/s become deg/h, those in m/s^2, g, mg and ug become ug; white noise of them is in deg/sqrt(h)
    and m/s/sqrt(h). Other units stay as they are.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``data``: tests whose Allan deviations stand beside those of the model.
    - ``step``: time from a value to the next in the model's unit of time, where there are no data.
    - ``at``: values of columns on which noise or motion depend: ``{"temperature": 20}``.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for all results, as JSON.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Datasheet`, and raises what :func:`kalfit.fit` raises.

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
    """Compares fits of the same data: log-likelihoods, AIC and BIC, likelihood-ratio tests of nested fits, and what differs.

    - ``fits``: a list of two or more fits or their files, or a dictionary of these with names to call them by. Files may also be
      those of ``kalfit validate --out``.
    - ``out``: a file for all results, as JSON.

    Returns a :class:`kalfit.Comparison`, and raises :class:`kalfit.DataError` if the fits are of different data.

    >>> import kalfit
    >>> data = "examples/random-coefficients/sleepstudy.csv"
    >>> model = kalfit.Model.load("examples/random-coefficients/sleepstudy.toml")
    >>> apart = kalfit.Model.from_text(model.text + '\\n[covariance]\\nstructure = "diagonal"')
    >>> fits = {"full": kalfit.fit(model, data), "diagonal": kalfit.fit(apart, data)}
    >>> compared = kalfit.compare(fits)
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
    design: Data | None = None,
    tests: Sequence[int] | None = None,
    *,
    groups: Mapping[str, Sequence[int]] | None = None,
    candidates: Data | None = None,
    budget: float | None = None,
    cost: str | None = None,
    most: str | None = None,
    goal: str = "D",
    so_far: Fit | Data | None = None,
    draws: int | None = None,
    seed: int = 1,
    mission: Data | None = None,
    outputs: Path | Mapping[str, object] | None = None,
    set: Set = None,
    out: Path | None = None,
    threads: int | None = None,
    progress: Progress = False,
) -> Plan:
    """Computes the standard errors to be expected before any test is run: of different numbers of tests like those of a design,
    or of the best plan among candidates within a budget.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``source``: the population that is taken to be the true one: a fit, its file, or a model with fixed or start values.
    - ``design``: data that give times, inputs and missing values; the measured values in them are not used.
    - ``tests``: the numbers of tests, each like those of the design: ``[10, 20, 50]``. With ``groups``, the numbers of tests in
      each group of the innermost level.
    - ``groups``: for a model with levels, the numbers of groups of each level in each group of the level above:
      ``{"serial": [5, 10, 20]}``.
    - ``candidates``: in place of ``design`` and ``tests``, data whose tests are the kinds of tests that could be made; for a
      model with levels, its units of the outermost level.
    - ``budget``: the largest cost of all tests of the best plan together.
    - ``cost``: the column of the cost of one test; by default ``cost`` where the data have it, else each test costs 1.
    - ``most``: the column of the largest number of tests; by default ``most`` where the data have it, else there is no limit.
    - ``goal``: what is to become best known: ``"D"``, all free values together; ``"A"``, the means over their standard
      deviations; or figures such as ``"sd(scale)"``, ``"corr(bias, scale)"`` or the name of a parameter.
    - ``so_far``: what is known already: a fit, its file, or data of tests that were made.
    - ``draws``: a number of draws of the parameters by the errors of the fit; the plan is the best on average over them.
    - ``seed``: the seed of the draws.
    - ``mission``: data of one test that has not been made; ``"output(NAME, 3)"`` and ``"limit(NAME, 3)"``, the mean of a state or
      output at its row 3 and the limit below which 95 % of all tests stay, are then figures of ``goal``.
    - ``outputs``: outputs of the mission, linear in the states: the path of a file of ``[outputs.NAME]``, or its tables.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a file for all results, as JSON.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Plan`, and raises what :func:`kalfit.fit` raises, and ``ValueError`` if neither ``design`` and
    ``tests`` nor ``candidates`` and ``budget`` are given.

    >>> import kalfit
    >>> model, data = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    >>> fit = kalfit.fit(model, data)
    >>> kalfit.plan(model, fit, data, tests=[10, 20]).to_dict()["tests"]
    [10, 20]
    >>> best = kalfit.plan(model, fit, candidates=data, budget=12, goal="sd(bias)")
    >>> sum(candidate["tests"] for candidate in best.to_dict()["candidates"])
    12
    """
    if candidates is not None:
        if design is not None or tests is not None or groups is not None:
            raise ValueError("candidates are given, expected no design, tests or groups")
        if budget is None or not 0.0 < budget < math.inf:
            raise ValueError(f"budget is {budget!r}, expected a number above 0")
        if draws is not None and not 1 <= draws <= 1000:
            raise ValueError(f"draws is {draws}, expected a number from 1 to 1000")
        is_fit = isinstance(so_far, FitRecord) or (isinstance(so_far, (str, os.PathLike)) and os.fspath(so_far).lower().endswith(".json"))
        known = None if so_far is None or not is_fit else source_text(so_far)  # type: ignore[arg-type]
        made = None if so_far is None or is_fit else as_data(so_far, "so_far")  # type: ignore[arg-type]
        of_outputs = None if outputs is None else outputs_text(outputs)
        limits = (float(budget), cost, most, str(goal), None if draws is None else (int(draws), int(seed)))
        with how(threads, progress) as told:
            text, notes = _kalfit.best_plan(
                model_text(model, set),
                source_text(source),
                as_data(candidates, "candidates"),
                limits,
                (known, made, ([] if mission is None else as_data(mission, "mission"), of_outputs), file_name(out)),
                told,
            )
        return Plan(text, notes)
    if design is None or tests is None:
        raise ValueError("expected a design and numbers of tests, or candidates and a budget")
    counts = [int(count) for count in tests]
    if not counts or not all(1 <= count <= 1_000_000_000 for count in counts):
        raise ValueError(f"tests is {list(tests)}, expected numbers from 1 to 1000000000")
    in_groups = [(str(level), [int(count) for count in own]) for level, own in (groups or {}).items()]
    if not all(own and all(1 <= count <= 1_000_000 for count in own) for _, own in in_groups):
        raise ValueError(f"groups is {groups!r}, expected numbers from 1 to 1000000")
    with how(threads, progress) as told:
        made_text, notes = _kalfit.plan(
            model_text(model, set),
            source_text(source),
            as_data(design, "design"),
            (counts, in_groups),
            file_name(out),
            told,
        )
    return Plan(made_text, notes)


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
    """Runs the filters once at known parameters, and returns the reductions: all that a fit needs of the data.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``at``: a fit or its file, from which free parameters of the model take their values.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a Parquet file for the table.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a table with a row for each test and phase, or ``None`` if ``out`` names a file. Table and file can be used wherever
    data can. Raises :class:`kalfit.ModelError` if a parameter has no value, and what :func:`kalfit.fit` raises.

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
    """Runs the ``[filter]`` of each phase, optimal or not, and returns its estimates with the covariance of their errors.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``data``: the tests: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``at``: a fit or its file, from which free parameters of the model take their values.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``out``: a Parquet file for the table.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a table with a row for each test and phase, or ``None`` if ``out`` names a file. Table and file can be used wherever
    data can. Raises :class:`kalfit.DataError` if a phase has no ``[filter]``, and what :func:`kalfit.fit` raises.
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
