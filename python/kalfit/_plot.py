"""Figures of a fit by matplotlib, where it is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kalfit._estimates import Estimate
from kalfit._fit_record import FitRecord
from kalfit._population import Phase

_BLUE, _ORANGE, _FAINT = "#0072b2", "#d55e00", "#777777"
#: Tests whose influence is drawn, pairs of states, outliers that are named.
_MOST_TESTS, _MOST_PAIRS, _MOST_NAMES = 30, 6, 12


def plot(fit: FitRecord, what: str) -> Any:
    """A ``matplotlib.figure.Figure``."""
    kinds = {"forest": _forest, "ellipses": _ellipses, "influence": _influence}
    if what not in kinds:
        known = ", ".join(repr(kind) for kind in kinds)
        raise ValueError(f"what is {what!r}, expected one of {known}; records are drawn by `kalfit plot` and in the report")
    try:
        import matplotlib.figure
    except ImportError as error:
        message = "fit.plot needs matplotlib: pip install 'kalfit[plot]'; `kalfit plot` draws the same figures without it"
        raise ImportError(message) from error
    figure = matplotlib.figure.Figure(layout="constrained")
    figure.suptitle(fit.title)
    kinds[what](fit, figure)
    return figure


def _forest(fit: FitRecord, figure: Any) -> None:
    drawn = [own for own in fit.estimates.values() if own.kind in ("mean", "std_dev", "parameter") and own.estimate is not None]
    drawn = [own for own in drawn if own.kind != "parameter" or own.status != "fixed"]
    groups: dict[tuple[str, str | None], list[Estimate]] = {}
    for own in drawn:
        groups.setdefault((own.kind, own.unit), []).append(own)
    if not groups:
        raise ValueError("no mean, spread or parameter is estimated")
    figure.set_size_inches(7.5, 0.8 + sum(0.7 + 0.3 * len(rows) for rows in groups.values()))
    axes = figure.subplots(len(groups), squeeze=False, gridspec_kw={"height_ratios": [len(rows) + 1 for rows in groups.values()]})
    for ((kind, unit), rows), ax in zip(groups.items(), axes[:, 0], strict=True):
        for y, own in enumerate(rows):
            known = [end for end in own.interval95 if end is not None]
            if own.status != "fixed" and known:
                ends = [own.estimate if end is None else end for end in own.interval95]
                ax.plot(ends, [y, y], color=_BLUE, linewidth=2)
            ax.plot([own.estimate], [y], "o", color=_BLUE, markerfacecolor=_BLUE if known and own.status != "fixed" else "white")
        words = {"mean": "mean", "std_dev": "standard deviation", "parameter": "value"}[kind]
        ax.set(yticks=range(len(rows)), yticklabels=[own.name for own in rows], xlabel=f"{words} [{unit}]" if unit else words)
        ax.set_ylim(len(rows) - 0.5, -0.5)
        ax.grid(axis="x", alpha=0.3)


def _ellipses(fit: FitRecord, figure: Any) -> None:
    pairs = [
        (phase, k, i)
        for phase in fit.phases
        for i in range(len(phase.states))
        for k in range(i)
        if phase.std_dev[i] > 0 and phase.std_dev[k] > 0
    ][:_MOST_PAIRS]
    if not pairs:
        raise ValueError("it takes two estimated states that vary from test to test")
    columns = min(len(pairs), 2 if len(pairs) == 4 else 3)
    rows = -(-len(pairs) // columns)
    figure.set_size_inches(max(4.5, 3.4 * columns), 0.4 + 3.1 * rows)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[len(pairs) :]:
        ax.set_visible(False)
    for (phase, k, i), ax in zip(pairs, axes.flat, strict=False):
        _pair(fit, phase, (k, i), ax)


def _pair(fit: FitRecord, phase: Phase, at: tuple[int, int], ax: Any) -> None:
    for part in (0.5, 0.95):
        x, y = ellipse(phase.mean[[*at]], phase.covariance[np.ix_(at, at)], part)
        ax.plot(x, y, color=_FAINT, linewidth=1)
    tests = [test for test in fit.tests if phase.name in test.means]
    level = 0.05 / max(len(fit.tests), 1)
    named = 0
    for test in tests:
        place = test.means[phase.name][[*at]]
        outlier = test.p_value is not None and test.p_value < level
        ax.plot(*place, "o", markersize=3, color=_ORANGE if outlier else _BLUE)
        if outlier and named < _MOST_NAMES:
            ax.annotate(test.id, place, textcoords="offset points", xytext=(5, 3), fontsize="small")
            named += 1
    several = len(fit.phases) > 1
    labels = []
    for state in at:
        unit = f" [{phase.units[state]}]" if phase.units[state] else ""
        labels.append(f"{phase.name}: " * several + phase.states[state] + unit)
    ax.set(xlabel=labels[0], ylabel=labels[1])
    ax.grid(alpha=0.3)


def ellipse(mean: NDArray[np.float64], covariance: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """The edge of the ellipse that holds a part of a normal population of two numbers, shape (2, 181).

    >>> x, y = ellipse(np.zeros(2), np.diag([4.0, 1.0]), 0.95)
    >>> round(float(x.max()) / 2, 3), round(float(y.max()), 3)  # the square root of the quantile of chi-squared, 5.991
    (2.448, 2.448)
    """
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.sqrt(-2.0 * np.log(1.0 - part)) * np.array([np.cos(angle), np.sin(angle)])
    edge: NDArray[np.float64] = mean[:, None] + vectors @ (np.sqrt(values.clip(min=0.0))[:, None] * circle)
    return edge


def _influence(fit: FitRecord, figure: Any) -> None:
    import json

    tests = json.loads(fit._results.tests(1))
    moved = {test["id"]: test["deletion"]["displacement"] for test in tests if test.get("deletion")}
    first = sorted(moved.items(), key=lambda one: (-one[1], one[0]))[:_MOST_TESTS]
    if not first:
        raise ValueError("the fit was not repeated without each test: ask for it by deletion='all'")
    free = max(fit.free_parameters, 1)
    limit = free * (1.0 - 2.0 / (9.0 * free)) ** 3  # the median of chi-squared, by Wilson and Hilferty
    figure.set_size_inches(6.5, 1.2 + 0.22 * len(first))
    ax = figure.subplots()
    colors = [_ORANGE if value > limit else _BLUE for _, value in first]
    ax.barh(range(len(first)), [value for _, value in first], color=colors, height=0.6)
    ax.axvline(limit, color=_FAINT, linestyle="--", linewidth=1, label="edge of the 50 % confidence region")
    ax.set(yticks=range(len(first)), yticklabels=[name for name, _ in first], xlabel="Cook's displacement without the test")
    ax.invert_yaxis()
    ax.legend(loc="lower right", fontsize="small")
    ax.grid(axis="x", alpha=0.3)
