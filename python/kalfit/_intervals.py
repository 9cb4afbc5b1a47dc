"""Intervals at any level from standard errors, on the scales that kalfit computes its own on."""

from __future__ import annotations

import math
from statistics import NormalDist

from kalfit import _kalfit
from kalfit._estimates import Estimate

__all__ = ["normal_p_value", "wald"]


def wald(own: Estimate, level: float, positive: bool) -> tuple[float, float] | None:
    """The interval from the standard error: by t for means with degrees of freedom, on the logarithmic scale for what is positive
    (standard deviations, variances, such parameters), on the atanh scale for correlations. None without standard error."""
    if own.estimate is None or own.std_error is None or own.status == "fixed":
        return None
    x, error = own.estimate, own.std_error
    half = (1.0 + level) / 2.0
    if own.df is not None:
        quantile = _kalfit.student_quantile(half, own.df)
        return None if quantile is None else (x - quantile * error, x + quantile * error)
    z = NormalDist().inv_cdf(half)
    if positive and x > 0.0:
        ratio = math.exp(z * error / x)
        return x / ratio, x * ratio
    if own.kind == "correlation" and abs(x) < 1.0:
        by = z * error / (1.0 - x * x)
        return math.tanh(math.atanh(x) - by), math.tanh(math.atanh(x) + by)
    return x - z * error, x + z * error


def normal_p_value(statistic: float) -> float:
    """The two-sided p-value of a normal statistic."""
    return math.erfc(abs(statistic) / math.sqrt(2.0))
