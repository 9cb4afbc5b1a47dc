"""Several tests of one unit: fits with levels, what is known of the groups, ensembles and plans."""

import json

import numpy as np
import polars
import pytest

import kalfit
from conftest import steady

PASTES = ("examples/levels/pastes.toml", "examples/levels/pastes.csv")


def test_a_fit_with_levels_is_the_command_s_to_the_bit(command):
    assert steady(kalfit.fit(*PASTES).to_dict()) == command("fit", *PASTES)


def test_levels_of_a_fit_are_those_of_its_json():
    fit = kalfit.fit(*PASTES)
    record = json.loads(fit.to_json())
    assert [(level.name, level.column, level.groups) for level in fit.levels] == [("batch", "batch", 10), ("tests", None, 30)]
    for level, expected in zip(fit.levels, record["levels"]):
        assert level.states == ["strength"] and level.std_dev.tolist() == expected["std_dev"]["estimate"]
        assert level.covariance.tolist() == expected["covariance"]["estimate"] and level.covariance.shape == (1, 1)
        assert level.std_dev_std_error.tolist() == expected["std_dev"]["std_error"]
        assert level.why_unknown("std_dev", "strength") is None
    assert fit.level("tests").covariance.tolist() == fit.covariance.tolist(), "the fit's own covariance is that within a batch"
    with pytest.raises(KeyError, match="there is no level 'lot', there are batch, tests"):
        fit.level("lot")
    assert kalfit.Fit.from_json(fit.to_json()).levels[0].covariance.tolist() == fit.levels[0].covariance.tolist()
    assert "Spread by level" in fit.summary()


def test_levels_agree_with_lme4():
    # lme4: lmer(strength ~ 1 + (1 | batch/cask), Pastes, REML = FALSE)
    fit = kalfit.fit(*PASTES)
    found = [fit.level("batch").std_dev[0], fit.level("tests").std_dev[0], fit.parameters["sigma"].estimate]
    expected = [1.0951, 2.9041, 0.8234]
    assert np.allclose(found, expected, atol=5e-4), (found, expected)


def test_what_is_known_of_groups_and_of_their_tests():
    fit = kalfit.fit(*PASTES)
    record = json.loads(fit.to_json())
    assert [(group.level, group.id, group.tests) for group in fit.groups[:2]] == [("batch", ("A",), 3), ("batch", ("B",), 3)]
    for group, expected in zip(fit.groups, record["groups"]):
        assert group.mean.tolist() == expected["mean"] and group.covariance.tolist() == expected["covariance"]
        assert (group.p_value, group.degrees_of_freedom) == (expected["p_value"], 1)
    total = sum(group.log_likelihood for group in fit.groups)
    assert abs(total - fit.log_likelihood) < 1e-9 * abs(total), (total, fit.log_likelihood)
    first = fit.tests[0]
    assert (first.id, first.groups) == ("A/a", ("A",))


def test_a_test_is_told_apart_by_its_groups_too():
    rows = polars.read_csv(PASTES[1])
    assert rows["cask"].n_unique() == 3 and len(kalfit.fit(PASTES[0], rows).tests) == 30


def test_the_notebook_shows_each_level():
    page = kalfit.fit(*PASTES)._repr_html_()
    assert "batch to batch" in page and "test to test of one batch" in page


def test_an_ensemble_of_groups_is_drawn(command, tmp_path):
    fit = kalfit.fit(*PASTES, out=tmp_path / "fit.json")
    drawn = kalfit.simulate(PASTES[0], fit, PASTES[1], seed=7)
    path = command("simulate", PASTES[0], "--from", str(tmp_path / "fit.json"), "--design", PASTES[1], "--seed", "7", out="drawn.csv")
    assert drawn.data.to_polars().equals(polars.read_csv(path))
    again = kalfit.fit(PASTES[0], drawn.data)
    assert [test.id for test in again.tests] == [test.id for test in fit.tests]
    with pytest.raises(kalfit.Error, match="expected at most the 30 of the design: the model has levels of groups"):
        kalfit.simulate(PASTES[0], fit, PASTES[1], seed=7, tests=60)


def test_more_units_or_more_tests_of_each_are_planned(command, tmp_path):
    fit = kalfit.fit(*PASTES, out=tmp_path / "fit.json")
    options = ("--from", str(tmp_path / "fit.json"), "--design", PASTES[1], "--groups", "batch=10,20", "--tests", "3,6")
    plan = kalfit.plan(PASTES[0], fit, PASTES[1], [3, 6], groups={"batch": [10, 20]})
    assert {**plan.to_dict(), "from": None} == {**command("plan", PASTES[0], *options), "from": None}
    record = plan.to_dict()
    assert record["tests"] == [30, 60, 60, 120]
    mean = next(q for q in record["quantities"] if q["quantity"] == "mean")["std_error"]
    assert mean[2] < mean[1] < mean[0], f"twice the batches say more of the mean than twice the casks: {mean}"
    with pytest.raises(kalfit.Error, match="how many groups of level `batch` is not said"):
        kalfit.plan(PASTES[0], fit, PASTES[1], [3])
    with pytest.raises(ValueError, match="groups is"):
        kalfit.plan(PASTES[0], fit, PASTES[1], [3], groups={"batch": [0]})


def test_reductions_hold_the_groups_of_tests():
    reductions = kalfit.reduce(*PASTES, set={"sigma": 0.8})
    assert reductions.to_pyarrow()["groups"].to_pylist()[:4] == [["A"], ["A"], ["A"], ["B"]]
    found = kalfit.fit(PASTES[0], reductions)
    expected = kalfit.fit(*PASTES, set={"sigma": 0.8}, innovations=False)
    assert found.log_likelihood == expected.log_likelihood and len(found.groups) == 10
    assert [level.covariance.tolist() for level in found.levels] == [level.covariance.tolist() for level in expected.levels]


def test_whether_batches_differ_is_a_hypothesis():
    found = kalfit.test(*PASTES, {"levels": {"batch": {"covariance": {"states": []}}}})
    assert found.converged and 0 < found.p_value < 1
    assert found.to_dict()["mixture"] == "0.5 chi2_0; 0.5 chi2_1"


def test_a_row_without_its_group_is_refused():
    rows = polars.DataFrame({"batch": ["A", None], "cask": ["a", "a"], "strength": [62.8, 62.6]})
    with pytest.raises(kalfit.DataError, match="data, row 2, column `batch`: found a missing cell, expected the group") as refused:
        kalfit.fit(PASTES[0], rows)
    assert "every row needs the group of its test" in str(refused.value)


def test_levels_beside_phases_are_refused():
    model = {
        "data": {"test": "cask", "levels": ["batch"], "phase": "phase"},
        "phases": {name: {"states": {"x": {}}, "measurements": {"y": {"column": "y", "equation": "x", "noise": 1}}} for name in "ab"},
    }
    with pytest.raises(kalfit.ModelError, match="levels.*does not go with.*phases"):
        kalfit.Model(model)
