"""Data as they are given: tables in memory, files, or both."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any, Protocol, Union, runtime_checkable

from kalfit._kalfit import Table as _Table

__all__ = ["Data", "Table", "TableLike", "as_data"]


@runtime_checkable
class TableLike(Protocol):
    """Any table with the Arrow PyCapsule interface: of polars, pandas 2.2 or newer, pyarrow, DuckDB, kalfit itself."""

    def __arrow_c_stream__(self, requested_schema: Any = None, /) -> Any:
        """A capsule with an Arrow C stream."""


_One = Union[TableLike, str, "os.PathLike[str]"]
Data = Union[_One, Sequence[_One]]


def as_data(data: Data | None, name: str = "data") -> list[str | tuple[str, Any]]:
    """Each datum for the compiled part: the name of a file or a pattern, or what messages call a table, and the table."""
    if data is None:
        return []
    if isinstance(data, (str, os.PathLike)) or hasattr(data, "__arrow_c_stream__"):
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
    raise TypeError(
        f"{name} is of type {type(datum).__name__}, expected a path or a table of polars, pandas (2.2 or newer) or pyarrow"
    )


class Table:
    """A table that kalfit made, for any library that knows Arrow.

    ``polars.DataFrame(table)``, ``pyarrow.table(table)`` and DuckDB take it as it is, and so does any function of kalfit that
    takes data.
    """

    __slots__ = ("_table",)

    def __init__(self, table: _Table) -> None:
        self._table = table

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """A capsule with an Arrow C stream of the table."""
        return self._table.__arrow_c_stream__(requested_schema)

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self._table.column_names()

    @property
    def metadata(self) -> dict[str, str]:
        """What the table says of itself."""
        return dict(self._table.metadata())

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        rows = "1 row" if len(self) == 1 else f"{len(self)} rows"
        return f"<kalfit.Table: {rows} of {', '.join(self.columns)}>"

    def to_pyarrow(self) -> Any:
        """The table as a ``pyarrow.Table``."""
        import pyarrow

        return pyarrow.table(self)

    def to_polars(self) -> Any:
        """The table as a ``polars.DataFrame``."""
        import polars

        return polars.DataFrame(self)

    def to_pandas(self) -> Any:
        """The table as a ``pandas.DataFrame``; this takes pyarrow too."""
        return self.to_pyarrow().to_pandas()
