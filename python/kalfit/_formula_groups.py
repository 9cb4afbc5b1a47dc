"""The grouping factors of a formula become levels of groups and tests: outer ones around inner ones, as the data nest them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kalfit._formula_text import Factor, FormulaText
from kalfit._kalfit import DataError, ModelError

__all__ = ["Grouping", "group_labels", "nest"]


@dataclass(frozen=True)
class Grouping:
    """One grouping factor: a level of the model, or its tests."""

    factor: Factor
    #: The column that tells its groups apart within the groups around them; it is made where no column of the data does.
    column: str
    #: Number of its groups.
    groups: int

    @property
    def name(self) -> str:
        """Its name in lme4."""
        return ":".join(self.factor)


def group_labels(frame: Any, factor: Factor) -> list[str]:
    """The text that names the group of each row."""
    columns = [frame[name].map(_text).tolist() for name in factor]
    parts = list(zip(*columns, strict=True))
    for separator in (":", "/", " | "):
        labels = [separator.join(texts) for texts in parts]
        if len(set(labels)) == len(set(parts)):
            return labels
    raise DataError(f"the columns {', '.join(factor)} have texts with `:`, `/` and `|`, by which groups cannot be told apart")


def _text(value: Any) -> str:
    """A name of a group as text: whole numbers without a decimal point."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


def nest(formula: FormulaText, frame: Any) -> list[Grouping]:
    """The grouping factors of a formula, the outermost first."""
    factors: list[Factor] = []
    for term in formula.random:
        for factor in term.factors:
            if not any(set(factor) == set(other) for other in factors):
                factors.append(factor)
    labels = {factor: _numbered(group_labels(frame, factor)) for factor in factors}
    counts = {factor: len(set(numbers)) for factor, numbers in labels.items()}
    for at, one in enumerate(factors):
        if counts[one] < 2:
            raise ModelError(
                f"formula `{formula.text}`: `{':'.join(one)}` has {counts[one]} group in the data, expected two or more\n\n"
                "hint: a spread over groups cannot be estimated from one of them; leave its term out"
            )
        for other in factors[at + 1 :]:
            _check_nested(formula, frame, one, other)
    # a factor within another has at least as many groups; of two that name the same groups the first of the formula stands outside
    ordered = sorted(factors, key=lambda factor: counts[factor])
    found: list[Grouping] = []
    around: set[str] = set()
    for factor in ordered:
        own = [column for column in factor if column not in around]
        column = own[0] if len(own) == 1 else ":".join(factor)
        found.append(Grouping(factor, column, counts[factor]))
        around |= {*factor}
    return found


def _numbered(labels: list[str]) -> list[int]:
    """The same labels as numbers, in order of appearance."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(label, len(numbers)) for label in labels]


def _check_nested(formula: FormulaText, frame: Any, one: Factor, other: Factor) -> None:
    """Refuses two factors of which neither stands within the other, and shows groups that cross."""
    ones, others = group_labels(frame, one), group_labels(frame, other)
    within, around = _several(ones, others), _several(others, ones)
    if within is None or around is None:
        return
    a, b = ":".join(one), ":".join(other)
    (group, found), (other_group, other_found) = within, around
    raise ModelError(
        f"formula `{formula.text}`: `{a}` and `{b}` cross: `{a}` {group!r} is found with `{b}` {found[0]!r} and {found[1]!r}, "
        f"and `{b}` {other_group!r} with `{a}` {other_found[0]!r} and {other_found[1]!r}; crossed effects are not possible yet\n\n"
        f"hint: if a `{b}` belongs to one `{a}` and its name is used again in others, write (… | {a} / {b})"
    )


def _several(labels: list[str], others: list[str]) -> tuple[str, tuple[str, str]] | None:
    """A label that stands beside two different others, with both; None where each stands beside one."""
    first: dict[str, str] = {}
    for label, other in zip(labels, others, strict=True):
        if first.setdefault(label, other) != other:
            return label, (first[label], other)
    return None
