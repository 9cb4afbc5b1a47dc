"""Results of everything but a fit."""

from __future__ import annotations

import json
from typing import Any

from kalfit import _kalfit
from kalfit._data import Table

__all__ = ["Applied", "Check", "Plan", "Predicted", "RatioTest", "Simulation", "Validation"]


class _Record:
    """Results that were made, as JSON and in words."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        self._json = json_text
        #: What one should know beside the results.
        self.notes = notes

    def to_json(self) -> str:
        """All results as JSON."""
        return self._json

    def to_dict(self) -> dict[str, Any]:
        """All results, as the JSON has them."""
        result: dict[str, Any] = json.loads(self._json)
        return result

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The results in words and tables."""
        raise NotImplementedError

    def __str__(self) -> str:
        return self.summary()

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(self.summary())


class RatioTest(_Record):
    """A hypothesis, tested within a model by the ratio of the likelihoods."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Twice the log-likelihood that the hypothesis costs.
        self.statistic: float = float(record["lr"])
        #: Number of constraints.
        self.degrees_of_freedom: int = record["df"]
        #: By the large-sample law; None where there is none. That of a bootstrap is in :meth:`to_dict`.
        self.p_value: float | None = record["p_value"]
        #: Whether both fits are certified.
        self.converged: bool = record["converged"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The test in words and tables, as ``kalfit test`` prints it."""
        return _kalfit.ratio_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.RatioTest: statistic {self.statistic:.4g}, p-value {self.p_value}>"


class Applied(_Record):
    """A fitted model that was applied to tests."""

    def __init__(self, json_text: str, notes: list[str], tests: Table | None, states: Table | None) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Log density of all that was measured.
        self.log_density: float = float(record["log_density"])
        #: What each test says, a row for each phase; None when it went to a file.
        self.tests = tests
        #: States at every step, and what they say of each measured value; None when they went to a file or were not asked for.
        self.states = states

    def summary(self, width: int = 80, color: bool = False) -> str:
        """What the model says of all tests, in words and tables, as ``kalfit apply`` prints it."""
        return _kalfit.applied_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Applied: {self.to_dict()['tests']} tests, log density {self.log_density:.6g}>"


class Predicted(_Record):
    """What tests that nobody has made will give."""

    def __init__(self, json_text: str, notes: list[str], table: Table | None) -> None:
        super().__init__(json_text, notes)
        #: States and outputs at every row; None when they went to a file.
        self.table = table

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The last row of each of the first tests, in words and tables, as ``kalfit predict`` prints it."""
        return _kalfit.predicted_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Predicted: {self.to_dict()['tests']} tests>"


class Validation(_Record):
    """Predictions of tests by fits that were made without them."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Sum of the log predictive densities.
        self.log_density: float = float(record["log_density"])
        #: Its standard error, by the scatter over tests.
        self.std_error: float | None = record["std_error"]
        #: By how much the model predicts better than the other one; None when there is none.
        self.difference: float | None = record["against"] and record["against"]["difference"]
        #: The standard error of that.
        self.difference_std_error: float | None = record["against"] and record["against"]["std_error"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The validation in words and tables, as ``kalfit validate`` prints it."""
        return _kalfit.validated_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Validation: log density {self.log_density:.6g}>"


class Plan(_Record):
    """Expected standard errors against the number of tests."""

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The plan in words and tables, as ``kalfit plan`` prints it."""
        return _kalfit.plan_summary(self._json, width, color)

    def __repr__(self) -> str:
        return "<kalfit.Plan>"


class Check(_Record):
    """A model and its data, looked at without a fit."""

    def __init__(self, json_text: str, notes: list[str], words: str) -> None:
        super().__init__(json_text, notes)
        self._words = words

    def summary(self, width: int = 80, color: bool = False) -> str:
        """What was found, in words and tables of 80 characters, as ``kalfit check`` prints it."""
        return self._words

    def __repr__(self) -> str:
        return "<kalfit.Check>"


class Simulation:
    """An ensemble that was drawn."""

    def __init__(
        self, data: Table | None, states: Table | None, counts: tuple[int, int], column: str | None, notes: list[str]
    ) -> None:
        #: The data; None when they went to a file.
        self.data = data
        #: The true initial state of each test; None when the data went to a file.
        self.states = states
        #: Number of tests, and of rows.
        self.tests, self.rows = counts
        #: The column that was added to tell tests apart, where the model names none.
        self.added_column = column
        #: What one should know.
        self.notes = notes

    def __repr__(self) -> str:
        return f"<kalfit.Simulation: {self.tests} tests, {self.rows} rows>"
