"""Intervals at any level from standard errors, on the scales that kalfit computes its own on."""

from __future__ import annotations

import math
from statistics import NormalDist

from kalfit._estimates import Estimate

__all__ = ["normal_p_value", "student_quantile", "wald"]


def wald(own: Estimate, level: float, positive: bool) -> tuple[float, float] | None:
    """The interval from the standard error: by t for means with degrees of freedom, on the logarithmic scale for what is positive
    (standard deviations, variances, such parameters), on the atanh scale for correlations. None without standard error."""
    if own.estimate is None or own.std_error is None or own.status == "fixed":
        return None
    x, error = own.estimate, own.std_error
    half = (1.0 + level) / 2.0
    if own.df is not None:
        by = student_quantile(half, own.df) * error
        return x - by, x + by
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


def student_quantile(p: float, df: float) -> float:
    """The quantile of Student's t.

    >>> round(student_quantile(0.975, 17.0), 6), round(student_quantile(0.05, 2.5), 6)
    (2.109816, -2.558219)
    """
    if p < 0.5:
        return -student_quantile(1.0 - p, df)
    high = 1.0
    while _student_tail(high, df) > 1.0 - p:
        high *= 2.0
    low = 0.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _student_tail(middle, df) > 1.0 - p else (low, middle)
    return 0.5 * (low + high)


def _student_tail(t: float, df: float) -> float:
    """The probability of a larger value, for t of zero or more."""
    return 0.5 * _beta(df / (df + t * t), 0.5 * df, 0.5)


def _beta(x: float, a: float, b: float) -> float:
    """The regularised incomplete beta function, by its continued fraction."""
    if x <= 0.0 or x >= 1.0:
        return float(x >= 1.0)
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta(1.0 - x, b, a)
    logarithm = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0))
    value = d
    for m in range(1, 10_000):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            c, d = 1.0 + term / c, 1.0 / (1.0 + term * d)
            value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return math.exp(logarithm) * value / a
