"""What the tests share. They run from the project's folder, as its examples are named from there."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
BENCH = ("examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv")
SLEEP = ("examples/random-coefficients/sleepstudy.toml", "examples/random-coefficients/sleepstudy.csv")
META = ("examples/meta-analysis/berkey1998.toml", "examples/meta-analysis/berkey1998.csv")
PHASES = ("examples/two-phase/platform.toml", "examples/two-phase/platform.csv")


@pytest.fixture(autouse=True)
def _in_the_project(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


@pytest.fixture
def command(tmp_path: Path) -> Any:
    """Runs the command `kalfit` and reads the file that it wrote. `KALFIT_COMMAND` names the built command."""
    program = os.environ.get("KALFIT_COMMAND")
    if not program:
        pytest.skip("KALFIT_COMMAND does not name the command to compare with")

    def run(*arguments: str, out: str = "out.json") -> Any:
        path = tmp_path / out
        done = subprocess.run([program, *arguments, "--out", str(path)], capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr
        return steady(json.loads(path.read_text())) if out.endswith(".json") else path

    return run


def steady(record: dict[str, Any], files: bool = True) -> dict[str, Any]:
    """Without what differs from run to run; without the names of files too, when `files` is false."""
    record["solver"].pop("seconds", None) if "solver" in record else None
    for method in record.get("methods", []):
        method.pop("seconds", None)
    if not files:
        record["data"].pop("files")
        for row in (record.get("misfit") or {}).get("wrong_rows", []):
            row.pop("file", None)
            row.pop("row")
    return record
