"""What is refused, and in which words."""

import os
import subprocess
from pathlib import Path

import pandas
import polars
import pyarrow
import pytest

import kalfit
from conftest import BENCH, SLEEP

MODEL = {
    "data": {"test": "id"},
    "states": {"level": {}},
    "measurements": {"y": {"column": "y", "equation": "level", "noise": 0.1}},
}


def test_exceptions_are_of_one_family():
    for kind in (kalfit.ModelError, kalfit.DataError, kalfit.FitError):
        assert issubclass(kind, kalfit.Error) and kind.__module__ == "kalfit"
    assert issubclass(kalfit.Interrupted, KeyboardInterrupt)


def test_a_wrong_model_is_shown_with_its_place_and_a_hint(tmp_path):
    text = Path(SLEEP[0]).read_text(encoding="utf-8").replace('noise = "sigma"', 'noize = "sigma"')
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(kalfit.ModelError) as caught:
        kalfit.Model.load(path)
    message = str(caught.value)
    assert "`noize`" in message and f"--> {path}:" in message and "^^^^^" in message and "hint: " in message
    program = os.environ.get("KALFIT_COMMAND")
    if program:
        done = subprocess.run([program, "check", str(path)], capture_output=True, text=True, check=False)
        assert done.returncode == 2 and done.stderr == f"error: {message}\n"


def test_wrong_data_are_named_by_table_row_and_column():
    with pytest.raises(kalfit.DataError, match=r"^data, row 2, column `y`: found `x`, expected a number"):
        kalfit.fit(MODEL, polars.DataFrame({"id": ["a", "b"], "y": ["1", "x"]}))
    with pytest.raises(kalfit.DataError, match=r"^data\[1\], row 1, column `y`: found `inf`"):
        kalfit.fit(MODEL, [polars.DataFrame({"id": ["a"], "y": [1.0]}), polars.DataFrame({"id": ["b"], "y": [float("inf")]})])
    with pytest.raises(kalfit.DataError, match=r"(?s)data has no column `y`.*hint: there is a column `Y`"):
        kalfit.fit(MODEL, pandas.DataFrame({"id": ["a"], "Y": [1.0]}))
    with pytest.raises(kalfit.DataError, match="data has no rows"):
        kalfit.fit(MODEL, polars.DataFrame({"id": [], "y": []}, schema={"id": polars.String, "y": polars.Float64}))
    with pytest.raises(kalfit.DataError, match="cannot read no-such.csv"):
        kalfit.fit(MODEL, "no-such.csv")
    table = polars.DataFrame({"id": ["a"], "y": [[1.0]]})
    with pytest.raises(kalfit.DataError, match="found values of type LargeList"):
        kalfit.fit(MODEL, table)
    with pytest.raises(kalfit.DataError, match="two columns named `y`"):
        kalfit.fit(MODEL, pyarrow.table([["a"], [1.0], [2.0]], names=["id", "y", "y"]))


def test_what_does_not_go_together_is_a_fit_error_or_a_model_error():
    with pytest.raises(kalfit.FitError, match="^`starts` has no effect"):
        kalfit.fit(*BENCH, starts=3)
    with pytest.raises(kalfit.ModelError, match="zigma"):
        kalfit.fit(*SLEEP, set={"zigma": 3})
    with pytest.raises(kalfit.ModelError, match="cannot test this hypothesis"):
        kalfit.test(*BENCH, {"covariance": {"structure": "full"}})
    with pytest.raises(kalfit.ModelError, match="no value is given for parameter `sigma`"):
        kalfit.reduce({**MODEL, "parameters": {"sigma": {}}, "measurements": {"y": {"column": "y", "equation": "level", "noise": "sigma"}}}, polars.DataFrame({"id": ["a"], "y": [1.0]}))


def test_messages_name_arguments_as_python_does():
    free = {**MODEL, "parameters": {"sigma": {}}, "measurements": {"y": {"column": "y", "equation": "level", "noise": "sigma"}}}
    rows = polars.DataFrame({"id": ["a", "b"], "y": [1.0, 2.0]})
    cases = [
        (lambda: kalfit.reduce(free, rows), 'hint: give it: `set={"sigma": VALUE}`'),
        (lambda: kalfit.fit(*BENCH, criterion="reml", std_errors="sandwich"), '`std_errors="sandwich"` go with `criterion="ml"` only'),
        (lambda: kalfit.fit(*BENCH, df="satterthwaite"), '`df="satterthwaite"` go with `criterion="reml"` only'),
        (lambda: kalfit.fit(*BENCH, phases="stacked"), '^`phases="stacked"` has no effect'),
    ]
    for call, words in cases:
        with pytest.raises(kalfit.Error) as caught:
            call()
        message = str(caught.value)
        assert message.startswith(words[1:]) if words.startswith("^") else words in message, message
        assert "--" not in message, message


def test_outputs_do_not_replace_inputs(tmp_path):
    model = tmp_path / "m.toml"
    model.write_text(Path(BENCH[0]).read_text(encoding="utf-8"))
    with pytest.raises(kalfit.Error, match="is one of the inputs"):
        kalfit.fit(model, BENCH[1], out=model)
    with pytest.raises(kalfit.Error, match="does not exist"):
        kalfit.fit(*BENCH, out=tmp_path / "no" / "fit.json")


def test_arguments_of_other_types_are_refused_in_words():
    with pytest.raises(TypeError, match="data is of type int, expected a path or a table"):
        kalfit.fit(BENCH[0], 3)
    with pytest.raises(TypeError, match="there are no data"):
        kalfit.fit(BENCH[0])
    with pytest.raises(TypeError, match="the model is of type int"):
        kalfit.fit(3, BENCH[1])
    with pytest.raises(ValueError, match="method is `hybrd`, expected one of `hybrid`"):
        kalfit.fit(*BENCH, method="hybrd")
    with pytest.raises(ValueError, match="tolerance is 2"):
        kalfit.fit(*BENCH, tolerance=2)
    with pytest.raises(ValueError, match="threads is 0"):
        kalfit.fit(*BENCH, threads=0)
    with pytest.raises(ValueError, match="seed has no effect without starts"):
        kalfit.fit(*SLEEP, seed=3)
    with pytest.raises(ValueError, match="standard input"):
        kalfit.fit(BENCH[0], "-")
    with pytest.raises(TypeError, match="found a value of type object"):
        kalfit.Model({"states": {"a": object()}})


def test_results_that_are_none_are_refused():
    for text in ("", "{}", '{"schema": "kalfit-fit/9"}', "[1]", '{"schema": "kalfit-fit/1"}'):
        with pytest.raises(kalfit.DataError, match="the results"):
            kalfit.Fit.from_json(text)
