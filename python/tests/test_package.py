"""The package as it is installed: its types, its documentation, and the guide."""

import doctest
import importlib
import importlib.metadata
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import kalfit
from conftest import ROOT

MODULES = sorted(f"kalfit.{module.name}" for module in pkgutil.iter_modules(kalfit.__path__)) + ["kalfit"]
GUIDE = re.findall(r"```python\n(.*?)```", (ROOT / "book" / "src" / "guide" / "python.md").read_text(encoding="utf-8"), re.DOTALL)


def test_the_wheel_is_what_is_tested():
    sources = ROOT / "python"
    assert sources not in Path(kalfit.__file__).resolve().parents, "the tests must run on the installed package"
    assert importlib.metadata.version("kalfit") == kalfit.__version__
    assert (Path(kalfit.__file__).parent / "py.typed").exists()
    assert (Path(kalfit.__file__).parent / "_kalfit.pyi").exists()


def test_every_public_name_is_there_and_documented():
    for name in kalfit.__all__:
        thing = getattr(kalfit, name)
        assert name == "__version__" or name in ("Data", "ModelLike") or thing.__doc__, f"{name} has no documentation"


def test_the_stubs_have_what_the_compiled_part_has():
    stubs = (Path(kalfit.__file__).parent / "_kalfit.pyi").read_text(encoding="utf-8")
    declared = set(re.findall(r"^(?:def|class) (\w+)", stubs, re.MULTILINE)) - {"_Stream"}
    assert declared == {name for name in dir(kalfit._kalfit) if not name.startswith("_")}


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_the_documentation_hold(name):
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
    failed, _ = doctest.testmod(importlib.import_module(name), optionflags=flags)
    assert failed == 0


def test_some_examples_were_found():
    finder = doctest.DocTestFinder()
    assert sum(len(test.examples) for name in MODULES for test in finder.find(importlib.import_module(name))) > 25


def test_the_guide_runs_from_top_to_bottom(tmp_path, monkeypatch):
    assert len(GUIDE) >= 5
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)  # it writes files
    names = {"__name__": "guide"}
    for block in GUIDE:
        exec(compile(block, "guide/python.md", "exec"), names)


def test_strict_types():
    files = ["python/tests/typed.py", "python/kalfit"]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file", "pyproject.toml", *files],
        capture_output=True, text=True, check=False, cwd=ROOT,
    )
    assert done.returncode == 0, done.stdout + done.stderr
