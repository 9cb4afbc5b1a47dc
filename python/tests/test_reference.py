"""The reference of the package in the book, and the docstrings that it is made of."""

from __future__ import annotations

import importlib.util
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cached_property
from itertools import zip_longest
from types import ModuleType
from typing import Any

import pytest

import kalfit
import kalfit.spark
from conftest import ROOT

PUBLIC = [(f"kalfit.{name}", getattr(kalfit, name)) for name in kalfit.__all__]
PUBLIC += [(f"kalfit.spark.{name}", getattr(kalfit.spark, name)) for name in kalfit.spark.__all__]
CLASSES = [(name, thing) for name, thing in PUBLIC if inspect.isclass(thing)]


def methods() -> Iterator[tuple[str, Any]]:
    """What can be called of the public classes; what Python itself gives them is not theirs."""
    for name, kind in CLASSES:
        for own in dir(kind):
            found = getattr(kind, own)
            is_method = inspect.isfunction(found) or inspect.ismethod(found)
            if not own.startswith("_") and is_method and found.__module__.split(".")[0] == "kalfit":
                yield f"{name}.{own}", found


FUNCTIONS = [*((name, thing) for name, thing in PUBLIC if inspect.isfunction(thing)), *methods()]
#: A class that users make by calling it: its docstring names the arguments.
CALLED = [("kalfit.Model", kalfit.Model)]
PROPERTIES = [
    (f"{name}.{own}", getattr(kind, own))
    for name, kind in CLASSES
    for own in dir(kind)
    if not own.startswith("_") and isinstance(getattr(kind, own), (property, cached_property))
]


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    """The script that writes the page."""
    spec = importlib.util.spec_from_file_location("reference", ROOT / "python" / "reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["reference"] = module  # its data classes look themselves up there
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_the_package_says(reference: ModuleType) -> None:
    pairs = zip_longest(reference.PAGE.read_text(encoding="utf-8").split("\n"), reference.page().split("\n"))
    for at, (found, expected) in enumerate(pairs, 1):
        place = f"{reference.PAGE.relative_to(ROOT)}, line {at}"
        assert found == expected, f"{place} is not what the package says; `{reference.COMMAND}` writes the page anew"


def test_links_of_the_page_lead_to_its_headings(reference: ModuleType) -> None:
    page = reference.page()
    outside = "\n".join(page.split("```")[::2])
    anchors = [reference.slug(heading) for heading in re.findall(r"^#+ (.*)$", outside, re.MULTILINE)]
    assert len(anchors) == len(set(anchors)), "two headings have one anchor"
    assert set(re.findall(r"\]\(#([^)]*)\)", outside)) <= set(anchors)
    for path in re.findall(r"\]\(([^)#]+)[^)]*\)", outside):
        assert (reference.PAGE.parent / path).is_file(), path


def test_enough_is_looked_at() -> None:
    counts = [len(things) for things in (CLASSES, FUNCTIONS, PROPERTIES)]
    assert counts[0] > 25 and counts[1] > 70 and counts[2] > 50, counts


@pytest.mark.parametrize(("name", "thing"), [*CLASSES, *FUNCTIONS, *PROPERTIES], ids=lambda part: part if isinstance(part, str) else "")
def test_every_public_name_has_a_docstring(name: str, thing: Any) -> None:
    assert inspect.getdoc(thing), f"{name} has no docstring"
    own = vars(thing).get("__doc__") if inspect.isclass(thing) else thing.__doc__
    assert own and not own.startswith(f"{name.split('.')[-1]}("), f"{name} has no docstring of its own"


@pytest.mark.parametrize(("name", "function"), [*FUNCTIONS, *CALLED], ids=lambda part: part if isinstance(part, str) else "")
def test_every_argument_is_named_in_its_docstring(name: str, function: Any) -> None:
    arguments = [argument for argument in inspect.signature(function).parameters if argument not in ("self", "cls")]
    missing = [argument for argument in arguments if not re.search(rf"``{argument}(``|=)", function.__doc__ or "")]
    assert not missing, f"the docstring of {name} does not name {', '.join(missing)}"
