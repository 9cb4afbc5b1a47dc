"""A model given as a dictionary, written as the text of a model file."""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["dumps", "loads", "quoted"]

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def dumps(model: Mapping[str, object]) -> str:
    """The text of a model file. What order the dictionary has, the text has.

    >>> print(dumps({"data": {"test": "unit"}, "states": {"bias": {}}}))
    [data]
    test = "unit"
    <BLANKLINE>
    [states]
    bias = {}
    <BLANKLINE>
    """
    tables = {key: value for key, value in model.items() if isinstance(value, Mapping)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in model.items() if key not in tables]
    for key, table in tables.items():
        if key == "phases":
            for name, phase in table.items():
                lines += _phase(str(name), phase)
        else:
            lines += _table((key,), table)
    return "\n".join(lines) + "\n"


def loads(text: str) -> dict[str, Any]:
    """The tables of a model file."""
    for name in ("tomllib", "tomli"):  # the first is part of Python 3.11 and newer
        try:
            tables: dict[str, Any] = importlib.import_module(name).loads(text)
        except ImportError:
            continue
        return tables
    raise ImportError("to read a model file in Python 3.10 takes the package tomli: pip install tomli")


def _phase(name: str, phase: object) -> list[str]:
    if not isinstance(phase, Mapping):
        raise TypeError(f"phase {name!r} is of type {type(phase).__name__}, expected a dictionary")
    parts = {key: value for key, value in phase.items() if isinstance(value, Mapping)}
    lines = _table(("phases", name), {key: value for key, value in phase.items() if key not in parts})
    for key, part in parts.items():
        lines += _table(("phases", name, str(key)), part)
    return lines


def _table(path: tuple[str, ...], table: Mapping[object, object]) -> list[str]:
    lines = ["", f"[{'.'.join(map(_key, path))}]"] if path else []
    return lines + [f"{_key(key)} = {_value(value)}" for key, value in table.items()]


def _key(key: object) -> str:
    if not isinstance(key, str):
        raise TypeError(f"the key {key!r} is of type {type(key).__name__}, expected a text")
    return key if _BARE.fullmatch(key) else quoted(key)


def quoted(text: str) -> str:
    """A text in quotes."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: object) -> str:
    tolist = getattr(value, "tolist", None)
    if callable(tolist):  # numbers and arrays of numpy
        value = tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    raise TypeError(f"found a value of type {type(value).__name__}, expected texts, numbers, lists or dictionaries")
