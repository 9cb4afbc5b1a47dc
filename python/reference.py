"""Writes the page of the book on the Python package, `book/src/reference/python.md`, from signatures and docstrings.

    python python/reference.py

takes an installed kalfit. Signatures, types of attributes and their words (the comments `#:`) are read from the sources of that
package, as they are written there, so that the page depends neither on the version of Python nor on optional packages.
"""

from __future__ import annotations

import ast
import functools
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
if Path(sys.path[0] or ".").resolve() == HERE:
    del sys.path[0]  # the sources beside this file lack the compiled part

import kalfit
import kalfit.spark

BOOK = HERE.parent / "book" / "src"
PAGE = BOOK / "reference" / "python.md"
COMMAND = "python python/reference.py"
#: The most characters of a line that is no row of a table.
WIDTH = 100

HEAD = f"""\
<!-- Made from the package by `{COMMAND}`. -->

# Python: functions and classes

This page lists the functions, classes and exceptions of the package `kalfit`. [kalfit in
Python](../guide/python.md) explains how they are used. The page is generated from the docstrings of
the package; `help(kalfit.fit)` shows the same words.

From a checkout, with a Rust toolchain:

```text
$ pip install .
```

```python
import kalfit

kalfit.__version__            # the version of the package, a text
```

Arguments after `*` in a signature must be named: `kalfit.fit(model, data, method="em")`. [Types in
signatures](#types-in-signatures) explains names such as `Data` and `ModelLike`.
"""


@dataclass(frozen=True)
class Section:
    """A part of the page: its heading, what stands below it, and the public names in it."""

    heading: str
    words: str
    names: tuple[str, ...]


SECTIONS = (
    Section("Fitting", "", ("fit", "Ensemble", "Step")),
    Section(
        "Results of a fit",
        "``kalfit.fit`` returns a ``Fit``. The other classes are its parts.",
        ("Fit", "Phase", "Level", "Factor", "Parameters", "Parameter", "Estimate", "TestFit", "GroupFit", "Labelled"),
    ),
    Section("Models and tables", "", ("Model", "Table", "TableLike")),
    Section(
        "Other jobs",
        "Each function does what the command of the same name does, and returns its results.",
        (
            *("check", "Check", "test", "RatioTest", "apply", "Applied", "predict", "Predicted", "simulate", "Simulation"),
            *("validate", "Validation", "compare", "Comparison", "plan", "Plan", "export", "Filter", "datasheet", "Datasheet"),
            *("reduce", "estimates"),
        ),
    ),
    Section("Models from formulas", "", ("lmm", "model_from_formula", "FormulaModel")),
    Section("Spark", "", ("spark.fit", "spark.reduce", "spark.apply")),
    Section(
        "Exceptions and warnings",
        "The text of an exception says where the error is, what was found, what was expected, and often a hint. Arguments that are "
        "out of range or of another type raise ``ValueError`` or ``TypeError``.",
        ("Error", "ModelError", "DataError", "FitError", "Interrupted", "ConvergenceWarning", "FormulaWarning"),
    ),
)
#: Sections that begin with the docstring of a module.
MODULES = {"Models from formulas": "kalfit.__main__", "Spark": "kalfit.spark"}
#: Types that signatures name, with their modules. The first two are public.
TYPES = {
    "Data": "kalfit._data",
    "ModelLike": "kalfit._model",
    "Path": "kalfit._model",
    "Set": "kalfit._given",
    "Progress": "kalfit._progress",
    "PerTest": "kalfit._arrays",
    "Array": "kalfit._numbers",
    "MaskedArray": "kalfit._numbers",
}
#: Classes that users make by calling them; functions and methods make the others.
CALLED = {"Model"}
#: Pages of the book that say more.
SEE = {
    "fit": ("guide/command-line.md", "guide/inference.md"),
    "Fit": ("reference/fit-json.md",),
    "Model": ("reference/model-file.md",),
    "test": ("guide/inference.md#hypotheses",),
    "RatioTest": ("reference/test-json.md",),
    "apply": ("howto/apply.md",),
    "Applied": ("reference/tables.md",),
    "predict": ("howto/predict.md",),
    "Predicted": ("reference/tables.md",),
    "validate": ("howto/validate.md",),
    "Validation": ("reference/validated-json.md",),
    "compare": ("howto/compare.md",),
    "Comparison": ("reference/compared-json.md",),
    "plan": ("howto/plan.md",),
    "Plan": ("reference/plan-json.md",),
    "export": ("howto/export.md",),
    "datasheet": ("howto/datasheet.md",),
    "Datasheet": ("reference/datasheet-json.md",),
    "reduce": ("howto/organisations.md", "guide/exchange.md"),
    "estimates": ("guide/phases.md", "guide/exchange.md"),
    "lmm": ("howto/formula.md",),
    "model_from_formula": ("howto/formula.md",),
    "spark.fit": ("howto/sites.md",),
}


# The sources of the package.


@dataclass(frozen=True)
class Source:
    """A module of the package."""

    name: str
    text: str
    tree: ast.Module

    def written(self, node: ast.AST) -> str:
        """The text of a piece of code, on one line."""
        return " ".join((ast.get_source_segment(self.text, node) or "").split())

    def words(self, node: ast.stmt) -> str:
        """The comment `#:` above a statement; an empty text if there is none."""
        lines = self.text.splitlines()
        first = node.lineno - 1
        while first > 0 and lines[first - 1].strip().startswith("#:"):
            first -= 1
        return " ".join(line.strip()[2:].strip() for line in lines[first : node.lineno - 1])

    def defined(self, name: str) -> ast.ClassDef | ast.FunctionDef:
        """The class or function of this name."""
        for node in self.tree.body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name:
                return node
        raise LookupError(f"{self.name} defines no {name}")


@functools.cache
def source(module: str) -> Source:
    """A module by its name."""
    *_, last = module.split(".")
    folder = Path(kalfit.__file__).parent
    path = folder / ("__init__.py" if module == "kalfit" else f"{last}.py")
    text = path.read_text(encoding="utf-8")
    return Source(module, text, ast.parse(text))


def home(name: str) -> str:
    """The module that defines a public name."""
    if name.startswith("spark."):
        return "kalfit.spark"
    for node in source("kalfit").tree.body:
        if isinstance(node, ast.ImportFrom) and name in [alias.name for alias in node.names]:
            return str(node.module)
    raise LookupError(f"kalfit imports no {name}")


def line(name: str) -> list[tuple[Source, ast.ClassDef]]:
    """A class of the package, and those that it inherits from."""
    found = []
    for kind in getattr(kalfit, name).__mro__:
        if kind.__module__.split(".")[0] == "kalfit":
            at = source(home(kind.__name__) if kind.__module__ == "kalfit" else kind.__module__)
            node = at.defined(kind.__name__)
            assert isinstance(node, ast.ClassDef)
            found.append((at, node))
    return found


def marks(node: ast.FunctionDef) -> set[str]:
    """The decorators of a function, by name."""
    return {mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)}


def is_property(node: ast.FunctionDef) -> bool:
    """Whether a method is read like an attribute."""
    return bool(marks(node) & {"property", "cached_property"})


def target(node: ast.stmt) -> ast.expr | None:
    """What a statement gives a value or a type."""
    if isinstance(node, ast.AnnAssign):
        return node.target
    return node.targets[0] if isinstance(node, ast.Assign) else None


def methods(name: str) -> dict[str, tuple[Source, ast.FunctionDef]]:
    """The public methods of a class: its own, then inherited ones."""
    found: dict[str, tuple[Source, ast.FunctionDef]] = {}
    for at, own in line(name):
        for node in own.body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not is_property(node):
                found.setdefault(node.name, (at, node))
    return found


@dataclass(frozen=True)
class Attribute:
    """An attribute or a property of a class."""

    name: str
    kind: str
    words: str


def attributes(name: str) -> list[Attribute]:
    """The public attributes and properties of a class: inherited ones, then its own."""
    found: dict[str, Attribute] = {}
    for at, own in reversed(line(name)):
        for one in own_attributes(at, own):
            found[one.name] = one
            if not one.words or not one.kind:
                raise LookupError(f"{at.name}: {own.name}.{one.name} has no type, or no words above it or in its docstring")
    return list(found.values())


def own_attributes(at: Source, own: ast.ClassDef) -> Iterator[Attribute]:
    """What the body of a class declares, and what its `__init__` sets."""
    for node in own.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and not node.target.id.startswith("_"):
            yield Attribute(node.target.id, at.written(node.annotation), at.words(node))
        elif isinstance(node, ast.FunctionDef) and node.name == "__init__":
            yield from set_attributes(at, node)
        elif isinstance(node, ast.FunctionDef) and is_property(node) and not node.name.startswith("_"):
            kind = "" if node.returns is None else at.written(node.returns)
            yield Attribute(node.name, kind, ast.get_docstring(node) or "")


def set_attributes(at: Source, init: ast.FunctionDef) -> Iterator[Attribute]:
    """What `__init__` sets; an attribute without a type has that of the argument which becomes its value."""
    types = {one.arg: at.written(one.annotation) for one in init.args.args if one.annotation is not None}
    for node in init.body:
        place = target(node)
        if isinstance(place, ast.Attribute) and not place.attr.startswith("_"):
            assert isinstance(node, (ast.AnnAssign, ast.Assign))
            value = node.value.id if isinstance(node.value, ast.Name) else ""
            kind = at.written(node.annotation) if isinstance(node, ast.AnnAssign) else types.get(value, "")
            yield Attribute(place.attr, kind, at.words(node))


# Signatures.


def signature(called: str, at: Source, node: ast.FunctionDef, *, method: bool) -> str:
    """A signature on one line, or on as many as it has arguments."""
    given = node.args
    assert not given.posonlyargs and given.vararg is None, "no public function has such arguments"
    defaults = [*[None] * (len(given.args) - len(given.defaults)), *given.defaults]
    parts = [argument(at, one, default) for one, default in zip(given.args, defaults, strict=True)][method:]
    if given.kwonlyargs:
        parts.append("*")
    parts += [argument(at, one, default) for one, default in zip(given.kwonlyargs, given.kw_defaults, strict=True)]
    if given.kwarg is not None:
        parts.append("**" + argument(at, given.kwarg, None))
    result = "" if node.returns is None or node.name == "__init__" else f" -> {at.written(node.returns)}"
    short = f"{called}({', '.join(parts)}){result}"
    if len(short) <= WIDTH:
        return short
    return "\n".join([f"{called}(", *(f"    {part}," for part in parts), f"){result}"])


def argument(at: Source, one: ast.arg, default: ast.expr | None) -> str:
    """An argument with its type and its default."""
    kind = "" if one.annotation is None else f": {at.written(one.annotation)}"
    return one.arg + kind + ("" if default is None else f" = {at.written(default)}")


# Docstrings become Markdown.

_CODE = re.compile(r"``(.+?)``", re.DOTALL)
_ROLE = re.compile(r":(func|class|meth|attr):`([^`]+)`")
#: Spaces that no line is broken at: within code and links, and before what would begin a list or a heading.
_KEPT = re.compile(r"`[^`]*`|\[[^\]]*\]\([^)]*\)")
_BEGINS = re.compile(r" (?=(?:[-+*#>|]|\d+[.)]) )")
_BLANK = "\0"


def slug(heading: str) -> str:
    """The anchor that mdBook makes of a heading."""
    kept = re.sub(r"[^\w\- ]", "", heading.lower())
    return kept.replace(" ", "-")


def heading_of(name: str) -> str:
    """The heading of a public name; that of a class differs from that of a function in more than a capital letter."""
    return f"class kalfit.{name}" if isinstance(thing(name), type) else f"kalfit.{name}"


def thing(name: str) -> object:
    """What has a public name."""
    return getattr(kalfit.spark, name.partition(".")[2]) if name.startswith("spark.") else getattr(kalfit, name)


def linked(role: str, target: str, owner: str | None) -> str:
    """A name that a docstring refers to, as a link; `owner` is the class that the docstring is of."""
    name = target.removeprefix("kalfit.")
    if role == "attr":
        return f"`{name}`"
    if role == "meth":
        of, _, method = name.rpartition(".")
        of = of or str(owner)
        if method not in methods(of):
            raise LookupError(f"a docstring refers to {of}.{method}, which does not exist")
        shown = method if of == owner else f"{of}.{method}"
        return f"[`{shown}`](#{slug(f'{of}.{method}')})"
    if not any(name in section.names for section in SECTIONS):
        raise LookupError(f"a docstring refers to {target}, which is not on the page")
    return f"[`kalfit.{name}`](#{slug(heading_of(name))})"


def inline(text: str, owner: str | None) -> str:
    """A text of a docstring on one line: its code and its references in Markdown."""
    text = " ".join(text.split())
    outside = _ROLE.sub("", _CODE.sub("", text))
    if re.search(r"[<>*\[\]`]", outside):
        raise ValueError(f"outside code, `<`, `*`, `[` and backticks mean something in Markdown: {text}")
    text = _CODE.sub(r"`\1`", text)
    return _ROLE.sub(lambda match: linked(match[1], match[2], owner), text)


def wrapped(text: str, first: str = "", rest: str = "") -> str:
    """A paragraph in lines; `first` and `rest` stand before them."""
    kept = _KEPT.sub(lambda match: match[0].replace(" ", _BLANK), text)
    kept = _BEGINS.sub(_BLANK, kept)
    lines = textwrap.wrap(
        kept, WIDTH, initial_indent=first, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines).replace(_BLANK, " ")


def markdown(docstring: str, owner: str | None = None) -> str:
    """A docstring in Markdown: paragraphs, lists, examples, blocks of code."""
    parts = []
    blocks = re.split(r"\n(?:[ \t]*\n)+", docstring.strip("\n"))
    for place, block in enumerate(blocks):
        if block.startswith(".. code-block::"):
            continue  # the block behind it says what it is
        if block.startswith(">>> "):
            parts.append(code(block))
        elif block.startswith("   "):
            directive = re.match(r"\.\. code-block:: (\w+)", blocks[place - 1])
            parts.append(code(textwrap.dedent(block), directive[1] if directive else "python"))
        elif block.startswith("- "):
            points = re.split(r"\n(?=- )", block)
            parts.append("\n".join(wrapped(inline(point[2:], owner), "- ", "  ") for point in points))
        else:
            parts.append(wrapped(inline(block, owner)))
    return "\n\n".join(parts)


def first_sentence(docstring: str) -> str:
    """What a name is, in a sentence."""
    paragraph = " ".join(re.split(r"\n[ \t]*\n", docstring.strip())[0].split())
    protected = _CODE.sub(lambda match: match[0].replace(" ", _BLANK), paragraph)
    return re.split(r"(?<=\.) ", protected)[0].replace(_BLANK, " ")


def code(text: str, language: str = "python") -> str:
    """A block of code."""
    return f"```{language}\n{text}\n```"


def cell(text: str) -> str:
    """A text in a table."""
    return text.replace("|", "\\|")


def table(*heads: str, rows: list[str]) -> str:
    """A table of rows that are made."""
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *rows])


# The page.


def documented(name: str) -> str:
    """The docstring of a public name."""
    module = home(name)
    if module == "kalfit._kalfit":
        return str(thing(name).__doc__)
    node = source(module).defined(name.rpartition(".")[2])
    found = ast.get_docstring(node)
    if not found:
        raise LookupError(f"kalfit.{name} has no docstring")
    return found


def title_of(path: str) -> str:
    """The title of a page of the book, or the words of a heading in it."""
    path, _, anchor = path.partition("#")
    lines = (BOOK / path).read_text(encoding="utf-8").splitlines()
    headings = [text.lstrip("#").strip() for text in lines if re.match(r"#+ ", text)]
    return next(text for text in headings if not anchor or slug(text) == anchor)


def see(name: str) -> list[str]:
    """Links to the pages that say more."""
    links = [f"[{title_of(path)}](../{path})".replace("(../reference/", "(") for path in SEE.get(name, ())]
    return [wrapped(f"See {' and '.join(links)}.")] if links else []


def function(name: str) -> list[str]:
    """The part of the page on a function."""
    at = source(home(name))
    node = at.defined(name.rpartition(".")[2])
    assert isinstance(node, ast.FunctionDef)
    shown = signature(f"kalfit.{name}", at, node, method=False)
    return [f"### {heading_of(name)}", code(shown), markdown(documented(name)), *see(name)]


def called(name: str) -> list[str]:
    """How users make a class, or what an exception is a kind of."""
    base = getattr(kalfit, name).__bases__[0]
    if issubclass(base, BaseException):
        return [code(f"class kalfit.{name}({base.__name__})")]
    if name not in CALLED:
        return []
    at, own = line(name)[0]
    init = next(node for node in own.body if isinstance(node, ast.FunctionDef) and node.name == "__init__")
    return [code(signature(f"kalfit.{name}", at, init, method=True))]


def class_(name: str) -> list[str]:
    """The part of the page on a class."""
    parts = [f"### {heading_of(name)}", *called(name), markdown(documented(name), name), *see(name)]
    if home(name) == "kalfit._kalfit":
        return parts
    rows = [f"| `{one.name}` | `{cell(one.kind)}` | {cell(inline(one.words, name))} |" for one in attributes(name)]
    if rows:
        parts.append(table("attribute", "type", "meaning", rows=rows))
    for own, (at, node) in methods(name).items():
        words = ast.get_docstring(node)
        if not words:
            raise LookupError(f"{at.name}: {name}.{own} has no docstring")
        before = "classmethod " if "classmethod" in marks(node) else ""
        shown = signature(f"{before}{name}.{own}", at, node, method=True)
        parts += [f"#### {name}.{own}", code(shown), markdown(words, name)]
    return parts


def section(own: Section) -> list[str]:
    """A section of the page: its words, a table of its names, and each of them."""
    parts = [f"## {own.heading}"]
    if own.words:
        parts.append(markdown(own.words))
    if own.heading in MODULES:
        parts.append(markdown(ast.get_docstring(source(MODULES[own.heading]).tree) or ""))
    whats = [cell(inline(first_sentence(documented(name)), name)) for name in own.names]
    rows = [f"| [`{name}`](#{slug(heading_of(name))}) | {what} |" for name, what in zip(own.names, whats, strict=True)]
    parts.append(table("name", "what it is", rows=rows))
    for name in own.names:
        parts += class_(name) if isinstance(thing(name), type) else function(name)
    return parts


def types() -> list[str]:
    """The types that signatures name."""
    rows = []
    for name, module in TYPES.items():
        at = source(module)
        nodes = [(node, target(node)) for node in at.tree.body]
        words = next(at.words(node) for node, place in nodes if isinstance(place, ast.Name) and place.id == name)
        if not words:
            raise LookupError(f"{module}: {name} has no words above it")
        shown = f"kalfit.{name}" if name in kalfit.__all__ else name
        rows.append(f"| `{shown}` | {cell(inline(words, None))} |")
    numpy = wrapped("`ArrayLike` is that of numpy: an array, or nested lists of numbers.")
    return ["## Types in signatures", table("name", "what it is", rows=rows), numpy]


def complete() -> None:
    """Each public name stands on the page once."""
    listed = [name for own in SECTIONS for name in own.names if not name.startswith("spark.")]
    listed += [name for name in TYPES if name in kalfit.__all__] + ["__version__"]
    if sorted(listed) != sorted(kalfit.__all__):
        different = ", ".join(sorted({*listed} ^ {*kalfit.__all__})) or "a name that is listed twice"
        raise LookupError(f"the sections of the page and kalfit.__all__ differ in {different}")


def page() -> str:
    """The page, as a text."""
    complete()
    parts = [HEAD.rstrip("\n")]
    for own in SECTIONS:
        parts += section(own)
    text = "\n\n".join([*parts, *types()]) + "\n"
    for shown in text.splitlines():
        if len(shown) > WIDTH and not shown.startswith("|"):
            raise ValueError(f"a line has {len(shown)} characters, expected at most {WIDTH}: {shown}")
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8", newline="\n")
    print(f"Wrote {PAGE}")
