"""The tables of a fit: estimates, their covariance and intervals, tests, constraints."""

from __future__ import annotations

import json
from typing import Any, Literal

import numpy as np

from kalfit import _kalfit
from kalfit._broom import broom_rows
from kalfit._data import Table
from kalfit._fit_record import FitRecord
from kalfit._formula_model import FormulaModel
from kalfit._frames import data_frame, table_of_columns
from kalfit._intervals import wald
from kalfit._labelled import Labelled

__all__ = ["FitTables"]


class FitTables(FitRecord):
    """What the results of a fit say, as tables."""

    def __init__(self, results: str | _kalfit.Results, name: str) -> None:
        super().__init__(results, name)
        #: The formula and its model, if :func:`kalfit.lmm` made the fit; else ``None``.
        self.formula: FormulaModel | None = None

    def tidy(self, names: Literal["kalfit", "broom"] = "kalfit") -> Table:
        """Every estimate as a table, a row for each number.

        - ``names``: ``"kalfit"`` has the columns ``name``, ``kind``, ``phase``, ``level``, ``state``, ``other_state``, ``column``,
          ``unit``, ``estimate``, ``std_error``, ``lower`` and ``upper`` (95 %), ``df``, ``statistic`` and ``p_value`` (of means
          under ``reml``) and ``status``, which :class:`kalfit.Estimate` describes. ``"broom"`` has the rows and columns of R's
          broom.mixed: ``effect`` (``fixed``, ``ran_pars`` or ``parameter``), ``group``, ``term``, ``estimate``, ``std_error``,
          ``statistic``, ``df``, ``p_value``, ``conf_low`` and ``conf_high``. Without degrees of freedom the p-values of fixed
          effects are those of the normal distribution.

        For a data frame: ``fit.tidy().to_polars()`` or ``fit.tidy().to_pandas()``.
        """
        if names not in ("kalfit", "broom"):
            raise ValueError(f"names is {names!r}, expected 'kalfit' or 'broom'")
        return broom_rows(self, self.formula) if names == "broom" else Table(self._results.table("parameters"))

    def glance(self) -> Table:
        """The fit as a table of one row.

        Its columns are ``title``, ``criterion``, ``model_check``, ``tests``, ``observations``, ``free_parameters``,
        ``log_likelihood``, ``aic``, ``bic`` and ``converged`` (1 or 0), and those of broom: ``nobs``, ``sigma`` (if the model has one
        parameter of that name), ``deviance`` (minus twice the log-likelihood; under ``reml`` lme4's REML criterion) and
        ``df_residual``.
        """
        noise = [parameter.estimate for parameter in self.parameters if parameter.name == "sigma"]
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
            "nobs": data["observations"],
            "sigma": noise[0] if len(noise) == 1 else None,
            "deviance": -2.0 * self.log_likelihood,
            "df_residual": data["observations"] - self.free_parameters,
        }
        return table_of_columns({name: [text] for name, text in texts.items()}, {name: [x] for name, x in numbers.items()})

    def vcov(self, what: Literal["fixed", "all"] = "fixed") -> Labelled:
        """The covariance of the estimates, with their names.

        - ``what``: ``"fixed"`` is that of means and regression coefficients, ``"all"`` that of variances, covariances and parameters
          too.

        ``numpy.asarray(fit.vcov())`` is an array, ``fit.vcov().to_pandas()`` a data frame. Under ``reml`` it is the covariance at the
        estimated variances, as lme4's ``vcov``; the standard errors of Kenward and Roger, which a fit then has, are a little larger
        where designs differ. Raises ``ValueError`` for a fit of more than 200 estimates, which does not keep it.

        >>> import kalfit
        >>> fit = kalfit.fit("examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv")
        >>> round(fit.vcov()["mean[bias]", "mean[scale]"], 2)
        0.32
        """
        if what not in ("fixed", "all"):
            raise ValueError(f"what is {what!r}, expected 'fixed' or 'all'")
        record = self._record.get("estimates")
        if not record:
            raise ValueError("this fit has no covariance of its estimates: it has more than 200 of them, or an older version made it")
        names = list(record["names"])
        kept = [k for k, name in enumerate(names) if what == "all" or self.estimates[name].kind in ("mean", "regression")]
        values = np.array(record["covariance"], dtype=np.float64).reshape(len(names), len(names))
        return Labelled([names[k] for k in kept], values[np.ix_(kept, kept)])

    def conf_int(self, level: float = 0.95, method: Literal["wald", "profile", "bootstrap"] | None = None) -> Table:
        """Confidence intervals as a table: ``name``, ``lower`` and ``upper`` of every estimate that has one.

        - ``level``: confidence, between 0 and 1.
        - ``method``: ``None`` takes the intervals of the fit at 0.95, whose option ``intervals`` says how they are computed, and
          those from standard errors at other levels. ``"wald"`` takes those from standard errors: of means by Student's t where
          the fit has degrees of freedom, on the logarithmic scale for what is positive, on the atanh scale for correlations.
          ``"profile"`` and ``"bootstrap"`` take those of a fit with this option, at 0.95 only.

        An end that was not found is NaN. Raises ``ValueError`` if the fit has no such intervals.
        """
        rows = self._intervals(level, method)
        ends = {"lower": [low for _, low, _ in rows], "upper": [high for _, _, high in rows]}
        return table_of_columns({"name": [name for name, _, _ in rows]}, ends)

    def _intervals(self, level: float, method: str | None) -> list[tuple[str, float | None, float | None]]:
        if not 0.0 < level < 1.0:
            raise ValueError(f"level is {level}, expected a number between 0 and 1, such as 0.95")
        if method not in ("wald", "profile", "bootstrap", None):
            raise ValueError(f"method is {method!r}, expected 'wald', 'profile' or 'bootstrap'")
        if method in ("profile", "bootstrap"):
            if self._record.get("intervals") != method:
                raise ValueError(f"this fit has no {method} intervals: fit with intervals={method!r}")
            if level != 0.95:
                raise ValueError(
                    f"level is {level}, but {method} intervals are found by the fit, at 0.95 only: method='wald' has other levels"
                )
        rows: list[tuple[str, float | None, float | None]] = []
        for own in self.estimates.values():
            if own.status == "fixed":
                continue
            by_error = wald(own, level, self._is_positive(own)) if method == "wald" or level != 0.95 else None
            low, high = by_error or ((None, None) if method == "wald" or level != 0.95 else own.interval95)
            if (low, high) != (None, None):
                rows.append((own.name, low, high))
        return rows

    def summary(self, width: int = 80, color: bool = False, *, level: float | None = None) -> str:
        """The results in words and tables, as the command prints them.

        - ``width``: number of characters of a line.
        - ``color``: ``True`` adds the colours of a terminal.
        - ``level``: a confidence, such as 0.9, at which a table of the intervals of :meth:`conf_int` follows.
        """
        text = self._results.summary(width, color)
        if level is None:
            return text
        rows = [(name, _shown(low), _shown(high)) for name, low, high in self._intervals(level, None)]
        widths = [max(len(row[at]) for row in [("name", "lower", "upper"), *rows]) for at in range(3)]
        lines = [f"{a:<{widths[0]}}  {b:>{widths[1]}}  {c:>{widths[2]}}" for a, b, c in [("name", "lower", "upper"), *rows]]
        return text.rstrip("\n") + f"\n\nIntervals at {100 * level:g} %\n" + "\n".join(f"  {line}" for line in lines) + "\n"

    def parameters_frame(self) -> Any:
        """All estimates as a ``pandas.DataFrame`` with a row for each number and the columns of :meth:`tidy`, as
        ``kalfit fit --parameters`` writes them. This needs pandas.
        """
        rows = json.loads(self._results.quantities())
        texts = ["name", "kind", "phase", "level", "state", "other_state", "column", "unit"]
        return data_frame(rows, texts, ["estimate", "std_error", "lower", "upper", "df", "statistic", "p_value"], ["status"])

    def tests_frame(self) -> Any:
        """What the fit says of each test, as a ``pandas.DataFrame`` with a row for each test. This needs pandas.

        Its columns are ``id``, ``group``, a column for each level of groups, ``log_likelihood``, ``observations``, ``distance``,
        ``degrees_of_freedom``, ``p_value``, ``mean[STATE]`` and ``std_dev[STATE]``; with several phases the name of the phase comes
        first, as in ``mean[coast: bias]``. :class:`kalfit.TestFit` describes them.
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

    def constraints_frame(self) -> Any:
        """What each constraint costs, as a ``pandas.DataFrame`` with a row for each constrained element. This needs pandas.

        Its columns, as ``kalfit fit --constraints`` writes them, are ``element``, ``phase``, ``level``, ``value`` (at which it is
        fixed), ``sensitivity`` (derivative of the log-likelihood with respect to that value), ``score_statistic`` and ``p_value``
        (the score test of the constraint), ``expected_change`` (of the element if it were freed), ``likelihood_ratio`` and
        ``likelihood_ratio_p_value`` (of a fit without the constraint, where one was made).
        """
        numbers = ["value", "sensitivity", "score_statistic", "p_value", "expected_change"]
        numbers += ["likelihood_ratio", "likelihood_ratio_p_value"]
        return data_frame(self._record["constraints"], ["element", "phase", "level"], numbers, [])

    def rows_frame(self) -> Any:
        """Measurements that contradict the others of their test, as a ``pandas.DataFrame`` with a row for each. This needs pandas.

        Its columns, as ``kalfit fit --rows`` writes them, are ``test``, ``phase``, ``file``, ``measurement``, ``row``, ``time``,
        ``deviation`` (from what all other measurements of the test say, in the unit of the measurement) and its ``std_dev``,
        ``p_value``, and ``adjusted_p_value`` (for the number of measurements). Raises ``ValueError`` for a fit without innovations.
        """
        if self.misfit is None:
            raise ValueError("this fit has no innovations, by which single measurements are examined")
        rows = self.misfit["wrong_rows"]
        numbers = ["row", "time", "deviation", "std_dev", "p_value", "adjusted_p_value"]
        return data_frame(rows, ["test", "phase", "file", "measurement"], numbers, [])


def _shown(end: float | None) -> str:
    return "" if end is None else f"{end:.6g}"
