"""What is known of single tests, and of groups of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kalfit._numbers import Array, array, number, square

__all__ = ["GroupFit", "TestFit", "group_fit_of", "test_fit_of"]


@dataclass(frozen=True)
class GroupFit:
    """What is known of one group of tests: the law of the mean of its members, given all data and the fit."""

    level: str
    #: Its name after those of the groups that it stands in, the outermost first.
    id: tuple[str, ...]
    tests: int
    log_likelihood: float
    #: Shape (p,).
    mean: Array
    #: Shape (p, p).
    covariance: Array
    #: How far the group lies from the population: chi-square under the model.
    distance: float | None
    degrees_of_freedom: int
    p_value: float | None


def group_fit_of(record: dict[str, Any]) -> GroupFit:
    """The group that a part of the results describes."""
    mean = array(record["mean"])
    return GroupFit(
        level=record["level"],
        id=tuple(record["id"]),
        tests=record["tests"],
        log_likelihood=record["log_likelihood"],
        mean=mean,
        covariance=square(record["covariance"], len(mean)),
        distance=record.get("distance"),
        degrees_of_freedom=record["degrees_of_freedom"],
        p_value=record.get("p_value"),
    )


@dataclass(frozen=True)
class TestFit:
    """What one test says: the law of its own initial state, given its data and the fit."""

    __test__ = False  # it is no test of pytest's

    id: str
    log_likelihood: float
    observations: int
    #: How far the test lies from the population: chi-square under the model.
    distance: float | None
    degrees_of_freedom: int | None
    p_value: float | None
    #: Mean by phase, each of shape (p,).
    means: dict[str, Array]
    #: Covariance by phase, each of shape (p, p).
    covariances: dict[str, Array]
    #: Its text in the column of ``[data] group``.
    group: str | None = None
    #: Names of its groups where the model has levels, the outermost first.
    groups: tuple[str, ...] = ()


def test_fit_of(record: dict[str, Any]) -> TestFit:
    """The test that a part of the results describes."""
    phases = [phase for phase in record["phases"] if phase.get("mean") is not None]
    return TestFit(
        id=record["id"],
        log_likelihood=float(record["log_likelihood"]),
        observations=int(record["observations"]),
        distance=number(record["distance"]),
        degrees_of_freedom=record["degrees_of_freedom"],
        p_value=number(record["p_value"]),
        means={phase["name"]: array(phase["mean"]) for phase in phases},
        covariances={phase["name"]: square(phase["covariance"], len(phase["mean"])) for phase in phases},
        group=record.get("group"),
        groups=tuple(record.get("groups", ())),
    )
