"""What of `kalfit.spark` runs on executors, without Spark, over partitions made by hand; and, where pyspark and Java are installed,
Spark itself."""

import os
import shutil
import sys
import uuid

import pandas
import pyarrow
import pytest

import kalfit
import kalfit.spark as spark
from conftest import BENCH, PHASES, SLEEP

PASTES = ("examples/levels/pastes.toml", "examples/levels/pastes.csv")

JAVA = shutil.which("java") is not None or "JAVA_HOME" in os.environ


def packed(model, rows, partitions=3):
    """The rows of whole tests in partitions, shuffled and packed as executors pack them."""
    known = kalfit.Model.load(model)
    whole = spark._whole(known, False)
    order = [*known.levels[1:], known.test] if known.levels else []
    order += [known.time] if known.time else []
    ids = list(rows[whole].unique())
    cells = []
    for number in range(partitions):
        own = rows[rows[whole].isin(ids[number::partitions])].sample(frac=1, random_state=3)
        table = pyarrow.Table.from_pandas(own.assign(kalfit_partition=number), preserve_index=False)
        cells += spark._pack(table.to_batches(max_chunksize=7), whole, order or ["Days"])
    return known, cells


def by_sums(known, cells, set=()):
    document, token = (known._document(), list(set)), uuid.uuid4().hex
    theta, asked = kalfit._kalfit.first_theta(document)
    for round in range(100):
        told = [batch.column("sums")[0].as_py() for cell in cells for batch in spark._sums([cell], token, document, asked)]
        after, results = kalfit._kalfit.join(document, "ml", theta, told, (None, None))
        if results is not None:
            return kalfit.Fit(results), round
        theta, asked = after
    raise AssertionError("no end after 100 rounds")


@pytest.mark.parametrize("model, path", [BENCH, PHASES, SLEEP, PASTES])
def test_sums_over_partitions_fit_as_all_rows_do(model, path):
    known, cells = packed(model, pandas.read_csv(path))
    found, _ = by_sums(known, cells)
    expected = kalfit.fit(model, path)
    assert found.converged and len(found.tests) == 0
    assert abs(found.log_likelihood - expected.log_likelihood) <= 1e-10 * abs(expected.log_likelihood)
    for one, other in zip(found.phases, expected.phases):
        assert abs(one.mean - other.mean).max() <= 1e-6 * abs(other.mean).max()
    again, _ = by_sums(known, cells)
    assert again.log_likelihood == found.log_likelihood


def test_an_executor_that_lost_its_tests_reads_them_again():
    known, cells = packed(BENCH[0], pandas.read_csv(BENCH[1]))
    document = (known._document(), [])
    _, asked = kalfit._kalfit.first_theta(document)
    once = [batch.to_pylist() for batch in spark._sums(cells, "one", document, asked)]
    assert len(spark._SITES) == 3
    spark._SITES.clear()
    assert [batch.to_pylist() for batch in spark._sums(cells, "one", document, asked)] == once


def test_rows_are_moved_only_to_where_they_are_not_kept():
    known, cells = packed(BENCH[0], pandas.read_csv(BENCH[1]))
    document = (known._document(), [])
    _, asked = kalfit._kalfit.first_theta(document)
    bare = [cell.select(["kalfit_partition"]) for cell in cells]

    def told(batches):
        return [batch.to_pylist()[0]["sums"] for batch in spark._sums(batches, "bare", document, asked)]

    assert told(bare) == [None, None, None]
    once = told(cells[:2])
    assert told(bare) == [*once, None] and None not in once


def test_what_spark_cannot_know_is_asked_for():
    model = {"states": {"a": {}}, "measurements": {"y": {"column": "y", "equation": "a", "noise": 1}}}
    with pytest.raises(ValueError, match="names no column that tells tests apart"):
        spark._order(kalfit.Model(model), None, None)
    with pytest.raises(ValueError, match="order_by"):
        spark._order(kalfit.Model({"data": {"test": "id"}, **model}), None, None)


@pytest.fixture(scope="module")
def session():
    sql = pytest.importorskip("pyspark.sql", reason="pyspark is not installed")
    os.environ["PYSPARK_PYTHON"] = sys.executable
    builder = sql.SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false")
    made = builder.config("spark.sql.shuffle.partitions", "3").getOrCreate()
    made.sparkContext.setLogLevel("ERROR")
    yield made
    made.stop()


@pytest.mark.skipif(not JAVA, reason="Spark needs Java, which is not installed")
@pytest.mark.filterwarnings("ignore")
class TestSparkItself:
    @pytest.mark.parametrize("model, path", [BENCH, PHASES, SLEEP])
    def test_fits_rows_and_reductions(self, session, model, path, capsys):
        frame = session.read.csv(path, header=True, inferSchema=True).repartition(4)  # tests in pieces
        order = None if kalfit.Model.load(model).time else "Days"
        expected = kalfit.fit(model, path)
        found = spark.fit(model, frame, order_by=order, progress=True)
        said = capsys.readouterr().err
        assert "is spread over partitions: the frame is repartitioned by test" in said
        assert "round 2: sums over the tests" in said
        assert abs(found.log_likelihood - expected.log_likelihood) <= 1e-10 * abs(expected.log_likelihood)
        assert found.converged
        at = expected if model == SLEEP[0] else None
        reductions = spark.reduce(model, frame, at=at, order_by=order)
        known = spark.fit(model, reductions)
        assert abs(known.log_likelihood - expected.log_likelihood) <= 1e-9 * abs(expected.log_likelihood)

    def test_groups_of_tests_stay_together(self, session, capsys):
        model, path = PASTES
        frame = session.read.csv(path, header=True, inferSchema=True).repartition(4)  # batches in pieces
        expected = kalfit.fit(model, path)
        found = spark.fit(model, frame, order_by="strength")
        assert "is spread over partitions: the frame is repartitioned by batch" in capsys.readouterr().err
        reductions = spark.reduce(model, frame, at=expected, order_by="strength")
        known = spark.fit(model, reductions.repartition(5))
        for other in (found, known):
            assert abs(other.log_likelihood - expected.log_likelihood) <= 1e-9 * abs(expected.log_likelihood)
            assert [level.groups for level in other.levels] == [level.groups for level in expected.levels]

    def test_applies_a_fit(self, session):
        model, path = BENCH
        frame = session.read.csv(path, header=True, inferSchema=True)
        source = kalfit.fit(model, path)
        found = spark.apply(model, frame, source).toPandas().sort_values("test", ignore_index=True)
        expected = kalfit.apply(model, path, source).tests.to_pandas().sort_values("test", ignore_index=True)
        assert list(found.columns) == list(expected.columns) and len(found) == len(expected)
        for column in expected.select_dtypes("number").columns:
            apart = abs(found[column].astype(float) - expected[column].astype(float))
            assert not (apart > 1e-9 * (1 + abs(expected[column].astype(float)))).any(), column

    def test_a_frame_without_the_columns_of_the_model_is_refused_before_anything_runs(self, session):
        frame = session.read.csv(BENCH[1], header=True, inferSchema=True).drop("hours")
        with pytest.raises(kalfit.DataError, match="the frame has no column 'hours', it has unit, station"):
            spark.fit(BENCH[0], frame)

    def test_reductions_of_different_models_do_not_mix(self, session):
        frame = session.read.csv(BENCH[1], header=True, inferSchema=True)
        with open(BENCH[0], encoding="utf-8") as file:
            other = kalfit.Model.from_text(file.read() + "\n# another\n")
        one = spark.reduce(BENCH[0], frame.where("unit = 'g01'")).union(spark.reduce(other, frame.where("unit = 'g02'")))
        with pytest.raises(kalfit.DataError, match="differ in kalfit.model_digest"):
            spark.fit(BENCH[0], one)
