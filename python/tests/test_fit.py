"""Fits are those of the command, whatever the data come in."""

from pathlib import Path

import json
import pickle

import numpy as np
import pandas
import polars
import pyarrow
import pyarrow.parquet
import pytest

import kalfit
from conftest import BENCH, META, PHASES, SLEEP, steady


@pytest.mark.parametrize("example", [BENCH, SLEEP, META, PHASES])
def test_a_fit_is_the_command_s_to_the_bit(example, command):
    assert steady(kalfit.fit(*example).to_dict()) == command("fit", *example)


def test_options_are_the_command_s(command):
    found = kalfit.fit(
        *SLEEP, set={"sigma": 25}, criterion="reml", solver="em", tolerance=1e-6, deletion="none", innovations=False
    )
    options = "--set sigma=25 --criterion reml --solver em --tolerance 1e-6 --deletion none --innovations off"
    assert steady(found.to_dict()) == command("fit", *SLEEP, *options.split())
    found = kalfit.fit(*SLEEP, method="innovations", intervals="profile", starts=2, seed=5, max_iterations=300)
    options = "--method innovations --intervals profile --starts 2 --seed 5 --max-iterations 300"
    assert steady(found.to_dict()) == command("fit", *SLEEP, *options.split())


def test_the_file_is_the_json(tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    text = (tmp_path / "fit.json").read_text()
    assert text == fit.to_json()
    assert kalfit.Fit.load(tmp_path / "fit.json") == fit == kalfit.Fit.from_json(text)
    fit.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == text
    assert pickle.loads(pickle.dumps(fit)) == fit


def test_the_report_is_that_of_the_command(tmp_path):
    fit = kalfit.fit(*BENCH)
    fit.save(tmp_path / "fit.json")
    fit.report(tmp_path / "fit.html")
    page = (tmp_path / "fit.html").read_text()
    assert page.startswith("<!DOCTYPE html>") and "g_sensitivity" in page
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.html", "fit.json"]
    with pytest.raises(OSError):
        fit.report(tmp_path / "no-such-folder" / "fit.html")


@pytest.mark.parametrize("model, path", [BENCH, PHASES])
def test_tables_of_every_kind_and_files_give_the_same_bits(model, path, tmp_path):
    expected = steady(kalfit.fit(model, path).to_dict(), files=False)
    polars_table = polars.read_csv(path, infer_schema_length=None)
    pandas_table = pandas.read_csv(path)
    arrow_table = pyarrow.Table.from_pandas(pandas_table)
    chunks = pyarrow.concat_tables([arrow_table.slice(start, 50) for start in range(0, len(arrow_table), 50)])
    pyarrow.parquet.write_table(arrow_table, tmp_path / "data.parquet")
    polars_table.write_ipc(tmp_path / "data.arrow")
    given = {
        "polars": polars_table,
        "polars, texts as categories": polars_table.with_columns(polars.col(polars.String).cast(polars.Categorical)),
        "pandas": pandas_table,
        "pyarrow": arrow_table,
        "pyarrow in chunks": chunks,
        "a reader of batches": arrow_table.to_reader(),
        "parquet": tmp_path / "data.parquet",
        "arrow": [tmp_path / "data.arrow"],
        "a pattern": str(tmp_path / "*.parquet"),
    }
    for name, data in given.items():
        assert steady(kalfit.fit(model, data).to_dict(), files=False) == expected, name


def test_tests_may_be_split_over_tables_and_files(tmp_path):
    whole = polars.read_csv(BENCH[1], infer_schema_length=None)
    first, rest = whole.filter(polars.col("unit") <= "g10"), whole.filter(polars.col("unit") > "g10")
    rest.write_csv(tmp_path / "rest.csv")
    fit = kalfit.fit(BENCH[0], [first, tmp_path / "rest.csv"])
    assert steady(fit.to_dict(), files=False) == steady(kalfit.fit(*BENCH).to_dict(), files=False)
    assert fit.to_dict()["data"]["files"] == ["data[0]", str(tmp_path / "rest.csv")]


def test_the_number_of_threads_changes_no_bit():
    assert steady(kalfit.fit(*SLEEP, threads=1).to_dict()) == steady(kalfit.fit(*SLEEP, threads=2).to_dict())


def test_figures_of_a_fit_are_those_of_its_json():
    fit = kalfit.fit(*SLEEP)
    record = json.loads(fit.to_json())
    phase = record["phases"][0]
    assert fit.states == ["intercept", "slope"] and fit.phases[0].units == ["ms", "ms/day"]
    assert fit.mean.tolist() == phase["mean"]["estimate"] and fit.mean.shape == (2,)
    assert fit.covariance.tolist() == phase["covariance"]["estimate"] and fit.covariance.dtype == np.float64
    assert fit.std_dev.tolist() == phase["std_dev"]["estimate"]
    assert fit.correlation.tolist() == phase["correlation"]["estimate"]
    assert fit.phases[0].correlation_std_error[0, 0] is np.ma.masked
    assert (fit.log_likelihood, fit.aic, fit.bic) == (record["log_likelihood"], record["aic"], record["bic"])
    assert (fit.converged, fit.reason, fit.certificate) == (True, record["reason"], record["certificate"])
    assert fit.free_parameters == 6 and fit.constraints == record["constraints"]
    sigma = fit.parameters["sigma"]
    assert (sigma.estimate, sigma.unit, sigma.fixed, len(fit.parameters)) == (record["parameters"][0]["estimate"], "ms", False, 1)
    assert [test.id for test in fit.tests] == [test["id"] for test in record["tests"]]
    assert fit.tests[0].means["main"].tolist() == record["tests"][0]["phases"][0]["mean"]
    assert repr(fit).startswith("<kalfit.Fit 'Reaction time under sleep deprivation': converged, log-likelihood")
    assert fit.summary(width=60) != fit.summary() == str(fit)


def test_what_is_unknown_is_masked_and_says_why():
    rows = polars.read_csv(SLEEP[1])
    model = {
        "data": {"test": "Subject"},
        "states": {"intercept": {}, "slope": {}, "dark": {}},
        "measurements": {"y": {"column": "Reaction", "equation": "intercept + slope * Days + 0 * dark", "noise": 25}},
        "mean": {"fixed": {"intercept": 250}},
        "covariance": {"fixed": {"intercept, slope": 0}},
    }
    phase = kalfit.fit(model, rows).phases[0]
    error = phase.mean_std_error
    assert error.mask.tolist() == [True, False, True] and error.tolist()[0] is None
    assert not np.isnan(error.data).any(), "no NaN lies under the mask"
    assert (phase.mean / error).mask.tolist() == [True, False, True], "what is calculated from the unknown is unknown"
    assert np.isnan(error.filled()).tolist() == [True, False, True], "NaN only for who asks for it"
    assert str(error).startswith("[-- ")
    assert phase.why_unknown("mean", "intercept") == "it is fixed"
    assert phase.why_unknown("mean", "slope") is None
    assert phase.why_unknown("mean", "dark") == "no test observes `dark`"
    assert phase.why_unknown("covariance", "intercept", "slope") == "it is fixed"
    assert phase.why_unknown("correlation", "slope", "slope") == "it is 1 by definition"
    assert "observes `dark`" in phase.why_unknown("std_dev", "dark")
    assert phase.covariance_std_error.mask[0, 1] and not phase.covariance_std_error.mask[0, 0]
    with pytest.raises(KeyError, match="there are intercept, slope, dark"):
        phase.why_unknown("mean", "light")
    with pytest.raises(ValueError, match="what is 'median'"):
        phase.why_unknown("median", "slope")


def test_a_singular_covariance_keeps_the_standard_errors_of_its_rank():
    fit = kalfit.fit("examples/mimu4444/gyro_x.toml", "examples/mimu4444/gyro_x.csv", innovations=False, deletion="none")
    phase = fit.phases[0]
    assert not phase.std_dev_std_error.mask.any() and not phase.mean_std_error.mask.any()
    assert phase.why_unknown("std_dev", "bias") is None
    record = fit.to_dict()
    record["phases"][0]["std_dev"]["std_error"][0] = None
    phase = kalfit.Fit.from_json(json.dumps(record)).phases[0]
    assert phase.why_unknown("std_dev", "bias") == "it is on the boundary: the covariance is singular, of rank 2 of 4"


def test_an_interval_without_an_end_has_none_there():
    record = kalfit.fit(*SLEEP).to_dict()
    record["parameters"][0]["interval95"] = [20.0, None]
    assert kalfit.Fit.from_json(json.dumps(record)).parameters["sigma"].interval95 == (20.0, None)


def test_a_fit_of_phases_says_which_to_ask():
    fit = kalfit.fit(*PHASES)
    assert [phase.name for phase in fit.phases] == ["align", "flight"]
    assert fit.phase("flight").mean.shape == (3,)
    with pytest.raises(ValueError, match=r"phases 'align', 'flight'.*fit\.phase\('align'\)\.mean"):
        fit.mean
    with pytest.raises(KeyError, match="there are align, flight"):
        fit.phase("landing")


def test_a_model_is_the_same_from_a_file_a_text_and_a_dictionary():
    text = Path(SLEEP[0]).read_text(encoding="utf-8")
    table = {
        "data": {"test": "Subject"},
        "states": {"intercept": {"unit": "ms"}, "slope": {"unit": "ms/day"}},
        "measurements": {"reaction": {"column": "Reaction", "equation": "intercept + slope * Days", "noise": "sigma"}},
        "parameters": {"sigma": {"start": np.float64(20), "unit": "ms"}},
    }
    fits = [kalfit.fit(model, SLEEP[1]) for model in (SLEEP[0], kalfit.Model.from_text(text), table)]
    assert len({fit.log_likelihood for fit in fits}) == 1
    model = kalfit.Model.load(SLEEP[0])
    assert model.text == text and model.parameters == ["sigma"] and model.test == "Subject" and model.time is None
    assert pickle.loads(pickle.dumps(model)) == model
    assert "Reaction" in model.describe()


def test_texts_that_need_quotes_survive_the_way_through_a_dictionary():
    hostile = 'a "quoted" \\ name\n\t\x7f\N{LATIN SMALL LETTER E WITH ACUTE}'
    model = {
        "title": hostile,
        "data": {"test": hostile, "missing": ["."]},
        "states": {"level": {}},
        "measurements": {"y": {"column": "y", "equation": "level", "noise": 1}},
        "covariance": {"fixed": {"level, level": 2.5}},
    }
    assert kalfit.Model(model).title == hostile
    fit = kalfit.fit(model, polars.DataFrame({hostile: ["a", "b", "c"], "y": [1.0, None, 4.0]}))
    assert fit.title == hostile and fit.covariance.tolist() == [[2.5]]


def test_the_model_check_and_groups_are_those_of_the_command():
    bench = "examples/gyro-bench/bench.toml", "examples/gyro-bench/bench.csv"
    fit = kalfit.fit(*bench, group_test=True)
    assert (fit.model_check["verdict"], fit.model_check["findings"]) == ("passed", [])
    assert [remark["kind"] for remark in fit.model_check["remarks"]] == ["influence"]
    assert "model check: passed" in fit._repr_html_()
    assert [(group["group"], group["tests"]) for group in fit.by_group] == [("A", 15), ("B", 13)]
    assert {test.group for test in fit.tests} == {"A", "B"}
    assert fit.group_test is not None and fit.group_test["degrees_of_freedom"] == 9
    assert kalfit.fit(*bench, deletion="none").group_test is None
