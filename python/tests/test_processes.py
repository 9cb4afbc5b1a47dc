"""Fits in processes that Python starts: forked, which take over no threads, and new ones."""

from __future__ import annotations

import multiprocessing
import pickle
import threading

import pytest

import kalfit

from conftest import META, SLEEP

#: A fit takes a fraction of a second; a process that hangs is no fit.
PATIENCE = 120.0


def _log_likelihood(files: tuple[str, str]) -> float:
    return kalfit.fit(*files).log_likelihood


def _with_threads(threads: int) -> float:
    return kalfit.fit(*SLEEP, threads=threads).log_likelihood


@pytest.mark.parametrize("method", [m for m in ("fork", "spawn") if m in multiprocessing.get_all_start_methods()])
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_fits_in_other_processes_are_those_of_this_one(method: str) -> None:
    expected = [_log_likelihood(SLEEP), _log_likelihood(META)]  # starts threads here before any process is forked
    with multiprocessing.get_context(method).Pool(2) as pool:
        found = pool.map_async(_log_likelihood, [SLEEP, META, SLEEP, META]).get(PATIENCE)
        threads = pool.map_async(_with_threads, [1, 2]).get(PATIENCE)
    assert found == expected * 2
    assert threads == [expected[0]] * 2
    assert _log_likelihood(SLEEP) == expected[0]


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_child_of_a_child_fits() -> None:
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def inner() -> None:
        sender.send(_log_likelihood(META))

    def outer() -> None:
        _log_likelihood(META)
        child = context.Process(target=inner)
        child.start()
        child.join(PATIENCE)

    process = context.Process(target=outer)
    expected = _log_likelihood(META)
    process.start()
    assert receiver.poll(PATIENCE), "the inner process hangs"
    assert receiver.recv() == expected
    process.join(PATIENCE)


def test_threads_fit_side_by_side() -> None:
    expected = _log_likelihood(META)
    found: list[float] = []
    threads = [threading.Thread(target=lambda: found.append(_log_likelihood(META))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert found == [expected] * 8


def test_a_fit_travels_between_processes() -> None:
    fit = kalfit.fit(*META)
    back = pickle.loads(pickle.dumps(fit))
    assert back.log_likelihood == fit.log_likelihood
    for bytes_ in (b"", pickle.dumps(fit)[:-20], b"\x80\x04N."):
        try:
            broken = pickle.loads(bytes_)
        except (EOFError, pickle.UnpicklingError, ValueError, kalfit.Error):
            continue
        assert broken is None, "what is no fit does not become one"
