"""What is worth a warning of Python."""

from __future__ import annotations

import sys
import warnings

__all__ = ["ConvergenceWarning", "FormulaWarning", "warn"]


class ConvergenceWarning(UserWarning):
    """A fit did not converge: its estimates are the best that were found, but no certified maximum."""


class FormulaWarning(UserWarning):
    """A formula was not taken as it is written: rows with missing values, or columns that depend on others, were left out."""


for _kind in (ConvergenceWarning, FormulaWarning):
    _kind.__module__ = "kalfit"


def warn(message: str, kind: type[Warning]) -> None:
    """Warns at the line that called this package."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back is not None and str(frame.f_globals.get("__name__", "")).split(".")[0] == "kalfit":
        level, frame = level + 1, frame.f_back
    warnings.warn(message, kind, stacklevel=level)
