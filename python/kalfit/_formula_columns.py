"""The columns of model matrices, as the package formulaic makes them, and the expressions of a model file for them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kalfit._formula_text import FormulaText
from kalfit._kalfit import DataError, ModelError
from kalfit._numbers import Array

__all__ = ["Matrix", "expression_of", "formulaic", "identifier", "variables"]

_RESERVED = {"sigma", "pi", "dt", "sqrt", "exp", "log", "sin", "cos", "tan", "abs", "min", "max", "if", "and", "or", "not"}
#: R's functions beside those that formulaic knows.
_FUNCTIONS: dict[str, Any] = {
    "sqrt": np.sqrt, "abs": np.abs, "sin": np.sin, "cos": np.cos, "tan": np.tan, "log1p": np.log1p, "expm1": np.expm1, "numpy": np,
}  # fmt: skip
_LEVEL = re.compile(r"(?:C\(\s*(?P<wrapped>`?[^,()`]+`?)\s*(?:,.*)?\)|(?P<plain>[^()\[\]]+))\[(?:T\.)?(?P<level>.*)\]", re.DOTALL)
_POWER = re.compile(r"(?:I\()?\(?(?P<name>[\w.]+)\)? ?\*\* ?(?P<power>\d+)\)?")
_FUNCTION = re.compile(r"(?:np\.|numpy\.)?(?P<function>log|exp|sqrt|center|scale)\((?P<name>[\w.]+)\)")


def formulaic() -> Any:
    """The package formulaic, or how to install it."""
    try:
        import formulaic as package
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ImportError(
            f"formulas need the packages formulaic, pandas and pyarrow ({error.name} is missing): pip install 'kalfit[formula]'"
        ) from error
    return package


def variables(text: str, formula: FormulaText) -> set[str]:
    """Names of the columns that a part of a formula uses."""
    return {str(name) for name in _parsed(text, formula).required_variables} - {*_FUNCTIONS}


def _parsed(text: str, formula: FormulaText) -> Any:
    package = formulaic()
    if re.search(r"(?<![\w.\])`])\.(?![\w.])", text):
        raise ModelError(f"formula `{formula.text}`: `.` stands for all other columns\n\nhint: name the columns")
    try:
        return package.Formula(text)
    except package.errors.FormulaicError as error:
        raise _not_understood(formula, text, error) from error


def _not_understood(formula: FormulaText, text: str, error: Exception) -> ModelError:
    words = " ".join(re.sub(r"\x1b\[[0-9;]*m|[⧛⧚]", "", str(error)).split())
    return ModelError(f"formula `{formula.text}`: formulaic does not understand `{text}`: {words}\n\nhint: its grammar is that of R")


class Matrix:
    """A model matrix: the columns that a part of a formula stands for."""

    def __init__(self, text: str, formula: FormulaText, frame: Any, context: Mapping[str, Any]) -> None:
        package = formulaic()
        self._text, self._formula = text, formula
        try:
            made = _parsed(text, formula).get_model_matrix(frame, context={**_FUNCTIONS, **context}, na_action="ignore")
        except package.errors.FormulaicError as error:
            raise _not_understood(formula, text, error) from error
        self._spec, self._context = made.model_spec, context
        self.columns = _columns(made)

    def again(self, frame: Any) -> dict[str, Array]:
        """The same columns of other data, with the levels, means and knots of the first."""
        package = formulaic()
        try:
            return _columns(self._spec.get_model_matrix(frame, context={**_FUNCTIONS, **self._context}, na_action="ignore"))
        except package.errors.FormulaicError as error:
            raise _not_understood(self._formula, self._text, error) from error

    def terms(self) -> list[str]:
        """The terms of this part of the formula; ``1`` is the intercept."""
        return [str(term) for term in self._spec.term_indices]


def _columns(made: Any) -> dict[str, Array]:
    return {str(name): np.asarray(made[name], dtype=np.float64) for name in made.columns}


def identifier(label: str, taken: set[str]) -> str:
    """A name for a column in the expressions of a model file: letters, digits and ``_``.

    >>> identifier("x:C(kind)[T.new oil]", set()), identifier("I(x ** 2)", set()), identifier("sigma", set())
    ('x_kind_new_oil', 'x_2', 'sigma_2')
    >>> identifier("C(kind, Treatment('old'))[T.new]", {"x"})
    'kind_new'
    """
    text = re.sub(r"\bC\(\s*([^,()]+),[^\[\]]*\)\[", r"(\1)[", label)
    text = re.sub(r"\b(?:C|I)\(", "(", text)
    text = re.sub(r"\[T\.", "[", text).replace("np.", "")
    name = re.sub(r"\W+", "_", text).strip("_") or "x"
    name = f"x{name}" if name[0].isdigit() else name
    number, found = 1, name
    while found in taken or found in _RESERVED:
        number += 1
        found = f"{name}_{number}"
    return found


def expression_of(label: str, values: Array, frame: Any) -> str | None:
    """An expression in columns of the data that has these values; None where a column must be made."""
    if (values == 1.0).all():
        return "1"
    if label in frame.columns and "`" not in label and _is(_numeric(frame, label), values):
        return _ticks(label)
    texts, product = [], np.ones(len(values))
    for factor in _factors(label):
        found = _factor(factor, frame)
        if found is None:
            return None
        texts.append(found[0])
        product = product * found[1]
    return " * ".join(texts) if _is(product, values) else None


def _is(found: Array | None, values: Array) -> bool:
    return found is not None and bool(np.allclose(found, values, rtol=1e-12, atol=1e-12 * np.abs(values).max(initial=0.0)))


def _factors(label: str) -> list[str]:
    """The factors of a product: between colons that stand in no brackets."""
    parts, depth = [""], 0
    for letter in label:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == ":" and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _factor(label: str, frame: Any) -> tuple[str, Array] | None:
    """An expression for one factor of a product, with its values."""
    if label in frame.columns and "`" not in label:
        values = _numeric(frame, label)
        return None if values is None else (_ticks(label), values)
    for pattern, make in ((_LEVEL, _of_level), (_POWER, _of_power), (_FUNCTION, _of_function)):
        match = pattern.fullmatch(label)
        if match is not None:
            return make(match, frame)
    return None


def _of_level(match: re.Match[str], frame: Any) -> tuple[str, Array] | None:
    column = (match["wrapped"] or match["plain"]).strip("`")
    if column not in frame.columns or "`" in column:
        return None
    numbers = _numeric(frame, column)
    if numbers is not None:
        try:
            level = float(match["level"])
        except ValueError:
            return None
        return f"if({_ticks(column)} == {_number(level)}, 1, 0)", (numbers == level).astype(np.float64)
    if frame[column].map(type).isin([str]).all():
        text = match["level"].replace("'", "''")
        return f"if({_ticks(column)} == '{text}', 1, 0)", (frame[column] == match["level"]).to_numpy(dtype=np.float64)
    return None


def _of_power(match: re.Match[str], frame: Any) -> tuple[str, Array] | None:
    values = _numeric(frame, match["name"])
    return None if values is None else (f"{_ticks(match['name'])}^{match['power']}", values ** int(match["power"]))


def _of_function(match: re.Match[str], frame: Any) -> tuple[str, Array] | None:
    name, function = match["name"], match["function"]
    values = _numeric(frame, name)
    if values is None:
        return None
    if function in ("center", "scale"):
        mean, spread = float(values.mean()), float(values.std(ddof=1))
        shifted = f"({_ticks(name)} - {_number(mean)})" if mean >= 0 else f"({_ticks(name)} + {_number(-mean)})"
        return (shifted, values - mean) if function == "center" else (f"{shifted} / {_number(spread)}", (values - mean) / spread)
    make: Callable[[Array], Array] = {"log": np.log, "exp": np.exp, "sqrt": np.sqrt}[function]
    return f"{function}({_ticks(name)})", make(values)


def _numeric(frame: Any, name: str) -> Array | None:
    """A column of numbers; None of any other, and of conditions, which files do not have."""
    if name not in frame.columns or frame[name].dtype.kind not in "iuf":
        return None
    values: Array = frame[name].to_numpy(dtype=np.float64)
    if not np.isfinite(values).all():
        raise DataError(f"data, column `{name}`: found an infinite value, expected numbers")
    return values


def _number(value: float) -> str:
    return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _ticks(name: str) -> str:
    return f"`{name}`"
