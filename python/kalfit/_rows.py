"""What was measured at each row of the data, and what a fit says of it."""

from __future__ import annotations

import csv
import glob
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kalfit._data import Table, table_columns
from kalfit._numbers import Array

__all__ = ["Measured", "data_columns", "measured_rows"]


@dataclass(frozen=True)
class Measured:
    """Measured values and the estimates beside them, a place for each row of the data; NaN where a row has none."""

    measurement: str
    tests: list[str]
    phases: list[str]
    observed: Array
    fitted: Array


def measured_rows(tables: Mapping[str, Any], data: Any, states: Table, measurement: str | None) -> Measured:
    """Puts the estimates of a table of states beside the rows that they belong to.

    ``tables`` are those of the model file, ``states`` what :func:`kalfit.apply` made with ``states=``.
    """
    along = table_columns(states, ["test", "phase", "row", "name", "value", "what"])
    named = [name for name, what in zip(along["name"], along["what"], strict=True) if what == "measurement"]
    known = list(dict.fromkeys(named))
    if measurement is None and len(known) > 1:
        raise ValueError(f"the model has measurements {', '.join(map(repr, known))}: say which, as in measurement={known[0]!r}")
    if measurement is not None and measurement not in known:
        raise ValueError(f"there is no measurement {measurement!r}, there are {', '.join(map(repr, known)) or 'none'}")
    name = measurement if measurement is not None else known[0]
    about = tables.get("data", {})
    ids = [*about.get("levels", []), *([about["test"]] if "test" in about else [])]
    if about.get("test") == "@file":
        raise ValueError("each file is a test, so that rows are not told apart: see apply(…, states='smoothed') for values by test and row")
    columns = _columns_of(tables, name)
    asked = [*ids, *columns.values(), *(about[key] for key in ("phase", "time") if key in about)]
    found = data_columns(data, list(dict.fromkeys(asked)), about.get("comment"))
    count = len(next(iter(found.values())))
    tests = ["/".join(_id(part) for part in parts) for parts in zip(*(found[name] for name in ids), strict=True)] if ids else [""] * count
    phases = [str(phase) for phase in found[about["phase"]]] if "phase" in about else ["main"] * count
    places: dict[tuple[str, str], list[int]] = {}
    for at, key in enumerate(zip(tests, phases, strict=True)):
        places.setdefault(key, []).append(at)
    times = found[about["time"]] if "time" in about else None
    observed, fitted = np.full(count, np.nan), np.full(count, np.nan)
    rows = zip(along["test"], along["phase"], along["row"], along["name"], along["value"], along["what"], strict=True)
    for test, phase, row, own, value, what in rows:
        if what != "measurement" or own != name:
            continue
        steps = places.get((test if ids else "", phase))
        if steps is None or row > len(steps):
            raise ValueError(f"row {row} of test {test!r} is not in the data; give those that the fit was made from: data=…")
        at, number = _measured_at(found[columns[phase]], steps, row - 1, times)
        observed[at], fitted[at] = number, value
    return Measured(name, tests, phases, observed, fitted)


def _columns_of(tables: Mapping[str, Any], name: str) -> dict[str, str]:
    """The column of a measurement, by phase."""
    phases = tables.get("phases", {"main": {}})
    found = {}
    for phase, own in phases.items():
        measurements = own.get("measurements", tables.get("measurements", {}))
        if name in measurements:
            if "where" in measurements[name]:
                raise ValueError(
                    f"measurement {name!r} is read from rows where {measurements[name]['where']}: "
                    "see apply(…, states='smoothed') for values by test and row"
                )
            found[phase] = str(measurements[name]["column"])
    return found


def _measured_at(column: list[Any], steps: list[int], row: int, times: list[Any] | None) -> tuple[int, float]:
    """The row of a step that has a value, and the value: rows of the same time are one step."""
    for later in range(row, len(steps)):
        if later > row and (times is None or times[steps[later]] != times[steps[row]]):
            break
        try:
            number = float(column[steps[later]])
        except (TypeError, ValueError):
            continue
        if not math.isnan(number):
            return steps[later], number
    raise ValueError("the data have no value where the fit has an estimate; give those that the fit was made from: data=…")


def _id(value: Any) -> str:
    """The name of a test as kalfit writes it."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def data_columns(data: Any, names: list[str], comment: str | None = None) -> dict[str, list[Any]]:
    """Columns of data: of all tables and files, one after the other."""
    if isinstance(data, (str, os.PathLike)):
        pattern = os.fspath(data)
        paths = [pattern] if os.path.exists(pattern) else sorted(glob.glob(pattern, recursive=True))
        parts = [_file_columns(path, names, comment) for path in paths]
    elif isinstance(data, Mapping) or hasattr(data, "__arrow_c_stream__"):
        return table_columns(data, names)
    elif isinstance(data, Iterable):
        parts = [data_columns(one, names, comment) for one in data]
    else:
        raise TypeError(f"data is of type {type(data).__name__}, expected a table, a dictionary of columns or a path")
    return {name: [value for part in parts for value in part[name]] for name in names}


def _file_columns(path: str, names: list[str], comment: str | None) -> dict[str, list[Any]]:
    kind = os.path.splitext(path)[1].lower()
    if kind in (".parquet", ".arrow", ".ipc", ".feather"):
        import pyarrow.feather
        import pyarrow.parquet

        read = pyarrow.parquet.read_table if kind == ".parquet" else pyarrow.feather.read_table
        return table_columns(read(path, columns=names), names)
    with open(path, encoding="utf-8-sig", newline="") as file:
        lines = (line for line in file if line.strip() and not (comment and line.startswith(comment)))
        reader = csv.reader(lines, delimiter="\t" if kind == ".tsv" else ",", skipinitialspace=True)
        header = [name.strip() for name in next(reader)]
        places = [header.index(name) for name in names]
        rows = [[row[at].strip() for at in places] for row in reader]
    return {name: [row[at] for row in rows] for at, name in enumerate(names)}
