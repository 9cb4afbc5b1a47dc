"""A job is told how many threads it has, and says how far it is."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Union

__all__ = ["How", "Progress", "Step", "how", "write_progress"]


class Step(str):
    """How far a job is, in words: a text, which also says how much of how much is done, where the end is known.

    >>> step = Step("reading", 30, 40)
    >>> step, step.done, step.of, step.share
    ('reading', 30, 40, 0.75)
    >>> Step("pass 4").share is None
    True
    """

    __slots__ = ("done", "of")

    #: Done so far; None where the end is not known.
    done: int | None
    #: All that is to be done.
    of: int | None

    def __new__(cls, words: str, done: int | None = None, of: int | None = None) -> Step:
        step = super().__new__(cls, words)
        step.done, step.of = done, of
        return step

    @property
    def share(self) -> float | None:
        """What part is done, from 0 to 1; None where the end is not known."""
        return None if self.done is None or not self.of else min(self.done / self.of, 1.0)


Progress = Union[bool, Callable[[Step], object]]
#: Number of threads, and what is called with words, what is done and all that is to be done.
How = tuple[Union[int, None], Union[Callable[[str, Union[int, None], Union[int, None]], object], None]]


def write_progress(step: Step) -> None:
    """Writes a line to standard error, over the one before."""
    share = "" if step.share is None else f", {100 * step.share:.0f} %"
    sys.stderr.write(f"\r{(step + share)[:110]:<110}")
    sys.stderr.flush()


def how(threads: int | None, progress: Progress) -> How:
    """How the compiled part does a job: with these threads, and telling this progress."""
    if threads is not None and not 1 <= threads <= 1024:
        raise ValueError(f"threads is {threads}, expected a number from 1 to 1024, or None for all processors")
    if progress is False:
        return (threads, None)
    told = write_progress if progress is True else progress
    return (threads, lambda words, done, of: told(Step(words, done, of)))
