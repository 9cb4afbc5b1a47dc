"""The data of a formula as a pandas data frame, without the rows that lack a value."""

from __future__ import annotations

import glob
import os
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from kalfit._data import Data
from kalfit._kalfit import DataError

__all__ = ["complete_rows", "frame_of", "plain_column"]

#: What stands for a missing value in files, as in a model file's data.
_MISSING = ["", "NA", "NaN", "null"]


def frame_of(data: Data, texts: set[str]) -> Any:
    """The data as a new data frame, whose index counts rows from 0. Columns ``texts`` of CSV files stay as they are written."""
    import pandas

    if isinstance(data, (str, os.PathLike)):
        pattern = os.fspath(data)
        paths = [pattern] if os.path.exists(pattern) else sorted(glob.glob(pattern, recursive=True))
        if not paths:
            raise DataError(f"cannot read {pattern}: there is no such file")
        return pandas.concat([_read(Path(path), texts) for path in paths], ignore_index=True)
    if isinstance(data, pandas.DataFrame):
        return data.reset_index(drop=True)
    if isinstance(data, Mapping):
        return pandas.DataFrame({str(name): list(column) for name, column in data.items()})
    if hasattr(data, "__arrow_c_stream__"):
        import pyarrow

        return pyarrow.table(data).to_pandas()
    if isinstance(data, (list, tuple)):
        return pandas.concat([frame_of(one, texts) for one in data], ignore_index=True)
    raise TypeError(f"data is of type {type(data).__name__}, expected a table, a dictionary of columns, or the path of a file")


def _read(path: Path, texts: set[str]) -> Any:
    import pandas

    kind = path.suffix.lower()
    if kind == ".parquet":
        return pandas.read_parquet(path)
    if kind in (".arrow", ".ipc", ".feather"):
        return pandas.read_feather(path)
    separator = "\t" if kind == ".tsv" else ","
    frame = pandas.read_csv(path, sep=separator, dtype=str, keep_default_na=False, na_values=_MISSING, skipinitialspace=True)
    for name in frame.columns:
        if name not in texts:
            frame[name] = _numbers(frame[name])
    return frame


def _numbers(column: Any) -> Any:
    """A column of texts as numbers, if all of them are."""
    import pandas

    known = column.dropna()
    if known.str.contains("_").any():  # which Python reads as a number, but no other program
        return column
    try:
        values = [float(text) for text in known]
    except ValueError:
        return column
    whole = len(known) == len(column) and all(text.lstrip("+-").isdigit() for text in known) and all(abs(x) < 2**53 for x in values)
    return pandas.Series(values, index=known.index).reindex(column.index).astype("int64" if whole else "float64")


def complete_rows(frame: Any, used: list[str], formula: str) -> Any:
    """The rows without a missing value in the columns that are used, as R's ``na.omit`` leaves them."""
    for name in used:
        if name not in frame.columns:
            close = [column for column in frame.columns if str(column).lower() == name.lower()]
            names = ", ".join(map(str, frame.columns[:12])) + (", …" if len(frame.columns) > 12 else "")
            hint = f"is `{close[0]}` meant?" if close else f"there are {names}"
            raise DataError(f"formula `{formula}`: data has no column `{name}`\n\nhint: {hint}")
    kept = frame[frame[used].notna().all(axis=1)].copy()
    if not len(kept):
        raise DataError(f"formula `{formula}`: no row has all of {', '.join(f'`{name}`' for name in used)}")
    for name in used:
        kept[name] = plain_column(kept[name])
    return kept


def plain_column(column: Any) -> Any:
    """A column without missing values in the kinds of numpy: libraries have many kinds of the same numbers and texts."""
    import pandas
    from pandas.api import types

    if isinstance(column.dtype, pandas.CategoricalDtype):
        return column.cat.remove_unused_categories()
    if types.is_bool_dtype(column.dtype):
        return column.astype(bool)
    if types.is_integer_dtype(column.dtype):
        return column.astype("int64")
    if types.is_float_dtype(column.dtype) or (len(column) and column.map(lambda value: isinstance(value, Decimal)).all()):
        return column.astype("float64")
    return column.astype(object) if types.is_string_dtype(column.dtype) else column
