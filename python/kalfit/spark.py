"""Ensembles too large for one machine: rows stay on a Spark cluster, and a fit asks for sums over them, free parameters included.

    fit = kalfit.spark.fit(model, frame)              # a Spark DataFrame of rows, or of reductions
    reductions = kalfit.spark.reduce(model, frame)    # a Spark DataFrame, a row for each test and phase
    tests = kalfit.spark.apply(model, frame, fit)     # a Spark DataFrame, a row for each test and phase

Partitions hold whole tests, and of a model with levels whole groups of the outermost level; where they do not, the frame is
repartitioned by them. All is done by ``DataFrame.mapInArrow`` on whole partitions, so that Spark Connect will do, and whatever a lost
executor takes along is made again from the frame.

Executors need kalfit, and the pyarrow and pandas that Spark's Arrow functions ask for. Nothing of Spark is imported before it is needed.
"""

from __future__ import annotations

import json
import sys
import uuid
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal

from kalfit import _kalfit
from kalfit._data import Table
from kalfit._fit import Fit, warn_unless_converged
from kalfit._given import Set, source_text
from kalfit._made import Made
from kalfit._model import Model, ModelLike, Path, as_model, assignments
from kalfit._progress import Progress, Step, telling

__all__ = ["apply", "fit", "reduce"]

#: The columns of reductions with their types in Spark, and what the reductions say of themselves, which Spark would lose.
_COLUMNS: dict[str, str] = {
    "test": "string",
    "phase": "string",
    "states": "array<string>",
    "constant": "double",
    "data": "array<double>",
    "factor": "array<double>",
    "covariates": "array<double>",
    "path": "string",
    "design": "string",
    "steps": "bigint",
    "observations": "bigint",
    "terminal_states": "array<string>",
    "terminal_mean": "array<double>",
    "terminal_sensitivity": "array<double>",
    "terminal_root": "array<double>",
    "inherited_transition": "array<double>",
    "inherited_input": "array<double>",
    "groups": "array<string>",
}
_METADATA = "kalfit"
#: The column of reductions with the names of the groups of a test, the outermost first.
_GROUPS = "groups"
#: Number of a row's partition.
_PARTITION = "kalfit_partition"
#: More bytes than this are not one cell of Arrow's.
_LARGEST = (1 << 31) - (1 << 20)

_Text = tuple[str, str, Any]


def fit(
    model: ModelLike,
    frame: Any,
    at: Fit | Path | None = None,
    *,
    set: Set = None,
    order_by: str | Sequence[str] | None = None,
    criterion: Literal["ml", "reml"] = "ml",
    partitions: int | None = None,
    progress: Progress = False,
) -> Fit:
    """Fits a model to the rows of a Spark DataFrame, which stay on the cluster.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``frame``: a Spark DataFrame of rows, or of the reductions that :func:`kalfit.spark.reduce` made.
    - ``at``: a fit or its file, from which free parameters take their values; ``None`` estimates them too.
    - ``set``: values at which parameters are fixed, as in ``{"tau": 90}``, or ``{"sigma[A]": 0.7}`` at one level.
    - ``order_by``: columns by which the rows of a test are put in order, as Spark keeps none; ``None`` is the model's time.
    - ``criterion``: what is maximised: the likelihood (``"ml"``) or the restricted likelihood (``"reml"``).
    - ``partitions``: the frame is first repartitioned into so many; ``None`` leaves it as it is.
    - ``progress``: ``True`` writes a line to standard error; a function is called with a :class:`kalfit.Step` for each round.

    Partitions must hold whole tests, and of a model with levels whole groups of the outermost level; else the frame is
    repartitioned by these, and a line to standard error says so.

    Returns a :class:`kalfit.Fit` without results of single tests: :func:`kalfit.spark.apply` has them. It agrees with that of
    :func:`kalfit.fit` up to rounding, and two fits of the same partitions agree to the bit. Raises ``ValueError`` if the model names
    no column of tests, or no time and ``order_by`` is ``None``, and what :func:`kalfit.fit` raises.
    """
    known = as_model(model)
    values = [*([] if at is None else _values(known, at)), *assignments(set)]
    reduced = _METADATA in frame.columns and "factor" in frame.columns
    if reduced:
        values = [*_held(known, frame), *values]
    document = (known._document(), values)
    theta, asked = _kalfit.first_theta(document)
    packed = _packed(known, frame, [] if reduced else _order(known, frame, order_by), partitions, reduced)
    try:
        with telling(progress) as told:
            found = _searched(document, criterion, (theta, asked), _Rounds(packed, document), told)
    finally:
        packed.unpersist()
    found._made = Made(model, set, None, {}, None)
    warn_unless_converged(found)
    return found


def _searched(
    document: tuple[_Text, list[str]], criterion: str, first: tuple[str, str], ask: _Rounds, told: Callable[[Step], object] | None
) -> Fit:
    """The fit, after as many rounds as it takes."""
    theta, asked = first
    for round in range(1, sys.maxsize):
        if told is not None:
            told(Step(f"round {round}: sums over the tests"))
        after, results = _kalfit.join(document, criterion, theta, ask.sums(asked), (None, None))
        if results is not None:
            return Fit(results)
        assert after is not None, "a search goes on, or it has ended"
        theta, asked = after
    raise AssertionError("a search ends")


def reduce(
    model: ModelLike,
    frame: Any,
    *,
    at: Fit | Path | None = None,
    set: Set = None,
    order_by: str | Sequence[str] | None = None,
    partitions: int | None = None,
) -> Any:
    """Runs the filters over a Spark DataFrame of rows at known parameters, partition by partition.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``frame``: a Spark DataFrame of rows.
    - ``at``: a fit or its file, from which free parameters of the model take their values.
    - ``set``: values at which parameters are fixed, as in :func:`kalfit.spark.fit`.
    - ``order_by``, ``partitions``: as in :func:`kalfit.spark.fit`.

    Returns a Spark DataFrame of reductions with a row for each test and phase, which :func:`kalfit.spark.fit` takes.
    """
    known = as_model(model)
    document, source = (known._document(), assignments(set)), None if at is None else source_text(at)
    packed = _packed(known, frame, _order(known, frame, order_by), partitions)
    schema = ", ".join(f"{name} {kind}" for name, kind in {**_COLUMNS, _METADATA: "string"}.items())

    def reductions(batches: Iterable[Any]) -> Iterator[Any]:
        return _reductions(batches, document, source)

    return packed.mapInArrow(reductions, schema)


def apply(
    model: ModelLike,
    frame: Any,
    source: Fit | ModelLike,
    *,
    set: Set = None,
    order_by: str | Sequence[str] | None = None,
    partitions: int | None = None,
) -> Any:
    """Applies a fitted model to the tests of a Spark DataFrame of rows. Nothing is estimated, and nothing is collected.

    - ``model``: a :class:`kalfit.Model`, the path of a model file, or a dictionary of its tables.
    - ``frame``: a Spark DataFrame of rows.
    - ``source``: where mean, covariance and parameters come from: a fit, its file, or a model with fixed or start values.
    - ``set``: values at which parameters are fixed, as in :func:`kalfit.spark.fit`.
    - ``order_by``, ``partitions``: as in :func:`kalfit.spark.fit`.

    Returns a Spark DataFrame with a row for each test and phase, and the columns of ``.tests`` of :class:`kalfit.Applied`.
    """
    from pyspark.sql import functions
    from pyspark.sql.pandas.types import from_arrow_schema

    known = as_model(model)
    document, text = (known._document(), assignments(set)), source_text(source)
    order = _order(known, frame, order_by)
    first = frame.select(known.test).where(functions.col(str(known.test)).isNotNull()).limit(1).collect()
    if not first:
        raise _kalfit.DataError("the frame has no rows")
    one = _pack_frame(known, frame.where(functions.col(str(known.test)) == first[0][0]).coalesce(1), order).collect()
    schema = _applied(_table(one[0]["rows"]), document, text).schema
    packed = _packed(known, frame, order, partitions)

    def tests(batches: Iterable[Any]) -> Iterator[Any]:
        for _, rows in _cells(batches):
            yield from _applied(_table(rows), document, text).to_batches()

    return packed.mapInArrow(tests, from_arrow_schema(schema))


def _order(model: Model, frame: Any, order_by: str | Sequence[str] | None) -> list[str]:
    """The columns that rows of a test are put in order by."""
    if model.test is None:
        raise ValueError("the model names no column that tells tests apart: set `test` in its [data]")
    order = [order_by] if isinstance(order_by, str) else list(order_by or [])
    if not order and model.time is None:
        raise ValueError("the model names no column of time, and Spark keeps no order of rows: name the columns of `order_by`")
    order = order or [str(model.time)]
    for column in (*model.levels, model.test, *order):
        if column not in frame.columns:
            raise _kalfit.DataError(f"the frame has no column {column!r}, it has {', '.join(frame.columns)}")
    return order


def _values(model: Model, at: Fit | Path) -> list[str]:
    """The values of a fit for the parameters of a model, as they are assigned."""
    found = at if isinstance(at, Fit) else Fit.load(at)
    place = {True: "{0.name}={0.estimate!r}", False: "{0.name}[{0.level}]={0.estimate!r}"}
    known = [p for p in found.parameters if p.name in model.parameters and not p.fixed]
    return [place[p.level is None].format(p) for p in known]


def _held(model: Model, reductions: Any) -> list[str]:
    """The values at which filters made reductions, of the parameters that the model leaves open."""
    kinds = [json.loads(row[0]) for row in reductions.select(_METADATA).distinct().limit(2).collect()]
    if not kinds:
        raise _kalfit.DataError("there are no reductions")
    for other in kinds[1:]:
        key = next(key for key in {**kinds[0], **other} if kinds[0].get(key) != other.get(key))
        raise _kalfit.DataError(f"the reductions were made at different models or parameters: they differ in {key}")
    values = []
    for parameter in json.loads(kinds[0].get("kalfit.parameters", "[]")):
        if parameter.get("value") is not None and not parameter.get("per"):
            values.append(f"{parameter['name']}={parameter['value']!r}")
        for level, value in (parameter.get("levels") or {}).items():
            values.append(f"{parameter['name']}[{level}]={value!r}")
    return values


def _packed(model: Model, frame: Any, order: list[str], partitions: int | None, reduced: bool = False) -> Any:
    """One row of bytes for each partition of a frame, kept on the executors; partitions hold whole tests."""
    from pyspark.sql import functions

    whole = _whole(model, reduced)
    key = functions.col(whole)[0] if whole == _GROUPS and reduced else whole
    if partitions is not None:
        frame = frame.repartition(partitions, key)
    packed = _pack_frame(model, frame, order, reduced).persist()
    ids = packed.select(_PARTITION, functions.explode("whole").alias("id"))
    split = ids.groupBy("id").count().where("count > 1").limit(1).collect()
    if split:
        packed.unpersist()
        what = model.levels[0] if model.levels else "test"
        sys.stderr.write(f"kalfit: {what} {split[0][0]} is spread over partitions: the frame is repartitioned by {what}\n")
        packed = _pack_frame(model, frame.repartition(key), order, reduced).persist()
    return packed


def _whole(model: Model, reduced: bool) -> str:
    """The column of what a partition holds whole: groups of the outermost level, or tests."""
    if model.levels:
        return _GROUPS if reduced else model.levels[0]
    return "test" if reduced else str(model.test)


def _pack_frame(model: Model, frame: Any, order: list[str], reduced: bool = False) -> Any:
    from pyspark.sql import functions

    whole = _whole(model, reduced)
    if model.levels and not reduced:
        order = [*model.levels[1:], str(model.test), *order]
    numbered = frame.withColumn(_PARTITION, functions.spark_partition_id())

    def pack(batches: Iterable[Any]) -> Iterator[Any]:
        return _pack(batches, whole, order)

    return numbered.mapInArrow(pack, f"{_PARTITION} int, whole array<string>, rows binary")


class _Rounds:
    """What partitions answer, round by round. Processes that keep the tests of a partition are asked without its rows: Spark moves
    them only to those that do not."""

    def __init__(self, packed: Any, document: tuple[_Text, list[str]]) -> None:
        self._packed = packed
        self._document = document
        self._token = uuid.uuid4().hex
        self._begun = False
        self._keep = True  # until most partitions cannot be answered for without their rows

    def sums(self, theta: str) -> list[str]:
        """A text from each partition, in their order."""
        from pyspark.sql import functions

        told: dict[int, str | None] = {}
        if self._begun and self._keep:
            told = self._asked(self._packed.select(_PARTITION), theta)
        missing = [partition for partition, sums in told.items() if sums is None]
        self._keep &= 2 * len(missing) <= len(told)
        if not told:
            told = self._asked(self._packed, theta)
        elif missing:
            told |= self._asked(self._packed.where(functions.col(_PARTITION).isin(missing)), theta)
        self._begun = True
        return [str(told[partition]) for partition in sorted(told)]

    def _asked(self, frame: Any, theta: str) -> dict[int, str | None]:
        token, document = self._token, self._document

        def passes(batches: Iterable[Any]) -> Iterator[Any]:
            return _sums(batches, token, document, theta)

        return dict(frame.mapInArrow(passes, f"{_PARTITION} int, sums string").collect())


# What follows runs on executors.

#: Tests that this process has read, by fit and partition: it saves reading them again, and a process without them reads them.
_SITES: OrderedDict[tuple[str, int], _kalfit.Site] = OrderedDict()
_MOST_SITES = 16


def _pack(batches: Iterable[Any], whole: str, order: Sequence[str]) -> Iterator[Any]:
    """The rows of one partition, in order, as one cell of bytes: an Arrow stream."""
    import pyarrow
    import pyarrow.compute

    batches = [batch for batch in batches if batch.num_rows > 0]
    if not batches:
        return
    table = pyarrow.Table.from_batches(batches)
    partition = table.column(_PARTITION)[0].as_py()
    table = table.drop_columns([_PARTITION])
    if order:
        table = table.sort_by([(column, "ascending") for column in (whole, *order)])
    column = table.column(whole)
    if pyarrow.types.is_list(column.type):
        column = pyarrow.compute.list_element(column, 0)  # the outermost group of reductions
    ids = column.unique().drop_null().cast(pyarrow.string())
    sink = pyarrow.BufferOutputStream()
    with pyarrow.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    rows = sink.getvalue()
    if rows.size > _LARGEST:
        raise _kalfit.DataError(
            f"partition {partition} has {rows.size} bytes, expected at most {_LARGEST}: ask for more `partitions`; "
            "a single test that is larger is fitted on one machine, or in phases"
        )
    cells = [pyarrow.array([partition], pyarrow.int32()), _list(ids), pyarrow.array([rows.to_pybytes()], pyarrow.binary())]
    yield pyarrow.RecordBatch.from_arrays(cells, names=[_PARTITION, "whole", "rows"])


def _list(ids: Any) -> Any:
    import pyarrow

    ids = ids.combine_chunks() if isinstance(ids, pyarrow.ChunkedArray) else ids
    return pyarrow.ListArray.from_arrays(pyarrow.array([0, len(ids)], pyarrow.int32()), ids)


def _cells(batches: Iterable[Any]) -> Iterator[tuple[int, Any]]:
    """Number and rows of each partition that was packed; None where its rows did not come along."""
    for batch in batches:
        numbers = batch.column(_PARTITION).to_pylist()
        yield from zip(numbers, batch.column("rows") if "rows" in batch.schema.names else [None] * len(numbers))


def _table(cell: Any) -> Any:
    """The rows of a cell; of reductions with what they say of themselves."""
    import pyarrow

    source = cell.as_buffer() if hasattr(cell, "as_buffer") else pyarrow.py_buffer(cell)
    table = pyarrow.ipc.open_stream(source).read_all()
    if _METADATA not in table.column_names or "factor" not in table.column_names:
        return table
    kinds = table.column(_METADATA).unique().to_pylist()
    assert len(kinds) == 1, "that was seen before"
    return _kalfit.Table(table.drop_columns([_METADATA]), sorted(json.loads(kinds[0]).items()))


def _sums(batches: Iterable[Any], token: str, document: tuple[_Text, list[str]], theta: str) -> Iterator[Any]:
    """What each partition answers; nothing where its rows are neither kept nor told."""
    import pyarrow

    for partition, rows in _cells(batches):
        site = _site((token, partition), document, rows)
        answer = None if site is None else site.answer(theta)
        cells = [pyarrow.array([partition], pyarrow.int32()), pyarrow.array([answer], pyarrow.string())]
        yield pyarrow.RecordBatch.from_arrays(cells, names=[_PARTITION, "sums"])


def _site(key: tuple[str, int], document: tuple[_Text, list[str]], rows: Any) -> _kalfit.Site | None:
    """The tests of a partition, read if they are not kept."""
    site = _SITES.get(key)
    if site is None and rows is not None:
        site = _SITES[key] = _kalfit.Site(document, [(f"partition {key[1]}", _table(rows))], 1)
    if site is not None:
        _SITES.move_to_end(key)
    for other in [other for other in _SITES if other[0] != key[0]]:
        del _SITES[other]
    while len(_SITES) > _MOST_SITES:
        _SITES.popitem(last=False)
    return site


def _reductions(batches: Iterable[Any], document: tuple[_Text, list[str]], source: Any) -> Iterator[Any]:
    """The reductions of each partition."""
    import pyarrow

    kinds = {
        "string": pyarrow.string(),
        "double": pyarrow.float64(),
        "bigint": pyarrow.int64(),
        "array<string>": pyarrow.list_(pyarrow.string()),
        "array<double>": pyarrow.list_(pyarrow.float64()),
    }
    for _, rows in _cells(batches):
        # one name for all, which the reductions carry along
        made, *_ = _kalfit.exchange("reductions", document, [("data", _table(rows))], source, None, (1, None))
        assert made is not None, "no file was named"
        table = Table(made).to_pyarrow()
        cells = [_plain(table.column(name), kinds[kind]) for name, kind in _COLUMNS.items()]
        told = json.dumps(Table(made).metadata, sort_keys=True)
        cells.append(pyarrow.chunked_array([pyarrow.array([told] * table.num_rows, pyarrow.string())]))
        yield from pyarrow.table(dict(zip([*_COLUMNS, _METADATA], cells))).to_batches()


def _applied(rows: Any, document: tuple[_Text, list[str]], source: Any) -> Any:
    """What the tests of one partition say, in types that Spark knows."""
    import pyarrow

    _, made, _, _ = _kalfit.apply(document, [("partition", rows)], source, None, (None, None), (1, None))
    assert made is not None, "no file was named"
    table = Table(made).to_pyarrow()
    columns = {name: _plain(table.column(name), _known(table.schema.field(name).type)) for name in table.column_names}
    return pyarrow.table(columns)


def _known(kind: Any) -> Any:
    """The type in Spark's words: no dictionaries, no large lists, no unsigned numbers."""
    import pyarrow
    from pyarrow import types

    if types.is_dictionary(kind):
        return _known(kind.value_type)
    if types.is_large_string(kind) or types.is_string_view(kind):
        return pyarrow.string()
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return pyarrow.list_(_known(kind.value_type))
    return pyarrow.int64() if types.is_unsigned_integer(kind) else kind


def _plain(column: Any, kind: Any) -> Any:
    return column.cast(kind) if column.type != kind else column
