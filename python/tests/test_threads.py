"""Python goes on while kalfit works, and Ctrl-C is heard."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import polars
import pytest

import kalfit
from conftest import BENCH, SLEEP

#: A fit that takes long enough to be interrupted: ten seconds or more.
LONG = {"method": "em", "starts": 10_000}


def test_other_threads_run_during_a_fit():
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    began = time.monotonic()
    kalfit.fit(*SLEEP, method="em", starts=500)
    ended = time.monotonic()
    done.set()
    thread.join()
    during = [at for at in ticks if began < at < ended]
    gaps = [b - a for a, b in zip(during, during[1:])]
    assert len(during) > 10, f"{len(during)} ticks in {ended - began:.2f} s"
    assert max(gaps) < 0.5 * (ended - began), f"a gap of {max(gaps):.3f} s in {ended - began:.2f} s"


def test_fits_run_side_by_side_to_the_same_answers():
    expected = kalfit.fit(*BENCH).log_likelihood
    found = []
    threads = [threading.Thread(target=lambda: found.append(kalfit.fit(*BENCH).log_likelihood)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 4


@pytest.fixture
def hears_ctrl_c():
    """A shell that starts the tests in the background has them ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_ctrl_c")
def test_ctrl_c_ends_a_fit_and_leaves_the_best_so_far(tmp_path):
    timer = threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    began = time.monotonic()
    timer.start()
    with pytest.raises(KeyboardInterrupt) as caught:
        kalfit.fit(*SLEEP, **LONG, out=tmp_path / "fit.json")
    assert time.monotonic() - began < 30
    assert not (tmp_path / "fit.json").exists(), "an interrupted fit writes no file"
    if isinstance(caught.value, kalfit.Interrupted):
        assert caught.value.fit.states == ["intercept", "slope"]


def test_ctrl_c_from_outside_ends_the_program():
    script = textwrap.dedent(
        f"""
        import signal
        import kalfit
        signal.signal(signal.SIGINT, signal.default_int_handler)
        print("begun", flush=True)
        try:
            kalfit.fit(*{SLEEP!r}, method="em", starts=10_000)
        except kalfit.Interrupted as interrupted:
            print("best so far", interrupted.fit.log_likelihood > -900)
        """
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "begun\n"
        time.sleep(1.0)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
    assert out == "best so far True\n", (out, err)


def test_progress_is_told_and_may_end_the_work():
    told = []
    kalfit.fit(*SLEEP, method="em", starts=2, progress=told.append)
    assert told and all(isinstance(line, str) for line in told)

    def enough(line):
        raise LookupError(line)

    with pytest.raises(LookupError):
        kalfit.fit(*SLEEP, **LONG, progress=enough)


def test_progress_goes_to_standard_error(capsys):
    kalfit.fit(*SLEEP, method="em", starts=1, progress=True)
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("\r")


def test_a_large_table_is_taken_without_python_s_lock():
    rows = 200_000
    table = polars.DataFrame({"id": [str(i // 10) for i in range(rows)], "y": [float(i % 7) for i in range(rows)]})
    model = {
        "data": {"test": "id"},
        "states": {"level": {}},
        "measurements": {"y": {"column": "y", "equation": "level", "noise": 1}},
    }
    fit = kalfit.fit(model, table, innovations=False, deletion="none")
    assert fit.to_dict()["data"]["tests"] == rows // 10 and fit.converged
