"""Data as they are given: tables in memory, files, or both."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, Union, runtime_checkable

import numpy as np

from kalfit._kalfit import Table as _Table

__all__ = ["Data", "Table", "TableLike", "as_data", "table_columns"]


@runtime_checkable
class TableLike(Protocol):
    """Any table with the Arrow PyCapsule interface: of polars, pandas 2.2 or newer, pyarrow, DuckDB, or kalfit itself.

    Such tables are read without a copy. ``isinstance(table, kalfit.TableLike)`` tells them.
    """

    def __arrow_c_stream__(self, requested_schema: Any = None, /) -> Any:
        """A capsule with an Arrow C stream."""


#: A table, a path or a pattern of paths, or a dictionary of columns.
_One = Union[TableLike, str, "os.PathLike[str]", Mapping[str, Any]]
#: Tests: a table (see :class:`kalfit.TableLike`); the path of a CSV, TSV, Parquet or Arrow file; a pattern of paths, such as
#: ``"runs/*.csv"``; a dictionary of columns, each a list or an array; or a list of any of these, which are one ensemble together.
Data = Union[_One, Sequence[_One]]
#: Whole numbers beyond this are not all numbers of the compiled part.
_EXACT = 2**53


def as_data(data: Data | None, name: str = "data") -> list[str | tuple[str, Any]]:
    """Each datum for the compiled part: the name of a file or a pattern, or what messages call a table, and the table."""
    if data is None:
        return []
    if isinstance(data, (str, os.PathLike, Mapping)) or hasattr(data, "__arrow_c_stream__"):
        return [_one(data, name)]
    if isinstance(data, Iterable):
        return [_one(datum, f"{name}[{index}]") for index, datum in enumerate(data)]
    return [_one(data, name)]


def _one(datum: Any, name: str) -> str | tuple[str, Any]:
    if isinstance(datum, (str, os.PathLike)):
        path = os.fspath(datum)
        if path == "-":
            raise ValueError(f"{name} is '-': standard input is read by the command only")
        return path
    if hasattr(datum, "__arrow_c_stream__"):
        return (name, datum)
    if isinstance(datum, Mapping):
        return (name, _table_of_dictionary(datum, name))
    raise TypeError(
        f"{name} is of type {type(datum).__name__}, expected a path or a table of polars, pandas (2.2 or newer) or pyarrow, "
        "or a dictionary of columns"
    )


def _table_of_dictionary(columns: Mapping[str, Any], name: str) -> _Table:
    """A dictionary of columns, each of numbers or of texts, as a table."""
    texts: list[tuple[str, list[str]]] = []
    numbers: list[tuple[str, bytes]] = []
    rows: dict[str, int] = {}
    for column, given in columns.items():
        if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
            raise TypeError(f"{name}, column {column!r} is of type {type(given).__name__}, expected a list or an array")
        values = list(given.tolist() if isinstance(given, np.ndarray) else given)
        rows[str(column)] = len(values)
        known = [value for value in values if value is not None and not (isinstance(value, float) and math.isnan(value))]
        if any(isinstance(value, int) and abs(value) > _EXACT for value in known):  # names, such as serial numbers
            known = values = ["" if value is None else str(value) for value in values]
        if all(isinstance(value, str) for value in known) and known:
            texts.append((str(column), [value if isinstance(value, str) else "" for value in values]))
        elif all(isinstance(value, (int, float, np.integer, np.floating)) for value in known):
            missing = [float("nan") if value is None else float(value) for value in values]
            numbers.append((str(column), np.array(missing, dtype=np.float64).tobytes()))
        else:
            kinds = ", ".join(sorted({type(value).__name__ for value in known}))
            raise TypeError(f"{name}, column {column!r} has values of type {kinds}, expected all texts or all numbers")
    if len({*rows.values()}) > 1:
        lengths = ", ".join(f"{column!r} {count}" for column, count in rows.items())
        raise ValueError(f"{name} has columns of different lengths: {lengths}")
    return _Table.columns(texts, numbers)


class Table:
    """A table that kalfit made, for any library that knows Arrow.

    ``polars.DataFrame(table)``, ``pyarrow.table(table)`` and DuckDB take it as it is, and so does any function of kalfit that
    takes data. ``len(table)`` is the number of rows. Unknown numbers are null or NaN.
    """

    __slots__ = ("_table",)

    def __init__(self, table: _Table) -> None:
        self._table = table

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """A capsule with an Arrow C stream of the table."""
        return self._table.__arrow_c_stream__(requested_schema)

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in their order."""
        return self._table.column_names()

    @property
    def metadata(self) -> dict[str, str]:
        """What the table says of itself: the Arrow metadata of its schema. Empty except for reductions and estimates."""
        return dict(self._table.metadata())

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        rows = "1 row" if len(self) == 1 else f"{len(self)} rows"
        return f"<kalfit.Table: {rows} of {', '.join(self.columns)}>"

    def to_pyarrow(self) -> Any:
        """The table as a ``pyarrow.Table``; this needs pyarrow."""
        import pyarrow

        return pyarrow.table(self)

    def to_polars(self) -> Any:
        """The table as a ``polars.DataFrame``; this needs polars."""
        import polars

        return polars.DataFrame(self)

    def to_pandas(self) -> Any:
        """The table as a ``pandas.DataFrame``; this needs pandas and pyarrow."""
        return self.to_pyarrow().to_pandas()


def table_columns(table: Any, names: Sequence[str]) -> dict[str, list[Any]]:
    """Columns of a table or of a dictionary as lists; a table that is known by its Arrow stream only takes pyarrow or polars."""
    if isinstance(table, Mapping):
        return {name: list(table[name]) for name in names}
    if isinstance(table, Table) or not hasattr(table, "columns") or not hasattr(table, "__getitem__"):
        table = _known_table(table)
    found = {}
    for name in names:
        column = table[name]
        as_list = next(getattr(column, word) for word in ("to_pylist", "to_list", "tolist") if hasattr(column, word))
        found[name] = list(as_list())
    return found


def _known_table(table: TableLike) -> Any:
    """A table of pyarrow, or of polars where there is no pyarrow."""
    try:
        import pyarrow
    except ImportError:
        import polars

        return polars.DataFrame(table)
    return pyarrow.table(table)
