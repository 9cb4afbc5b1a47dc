"""What the results of a fit say.

What draws or sends a fit needs no more than this: files that do so stand between it and :class:`kalfit.Fit`.
"""

from __future__ import annotations

import copy
import json
from functools import cached_property
from typing import Any

from kalfit import _kalfit
from kalfit._estimates import Estimate, Parameters, estimate_of, parameter_of
from kalfit._numbers import Array, MaskedArray, number
from kalfit._population import Factor, Level, Phase
from kalfit._test_fits import GroupFit, TestFit, group_fit_of, test_fit_of

__all__ = ["FitRecord"]


class FitRecord:
    """What the results of a fit say of the population, of its parameters and of the tests."""

    def __init__(self, results: str | _kalfit.Results, name: str) -> None:
        self._results = _kalfit.Results(name, results) if isinstance(results, str) else results

    def to_json(self) -> str:
        """All results as JSON, as ``kalfit fit --out`` writes it."""
        return self._results.json()

    def to_dict(self) -> dict[str, Any]:
        """All results as a dictionary, with the keys of the JSON. Each call makes a new one."""
        result: dict[str, Any] = json.loads(self.to_json())
        return result

    @cached_property
    def _record(self) -> dict[str, Any]:
        """All but the tests, of which there may be very many."""
        record: dict[str, Any] = json.loads(self._results.head())
        return record

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The mean and covariance of each phase; a model without phases has one, named ``main``."""
        return tuple(Phase(phase) for phase in self._record["phases"])

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """The covariance of each level of groups, the outermost first, and last that between tests; empty without groups."""
        return tuple(Level(level) for level in self._record.get("levels", []))

    @cached_property
    def crossed(self) -> tuple[Factor, ...]:
        """The covariance of each crossed factor, with the effects of its levels; empty without such factors."""
        return tuple(Factor(factor) for factor in self._record.get("crossed", []))

    def level(self, name: str) -> Level:
        """The level or crossed factor of this ``name``; ``tests`` is the level of the tests themselves.

        Raises ``KeyError`` if there is none.
        """
        levels = [*self.levels, *self.crossed]
        for level in levels:
            if level.name == name:
                return level
        names = ", ".join(level.name for level in levels) or "none"
        raise KeyError(f"there is no level {name!r}, there are {names}")

    @cached_property
    def groups(self) -> list[GroupFit]:
        """What the fit says of each group, level by level, the outermost first; empty without levels."""
        return [group_fit_of(record) for record in self._record.get("groups", [])]

    def phase(self, name: str) -> Phase:
        """The phase of this ``name``. Raises ``KeyError`` if there is none."""
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
        """Mean of the initial state over the population, shape (p,), in the units of the states."""
        return self._only.mean

    @property
    def covariance(self) -> Array:
        """Covariance of the initial state over the population, shape (p, p). With levels, that between tests of one group."""
        return self._only.covariance

    @property
    def std_dev(self) -> Array:
        """Standard deviations of the initial state, shape (p,): roots of the diagonal of :attr:`covariance`."""
        return self._only.std_dev

    @property
    def correlation(self) -> MaskedArray:
        """Correlations of the initial state, shape (p, p); masked beside a variance of zero."""
        return self._only.correlation

    @cached_property
    def parameters(self) -> Parameters:
        """The dynamic parameters: ``fit.parameters["tau"].estimate``."""
        return Parameters([parameter_of(record) for record in self._record["parameters"]])

    @cached_property
    def tests(self) -> list[TestFit]:
        """What the fit says of each test, in the order of the data; empty after ``kalfit.fit(…, tests=False)``."""
        return self._some_tests(1)

    def _some_tests(self, every: int) -> list[TestFit]:
        return [test_fit_of(record) for record in json.loads(self._results.tests(every))]

    @cached_property
    def estimates(self) -> dict[str, Estimate]:
        """Every number of the fit by its name: ``fit.estimates["mean[bias]"].interval95``."""
        return {row["name"]: estimate_of(row) for row in json.loads(self._results.quantities())}

    def _is_positive(self, own: Estimate) -> bool:
        """Whether a number cannot be negative: a standard deviation, a variance, a parameter that is used as one."""
        if own.kind == "parameter":
            name = f"parameter `{own.name.split('[')[0]}`"
            return any(words.startswith(name) and "not negative" in words for words in self._record.get("model") or [])
        if own.kind == "covariance":
            first, second = own.name[own.name.index("[") + 1 : -1].split(", ")
            return first == second
        return own.kind == "std_dev"

    @property
    def constraints(self) -> list[dict[str, Any]]:
        """A dictionary for each constrained element of mean and covariance, with the cost of the constraint: ``element``, ``value``,
        ``sensitivity``, ``score_statistic``, ``p_value`` and more."""
        result: list[dict[str, Any]] = copy.deepcopy(self._record["constraints"])
        return result

    @property
    def title(self) -> str:
        """Title of the model; an empty text if it has none."""
        return str(self._record["title"])

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of all measurements, with all constants; the restricted one under ``criterion="reml"``."""
        return float(self._record["log_likelihood"])

    @property
    def aic(self) -> float | None:
        """Akaike's criterion, 2k - 2ℓ with k free quantities. ``None`` if the log-likelihood ℓ is that of estimates, or is not what was
        maximised."""
        return number(self._record["aic"])

    @property
    def bic(self) -> float | None:
        """Schwarz's criterion, k log(observations) - 2ℓ. ``None`` where :attr:`aic` is, or without observations."""
        return number(self._record["bic"])

    @property
    def free_parameters(self) -> int:
        """Number of free quantities: elements of mean and covariance, regression coefficients and parameters."""
        return int(self._record["free_parameters"])

    @property
    def converged(self) -> bool:
        """Whether the conditions of a maximum hold: see :attr:`certificate`."""
        return bool(self._record["converged"])

    @property
    def reason(self) -> str:
        """Why the search ended, in words."""
        return str(self._record["reason"])

    @property
    def misfit(self) -> dict[str, Any] | None:
        """What tests have in common that the model does not describe: score tests of mean terms (``terms``), ``normality`` of the
        innovations, tests ``unlike`` the others of their groups, and ``wrong_rows``, measurements that contradict the others of
        their test. ``None`` without innovations."""
        found = self._record.get("misfit")
        none: dict[str, Any] = {"unlike": [], "wrong_rows": []}
        return None if found is None else none | copy.deepcopy(found)

    @property
    def model_check(self) -> dict[str, Any]:
        """Whether the model describes the data: ``verdict`` (``passed``, ``doubtful`` or ``not checked``), the ``findings`` that
        speak against it, and ``remarks`` that limit its answer, each with ``kind`` and ``text``."""
        none: dict[str, Any] = {"verdict": "not checked", "findings": [], "remarks": []}
        return none | (self._record.get("model_check") or {})

    @property
    def by_group(self) -> list[dict[str, Any]]:
        """A dictionary for each group of ``[data] group``, with the figures of its tests together: ``group``, ``tests``,
        ``log_likelihood``, ``innovations_mean_square``, ``distance`` and more."""
        return [dict(group) for group in self._record.get("by_group") or []]

    @property
    def group_test(self) -> dict[str, Any] | None:
        """The test of whether the groups of ``[data] group`` differ: ``statistic``, ``degrees_of_freedom``, ``p_value`` and more.
        ``None`` unless the fit was made with ``group_test=True``."""
        found = self._record.get("group_test")
        return None if found is None else dict(found)

    @property
    def certificate(self) -> dict[str, float]:
        """How far the conditions of a maximum are from holding, in standard errors: ``mean``, ``covariance``, ``null_space``,
        ``parameters``, and ``rounding``, a bound of the rounding errors in these."""
        return dict(self._record["certificate"])

    @property
    def notes(self) -> list[str]:
        """Findings in plain words, the most important first."""
        return list(self._record.get("notes", []))
