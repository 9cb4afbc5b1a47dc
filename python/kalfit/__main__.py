"""``python -m kalfit model --formula "y ~ x + (1 | unit)" data.csv`` prints the model file that a formula stands for.

``--help`` lists the options; ``--out DIR`` writes the model file, and the data where the model takes others.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from kalfit._formula_model import FormulaModel, model_from_formula
from kalfit._kalfit import Error
from kalfit._warnings import FormulaWarning

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; 0 when done, 2 for bad input."""
    parser = argparse.ArgumentParser(prog="python -m kalfit", description="What the command `kalfit` does not do.")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    model = commands.add_parser(
        "model",
        help="print the model file that a formula stands for",
        description="Prints the model file that a formula in lme4's words stands for. Where it takes columns that the data do not have, "
        "--out writes them.",
    )
    model.add_argument("data", nargs="+", metavar="DATA", help="CSV, Parquet or Arrow files")
    model.add_argument("--formula", required=True, metavar="TEXT", help="such as 'y ~ x + (1 + x | unit / run)'")
    model.add_argument("--weights", metavar="COLUMN", help="the noise has the variance sigma^2 / COLUMN")
    model.add_argument("--variances", metavar="COLUMN", help="known variances of the noise")
    model.add_argument("--out", metavar="DIR", help="write DIR/model.toml, and DIR/data.csv if the model takes other data than DATA")
    options = parser.parse_args(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FormulaWarning)  # the notes are printed below
            made = model_from_formula(options.formula, options.data, weights=options.weights, variances=options.variances)
        if options.out is not None:
            made.save(options.out)
    except (Error, ImportError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(made, end="")
    _say(made, options.data, options.out)
    return 0


def _say(made: FormulaModel, data: list[str], out: str | None) -> None:
    for note in made.notes:
        print(f"note: {note}", file=sys.stderr)
    if out is not None:
        files = [str(Path(out) / "data.csv")] if made.takes_other_data else data
        print(f"note: kalfit fit {Path(out) / 'model.toml'} {' '.join(files)} --criterion reml", file=sys.stderr)
    elif made.made:
        names = ", ".join(f"`{name}`" for name in made.made)
        print(f"note: the model takes columns that the data do not have: {names}; --out DIR writes them", file=sys.stderr)
    elif made.takes_other_data:
        print("note: --out DIR writes the data without these rows", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
