"""The text of the model file that a formula stands for."""

from __future__ import annotations

from dataclasses import dataclass, field

from kalfit._formula_groups import Nesting
from kalfit._toml import quoted

__all__ = ["Parts", "model_file"]


@dataclass
class Parts:
    """What a model file is made of."""

    formula: str
    #: The column that is measured, and the name of the measurement.
    response: str
    measurement: str
    #: Levels, tests and crossed factors.
    nesting: Nesting
    #: The name of each state, and the expression that it is multiplied with.
    states: dict[str, str]
    #: Words on each state.
    words: dict[str, str]
    #: States with a mean of zero: random terms that are no fixed effects.
    zero_means: list[str]
    #: States that vary, by the name of the grouping factor: lists of states that are correlated.
    blocks: dict[str, list[list[str]]]
    #: Expressions that are added as they are.
    offsets: list[str] = field(default_factory=list)
    #: The noise: ``noise = "sigma"`` or another line.
    noise: str = 'noise = "sigma"'
    #: Whether the standard deviation of the noise is estimated.
    sigma: bool = True

    def varying(self) -> set[str]:
        """States that vary with any factor."""
        return {state for blocks in self.blocks.values() for block in blocks for state in block}


def model_file(parts: Parts) -> str:
    """The text of the model file."""
    levels, tests, crossed = parts.nesting.levels, parts.nesting.tests, parts.nesting.crossed
    lines = [f"title = {quoted(parts.formula)}", "", "[data]", f"test = {quoted('@row' if tests is None else tests.column)}"]
    for key, groupings in (("levels", levels), ("crossed", crossed)):
        if groupings:
            lines.append(f"{key} = [{', '.join(quoted(grouping.column) for grouping in groupings)}]")
    varying = parts.varying()
    lines += ["", "[states]"]
    tables = {state: f"{state} = {'{}' if state in varying else '{ random = false }'}" for state in parts.states}
    width = max(map(len, tables.values()))
    lines += [f"{table:<{width}}  # {parts.words[state]}" for state, table in tables.items()]
    terms = [state if column == "1" else f"{state} * {column}" for state, column in parts.states.items()]
    equation = " + ".join([*terms, *parts.offsets])
    lines += [
        "",
        f"[measurements.{parts.measurement}]",
        f"column = {quoted(parts.response)}",
        f"equation = {quoted(equation)}",
        parts.noise,
    ]
    if parts.sigma:
        lines += ["", "[parameters]", "sigma = {}"]
    if parts.zero_means:
        lines += ["", "[mean]", f"fixed = {{ {', '.join(f'{state} = 0' for state in parts.zero_means)} }}"]
    of_tests = [] if tests is None else parts.blocks[tests.name]
    lines += _covariance("[covariance]", of_tests, varying, bool(levels or crossed))
    for key, groupings in (("levels", levels), ("crossed", crossed)):
        for grouping in groupings:
            lines += _covariance(f"[{key}.{quoted(grouping.column)}.covariance]", parts.blocks[grouping.name], varying, True)
    return "\n".join(lines) + "\n"


def _covariance(title: str, blocks: list[list[str]], varying: set[str], levels: bool) -> list[str]:
    """A table of covariances; none where the covariance of all states is full."""
    states = [state for block in blocks for state in block]
    lines = []
    if len(blocks) > 1 and len(blocks) == len(states):
        lines.append('structure = "diagonal"')
    elif len(blocks) > 1:
        lists = ", ".join(f"[{', '.join(map(quoted, block))}]" for block in blocks)
        lines += ['structure = "blocks"', f"blocks = [{lists}]"]
    if levels and {*states} != varying:
        lines.append(f"states = [{', '.join(map(quoted, states))}]")
    return ["", title, *lines] if lines else []
