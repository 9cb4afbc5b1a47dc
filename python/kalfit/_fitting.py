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
    """Tests that are given by the arrays of their state-space models, without a model file. Made by :meth:`from_arrays`.

    An ensemble is fitted by :meth:`fit` or :func:`kalfit.fit`. Every other function takes it as data, beside the model that
    :meth:`model` makes for it. ``len(ensemble)`` is the number of tests.
    """

    def __init__(self, table: Table, parts: Mapping[str, object], states: list[str], ids: list[str]) -> None:
        #: The data: a row for each step, and a column for each element of an array that is not the same in all rows.
        self.table = table
        #: Names of the n states, in the order of the arrays.
        self.states = states
        #: Names of the tests.
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
        """Makes an ensemble from the arrays of state-space models.

        Each test has n states x and m measurements z, which follow

        .. code-block:: text

            x_k = F_k x_{k-1} + u_k + w_k,  w_k ~ N(0, Q_k)
            z_k = H_k x_k + d_k + v_k,      v_k ~ N(0, R_k)

        The mean and the covariance of the initial state x_0 over the tests are what a fit estimates.

        - ``measurements``: z, a list with an array of shape (steps, m) for each test, or one array (tests, steps, m). NaN is a
          value that was not measured.
        - ``observation``: H, of shape (m, n) at each step.
        - ``noise``: R, the covariance of v, of shape (m, m) at each step.
        - ``transition``: F, of shape (n, n) at each step; ``None`` is the identity.
        - ``process_noise``: Q, the covariance of w, of shape (n, n) at each step; ``None`` is zero.
        - ``inputs``: u, of shape (n,) at each step; ``None`` is zero.
        - ``measurement_offsets``: d, of shape (m,) at each step; ``None`` is zero.
        - ``start_offsets``: a known amount of x_0 that is added to the part that is estimated, of shape (n,) or (tests, n).
        - ``known_start``: mean and standard deviation of each state whose start is known, as in ``{"drift": (0.0, 0.2)}``; such
          states are no part of what is estimated.
        - ``states``: names of the states; ``None`` calls them ``x1``, ``x2``, ...
        - ``ids``: names of the tests; ``None`` calls them ``1``, ``2``, ...
        - ``step_first``: ``True`` if a transition precedes the first row of a test; else x_0 is the state at its first row.

        Each of ``observation``, ``noise``, ``transition``, ``process_noise``, ``inputs`` and ``measurement_offsets`` is one array
        of the shape of a step, the same at all steps; or an array (steps, ...), the same for all tests, of which a shorter test
        takes the beginning; or a list with one of these for each test. Values that no measurement needs may be NaN.

        Raises ``ValueError`` for arrays whose shapes do not go together, and for covariances that are not symmetric.

        >>> import numpy, kalfit
        >>> line = numpy.array([[[1.0, 0.0]], [[1.0, 5.0]], [[1.0, 10.0]]])  # H: 3 steps, m = 1, n = 2
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
        """The model of these tests.

        - ``mean``: constraints on the mean, as a dictionary of the keys of ``[mean]`` in a model file.
        - ``covariance``: constraints on the covariance, as those of ``[covariance]``: ``{"structure": "diagonal"}``.
        - ``title``: a line for summaries and reports.
        """
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
        """Fits these tests: :func:`kalfit.fit` with the model that :meth:`model` makes.

        ``mean``, ``covariance`` and ``title`` are those of :meth:`model`, ``options`` those of :func:`kalfit.fit`.
        """
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
    """Fits a model to data by maximum likelihood: the mean and covariance of the initial state, and the free parameters.

    The options are those of the command ``kalfit fit``, under the same names.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables; or a :class:`kalfit.Ensemble`,
      which has its own data.
    - ``data``: the tests: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``method``: how free parameters are estimated. ``"hybrid"`` searches over them, and solves for mean and covariance at each
      step; ``"innovations"`` searches over all of them jointly; ``"em"`` is the EM algorithm, with many more steps to the same
      maximum; ``"all"`` runs all three for comparison, and returns the results of ``"hybrid"``.
    - ``solver``: how mean and covariance are estimated: by Newton's method with the exact Hessian (``"newton"``), or by the EM
      algorithm (``"em"``).
    - ``criterion``: what is maximised: the likelihood (``"ml"``), or the restricted likelihood (``"reml"``), by which
      covariances are less biased with few tests.
    - ``phases``: how the phases of a test are combined: exactly, phase by phase (``"chain"``); each by itself, so that their
      correlation is lost (``"marginal"``); or exactly, as one large test (``"stacked"``).
    - ``intervals``: how 95 % intervals are computed: from standard errors (``"wald"``), from the profile likelihood
      (``"profile"``), or from it with quantiles of 199 drawn ensembles, for known parameters (``"bootstrap"``). ``"auto"``
      takes profiles with ``criterion="reml"`` and at most 50 tests or units, where that is quick, and standard errors else.
    - ``df``: how degrees of freedom of means are computed, with ``criterion="reml"`` only: ``"kenward-roger"`` (the default
      there), ``"satterthwaite"`` or ``"none"``.
    - ``std_errors``: how standard errors are computed: from the curvature of the log-likelihood (``"observed"``), from its
      expectation (``"expected"``), or from the curvature and the scatter of the tests' scores (``"sandwich"``), which is valid
      for wrong models too, given many tests.
    - ``deletion``: whether the fit is repeated without each test in turn, to find influential ones: if that takes about a
      second at most (``"auto"``), always (``"all"``) or never (``"none"``).
    - ``innovations``: ``False`` leaves out the innovations, by which the model is checked, and reads the data once only.
    - ``tests``: ``False`` leaves out all results of single tests, for millions of tests.
    - ``group_test``: ``True`` also fits each group of ``[data] group`` by itself, and tests whether the groups differ.
    - ``starts``: number of additional random starts of the search for free parameters, at most 10000; ``None`` is 0.
    - ``seed``: seed of these starts; ``None`` is 1.
    - ``tolerance``: the search ends within this many standard errors of the maximum; ``None`` is 1e-8.
    - ``max_iterations``: the search ends after this many iterations; ``None`` is 200, or 20000 with ``solver="em"``.
    - ``threads``: number of threads; ``None`` is one for each processor. The results do not depend on it.
    - ``out``: a file for all results, as JSON, which :meth:`Fit.load` reads.
    - ``report``: a file for the report, one HTML page. It shows the records of the tests too, where these have times;
      :meth:`Fit.report` makes it from the results alone.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` now and then.

    Returns a :class:`kalfit.Fit`. If it did not converge, it comes with a :class:`kalfit.ConvergenceWarning`. Other threads of
    Python run meanwhile. Ctrl-C ends the fit; if there are estimates by then, :class:`kalfit.Interrupted` has them.

    Raises :class:`kalfit.ModelError` if the model is wrong, :class:`kalfit.DataError` if the data are, and
    :class:`kalfit.FitError` if the model or an option does not go with the data. An argument outside its range is a
    ``ValueError``, one of another type a ``TypeError``.

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
