"""Models."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Union

from kalfit import _kalfit, _toml

__all__ = ["Model", "ModelLike", "as_model", "assignments"]

#: The path of a file: a text, or a ``pathlib.Path``.
Path = Union[str, "os.PathLike[str]"]


class Model:
    """A model: what a model file says, read and checked.

    ``model`` is a dictionary of the tables of a model file; :meth:`load` reads a file, and :meth:`from_text` its text. Two models
    are equal if their texts are.

    Raises :class:`kalfit.ModelError` if something is wrong with the model; the message shows the place in the text.

    >>> import kalfit
    >>> model = kalfit.Model({
    ...     "data": {"test": "unit"},
    ...     "states": {"bias": {"unit": "deg/h"}, "scale": {}},
    ...     "measurements": {"rate": {"column": "rate", "equation": "bias + scale * u", "noise": 0.1}},
    ... })
    >>> model
    <kalfit.Model 'model'>
    >>> kalfit.Model({"states": {"bias": {}}})
    Traceback (most recent call last):
    ...
    kalfit.ModelError: `[measurements]` is missing...
    """

    __slots__ = ("_file", "_name", "_text", "_words", "digest", "levels", "parameters", "test", "time", "title")

    #: The title; an empty text if there is none.
    title: str
    #: The digest of the text: ``sha256:`` and 64 hexadecimal digits. Results of fits carry it along.
    digest: str
    #: Names of the dynamic parameters.
    parameters: list[str]
    #: The columns that name the groups of a test, the outermost first.
    levels: list[str]
    #: The column that names the test; ``None`` if the model names none.
    test: str | None
    #: The column of time; ``None`` if the model names none.
    time: str | None

    def __init__(self, model: Mapping[str, object]) -> None:
        self._set("model", _toml.dumps(model), None)

    @classmethod
    def load(cls, path: Path) -> Model:
        """Reads the model file ``path``. Raises :class:`kalfit.ModelError` if it cannot be read or is wrong.

        >>> import kalfit
        >>> kalfit.Model.load("examples/gyro-bench/bench.toml")
        <kalfit.Model 'Gyros on two bench stations'>
        """
        return cls._of(os.fspath(path), _kalfit.read_model(path), os.fspath(path))

    @classmethod
    def from_text(cls, text: str, name: str = "model") -> Model:
        """Reads ``text``, the text of a model file; messages call it ``name``. Raises :class:`kalfit.ModelError` if it is wrong."""
        return cls._of(name, text, None)

    @classmethod
    def _of(cls, name: str, text: str, file: str | None) -> Model:
        model = cls.__new__(cls)
        model._set(name, text, file)
        return model

    def _set(self, name: str, text: str, file: str | None) -> None:
        self._name, self._text, self._file = name, text, file
        told = _kalfit.describe(self._document())
        self.title, self.digest, self._words, self.parameters, self.test, self.time, self.levels = told

    def _document(self) -> tuple[str, str, str | None]:
        return (self._name, self._text, self._file)

    @property
    def text(self) -> str:
        """The text of the model file."""
        return self._text

    def describe(self) -> str:
        """The model in words and equations, one fact a line."""
        return "\n".join(self._words)

    def __repr__(self) -> str:
        return f"<kalfit.Model {self.title or self._name!r}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self._text == other._text

    def __hash__(self) -> int:
        return hash(self._text)

    def __reduce__(self) -> tuple[object, ...]:
        return (Model._of, self._document())


#: A model: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
ModelLike = Union[Model, Path, Mapping[str, object]]


def as_model(model: ModelLike) -> Model:
    """The model that is meant: itself, a file, or a dictionary."""
    if isinstance(model, Model):
        return model
    if isinstance(model, Mapping):
        return Model(model)
    if isinstance(model, (str, os.PathLike)):
        return Model.load(model)
    raise TypeError(f"the model is of type {type(model).__name__}, expected a kalfit.Model, a path or a dictionary")


def assignments(values: Mapping[str, float] | Sequence[str] | None) -> list[str]:
    """Values of parameters, as the command has them: ``{"tau": 90, "sigma[A]": 0.7}``."""
    if values is None:
        return []
    if isinstance(values, Mapping):
        return [f"{name}={float(value)!r}" for name, value in values.items()]
    if isinstance(values, str):
        raise TypeError("set is a text, expected a dictionary such as {'tau': 90}")
    return [str(assignment) for assignment in values]
