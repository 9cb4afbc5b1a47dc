"""The text of a formula in lme4's words, taken apart: response, fixed part, random terms, offsets."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from kalfit._kalfit import ModelError

__all__ = ["Factor", "FormulaText", "RandomTerm", "parse"]

#: A grouping factor: the columns whose combinations are its groups.
Factor = tuple[str, ...]

_OPEN, _CLOSED = "([{", ")]}"
_FACTOR = re.compile(r"(?:factor|C)\(\s*(.+?)\s*\)")
#: Words of other packages that stand before a random term.
_STRUCTURES = re.compile(r"(?:us|diag|cs|ar1|ou|exp|gau|mat|toep|rr|homdiag|mm|s|te|t2)\s*\(.*\|", re.DOTALL)


@dataclass(frozen=True)
class RandomTerm:
    """A random term: ``(1 + x | unit)``."""

    text: str
    #: What varies: ``1 + x``.
    design: str
    #: What it varies with, from the left: ``a / b`` is ``a`` and then ``a:b``.
    factors: tuple[Factor, ...]
    #: Whether its coefficients are correlated: ``|``, not ``||``.
    correlated: bool


@dataclass(frozen=True)
class FormulaText:
    """A formula, taken apart."""

    text: str
    response: str
    #: What has the same coefficient in all groups.
    fixed: str
    random: tuple[RandomTerm, ...]
    offsets: tuple[str, ...]


def parse(formula: str) -> FormulaText:
    """Takes a formula apart.

    >>> parts = parse("y ~ x + offset(o) + (1 + x | unit / run)")
    >>> parts.response, parts.fixed, parts.offsets
    ('y', 'x', ('o',))
    >>> parts.random[0].design, parts.random[0].factors
    ('1 + x', (('unit',), ('unit', 'run')))
    """
    if not isinstance(formula, str):
        raise TypeError(f"the formula is of type {type(formula).__name__}, expected a text such as 'y ~ x + (1 | unit)'")
    text = " ".join(formula.split())
    sides = _split(text, "~")
    if len(sides) != 2 or not sides[0].strip():
        raise _wrong(text, "expected a response, one `~` and terms", "y ~ x + (1 | unit)")
    response = sides[0].strip()
    if response.startswith("cbind(") or len(_split(response, "+")) > 1:
        raise _wrong(text, f"`{response}` has several responses, expected one", "write a model file, which takes several measurements")
    fixed: list[str] = []
    random: list[RandomTerm] = []
    offsets: list[str] = []
    for sign, term in _summands(sides[1], text):
        inside = _inside(term)
        if inside is not None and len(_split(inside, "|")) > 1:
            if sign == "-":
                raise _wrong(text, f"the random term `{term}` is subtracted", "leave it out")
            random.append(_random(inside, text))
        elif term.startswith("offset(") and term.endswith(")") and _inside(term[len("offset") :]) is not None:
            if sign == "-":
                raise _wrong(text, f"`{term}` is subtracted", "write offset(-x)")
            offsets.append(term[len("offset(") : -1].strip())
        elif _STRUCTURES.match(term):
            raise _wrong(text, f"`{term}` has a covariance structure of another package", "expected (… | g) or (… || g)")
        elif "|" in _outside_quotes(term):
            raise _wrong(text, f"`{term}` has a bar that is not in its own parentheses", "y ~ x + (1 + x | unit)")
        else:
            fixed.append(f"{sign} {term}" if fixed or sign == "-" else term)
    return FormulaText(text, _python(response), _python(" ".join(fixed)) or "1", tuple(random), tuple(map(_python, offsets)))


def _random(inside: str, whole: str) -> RandomTerm:
    parts = _split(inside, "|")
    correlated = len(parts) == 2
    if not correlated and not (len(parts) == 3 and parts[1] == ""):
        raise _wrong(whole, f"`({inside})` has {len(parts) - 1} bars, expected `|` or `||`", "(1 + x | unit)")
    design, group = parts[0].strip(), parts[-1].strip()
    if not design:
        raise _wrong(whole, f"nothing stands before the bar of `({inside})`", "(1 | unit) for an intercept, (0 + x | unit) for a slope")
    return RandomTerm(f"({inside.strip()})", _python(design), _factors(group, f"({inside})", whole), correlated)


def _factors(group: str, term: str, whole: str) -> tuple[Factor, ...]:
    """The grouping factors of a random term: ``a``, ``a / b``, ``a:b``."""
    for operator in "*+-":
        if len(_split(group, operator)) > 1:
            hint = "(1 | a / b) for b within a, (1 | a:b) for their combinations, (1 | a) + (1 | b) for groups that cross"
            raise _wrong(whole, f"the group of `{term}` has `{operator}`", hint)
    found: list[Factor] = []
    for part in _split(group, "/"):
        columns = tuple(_column(name.strip(), term, whole) for name in _split(part, ":"))
        found.append((*(found[-1] if found else ()), *columns))
    return tuple(found)


def _column(name: str, term: str, whole: str) -> str:
    factor = _FACTOR.fullmatch(name)
    name = factor.group(1) if factor else name
    if len(name) > 2 and name[0] == name[-1] == "`":
        return name[1:-1]
    if re.fullmatch(r"[^\W\d][\w.]*", name) is None:
        found = f"`{name}`" if name else "nothing"
        raise _wrong(whole, f"{found} stands behind the bar of `{term}`, expected a column that names groups", "(1 | unit)")
    return name


def _wrong(formula: str, what: str, hint: str) -> ModelError:
    return ModelError(f"formula `{formula}`: {what}\n\nhint: {hint}")


def _scan(text: str) -> Iterator[tuple[int, str, int]]:
    """Every letter that is in no quotes, with its place and how many brackets are open around it."""
    depth, quote = 0, ""
    for at, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"`":
            quote = letter
        else:
            depth -= letter in _CLOSED
            yield at, letter, depth
            depth += letter in _OPEN


def _split(text: str, separator: str) -> list[str]:
    """The parts between separators that stand in no brackets and no quotes."""
    parts, begun = [], 0
    for at, letter, depth in _scan(text):
        if letter == separator and depth == 0:
            parts.append(text[begun:at])
            begun = at + 1
    return [*parts, text[begun:]]


def _outside_quotes(text: str) -> str:
    return "".join(letter for _, letter, _ in _scan(text))


def _inside(term: str) -> str | None:
    """What stands within the parentheses that hold a whole term."""
    if not (term.startswith("(") and term.endswith(")")):
        return None
    closed = [at for at, letter, depth in _scan(term) if letter == ")" and depth == 0]
    return term[1:-1] if closed[:1] == [len(term) - 1] else None


def _summands(text: str, whole: str) -> list[tuple[str, str]]:
    """The terms of a sum, each with its sign."""
    depths = [0, *(depth for _, letter, depth in _scan(text) if letter in _CLOSED)]
    opened = sum(letter in _OPEN for _, letter, _ in _scan(text))
    if min(depths) < 0 or opened != len(depths) - 1:
        raise _wrong(whole, "its parentheses do not match", "y ~ x + (1 | unit)")
    terms, sign, begun = [], "+", 0
    signs = [(at, letter) for at, letter, depth in _scan(text) if letter in "+-" and depth == 0]
    for at, letter in [*signs, (len(text), "")]:
        term = text[begun:at].strip()
        if term:
            terms.append((sign, term))
        elif (begun, at) != (0, at) or not letter:
            raise _wrong(whole, "a term is missing beside `+`, `-` or `~`", "y ~ x + (1 | unit)")
        sign, begun = letter, at + 1
    return terms


def _python(text: str) -> str:
    """What R writes otherwise: ``x^2`` and ``factor(x)``."""
    places = {at for at, letter, _ in _scan(text) if letter == "^"}
    text = "".join("**" if at in places else letter for at, letter in enumerate(text))
    return re.sub(r"(?<![\w.])(?:as\.)?factor\(", "C(", text)
