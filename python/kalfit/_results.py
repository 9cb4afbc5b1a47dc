"""Results of everything but a fit."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kalfit import _kalfit
from kalfit._data import Table
from kalfit._frames import data_frame

__all__ = [
    "Applied",
    "Check",
    "Comparison",
    "Datasheet",
    "Filter",
    "Plan",
    "Predicted",
    "RatioTest",
    "Simulation",
    "Validation",
]


class _Record:
    """Results that were made, as JSON and in words."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        self._json = json_text
        #: What one should know beside the results, in plain words.
        self.notes = notes

    def to_json(self) -> str:
        """All results as JSON, as the command writes them."""
        return self._json

    def to_dict(self) -> dict[str, Any]:
        """All results as a dictionary, with the keys of the JSON. Each call makes a new one."""
        result: dict[str, Any] = json.loads(self._json)
        return result

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The results in words and tables.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        raise NotImplementedError

    def __str__(self) -> str:
        return self.summary()

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(self.summary())


class RatioTest(_Record):
    """The likelihood-ratio test of a hypothesis within a model. Made by :func:`kalfit.test`; ``print`` shows its summary."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Likelihood ratio -2 log λ: twice the log-likelihood that the hypothesis costs.
        self.statistic: float = float(record["lr"])
        #: Number of free quantities that the hypothesis takes away.
        self.degrees_of_freedom: int = record["df"]
        #: p-value from the large-sample distribution; ``None`` where there is none. That of a bootstrap is in ``to_dict()["bootstrap"]``.
        self.p_value: float | None = record["p_value"]
        #: F test of a hypothesis on means alone, for few tests: a dictionary of ``value``, ``df_num``, ``df_den``, ``scale``,
        #: ``p_value`` and ``method``. ``None`` for any other hypothesis.
        self.f: dict[str, Any] | None = record.get("f")
        #: Whether the fits of model and hypothesis converged.
        self.converged: bool = record["converged"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The test in words and tables, as ``kalfit test`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.ratio_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.RatioTest: statistic {self.statistic:.4g}, p-value {self.p_value}>"


class Applied(_Record):
    """A fitted model that was applied to tests. Made by :func:`kalfit.apply`; ``print`` shows its summary."""

    def __init__(self, json_text: str, notes: list[str], tests: Table | None, states: Table | None) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Log predictive density of all measurements.
        self.log_density: float = float(record["log_density"])
        #: Posterior, distance, log density and innovations of each test, with a row for each phase; ``None`` if they went to a file.
        self.tests = tests
        #: Each state at each step, and the prediction of each measured value; ``None`` if they went to a file or were not asked for.
        self.states = states

    def summary(self, width: int = 80, color: bool = False) -> str:
        """What the model says of all tests, in words and tables, as ``kalfit apply`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.applied_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Applied: {self.to_dict()['tests']} tests, log density {self.log_density:.6g}>"


class Predicted(_Record):
    """Predictions of tests that have not been made. Made by :func:`kalfit.predict`; ``print`` shows its summary."""

    def __init__(self, json_text: str, notes: list[str], table: Table | None) -> None:
        super().__init__(json_text, notes)
        #: Mean, standard deviations and limits of each state and output at every row; ``None`` if they went to a file.
        self.table = table

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The last row of each of the first tests, in words and tables, as ``kalfit predict`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.predicted_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Predicted: {self.to_dict()['tests']} tests>"


class Validation(_Record):
    """The cross-validation of a model: predictions of tests by fits without them. Made by :func:`kalfit.validate`; ``print`` shows
    its summary."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        super().__init__(json_text, notes)
        record = self.to_dict()
        #: Sum of the log predictive densities of the tests; larger is better.
        self.log_density: float = float(record["log_density"])
        #: Standard error of ``log_density``, from the scatter over tests or groups.
        self.std_error: float | None = record["std_error"]
        #: ``log_density`` minus that of the other model; ``None`` if there is none.
        self.difference: float | None = record["against"] and record["against"]["difference"]
        #: Standard error of ``difference``; ``None`` if there is no other model.
        self.difference_std_error: float | None = record["against"] and record["against"]["std_error"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The validation in words and tables, as ``kalfit validate`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.validated_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Validation: log density {self.log_density:.6g}>"


class Filter(_Record):
    """The Kalman filter that follows from a fit. Made by :func:`kalfit.export`; ``print`` shows its summary.

    From step to step ``x = F x + B u + w`` with ``w ~ N(0, Q)``, and at each step ``z = H x + D u + v`` with ``v ~ N(0, R)``. In shapes,
    n is the number of states, m of measurements and k of inputs.
    """

    def __init__(self, json_text: str, notes: list[str]) -> None:
        record: dict[str, Any] = json.loads(json_text)
        super().__init__(json_text, notes + record["notes"])
        #: Length of a step in the model's unit of time; ``None`` if none was given.
        self.step: float | None = record["step"]
        #: Names of the n states x, also of those that are not estimated.
        self.states: list[str] = record["states"]
        #: Unit label of each state; ``None`` where the model has none.
        self.units: list[str | None] = record["units"]
        #: Names of the m measurements z.
        self.measurements: list[str] = record["measurements"]
        #: Column that each measurement is read from.
        self.columns: list[str] = record["columns"]
        #: The k inputs u: expressions in columns, ``"1"`` for what is constant.
        self.inputs: list[str] = record["inputs"]
        n, m, k = len(self.states), len(self.measurements), len(self.inputs)

        def matrix(name: str, rows: int, columns: int) -> NDArray[np.float64]:
            return np.array(record[name], dtype=np.float64).reshape(rows, columns)

        #: Transition of a step, shape (n, n).
        self.F: NDArray[np.float64] = matrix("F", n, n)
        #: Covariance of the process noise w of a step, shape (n, n).
        self.Q: NDArray[np.float64] = matrix("Q", n, n)
        #: Effect of the inputs on the states in a step, shape (n, k).
        self.B: NDArray[np.float64] = matrix("B", n, k)
        #: Effect of the states on the measurements, shape (m, n).
        self.H: NDArray[np.float64] = matrix("H", m, n)
        #: Effect of the inputs on the measurements, shape (m, k).
        self.D: NDArray[np.float64] = matrix("D", m, k)
        #: Covariance of the measurement noise v, shape (m, m).
        self.R: NDArray[np.float64] = matrix("R", m, m)
        started = record["x0"] is not None
        #: Mean of the initial state of a new test, shape (n,); ``None`` for a phase that inherits from the phase before.
        self.x0: NDArray[np.float64] | None = np.array(record["x0"], dtype=np.float64) if started else None
        #: Covariance of that initial state, shape (n, n); ``None`` where ``x0`` is.
        self.P0: NDArray[np.float64] | None = matrix("P0", n, n) if started else None

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The filter in words and tables, as ``kalfit export`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.exported_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Filter: states {self.states}, measurements {self.measurements}, inputs {self.inputs}>"


class Datasheet(_Record):
    """The numbers of a datasheet that follow from a fit. Made by :func:`kalfit.datasheet`; ``print`` shows its summary."""

    def __init__(self, json_text: str, notes: list[str]) -> None:
        record: dict[str, Any] = json.loads(json_text)
        super().__init__(json_text, notes + record["notes"])
        #: A dictionary for each number: ``name``, ``of``, ``value``, ``unit``, ``interval95``, ``definition`` and more.
        self.entries: list[dict[str, Any]] = record["entries"]
        #: Allan deviations, a dictionary for each measurement: ``measurement``, ``unit``, ``step``, ``points`` and more. Each point has
        #: ``time``, ``model``, ``data``, ``interval95`` and more.
        self.allan: list[dict[str, Any]] = record["allan"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The numbers in words and tables, as ``kalfit datasheet`` prints them.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.datasheet_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Datasheet: {len(self.entries)} numbers, {len(self.allan)} Allan deviations>"


class Comparison(_Record):
    """A comparison of fits of the same data. Made by :func:`kalfit.compare`; ``print`` shows its summary."""

    def __init__(self, json_text: str) -> None:
        record: dict[str, Any] = json.loads(json_text)
        super().__init__(json_text, record["notes"])
        #: Whether the log-likelihoods are of the same thing, so that their differences mean something.
        self.comparable: bool = record["comparable"]
        #: A dictionary for each fit: ``log_likelihood``, ``free_parameters``, ``aic``, ``delta_aic``, ``akaike_weight`` and more.
        self.fits: list[dict[str, Any]] = record["fits"]
        #: A dictionary for each fit that is nested in another, with the likelihood-ratio test: ``null`` and ``alternative``
        #: (places in ``fits``), ``lr``, ``df``, ``p_value`` and ``p_value_kind``.
        self.nested: list[dict[str, Any]] = record["nested"]
        #: A dictionary for each element or parameter that is not free, or not fixed at one value, in all fits.
        self.differences: list[dict[str, Any]] = record["differences"]

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The comparison in words and tables, as ``kalfit compare`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.compared_summary(self._json, width, color)

    def __repr__(self) -> str:
        return f"<kalfit.Comparison: {len(self.fits)} fits, {len(self.nested)} tests of one within another>"


class Plan(_Record):
    """Expected standard errors for different numbers of tests, or of the best plan among candidates. Made by
    :func:`kalfit.plan`; ``print`` shows its summary, and :meth:`to_dict` has the numbers."""

    def candidates_frame(self) -> Any:
        """The candidates of a best plan as a pandas data frame: ``name``, ``cost``, ``most``, ``relaxed``, ``tests`` (how many to
        make) and ``sensitivity``; no rows where no candidates were given."""
        numbers = ["cost", "most", "relaxed", "tests", "sensitivity"]
        return data_frame(self.to_dict().get("candidates", []), ["name"], numbers, [])

    def quantities_frame(self) -> Any:
        """Values and expected standard errors as a pandas data frame: ``quantity``, ``phase``, ``level``, ``states`` (joined by a
        comma), ``column``, ``parameter``, ``value``, ``std_error_before``, ``df``, and ``std_error`` for each number of tests,
        named ``std_error[10]``."""
        record = self.to_dict()
        columns = [f"std_error[{count}]" for count in record["tests"]]
        if record.get("arrangements"):
            shapes = [[*(count for _, count in one["groups"]), one["tests"]] for one in record["arrangements"]]
            columns = [f"std_error[{' x '.join(map(str, shape))}]" for shape in shapes]
        rows = [
            {**row, "states": ", ".join(row["states"]), **dict(zip(columns, row["std_error"], strict=True))}
            for row in record["quantities"]
        ]
        texts = ["quantity", "phase", "level", "states", "column", "parameter"]
        return data_frame(rows, texts, ["value", "std_error_before", "df", *columns], [])

    def summary(self, width: int = 80, color: bool = False) -> str:
        """The plan in words and tables, as ``kalfit plan`` prints it.

        ``width`` is the number of characters of a line, and ``color=True`` adds the colours of a terminal.
        """
        return _kalfit.plan_summary(self._json, width, color)

    def __repr__(self) -> str:
        return "<kalfit.Plan>"


class Check(_Record):
    """What was found of a model and its data without a fit. Made by :func:`kalfit.check`; ``print`` shows its summary."""

    def __init__(self, json_text: str, notes: list[str], words: str) -> None:
        super().__init__(json_text, notes)
        self._words = words

    def summary(self, width: int = 80, color: bool = False) -> str:
        """What was found, in words and tables, as ``kalfit check`` prints it. Lines have 80 characters, without colours, whatever
        ``width`` and ``color`` say."""
        return self._words

    def __repr__(self) -> str:
        return "<kalfit.Check>"


class Simulation:
    """An ensemble of tests that was drawn. Made by :func:`kalfit.simulate`."""

    def __init__(
        self, data: Table | None, states: Table | None, counts: tuple[int, int], column: str | None, notes: list[str]
    ) -> None:
        #: The data, as the model reads them; ``None`` if they went to a file.
        self.data = data
        #: The true initial states, with a row for each test and a column for each state; ``None`` if the data went to a file.
        self.states = states
        #: Number of tests.
        self.tests: int = counts[0]
        #: Number of rows.
        self.rows: int = counts[1]
        #: The column that was added to name the tests, where the model has none; else ``None``.
        self.added_column = column
        #: What one should know beside the results, in plain words.
        self.notes = notes

    def __repr__(self) -> str:
        return f"<kalfit.Simulation: {self.tests} tests, {self.rows} rows>"
