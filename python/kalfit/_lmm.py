"""Linear mixed models by formula."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kalfit._data import Data
from kalfit._fit import Fit
from kalfit._fitting import fit
from kalfit._formula_model import model_from_formula

__all__ = ["lmm"]


def lmm(
    formula: str,
    data: Data,
    *,
    reml: bool = True,
    weights: str | None = None,
    variances: str | None = None,
    context: Mapping[str, Any] | None = None,
    **options: Any,
) -> Fit:
    """Fits a linear mixed model that a formula in the words of lme4 describes.

    As lme4 and statsmodels do, it maximises the restricted likelihood; ``reml=False`` asks for the full one, which is the default
    of :func:`kalfit.fit`. Everything else is as there: ``options`` are those of :func:`kalfit.fit`. What the formula may say, and
    ``weights``, ``variances`` and ``context``, are described with :func:`kalfit.model_from_formula`. The attribute ``formula`` of the
    fit has the model, the data with the columns that were made, and what each state is in the formula.

    >>> import kalfit
    >>> fit = kalfit.lmm("Reaction ~ Days + (Days | Subject)", "examples/random-coefficients/sleepstudy.csv")
    >>> round(-2 * fit.log_likelihood, 4), fit.mean.round(3).tolist()
    (1743.6283, [251.405, 10.467])
    """
    if "family" in options:
        raise ValueError(f"family is {options['family']!r}: the noise of kalfit's models is normal; for other families see lme4's glmer")
    for name in ("criterion", "REML"):
        if name in options:
            raise TypeError(f"{name} is {options[name]!r}: say reml=True or reml=False")
    made = model_from_formula(formula, data, weights=weights, variances=variances, context=context)
    result = fit(made.model, made.data, criterion="reml" if reml else "ml", **options)
    result.formula = made
    return result
