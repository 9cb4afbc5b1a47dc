"""A matrix whose rows and columns have names."""

from __future__ import annotations

from typing import Any

import numpy as np

from kalfit._numbers import Array

__all__ = ["Labelled"]


class Labelled:
    """A square matrix whose rows and columns have names. Made by :meth:`Fit.vcov`.

    ``matrix["a", "b"]`` is one element, ``numpy.asarray(matrix)`` all of them, ``len(matrix)`` the number p of rows. A name that does
    not exist raises ``KeyError``.
    """

    def __init__(self, names: list[str], values: Array) -> None:
        #: Names of rows and columns, p of them.
        self.names = names
        #: The matrix, shape (p, p).
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """The matrix without names."""
        return np.array(self.values, dtype=dtype)

    def __getitem__(self, key: tuple[str, str]) -> float:
        """The element of two names."""
        row, column = key
        for name in key:
            if name not in self.names:
                raise KeyError(f"there is no {name!r}, there are {', '.join(self.names)}")
        return float(self.values[self.names.index(row), self.names.index(column)])

    def __len__(self) -> int:
        return len(self.names)

    def to_pandas(self) -> Any:
        """The matrix as a ``pandas.DataFrame``; this needs pandas."""
        import pandas

        return pandas.DataFrame(self.values, index=self.names, columns=self.names)

    def __repr__(self) -> str:
        cells = [["", *self.names]] + [
            [name, *(f"{value:.6g}" for value in row)] for name, row in zip(self.names, self.values, strict=True)
        ]
        widths = [max(len(row[at]) for row in cells) for at in range(len(cells[0]))]
        lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
        return "\n".join(line.rstrip() for line in lines)
