"""The numbers of a record become arrays; those that are unknown are masked."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "MaskedArray", "array", "ends", "masked_array", "number", "square"]

#: An array of numpy, of numbers that are all known.
Array = NDArray[np.float64]
#: A masked array of numpy, of numbers of which some may be unknown: those are masked, print as ``--`` and become ``None`` in
#: ``tolist()``, and NaN in ``filled()``.
MaskedArray: TypeAlias = np.ma.MaskedArray[Any, np.dtype[np.float64]]


def number(value: Any) -> float | None:
    """One number, which may be unknown."""
    return None if value is None else float(value)


def array(values: Any) -> Array:
    """Numbers that are all known."""
    return np.array(values, dtype=np.float64)


def masked_array(values: Any) -> MaskedArray:
    """Numbers of which some may be unknown."""
    numbers = np.array(values, dtype=np.float64)  # None becomes NaN, for the mask to cover
    unknown = np.isnan(numbers)
    return np.ma.array(np.where(unknown, 0.0, numbers), mask=unknown, fill_value=np.nan)


def square(values: Any, p: int) -> Array:
    """A matrix of shape (p, p), whose numbers are all known."""
    return array(values).reshape(p, p)


def ends(record: dict[str, Any], shape: tuple[int, ...]) -> MaskedArray:
    """Both ends of each interval of a vector or a matrix."""

    def pair(one: Any) -> list[Any]:
        return [None, None] if one is None else list(one)

    values = record.get("interval95") or []
    if len(shape) == 1:
        pairs = [pair(one) for one in values]
    else:
        pairs = [pair(one) for row in values for one in row]
    missing = [[None, None]] * (int(np.prod(shape)) - len(pairs))  # older records have none
    return masked_array(pairs + missing).reshape(*shape, 2)
