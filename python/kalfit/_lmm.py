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
    """Fits a linear mixed model that is given by a formula of lme4. This needs ``pip install 'kalfit[formula]'``.

    - ``formula``: such as ``"y ~ x + (1 + x | unit)"``; :func:`kalfit.model_from_formula` says what it may contain.
    - ``data``: a table, a path or a pattern of paths, a dictionary of columns, or a list of these.
    - ``reml``: ``True`` maximises the restricted likelihood, as lme4 and statsmodels do by default; ``False`` the likelihood, which
      is the default of :func:`kalfit.fit`.
    - ``weights``, ``variances``, ``context``: as in :func:`kalfit.model_from_formula`.
    - ``options``: those of :func:`kalfit.fit`.

    Returns a :class:`kalfit.Fit`, whose attribute ``formula`` is the :class:`kalfit.FormulaModel`. Raises what
    :func:`kalfit.model_from_formula` and :func:`kalfit.fit` raise.

    >>> import kalfit
    >>> data = "examples/random-coefficients/sleepstudy.csv"
    >>> fit = kalfit.lmm("Reaction ~ Days + (Days | Subject)", data)
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
