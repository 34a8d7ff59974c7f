"""The sequence of sticks as a Markov chain: its transition kernel, from simulated sticks or by quadrature, and what
follows from it for any number of successive sticks.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Hashable, Mapping
from functools import cached_property
from typing import Any, NamedTuple, cast, get_args

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from .._dynamics.sticks import FlatSticks
from .._excitation.motion import RandomPhase
from .._foundation import checks
from .._foundation.types import Ending
from .._systems.system import System
from .distribution import bin_of
from .estimate import EnsembleLike, Estimate, origin_of, require_ensemble
from .independence import HypothesisTest, Verdict, check_significance, holm, serial_correlation
from .quadrature import FOLLOWING, After, Columns, by_quadrature, levels_of, period_of

# What is known when a stick ends, and what follows from it.
#
# With a base whose jumps have no memory (`PoissonSwitching`), or one that depends on its own phase only (`RandomSteps`,
# periodic bases), what comes after a stick depends on the past by where the mass is when the stick ends, how the base
# moves then, and its phase. So the ends of successive sticks are a Markov chain. All of it follows from the columns of
# the sticks: the base moved with the mean velocity of the stick, and the mass was left where the next slip began. A
# stick that ends with a jump of the base does not tell the new velocity; but that is drawn then, from what the old one
# allows, and belongs to what follows.

_STATE: dict[str, tuple[str, ...]] = {
    "stick": ("end_position", "base_velocity", "ending", "phase"),
    "slip": ("position", "base_velocity", "phase"),
}
"""What is known then."""
_UNITS = {"base_velocity": "m/s", "ending": "1"}  # of a position its own, of all others s
_CATEGORIES = ("base_velocity", "ending")  # of which each value is told apart, if there are few
_MOST_LEVELS = 16
_ALIKE = 1e-6  # of the largest: closer velocities, and positions, are one
_PARTS = 20  # of the samples, each left out once for standard errors
_MOST_CELLS = 2**24  # of tables
_BLOCK = 16  # transitions from nearly the same state
_CLASSES = 8  # of numbers where they are ranked: what differs by less than one among like states tells nothing
_POINTS = 2**18  # of a quadrature
_DRAWN_FROM = 8  # transitions that began closest
_BEYOND = 0.05  # of the range of a number: so far outside of what is known it is still taken for the nearest


class Cells(NamedTuple):
    """How the states are divided: by the values of some numbers, and then by quantiles of the others.

    - `categories`: the numbers that are told apart, by name, and their values, one column for each category.
    - `edges`: of each category, those of the cells along each other number (inner ones only), and its first cell.
    """

    names: tuple[str, ...]
    categories: Float[np.ndarray, "names categories"]
    others: tuple[str, ...]
    edges: tuple[tuple[np.ndarray, ...], ...]
    first: Int[np.ndarray, " categories_and_end"]

    @classmethod
    def of(cls, state: Columns, bins: int) -> "Cells":
        """About `bins` cells in each category, with about as many states each."""
        names = tuple(
            name for name in state if name in _CATEGORIES and len(np.unique(state[name][:100_000])) <= _MOST_LEVELS
        )
        others = tuple(name for name in state if name not in names)
        size = len(next(iter(state.values())))
        rows = np.array([state[name] for name in names]).reshape(len(names), size)
        categories, whose = np.unique(rows, axis=1, return_inverse=True) if names else (rows[:, :1], np.zeros(size))
        edges = []
        for number in range(categories.shape[1]):
            here = whose.ravel() == number
            of = [state[name][here] for name in others]
            sizes = [_ALIKE * np.max(np.abs(state[name]), initial=0.0) for name in others]
            varying = [np.ptp(values) > size for values, size in zip(of, sizes, strict=True)]
            each = round(bins ** (1 / max(sum(varying), 1)))
            inner = (np.unique(np.quantile(values, np.arange(1, each) / each)) for values in of)
            edges.append(tuple(own if varies else np.zeros(0) for own, varies in zip(inner, varying, strict=True)))
        sizes = [math.prod(len(one) + 1 for one in own) for own in edges]
        return cls(names, categories, others, tuple(edges), np.cumsum([0, *sizes]))

    @property
    def number(self) -> int:
        """How many cells there are."""
        return int(self.first[-1])

    def category_of(self, state: Columns) -> Int[np.ndarray, " states"]:
        """The category of each state; -1 of those that no state was in."""
        size = len(next(iter(state.values())))
        found = np.full(size, -1 if self.names else 0)
        if self.names:
            rows = np.array([state[name] for name in self.names])
            for number, values in enumerate(self.categories.T):
                found[np.all(rows == values[:, None], axis=0)] = number
        return found

    def cell_of(self, state: Columns) -> Int[np.ndarray, " states"]:
        """The cell of each state; -1 of those in no category."""
        category = self.category_of(state)
        cell = np.full(len(category), -1)
        for number, edges in enumerate(self.edges):
            here = np.flatnonzero(category == number)
            place = np.zeros(len(here), int)
            for name, inner in zip(self.others, edges, strict=True):
                place = place * (len(inner) + 1) + np.searchsorted(inner, state[name][here], side="right")
            cell[here] = self.first[number] + place
        return cell


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class SequenceDistribution:
    """The joint distribution of numbers of successive sticks, in bins: of any number of them.

    - `names`: of each, such as ``("duration", 1)``: that of the first stick to come. `edges`: of its bins.
    - `probabilities`: of the cells, one axis for each number. `replicates`: the same without each part of the samples,
      from which standard errors follow.
    """

    names: tuple[tuple[str, int], ...]
    edges: tuple[np.ndarray, ...]
    probabilities: np.ndarray
    replicates: tuple[np.ndarray, ...]
    samples: int
    origin: Hashable

    @property
    def standard_errors(self) -> np.ndarray:
        """The standard errors of the `probabilities`."""
        return _jackknifed(np.array(self.replicates))

    @property
    def density(self) -> np.ndarray:
        """The probability density, per unit of each number."""
        volume = np.ones(())
        for edges in self.edges:
            volume = volume[..., None] * np.diff(edges)
        return self.probabilities / volume

    def entropy(self) -> Estimate:
        """The Shannon entropy of the probabilities, nats."""
        return self._estimate("entropy", _entropy)

    def mutual_information(self) -> Estimate:
        """What the numbers tell of each other, nats: the sum of their entropies less the entropy of all together."""
        axes = range(self.probabilities.ndim)

        def shared(p: np.ndarray) -> float:
            alone = sum(_entropy(p.sum(axis=tuple(other for other in axes if other != axis))) for axis in axes)
            return alone - _entropy(p)

        return self._estimate("mutual information", shared)

    def _estimate(self, name: str, function: Callable[[np.ndarray], float]) -> Estimate:
        error = float(_jackknifed(np.array([function(one) for one in self.replicates])))
        of = ", ".join(f"{number} {order}" for number, order in self.names)
        return Estimate(f"{name} of {of}", function(self.probabilities), error, "nat", self.samples, self.origin)

    def __repr__(self) -> str:
        return f"{self.mutual_information()}\n{self.entropy()}"


def _entropy(p: np.ndarray) -> float:
    positive = p[p > 0]
    return float(-(positive @ np.log(positive)))


def _jackknifed(replicates: np.ndarray) -> np.ndarray:
    """The standard error of what has these `replicates`, (parts, ...), each without one part."""
    parts = len(replicates)
    return np.asarray(np.sqrt((parts - 1) * np.mean((replicates - replicates.mean(axis=0)) ** 2, axis=0)))


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TransitionKernel:
    """The distribution of what follows a stick (or a slip), given the state at its end: result of `transition_kernel`.

    - `after`: "stick" or "slip". `given`: the names of what is known at its end.
    - `state`, `next_state`: what is known at the end of each, and of the one after it, by name, (transitions,).
      `following`: the numbers of what comes between these ends, by name, (transitions,).
    - `owner`: the sample of each transition; those of a sample are in order of time. `samples`: their number.
    - `incomplete`: how many ends were left out because the end of the simulation cut what follows.
    - `cells`: how states are divided for all that is computed with matrices. `position_unit`: of positions.
    """

    after: str
    given: tuple[str, ...]
    state: Columns
    following: Columns
    next_state: Columns
    owner: Int[np.ndarray, " transitions"]
    samples: int
    incomplete: int
    cells: Cells
    position_unit: str
    origin: Hashable = dataclasses.field(default_factory=object)

    @property
    def number(self) -> int:
        """Number of transitions."""
        return len(self.owner)

    @cached_property
    def cell(self) -> Int[np.ndarray, " transitions"]:
        """The cell of each state."""
        return self.cells.cell_of(self.state)

    @cached_property
    def next_cell(self) -> Int[np.ndarray, " transitions"]:
        """The cell of each next state."""
        return self.cells.cell_of(self.next_state)

    @cached_property
    def counts(self) -> Int[np.ndarray, "cells cells"]:
        """How many transitions lead from each cell to each."""
        return self._table(np.zeros(self.number, int), 1).sum(axis=(0, 3))

    @property
    def probabilities(self) -> Float[np.ndarray, "cells cells"]:
        """The probability of a transition from each cell (a row) to each cell."""
        return _rows(self.counts)

    @property
    def standard_errors(self) -> Float[np.ndarray, "cells cells"]:
        """Those of the `probabilities`: binomial, since what follows a state depends on no other transition."""
        p, number = self.probabilities, self.counts.sum(axis=1, keepdims=True)
        return np.sqrt(p * (1 - p) / np.maximum(number, 1))

    @property
    def stationary(self) -> Float[np.ndarray, " cells"]:
        """The distribution over the cells that the chain tends to."""
        return _stationary(self.probabilities)

    @property
    def stationary_errors(self) -> Float[np.ndarray, " cells"]:
        """The standard errors of `stationary`."""
        return self._error_of(_stationary)

    @property
    def second_eigenvalue(self) -> Estimate:
        """The absolute value of the second largest eigenvalue: the factor by which each stick lessens what is left of
        the influence of the first.
        """
        value, error = _second(self.probabilities), float(self._error_of(_second))
        return Estimate("second eigenvalue of the transition kernel", value, error, "1", self.samples, self.origin)

    def steps_to_forget(self, distance: float = 0.01) -> int:
        """After how many sticks the start is forgotten: from whatever state, the distribution over the cells then
        differs from the stationary one by at most `distance` (total variation).

        Raises:
            ValueError: Unless ``0 < distance < 1``, and where the chain never forgets its start.
        """
        checks.bounded("distance", distance, above=0, below=1)
        _, p = _lasting(self.probabilities)
        power, limit, steps = p, _stationary(p), 1
        while np.max(np.abs(power - limit).sum(axis=1)) / 2 > distance:
            if steps >= 10_000:
                raise ValueError("This chain does not forget its start within 10,000 sticks; it may be periodic.")
            power, steps = power @ p, steps + 1
        return steps

    def joint(self, *values: tuple[str, int], bins: int = 20, start: object = "stationary") -> SequenceDistribution:
        """The joint distribution of numbers of successive sticks, composed of transitions.

        Args:
            *values: Pairs of a name of `following` and an order: ``("duration", 1), ("duration", 2)`` are the durations
                of the first and the second stick to come. Any number of them.
            bins: The largest number of bins of each.
            start: Where the chain begins: "stationary", or a state by name, ``{"end_position": 0.1, ...}``.

        Raises:
            ValueError: For other names or orders, the same twice, and for more than 2^24 cells in all.
        """
        bins = checks.whole_number("bins", bins, minimum=2, maximum=1000)
        if not values:
            raise checks.refused("values", "hold pairs such as ('duration', 1)", values)
        for value in values:
            if not (isinstance(value, tuple) and len(value) == 2):
                raise checks.refused("values", "hold pairs such as ('duration', 1)", value)
            checks.chosen("values", value[0], self.following)
            checks.whole_number("values", value[1], maximum=10_000)
        if len(set(values)) < len(values):
            raise checks.refused("values", "hold each number once", values)
        edges = tuple(np.linspace(own.min(), own.max(), bins + 1) for own in (self.following[n] for n, _ in values))
        tables, sizes = [], [bins] * len(values)
        if bins ** len(values) * self.cells.number > _MOST_CELLS:
            raise checks.refused("bins", f"be fewer for {len(values)} numbers: at most 2^24 cells in all", bins)
        for order in range(1, max(order for _, order in values) + 1):
            own = [at for at, (_, one) in enumerate(values) if one == order]
            place = np.zeros(self.number, int)
            for at in own:
                inside = np.clip(bin_of(self.following[values[at][0]], edges[at]), 0, bins - 1)
                place = place * bins + inside
            tables.append((self._table(place, bins ** len(own)), own))
        begin = None
        if isinstance(start, Mapping):
            begin = np.eye(self.cells.number)[self.cells.cell_of(self._checked(start))[0]]
        else:
            checks.chosen("start", start, ("stationary",))

        def composed(pick: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
            chance, axes = None, []
            for table, own in tables:
                counted = pick(table)
                kernel = counted / np.maximum(counted.sum(axis=(1, 2), keepdims=True), 1)
                if chance is None:
                    chance = (_stationary(_rows(counted.sum(axis=2))) if begin is None else begin)[None]
                flow = np.tensordot(chance, kernel, axes=([1], [0]))  # (values so far, next cell, bins)
                chance = flow.transpose(0, 2, 1).reshape(-1, self.cells.number)
                axes += own
            assert chance is not None
            return chance.sum(axis=1).reshape([sizes[at] for at in axes]).transpose(np.argsort(axes))

        replicates = tuple(composed(lambda t, g=g: t.sum(axis=0) - t[g]) for g in range(_PARTS))
        whole = composed(lambda t: t.sum(axis=0))
        return SequenceDistribution(tuple(values), edges, whole, replicates, self.samples, self.origin)

    def nearest(
        self, state: Mapping[str, Any], number: int, generator: np.random.Generator, *, is_centred: bool = True
    ) -> Int[np.ndarray, "states number"]:
        """The transitions that began closest to each `state`, (states,) numbers by name: those of its category.

        Of a category in which all states are one, any of its transitions. `is_centred`: whether the state is amidst
        them; if not, it is anywhere among them, as if it had been drawn like theirs.

        Raises:
            ValueError: For other names than `given`, and a state in no category.
        """
        columns = self._checked(state)
        category = self.cells.category_of(columns)
        present = np.unique(category).tolist()
        number = min(number, *(len(self._members[one]) for one in present))
        found = np.empty((len(category), number), int)
        for one in present:
            here, members = category == one, self._members[one]
            if not self._scales[one]:
                found[here] = members[generator.integers(len(members), size=(here.sum(), number))]
                continue
            near = self._closest(one, self._points(one, columns, here), number)
            if not is_centred:
                about = near[np.arange(len(near)), generator.integers(number, size=len(near))]
                near = self._closest(one, self._points(one, self.state, about), number)
            found[here] = near
        return found

    def like(
        self, state: Mapping[str, float], number: int | None = None, among: np.ndarray | None = None
    ) -> Int[np.ndarray, " transitions"]:
        """The transitions that began closest to one `state`; all, where all of its category began from one.

        Args:
            state: Numbers by name.
            number: How many; by default ``n^0.7``, at least 50, of the n of this category.
            among: Which transitions count, (transitions,); by default all.

        Raises:
            ValueError: As `nearest`.
        """
        columns = self._checked(state, is_single=True)
        category = int(self.cells.category_of(columns)[0])
        members = self._members[category]
        wanted = len(members) if not self._scales[category] else number or max(50, round(len(members) ** 0.7))
        size = wanted = min(wanted, len(members))
        while True:
            near = members
            if size < len(members):
                near = self._closest(category, self._points(category, columns, np.zeros(1, int)), size)[0]
            near = near if among is None else near[among[near]]
            if len(near) >= wanted or size == len(members):
                return near[:wanted]
            size = min(4 * size, len(members))

    def unit_of(self, name: str) -> str:
        """The unit of one of the numbers."""
        return self.position_unit if "position" in name else _UNITS.get(name, "s")

    def order_test(self, significance: float = 0.05) -> Verdict:
        """Test whether the state tells all: given it, does what follows depend on what was before?

        Transitions from nearly the same state, 16 at a time, are ranked among each other by a number of the cycle
        before (of the state at its begin, and of what followed that), and by one of what follows. If the state tells
        all, both ranks are independent. Since the states of the 16 differ too, a linear function of these is taken out,
        and what then differs by less than an eighth of all transitions is equal. The tests are serial rank correlations
        as in `independent`, one for each pair.

        Raises:
            ValueError: Unless ``0 < significance < 1``.
        """
        check_significance(significance)
        later = np.flatnonzero(np.diff(self.owner, prepend=-1) == 0)
        block = self._blocks(later)
        counts = np.bincount(self.owner[later], minlength=self.samples)
        before = {f"{words(name)} two {self.after}s ago": column for name, column in self.state.items()}
        before |= {f"earlier {words(name)}": self.following[name] for name in self.following if name not in self.given}
        rest = _beyond_state([self.state[name][later] for name in self.cells.others], block)
        before = {name: rest(column[later - 1]) for name, column in before.items()}
        following = {name: rest(column[later]) for name, column in self.following.items()}
        tests = []
        for (early, column), (late, values) in itertools.product(before.items(), following.items()):
            test = serial_correlation(column, values, block, counts)
            tests.append(dataclasses.replace(test, name=f"{early}, {words(late)}"))
        reason, made = tests[0].reason, tuple(test for test in tests if test.made)
        if not any(map(np.any, following.values())):
            reason = "what follows like states hardly differs, so that nothing is left to explain"
        together = HypothesisTest("Serial rank correlation", reason=reason)
        if made:
            reason, least = "", min(made, key=lambda test: test.p_value)
            name = f"Serial rank correlation, {len(made)} pairs of numbers"
            p_value = min(holm([test.p_value for test in made]))
            effect = (least.effect, f"rank correlation of {least.name}", least.effect_error)
            together = HypothesisTest(name, least.statistic, p_value, *effect, least.sizes, parts=made)
        question = f"Does what follows a {self.after} depend on its end alone ({', '.join(map(words, self.given))})?"
        remark = (
            f"Compared {len(later)} transitions that have one before, in blocks of up to {_BLOCK} from like states."
        )
        return Verdict(question, significance, (together,), self.samples, len(later), reason, (remark,))

    def sample(
        self, sequences: int, sticks: int, *, seed: int = 0, start: Mapping[str, float] | None = None
    ) -> FlatSticks:
        """Sequences of sticks drawn from the kernel: each stick is one that followed a state close to the last end.

        Times count from the end of the stick (or of the slip) that the sequence starts from.

        Args:
            sequences: How many.
            sticks: The number of sticks of each.
            seed: Of the random numbers.
            start: The state that all start from, by name; by default each starts from that of a transition.

        Returns:
            The sticks, for all that takes `flat_sticks`, such as `independent`.

        Raises:
            ValueError: For numbers below 1, and a state that is not known.
        """
        sequences, sticks = checks.whole_number("sequences", sequences), checks.whole_number("sticks", sticks)
        generator = np.random.default_rng(checks.whole_number("seed", seed, minimum=0))
        if start is None:
            chosen = generator.integers(self.number, size=sequences)
            state = {name: column[chosen] for name, column in self.state.items()}
        else:
            state = {name: np.repeat(one, sequences) for name, one in self._checked(start, is_single=True).items()}
        first, drawn = state.get("position", np.full(sequences, np.nan)), list[Columns]()
        for _ in range(sticks):
            near = self.nearest(state, _DRAWN_FROM, generator)
            one = near[np.arange(sequences), generator.integers(near.shape[1], size=sequences)]
            drawn.append({name: column[one] for name, column in self.following.items()})
            state = {name: column[one] for name, column in self.next_state.items()}
        of = {name: np.stack([one[name] for one in drawn], axis=1) for name in drawn[0]}
        if self.after == "stick":
            end = np.cumsum(of["slip_before"] + of["duration"], axis=1)
            position, start_at = of["position"], end - of["duration"]
        else:  # the position belongs to the stick after the slip
            start_at = np.cumsum(of["duration"] + of["slip_duration"], axis=1) - of["duration"] - of["slip_duration"]
            end = start_at + of["duration"]
            position = np.concatenate([first[:, None], of["position"][:, :-1]], axis=1)
        moved = position - np.concatenate([np.full((sequences, 1), np.nan), of["end_position"][:, :-1]], axis=1)
        columns = {"position": position, "slip_displacement": moved}
        flat = {name: column.ravel() for name, column in columns.items()}
        count = np.full(sequences, sticks)
        return FlatSticks.of(count, start_at.ravel(), end.ravel(), of["ending"].ravel().astype(np.int8), **flat)

    @cached_property
    def _members(self) -> list[np.ndarray]:
        """The transitions of each category."""
        category = self.cells.category_of(self.state)
        return [np.flatnonzero(category == one) for one in range(self.cells.categories.shape[1])]

    @cached_property
    def _scales(self) -> list[dict[str, float]]:
        """By category: what numbers that are not told apart are measured in, standard deviations; none if all alike."""
        found = []
        for members, edges in zip(self._members, self.cells.edges, strict=True):
            varying = [name for name, inner in zip(self.cells.others, edges, strict=True) if len(inner)]
            found.append({name: float(self.state[name][members].std()) for name in varying})
        return found

    def _points(self, category: int, columns: Columns, which: np.ndarray) -> np.ndarray:
        """Where states are in their category, in the units of the scales, (states, numbers)."""
        scales = self._scales[category].items()
        return np.stack([columns[name][which] / scale for name, scale in scales], axis=1)

    @cached_property
    def _trees(self) -> dict[int, Any]:
        return {}

    def _closest(self, category: int, points: np.ndarray, number: int) -> np.ndarray:
        from scipy.spatial import KDTree  # noqa: PLC0415 - slow to load

        members = self._members[category]
        if category not in self._trees:
            self._trees[category] = KDTree(self._points(category, self.state, members))
        return members[self._trees[category].query(points, k=range(1, number + 1))[1]]

    def _blocks(self, chosen: np.ndarray) -> Int[np.ndarray, " chosen"]:
        """A number for each of the `chosen` transitions, alike for up to `_BLOCK` that began from nearly one state."""
        block, last = np.empty(self.number, int), 0
        for category, members in enumerate(self._members):
            inside = members[np.isin(members, chosen, assume_unique=True)]
            points = self._points(category, self.state, inside) if self._scales[category] else None
            waiting = [np.arange(len(inside))]
            while waiting:
                some = waiting.pop()
                if len(some) <= _BLOCK or points is None:
                    block[inside[some]] = last
                    last += 1
                    continue
                widest = int(np.argmax(np.ptp(points[some], axis=0)))
                half = len(some) // 2
                parted = some[np.argpartition(points[some, widest], half)]
                waiting += [parted[:half], parted[half:]]
        return block[chosen]

    def _checked(self, state: Mapping[str, Any], *, is_single: bool = False) -> Columns:
        """The columns of states, (states,). Raises ValueError for other names than `given`, for what is no number, and
        for an unknown one; a single one must be amidst those of its category: closest to any other are states too.
        """
        if not isinstance(state, Mapping) or set(state) != set(self.given):
            raise checks.refused("state", f"hold a number for each of {', '.join(self.given)}", state)
        for name, value in state.items():
            checks.numeric(f"state[{name!r}]", value, 0 if is_single else None)
        columns = {name: np.atleast_1d(np.asarray(state[name], float)) for name in self.given}
        if np.any(unknown := self.cells.category_of(columns) < 0):
            at = int(np.argmax(unknown))
            given = ", ".join(f"{name} = {columns[name][at]:.6g}" for name in self.cells.names)
            known = "; ".join(
                ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.cells.names, values, strict=True))
                for values in self.cells.categories.T
            )
            raise ValueError(
                f"Argument state must be one that a {self.after} ended in, {known}, but {given} was given."
            )
        for name in self.given if is_single else ():
            own = self.state[name][self._members[int(self.cells.category_of(columns)[0])]]
            low, high, slack = own.min(), own.max(), _BEYOND * np.ptp(self.state[name])
            if not low - slack <= columns[name][0] <= high + slack:
                where = (
                    f"be between {low:.6g} and {high:.6g} {self.unit_of(name)}, as at the ends that the kernel knows"
                )
                raise checks.refused(f"state[{name!r}]", where, state[name])
        return columns

    def _table(self, place: np.ndarray, places: int) -> Int[np.ndarray, "parts cells cells places"]:
        """Counts of transitions by part of the samples, cell, next cell and `place`, from 0 to `places` - 1."""
        cells = self.cells.number
        known = (self.cell >= 0) & (self.next_cell >= 0)
        index = (self.owner % _PARTS * cells + self.cell) * cells + self.next_cell
        counts = np.bincount((index * places + place)[known], minlength=_PARTS * cells * cells * places)
        return counts.reshape(_PARTS, cells, cells, places)

    def _error_of(self, function: Callable[[np.ndarray], Any]) -> np.ndarray:
        """The standard error of a function of the `probabilities`."""
        table = self._table(np.zeros(self.number, int), 1)[..., 0]
        return _jackknifed(np.array([function(_rows(table.sum(axis=0) - one)) for one in table]))

    def __repr__(self) -> str:
        given = ", ".join(map(words, self.given))
        lines = [f"Transition kernel after a {self.after}, from {self.number:,} transitions: given {given}"]
        lines.append(f"  {self.cells.number} cells; {self.second_eigenvalue}")
        if self.incomplete:
            lines.append(f"  {self.incomplete:,} ends left out: the end of the simulation cut what follows")
        return "\n".join(lines)


def _beyond_state(state: list[np.ndarray], block: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function of values: the rank of each among all, less the linear function of the `state` that fits the ranks of
    its block best, in steps of a class. Within a block states still differ a little; where nothing happens by chance
    all numbers follow that, which is no dependence.
    """
    size = np.bincount(block)

    def centred(values: np.ndarray) -> np.ndarray:
        return values - (np.bincount(block, values) / size)[block]

    by = [centred(column / column.std()) for column in state if np.ptp(column)]
    products = np.array([np.bincount(block, a * b) for a in by for b in by]).reshape(len(by), len(by), len(size))
    inverse = np.linalg.pinv(products.transpose(2, 0, 1), rcond=1e-9, hermitian=True)

    def rest(values: np.ndarray) -> np.ndarray:
        rank = centred(stats.rankdata(values) / len(values))
        found = np.array([np.bincount(block, own * rank) for own in by]).reshape(len(by), len(size))
        slopes = np.einsum("bij,jb->ib", inverse, found)
        return np.round(_CLASSES * (rank - sum(slope[block] * own for slope, own in zip(slopes, by, strict=True))))

    return rest


def words(name: str) -> str:
    """A name as words."""
    return name.replace("_", " ")


def _rows(counts: np.ndarray) -> np.ndarray:
    """Each row over its sum; zeros for a cell that was never left."""
    return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)


def _lasting(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which cells are left again and again, and the transitions between these."""
    kept = np.arange(len(p))
    while not np.all(leaves := p[np.ix_(kept, kept)].sum(axis=1) > 0):
        kept = kept[leaves]
    inside = p[np.ix_(kept, kept)]
    return kept, inside / inside.sum(axis=1, keepdims=True)


def _stationary(p: np.ndarray) -> np.ndarray:
    """The distribution that the transitions `p` leave as it is: the solution of ``x (p - 1) = 0`` with the sum 1."""
    kept, inside = _lasting(p)
    system = np.concatenate([inside.T - np.eye(len(kept)), np.ones((1, len(kept)))])
    found = np.zeros(len(p))
    found[kept], *_ = np.linalg.lstsq(system, np.append(np.zeros(len(kept)), 1.0), rcond=None)
    return found


def _second(p: np.ndarray) -> float:
    values = np.sort(np.abs(np.linalg.eigvals(_lasting(p)[1])))
    return float(values[-2]) if len(values) > 1 else 0.0


# Kernels from simulated sticks.


def transition_kernel(
    source: "EnsembleLike | System",
    law: Any = None,
    *,
    after: After = "stick",
    given: tuple[str, ...] | None = None,
    period: float | None = None,
    bins: int = 32,
    ends_before: float | None = None,
    transitions: int | None = None,
) -> TransitionKernel:
    """The distribution of the next stick given how the last one ended: the sequence of sticks as a Markov chain.

    Of an ensemble, from its sticks. Of a `MassSpring` without damping on a `PoissonSwitching` or `RandomSteps` base, by
    quadrature: closed forms of the motion, at the points of a Sobol' sequence in place of random numbers.

    Args:
        source: An `Ensemble` with ``keep="sticks"`` (or "statistics": its retained samples), or a system.
        law: That of the base, with a system.
        after: "stick": from the end of each stick to that of the next. "slip": from the end of each slip, where a stick
            begins, to that of the next slip.
        given: The names of what is known then. After a stick some of "end_position" (m), "base_velocity" (its mean in
            the stick, m/s), "ending" (an `Ending` code) and "phase" of the base (s); after a slip "position",
            "base_velocity" (in the stick that begins) and "phase". By default all, "phase" only where the law has a
            period (with `RandomPhase` that of each sample's own motion). Any number of the stick, such as "duration",
            can be added.
        period: Of the base, s. By default that of its law: of `RandomSteps` the time between draws.
        bins: Into how many cells the states of each base velocity and ending are divided, for all that is computed with
            matrices.
        ends_before: Only ends before this instant (s) are used. By default the middle of the simulation, so that nearly
            all that follows is complete.
        transitions: How many points the quadrature has of each way in which a stick can end, at least; by default 2^18.

    Returns:
        A `TransitionKernel`.

    Raises:
        ValueError: For an ensemble without sticks or whose positions are not known, other names, numbers out of range,
            and a system or law without such closed forms.

    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> kernel = ss.transition_kernel(ss.papers.belt_oscillator(), law, transitions=2**14)
    >>> kernel.steps_to_forget(0.01)
    6
    """
    after = cast(After, checks.chosen("after", after, get_args(After)))
    bins = checks.whole_number("bins", bins, minimum=1, maximum=1000)
    if period is not None:
        checks.positive("period", period, "s")
    if isinstance(source, System):
        for name, own in (("period", period), ("ends_before", ends_before)):
            if own is not None:
                raise checks.refused(name, "be left out with a system and a law, which know it", own)
        wanted = _POINTS if transitions is None else transitions
        points = checks.whole_number("transitions", wanted, minimum=_PARTS, maximum=2**26)
        state, following, later = by_quadrature(source, law, after, points)
        owner = np.arange(len(following["duration"]))
        samples, incomplete, origin, coordinate = len(owner), 0, object(), source.stick_position
    else:
        ensemble = require_ensemble(source)
        if law is not None:
            raise checks.refused("law", "be left out with an ensemble, which has one", law)
        if transitions is not None:
            raise checks.refused("transitions", "be left out with an ensemble: its sticks are taken", transitions)
        before = ensemble.t1 / 2 if ends_before is None else ends_before
        checks.bounded("ends_before", before, "s", above=0)
        own_period = period_of(ensemble.law)
        period = own_period if period is None else period
        shift = None  # of the clock of each sample, s
        if isinstance(ensemble.law, RandomPhase) and own_period is not None:
            shift = ensemble._phases() * own_period / (2 * math.pi)
        sticks, levels = ensemble.numbered_sticks(), levels_of(ensemble.law)
        coordinate = ensemble.system.stick_position
        turn = coordinate.period
        state, following, later, owner, incomplete = _from_sticks(sticks, after, period, shift, levels, before, turn)
        samples, origin = len(sticks.count), origin_of(ensemble)
    known = tuple(name for name in _STATE[after] if name in state)
    names = known if given is None else tuple(checks.chosen("given", name, state) for name in given)
    if not names or len(set(names)) < len(names):
        raise checks.refused("given", "hold one or more different names", given)
    state, later = ({name: of[name] for name in names} for of in (state, later))
    found = (after, names, state, following, later, owner, samples, incomplete, Cells.of(state, bins))
    return TransitionKernel(*found, coordinate.unit, origin)


def _phase(time: np.ndarray, period: float) -> np.ndarray:
    """The phase in ``[0, period)``; 0 within round-off, from either side."""
    phase = time % period
    return np.where(np.minimum(phase, period - phase) <= _ALIKE * period, 0.0, phase)


def _from_sticks(
    sticks: FlatSticks, after: After, period: float | None, shift: np.ndarray | None, levels: np.ndarray | None,
    before: float, turn: float | None,
) -> tuple[Columns, Columns, Columns, np.ndarray, int]:  # fmt: skip
    """The states, what follows, the next states and the owner of each transition, and how many were left out.

    `turn`: after which positions are the same again, where they are angles.
    """
    owner, start, end = sticks.sample, np.asarray(sticks.start, float), np.asarray(sticks.end, float)
    has_next = np.append(np.diff(owner) == 0, False)
    position, moved = np.asarray(sticks.position, float), np.asarray(sticks.slip_displacement, float)
    left = np.where(has_next, np.append((position - moved)[1:], np.nan), np.nan)
    duration = end - start
    way = left - position
    if turn is not None:  # positions are within one turn, displacements are not
        left, way = left % turn, way - turn * np.round(way / turn)
    # What stays where it is, but for round-off, is on a base at rest.
    way = np.where(np.abs(way) <= _ALIKE * np.max(np.abs(position), initial=0.0), 0.0, way)
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity = way / duration
    if levels is not None:
        velocity = levels[np.argmin(np.abs(np.nan_to_num(velocity)[:, None] - levels), axis=1)]
    of = {
        "position": position, "base_velocity": velocity, "duration": duration, "end_position": left,
        "ending": sticks.ending.astype(float), "slip_duration": np.append(start[1:], np.nan) - end,
        "slip_before": start - np.where(np.append(False, has_next[:-1]), np.append(0.0, end[:-1]), 0.0),
    }  # fmt: skip
    begin = end if after == "stick" else start
    if period is not None:
        of["phase"] = _phase(begin if shift is None else begin + shift[owner], period)
    used = (sticks.ending != Ending.HORIZON) & (begin < before)
    complete = np.flatnonzero(used & has_next & np.append(has_next[1:], False))
    if not np.all(np.isfinite(left[complete])):
        raise ValueError(
            "Argument source must know the position and slip displacement of its sticks, but some are NaN."
        )
    if len(complete) < _PARTS:
        raise ValueError(
            f"Argument source must have at least {_PARTS} sticks that end before ends_before = {before:.6g} s and two "
            f"sticks after each, but {len(complete)} were found; simulate more samples, or longer."
        )
    state, later = ({name: column[which] for name, column in of.items()} for which in (complete, complete + 1))
    mixed = dict.fromkeys(FOLLOWING[after], later if after == "stick" else state) | {"position": later}
    following = {name: mixed[name][name] for name in FOLLOWING[after]}
    return state, following, later, owner[complete], int(used.sum()) - len(complete)
