"""The other commands."""

from pathlib import Path

import json

import numpy
import pandas
import polars
import pyarrow.parquet
import pytest

import kalfit
from conftest import BENCH, PHASES, SLEEP, steady

NULL = {"mean": {"fixed": {"bias": 0}}, "covariance": {"fixed": {"bias, scale": 0}}}
NULL_TEXT = '[mean]\nfixed = { bias = 0 }\n[covariance]\nfixed = { "bias, scale" = 0 }\n'


def test_a_hypothesis_is_tested_as_the_command_does_it(command, tmp_path):
    null = tmp_path / "null.toml"
    null.write_text(NULL_TEXT)
    expected = command("test", *BENCH, "--null", str(null), "--bootstrap", "20", "--seed", "3")
    found = kalfit.test(*BENCH, null, bootstrap=20, seed=3)
    assert steady(found.to_dict()) == expected
    assert found.p_value == expected["p_value"] and found.converged
    assert "hypothesis" in found.summary().lower()
    assert kalfit.test(*BENCH, NULL).statistic == found.statistic
    due = [kalfit.test(*BENCH, NULL, seed=seed).to_dict().get("bootstrap") for seed in (1, 5)]
    assert [own and own["seed"] for own in due] == [1, 5], "the seed is that of draws that are due"


def test_a_check_says_what_the_command_says():
    assert "scale" in kalfit.check(BENCH[0]).summary()
    found = kalfit.check(*BENCH)
    record = found.to_dict()
    assert record["checked"]["kind"] == "reduced" and record["checked"]["data"]["tests"] == 28
    assert "28 tests" in str(found)
    assert kalfit.check(*SLEEP).to_dict()["parameters"][0]["name"] == "sigma"


def test_the_best_plan_is_the_command_s(command, tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    saved = str(tmp_path / "fit.json")
    options = ["--from", saved, "--candidates", BENCH[1], "--budget", "9", "--for", "sd(bias)", "--with", saved]
    expected = command("plan", BENCH[0], *options)
    best = kalfit.plan(BENCH[0], tmp_path / "fit.json", candidates=BENCH[1], budget=9, goal="sd(bias)", so_far=saved)
    assert best.to_dict() == {key: value for key, value in expected.items() if key != "simulate"}, "the command names a file"
    own = kalfit.plan(BENCH[0], fit, candidates=BENCH[1], budget=9, goal="sd(bias)", so_far=fit).to_dict()
    assert own["candidates"] == expected["candidates"]
    frame = best.candidates_frame()
    assert frame["tests"].sum() == 9 and frame["tests"].max() > 0
    errors = best.quantities_frame().set_index("quantity")
    assert (errors["std_error[9]"] < errors["std_error_before"]).any()
    drawn = kalfit.simulate(BENCH[0], fit, BENCH[1], seed=1, plan=best)
    assert repr(drawn).startswith("<kalfit.Simulation: 9 tests")
    made = kalfit.plan(BENCH[0], fit, candidates=BENCH[1], budget=9, goal="sd(bias)", so_far=BENCH[1]).to_dict()
    flight = {"unit": ["x", "x"], "hours": [0.1, 0.2], "scale_input": [0.0, 0.05], "accel": [1.0, 1.0]}
    outputs = {"rate": "bias + scale * scale_input + g_sensitivity * accel"}
    served = kalfit.plan(
        BENCH[0], fit, candidates=BENCH[1], budget=9, goal="limit(rate, 2)", mission=flight, outputs=outputs, so_far=fit
    )
    limits = [row for row in served.to_dict()["quantities"] if row.get("parameter") == "limit(rate, 2)"]
    assert limits[0]["std_error"][0] < limits[0]["std_error_before"]
    assert made["information_so_far"] is not None
    for wrong in ({"budget": 0}, {"budget": 9, "draws": 0}, {"budget": 9, "tests": [5]}):
        with pytest.raises(ValueError, match="expected"):
            kalfit.plan(BENCH[0], fit, candidates=BENCH[1], **wrong)
    with pytest.raises(kalfit.Error, match="no figure of this model"):
        kalfit.plan(BENCH[0], fit, candidates=BENCH[1], budget=9, goal="sd(bais)")
    with pytest.raises(ValueError, match="expected a design"):
        kalfit.plan(BENCH[0], fit)


def test_a_plan_is_the_command_s(command, tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    expected = command("plan", BENCH[0], "--from", str(tmp_path / "fit.json"), "--design", BENCH[1], "--tests", "5,50")
    found = kalfit.plan(BENCH[0], tmp_path / "fit.json", BENCH[1], [5, 50])
    assert found.to_dict() == expected
    assert {**kalfit.plan(BENCH[0], fit, BENCH[1], [5, 50]).to_dict(), "from": None} == {**expected, "from": None}
    assert "50" in found.summary()
    with pytest.raises(ValueError, match="tests is"):
        kalfit.plan(BENCH[0], fit, BENCH[1], [])


def test_a_fit_is_applied_as_the_command_applies_it(command, tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    arguments = ("apply", *BENCH, "--from", str(tmp_path / "fit.json"), "--states", str(tmp_path / "s.csv"), "--kind", "filtered")
    path = command(*arguments, out="tests.csv")
    found = kalfit.apply(*BENCH, fit, states="filtered")
    assert found.tests.to_pandas().equals(pandas.read_csv(path))
    assert found.states.to_pandas().equals(pandas.read_csv(tmp_path / "s.csv"))
    assert found.log_density == pytest.approx(fit.log_likelihood, rel=1e-12)
    assert "agree with this population" in found.summary() and "28 tests" in repr(found)
    written = kalfit.apply(*BENCH, fit, out=tmp_path / "w.csv")
    assert written.tests is None and written.states is None and (tmp_path / "w.csv").read_text() == path.read_text()
    with pytest.raises(ValueError, match="states_out"):
        kalfit.apply(*BENCH, fit, states_out=tmp_path / "w.csv")
    with pytest.raises(ValueError, match="states is"):
        kalfit.apply(*BENCH, fit, states="guessed")


def test_missions_are_predicted_as_the_command_predicts_them(command, tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    outputs = tmp_path / "out.toml"
    outputs.write_text('[outputs.heading]\nequation = "bias + 10 * scale"\n', encoding="utf-8")
    arguments = ("predict", BENCH[0], "--from", str(tmp_path / "fit.json"), "--design", BENCH[1], "--outputs", str(outputs))
    path = command(*arguments, "--one-sided", out="p.csv")
    for given in (outputs, {"heading": "bias + 10 * scale"}, {"heading": {"equation": "bias + 10 * scale"}}):
        found = kalfit.predict(BENCH[0], fit, BENCH[1], outputs=given, one_sided=True)
        assert found.table.to_pandas().equals(pandas.read_csv(path))
    assert "28 tests" in found.summary() and "28 tests" in repr(found)
    same = fit.predict(BENCH[1], outputs=outputs, one_sided=True)
    assert same.table.to_pandas().equals(found.table.to_pandas())
    read = kalfit.Fit.load(tmp_path / "fit.json")
    assert read.predict(BENCH[1], model=BENCH[0]).to_dict()["rows"] == found.to_dict()["rows"]
    with pytest.raises(TypeError, match="does not know its model"):
        read.predict(BENCH[1])
    with pytest.raises(ValueError, match="content is 0.2"):
        kalfit.predict(BENCH[0], fit, BENCH[1], content=0.2)
    with pytest.raises(kalfit.ModelError, match="not linear"):
        kalfit.predict(BENCH[0], fit, BENCH[1], outputs={"wrong": "bias * scale"})


def test_models_are_validated_as_the_command_validates_them(command):
    model, data = SLEEP
    expected = command("validate", model, data, "--folds", "6", "--seed", "3")
    found = kalfit.validate(model, data, folds=6, seed=3)
    assert found.to_dict() == expected
    assert found.log_density == pytest.approx(sum(one["log_density"] for one in expected["pieces"]), rel=1e-12)
    assert found.difference is None and "in 6 folds" in found.summary()
    text = Path(model).read_text(encoding="utf-8")
    other = kalfit.Model.from_text(text + '\n[covariance]\nstructure = "diagonal"\n')
    beside = kalfit.validate(model, data, folds=6, seed=3, against=other)
    differences = [one["log_density"] - one["against"] for one in beside.to_dict()["pieces"]]
    assert beside.difference == pytest.approx(sum(differences), rel=1e-9)
    with pytest.raises(ValueError, match="folds is 1"):
        kalfit.validate(model, data, folds=1)


def test_tests_are_a_frame():
    fit = kalfit.fit(*BENCH)
    frame = fit.tests_frame()
    assert list(frame["id"]) == [test.id for test in fit.tests] and len(frame) == 28
    assert frame["mean[bias]"][0] == fit.tests[0].means["main"][0]
    assert frame["std_dev[scale]"][3] == pytest.approx(fit.tests[3].covariances["main"][1, 1] ** 0.5, rel=1e-15)
    applied = fit.apply(BENCH[1]).tests.to_pandas()
    assert numpy.allclose(applied["mean[bias]"], frame["mean[bias]"], rtol=1e-9, atol=1e-12)
    phases = kalfit.fit(*PHASES).tests_frame()
    assert "mean[align: drift]" in phases.columns and phases["mean[flight: drift]"].isna().sum() == 4


def test_estimates_and_constraints_are_frames():
    fit = kalfit.fit(*BENCH)
    frame = fit.parameters_frame().set_index("name")
    for i, state in enumerate(fit.states):
        assert frame.loc[f"mean[{state}]", "estimate"] == fit.mean[i]
        assert frame.loc[f"std_dev[{state}]", "std_error"] == fit.phase("main").std_dev_std_error[i]
    assert frame.loc["covariance[bias, scale]", "estimate"] == fit.covariance[0, 1]
    assert set(frame["kind"]) <= {"mean", "regression", "std_dev", "covariance", "correlation", "parameter"}
    for parameter in fit.parameters:
        name = parameter.name if parameter.level is None else f"{parameter.name}[{parameter.level}]"
        assert frame.loc[name, "estimate"] == parameter.estimate
    constraints = kalfit.fit(*BENCH).constraints_frame()
    assert list(constraints["element"]) == [one["element"] for one in fit.constraints]
    assert constraints["p_value"].dtype == float
    fitted = kalfit.fit(*BENCH)
    rows = fitted.rows_frame()
    assert list(rows["test"]) == [row["test"] for row in fitted.misfit["wrong_rows"]]
    assert rows["deviation"].dtype == float and fitted.misfit["innovations"] == fitted.to_dict()["data"]["observations"]
    phases = kalfit.fit(*PHASES).parameters_frame()
    assert "align: mean[drift]" in set(phases["name"])


def test_a_fit_with_its_data_writes_a_report_that_shows_them(tmp_path):
    kalfit.fit(*BENCH, report=tmp_path / "fit.html")
    assert (tmp_path / "fit.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_an_ensemble_is_drawn_as_the_command_draws_it(command, tmp_path):
    fit = kalfit.fit(*BENCH, out=tmp_path / "fit.json")
    arguments = ("simulate", BENCH[0], "--from", str(tmp_path / "fit.json"), "--design", BENCH[1], "--seed", "7")
    path = command(*arguments, "--tests", "40", "--truth", str(tmp_path / "truth.csv"), out="drawn.csv")
    drawn = kalfit.simulate(BENCH[0], fit, polars.read_csv(BENCH[1], infer_schema_length=None), seed=7, tests=40)
    assert (drawn.tests, len(drawn.data), len(drawn.states)) == (40, drawn.rows, 40)
    assert drawn.data.to_pandas().equals(pandas.read_csv(path))
    assert drawn.states.to_pandas().equals(pandas.read_csv(tmp_path / "truth.csv"))
    assert drawn.data.to_polars().columns == drawn.data.columns
    assert kalfit.fit(BENCH[0], drawn.data).log_likelihood == kalfit.fit(BENCH[0], path).log_likelihood
    written = kalfit.simulate(BENCH[0], fit, BENCH[1], seed=7, out=tmp_path / "w.csv", truth=tmp_path / "t.csv", tests=40)
    assert written.data is None and (tmp_path / "w.csv").read_text() == path.read_text()


@pytest.mark.parametrize("example", [BENCH, PHASES])
def test_reductions_stand_in_for_data_in_memory_and_in_files(example, command, tmp_path):
    model, data = example
    expected = kalfit.fit(model, data, innovations=False)
    table = kalfit.reduce(model, data)
    path = command("reduce", model, data, out="reductions.parquet")
    assert table.to_pyarrow().to_pylist() == pyarrow.parquet.read_table(path).to_pylist()
    assert table.metadata["kalfit.schema"] == "kalfit-reductions/1"
    for given in (table, table.to_pyarrow(), path):
        found = kalfit.fit(model, given)
        assert found.log_likelihood == expected.log_likelihood
        assert [phase.mean.tolist() for phase in found.phases] == [phase.mean.tolist() for phase in expected.phases]
    assert kalfit.reduce(model, data, out=tmp_path / "again.parquet") is None
    assert (tmp_path / "again.parquet").read_bytes() == path.read_bytes()
    with pytest.raises(kalfit.Error, match="expected one that ends in `.parquet`"):
        kalfit.reduce(model, data, out=tmp_path / "r.csv")


def test_reductions_of_another_model_are_refused():
    other = Path(BENCH[0]).read_text(encoding="utf-8").replace("time_constant = ", "time_constant = 2 * ")
    with pytest.raises(kalfit.DataError, match="made with another model|digest"):
        kalfit.fit(kalfit.Model.from_text(other.replace('2 * "tau"', '"2 * tau"')), kalfit.reduce(*BENCH))


def test_parameters_come_from_a_fit():
    fit = kalfit.fit(*SLEEP)
    held = kalfit.fit(SLEEP[0], kalfit.reduce(*SLEEP, at=fit))
    assert held.parameters["sigma"].estimate == fit.parameters["sigma"].estimate
    assert abs(held.log_likelihood - fit.log_likelihood) < 1e-9 * abs(fit.log_likelihood)


def test_estimates_of_filters_are_made_and_fitted():
    model = json.loads(json.dumps({
        "data": {"test": "id"},
        "states": {"level": {}},
        "measurements": {"y": {"column": "y", "equation": "level", "noise": 0.5}},
        "filter": {"kind": "kalman-schmidt", "mean": {"level": 0}, "covariance": [[4]]},
    }))
    rows = polars.DataFrame({"id": list("aabbcc"), "y": [1.0, 1.2, 3.0, 2.5, -1.0, -0.6]})
    estimates = kalfit.estimates(model, rows)
    assert len(estimates) == 3 and estimates.metadata["kalfit.schema"] == "kalfit-estimates/1"
    assert abs(kalfit.fit(model, estimates).mean[0] - kalfit.fit(model, rows).mean[0]) < 1e-9
