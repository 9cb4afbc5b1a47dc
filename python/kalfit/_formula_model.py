"""Models from formulas in lme4's words: random terms become states, grouping factors levels, crossed factors and tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from kalfit._data import Data
from kalfit._formula_columns import formulaic
from kalfit._formula_maker import Maker
from kalfit._formula_text import parse
from kalfit._formula_words import model_file
from kalfit._model import Model, Path
from kalfit._warnings import FormulaWarning, warn

__all__ = ["FormulaModel", "model_from_formula"]


class FormulaModel:
    """A formula as a model of kalfit, with the data that the model takes. Made by :func:`kalfit.model_from_formula`.

    ``print`` shows the text of the model file.
    """

    def __init__(self, maker: Maker) -> None:
        #: The formula, as it was given.
        self.formula: str = maker.text.text
        #: The model that the formula stands for.
        self.model: Model = Model.from_text(model_file(maker.parts), f"formula `{maker.text.text}`")
        #: The rows without missing values as a ``pandas.DataFrame``, with the columns that were made for the model.
        self.data: Any = maker.frame.reset_index(drop=True)
        #: The place of each of these rows in the data that were given, from 0, shape (rows,).
        self.rows: np.ndarray[Any, np.dtype[np.intp]] = maker.frame.index.to_numpy(dtype=np.intp)
        #: Number of rows that were given.
        self.rows_given: int = maker.rows_given
        #: What each state is in the formula: ``{"kind_b": "kind[T.b]"}``.
        self.terms: dict[str, str] = dict(maker.terms)
        #: Names of the states with an estimated mean: the fixed effects.
        self.fixed: list[str] = [state for state in maker.terms if state not in maker.parts.zero_means]
        nesting = maker.parts.nesting
        #: The grouping factor of each level, the outermost first, that of ``tests``, unless each row is one, and those that cross:
        #: ``{"tests": "Subject"}``.
        self.groups: dict[str, str] = {g.column: g.name for g in nesting.levels}
        if nesting.tests is not None:
            self.groups["tests"] = nesting.tests.name
        self.groups |= {g.column: g.name for g in nesting.crossed}
        #: Columns that were made for the model, and the term of the formula that each is.
        self.made: dict[str, str] = dict(maker.made)
        #: Which rows and fixed effects were left out, in plain words.
        self.notes: list[str] = list(maker.notes)
        self._maker = maker

    def prepare(self, data: Data) -> Any:
        """Other ``data`` as a ``pandas.DataFrame`` with the columns that were made for the model, so that a fit can be applied to them.

        Levels of factors, means, knots and bases are those of the data of the formula. No row is left out.
        """
        return self._maker.again(data)

    def again(self, formula: str | None = None, data: Data | None = None) -> FormulaModel:
        """Makes the model of another ``formula``, or of other ``data``, with the same weights, variances and context."""
        options = self._maker.options
        return model_from_formula(formula or self.formula, self._maker.data if data is None else data, **options)

    def save(self, folder: Path) -> None:
        """Writes ``model.toml`` into ``folder``, which is made if it is missing, and ``data.csv`` if :attr:`takes_other_data`."""
        place = FilePath(folder)
        place.mkdir(parents=True, exist_ok=True)
        (place / "model.toml").write_text(str(self), encoding="utf-8")
        if self.takes_other_data:
            self.data.to_csv(place / "data.csv", index=False)

    @property
    def takes_other_data(self) -> bool:
        """Whether the model takes other data than were given: columns were made, or rows were left out."""
        return bool(self.made) or len(self.rows) < self.rows_given

    def __str__(self) -> str:
        return self.model.text

    def __repr__(self) -> str:
        return f"<kalfit.FormulaModel {self.formula!r}: {len(self.data)} rows, states {', '.join(self.terms)}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        printer.text(str(self))


def model_from_formula(
    formula: str,
    data: Data,
    *,
    weights: str | None = None,
    variances: str | None = None,
    context: Mapping[str, Any] | None = None,
) -> FormulaModel:
    """Makes the model of a formula of lme4. This needs ``pip install 'kalfit[formula]'``.

    - ``formula``: such as ``"y ~ x * kind + (1 + x | unit / run)"``. Fixed effects are read by the package formulaic: factors with
      treatment contrasts as in R, interactions, ``log(x)``, ``I(x^2)``, ``poly(x, 2)``, ``bs(x, df=4)``, ``scale(x)``,
      ``center(x)``, and functions of ``context``. Random terms may be correlated, ``(1 + x | g)``, or not, ``(1 + x || g)``; groups
      may be nested, ``a / b`` or ``a:b``, or cross, ``(1 | a) + (1 | b)``. ``offset(o)`` adds a column as it is.
    - ``data``: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``weights``: name of a column w, by which the noise has the variance ``sigma^2 / w``.
    - ``variances``: name of a column with the known variance of the noise of each row, as in a meta-analysis; then no ``sigma`` is
      estimated.
    - ``context``: functions and values by the names that the formula has for them: ``{"half": lambda x: x / 2}``.

    Returns a :class:`kalfit.FormulaModel`. Rows with missing values are left out, as R's ``na.omit`` does, and fixed effects whose
    columns depend on others; a :class:`kalfit.FormulaWarning` says which. Raises :class:`kalfit.ModelError` for a formula that cannot
    be read, :class:`kalfit.DataError` for wrong data, and ``ImportError`` without formulaic and pandas.

    >>> import kalfit
    >>> data = "examples/random-coefficients/sleepstudy.csv"
    >>> made = kalfit.model_from_formula("Reaction ~ Days + (Days | Subject)", data)
    >>> print(made.model.describe().splitlines()[0])
    tests: one for each value of column `Subject`
    >>> made.terms, made.groups
    ({'Intercept': 'Intercept', 'Days': 'Days'}, {'tests': 'Subject'})
    """
    formulaic()
    made = FormulaModel(Maker(parse(formula), data, weights, variances, dict(context or {})))
    for note in made.notes:
        warn(note, FormulaWarning)
    return made
