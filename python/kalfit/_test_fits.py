"""What is known of single tests, and of groups of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kalfit._numbers import Array, array, number, square

__all__ = ["GroupFit", "TestFit", "group_fit_of", "test_fit_of"]


@dataclass(frozen=True)
class GroupFit:
    """What a fit says of one group of tests, such as a unit: the posterior of the mean of its members, given all data."""

    #: Name of its level.
    level: str
    #: Name of the group, after those of the groups that contain it, the outermost first.
    id: tuple[str, ...]
    #: Number of its tests.
    tests: int
    #: Log-likelihood of all measurements of its tests, by themselves.
    log_likelihood: float
    #: Posterior mean, shape (p,).
    mean: Array
    #: Posterior covariance of that mean, shape (p, p).
    covariance: Array
    #: Squared distance of the group from the population, in standard deviations: chi-squared under the model. ``None`` where it
    #: is not known.
    distance: float | None
    #: Degrees of freedom of the distance.
    degrees_of_freedom: int
    #: Probability of a larger distance under the model; ``None`` where it is not known.
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
    """What a fit says of one test: the posterior of its own initial state, given the data, and how well it agrees with the others."""

    __test__ = False  # it is no test of pytest's

    #: Name of the test.
    id: str
    #: Log-likelihood of its measurements; with levels, without the other tests of its group.
    log_likelihood: float
    #: Number of measured values.
    observations: int
    #: Squared distance of the test from the population, in standard deviations: chi-squared under the model. ``None`` where it is
    #: not known.
    distance: float | None
    #: Degrees of freedom of the distance.
    degrees_of_freedom: int | None
    #: Probability of a larger distance under the model; ``None`` where it is not known.
    p_value: float | None
    #: Posterior mean of the initial state by phase, each of shape (p,): ``test.means["main"]``.
    means: dict[str, Array]
    #: Posterior covariance of the initial state by phase, each of shape (p, p).
    covariances: dict[str, Array]
    #: Its text in the column of ``[data] group``; ``None`` where the model names none.
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
