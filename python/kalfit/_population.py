"""What is estimated of the population: the initial state of each phase, what varies at each level of groups, and crossed factors."""

from __future__ import annotations

from typing import Any, Literal

from kalfit._numbers import Array, MaskedArray, array, ends, masked_array, square

__all__ = ["Factor", "Level", "Phase"]


class _Spread:
    """A covariance of initial states, with all that is known of it. Arrays are in the order of :attr:`states`."""

    def __init__(self, record: dict[str, Any]) -> None:
        self._record = record
        #: Name of the phase or level.
        self.name: str = record["name"]
        #: Names of the p estimated states, in the order of every array.
        self.states: list[str] = list(record["states"])

    @property
    def covariance(self) -> Array:
        """Covariance of the initial state, shape (p, p)."""
        return square(self._record["covariance"]["estimate"], len(self.states))

    @property
    def covariance_std_error(self) -> MaskedArray:
        """Standard error of each element of the covariance, shape (p, p)."""
        return masked_array(self._record["covariance"]["std_error"]).reshape(len(self.states), len(self.states))

    @property
    def std_dev(self) -> Array:
        """Standard deviations of the initial state, shape (p,): roots of the diagonal of :attr:`covariance`."""
        return array(self._record["std_dev"]["estimate"])

    @property
    def std_dev_std_error(self) -> MaskedArray:
        """Standard errors of the standard deviations, shape (p,)."""
        return masked_array(self._record["std_dev"]["std_error"])

    @property
    def covariance_interval95(self) -> MaskedArray:
        """95 % intervals of the covariance, shape (p, p, 2): lower and upper end."""
        return ends(self._record["covariance"], (len(self.states), len(self.states)))

    @property
    def std_dev_interval95(self) -> MaskedArray:
        """95 % intervals of the standard deviations, shape (p, 2): lower and upper end."""
        return ends(self._record["std_dev"], (len(self.states),))

    @property
    def correlation_interval95(self) -> MaskedArray:
        """95 % intervals of the correlations, shape (p, p, 2): lower and upper end."""
        return ends(self._record["correlation"], (len(self.states), len(self.states)))

    @property
    def correlation(self) -> MaskedArray:
        """Correlations of the initial state, shape (p, p); masked beside a variance of zero."""
        return masked_array(self._record["correlation"]["estimate"]).reshape(len(self.states), len(self.states))

    @property
    def correlation_std_error(self) -> MaskedArray:
        """Standard errors of the correlations, shape (p, p)."""
        return masked_array(self._record["correlation"]["std_error"]).reshape(len(self.states), len(self.states))


class Phase(_Spread):
    """The estimated mean and covariance of the initial state of one phase, over the population.

    Arrays are in the order of :attr:`states`, in the units of the states. What may be unknown, such as the standard error of a fixed
    element, comes in masked arrays: an unknown number is masked, and so is whatever is calculated from it. :meth:`why_unknown`
    says why; ``filled()`` makes it NaN.
    """

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__(record)
        #: Unit label of each state; ``None`` where the model has none.
        self.units: list[str | None] = list(record.get("units") or [None] * len(self.states))

    @property
    def mean(self) -> Array:
        """Mean of the initial state, shape (p,)."""
        return array(self._record["mean"]["estimate"])

    @property
    def mean_std_error(self) -> MaskedArray:
        """Standard errors of the mean, shape (p,)."""
        return masked_array(self._record["mean"]["std_error"])

    @property
    def mean_interval95(self) -> MaskedArray:
        """95 % intervals of the mean, shape (p, 2): lower and upper end."""
        return ends(self._record["mean"], (len(self.states),))

    @property
    def mean_df(self) -> MaskedArray:
        """Degrees of freedom of the mean, shape (p,); all masked unless the criterion is ``reml``."""
        return masked_array(self._record["mean"].get("df") or [None] * len(self.states))

    @property
    def mean_p_value(self) -> MaskedArray:
        """Two-sided p-value of the hypothesis that each mean is zero, shape (p,); all masked unless the criterion is ``reml``."""
        return masked_array(self._record["mean"].get("p_value") or [None] * len(self.states))

    def why_unknown(
        self, what: Literal["mean", "std_dev", "covariance", "correlation"], state: str, other: str | None = None
    ) -> str | None:
        """Why a figure has no standard error, in words; ``None`` if it has one.

        - ``what``: the figure.
        - ``state``: its state.
        - ``other``: the other state of a covariance or a correlation; ``None`` is the same one.
        """
        return _why_unknown(self._record, self.states, what, state, other)

    def __repr__(self) -> str:
        return f"<kalfit.Phase {self.name!r}: {', '.join(self.states)}>"


class Level(_Spread):
    """The estimated covariance from group to group of a level, or, at the last level, from test to test within the groups.

    Arrays are in the order of :attr:`states`, in the units of the states. What may be unknown, such as the standard error of a fixed
    element, comes in masked arrays: an unknown number is masked, and so is whatever is calculated from it. :meth:`why_unknown`
    says why; ``filled()`` makes it NaN.
    """

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__(record)
        #: Column that names the groups; ``None`` for the level of the tests.
        self.column: str | None = record.get("column")
        #: Number of groups; for the level of the tests, their number.
        self.groups: int = record["groups"]

    def why_unknown(
        self, what: Literal["std_dev", "covariance", "correlation"], state: str, other: str | None = None
    ) -> str | None:
        """Why a figure has no standard error, in words; ``None`` if it has one.

        - ``what``: the figure.
        - ``state``: its state.
        - ``other``: the other state of a covariance or a correlation; ``None`` is the same one.
        """
        return _why_unknown(self._record, self.states, what, state, other)

    def __repr__(self) -> str:
        return f"<kalfit.Level {self.name!r}: {self.groups} groups, {', '.join(self.states)}>"


class Factor(Level):
    """The estimated covariance of the effects of a crossed factor, with the effect of each of its levels.

    It is a :class:`kalfit.Level` whose :attr:`groups` counts the levels; what is said there of arrays holds here. Effects are
    posterior means, given all tests, at the estimates; the arrays are empty where the fit has no results of tests.
    """

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__(record)
        effects = record.get("effects", [])
        p = len(self.states)
        #: Column of each slot, where a test has several members of the factor; empty otherwise.
        self.slots: dict[str, str] = {one["slot"]: one["column"] for one in record.get("slots", [])}
        #: Name of each level.
        self.names: list[str] = [effect["id"] for effect in effects]
        #: Number of tests that meet each level.
        self.tests: list[int] = [effect["tests"] for effect in effects]
        #: Effect of each level on each state, shape (levels, p).
        self.effects: Array = array([effect["mean"] for effect in effects]).reshape(len(effects), p)
        #: Posterior standard deviation of each effect, shape (levels, p).
        self.effects_std_dev: Array = array([effect["std_dev"] for effect in effects]).reshape(len(effects), p)
        #: Posterior covariance of the effects of each level, shape (levels, p, p).
        self.effects_covariance: Array = array([effect["covariance"] for effect in effects]).reshape(len(effects), p, p)

    def __repr__(self) -> str:
        return f"<kalfit.Factor {self.name!r}: {self.groups} levels, {', '.join(self.states)}>"


def _why_unknown(
    record: dict[str, Any], states: list[str], what: str, state: str, other: str | None
) -> str | None:
    if what not in ("mean", "std_dev", "covariance", "correlation"):
        raise ValueError(f"what is {what!r}, expected 'mean', 'std_dev', 'covariance' or 'correlation'")
    for name in (state, other):
        if name is not None and name not in states:
            raise KeyError(f"there is no state {name!r}, there are {', '.join(states)}")
    i = states.index(state)
    j = i if other is None else states.index(other)
    single = what in ("mean", "std_dev")
    error = record[what]["std_error"]
    if (error[i] if single else error[i][j]) is not None:
        return None
    if what == "correlation" and i == j:
        return "it is 1 by definition"
    if what == "correlation" and record[what]["estimate"][i][j] is None:
        return "a state that does not vary has no correlations"
    fixed = record["mean"]["fixed"][i] if what == "mean" else record["covariance"]["fixed"][i][j]
    if fixed:
        return "it is fixed"
    named = (states[i],) if what == "mean" else (states[i], states[j])
    kind = "mean" if what == "mean" else "covariance"
    for direction in record["unidentified"]:
        if direction["what"] == kind and _takes_part(direction, named):
            return direction.get("reason") or "the data do not determine it"
    for boundary in record["boundary"] if kind == "covariance" else []:
        if not boundary.get("states") or {*named} & {*boundary["states"]}:
            return f"it is on the boundary: the covariance is singular, of rank {boundary['rank']} of {boundary['of']}"
    return "it is not known"


def _takes_part(direction: dict[str, Any], named: tuple[str, ...]) -> bool:
    """Whether an unidentified direction moves a mean, or a covariance of these states."""
    elements = direction.get("elements", [])
    moved = [element for element, size in zip(elements, direction["direction"]) if abs(size) > 1e-6]
    texts = {named[0]} if len(named) == 1 else {f"{a}, {b}" for a, b in (named, named[::-1])}
    return not texts.isdisjoint(moved)
