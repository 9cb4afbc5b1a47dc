"""Fits of a model to data, and of ensembles that are given by arrays.

The function takes an ensemble, and an ensemble has a method that calls it, so they stand in one file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from kalfit import _kalfit
from kalfit._arrays import Builder, PerTest, measured_tests, per_row, start_offsets_per_row
from kalfit._data import Data, Table, as_data
from kalfit._fit import Fit, Interrupted, warn_unless_converged
from kalfit._given import Set, file_name, model_text
from kalfit._made import Made
from kalfit._model import Model, ModelLike, Path
from kalfit._numbers import Array
from kalfit._progress import Progress, how

__all__ = ["Ensemble", "fit"]


class Ensemble:
    """Tests given by the arrays of their state-space models. Made by :meth:`from_arrays`.

    It stands wherever data stand, beside the model that :meth:`model` makes for it, and :func:`kalfit.fit` and :meth:`fit` fit
    it directly.
    """

    def __init__(self, table: Table, parts: Mapping[str, object], states: list[str], ids: list[str]) -> None:
        #: The data: a row a step, a column for whatever is not the same in all rows.
        self.table = table
        #: Names of the states, in the order of the arrays.
        self.states = states
        #: Ids of the tests.
        self.ids = ids
        self._parts = parts

    @classmethod
    def from_arrays(
        cls,
        measurements: Sequence[ArrayLike] | Array,
        *,
        observation: PerTest,
        noise: PerTest,
        transition: PerTest | None = None,
        process_noise: PerTest | None = None,
        inputs: PerTest | None = None,
        measurement_offsets: PerTest | None = None,
        start_offsets: ArrayLike | None = None,
        known_start: Mapping[str, tuple[float, float]] | None = None,
        states: Sequence[str] | None = None,
        ids: Sequence[str] | None = None,
        step_first: bool = False,
    ) -> Ensemble:
        r"""Tests of the model

        .. code-block:: text

            x_k = F_k x_{k-1} + u_k + w_k,  w_k ~ N(0, Q_k)        z_k = H_k x_k + d_k + v_k,  v_k ~ N(0, R_k)

        whose initial state has a mean and a covariance over the tests that are to be estimated. No transition precedes the
        first row of a test, unless ``step_first``.

        ============================ ============ ===================================================================
        argument                     one step     what it is
        ============================ ============ ===================================================================
        ``measurements``             (m,)         z: a list with an array (steps, m) for each test, or one array
                                                  (tests, steps, m); NaN: not measured
        ``observation``              (m, n)       H
        ``noise``                    (m, m)       R, a covariance
        ``transition``               (n, n)       F; identity when None
        ``process_noise``            (n, n)       Q, a covariance; none when None
        ``inputs``                   (n,)         u; none when None
        ``measurement_offsets``      (m,)         d; none when None
        ``start_offsets``            (n,)         known amount of x_0 beside what is estimated: (n,) or (tests, n)
        ============================ ============ ===================================================================

        Each of those from ``observation`` to ``measurement_offsets`` is one array of one step's shape, the same always; or an
        array (steps, ...), the same for all tests, of which a shorter test takes the beginning; or a list with one of these for
        each test. Values that no measurement needs may be NaN.

        ``known_start`` names states whose start is known, with its mean and standard deviation: they are not part of what is
        estimated. ``states`` and ``ids`` are names of the states (``x1``, ``x2``, ...) and of the tests (``1``, ``2``, ...).

        >>> import numpy, kalfit
        >>> line = numpy.array([[[1.0, 0.0]], [[1.0, 5.0]], [[1.0, 10.0]]])          # H: 3 steps, m = 1, n = 2
        >>> ends = [(1.0, 2.1), (0.2, 0.3), (1.9, 4.2), (0.8, 0.9), (1.1, 3.0), (0.4, 1.2)]
        >>> ensemble = kalfit.Ensemble.from_arrays(
        ...     [numpy.array([[a], [0.5 * (a + b)], [b]]) for a, b in ends],
        ...     observation=line, noise=[[0.01]], states=["intercept", "slope"],
        ... )
        >>> ensemble
        <kalfit.Ensemble: 6 tests, 18 rows, states intercept, slope>
        >>> fit = ensemble.fit(covariance={"structure": "diagonal"})
        >>> fit.mean.round(6).tolist()
        [0.9, 0.105]

        Raises :class:`ValueError` for arrays whose shapes do not go together.
        """
        z = measured_tests(measurements)
        rows = [len(test) for test in z]
        m = z[0].shape[1]
        h = per_row("observation", observation, (m, -1), rows)
        n = h.shape[2]
        names = [f"x{i + 1}" for i in range(n)] if states is None else [str(name) for name in states]
        if len(names) != n or len(set(names)) != n:
            raise ValueError(f"states has {len(names)} names ({', '.join(names)}), expected {n} different ones, as H has columns")
        labels = [str(i + 1) for i in range(len(z))] if ids is None else [str(label) for label in ids]
        if len(labels) != len(z) or len(set(labels)) != len(z):
            raise ValueError(f"ids has {len(labels)} texts, expected {len(z)} different ones, as there are tests")
        builder = Builder(np.concatenate(z), names)
        builder.motion(
            per_row("transition", np.eye(n) if transition is None else transition, (n, n), rows),
            per_row("process_noise", np.zeros((n, n)) if process_noise is None else process_noise, (n, n), rows),
            per_row("inputs", np.zeros(n) if inputs is None else inputs, (n,), rows),
        )
        builder.observed(
            h,
            per_row("noise", noise, (m, m), rows),
            per_row("measurement_offsets", np.zeros(m) if measurement_offsets is None else measurement_offsets, (m,), rows),
        )
        builder.starts(start_offsets_per_row(start_offsets, n, rows), dict(known_start or {}))
        return cls(builder.table(np.repeat(labels, rows)), builder.parts(step_first), names, labels)

    def model(
        self,
        *,
        mean: Mapping[str, object] | None = None,
        covariance: Mapping[str, object] | None = None,
        title: str = "",
    ) -> Model:
        """The model of these tests, with the structure of a model file's ``[mean]`` and ``[covariance]``."""
        parts: dict[str, object] = {"title": title, **self._parts}
        if mean is not None:
            parts["mean"] = mean
        if covariance is not None:
            parts["covariance"] = covariance
        return Model(parts)

    def fit(
        self,
        *,
        mean: Mapping[str, object] | None = None,
        covariance: Mapping[str, object] | None = None,
        title: str = "",
        **options: Any,
    ) -> Fit:
        """Fits these tests; ``options`` are those of :func:`kalfit.fit`."""
        return fit(self.model(mean=mean, covariance=covariance, title=title), self, **options)

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """A capsule with an Arrow C stream of :attr:`table`."""
        return self.table.__arrow_c_stream__(requested_schema)

    def __len__(self) -> int:
        return len(self.ids)

    def __repr__(self) -> str:
        return f"<kalfit.Ensemble: {len(self)} tests, {len(self.table)} rows, states {', '.join(self.states)}>"


def fit(
    model: ModelLike | Ensemble,
    data: Data | None = None,
    *,
    set: Set = None,
    method: Literal["hybrid", "innovations", "em", "all"] = "hybrid",
    solver: Literal["newton", "em"] = "newton",
    criterion: Literal["ml", "reml"] = "ml",
    phases: Literal["chain", "marginal", "stacked"] = "chain",
    intervals: Literal["auto", "wald", "profile", "bootstrap"] = "auto",
    df: Literal["kenward-roger", "satterthwaite", "none"] | None = None,
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
    out all results of single tests, for millions of tests. ``df`` goes with ``criterion="reml"``, where ``"kenward-roger"`` is the
    default. ``progress=True`` writes a line to standard error; a function is called
    with a :class:`kalfit.Step` instead.

    A fit that did not converge comes with a :class:`kalfit.ConvergenceWarning`. The work is done without Python's lock. Ctrl-C ends it at once; if there is something to show by then, the exception is
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
        "df": df,
        "std_errors": std_errors,
        "deletion": deletion,
        "innovations": innovations,
        "tests": tests,
        "group_test": group_test,
        "starts": starts,
        "seed": seed,
        "tolerance": tolerance,
        "max_iterations": max_iterations,
        "report": file_name(report),
    }
    with how(threads, progress) as told:
        found, interrupted = _kalfit.fit(model_text(model, set), as_data(data), file_name(out), options, told)
    result = Fit(found)
    kept = {name: value for name, value in options.items() if name != "report"} | {"threads": threads}
    result._made = Made(model, set, data, kept, fit)
    if interrupted:
        raise Interrupted(result)
    warn_unless_converged(result)
    return result
