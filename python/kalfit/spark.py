"""Ensembles too large for one machine: the filters run where the data are, on a Spark cluster, and their reductions are fitted here.

    reductions = kalfit.spark.reduce(model, frame)     # a Spark DataFrame, a row for each test and phase
    fit = kalfit.spark.fit(model, reductions)

Executors need kalfit, pandas and pyarrow. Nothing of Spark is imported before it is needed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from kalfit import _kalfit
from kalfit._data import Table
from kalfit._fit import Fit
from kalfit._jobs import Set, _source
from kalfit._jobs import fit as _fit
from kalfit._model import Model, ModelLike, Path, as_model, assignments

__all__ = ["fit", "reduce"]

#: The columns of reductions with their types in Spark, and what the reductions say of themselves, which Spark would lose.
_COLUMNS: dict[str, str] = {
    "test": "string",
    "phase": "string",
    "states": "array<string>",
    "constant": "double",
    "data": "array<double>",
    "factor": "array<double>",
    "covariates": "array<double>",
    "path": "string",
    "design": "string",
    "steps": "bigint",
    "observations": "bigint",
    "terminal_states": "array<string>",
    "terminal_mean": "array<double>",
    "terminal_sensitivity": "array<double>",
    "terminal_root": "array<double>",
    "inherited_transition": "array<double>",
    "inherited_input": "array<double>",
    "groups": "array<string>",
}
_METADATA = "kalfit"


class GroupReducer:
    """Reduces the rows of one test, or of some, from a pandas table to a pandas table: what runs on the executors."""

    def __init__(
        self, model: Model, set: Sequence[str], at: tuple[str, str, str | None] | None, order: Sequence[str]
    ) -> None:
        self._model = model
        self._set = list(set)
        self._at = at
        self._order = list(order)

    def __call__(self, rows: Any) -> Any:
        rows = rows.sort_values(self._order, kind="stable") if self._order else rows
        model = (self._model._document(), self._set)
        table, *_ = _kalfit.exchange("reductions", model, [("data", rows)], self._at, None, (1, None))
        assert table is not None, "no file was named"
        made = Table(table)
        reductions = made.to_pandas()
        reductions[_METADATA] = json.dumps(made.metadata, sort_keys=True)
        return reductions[[*_COLUMNS, _METADATA]]


def reduce(
    model: ModelLike,
    frame: Any,
    *,
    at: Fit | Path | None = None,
    set: Set = None,
    order_by: str | Sequence[str] | None = None,
) -> Any:
    """Runs the filters over a Spark DataFrame of rows, test by test, and gives a DataFrame of reductions.

    Free parameters take their values from ``at`` or ``set``, as in :func:`kalfit.reduce`. Spark keeps no order of rows: those of
    a test are put in the order of the model's time, or of ``order_by``.
    """
    known = as_model(model)
    if known.test is None:
        raise ValueError("the model names no column that tells tests apart: set `test` in its [data]")
    order = [order_by] if isinstance(order_by, str) else list(order_by or [])
    if not order and known.time is None:
        raise ValueError("the model names no column of time, and Spark keeps no order of rows: name the columns of `order_by`")
    order = order or [str(known.time)]
    for column in (known.test, *order):
        if column not in frame.columns:
            raise _kalfit.DataError(f"the frame has no column {column!r}, it has {', '.join(frame.columns)}")
    reducer = GroupReducer(known, assignments(set), None if at is None else _source(at), order)
    schema = ", ".join(f"{name} {kind}" for name, kind in {**_COLUMNS, _METADATA: "string"}.items())

    def of_group(rows: Any) -> Any:  # Spark counts the arguments of a function, and takes `self` for one
        return reducer(rows)

    return frame.groupBy(known.test).applyInPandas(of_group, schema)


def fit(model: ModelLike, reductions: Any, **options: Any) -> Fit:
    """Collects the reductions that :func:`reduce` made, and fits them; ``options`` are those of :func:`kalfit.fit`."""
    return _fit(model, collected(reductions.toPandas()), **options)


def collected(reductions: Any) -> Table:
    """A pandas table of reductions from many groups as one table of kalfit's, in the order of the tests' ids."""
    kinds = [dict(json.loads(text)) for text in sorted(reductions[_METADATA].unique())]
    if not kinds:
        raise _kalfit.DataError("there are no reductions")
    first: Mapping[str, str] = kinds[0]
    for other in kinds[1:]:
        if other != first:
            key = next(key for key in {**first, **other} if first.get(key) != other.get(key))
            raise _kalfit.DataError(f"the reductions were made at different models or parameters: they differ in {key}")
    ordered = reductions.drop(columns=_METADATA).sort_values(["test", "phase"], kind="stable", ignore_index=True)
    return Table(_kalfit.Table(ordered, sorted(first.items())))
