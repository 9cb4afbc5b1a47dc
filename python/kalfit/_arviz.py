"""Draws of the estimates as ArviZ's InferenceData: of a parametric bootstrap, or of the normal law of the estimates."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from kalfit._fit_record import FitRecord
from kalfit._numbers import Array
from kalfit._warnings import ConvergenceWarning

__all__ = ["Draws", "bootstrap_draws", "inference_data", "normal_draws"]

#: Draws by the name of the estimate.
Draws: TypeAlias = Mapping[str, Array]


def normal_draws(fit: FitRecord, draws: int, seed: int) -> Draws:
    """Draws from the normal law of the estimates; that of what is positive is of its logarithm."""
    record = fit._record.get("estimates")
    if not record or not record["names"]:
        raise ValueError("this fit has no covariance of its estimates")
    names: list[str] = record["names"]
    at = np.array([fit.estimates[name].estimate for name in names], dtype=np.float64)
    scale = np.array([fit._is_positive(fit.estimates[name]) and x > 0 for name, x in zip(names, at, strict=True)])
    slope = np.where(scale, 1.0 / np.where(scale, at, 1.0), 1.0)
    center = np.where(scale, np.log(np.where(scale, at, 1.0)), at)
    spread = np.array(record["covariance"], dtype=np.float64) * slope[:, None] * slope[None, :]
    values, vectors = np.linalg.eigh(spread)
    root = vectors * np.sqrt(values.clip(min=0.0))
    drawn = center + np.random.default_rng(seed).standard_normal((draws, len(names))) @ root.T
    drawn = np.where(scale, np.exp(np.where(scale, drawn, 0.0)), drawn)
    return {name: drawn[:, place] for place, name in enumerate(names)}


def bootstrap_draws(fit: FitRecord, draws: int, again: Callable[[int], FitRecord]) -> tuple[Draws, int]:
    """Estimates of fits to data that were drawn from the fit, and how many of these fits did not converge."""
    names = [own.name for own in fit.estimates.values() if own.status not in ("fixed", "undefined") and own.estimate is not None]
    found = np.full((draws, len(names)), math.nan)
    missed = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for draw in range(draws):
            refitted = again(draw)
            missed += not refitted.converged
            for place, name in enumerate(names):
                value = refitted.estimates[name].estimate
                found[draw, place] = math.nan if value is None else value
    return {name: found[:, place] for place, name in enumerate(names)}, missed


def inference_data(draws: Draws, attributes: Mapping[str, Any]) -> Any:
    """An ``arviz.InferenceData``, in newer versions of ArviZ an ``xarray.DataTree``, of one chain in the group ``posterior``."""
    try:
        import arviz
        import xarray
    except ImportError as error:
        raise ImportError("InferenceData takes the package arviz: pip install 'kalfit[arviz]'") from error
    variables = {name: (("chain", "draw"), values[None, :]) for name, values in draws.items()}
    count = len(next(iter(draws.values())))
    dataset = xarray.Dataset(variables, coords={"chain": [0], "draw": np.arange(count)}, attrs=dict(attributes))
    if hasattr(arviz, "InferenceData"):
        return arviz.InferenceData(posterior=dataset)
    return xarray.DataTree.from_dict({"posterior": dataset})
