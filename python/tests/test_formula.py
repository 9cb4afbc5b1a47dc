"""Formulas in the words of lme4: published figures, explicit models, and what is refused."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import polars
import pyarrow
import pytest

import kalfit
from conftest import ROOT, SLEEP

pytest.importorskip("formulaic")

SLEEPSTUDY = SLEEP[1]
PASTES = "examples/levels/pastes.csv"
NESTED = "crates/kalfit-cli/tests/reference/lmm-nested"


def ensemble(seed=5, units=40):
    """Rows of units with an intercept and a slope of their own, a factor and a column of whole numbers."""
    rng = np.random.default_rng(seed)
    rows = []
    for unit in range(units):
        own = rng.multivariate_normal([0, 0], [[4, 0.8], [0.8, 1]])
        for run in range(rng.integers(6, 14)):
            x, kind = rng.normal(), rng.choice(["old", "new", "best one"])
            effect = {"old": 0.0, "new": 0.7, "best one": 1 - 0.5 * x}[kind]
            y = 2 + own[0] + (1 + own[1]) * x + effect + 0.8 * rng.normal()
            rows.append((f"u{unit}", f"s{unit % 4}", run % 2, x, kind, rng.integers(1, 4), y))
    return pandas.DataFrame(rows, columns=["unit", "station", "run", "x", "kind", "count", "y"])


def test_sleepstudy_is_that_of_lme4():
    # lme4: lmer(Reaction ~ Days + (Days | Subject), sleepstudy), as its documentation prints it
    fit = kalfit.lmm("Reaction ~ Days + (Days | Subject)", SLEEPSTUDY)
    assert fit.to_dict()["criterion"] == "reml", "as lme4 has it"
    assert abs(-2 * fit.log_likelihood - 1743.6283) < 1e-4
    assert fit.states == ["Intercept", "Days"]
    assert np.allclose(fit.mean, [251.405, 10.467], atol=5e-4)
    assert np.allclose(fit.phases[0].mean_std_error, [6.825, 1.546], atol=5e-4)
    assert np.allclose(fit.std_dev, [24.741, 5.922], atol=6e-4)
    assert abs(fit.correlation[0, 1] - 0.066) < 5e-4 and abs(fit.parameters["sigma"].estimate - 25.592) < 5e-4
    full = kalfit.lmm("Reaction ~ Days + (Days | Subject)", SLEEPSTUDY, reml=False)
    assert abs(full.log_likelihood + 875.9697) < 1e-4 and full.to_dict()["criterion"] == "ml"


def test_uncorrelated_terms_are_those_of_lme4():
    # lme4: lmer(Reaction ~ Days + (Days || Subject), sleepstudy): REML criterion 1743.7, 25.051, 5.988, 25.565
    fits = [
        kalfit.lmm(f"Reaction ~ Days + {random}", SLEEPSTUDY) for random in ("(Days || Subject)", "(1 | Subject) + (0 + Days | Subject)")
    ]
    assert fits[0].log_likelihood == fits[1].log_likelihood and abs(-2 * fits[0].log_likelihood - 1743.669) < 1e-3
    assert np.allclose(fits[0].std_dev, [25.051, 5.988], atol=1e-3) and abs(fits[0].parameters["sigma"].estimate - 25.565) < 1e-3
    assert '[covariance]\nstructure = "diagonal"\n' in str(fits[0].formula)
    assert fits[0].covariance[0, 1] == 0.0 and fits[0].free_parameters == 5


@pytest.mark.parametrize(
    "formula, file, case",
    [
        ("strength ~ 1 + (1 | batch / cask)", "pastes.csv", "pastes-reml"),
        ("strength ~ (1 | batch) + (1 | batch:cask)", "pastes.csv", "pastes-reml"),
        ("Thickness ~ 1 + (1 | Lot/Wafer)", "oxide.csv", "oxide-reml"),
        ("pixel ~ day + I(day^2) + (day | Dog) + (1 | Dog:Side)", "pixel.csv", "pixel-reml"),
    ],
)
def test_nested_models_are_those_of_lme4_and_nlme(formula, file, case):
    with open(f"{NESTED}/expected.json", encoding="utf-8") as handle:
        expected = next(one for one in json.load(handle) if one["fit"] == case)
    fit = kalfit.lmm(formula, f"{NESTED}/{file}")
    assert abs(fit.log_likelihood - expected["log_likelihood"]) < 1e-6
    assert np.allclose(fit.mean, expected["mean"], rtol=1e-6)
    (name, outer), *_ = expected["levels"].items()
    assert np.allclose(fit.level(name).covariance, outer["covariance"], rtol=1e-4, atol=1e-4)
    assert np.allclose(fit.level("tests").covariance, expected["covariance"], rtol=1e-4, atol=1e-4)
    sigma = float(expected["set"][0].split("=")[1])
    assert abs(fit.parameters["sigma"].estimate - sigma) < 1e-4 * sigma


def test_random_data_are_fitted_as_statsmodels_fits_them():
    smf = pytest.importorskip("statsmodels.formula.api")
    rows = ensemble()
    for reml in (True, False):
        fit = kalfit.lmm("y ~ x * C(kind) + (1 + x | unit)", rows, reml=reml)
        other = smf.mixedlm("y ~ x * C(kind)", rows, groups="unit", re_formula="~x").fit(reml=reml)
        assert -1e-6 < fit.log_likelihood - other.llf < 1e-4, "the same function, and no lower maximum"
        fixed = {fit.formula.terms[state]: mean for state, mean in zip(fit.states, fit.mean)}
        assert {*fixed} == {*other.fe_params.index}
        assert all(abs(fixed[name] - value) < 1e-3 for name, value in other.fe_params.items())
        assert np.allclose(fit.covariance[:2, :2], other.cov_re, atol=5e-3)
        assert np.allclose(fit.fitted(), other.fittedvalues, atol=2e-3) and np.allclose(fit.resid(), other.resid, atol=2e-3)
        assert np.allclose(fit.vcov().values.diagonal() ** 0.5, other.bse_fe[[*fixed]], rtol=5e-3)


def test_factors_and_interactions_are_dummy_columns():
    rows = ensemble()
    by_hand = rows.assign(new=(rows["kind"] == "new") * 1.0, old=(rows["kind"] == "old") * 1.0)
    model = {
        "data": {"test": "unit"},
        "states": {"a": {}, "b": {}, **{name: {"random": False} for name in ("new_", "old_", "xnew", "xold")}},
        "measurements": {
            "y": {"column": "y", "equation": "a + b * x + new_ * new + old_ * old + xnew * x * new + xold * x * old", "noise": "sigma"}
        },
        "parameters": {"sigma": {}},
    }
    expected = kalfit.fit(model, by_hand, criterion="reml")
    fit = kalfit.lmm("y ~ x * kind + (x | unit)", rows)
    assert fit.states == ["Intercept", "x", "kind_new", "kind_old", "x_kind_new", "x_kind_old"]
    assert abs(fit.log_likelihood - expected.log_likelihood) < 1e-9 * abs(expected.log_likelihood)
    assert np.allclose(fit.mean, expected.mean, rtol=1e-6) and np.allclose(fit.covariance, expected.covariance, rtol=1e-5)
    assert fit.formula.terms["x_kind_new"] == "x:kind[T.new]" and not fit.formula.takes_other_data
    counted = kalfit.lmm("y ~ x + factor(count) + (x | unit)", rows)
    assert counted.formula.terms["count_2"] == "C(count)[T.2]" and "if(`count` == 2, 1, 0)" in str(counted.formula)
    other = kalfit.lmm("y ~ x + factor(text) + (x | unit)", rows.assign(text=rows["count"].map(str)))
    assert counted.log_likelihood == other.log_likelihood, "whole numbers and their texts are the same factor"


def test_a_random_term_without_a_fixed_effect_has_a_mean_of_zero():
    made = kalfit.model_from_formula("y ~ kind + (0 + kind | unit)", ensemble())
    assert "[mean]\nfixed = { kind_best_one = 0 }" in str(made) and "kind_best_one" not in made.fixed
    fit = kalfit.fit(made.model, made.data, criterion="reml")
    assert fit.estimates["mean[kind_best_one]"].status == "fixed" and fit.free_parameters == 3 + 6 + 1
    apart = kalfit.model_from_formula("y ~ x + (kind || unit)", ensemble())
    assert 'structure = "blocks"\nblocks = [["Intercept"], ["kind_best_one", "kind_new", "kind_old"]]' in str(apart), "as lme4 takes ||"


def test_splines_and_polynomials_come_in_columns(tmp_path):
    made = kalfit.model_from_formula("Reaction ~ bs(Days, df=4) + (1 | Subject)", SLEEPSTUDY)
    assert list(made.made) == [f"bs(Days, df=4)[{k}]" for k in range(1, 5)] and made.takes_other_data
    quadratic = [kalfit.lmm(f"Reaction ~ {text} + (1 | Subject)", SLEEPSTUDY, reml=False) for text in ("poly(Days, 2)", "Days + I(Days^2)")]
    assert abs(quadratic[0].log_likelihood - quadratic[1].log_likelihood) < 1e-8, "the same curves"
    assert not quadratic[1].formula.made
    scaled = kalfit.lmm("Reaction ~ scale(Days) + (1 | Subject)", SLEEPSTUDY, reml=False)
    days = polars.read_csv(SLEEPSTUDY)["Days"]
    plain = kalfit.lmm("Reaction ~ Days + (1 | Subject)", SLEEPSTUDY, reml=False)
    assert abs(scaled.mean[1] / days.std() - plain.mean[1]) < 1e-8, "scale divides by R's standard deviation"
    assert not scaled.formula.made and "(`Days` - 4.5) / " in str(scaled.formula), "an expression, which fits other data"
    logged = kalfit.lmm("log(Reaction) ~ Days + (1 | Subject)", SLEEPSTUDY)
    by_hand = polars.read_csv(SLEEPSTUDY).with_columns(polars.col("Reaction").log())
    assert abs(logged.log_likelihood - kalfit.lmm("Reaction ~ Days + (1 | Subject)", by_hand).log_likelihood) < 1e-9
    doubled = kalfit.lmm("Reaction ~ twice(Days) + (1 | Subject)", SLEEPSTUDY, context={"twice": lambda x: 2 * x})
    assert abs(2 * doubled.mean[1] - plain.mean[1]) < 1e-8


def test_new_data_get_the_columns_of_the_first():
    fit = kalfit.lmm("log(Reaction) ~ poly(Days, 2) + (1 | Subject)", SLEEPSTUDY)
    rows = pandas.read_csv(SLEEPSTUDY, dtype={"Subject": str})
    prepared = fit.formula.prepare(rows[rows["Subject"] == "308"])
    first = fit.formula.data.iloc[:10]
    assert np.allclose(prepared["poly(Days, 2)[2]"], first["poly(Days, 2)[2]"]) and np.allclose(
        prepared["log(Reaction)"], first["log(Reaction)"]
    )
    applied = fit.apply(prepared).tests.to_pandas()
    assert abs(applied["mean[Intercept]"][0] - fit.tests[0].means["main"][0]) < 1e-9
    design = fit.formula.prepare({"Subject": ["new"] * 3, "Days": [0, 4, 9]})
    assert len(fit.predict(design).table.to_pandas()) > 0, "what is to be predicted was not measured"


def test_the_command_fits_what_was_saved(tmp_path):
    program = os.environ.get("KALFIT_COMMAND")
    if not program:
        pytest.skip("KALFIT_COMMAND does not name the command to compare with")
    for number, (formula, data) in enumerate(
        [
            ("Reaction ~ poly(Days, 2) + (Days | Subject)", SLEEPSTUDY),
            ("strength ~ (1 | batch/cask)", PASTES),
            ("strength ~ (1 | batch:cask)", PASTES),
        ]
    ):
        fit = kalfit.lmm(formula, data)
        folder = tmp_path / str(number)
        fit.formula.save(folder)
        rows = folder / "data.csv" if fit.formula.takes_other_data else data
        assert (folder / "data.csv").exists() == fit.formula.takes_other_data == (number != 1)
        command = [program, "fit", str(folder / "model.toml"), str(rows), "--criterion", "reml", "--out", str(folder / "fit.json")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found = kalfit.Fit.load(folder / "fit.json")
        assert found.log_likelihood == fit.log_likelihood and found.mean.tolist() == fit.mean.tolist()


def test_python_prints_the_model_file(tmp_path):
    def run(*arguments):
        command = [sys.executable, "-m", "kalfit", "model", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = run("--formula", "Reaction ~ Days + (Days | Subject)", SLEEPSTUDY)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert done.stdout == str(kalfit.model_from_formula("Reaction ~ Days + (Days | Subject)", SLEEPSTUDY))
    done = run("--formula", "Reaction ~ bs(Days, df=4) + (1 | Subject)", SLEEPSTUDY)
    assert "takes columns that the data do not have: `bs(Days, df=4)[1]`" in done.stderr
    done = run("--formula", "Reaction ~ bs(Days, df=4) + (1 | Subject)", SLEEPSTUDY, "--out", str(tmp_path / "new"))
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["data.csv", "model.toml"]
    assert f"kalfit fit {tmp_path / 'new' / 'model.toml'} {tmp_path / 'new' / 'data.csv'} --criterion reml" in done.stderr
    done = run("--formula", "Reaction ~ Dayz + (1 | Subject)", SLEEPSTUDY)
    assert done.returncode == 2 and done.stdout == "" and done.stderr.startswith("error: formula") and "no column `Dayz`" in done.stderr


def test_data_may_come_in_any_form(tmp_path):
    rows = ensemble()
    expected = kalfit.lmm("y ~ x * kind + (x | unit)", rows)
    rows.to_csv(tmp_path / "a.csv", index=False)
    rows.to_parquet(tmp_path / "a.parquet")
    forms = {
        "polars": polars.from_pandas(rows),
        "pyarrow": pyarrow.Table.from_pandas(rows),
        "a dictionary": rows.to_dict("list"),
        "categories": rows.astype({"kind": "category", "unit": "category"}),
        "parts": [rows.iloc[:100], polars.from_pandas(rows.iloc[100:])],
        "csv": tmp_path / "a.csv",
        "parquet": str(tmp_path / "a.parq*"),
    }
    for name, data in forms.items():
        assert kalfit.lmm("y ~ x * kind + (x | unit)", data).log_likelihood == expected.log_likelihood, name
    numbered = pandas.read_csv(PASTES).assign(cask=lambda d: "0" + (d["cask"].map(ord) - 96).map(str))
    numbered.to_csv(tmp_path / "ids.csv", index=False)
    assert [test.id for test in kalfit.lmm("strength ~ (1 | batch/cask)", tmp_path / "ids.csv").tests][:3] == ["A/01", "A/02", "A/03"]


def test_rows_with_missing_values_are_left_out_and_counted():
    rows = ensemble()
    holes = rows.copy()
    holes.loc[[3, 50, 51], "x"] = np.nan
    holes.loc[7, "unit"] = None
    holes.loc[9, "y"] = np.nan
    holes.loc[20, "station"] = None  # which the formula does not take
    with pytest.warns(kalfit.FormulaWarning, match=rf"5 of {len(rows)} rows are left out"):
        fit = kalfit.lmm("y ~ x + (1 | unit)", holes)
    expected = kalfit.lmm("y ~ x + (1 | unit)", rows.drop(index=[3, 7, 9, 50, 51]))
    assert fit.log_likelihood == expected.log_likelihood and fit.resid().shape == (len(rows) - 5,)
    assert np.allclose(rows["y"].to_numpy()[fit.formula.rows] - fit.fitted(), fit.resid(), atol=1e-12)
    rows["z"] = rows["x"] - rows["x"].min()
    with pytest.warns(kalfit.FormulaWarning, match="1 of"), np.errstate(divide="ignore"):
        assert len(kalfit.model_from_formula("y ~ log(z) + (1 | unit)", rows).data) == len(rows) - 1, "the logarithm of zero"


def test_dependent_fixed_effects_are_left_out_as_lme4_does():
    rows = ensemble().assign(twice=lambda d: 2 * d["x"])
    with pytest.warns(kalfit.FormulaWarning, match="fixed effects `twice` are left out"):
        fit = kalfit.lmm("y ~ x + twice + (1 | unit)", rows)
    assert fit.log_likelihood == kalfit.lmm("y ~ x + (1 | unit)", rows).log_likelihood


def test_offsets_weights_and_known_variances():
    rows = ensemble().assign(known=lambda d: 0.5 + d["count"], o=lambda d: 3 * d["x"])
    plain = kalfit.lmm("y ~ x + (1 | unit)", rows)
    shifted = kalfit.lmm("y ~ x + offset(o) + (1 | unit)", rows)
    assert abs(plain.mean[1] - 3 - shifted.mean[1]) < 1e-9 and np.allclose(plain.fitted(), shifted.fitted(), atol=1e-9)
    made = kalfit.lmm("y ~ x + offset(log(known)) + (1 | unit)", rows)
    by_hand = kalfit.lmm("y ~ x + (1 | unit)", rows.assign(y=rows["y"] - np.log(rows["known"])))
    assert abs(made.log_likelihood - by_hand.log_likelihood) < 1e-9
    weighted = kalfit.lmm("y ~ x + (1 | unit)", rows, weights="known")
    assert 'variance = "sigma^2 / `known`"' in str(weighted.formula) and abs(weighted.log_likelihood - plain.log_likelihood) > 0.01
    even = kalfit.lmm("y ~ x + (1 | unit)", rows.assign(known=4.0), weights="known")
    assert (
        abs(even.log_likelihood - plain.log_likelihood) < 1e-8
        and abs(even.parameters["sigma"].estimate / 2 - plain.parameters["sigma"].estimate) < 1e-6
    )


def test_known_variances_make_a_meta_analysis():
    # metafor 3.8.1: rma(y_PD, v_PD, data = dat.berkey1998) has this model, one row a study
    trials = polars.read_csv("examples/meta-analysis/berkey1998.csv")
    fit = kalfit.lmm("y_PD ~ 1 + (1 | trial)", trials, variances="v_PD")
    y, v = trials["y_PD"].to_numpy(), trials["v_PD"].to_numpy()
    weights = 1 / (v + fit.covariance[0, 0])
    assert abs(fit.mean[0] - (weights * y).sum() / weights.sum()) < 1e-9 and len(fit.parameters) == 0

    def restricted(tau2):
        w = 1 / (v + tau2)
        return -0.5 * (np.log(v + tau2).sum() + np.log(w.sum()) + (w * (y - (w * y).sum() / w.sum()) ** 2).sum())

    best = restricted(fit.covariance[0, 0])
    assert best > max(restricted(fit.covariance[0, 0] * factor) for factor in (0.99, 1.01))


def test_groups_are_nested_as_the_data_nest_them():
    rows = ensemble()
    made = kalfit.model_from_formula("y ~ x * C(kind) + (1 + x | unit / run) + (1 | station)", rows)
    assert made.model.levels == ["station", "unit"] and made.model.test == "run"
    assert made.groups == {"station": "station", "unit": "unit", "tests": "unit:run"}
    assert '[levels.station.covariance]\nstates = ["Intercept"]' in str(made).replace('"station"', "station")
    fit = kalfit.fit(made.model, made.data, criterion="reml", deletion="none", innovations=False)
    assert [level.groups for level in fit.levels] == [4, 40, 80]
    joined = kalfit.model_from_formula("y ~ x + (1 | unit:run)", rows)
    assert joined.model.test == "unit:run" and joined.data["unit:run"][0] == "u0:0"


def test_factors_that_cross_become_crossed_factors():
    rows = ensemble()
    made = kalfit.model_from_formula("y ~ x + (1 | unit) + (1 | kind)", rows)
    assert made.groups == {"unit": "unit", "kind": "kind"} and 'test = "@row"' in str(made)
    assert '[covariance]\nstates = []' in str(made), "rows of one unit and kind differ by their noise alone"
    # runs stand within units, and each run is made at one station
    benches = rows.assign(bench=[f"b{(int(unit[1:]) + 2 * run) % 3}" for unit, run in zip(rows["unit"], rows["run"], strict=True)])
    made = kalfit.model_from_formula("y ~ x + (1 | unit / run) + (1 | bench)", benches)
    assert made.model.test == "run" and made.model.levels == ["unit"] and 'crossed = ["bench"]' in str(made)


def test_plates_and_samples_are_those_of_lme4():
    rows = "crates/kalfit-cli/tests/data/crossed/penicillin.csv"
    fit = kalfit.lmm("diameter ~ 1 + (1 | plate) + (1 | sample)", rows, progress=False)
    # lme4: REML criterion 330.8606
    assert fit.converged and fit.log_likelihood == pytest.approx(-330.8606 / 2, abs=5e-5)
    assert fit.level("sample").std_dev[0] == pytest.approx(1.9316, abs=1e-3)
    assert fit.level("plate").std_dev[0] == pytest.approx(0.8467, abs=1e-3)
    (factor,) = fit.crossed
    assert factor.names == ["A", "B", "C", "D", "E", "F"] and factor.effects.shape == (6, 1)
    assert factor.effects_covariance.shape == (6, 1, 1) and "6 levels" in repr(factor)
    assert {"plate", "sample", "Residual"} <= {*fit.tidy("broom").to_polars()["group"]}


@pytest.mark.parametrize(
    "formula, words",
    [
        ("Reaction + (1 | Subject)", "expected a response, one `~` and terms"),
        ("~ Days + (1 | Subject)", "expected a response, one `~` and terms"),
        ("cbind(Days, Reaction) ~ (1 | Subject)", "has several responses"),
        ("Subject ~ Days + (1 | Subject)", "is no column of numbers"),
        ("Reaction ~ Days", "has no random term"),
        ("Reaction ~ Days + 1 | Subject", "a bar that is not in its own parentheses"),
        ("Reaction ~ Days * (1 | Subject)", "a bar that is not in its own parentheses"),
        ("Reaction ~ Days - (1 | Subject)", "is subtracted"),
        ("Reaction ~ Days + ar1(Days | Subject)", "a covariance structure of another package"),
        ("Reaction ~ Days + (1 ||| Subject)", "has 3 bars"),
        ("Reaction ~ Days + ( | Subject)", "nothing stands before the bar"),
        ("Reaction ~ Days + (0 | Subject)", "nothing varies"),
        ("Reaction ~ Days + (1 | )", "nothing stands behind the bar"),
        ("Reaction ~ Days + (1 | 1)", "`1` stands behind the bar"),
        ("Reaction ~ Days + (1 | cut(Days))", "expected a column that names groups"),
        ("Reaction ~ Days + (1 | Subject * Days)", r"the group of `\(1 \| Subject \* Days\)` has `\*`"),
        ("Reaction ~ Days + (1 | Subject) + (Days | Subject)", "`Intercept` varies twice with `Subject`"),
        ("Reaction ~ Days + + (1 | Subject)", "a term is missing"),
        ("Reaction ~ (Days + (1 | Subject)", "parentheses do not match"),
        ("Reaction ~ . + (1 | Subject)", "stands for all other columns"),
        ("Reaction ~ nope(Days) + (1 | Subject)", "(?s)there is no function `nope`.*context={'nope'"),
        ("Reaction ~ log(Days, 2, 3) + (1 | Subject)", "formulaic does not understand"),
        ("Reaction ~ Days ~ (1 | Subject)", "one `~` and terms"),
        ("Reaction ~ I(0 * Days) + (0 + I(0 * Days) | Subject)", "is zero in all rows"),
    ],
)
def test_formulas_that_are_refused(formula, words):
    with pytest.raises(kalfit.ModelError, match=words) as refused:
        kalfit.lmm(formula, SLEEPSTUDY)
    assert formula in str(refused.value) and "\n\nhint: " in str(refused.value)


def test_arguments_that_are_refused():
    formula = "Reaction ~ Days + (1 | Subject)"
    with pytest.raises(ValueError, match="family is 'poisson': the noise of kalfit's models is normal"):
        kalfit.lmm(formula, SLEEPSTUDY, family="poisson")
    with pytest.raises(TypeError, match="say reml=True or reml=False"):
        kalfit.lmm(formula, SLEEPSTUDY, criterion="ml")
    with pytest.raises(TypeError, match="the formula is of type int"):
        kalfit.lmm(3, SLEEPSTUDY)
    with pytest.raises(TypeError, match="data is of type int"):
        kalfit.lmm(formula, 3)
    with pytest.raises(kalfit.DataError, match="(?s)has no column `days`.*is `Days` meant"):
        kalfit.lmm("Reaction ~ days + (1 | Subject)", SLEEPSTUDY)
    with pytest.raises(kalfit.DataError, match="cannot read no-such.csv"):
        kalfit.lmm(formula, "no-such.csv")
    with pytest.raises(kalfit.ModelError, match="weights and variances are given"):
        kalfit.lmm(formula, SLEEPSTUDY, weights="Days", variances="Days")
    with pytest.raises(kalfit.DataError, match="weights is `Days`, expected a column of positive numbers"):
        kalfit.lmm(formula, SLEEPSTUDY, weights="Days")
    rows = polars.read_csv(SLEEPSTUDY).with_row_index("row")
    with pytest.raises(kalfit.ModelError, match="`row` has 180 groups in 180 rows, expected fewer"):
        kalfit.lmm("Reaction ~ Days + (1 | row)", rows)
    with pytest.raises(kalfit.ModelError, match="`Subject` has 1 group in the data"):
        kalfit.lmm(formula, rows.head(10))
    with pytest.raises(kalfit.DataError, match="no row has all of"):
        kalfit.lmm(formula, rows.with_columns(polars.lit(None, polars.Float64).alias("Days")))


def test_without_formulaic_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "formulaic", None)
    with pytest.raises(ImportError, match=r"pip install 'kalfit\[formula\]'"):
        kalfit.lmm("Reaction ~ Days + (1 | Subject)", SLEEPSTUDY)


def test_names_that_expressions_cannot_have_are_replaced_and_mapped():
    rows = ensemble().rename(columns={"x": "sigma", "kind": "kind of unit", "count": "2 be"})
    fit = kalfit.lmm("y ~ sigma + `kind of unit` + `2 be` + (1 | unit)", rows)
    assert fit.states == ["Intercept", "sigma_2", "kind_of_unit_new", "kind_of_unit_old", "x2_be"]
    assert fit.formula.terms["sigma_2"] == "sigma" and not fit.formula.made
    expected = kalfit.lmm("y ~ x + kind + count + (1 | unit)", ensemble())
    assert fit.log_likelihood == expected.log_likelihood
    quoted = ensemble().assign(kind=lambda d: d["kind"].str.replace("best one", "it's `best`"))
    assert kalfit.lmm("y ~ x + kind + count + (1 | unit)", quoted).converged, "quotes and backticks in the names of levels"
    truth = ensemble().assign(flag=lambda d: d["kind"] == "new")
    flag = kalfit.lmm("y ~ flag + (1 | unit)", truth)
    as_number = kalfit.lmm("y ~ flag + (1 | unit)", truth.assign(flag=truth["flag"] * 1.0))
    assert abs(flag.log_likelihood - as_number.log_likelihood) < 1e-9


def test_a_fit_is_updated_by_formula():
    fit = kalfit.lmm("Reaction ~ Days + (Days | Subject)", SLEEPSTUDY)
    smaller = fit.update(formula="Reaction ~ Days + (1 | Subject)", reml=False)
    # lme4: lmer(Reaction ~ Days + (1 | Subject), sleepstudy, REML = FALSE) has the log-likelihood -897.0393
    assert abs(smaller.log_likelihood + 897.0393) < 1e-4 and smaller.formula.formula == "Reaction ~ Days + (1 | Subject)"
    rows = polars.read_csv(SLEEPSTUDY).filter(polars.col("Subject") != 308)
    fewer = fit.update(data=rows)
    assert len(fewer.tests) == 17 and fewer.formula.rows_given == 170
    apart = fit.update(covariance={"structure": "diagonal"})
    assert abs(apart.log_likelihood - kalfit.lmm("Reaction ~ Days + (Days || Subject)", SLEEPSTUDY).log_likelihood) < 1e-9


def test_the_page_on_formulas_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    text = (ROOT / "book" / "src" / "howto" / "formula.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```(python|text|toml)\n(.*?)```", text, re.DOTALL)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    names, compared = {"__name__": "page"}, 0
    for (kind, code), (_, shown) in zip(blocks, [*blocks[1:], ("", "")]):
        if kind != "python":
            continue
        exec(compile(code, "howto/formula.md", "exec"), names)
        printed = capsys.readouterr().out
        if printed:
            assert [line.rstrip() for line in printed.rstrip().splitlines()] == shown.rstrip().splitlines()
            compared += 1
    assert compared == 3


@pytest.mark.parametrize(
    "formula, log_likelihood, mean, std_error, covariance, scale",
    [
        ("Weight ~ Time + (1 | Pig)", -2404.7753, [15.724, 6.943], [0.788, 0.033], [[40.394]], 11.3669),
        ("Weight ~ Time + (1 + Time | Pig)", -2217.0475, [15.739, 6.939], [0.550, 0.080], [[19.493, 0.294], [0.294, 0.416]], 6.0374),
    ],
)
def test_the_pigs_of_statsmodels_documentation(formula, log_likelihood, mean, std_error, covariance, scale):
    # as its page on linear mixed effects models prints them; the covariance of the second is that of lme4 on the same page
    statsmodels = pytest.importorskip("statsmodels")
    data = Path(statsmodels.__file__).parent / "regression" / "tests" / "results" / "dietox.csv"
    if not data.exists():
        pytest.skip("statsmodels came without the data of its tests")
    fit = kalfit.lmm(formula, data, deletion="none", innovations=False)
    assert abs(fit.log_likelihood - log_likelihood) < 1e-4
    assert np.allclose(fit.mean, mean, atol=6e-4) and np.allclose(fit.phases[0].mean_std_error, std_error, atol=6e-4)
    size = len(covariance)
    assert np.allclose(fit.covariance[:size, :size], covariance, atol=1e-3) and abs(fit.parameters["sigma"].estimate ** 2 - scale) < 2e-4
