"""What a file is that was expected to be a fit."""

from __future__ import annotations

import json
import re

__all__ = ["found_instead"]

#: Beginnings of files in other forms.
_FORMS = {b"PAR1": "a Parquet file", b"ARROW1": "an Arrow file", b"PK\x03\x04": "a zip file", b"\x1f\x8b": "a gzip file"}


def found_instead(content: bytes) -> str | None:
    """What a file is that is no fit, in words; None of what may be one.

    >>> found_instead(b'{"schema": "kalfit-plan/1", "tests": [5]}')
    'a result of `kalfit plan` (schema `kalfit-plan/1`)'
    >>> found_instead(b'{"mean": 1, "sd": 2}')
    'JSON with the keys `mean`, `sd`'
    >>> found_instead(b"[states]\\nbias = {}\\n")
    'a model file, by its table `[states]`'
    """
    for beginning, form in _FORMS.items():
        if content.startswith(beginning):
            return form
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return f"no text, but {len(content)} bytes in another form"
    if not text.strip():
        return "an empty file"
    try:
        record = json.loads(text)
    except ValueError as error:
        return _no_json(text, error)
    if not isinstance(record, dict):
        kind = {list: "a list", str: "a text", int: "a number", float: "a number"}.get(type(record), "a single value")
        return f"JSON that is {kind}, not the object of a result"
    schema = str(record.get("schema", ""))
    if schema.startswith("kalfit-fit/"):
        return None
    match = re.fullmatch(r"kalfit-([a-z]+)/\d+", schema)
    if match:
        return f"a result of `kalfit {match[1]}` (schema `{schema}`)"
    keys = [f"`{key}`" for key in list(record)[:8]]
    return f"JSON with the keys {', '.join(keys)}{', …' if len(record) > 8 else ''}" if keys else "JSON without any key"


def _no_json(text: str, error: ValueError) -> str:
    for table in re.findall(r"^\[([^\[\]\n]+)\]", text, re.MULTILINE):
        if table.split(".")[0] in ("data", "states", "measurements", "parameters", "mean", "covariance", "phases", "levels"):
            return f"a model file, by its table `[{table}]`"
    if text.lstrip().startswith("<"):
        return "a page of HTML or XML"
    if text.lstrip().startswith("{"):
        return f"JSON that breaks off or is damaged ({error})"
    first = text.strip().splitlines()[0][:60]
    return f"no JSON; its first line is `{first}`"
