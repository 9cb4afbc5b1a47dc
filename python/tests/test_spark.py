"""The part of `kalfit.spark` that runs on executors, without Spark, over a frame that stands in for Spark's; and, where pyspark and
Java are installed, Spark itself."""

import inspect
import os
import shutil
import sys
from pathlib import Path

import pandas
import pytest

import kalfit
import kalfit.spark
from conftest import BENCH, PHASES


class Frame:
    """Groups and applies as Spark does, in an order of its own."""

    def __init__(self, rows):
        self._rows = rows

    @property
    def columns(self):
        return list(self._rows.columns)

    def groupBy(self, column):
        return Groups(self._rows, column)

    def toPandas(self):
        return self._rows


class Groups:
    def __init__(self, rows, column):
        self._rows, self._column = rows, column

    def applyInPandas(self, function, schema):
        names = [part.split()[0] for part in schema.split(", ")]
        shuffled = self._rows.sample(frac=1, random_state=3)
        # Spark hands over the key too when a function has two arguments, and takes `self` of an object for one
        assert len(inspect.getfullargspec(function).args) == 1
        parts = [function(rows) for _, rows in shuffled.groupby(self._column, sort=False)]
        assert all(list(part.columns) == names for part in parts)
        return Frame(pandas.concat(parts, ignore_index=True))


@pytest.mark.parametrize("model, path", [BENCH, PHASES])
def test_reductions_by_group_fit_to_the_same_bits(model, path):
    reductions = kalfit.spark.reduce(model, Frame(pandas.read_csv(path)))
    found = kalfit.spark.fit(model, reductions)
    expected = kalfit.fit(model, path)
    assert abs(found.log_likelihood - expected.log_likelihood) <= 1e-12 * abs(expected.log_likelihood)
    for one, other in zip(found.phases, expected.phases):
        assert abs(one.mean - other.mean).max() <= 1e-9 * abs(other.mean).max()


@pytest.mark.skipif(shutil.which("java") is None and "JAVA_HOME" not in os.environ, reason="Spark needs Java")
@pytest.mark.filterwarnings("ignore")
def test_spark_itself_gives_the_same_fit(tmp_path, monkeypatch):
    sql = pytest.importorskip("pyspark.sql")
    monkeypatch.setenv("PYSPARK_PYTHON", sys.executable)
    session = sql.SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false").getOrCreate()
    try:
        for model, path in (BENCH, PHASES):
            expected = kalfit.fit(model, path).log_likelihood
            reductions = kalfit.spark.reduce(model, session.read.csv(str(path), header=True, inferSchema=True))
            assert abs(kalfit.spark.fit(model, reductions).log_likelihood - expected) <= 1e-12 * abs(expected)
            reductions.write.parquet(str(tmp_path / Path(path).stem))
            stored = session.read.parquet(str(tmp_path / Path(path).stem))
            assert abs(kalfit.spark.fit(model, stored).log_likelihood - expected) <= 1e-12 * abs(expected)
    finally:
        session.stop()


def test_a_frame_without_the_columns_of_the_model_is_refused_before_anything_runs():
    frame = Frame(pandas.read_csv(BENCH[1]).drop(columns="hours"))
    with pytest.raises(kalfit.DataError, match="the frame has no column 'hours', it has unit, station"):
        kalfit.spark.reduce(BENCH[0], frame)


def test_what_spark_cannot_know_is_asked_for():
    model = {"states": {"a": {}}, "measurements": {"y": {"column": "y", "equation": "a", "noise": 1}}}
    with pytest.raises(ValueError, match="names no column that tells tests apart"):
        kalfit.spark.reduce(model, None)
    with pytest.raises(ValueError, match="order_by"):
        kalfit.spark.reduce({"data": {"test": "id"}, **model}, None)
    rows = Frame(pandas.DataFrame({"id": ["a", "a", "b", "b"], "k": [1, 2, 1, 2], "y": [1.0, 2.0, 3.0, 5.0]}))
    reductions = kalfit.spark.reduce({"data": {"test": "id"}, **model}, rows, order_by="k")
    assert len(reductions.toPandas()) == 2


def test_reductions_of_different_models_do_not_mix():
    rows = pandas.read_csv(BENCH[1])
    one = kalfit.spark.reduce(BENCH[0], Frame(rows[rows.unit == "g01"])).toPandas()
    text = Path(BENCH[0]).read_text(encoding="utf-8") + "\n# another\n"
    other = kalfit.spark.reduce(kalfit.Model.from_text(text), Frame(rows[rows.unit == "g02"])).toPandas()
    with pytest.raises(kalfit.DataError, match="differ in kalfit.model_digest"):
        kalfit.spark.fit(BENCH[0], Frame(pandas.concat([one, other])))
    with pytest.raises(kalfit.DataError, match="there are no reductions"):
        kalfit.spark.fit(BENCH[0], Frame(one[:0]))
