"""A fit in the columns of R's broom and broom.mixed."""

from __future__ import annotations

import json
from typing import Any

from kalfit._data import Table
from kalfit._fit_record import FitRecord
from kalfit._formula_model import FormulaModel
from kalfit._frames import table_of_columns
from kalfit._intervals import normal_p_value

__all__ = ["broom_rows"]

_NUMBERS = ("estimate", "std_error", "statistic", "df", "p_value", "conf_low", "conf_high")


def broom_rows(fit: FitRecord, formula: FormulaModel | None) -> Table:
    """Fixed effects (``effect`` is ``fixed``), then standard deviations and correlations (``ran_pars``) with their ``group``."""
    terms = {} if formula is None else formula.terms
    rows = [row for row in json.loads(fit._results.quantities()) if row["estimate"] is not None]
    made = [_fixed(row, terms) for row in rows if row["kind"] in ("mean", "regression") and _stands(row)]
    made += [_random(row, terms, formula) for row in rows if row["kind"] in ("std_dev", "correlation") and _stands(row)]
    made += [_parameter(row, formula) for row in rows if row["kind"] == "parameter" and _stands(row)]
    texts = {name: [row[name] for row in made] for name in ("effect", "group", "term")}
    return table_of_columns(texts, {name: [row[name] for row in made] for name in _NUMBERS})


def _stands(row: dict[str, Any]) -> bool:
    """Structural zeros are no rows: means of states without a fixed effect, spreads of states that do not vary."""
    return not (row["status"] == "fixed" and row["estimate"] == 0.0 and row["kind"] != "parameter")


def _row(row: dict[str, Any], effect: str, group: str, term: str) -> dict[str, Any]:
    found = {"effect": effect, "group": group, "term": term, "conf_low": row["lower"], "conf_high": row["upper"]}
    if row["status"] == "fixed":
        found |= {"conf_low": None, "conf_high": None}
    return found | {name: row.get(name) for name in ("estimate", "std_error", "statistic", "df", "p_value")}


def _phase(row: dict[str, Any]) -> str:
    """The prefix of a name where a fit has several phases."""
    phase = row.get("phase")
    return "" if phase in (None, "main") else f"{phase}: "


def _fixed(row: dict[str, Any], terms: dict[str, str]) -> dict[str, Any]:
    term = terms.get(row["state"], row["state"])
    made = _row(row, "fixed", "", _phase(row) + (term if row["kind"] == "mean" else f"{term}:{row['column']}"))
    if made["statistic"] is None and made["std_error"]:
        statistic = row["estimate"] / row["std_error"]
        made |= {"statistic": statistic, "p_value": normal_p_value(statistic)}
    return made


def _random(row: dict[str, Any], terms: dict[str, str], formula: FormulaModel | None) -> dict[str, Any]:
    level = row["level"] or "tests"
    group = level if formula is None else formula.groups.get(level, level)
    names = [terms.get(state, state) for state in (row["state"], row["other_state"]) if state is not None]
    word = "sd" if row["kind"] == "std_dev" else "cor"
    return _row(row, "ran_pars", group, f"{word}__{_phase(row)}{'.'.join(names)}")


def _parameter(row: dict[str, Any], formula: FormulaModel | None) -> dict[str, Any]:
    if formula is not None and row["name"] == "sigma":
        return _row(row, "ran_pars", "Residual", "sd__Observation")
    return _row(row, "parameter", "", row["name"])
