"""Tables, names, intervals and figures of a fit."""

import sys

import numpy as np
import pytest

import kalfit
from conftest import BENCH, META, PHASES, SLEEP


@pytest.fixture(scope="module")
def bench():
    return kalfit.fit(*BENCH)


def test_tidy_is_what_the_command_writes(bench):
    table = bench.tidy()
    rows = table.to_polars()
    assert table.columns == rows.columns and {"name", "estimate", "std_error", "lower", "upper", "status"} <= {*rows.columns}
    frame = bench.parameters_frame()
    assert rows["name"].to_list() == frame["name"].to_list()
    assert rows["estimate"].to_list() == frame["estimate"].to_list()
    assert rows.filter(rows["name"] == "mean[scale]")["std_error"].item() == bench.phases[0].mean_std_error[1]
    assert rows.filter(rows["name"] == "noise_a")["status"].item() == "fixed"


def test_means_with_few_tests_have_degrees_of_freedom():
    few = kalfit.fit(*SLEEP, criterion="reml", innovations=False)
    rows = few.tidy().to_polars()
    mean = rows.filter(rows["name"] == "mean[slope]")
    assert mean["df"].item() == few.estimates["mean[slope]"].df == few.phases[0].mean_df[1]
    assert few.to_dict()["df_method"] == "kenward-roger" and abs(mean["df"].item() - 17) < 1e-4
    assert few.estimates["std_dev[slope]"].df is None
    other = kalfit.fit(*SLEEP, criterion="reml", df="none", innovations=False)
    assert "df_method" not in other.to_dict() and other.phases[0].mean_df.mask.all()


def test_glance_is_one_row_with_the_figures_of_the_fit(bench):
    row = bench.glance().to_polars().row(0, named=True)
    assert len(bench.glance()) == 1
    assert (row["log_likelihood"], row["aic"], row["bic"]) == (bench.log_likelihood, bench.aic, bench.bic)
    assert (row["tests"], row["observations"], row["free_parameters"], row["converged"]) == (28, 614, 9, 1)
    assert (row["criterion"], row["model_check"]) == ("ml", "passed")


def test_augment_has_a_row_for_each_test_and_phase(bench):
    rows = bench.augment().to_polars()
    assert rows["test"].to_list() == [test.id for test in bench.tests]
    assert rows["mean[bias]"][0] == bench.tests[0].means["main"][0]
    assert rows["displacement"].max() == max(test["deletion"]["displacement"] for test in bench.to_dict()["tests"])
    phases = kalfit.fit(*PHASES).augment().to_polars()
    assert phases["phase"].unique().sort().to_list() == ["align", "flight"]


def test_intervals_are_those_of_the_json(bench):
    phase, record = bench.phases[0], bench.to_dict()["phases"][0]
    for what, shape in [("mean", (3, 2)), ("std_dev", (3, 2)), ("covariance", (3, 3, 2)), ("correlation", (3, 3, 2))]:
        ends = getattr(phase, f"{what}_interval95")
        assert ends.shape == shape
        known = record[what]["interval95"]
        assert ends[1].tolist() == (known[1] if len(shape) == 2 else [one or [None, None] for one in known[1]]), what
    z = (phase.mean_interval95[:, 1] - phase.mean) / phase.mean_std_error
    assert np.allclose(z, 1.959964, atol=1e-6), z
    assert phase.correlation_interval95.mask[0, 0].all(), "a correlation that is 1 by definition has no interval"


def test_conf_int_has_every_estimate_with_an_interval(bench):
    rows = bench.conf_int().to_polars()
    by_name = {row["name"]: (row["lower"], row["upper"]) for row in rows.to_dicts()}
    assert by_name["mean[bias]"] == tuple(bench.phases[0].mean_interval95[0].tolist())
    assert by_name["mean[bias]"] == bench.estimates["mean[bias]"].interval95
    assert "tau" not in by_name, "it is fixed"


def test_every_number_has_a_name(bench):
    one = bench.estimates["std_dev[g_sensitivity]"]
    assert (one.kind, one.unit, one.status) == ("std_dev", "deg/h/g", "estimated")
    assert (one.estimate, one.std_error) == (bench.std_dev[2], bench.phases[0].std_dev_std_error[2])
    assert "flight: mean[tilt]" in kalfit.fit(*PHASES).estimates


def test_without_tests_there_are_none(command):
    fit = kalfit.fit(*META, tests=False)
    assert len(fit.tests) == 0 and len(fit.augment()) == 0 and fit.model_check["verdict"] == "not checked"
    assert fit.log_likelihood == kalfit.fit(*META).log_likelihood
    assert fit.to_dict()["tests"] == command("fit", *META, "--no-tests")["tests"] == []
    with pytest.raises(ValueError, match="deletion is 'all', but tests is False"):
        kalfit.fit(*META, tests=False, deletion="all")


def test_progress_says_what_part_is_done():
    steps = []
    ensemble = kalfit.Ensemble.from_arrays(np.random.default_rng(2).normal(size=(3000, 20, 1)), observation=[[1.0]], noise=[[0.1]])
    drawn = kalfit.simulate(ensemble.model(), ensemble.fit(), design=ensemble, seed=1, tests=200_000, progress=steps.append)
    assert drawn.tests == 200_000 and steps, "somebody was told"
    assert all(isinstance(step, str) and isinstance(step, kalfit.Step) for step in steps)
    shares = [step.share for step in steps if step.share is not None]
    assert shares and all(0.0 <= share <= 1.0 for share in shares), steps


@pytest.mark.parametrize("example", [BENCH, SLEEP, PHASES])
def test_figures_show_every_row(example, tmp_path):
    pytest.importorskip("matplotlib")
    fit = kalfit.fit(*example, deletion="all")
    for what in ("forest", "ellipses", "influence"):
        figure = fit.plot(what)
        assert figure.get_suptitle() == fit.title
        figure.savefig(tmp_path / f"{what}.png")
        assert (tmp_path / f"{what}.png").stat().st_size > 5000
    rows = sum(len(ax.get_yticks()) for ax in fit.plot("forest").axes)
    free = sum(not parameter.fixed for parameter in fit.parameters)
    assert rows == 2 * sum(len(phase.states) for phase in fit.phases) + free


def test_the_figure_of_influence_marks_what_the_model_check_names(bench):
    pytest.importorskip("matplotlib")
    ax = bench.plot("influence").axes[0]
    colors = {patch.get_facecolor()[:3] for patch in ax.patches[1:]}
    assert ax.get_yticklabels()[0].get_text() == "g07" and len(ax.patches) == 28
    assert ax.patches[0].get_facecolor()[:3] not in colors, "g07 alone is influential"


def test_what_cannot_be_drawn_says_why(bench, monkeypatch):
    with pytest.raises(ValueError, match="expected one of 'forest', 'ellipses', 'influence'"):
        bench.plot("pie")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'kalfit\[plot\]'"):
        bench.plot("forest")
