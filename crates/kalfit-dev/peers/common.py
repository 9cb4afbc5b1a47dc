"""What the Python scripts share: the time of a piece of work alone, and the lines that `cargo dev peers` reads."""

import sys
import time
from importlib.metadata import version


def missing():
    """Status 77 says that a package is missing."""
    sys.exit(77)


def timed(work):
    """The result of `work`, and the processor and elapsed seconds of one run."""
    elapsed, processor = time.perf_counter(), time.process_time()
    result = work()
    return result, (time.process_time() - processor, time.perf_counter() - elapsed)


def repeated(work, batches=5, batch=0.3):
    """As `timed`, of short work: runs in batches long enough for the clock, and the least of them."""
    work()
    least = (float("inf"), float("inf"))
    for _ in range(batches):
        runs = 0
        elapsed, processor = time.perf_counter(), time.process_time()
        while time.perf_counter() - elapsed < batch:
            result = work()
            runs += 1
        taken = ((time.process_time() - processor) / runs, (time.perf_counter() - elapsed) / runs)
        least = tuple(map(min, least, taken))
    return result, least


def say(package, run, log_likelihood, **lists):
    print("version", package, version(package))
    print("log_likelihood", repr(float(log_likelihood)))
    for key, values in lists.items():
        print(key, *(repr(float(value)) for value in values))
    print("processor", repr(run[0]))
    print("elapsed", repr(run[1]))
