"""The JSON Schema of model files, as `kalfit schema` prints it, against the model files of the project."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

jsonschema = pytest.importorskip("jsonschema")
tomllib = pytest.importorskip("tomllib" if sys.version_info >= (3, 11) else "tomli")

ROOT = Path(__file__).resolve().parents[2]
#: Files beside models: outputs and hypotheses have keys of their own.
OTHERS = {"outputs.toml"}
MODELS = sorted(
    path
    for folder in ("examples", "crates/kalfit-cli/templates", "crates/kalfit-cli/tests/data")
    for path in (ROOT / folder).rglob("*.toml")
    if path.name not in OTHERS
)


@pytest.fixture(scope="module")
def schema() -> Any:
    program = os.environ.get("KALFIT_COMMAND")
    if not program:
        pytest.skip("KALFIT_COMMAND does not name the command to compare with")
    printed = subprocess.run([program, "schema"], capture_output=True, text=True, check=True).stdout
    found = json.loads(printed)
    jsonschema.Draft7Validator.check_schema(found)
    return jsonschema.Draft7Validator(found)


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.name)
def test_every_model_is_one_by_the_schema(schema: Any, path: Path) -> None:
    model = tomllib.loads(path.read_text(encoding="utf-8"))
    assert [error.message for error in schema.iter_errors(model)] == []


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("[data]\ntset = 'a'\n", "data"),
        ("[states]\na = { proces = 'random-walk' }\n", "a"),
        ("[states]\na = { process = 'brownian' }\n", "process"),
        ("[covariance]\nequal = ['a, a']\n", "equal"),
        ("[phases.coast]\nparameters = {}\n", "coast"),
    ],
)
def test_mistakes_are_found_where_they_are(schema: Any, line: str, place: str) -> None:
    errors = list(schema.iter_errors(tomllib.loads(line)))
    assert any(place in [str(step) for step in error.absolute_path] for error in errors), errors
