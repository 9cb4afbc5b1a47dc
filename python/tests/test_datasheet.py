"""Numbers of a datasheet: against the fit, and Allan deviations against numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest

import kalfit

MODEL = """
[data]
test = "run"
time = "t"
time_unit = "s"
[states.bias]
unit = "m/s^2"
[measurements.accelerometer]
column = "y"
equation = "bias"
noise = "sigma"
[parameters]
sigma = { start = 0.1, unit = "m/s^2" }
"""


@pytest.fixture(scope="module")
def rows() -> pandas.DataFrame:
    random = np.random.default_rng(3)
    runs = [
        pandas.DataFrame({"run": f"r{j}", "t": 0.5 * np.arange(100), "y": random.normal() + 0.2 * random.normal(size=100)})
        for j in range(8)
    ]
    return pandas.concat(runs, ignore_index=True)


def test_numbers_and_intervals_are_those_of_the_fit(rows: pandas.DataFrame, tmp_path: Path) -> None:
    model = kalfit.Model.from_text(MODEL)
    fit = kalfit.fit(model, rows)
    sheet = kalfit.datasheet(model, fit, rows, out=tmp_path / "sheet.json")
    assert sheet.to_json() == (tmp_path / "sheet.json").read_text()
    walk, mean, spread = sheet.entries
    sigma = fit.to_dict()["parameters"][0]
    # m/s^2 times sqrt(s) is m/s/sqrt(s); an hour has 3600 s
    factor = np.sqrt(0.5) * 60
    assert (walk["name"], walk["unit"]) == ("velocity random walk", "m/s/sqrt(h)")
    assert walk["value"] == pytest.approx(sigma["estimate"] * factor, rel=1e-12)
    assert walk["interval95"] == pytest.approx([end * factor for end in sigma["interval95"]], rel=1e-12)
    phase = fit.to_dict()["phases"][0]
    assert mean["value"] == pytest.approx(phase["mean"]["estimate"][0] / 9.80665e-6, rel=1e-12)
    assert spread["value"] == pytest.approx(phase["std_dev"]["estimate"][0] / 9.80665e-6, rel=1e-12)
    assert spread["interval95"] == pytest.approx([x / 9.80665e-6 for x in phase["std_dev"]["interval95"][0]], rel=1e-12)
    assert "velocity random walk" in sheet.summary()


def test_allan_deviations_of_records_are_those_of_numpy(rows: pandas.DataFrame) -> None:
    model = kalfit.Model.from_text(MODEL)
    sheet = kalfit.datasheet(model, kalfit.fit(model, rows), rows)
    (curve,) = sheet.allan
    assert [point["values"] for point in curve["points"]] == [1, 2, 5, 10, 20, 50]
    for point in curve["points"]:
        m, squares = point["values"], []
        for _, run in rows.groupby("run"):
            means = np.convolve(run["y"], np.ones(m) / m, "valid")
            squares.extend((means[m:] - means[:-m]) ** 2)
        expected = np.sqrt(np.mean(squares) / 2) / 9.80665e-6
        print(m, point["data"], expected)
        assert point["data"] == pytest.approx(expected, rel=1e-9)
        assert point["interval95"][0] < point["model"] < point["interval95"][1]


def test_a_step_stands_for_data() -> None:
    known = '[mean]\nfixed = { bias = 1 }\n[covariance]\nfixed = { "bias, bias" = 4 }\n'
    model = kalfit.Model.from_text(MODEL.replace("start = 0.1", "value = 0.1") + known)
    sheet = kalfit.datasheet(model, model, step=0.25)
    assert sheet.entries[0]["value"] == pytest.approx(0.1 * 0.5 * 60)
    assert sheet.allan[0]["points"][0]["model"] == pytest.approx(0.1 / 9.80665e-6)
    with pytest.raises(ValueError, match="step is given beside data"):
        kalfit.datasheet(model, model, "data.csv", step=1)
