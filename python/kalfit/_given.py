"""What functions are given becomes what the compiled part takes: models and results of a fit become texts, paths the names of files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Union

from kalfit import _kalfit, _toml
from kalfit._data import Table
from kalfit._fit_record import FitRecord
from kalfit._model import ModelLike, Path, as_model, assignments

__all__ = ["Set", "Text", "file_name", "model_text", "outputs_text", "source_text", "table_of", "text_beside"]

#: Values at which parameters are fixed: a dictionary, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level; or a list of
#: texts, as in ``["tau=90"]``. ``None`` fixes none.
Set = Union[Mapping[str, float], Sequence[str], None]
#: What messages call a text, the text, and the file that it is from.
Text = tuple[str, str, Union[str, None]]


def file_name(path: Path | None) -> str | None:
    """The name of a file, where one is to be written."""
    return None if path is None else os.fspath(path)


def table_of(made: _kalfit.Table | None) -> Table | None:
    """The table that the compiled part made, unless it wrote a file."""
    return None if made is None else Table(made)


def model_text(model: ModelLike, set: Set) -> tuple[Text, list[str]]:
    """The text of a model, and what is set of its parameters."""
    return (as_model(model)._document(), assignments(set))


def text_beside(document: Path | Mapping[str, object], name: str) -> Text:
    """A file that is read with a model, or a dictionary of its tables."""
    if isinstance(document, Mapping):
        return (name, _toml.dumps(document), None)
    path = os.fspath(document)
    with open(path, encoding="utf-8") as file:
        return (path, file.read(), path)


def outputs_text(outputs: Path | Mapping[str, object]) -> Text:
    """A file of outputs, or equations by name."""
    if not isinstance(outputs, Mapping):
        return text_beside(outputs, "the outputs")
    tables = {name: {"equation": one} if isinstance(one, str) else one for name, one in outputs.items()}
    return text_beside({"outputs": tables}, "the outputs")


def source_text(source: FitRecord | ModelLike) -> Text:
    """Results of a fit, or a model: as themselves, or in a file."""
    if isinstance(source, FitRecord):
        return ("the fit", source.to_json(), None)
    if isinstance(source, (str, os.PathLike)):
        path = os.fspath(source)
        if not path.lower().endswith(".toml"):
            with open(path, encoding="utf-8") as file:
                return (path, file.read(), path)
    return as_model(source)._document()
