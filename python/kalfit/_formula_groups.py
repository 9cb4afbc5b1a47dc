"""The grouping factors of a formula become levels of groups and tests, outer ones around inner ones, and crossed factors, as the data are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kalfit._formula_text import Factor, FormulaText
from kalfit._kalfit import DataError, ModelError

__all__ = ["Grouping", "Nesting", "group_labels", "nest"]


@dataclass(frozen=True)
class Grouping:
    """One grouping factor: a level of the model, its tests, or a crossed factor."""

    factor: Factor
    #: The column that tells its groups apart within the groups around them; it is made where no column of the data does.
    column: str
    #: Number of its groups.
    groups: int

    @property
    def name(self) -> str:
        """Its name in lme4."""
        return ":".join(self.factor)


@dataclass(frozen=True)
class Nesting:
    """How the grouping factors of a formula stand to each other."""

    #: Factors around each other, the outermost first, without that of the tests.
    levels: list[Grouping]
    #: The factor whose groups are the tests; None where each row is a test.
    tests: Grouping | None
    #: Factors that cross others.
    crossed: list[Grouping]

    @property
    def all(self) -> list[Grouping]:
        """All factors."""
        return [*self.levels, *([] if self.tests is None else [self.tests]), *self.crossed]


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


def nest(formula: FormulaText, frame: Any) -> Nesting:
    """The grouping factors of a formula as the data nest or cross them."""
    factors: list[Factor] = []
    for term in formula.random:
        for factor in term.factors:
            if not any(set(factor) == set(other) for other in factors):
                factors.append(factor)
    labels = {factor: _numbered(group_labels(frame, factor)) for factor in factors}
    counts = {factor: len(set(numbers)) for factor, numbers in labels.items()}
    for one in factors:
        if counts[one] < 2:
            raise ModelError(
                f"formula `{formula.text}`: `{':'.join(one)}` has {counts[one]} group in the data, expected two or more\n\n"
                "hint: a spread over groups cannot be estimated from one of them; leave its term out"
            )

    def is_within(one: Factor, other: Factor) -> bool:
        return _each_meets_one(labels[one], labels[other])

    # a factor within another has at least as many groups; of two that name the same groups the first of the formula stands outside
    ordered = sorted(factors, key=lambda factor: counts[factor])
    chain: list[Factor] = []
    for factor in reversed(ordered):  # from the finest on
        if all(is_within(inner, factor) for inner in chain):
            chain.insert(0, factor)
    crossing = [factor for factor in factors if factor not in chain]
    found: list[Grouping] = []
    around: set[str] = set()
    for factor in chain:
        own = [column for column in factor if column not in around]
        column = own[0] if len(own) == 1 else ":".join(factor)
        found.append(Grouping(factor, column, counts[factor]))
        around |= {*factor}
    crossed = [Grouping(factor, ":".join(factor), counts[factor]) for factor in crossing]
    # what a test meets is the same in all of its rows
    if all(is_within(chain[-1], factor) for factor in crossing):
        return Nesting(found[:-1], found[-1], crossed)
    return Nesting(found, None, crossed)


def _numbered(labels: list[str]) -> list[int]:
    """The same labels as numbers, in order of appearance."""
    numbers: dict[str, int] = {}
    return [numbers.setdefault(label, len(numbers)) for label in labels]


def _each_meets_one(labels: list[int], others: list[int]) -> bool:
    """Whether each group of the first factor is in one group of the other."""
    first: dict[int, int] = {}
    return all(first.setdefault(label, other) == other for label, other in zip(labels, others, strict=True))
