"""Rows of results as tables and as data frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from kalfit import _kalfit
from kalfit._data import Table

__all__ = ["data_frame", "table_of_columns"]


def table_of_columns(texts: dict[str, list[str]], numbers: dict[str, list[Any]]) -> Table:
    """A table of texts and numbers; numbers that are None become NaN."""
    values = [(name, np.array(column, dtype=np.float64).tobytes()) for name, column in numbers.items()]
    return Table(_kalfit.Table.columns(list(texts.items()), values))


def data_frame(rows: list[dict[str, Any]], texts: list[str], numbers: list[str], last: list[str]) -> Any:
    """Rows as a data frame; numbers that are not known are missing in it, and columns have their kind where there are no rows, too."""
    import pandas

    def column(name: str) -> list[Any]:
        return [row.get(name) for row in rows]

    kinds = [(name, "object") for name in texts] + [(name, "float64") for name in numbers] + [(name, "object") for name in last]
    return pandas.DataFrame({name: pandas.Series(column(name), dtype=kind) for name, kind in kinds})
