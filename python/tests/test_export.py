"""The exported filter, run in numpy, gives kalfit's innovations; its files hold the same; fits side by side."""

from __future__ import annotations

import importlib.util
import json
import math
from typing import Any

import numpy as np
import pandas
import pytest
import scipy.io
from conftest import BENCH, SLEEP

import kalfit

MODEL = """
[data]
test = "unit"
time = "t"
time_unit = "s"
[states.bias]
unit = "deg/s"
[states.slow]
process = "gauss-markov-2"
time_constant = 2
sigma = 0.3
[states.walk]
process = "random-walk"
noise_density = 0.2
[states.angle]
derivative = "bias + slow + gain * (rate - 1)"
noise_density = 0.1
initial = { mean = 0.5, sigma = 0.2 }
[process_noise_covariance]
"walk, angle" = 0.01
[measurements.encoder]
column = "y"
equation = "angle + 0.1 * rate * T - 2"
noise = "sigma"
[measurements.gyro]
column = "z"
equation = "bias + slow + walk"
noise = 0.2
[noise_covariance]
"encoder, gyro" = 0.02
[parameters]
sigma = { start = 0.3 }
gain = 0.5
"""
NAMES = ["states", "units", "measurements", "columns", "inputs"]
ARRAYS = ["F", "Q", "B", "H", "D", "R", "x0", "P0"]


@pytest.fixture(scope="module")
def rows() -> pandas.DataFrame:
    random = np.random.default_rng(5)
    tables = []
    for unit in range(10):
        n = 15 + unit
        rate, warm = 1 + random.normal(size=n), 20 + random.normal(size=n)
        bias = random.normal()
        y = np.cumsum(0.5 * (bias + 0.5 * (rate - 1))) + 0.1 * rate * warm - 2 + 0.3 * random.normal(size=n)
        z = bias + np.cumsum(0.14 * random.normal(size=n)) + 0.2 * random.normal(size=n)
        y[random.random(n) < 0.2], z[random.random(n) < 0.2] = np.nan, np.nan
        tables.append(pandas.DataFrame({"unit": f"u{unit}", "t": 0.5 * np.arange(n), "rate": rate, "T": warm, "y": y, "z": z}))
    return pandas.concat(tables, ignore_index=True)


@pytest.fixture(scope="module")
def model() -> kalfit.Model:
    return kalfit.Model.from_text(MODEL)


@pytest.fixture(scope="module")
def fitted(model: kalfit.Model, rows: pandas.DataFrame) -> kalfit.Fit:
    return kalfit.fit(model, rows)


def run(f: Any, rows: pandas.DataFrame) -> np.ndarray:
    """(prediction, standard deviation) of each measured value: a filter from a textbook, which knows nothing of kalfit."""
    found = []
    for _, test in rows.groupby("unit", sort=False):
        x, P = np.array(f["x0"]), np.array(f["P0"])
        for k, row in enumerate(test.to_dict("records")):
            u = np.array([eval(text, {"__builtins__": {}}, row) for text in f["inputs"]], dtype=float)
            if k > 0:
                x, P = f["F"] @ x + f["B"] @ u, f["F"] @ P @ f["F"].T + f["Q"]
            z = np.array([row[column] for column in f["columns"]], dtype=float)
            seen = ~np.isnan(z)
            H = f["H"][seen]
            predicted = H @ x + f["D"][seen] @ u
            S = H @ P @ H.T + f["R"][np.ix_(seen, seen)]
            found.extend(zip(predicted, np.sqrt(np.diag(S))))
            gain = np.linalg.solve(S, H @ P).T
            x, P = x + gain @ (z[seen] - predicted), P - gain @ S @ gain.T
    return np.array(found)


def fields(filter: kalfit.Filter) -> dict[str, Any]:
    return {name: getattr(filter, name) for name in NAMES + ARRAYS}


def test_a_filter_in_numpy_gives_the_innovations_of_kalfit(model, rows, fitted):
    filter = kalfit.export(model, fitted, step=0.5)
    assert filter.inputs == ["rate", "rate * T", "1"] and len(filter.states) == 5
    found = run(fields(filter), rows)
    states = kalfit.apply(model, rows, fitted, states="predicted").states.to_pandas()
    expected = states[states["what"] == "measurement"][["value", "std_dev"]].to_numpy()
    assert found.shape == expected.shape and len(found) > 300
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_all_kinds_of_files_hold_the_same(model, fitted, tmp_path):
    filter = kalfit.export(model, fitted, step=0.5, out=tmp_path / "f.json")
    expected = fields(filter)

    def same(found: dict[str, Any]) -> None:
        for name in ARRAYS:
            array = np.array(found[name], dtype=float)
            assert array.shape == expected[name].shape, name
            np.testing.assert_array_equal(array, expected[name], err_msg=name)
        for name in NAMES:
            assert list(found[name]) == [text or "" for text in expected[name]], name
        assert float(found["step"]) == 0.5

    record = json.loads((tmp_path / "f.json").read_text())
    assert record == filter.to_dict()
    same({**record, "units": [unit or "" for unit in record["units"]]})

    kalfit.export(model, fitted, step=0.5, out=tmp_path / "f.npz")
    with np.load(tmp_path / "f.npz", allow_pickle=False) as arrays:
        same(dict(arrays))
        assert str(arrays["x0_at"]) == "first row" and str(arrays["time_unit"]) == "s"

    kalfit.export(model, fitted, step=0.5, out=tmp_path / "f.mat")
    found = scipy.io.loadmat(str(tmp_path / "f.mat"), chars_as_strings=True)
    texts = {name: [str(cell[0][0]) if cell[0].size else "" for cell in found[name]] for name in NAMES}
    assert found["x0"].shape == (5, 1) and str(found["x0_at"][0]) == "first row"
    same({**found, **texts, "x0": found["x0"][:, 0], "step": found["step"][0, 0]})

    kalfit.export(model, fitted, step=0.5, format="python", out=tmp_path / "module.py")
    spec = importlib.util.spec_from_file_location("module", tmp_path / "module.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    same({**vars(module), "units": [unit or "" for unit in module.units]})
    assert "import kalfit" not in (tmp_path / "module.py").read_text()

    first = (tmp_path / "f.npz").read_bytes()
    kalfit.export(model, fitted, step=0.5, out=tmp_path / "f.npz")
    assert (tmp_path / "f.npz").read_bytes() == first, "a filter is the same bytes whenever it is written"


def test_names_of_any_language_and_matrices_of_nothing_are_written(tmp_path):
    text = """
title = 'µ "quoted" \\ back*/slash'
[states.bias]
unit = "°/h"
[measurements.kreisel]
column = "größe"
equation = "bias"
noise = 0.1
[mean]
fixed = { bias = 1 }
[covariance]
fixed = { "bias, bias" = 4 }
"""
    model = kalfit.Model.from_text(text)
    filters = [kalfit.export(model, model, out=tmp_path / f"f.{ending}") for ending in ("npz", "mat", "py", "h")]
    assert filters[0].step is None and filters[0].B.shape == (1, 0) and filters[0].D.shape == (1, 0)
    with np.load(tmp_path / "f.npz", allow_pickle=False) as arrays:
        assert arrays["units"].tolist() == ["°/h"] and arrays["columns"].tolist() == ["größe"]
        assert arrays["B"].shape == (1, 0) and arrays["inputs"].shape == (0,) and math.isnan(arrays["step"])
        assert str(arrays["title"]) == 'µ "quoted" \\ back*/slash'
    found = scipy.io.loadmat(str(tmp_path / "f.mat"))
    assert str(found["units"][0, 0][0]) == "°/h" and found["B"].shape == (1, 0) and found["inputs"].shape[0] == 0
    names: dict[str, Any] = {}
    exec(compile((tmp_path / "f.py").read_text(encoding="utf-8"), "f.py", "exec"), names)
    assert names["units"] == ["°/h"] and names["__doc__"].startswith('µ "quoted" \\ back*/slash')
    header = (tmp_path / "f.h").read_text(encoding="utf-8")
    assert "back* /slash" in header and "f_B[" not in header


def test_what_has_no_constant_matrices_is_refused_in_words_of_python(tmp_path):
    fit = kalfit.fit(*SLEEP)
    with pytest.raises(kalfit.ModelError, match=r'depends on column `Days`[\s\S]*`at=\{"Days": VALUE\}`'):
        kalfit.export(SLEEP[0], fit)
    filter = kalfit.export(SLEEP[0], fit, at={"Days": 3})
    assert filter.H.tolist() == [[1.0, 3.0]] and filter.to_dict()["at"] == ["Days=3"]
    assert "1 measurement" in filter.summary() and "intercept" in repr(filter)
    with pytest.raises(ValueError, match="format says"):
        kalfit.export(SLEEP[0], fit, at={"Days": 3}, format="c")
    with pytest.raises(ValueError, match="format is"):
        kalfit.export(SLEEP[0], fit, at={"Days": 3}, format="xml", out=tmp_path / "f")
    with pytest.raises(kalfit.Error, match='format="json"'):
        kalfit.export(SLEEP[0], fit, at={"Days": 3}, out=tmp_path / "f")


def test_fits_are_compared_as_the_command_compares_them(command, tmp_path):
    text = kalfit.Model.load(SLEEP[0]).text
    models = {"full": text, "apart": text + '\n[covariance]\nstructure = "diagonal"\n'}
    fits = {}
    for name, own in models.items():
        fits[name] = kalfit.fit(kalfit.Model.from_text(own), SLEEP[1], out=tmp_path / f"{name}.json")
    paths = [tmp_path / f"{name}.json" for name in models]
    told = command("compare", *map(str, paths), out="compared.json")
    found = kalfit.compare(paths, out=tmp_path / "c.json")
    assert found.to_dict() == told == json.loads((tmp_path / "c.json").read_text())
    named = kalfit.compare(fits)
    assert [fit["name"] for fit in named.fits] == ["full", "apart"] and named.comparable
    test = named.nested[0]
    assert (test["null"], test["alternative"], test["df"]) == (1, 0, 1)
    assert test["lr"] == pytest.approx(2 * (fits["full"].log_likelihood - fits["apart"].log_likelihood))
    assert [difference["element"] for difference in named.differences] == ["covariance[intercept, slope]"]
    assert "Nested fits" in named.summary() and "2 fits" in repr(named)
    assert [fit["name"] for fit in kalfit.compare([fits["full"], fits["apart"]]).fits] == ["fit 1", "fit 2"]
    with pytest.raises(kalfit.DataError, match="not fits of the same data"):
        kalfit.compare([fits["full"], kalfit.fit(*BENCH)])
