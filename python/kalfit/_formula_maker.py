"""Makes the parts of a model file from a formula and data: states, levels, noise, and columns that the data do not have."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from kalfit._data import Data
from kalfit._formula_columns import Matrix, expression_of, identifier, variables
from kalfit._formula_data import complete_rows, frame_of, plain_column
from kalfit._formula_groups import Grouping, Nesting, group_labels, nest
from kalfit._formula_text import FormulaText
from kalfit._formula_words import Parts
from kalfit._kalfit import DataError, ModelError
from kalfit._numbers import Array

__all__ = ["Maker"]


class Maker:
    """Makes the parts of a model file from a formula and data."""

    def __init__(self, text: FormulaText, data: Data, weights: str | None, variances: str | None, context: dict[str, Any]) -> None:
        self.text, self.context = text, context
        #: What was given.
        self.data = data
        self.options: dict[str, Any] = {"weights": weights, "variances": variances, "context": context}
        self.notes: list[str] = []
        #: What each state stands for, columns that were made with their labels, and the matrices that they come from.
        self.terms: dict[str, str] = {}
        self.made: dict[str, str] = {}
        self._matrices: list[Matrix] = []
        self._joined: dict[str, tuple[str, ...]] = {}
        if not text.random:
            raise ModelError(
                f"formula `{text.text}` has no random term, expected one such as (1 | unit)\n\n"
                "hint: without random effects this is a regression, of which kalfit's estimates are no others than those of least squares"
            )
        if weights is not None and variances is not None:
            raise ModelError("weights and variances are given: known variances have no scale that weights could share")
        grouping = {column for term in text.random for factor in term.factors for column in factor}
        self._texts = grouping
        given = frame_of(data, grouping)
        self.rows_given = len(given)
        self.frame = complete_rows(given, self._used(grouping, weights, variances, given), text.text)
        fixed = self._matrix(text.fixed)
        random = self._random_matrices()
        response, measured = self._response()
        offsets = [(label, self._matrix(f"0 + {label}")) for label in text.offsets]
        self._drop_unknown([measured, *[c for m in self._matrices for c in m.columns.values()]])
        nesting = nest(text, self.frame)
        if nesting.tests is not None:
            self._check_residual(nesting.tests, variances)
        self.columns: list[tuple[str, Array]] = []
        states = self._fixed_states(self._full_rank(fixed.columns))
        zero_means: list[str] = []
        blocks = self._blocks(nesting, random, states, zero_means)
        for grouping_ in nesting.all:
            self._join(grouping_)
        noise, sigma = self._noise(weights, variances)
        self.parts = Parts(
            formula=text.text,
            response=response,
            measurement=identifier(text.response, set()),
            nesting=nesting,
            states=states,
            words=self._words(states, zero_means, blocks),
            zero_means=zero_means,
            blocks=blocks,
            offsets=[self._expression(*self._offset(label, matrix)) for label, matrix in offsets],
            noise=noise,
            sigma=sigma,
        )

    def _used(self, grouping: set[str], weights: str | None, variances: str | None, given: Any) -> list[str]:
        used = {name for name in (weights, variances) if name is not None} | grouping
        texts = [self.text.response, self.text.fixed, *self.text.offsets, *(term.design for term in self.text.random)]
        for text in texts:
            for name in variables(text, self.text) - ({*self.context} - {*given.columns}):
                if name not in given.columns and re.search(rf"(?<![\w.]){re.escape(name)}\s*\(", text):
                    raise ModelError(
                        f"formula `{self.text.text}`: there is no function `{name}`\n\nhint: there are log, exp, sqrt, I, C, poly, bs, cr, cc, "
                        f"scale, center and those of numpy as np; others are given by context={{'{name}': …}}"
                    )
                used.add(name)
        return sorted(used)

    def _matrix(self, text: str) -> Matrix:
        made = Matrix(text, self.text, self.frame, self.context)
        self._matrices.append(made)
        return made

    def _random_matrices(self) -> list[tuple[str, frozenset[str], dict[str, Array]]]:
        """Each block of correlated coefficients: its term, its factor, its columns."""
        found = []
        for term in self.text.random:
            matrix = self._matrix(term.design)
            if term.correlated:
                blocks = [matrix.columns]
            else:  # as in lme4 the columns of one factor stay correlated
                blocks = [self._matrix(part if part == "1" else f"0 + {part}").columns for part in matrix.terms()]
            if not all(blocks) or not blocks:
                raise ModelError(f"formula `{self.text.text}`: nothing varies in `{term.text}`\n\nhint: (1 | unit) is an intercept")
            for factor in term.factors:
                found += [(term.text, frozenset(factor), block) for block in blocks]
        return found

    def _response(self) -> tuple[str, Array]:
        """The column that is measured: of the data, or made."""
        text = self.text.response
        matrix = Matrix(f"0 + {text}", self.text, self.frame, self.context)
        if len(matrix.columns) != 1:
            names = ", ".join(f"`{name}`" for name in list(matrix.columns)[:4])
            raise ModelError(
                f"formula `{self.text.text}`: the response `{text}` is no column of numbers, but becomes {names}\n\n"
                "hint: the noise is normal; for counts and classes see lme4's glmer"
            )
        (label, values), *_ = matrix.columns.items()
        plain = text.strip("`")
        if plain in self.frame.columns and self.frame[plain].dtype.kind in "iuf":
            return plain, values
        self._matrices.append(matrix)
        self._make(label, values)
        return label, values

    def _drop_unknown(self, columns: list[Array]) -> None:
        """Leaves out rows in which a transform gave no number."""
        unknown = ~np.isfinite(np.column_stack(columns)).all(axis=1)
        if unknown.all():
            raise DataError(f"formula `{self.text.text}`: no row has a number in all columns that the formula makes")
        if unknown.any():
            self.frame = self.frame[~unknown]
            for matrix in self._matrices:
                matrix.columns.update({name: values[~unknown] for name, values in matrix.columns.items()})
        missing = self.rows_given - len(self.frame)
        if missing:
            self.notes.append(
                f"{missing} of {self.rows_given} rows are left out, as they lack a value that formula `{self.text.text}` takes"
            )

    def _check_residual(self, tests: Grouping, variances: str | None) -> None:
        if variances is None and tests.groups >= len(self.frame):
            raise ModelError(
                f"formula `{self.text.text}`: `{tests.name}` has {tests.groups} groups in {len(self.frame)} rows, expected fewer: what "
                "varies between them cannot be told from the residual\n\n"
                "hint: where the variances of the residuals are known, name their column: variances='v'"
            )

    def _full_rank(self, columns: dict[str, Array]) -> dict[str, Array]:
        """The columns that do not depend on those before them, as R leaves them."""
        kept: dict[str, Array] = {}
        basis = np.empty((len(self.frame), 0))
        dropped = []
        for label, values in columns.items():
            rest = values - basis @ (basis.T @ values)
            rest = rest - basis @ (basis.T @ rest)
            size = float(np.linalg.norm(values))
            if float(np.linalg.norm(rest)) <= 1e-7 * size or size == 0.0:
                dropped.append(label)
                continue
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            kept[label] = values
        if dropped:
            self.notes.append(
                f"the fixed effects {', '.join(f'`{label}`' for label in dropped)} are left out, as their columns depend on the others"
            )
        return kept

    def _fixed_states(self, columns: dict[str, Array]) -> dict[str, str]:
        """A state for each fixed effect, with the expression that it is multiplied with."""
        states: dict[str, str] = {}
        for label, values in columns.items():
            self._add(states, label, values)
        return states

    def _add(self, states: dict[str, str], label: str, values: Array) -> str:
        name = identifier(label, {*states})
        states[name] = self._expression(label, values)
        self.terms[name] = label
        self.columns.append((name, values))
        return name

    def _blocks(
        self,
        nesting: Nesting,
        random: list[tuple[str, frozenset[str], dict[str, Array]]],
        states: dict[str, str],
        zero_means: list[str],
    ) -> dict[str, list[list[str]]]:
        """The states of each block of correlated coefficients, by the name of the grouping factor."""
        found: dict[str, list[list[str]]] = {grouping.name: [] for grouping in nesting.all}
        for term, factor, columns in random:
            name = next(grouping.name for grouping in nesting.all if frozenset(grouping.factor) == factor)
            block: list[str] = []
            for label, values in columns.items():
                if not values.any():
                    raise ModelError(f"formula `{self.text.text}`: `{label}` of `{term}` is zero in all rows\n\nhint: leave it out")
                state = next((state for state, own in self.columns if np.array_equal(own, values)), None)
                if state is None:
                    state = self._add(states, label, values)
                    zero_means.append(state)
                if any(state in own for own in [*found[name], block]):
                    raise ModelError(
                        f"formula `{self.text.text}`: `{label}` varies twice with `{name}`, expected once\n\n"
                        "hint: (1 | g) + (0 + x | g) are an intercept and a slope that are not correlated"
                    )
                block.append(state)
            found[name].append(block)
        return found

    def _expression(self, label: str, values: Array) -> str:
        """An expression with these values: of columns of the data, or a column that is made."""
        found = expression_of(label, values, self.frame)
        return found if found is not None else f"`{self._make(label, values)}`"

    def _make(self, label: str, values: Array) -> str:
        name = label.replace("`", "")
        known = self.frame.columns
        if name not in self.made or self.made[name] != label:
            while name in known:
                name += "'"
            self.frame = self.frame.assign(**{name: values})
            self.made[name] = label
        return name

    def _offset(self, label: str, matrix: Matrix) -> tuple[str, Array]:
        if len(matrix.columns) != 1:
            raise ModelError(f"formula `{self.text.text}`: offset({label}) is no column of numbers")
        return next(iter(matrix.columns.items()))

    def _join(self, grouping: Grouping) -> None:
        """Makes the column of a factor whose groups are combinations."""
        if grouping.column not in grouping.factor:
            self.frame = self.frame.assign(**{grouping.column: group_labels(self.frame, grouping.factor)})
            self.made[grouping.column] = grouping.name
            self._joined[grouping.column] = grouping.factor

    def _noise(self, weights: str | None, variances: str | None) -> tuple[str, bool]:
        name = weights if weights is not None else variances
        if name is None:
            return 'noise = "sigma"', True
        word = "weights" if weights is not None else "variances"
        if self.frame[name].dtype.kind not in "iuf" or not np.isfinite(self.frame[name]).all() or not (self.frame[name] > 0).all():
            raise DataError(f"{word} is `{name}`, expected a column of positive numbers")
        if weights is not None:
            return f'variance = "sigma^2 / `{name}`"', True
        return f'variance = "`{name}`"', False

    def _words(self, states: dict[str, str], zero_means: list[str], blocks: dict[str, list[list[str]]]) -> dict[str, str]:
        words = {}
        for state in states:
            varies = [name for name, own in blocks.items() if any(state in block for block in own)]
            parts = [] if state in zero_means else ["fixed"]
            parts += [f"varies with {' and '.join(varies)}"] if varies else []
            words[state] = f"{self.terms[state]}: {', '.join(parts)}".replace("\n", " ")
        return words

    def again(self, data: Data) -> Any:
        """Other data with the columns that were made."""
        frame = frame_of(data, self._texts)
        for name in frame.columns:
            if frame[name].notna().all():
                frame[name] = plain_column(frame[name])
        for matrix in self._matrices:
            wanted = {label: name for name, label in self.made.items() if label in matrix.columns and name not in self._joined}
            future = self.parts.response in wanted.values() and not variables(self.text.response, self.text) <= {*frame.columns}
            if wanted and not future:  # what is to be predicted was not measured
                columns = matrix.again(frame)
                frame = frame.assign(**{name: columns[label] for label, name in wanted.items()})
        for column, factor in self._joined.items():
            frame = frame.assign(**{column: group_labels(frame, factor)})
        return frame
