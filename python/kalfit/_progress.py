"""A job is told how many threads it has, and says how far it is."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Union

__all__ = ["How", "Progress", "Step", "how", "telling"]


class Step(str):
    """How far a job is, in words: a text that also says how much of how much is done, where the end is known.

    Functions that are given as ``progress`` are called with it.

    >>> import kalfit
    >>> step = kalfit.Step("reading", 30, 40)
    >>> step, step.done, step.of, step.share
    ('reading', 30, 40, 0.75)
    >>> kalfit.Step("pass 4").share is None
    True
    """

    __slots__ = ("done", "of")

    #: How much is done so far; ``None`` where the end is not known.
    done: int | None
    #: How much is to be done; ``None`` where that is not known.
    of: int | None

    def __new__(cls, words: str, done: int | None = None, of: int | None = None) -> Step:
        step = super().__new__(cls, words)
        step.done, step.of = done, of
        return step

    @property
    def share(self) -> float | None:
        """The part that is done, from 0 to 1; ``None`` where the end is not known."""
        return None if self.done is None or not self.of else min(self.done / self.of, 1.0)


#: Who is told how far a job is: nobody (``False``), a line on standard error (``True``), or a function of a :class:`kalfit.Step`.
Progress = Union[bool, Callable[[Step], object]]
#: Number of threads, and what is called with words, what is done and all that is to be done.
How = tuple[Union[int, None], Union[Callable[[str, Union[int, None], Union[int, None]], object], None]]


class _Line:
    """A line on standard error that is written over and over, and ends with the job."""

    def __init__(self) -> None:
        self._written = False

    def write(self, step: Step) -> None:
        share = "" if step.share is None else f", {100 * step.share:.0f} %"
        sys.stderr.write(f"\r{(step + share)[:110]:<110}")
        sys.stderr.flush()
        self._written = True

    def end(self) -> None:
        if self._written:
            sys.stderr.write("\n")
            sys.stderr.flush()


@contextmanager
def telling(progress: Progress) -> Iterator[Callable[[Step], object] | None]:
    """Who is told how far a job is; a line on standard error ends with the job."""
    if progress is not True:
        yield progress or None
        return
    line = _Line()
    try:
        yield line.write
    finally:
        line.end()


@contextmanager
def how(threads: int | None, progress: Progress) -> Iterator[How]:
    """How the compiled part does a job: with these threads, and telling this progress."""
    if threads is not None and not 1 <= threads <= 1024:
        raise ValueError(f"threads is {threads}, expected a number from 1 to 1024, or None for all processors")
    with telling(progress) as told:
        yield (threads, None if told is None else lambda words, done, of: told(Step(words, done, of)))
