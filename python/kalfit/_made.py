"""What a fit was made from, where it was made here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kalfit import _toml
from kalfit._model import Model, ModelLike, as_model

if TYPE_CHECKING:
    from kalfit._fit import Fit

__all__ = ["Made", "changed_model"]

#: Keys of these tables replace those of the model, as a hypothesis' do.
_TABLES = ("mean", "covariance", "parameters", "levels")


@dataclass(frozen=True)
class Made:
    """What a fit was made from."""

    model: Any
    #: What was set of its parameters.
    set: Any
    #: None where the rows are elsewhere.
    data: Any
    #: The other options.
    options: Mapping[str, Any]
    #: The function that made the fit; None where it cannot be asked again.
    again: Callable[..., Fit] | None


def changed_model(model: ModelLike, changes: Mapping[str, Mapping[str, object]]) -> Model:
    """A model with other constraints: keys of ``[mean]``, ``[covariance]``, ``[parameters]`` and ``[levels]`` that replace its own."""
    known = as_model(model)
    tables = _toml.loads(known.text)
    for name, keys in changes.items():
        if name not in _TABLES:
            raise TypeError(f"there is no table {name!r} to change, there are {', '.join(_TABLES)}")
        own = tables.setdefault(name, {})
        if name == "levels":
            for level, table in keys.items():
                covariance = table["covariance"] if isinstance(table, Mapping) and "covariance" in table else table
                if not isinstance(covariance, Mapping):
                    raise TypeError(f"levels[{level!r}] is {table!r}, expected a dictionary such as {{'states': []}}")
                _replace(own.setdefault(level, {}).setdefault("covariance", {}), covariance)
        else:
            _replace(own, keys)
    return Model.from_text(_toml.dumps(tables), known._name)


def _replace(own: dict[str, object], keys: Mapping[str, object]) -> None:
    """Keys replace keys; another structure drops the other keys, but not the order and what varies."""
    if "structure" in keys:
        for key in [key for key in own if key not in ("order", "states", "known")]:
            del own[key]
    own.update(keys)
