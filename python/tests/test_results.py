"""What statsmodels, broom and ArviZ have taught to expect of a fit."""

import json
import sys
import warnings

import numpy as np
import pandas
import polars
import pytest

import kalfit
from conftest import BENCH, META, PHASES, SLEEP, steady

PASTES = ("examples/levels/pastes.toml", "examples/levels/pastes.csv")


@pytest.fixture(scope="module")
def sleep():
    return kalfit.fit(*SLEEP)


@pytest.fixture(scope="module")
def few():
    return kalfit.fit(*SLEEP, criterion="reml", innovations=False, deletion="none")


def by_name(table):
    return {row["name"]: (row["lower"], row["upper"]) for row in table.to_polars().to_dicts()}


def test_vcov_is_the_covariance_of_the_estimates(sleep):
    covariance = sleep.vcov()
    assert covariance.names == ["mean[intercept]", "mean[slope]"] and len(covariance) == 2
    assert np.allclose(np.sqrt(np.diag(np.asarray(covariance))), sleep.phases[0].mean_std_error, rtol=1e-6)
    assert covariance["mean[slope]", "mean[intercept]"] == covariance.values[1, 0] < 0
    frame = covariance.to_pandas()
    assert frame.loc["mean[slope]", "mean[slope]"] == covariance.values[1, 1] and list(frame) == covariance.names
    everything = sleep.vcov("all")
    assert everything.names[-1] == "sigma" and everything.values.shape == (6, 6)
    assert abs(everything["sigma", "sigma"] ** 0.5 / sleep.parameters["sigma"].std_error - 1) < 1e-6
    assert "mean[slope]" in repr(covariance) and len(repr(covariance).splitlines()) == 3
    with pytest.raises(KeyError, match=r"there is no 'sigma', there are mean\[intercept\]"):
        covariance["sigma", "sigma"]
    with pytest.raises(ValueError, match="what is 'some'"):
        sleep.vcov("some")


def test_vcov_has_coefficients_of_regressions_and_of_phases():
    rows = polars.read_csv(SLEEP[1]).with_columns((polars.col("Subject") % 7).alias("age"))
    model = kalfit.Model.from_text(kalfit.Model.load(SLEEP[0]).text + '\n[mean.regression]\nintercept = ["age"]\n')
    fit = kalfit.fit(model, rows, deletion="none")
    names = fit.vcov().names
    assert len(names) == 3 and names[2].startswith("regression["), names
    assert abs(fit.vcov()[names[2], names[2]] ** 0.5 / fit.estimates[names[2]].std_error - 1) < 1e-6
    assert "align: mean[tilt]" in kalfit.fit(*PHASES, deletion="none").vcov().names
    old = fit.to_dict() | {"estimates": None}
    with pytest.raises(ValueError, match="no covariance of its estimates"):
        kalfit.Fit.from_json(json.dumps(old)).vcov()


@pytest.mark.parametrize("example", [SLEEP, BENCH, PASTES, PHASES])
def test_intervals_from_standard_errors_are_kalfit_s_own_at_95_percent(example):
    fit = kalfit.fit(*example, intervals="wald", deletion="none", innovations=False)
    recorded, computed = by_name(fit.conf_int()), by_name(fit.conf_int(method="wald"))
    found = {name for name in computed if name in recorded}
    assert len(found) > 2 and {own.kind for own in fit.estimates.values() if own.name in found} >= {"mean", "std_dev"}
    for name in found:
        assert np.allclose(computed[name], recorded[name], rtol=1e-6, atol=1e-12), name


def test_intervals_have_levels(few, sleep):
    from scipy import stats

    low, high = by_name(few.conf_int(0.9))["mean[slope]"]
    one = few.estimates["mean[slope]"]
    assert np.allclose([low, high], stats.t.interval(0.9, one.df, one.estimate, one.std_error), rtol=1e-9)
    assert by_name(few.conf_int(0.95, "wald"))["mean[slope]"] == pytest.approx(one.interval95, rel=1e-9)
    low, high = by_name(sleep.conf_int(0.99))["std_dev[slope]"]
    one = sleep.estimates["std_dev[slope]"]
    assert abs(np.log(high / low) / 2 - stats.norm.ppf(0.995) * one.std_error / one.estimate) < 1e-9, "on the logarithmic scale"
    assert abs(low * high / one.estimate**2 - 1) < 1e-12
    low, high = by_name(sleep.conf_int(0.99999))["correlation[intercept, slope]"]
    assert -1 < low < high < 1
    narrow, wide = by_name(sleep.conf_int(0.5)), by_name(sleep.conf_int(0.999))
    assert all(wide[name][0] < narrow[name][0] < narrow[name][1] < wide[name][1] for name in narrow)


def test_profile_intervals_are_those_of_the_fit():
    profiled = kalfit.fit(*SLEEP, intervals="profile", deletion="none", innovations=False)
    plain = kalfit.fit(*SLEEP, intervals="wald", deletion="none", innovations=False)
    recorded = by_name(profiled.conf_int(method="profile"))
    assert recorded == by_name(profiled.conf_int()) and recorded["sigma"] == profiled.estimates["sigma"].interval95
    assert by_name(profiled.conf_int(method="wald"))["sigma"] == pytest.approx(by_name(plain.conf_int())["sigma"], rel=1e-6)
    with pytest.raises(ValueError, match="level is 0.9, but profile intervals are found by the fit, at 0.95 only"):
        profiled.conf_int(0.9, "profile")
    with pytest.raises(ValueError, match="this fit has no profile intervals"):
        plain.conf_int(method="profile")
    with pytest.raises(ValueError, match="this fit has no bootstrap intervals"):
        profiled.conf_int(method="bootstrap")
    with pytest.raises(ValueError, match="level is 95"):
        plain.conf_int(95)
    with pytest.raises(ValueError, match="method is 'exact'"):
        plain.conf_int(method="exact")


def test_the_summary_has_intervals_at_another_level(sleep):
    assert sleep.summary() == str(sleep)
    more = sleep.summary(level=0.9)
    assert more.startswith(sleep.summary().rstrip("\n")) and "Intervals at 90 %" in more
    low, high = by_name(sleep.conf_int(0.9))["sigma"]
    line = next(line for line in more.split("Intervals at 90 %")[1].splitlines() if line.strip().startswith("sigma"))
    assert line.split() == ["sigma", f"{low:.6g}", f"{high:.6g}"]


def test_fitted_values_are_those_of_the_random_effects(sleep):
    rows = polars.read_csv(SLEEP[1])
    own = {test.id: test.means["main"] for test in sleep.tests}
    expected = np.array([own[str(subject)] @ [1.0, days] for subject, days in zip(rows["Subject"], rows["Days"])])
    assert np.allclose(sleep.fitted(), expected, rtol=1e-9)
    assert np.allclose(sleep.resid(), rows["Reaction"].to_numpy() - expected, atol=1e-9)


def test_rows_of_fitted_values_are_those_of_the_data():
    rows = pandas.read_csv(PASTES[1])
    expected = kalfit.fit(*PASTES, deletion="none").fitted()
    order = np.random.default_rng(3).permutation(len(rows))
    mixed = kalfit.fit(PASTES[0], rows.iloc[order], deletion="none")
    assert np.allclose(mixed.fitted(), expected[order], atol=1e-7), "tests that are not contiguous"
    holes = rows.copy()
    holes.loc[[4, 11], "strength"] = np.nan
    fit = kalfit.fit(PASTES[0], holes, deletion="none")
    assert np.flatnonzero(np.isnan(fit.resid())).tolist() == [4, 11]
    parts = kalfit.fit(PASTES[0], [rows.iloc[:20].to_dict("list"), polars.from_pandas(rows.iloc[20:])], deletion="none")
    assert np.allclose(parts.fitted(), expected, atol=1e-7)


def test_fitted_values_of_any_model_with_one_measurement(tmp_path):
    bench = kalfit.fit(*BENCH, deletion="none")
    assert not np.isnan(bench.resid()).any() and 0.05 < np.std(bench.resid()) < 0.2, "of the size of the noise"
    with pytest.raises(ValueError, match="the model has measurements 'still', 'doppler', 'star': say which"):
        kalfit.fit(*PHASES, deletion="none").fitted()
    phases = kalfit.fit(*PHASES, deletion="none")
    rows = pandas.read_csv(PHASES[1])
    for measurement, column in (("still", "velocity"), ("doppler", "doppler"), ("star", "star")):
        found = phases.resid(measurement)
        assert len(found) == len(rows) and (np.isnan(found) == rows[column].isna()).all(), measurement
    with pytest.raises(ValueError, match="no measurement 'speed'"):
        phases.fitted("speed")
    bench.save(tmp_path / "fit.json")
    with pytest.raises(TypeError, match="does not know its model"):
        kalfit.Fit.load(tmp_path / "fit.json").resid()


def test_rows_that_are_not_those_of_the_fit_are_noticed():
    from kalfit._rows import measured_rows

    bench = kalfit.fit(*BENCH, deletion="none")
    states = bench.apply(BENCH[1], states="smoothed").states
    tables, rows = {"data": {"test": "unit"}, "measurements": {"rate": {"column": "rate"}}}, pandas.read_csv(BENCH[1])
    assert np.allclose(measured_rows(tables, rows, states, None).fitted, bench.fitted())
    with pytest.raises(ValueError, match=r"row \d+ of test 'g.*' is not in the data; give those that the fit was made from"):
        measured_rows(tables, rows.head(100), states, None)
    with pytest.raises(ValueError, match="no value where the fit has an estimate"):
        measured_rows(tables, rows.assign(rate=np.nan), states, None)
    files = {**tables, "data": {"test": "@file"}}
    with pytest.raises(ValueError, match="each file is a test"):
        measured_rows(files, rows, states, None)


def test_rows_read_by_a_condition_are_refused():
    model = {
        "data": {"test": "id"},
        "states": {"level": {}},
        "measurements": {"y": {"column": "y", "equation": "level", "noise": 1, "where": "kind == 'a'"}},
    }
    fit = kalfit.fit(model, {"id": [1, 1, 2, 2], "kind": list("abab"), "y": [1.0, 2.0, 3.0, 5.0]}, deletion="none")
    with pytest.raises(ValueError, match="read from rows where kind == 'a'"):
        fit.fitted()


def test_augment_has_a_row_for_each_row(sleep):
    rows = sleep.augment(by="row").to_polars()
    assert rows.columns == ["test", "phase", "measurement", "row", "observed", "fitted", "resid"] and len(rows) == 180
    assert np.allclose(rows["resid"], sleep.resid()) and rows["row"].to_list() == list(range(1, 181))
    assert rows["observed"].to_list() == polars.read_csv(SLEEP[1])["Reaction"].to_list() and rows["test"][0] == "308"
    with pytest.raises(ValueError, match="by is 'column'"):
        sleep.augment(by="column")


def test_a_fit_is_updated(sleep):
    same = sleep.update()
    assert steady(same.to_dict()) == steady(sleep.to_dict())
    assert steady(sleep.update(criterion="reml").to_dict()) == steady(kalfit.fit(*SLEEP, criterion="reml").to_dict())
    assert steady(sleep.update(set={"sigma": 25}).to_dict()) == steady(kalfit.fit(*SLEEP, set={"sigma": 25}).to_dict())
    model = kalfit.Model.load(SLEEP[0]).text
    apart = kalfit.fit(kalfit.Model.from_text(model + '\n[covariance]\nstructure = "diagonal"\n'), SLEEP[1])
    found = sleep.update(covariance={"structure": "diagonal"})
    assert found.log_likelihood == apart.log_likelihood
    assert sleep.update(mean={"fixed": {"slope": 10}}).mean[1] == 10.0
    assert found.update(covariance={"structure": "full"}).log_likelihood == pytest.approx(sleep.log_likelihood, abs=1e-8)
    assert found.update(parameters={"sigma": 25}).free_parameters == 4, "an update of an update"
    rows = polars.read_csv(SLEEP[1]).filter(polars.col("Days") < 5)
    assert sleep.update(data=rows).log_likelihood == kalfit.fit(SLEEP[0], rows).log_likelihood
    paste = kalfit.fit(*PASTES, deletion="none")
    alone = paste.update(levels={"batch": {"states": []}})
    assert alone.log_likelihood < paste.log_likelihood and alone.level("batch").std_dev.tolist() == [0.0]
    known = kalfit.fit(*SLEEP, set={"sigma": 30}, deletion="none")
    assert known.update(innovations=False).log_likelihood == known.log_likelihood, "what was set stays"
    held = sleep.update(covariance={"fixed": {"slope, slope": 4}})
    assert held.covariance[1, 1] == 4.0
    assert held.update(covariance={"structure": "diagonal"}).log_likelihood == apart.log_likelihood, "a structure drops other keys"
    few = kalfit.fit(*SLEEP, criterion="reml", df="satterthwaite", deletion="none")
    assert few.update(criterion="ml").log_likelihood == pytest.approx(sleep.log_likelihood, abs=1e-9)


def test_what_cannot_be_updated_says_so(sleep, tmp_path):
    sleep.save(tmp_path / "fit.json")
    with pytest.raises(TypeError, match="does not know its model"):
        kalfit.Fit.load(tmp_path / "fit.json").update(criterion="reml")
    with pytest.raises(TypeError, match="not made by a formula"):
        sleep.update(formula="y ~ (1 | g)")
    with pytest.raises(TypeError, match="criterium"):
        sleep.update(criterium="reml")
    with pytest.raises(TypeError, match="levels\\['batch'\\] is 3"):
        kalfit.fit(*PASTES, deletion="none").update(levels={"batch": 3})


def test_a_fit_that_did_not_converge_warns():
    with pytest.warns(kalfit.ConvergenceWarning, match="the fit did not converge: ") as caught:
        fit = kalfit.fit(*SLEEP, max_iterations=1, deletion="none")
    assert not fit.converged and caught[0].filename == __file__, "the line of the caller"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kalfit.fit(*SLEEP).converged


def test_progress_ends_its_line(capfd, monkeypatch):
    from kalfit import _progress

    with _progress.how(None, True) as (_, told):
        told("reading", 1, 2)
        told("fitting", None, None)
    written = capfd.readouterr().err
    assert written.endswith("\n") and written.count("\n") == 1 and "\rreading, 50 %" in written
    with _progress.how(None, True):
        pass
    assert capfd.readouterr().err == "", "nothing was told"
    with pytest.raises(RuntimeError), _progress.telling(True) as told:
        told(kalfit.Step("half"))
        raise RuntimeError
    assert capfd.readouterr().err.endswith("\n"), "a job that fails ends its line, too"


@pytest.mark.parametrize(
    "content, found",
    [
        (b'{"schema": "kalfit-plan/1", "tests": [5]}', "a result of `kalfit plan` (schema `kalfit-plan/1`)"),
        (b'{"a": 1, "b": 2}', "JSON with the keys `a`, `b`"),
        (b"[1, 2]", "JSON that is a list"),
        (b"{}", "JSON without any key"),
        (b"", "an empty file"),
        (b'{"schema": "kalfit-fit/1", "data"', "JSON that breaks off"),
        (b"# a model\n[states]\nbias = {}\n", "a model file, by its table `[states]`"),
        (b"unit,y\na,1\n", "no JSON; its first line is `unit,y`"),
        (b"<!DOCTYPE html>", "a page of HTML"),
        (b"PAR1\x00\x01", "a Parquet file"),
        (b"\xff\xfe\x00", "no text, but 3 bytes"),
    ],
)
def test_a_file_that_is_no_fit_is_named(content, found, tmp_path):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(kalfit.DataError) as refused:
        kalfit.Fit.load(path)
    assert f"`{path}` is not a result of `kalfit fit`: found {found}" in str(refused.value)


def test_results_of_other_commands_are_named(sleep, tmp_path):
    kalfit.plan(*SLEEP[:1], sleep, SLEEP[1], [10], out=tmp_path / "plan.json")
    kalfit.test(*SLEEP, {"mean": {"fixed": {"slope": 0}}}, out=tmp_path / "test.json")
    kalfit.compare([sleep, sleep], out=tmp_path / "compared.json")
    for name in ("plan", "test", "compare"):
        path = next(tmp_path.glob(f"{name}*"))
        with pytest.raises(kalfit.DataError, match=rf"found a result of `kalfit {name}"):
            kalfit.Fit.load(path)


def test_dictionaries_of_columns_are_data():
    rows = polars.read_csv(SLEEP[1])
    expected = steady(kalfit.fit(SLEEP[0], rows).to_dict(), files=False)
    columns = {"Subject": rows["Subject"].to_list(), "Days": tuple(rows["Days"]), "Reaction": rows["Reaction"].to_numpy()}
    assert steady(kalfit.fit(SLEEP[0], columns).to_dict(), files=False) == expected
    texts = {**columns, "Subject": [f"{subject}" for subject in rows["Subject"]]}
    assert steady(kalfit.fit(SLEEP[0], texts).to_dict(), files=False) == expected
    holes = {**columns, "Reaction": [None, *rows["Reaction"][1:]]}
    assert kalfit.fit(SLEEP[0], holes).to_dict()["data"]["observations"] == 179
    serial = {**columns, "Subject": [2**60 + int(subject) for subject in rows["Subject"]]}
    assert [test.id for test in kalfit.fit(SLEEP[0], serial).tests][:2] == [str(2**60 + 308), str(2**60 + 309)]
    with pytest.raises(ValueError, match="columns of different lengths: 'a' 2, 'b' 1"):
        kalfit.fit(SLEEP[0], {"a": [1, 2], "b": [1]})
    with pytest.raises(TypeError, match="column 'a' is of type int"):
        kalfit.fit(SLEEP[0], {"a": 1})
    with pytest.raises(TypeError, match="column 'a' has values of type int, str, expected all texts or all numbers"):
        kalfit.fit(SLEEP[0], {"a": [1, "x"]})


def test_tidy_has_broom_s_columns(few):
    fit = kalfit.lmm("Reaction ~ Days + (Days | Subject)", SLEEP[1]) if _formulaic() else few
    rows = fit.tidy("broom").to_polars()
    columns = ["effect", "group", "term", "estimate", "std_error", "statistic", "df", "p_value", "conf_low", "conf_high"]
    assert rows.columns == columns
    assert rows["effect"].to_list()[:2] == ["fixed"] * 2 and abs(rows["estimate"][1] - 10.467286) < 1e-5
    assert abs(rows["statistic"][1] - 6.771) < 1e-3 and abs(rows["df"][1] - 17) < 1e-6
    if _formulaic():
        assert rows["term"].to_list() == ["Intercept", "Days", "sd__Intercept", "sd__Days", "cor__Intercept.Days", "sd__Observation"]
        assert rows["group"].to_list() == ["", "", "Subject", "Subject", "Subject", "Residual"]
        paste = kalfit.lmm("strength ~ (1 | batch/cask)", PASTES[1]).tidy("broom").to_polars()
        assert paste["group"].to_list() == ["", "batch", "batch:cask", "Residual"]
        other = kalfit.lmm("Reaction ~ Days + (0 + I(Days^2) | Subject)", SLEEP[1]).tidy("broom").to_polars()
        terms = ["Intercept", "Days", "sd__I(Days ** 2)", "sd__Observation"]
        assert other["term"].to_list() == terms, "neither states that do not vary nor means of zero have a row"
    with pytest.raises(ValueError, match="names is 'R'"):
        fit.tidy("R")


def _formulaic():
    try:
        import formulaic  # noqa: F401
    except ImportError:
        return False
    return True


def test_broom_s_p_values_without_degrees_of_freedom_are_normal(sleep):
    from scipy import stats

    row = sleep.tidy("broom").to_polars().row(1, named=True)
    assert row["term"] == "slope" and row["statistic"] == pytest.approx(row["estimate"] / row["std_error"])
    assert row["p_value"] == pytest.approx(2 * stats.norm.sf(row["statistic"]), rel=1e-9) and np.isnan(row["df"])
    fixed = kalfit.fit(*BENCH, deletion="none").tidy("broom").to_polars()
    assert fixed.filter(polars.col("term") == "tau")["conf_low"].is_nan().item(), "what is fixed has no interval"
    align = kalfit.fit(*PHASES, deletion="none").tidy("broom").to_polars()["term"].to_list()
    assert "align: tilt" in align and "sd__flight: tilt" in align


def test_glance_has_broom_s_figures(few):
    row = few.glance().to_polars().row(0, named=True)
    assert (row["nobs"], row["df_residual"]) == (180, 174) and abs(row["deviance"] - 1743.6283) < 1e-4
    assert abs(row["sigma"] - 25.592) < 1e-3 and row["log_likelihood"] == few.log_likelihood
    assert np.isnan(kalfit.fit(*META, deletion="none").glance().to_polars()["sigma"][0]), "there is none"


def test_inference_data_are_draws_of_the_normal_law(sleep):
    pytest.importorskip("arviz")
    drawn = sleep.to_arviz(4000, seed=3).posterior
    assert drawn.attrs["law"] == "normal law of the estimates, no posterior" and dict(drawn.sizes) == {"chain": 1, "draw": 4000}
    assert {*drawn.data_vars} == {*sleep.vcov("all").names}
    slope = drawn["mean[slope]"].values.ravel()
    error = sleep.estimates["mean[slope]"].std_error
    assert abs(slope.mean() - sleep.mean[1]) < 5 * error / 4000**0.5 and abs(slope.std() / error - 1) < 0.06
    assert (drawn["covariance[slope, slope]"].values > 0).all() and (drawn["sigma"].values > 0).all()
    both = np.cov(drawn["mean[intercept]"].values.ravel(), slope)[0, 1]
    assert both == pytest.approx(sleep.vcov()["mean[intercept]", "mean[slope]"], abs=0.4)
    assert sleep.to_arviz(5, seed=3).posterior.equals(sleep.to_arviz(5, seed=3).posterior)
    with pytest.raises(ValueError, match="law is 'bayes'"):
        sleep.to_arviz(law="bayes")
    with pytest.raises(ValueError, match="draws is 0"):
        sleep.to_arviz(0)


def test_inference_data_are_draws_of_a_bootstrap(sleep):
    pytest.importorskip("arviz")
    drawn = sleep.to_arviz(60, law="bootstrap", seed=7).posterior
    assert drawn.attrs["law"] == "parametric bootstrap, no posterior" and drawn.attrs["not_converged"] == 0
    slope = drawn["mean[slope]"].values.ravel()
    error = sleep.estimates["mean[slope]"].std_error
    assert abs(slope.mean() - sleep.mean[1]) < 4 * error / 60**0.5 and 0.7 < slope.std() / error < 1.4
    first = kalfit.fit(SLEEP[0], kalfit.simulate(SLEEP[0], sleep, SLEEP[1], seed=7).data, deletion="none")
    assert slope[0] == pytest.approx(first.mean[1], rel=1e-9) and drawn["std_dev[slope]"].values[0, 0] == pytest.approx(
        first.std_dev[1], rel=1e-6
    )
    with pytest.raises(TypeError, match="does not know its model"):
        kalfit.Fit.from_json(sleep.to_json()).to_arviz(law="bootstrap")


def test_without_arviz_the_message_says_how_to_install_it(sleep, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(ImportError, match=r"pip install 'kalfit\[arviz\]'"):
        sleep.to_arviz(5)
