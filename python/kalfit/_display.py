"""A fit in a notebook: tables, and a forest plot of the tests."""

from __future__ import annotations

import math
from html import escape
from typing import Any

from kalfit._fit_record import FitRecord
from kalfit._population import Phase

__all__ = ["html"]

#: More tests than this are thinned out, more panels left out: the plot must fit a screen.
_MOST_TESTS = 40
_MOST_PANELS = 4
_MOST_PARAMETERS = 40
_NORMAL95 = 1.959963984540054


def html(fit: FitRecord) -> str:
    """The fit as a piece of HTML without scripts, that refers to nothing outside."""
    record = fit._record
    state = "converged" if fit.converged else "<b>not converged</b>"
    figures = [
        f"{record['data']['tests']} tests",
        f"{record['data']['observations']} observations",
        f"log-likelihood {_shown(fit.log_likelihood, 8)}",
    ]
    if fit.aic is not None:
        figures.append(f"AIC {_shown(fit.aic, 8)}")
    parts = [
        f"<div class='kalfit-fit'><p><b>{escape(fit.title or 'kalfit')}</b>: {state} ({escape(fit.reason)})<br>",
        f"{_model_check(fit)}<br>",
        f"{', '.join(figures)}</p>",
    ]
    for phase in fit.phases:
        parts += [_phase_table(phase, fit), _forest(fit, phase)]
    parts += [_parameter_table(fit), _notes(fit), "</div>"]
    return "".join(parts)


def _model_check(fit: FitRecord) -> str:
    checked = fit.model_check
    if not checked["findings"]:
        return f"model check: {escape(checked['verdict'])}"
    found = "; ".join(escape(finding["text"]) for finding in checked["findings"])
    return f"model check: <b>{escape(checked['verdict'])}</b> ({found})"


def _shown(value: float | None, digits: int = 4) -> str:
    if value is None or not math.isfinite(value):
        return "\N{EM DASH}"
    return f"{value:.{digits}g}"


def _with_error(value: float, error: float | None) -> str:
    if error is None or not math.isfinite(error):
        return _shown(value)
    return f"{_shown(value)} ± {_shown(error, 2)}"


def _table(heads: list[str], rows: list[list[str]]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _phase_table(phase: Phase, fit: FitRecord) -> str:
    """Means and standard deviations; where there are levels, the standard deviations of each."""
    means = [phase.mean, phase.mean_std_error.tolist()]
    spreads = [[spread.std_dev, spread.std_dev_std_error.tolist()] for spread in fit.levels or [phase]]
    rows = [
        [state, unit or "", *(_with_error(values[i], errors[i]) for values, errors in [means, *spreads])]
        for i, (state, unit) in enumerate(zip(phase.states, phase.units))
    ]
    head = f"<p>Phase {escape(phase.name)}</p>" if len(fit.phases) > 1 else ""
    heads = [f"std. dev. ± std. error{where}" for where in _steps(fit) or [""]]
    return head + _table(["state", "unit", "mean ± std. error", *heads], rows)


def _steps(fit: FitRecord) -> list[str]:
    """From whom to whom each level varies, the outermost first; nothing without levels."""
    names = ["test" if level.column is None else level.name for level in fit.levels]
    above = ["", *(f" of one {name}" for name in names)]
    return [f", {name} to {name}{of}" for name, of in zip(names, above)]


def _parameter_table(fit: FitRecord) -> str:
    rows = []
    for parameter in fit.parameters[:_MOST_PARAMETERS]:
        name = parameter.name if parameter.level is None else f"{parameter.name}[{parameter.level}]"
        value = _with_error(parameter.estimate, parameter.std_error) + (" fixed" if parameter.fixed else "")
        interval = parameter.interval95
        limits = "" if interval is None else f"{_shown(interval[0])} to {_shown(interval[1])}"
        rows.append([name, parameter.unit or "", value, limits])
    text = _table(["parameter", "unit", "value ± std. error", "95 % interval"], rows)
    rest = len(fit.parameters) - len(rows)
    return text + (f"<p>and {rest} more parameters</p>" if rest > 0 else "")


def _notes(fit: FitRecord) -> str:
    items = "".join(f"<li>{escape(note)}</li>" for note in fit.notes)
    return f"<ul>{items}</ul>" if items else ""


def _forest(fit: FitRecord, phase: Phase) -> str:
    """Each test's own state with its 95 % interval, beside the population's mean and the range of 95 % of its tests."""
    step = max(1, -(-len(fit._results) // _MOST_TESTS))
    shown = [test for test in fit._some_tests(step) if phase.name in test.means]
    if len(shown) < 2 or not phase.states:
        return ""
    # a test that nothing is known of varies at all levels
    deviations = [math.sqrt(sum(float(one.covariance[i, i]) for one in fit.levels or [phase])) for i in range(len(phase.states))]
    panels = "".join(_panel(phase, i, deviations[i], shown) for i in range(min(len(phase.states), _MOST_PANELS)))
    which = f"every {step}th test" if step > 1 else "each test"
    words = f"{which} by its own data and the fit, with 95 % intervals; line: mean, band: 95 % of the population"
    left = len(phase.states) - _MOST_PANELS
    words += f"; {left} more states" if left > 0 else ""
    return f"<div>{panels}</div><p><small>{words}</small></p>"


def _panel(phase: Phase, index: int, deviation: float, tests: list[Any]) -> str:
    """One state: an SVG with a line for each test."""
    width, label, line, top = 330, 90, 13, 22
    centre, spread = float(phase.mean[index]), _NORMAL95 * deviation
    rows = []
    for test in tests:
        value = float(test.means[phase.name][index])
        half = _NORMAL95 * math.sqrt(max(float(test.covariances[phase.name][index, index]), 0.0))
        rows.append((test.id, value, half))
    low = min([centre - spread] + [value - half for _, value, half in rows])
    high = max([centre + spread] + [value + half for _, value, half in rows])
    reach = (high - low) or 1.0

    def x(value: float) -> float:
        return round(label + (width - label - 8) * (value - low) / reach, 1)

    height = top + line * len(rows) + 20
    unit = phase.units[index]
    name = escape(phase.states[index] + (f" ({unit})" if unit else ""))
    style = "font-family:sans-serif;font-size:10px"
    svg = [
        f"<svg role='img' aria-label='forest plot of {name}' width='{width}' height='{height}' style='{style}'>",
        f"<text x='{label}' y='12' fill='currentColor'>{name}</text>",
        f"<rect x='{x(centre - spread)}' y='{top - 4}' width='{round(x(centre + spread) - x(centre - spread), 1)}' "
        f"height='{line * len(rows)}' fill='#4477aa' fill-opacity='0.15'/>",
        f"<line x1='{x(centre)}' x2='{x(centre)}' y1='{top - 4}' y2='{top - 4 + line * len(rows)}' stroke='#4477aa'/>",
    ]
    for row, (test_id, value, half) in enumerate(rows):
        y = top + line * row + 4
        short = test_id if len(test_id) <= 14 else test_id[:13] + "…"
        svg += [
            f"<text x='{label - 6}' y='{y + 3}' text-anchor='end' fill='currentColor'>{escape(short)}</text>",
            f"<line x1='{x(value - half)}' x2='{x(value + half)}' y1='{y}' y2='{y}' stroke='currentColor'/>",
            f"<circle cx='{x(value)}' cy='{y}' r='2.5' fill='currentColor'>"
            f"<title>{escape(test_id)}: {_shown(value)}</title></circle>",
        ]
    foot = height - 4
    svg += [
        f"<text x='{label}' y='{foot}' fill='currentColor'>{_shown(low, 3)}</text>",
        f"<text x='{width - 8}' y='{foot}' text-anchor='end' fill='currentColor'>{_shown(high, 3)}</text>",
        "</svg>",
    ]
    return "".join(svg)
