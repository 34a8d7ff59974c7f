"""Periodic orbits followed along a parameter, by pseudo-arclength (Keller 1977), and what happens on the way."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import newton

from .._dynamics.common.method import working_dtype
from .._dynamics.simulation import provenance, source
from .._ensemble.points import SweepSetting, label_and_unit, setter_of
from .._foundation import checks
from .._foundation.extras import Dataset, Entries, labeled_dataset, require_labels, variable
from .._uncertainty.numbers import number_at
from ._cases import apart
from ._orbits import TOLERANCE, Equations, Evaluated, Mode, PeriodicOrbit, Plane, count, sequence

# The points of a branch of periodic orbits, and what changes between two of them.


_SIGNS = {1: "+", -1: "-", 0: "0"}


class BranchEvent(NamedTuple):
    """What happens on a branch: its `kind`, the value of the `parameter` there, the point after which, and in words.

    Kinds: "fold", "flip", "Neimark-Sacker", "branch point", "stick appears", "stick vanishes", "slip appears", "slip
    vanishes", "grazing"; of ends also "Hopf", and "end" where none of these was found.
    """

    kind: str
    parameter: float
    point: int
    text: str


class OrbitPoint(NamedTuple):
    """A point of the branch: the `unknowns`, the equations `found` there, the `tangent` (scaled), and the number of
    iterations that it took.
    """

    unknowns: np.ndarray
    found: Evaluated
    tangent: np.ndarray
    iterations: int

    def turned(self) -> "OrbitPoint":
        """The same, its tangent the other way."""
        return self._replace(tangent=-self.tangent)


class Change(NamedTuple):
    """What changed between two points, and whether a point in between `is_before` it."""

    kind: str
    text: str
    is_before: Callable[[OrbitPoint], bool]


def changes(last: OrbitPoint, found: OrbitPoint) -> Iterator[Change]:
    """What changed between two neighbouring points with the same sequence of modes."""
    turned = last.tangent[-1] * found.tangent[-1] < 0
    if turned:
        yield Change("fold", "the branch turns round", lambda point: point.tangent[-1] * last.tangent[-1] > 0)
    for kind, text, test in _TESTS:
        if kind == "branch point" and turned:
            continue

        def sign(point: OrbitPoint, test: Callable[[np.ndarray], float] = test) -> float:
            return test(point.found.own_multipliers)

        if sign(last) * sign(found) < 0:
            yield Change(kind, text, lambda point, sign=sign: sign(point) * sign(last) > 0)


def _flip(multipliers: np.ndarray) -> float:
    """Changes its sign where a multiplier passes -1."""
    return float(np.prod(multipliers + 1).real)


def _rotation(multipliers: np.ndarray) -> float:
    """Changes its sign where a complex pair passes the unit circle; NaN where there is none."""
    pairs = multipliers[np.imag(multipliers) > 1e-9]
    return float(np.prod(np.abs(pairs) - 1)) if len(pairs) else float("nan")


_TESTS = (
    ("flip", "a multiplier passes -1: an orbit of twice the period branches off", _flip),
    ("Neimark-Sacker", "a pair of multipliers passes the unit circle: motion on a torus branches off", _rotation),
    ("branch point", "a multiplier passes 1: another branch crosses", lambda found: float(np.prod(found - 1).real)),
)


def text_of(order: Iterable[tuple[int, ...]]) -> str:
    """Modes in turn, by the signs of the relative velocities of all contacts: "-0" is a slip with negative relative
    velocity of the first, and a stick of the second.
    """
    return " ".join("".join(_SIGNS[sign] for sign in signs) for signs in order)


def change_of_modes(last: OrbitPoint, found: OrbitPoint) -> Change | None:
    """The change of the sequence of modes between two neighbouring points; None where it is the same."""
    order, new = sequence(last.found.modes), sequence(found.found.modes)
    if order == new:
        return None
    text = f"the sequence of modes {text_of(order)} becomes {text_of(new)}"
    kind = kind_of(last.found.modes, found.found.modes)
    return Change(kind, text, lambda point: sequence(point.found.modes) == order)


def kind_of(before: tuple[Mode, ...], after: tuple[Mode, ...]) -> str:
    """What a change of the sequence of modes is called, by the numbers of sticks and slips. Where one less of both is
    left, a slip vanished in a stick or a stick in a slip: which of them is shorter.
    """
    if not any(any(mode.signs) for mode in after):
        return "slip vanishes"
    sticks, *slips = (count(after, sign) - count(before, sign) for sign in (0, 1, -1))
    if not sticks:
        return "grazing"
    shortest = min(before if sticks < 0 else after, key=lambda mode: mode.end - mode.start)
    thing = "slip" if sticks * sum(slips) > 0 and all(shortest.signs) else "stick"
    return f"{thing} {'appears' if sticks > 0 else 'vanishes'}"


def end_of(before: tuple[Mode, ...], beyond: tuple[Mode, ...]) -> tuple[str, str]:
    """What the end of a branch is called, and in words, by the modes of its last orbit, and of the motion that was
    followed from just `beyond` it: what comes first that is not as before counts, as the rest may follow from that.
    """
    shown = (text_of(mode.signs for mode in modes) for modes in (before, beyond))
    kind = kind_of(before, beyond)
    for number, mode in enumerate(before):
        there = beyond[min(number, len(beyond) - 1)].signs
        if there == mode.signs:
            continue
        contact = int(np.argmax(np.not_equal(mode.signs, there)))  # the first that differs
        until = before[number - 1].signs[contact] if number else 0
        if mode.signs[contact] and not there[contact]:
            kind = "slip vanishes" if until == 0 else "stick appears"
        elif there[contact] and not mode.signs[contact]:
            kind = "slip appears" if until == 0 and number else "stick vanishes"
        break
    return kind, "a motion with the modes {} becomes one with {}".format(*shown)


# Where branches of periodic orbits end: they would go back over the same orbits half a period later, or the release of
# a stick becomes tangent.


_LARGE = (30.0, 3e5)  # multipliers by which it is extrapolated where they become infinite: neither end is exact
_FITTED = 4  # points
_ROOT_ITERATIONS = 20
_EXACT = 1e-13


def turning_back(
    equations: Equations, scale: np.ndarray, last: OrbitPoint, found: OrbitPoint
) -> tuple[str, float, str] | None:
    """The kind of the end between two neighbouring points, the parameter there, and in words; None where there is none.

    A cycle shrinks into an equilibrium at a Hopf point, and an orbit of twice the period into the one that doubles.
    Beyond, the equations have the same orbits again, which begin half a period later: what the orbit moves in half of
    its period changes its sign, and of a cycle around an equilibrium the rates do too. The equations of the orbit are
    singular there; those of the equilibrium, or of the orbit of half the period, are not, and its multipliers tell
    where it is.
    """
    if last.tangent[-1] * found.tangent[-1] >= 0:
        return None
    size = equations.coordinates
    one, two = (equations.half_way(point.unknowns) for point in (last, found))
    if one is None or two is None:
        return None
    axis = (one - two) / scale[:size] ** 2
    before, after = float(np.dot(one, axis)), float(np.dot(two, axis))
    if not before > 0 > after:
        return None
    share = before / (before - after)
    between = last.unknowns + share * (found.unknowns - last.unknowns)
    rates = [point.found.matrix[:size, size] / scale[:size] for point in (last, found)]
    if not equations.driven and np.dot(*rates) < 0:
        # An equilibrium comes back after any time; after a quarter of the period the critical multipliers are +-i.
        between[size] /= 4

        def growth(at: Evaluated) -> float:
            critical = np.argmin(np.abs(at.multipliers - 1j))
            return math.log(abs(at.multipliers[critical]))

        value = _root(equations, between, last.unknowns[-1], size, None, growth)
        return "Hopf", value, "the cycle shrinks into an equilibrium"
    value = halved(equations, between, last.unknowns[-1])
    return "flip", value, "the orbit becomes one of half its period, which doubles there"


def halved(equations: Equations, between: np.ndarray, other: float) -> float:
    """The parameter near that of the unknowns `between` where the orbit of half the period has the multiplier -1."""
    guess, periods = equations.halved(between)

    def doubles(at: Evaluated) -> float:
        return _flip(at.own_multipliers)

    return _root(equations, guess, other, equations.size, periods, doubles)


def _root(
    equations: Equations, guess: np.ndarray, other: float, number: int, periods: int | None,
    test: Callable[[Evaluated], float],
) -> float:  # fmt: skip
    """The parameter near that of the `guess` where a `test` of what comes back is zero; its first `number` unknowns
    follow from it. That of the guess, where it is not found.
    """
    unknowns = guess.copy()

    def at(parameter: float) -> float:
        unknowns[-1] = parameter
        found = None
        for _ in range(_ROOT_ITERATIONS):
            found = equations.at(unknowns, periods)
            if found is None:
                break
            # Of contacts that stick all the time the matrix is singular: they stay where they are.
            change = np.linalg.lstsq(found.matrix[:number, :number], -found.value[:number], rcond=1e-10)[0]
            unknowns[:number] += change
            if np.max(np.abs(change)) <= _EXACT * np.max(np.abs(unknowns[:number])):
                break
        return math.nan if found is None else test(found)

    result: Any
    value, result = newton(at, guess[-1], x1=other, tol=1e-12, full_output=True, disp=False)  # pyright: ignore[reportAssignmentType]
    near = abs(value - guess[-1]) <= abs(other - guess[-1]) + 1e-3 * abs(guess[-1])
    return float(value) if result.converged and near else float(guess[-1])


def tangent_release(points: list[OrbitPoint]) -> float | None:
    """The parameter where the largest multiplier of the last `points` with the same order of modes becomes infinite;
    None where it does not grow so far.

    Static friction larger than the kinetic one holds a stick for ever from where the force no longer reaches it. Before
    that the release is nearly tangent, and its time, and with it the largest multiplier, goes as one over the distance
    of the parameter; where the orbit has two such releases by symmetry, as one over its square.
    """
    same = [point for point in points if point.found.order == points[-1].found.order]
    sizes = np.array([np.max(np.abs(point.found.multipliers)) for point in same])
    values = np.array([point.unknowns[-1] for point in same])
    if sizes[-1] < _LARGE[1]:
        return None
    known = np.flatnonzero((sizes > _LARGE[0]) & (sizes < _LARGE[1]))[-_FITTED:]
    if len(known) < _FITTED or np.any(np.diff(sizes[known]) <= 0):
        return None
    found = []
    for power in (1, 2):
        small = sizes[known] ** (-1 / power)
        ends = [float(BarycentricInterpolator(small[skip:], values[known[skip:]])(0.0)) for skip in (0, 1)]
        found.append((abs(ends[0] - ends[1]), ends[0]))
    return min(found)[1]


# A branch as it is followed, and its result.


_ITERATIONS = 40  # near grazing, where the map has the slope of a square root, Newton's method converges slowly
_ROUND_OFF = 4.0  # units in the last place of the unknowns, to which they are found
_FEW = 4  # iterations after which the next step may be longer
_SHORTEST = 1e-9  # step, relative to the first
_LONGEST = 4.0  # likewise
_AT_REST = 0.9999  # of the period in sticks
_HALF = 1e-7  # scaled: what an orbit moves in half of its period, that is one of half the period
_LOCATED = 1e-10  # of the way between two points
_MIDDLES = (0.5, 0.4, 0.6, 0.25, 0.75)  # of what is left of it
_MOST_CHANGES = 20  # of the sequence of modes between two points
_FARTHEST = 1.0  # change in one iteration, scaled
_LEAST_COSINE = 0.5  # between the tangents of neighbours
_CORNER = 1e-3  # step, relative to the first, over which the tangent may turn more: at a corner
_TOLD = 1e-6  # of the way to `until`: the width of a bracket from which on an event says it
_BEYOND = 4.0 ** np.arange(16)  # steps, by which a motion beyond the end of a branch is looked for
_CROSSES = 0.9  # cosine of the angle between the motion and the normal of the plane where an orbit begins
_LOOKS = (2.0, 10.0, 50.0, 250.0, 1250.0)  # steps, by which the way from a corner is found


class OrbitBranch(NamedTuple):
    """A branch of periodic orbits.

    - `points`: a data set with the dimension "point": the parameter, the numbers of the state where the orbit begins
      (of one that nothing drives, in the middle of its longest slip), ``period`` (s), ``multiplier_real`` and
      ``multiplier_imag`` with the further dimension "multiplier", ``is_stable``, ``stick_count`` and ``stick_fraction``
      of one period (mean over the contacts), and ``modes``, the signs of the relative velocities in turn. One that is
      called as the parameter is has an underscore after its name.
    - `events`: what happens on the way, in order (`BranchEvent`); where a multiplier is 1 they are known less exactly.
    - `ending`: why the branch ends, in words.
    """

    points: Dataset
    events: tuple[BranchEvent, ...]
    ending: str


def continue_orbit(
    orbit: PeriodicOrbit,
    parameter: str,
    *,
    until: float,
    step: float = 0.02,
    most: int = 500,
) -> OrbitBranch:
    """Follow a periodic orbit along a parameter, round folds, and say what happens on the way.

    Args:
        orbit: A `periodic_orbit` that has converged.
        parameter: Its name, as `sensitivity` uses it.
        until: The branch ends where the parameter reaches this value, or its value at the begin again after a fold.
        step: The first step, as a share of the way to `until`; later ones are chosen by how Newton's method converges.
        most: The largest number of points.

    Returns:
        The branch. Where the sequence of sticks and slips changes, the event is located and the branch goes on with the
        new one; where no orbit is found beyond, it ends, and the event says with what.

    Raises:
        ValueError: For arguments that do not fit, and for an orbit that has not converged.
        ImportError: Without the extra ``study``.
    """
    checks.require_threads_of_jax()
    require_labels()
    if not isinstance(orbit, PeriodicOrbit) or not bool(np.all(np.asarray(orbit.converged))):
        shown = "one that has not" if isinstance(orbit, PeriodicOrbit) else checks.show(orbit)
        raise ValueError(f"Argument orbit must be a periodic_orbit that has converged, but {shown} was given.")
    checks.bounded("step", step, above=0, below=1)
    checks.bounded("until", until)
    state = np.asarray(orbit.state, float)
    setting = SweepSetting(orbit.system, orbit.base, tuple(state.tolist()), orbit.method)
    setter = setter_of(setting, (parameter,))
    path = setter.paths.get(parameter)
    if path is None or path[0] == "y0":
        raise ValueError(
            f"Argument parameter must name a number of the system or of what drives it, but {checks.show(parameter)} "
            "was given."
        )
    value = float(number_at(setting, path))
    if float(until) == value:
        raise ValueError(f"Argument until must differ from the {parameter} of the orbit, but both are {value:g}.")
    setter((float(until),))
    dtype = np.dtype(working_dtype(stacklevel=4))
    one, coordinates = orbit.simulation, orbit.system.coordinates
    sizes = np.array([float(one.maximum(each.name) - one.minimum(each.name)) for each in coordinates])
    free = [] if orbit.is_driven else [float(orbit.period)]
    scale = np.array([*np.maximum(sizes, max(1e-3 * np.max(sizes), 1e-12)), *free, abs(until - value)])
    equations = Equations(orbit, setter, parameter, dtype)
    most = checks.whole_number("most", most)
    branch = _Branch(equations, scale, parameter, np.array([*state, *free, value]), float(until), step)
    branch.follow(most)

    points, orbits = branch.points, [point.found for point in branch.points]
    values = np.array([point.unknowns for point in points]).reshape(len(points), -1)
    multipliers = np.array([one.multipliers for one in orbits]).reshape(len(points), len(coordinates))
    many = ("point", "multiplier")
    in_turn = [text_of(sequence(one.modes)) for one in orbits]
    variables: Entries = {
        "period": variable("point", [one.duration for one in orbits], "period of the orbit", "s"),
        "multiplier_real": variable(many, np.real(multipliers), "Floquet multiplier, real part"),
        "multiplier_imag": variable(many, np.imag(multipliers), "Floquet multiplier, imaginary part"),
        "is_stable": variable("point", [one.is_stable for one in orbits], "whether the orbit is stable"),
        "stick_count": variable("point", [count(one.modes, 0) for one in orbits], "number of sticks in one period"),
        "stick_fraction": variable(
            "point", [one.stick_fraction for one in orbits], "share of the period in sticks, mean over contacts"
        ),
        "modes": variable("point", in_turn, "signs of the relative velocities, mode after mode"),
    }
    for number, coordinate in enumerate(coordinates):
        label = f"{coordinate.name} where the orbit begins"
        variables[coordinate.variable] = variable("point", values[:, number], label, coordinate.unit)
    label, unit = label_and_unit(setting, parameter)
    found = labeled_dataset(
        apart(variables, [parameter]), {parameter: variable("point", values[:, -1], label, unit)},
        {**source(), **provenance(setting.system, setting.law, setting.method)},
    )  # fmt: skip
    return OrbitBranch(found, tuple(branch.events), branch.ending)


@dataclasses.dataclass
class _Branch:
    """A branch as it grows, from where it is `begun` to the parameter `until`: its `points` and `events`, and at last
    its `ending`. `scale`: of the unknowns. `step`: the first.
    """

    equations: Equations
    scale: np.ndarray
    parameter: str
    begun: np.ndarray
    until: float
    step: float
    points: list[OrbitPoint] = dataclasses.field(default_factory=list)
    events: list[BranchEvent] = dataclasses.field(default_factory=list)
    ending: str = ""

    @property
    def _range(self) -> tuple[float, float]:
        """The smallest and the largest value of the parameter."""
        return min(self.begun[-1], self.until), max(self.begun[-1], self.until)

    def follow(self, most: int) -> None:
        """Grow until the parameter leaves its range, the branch ends, or there are `most` points."""
        toward = np.eye(len(self.begun))[-1] * np.sign(self.until - self.begun[-1])
        first = self._moved(self.begun)
        last = None if first is None else self._corrected(first, toward, toward)
        if last is None:
            raise ValueError(
                "Argument orbit must be one whose motion comes back, but Newton's method did not converge there again; "
                "find it with a smaller tolerance."
            )
        self.points.append(last)
        length = self.step
        while len(self.points) < most:
            last = self.points[-1]
            noted = None
            for guess in self._guesses(last, length):
                found = self._corrected(guess, last.tangent, last.tangent)
                if found is None:
                    continue
                # The next point of the same branch, and not one of another that is near.
                moved = np.linalg.norm(found.unknowns / self.scale - last.unknowns / self.scale)
                goes_on = abs(np.dot(found.tangent, last.tangent)) > _LEAST_COSINE or length < _CORNER * self.step
                if moved > 4 * length or not goes_on:
                    continue
                if self._turns_back(last, found):
                    return
                inside = self._range[0] <= found.unknowns[-1] <= self._range[1]
                noted = self._noted(last, found) if inside else None
                if noted is not None or self.ending or (not inside and self._land(last, found)):
                    break
            if self.ending:
                return
            if noted is not None:
                self.points.append(self._rebased(noted))
                length = min(length * (2 if noted.iterations <= _FEW else 1), _LONGEST * self.step)
                continue
            length /= 2
            if length < _SHORTEST * self.step:
                self._end_here(last, length)
                return
        self.ending = f"{most} points were found; ask for more with the argument most"

    def _guesses(self, last: OrbitPoint, length: float) -> Iterator[np.ndarray]:
        """Guesses (scaled) of the point that follows at a `length`: along the tangent, and along a parabola.

        Where a stick is about to last for ever, its release is nearly tangent, and the way to the end in the state as
        the square of that in the parameter: along the tangent one leaves the motions that are released at half the way.
        """
        yield last.unknowns / self.scale + length * last.tangent
        before = self.points[-3:]
        if self.equations.driven and len(before) == 3 and len({point.found.order for point in before}) == 1:
            places = np.array([point.unknowns for point in before]) / self.scale
            at = np.append(0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
            yield BarycentricInterpolator(at, places)(at[-1] + length)

    def _end(self, kind: str, value: float, why: str) -> None:
        self.ending = why
        self.events.append(BranchEvent(kind, float(value), len(self.points) - 1, why))

    def _end_here(self, last: OrbitPoint, length: float) -> None:
        """End where no orbit continues `last`: what vanishes is told by the motion that is followed from just beyond,
        which also is the other end of the bracket in which the branch ends.
        """
        for factor in _BEYOND:
            ahead = last.unknowns + factor * length * last.tangent * self.scale
            beyond = self.equations.at(ahead)
            if beyond is None or sequence(beyond.modes) == sequence(last.found.modes):
                continue
            kind, text = end_of(last.found.modes, beyond.modes)
            end = tangent_release(self.points)
            value = (last.unknowns[-1] + ahead[-1]) / 2 if end is None else end
            ahead = 2 * value - last.unknowns
            self._end(kind, value, f"{text}; no orbit continues the branch{self._width(last.unknowns, ahead)}")
            return
        shortest = min(last.found.modes, key=lambda mode: mode.end - mode.start)
        kind, duration = "slip" if all(shortest.signs) else "stick", shortest.end - shortest.start
        why = f"no orbit was found beyond: the shortest {kind} lasts {duration:.3g} s"
        self._end("end", last.unknowns[-1], why)

    def _width(self, one: np.ndarray, other: np.ndarray) -> str:
        """The bracket of an event between two points in words, where it is wider than events are located."""
        low, high = sorted((one[-1], other[-1]))
        return f" (between {low:.9g} and {high:.9g})" if high - low > _TOLD * self.scale[-1] else ""

    def _turns_back(self, last: OrbitPoint, found: OrbitPoint) -> bool:
        """Whether the branch ends between two points because it would go back over the same orbits. Ends it there."""
        end = turning_back(self.equations, self.scale, last, found)
        if end is None and self._is_half(found) and not self._is_half(last):
            corner, more = self._located(last, found, lambda point: not self._is_half(point))
            value = halved(self.equations, corner.unknowns, corner.unknowns[-1] + _TOLD * self.scale[-1])
            end = "flip", value, f"the orbit becomes one of half its period, which doubles there{more}"
        if end is not None:
            kind, value, text = end
            self._end(kind, value, f"{text}, and the branch ends")
        return end is not None

    def _is_half(self, point: OrbitPoint) -> bool:
        """Whether a point is an orbit of half the period: it solves the same equations, so a step may lead to it."""
        if not self.equations.driven or self.equations.periods % 2:
            return False
        moved = self.equations.half_way(point.unknowns)
        return moved is not None and bool(np.max(np.abs(moved / self.scale[: len(moved)])) < _HALF)

    def _land(self, last: OrbitPoint, found: OrbitPoint) -> bool:
        """The last point, where the parameter is at the end of its range that it passed; whether it was found."""
        end = np.clip(found.unknowns[-1], *self._range)
        share = (end - last.unknowns[-1]) / (found.unknowns[-1] - last.unknowns[-1])
        guess = (last.unknowns + share * (found.unknowns - last.unknowns)) / self.scale
        guess[-1] = end / self.scale[-1]
        landed = self._corrected(guess, np.eye(len(guess))[-1], last.tangent)
        noted = None if landed is None else self._noted(last, landed)
        if noted is None:
            return False
        self.points.append(noted)
        self.ending = f"{self.parameter} reached {end:g}"
        return True

    def _corrected(self, guess: np.ndarray, along: np.ndarray, before: np.ndarray) -> OrbitPoint | None:
        """The point of the branch in the plane through `guess` (scaled) across `along`; None where Newton's method
        finds none. Its tangent points as the one `before`.
        """
        size = self.equations.coordinates
        scales = np.append(self.scale[:size], [1.0] * (self.equations.size - size))  # of the equations
        scaled, best, smallest = guess.copy(), None, TOLERANCE[self.equations.itemsize]
        for iteration in range(_ITERATIONS):
            found = self.equations.at(scaled * self.scale)
            if found is None:
                return best
            rows = found.matrix * self.scale / scales[:, None]
            sides = np.append(found.value / scales, np.dot(along, scaled - guess))
            error = np.max(np.abs(sides))
            # Round-off of the unknowns: near the end of a branch its multiplier may be a million.
            noise = _ROUND_OFF * np.finfo(f"f{self.equations.itemsize}").eps * np.max(np.abs(rows) @ np.abs(scaled))
            if error <= (smallest if best else max(smallest, noise)):
                tangent = np.linalg.svd(rows)[2][-1]
                tangent *= 1 if np.dot(tangent, before) >= 0 else -1
                best = OrbitPoint(scaled * self.scale, found, tangent, best.iterations if best else iteration)
                # On until round-off: where a multiplier is nearly 1, the orbit is far less exact than its residual.
                smallest = error / 2
            elif best is not None:
                return best
            try:
                change = np.linalg.solve(np.vstack([rows, along]), -sides)
            except np.linalg.LinAlgError:
                return best
            scaled = scaled + change
            if np.max(np.abs(change)) > _FARTHEST:
                return best
        return best

    def _moved(self, unknowns: np.ndarray) -> np.ndarray | None:
        """The unknowns (scaled) of the same orbit, where nothing drives it from the middle of its longest slip on."""
        if self.equations.driven:
            return unknowns / self.scale
        size = self.equations.coordinates
        self.equations.plane = Plane(unknowns[:size], np.ones(size))
        found = self.equations.at(unknowns)
        if found is None:
            return None
        slips = [mode for mode in found.modes if any(mode.signs)]
        longest = max(slips or found.modes, key=lambda mode: mode.end - mode.start)
        moved = unknowns.copy()
        moved[size] = (longest.start + longest.end) / 2
        there = self.equations.at(moved)
        assert there is not None
        state, across = unknowns[:size] + there.value[:size], there.matrix[:size, size] / self.scale[:size]
        self.equations.plane = Plane(state, across / np.max(np.abs(across)) / self.scale[:size])
        return np.append(state, unknowns[size:]) / self.scale

    def _rebased(self, point: OrbitPoint) -> OrbitPoint:
        """The same point from the middle of its longest slip on, where its begin has come near an event, or the motion
        there along the plane.
        """
        if self.equations.driven:
            return point
        size = self.equations.coordinates
        rates = point.found.matrix[:size, size] / self.scale[:size]
        normal = point.found.matrix[size, :size] * self.scale[:size]
        cosine = np.dot(rates, normal) / (np.linalg.norm(rates) * np.linalg.norm(normal))
        if cosine >= _CROSSES and point.found.is_far_from_events:
            return point
        plane = self.equations.plane
        guess = self._moved(point.unknowns)
        if guess is not None:
            parameter = np.eye(len(guess))[-1]
            found = self._corrected(guess, parameter, parameter * np.sign(point.tangent[-1] or 1.0))
            if found is not None:
                return found
        self.equations.plane = plane
        return point

    def _noted(self, last: OrbitPoint, found: OrbitPoint) -> OrbitPoint | None:
        """Note what happened between two points, each event located, the first one first. Returns `found`, its tangent
        away from `last`: where the sequence of modes changes, the branch may turn round in a corner. None, with nothing
        noted, where a change is not located, since orbits do not lead over to `found`, or where all sticks: a mass may
        rest anywhere, and no orbit is alone. None too where all comes to rest at an event, which ends the branch.
        """
        begun, number = last, len(self.events)
        if found.found.is_at_rest and not begun.found.is_at_rest:
            return None
        for _ in range(_MOST_CHANGES):
            change = change_of_modes(last, found)
            if change is None:
                break
            corner, text = self._located(last, found, change.is_before)
            if text:
                del self.events[number:]
                return None
            self._add(change_of_modes(last, corner) or change, corner, text)
            last = corner
        kinds = [event.kind for event in self.events[number:]]
        if found.found.stick_fraction > _AT_REST and "slip vanishes" in kinds:
            # A mass may rest at the very limit of friction, and Newton's method finds that: its slips are round-off.
            del self.events[number + kinds.index("slip vanishes") + 1 :]
            self.ending = self.events[-1].text
            return None
        if len(self.events) > number or begun.found.order != found.found.order:
            found = self._away(found, float(np.linalg.norm(self._way(begun, found))))
            if len(self.events) > number and begun.tangent[-1] * found.tangent[-1] < 0:
                event = self.events[-1]
                self.events[-1] = event._replace(text=f"{event.text}; the branch turns round there")
            last = last if np.dot(last.tangent, found.tangent) > 0 else last.turned()
        for one in changes(last, found):
            self._add(one, *self._located(last, found, one.is_before))
        return found

    def _way(self, last: OrbitPoint, found: OrbitPoint) -> np.ndarray:
        """From one point to the next, scaled."""
        return (found.unknowns - last.unknowns) / self.scale

    def _away(self, found: OrbitPoint, length: float) -> OrbitPoint:
        """`found` with the tangent that leads away from where the order of modes became what it is there."""
        for factor in _LOOKS:
            there = []
            for point in (found, found.turned()):
                guess = found.unknowns / self.scale + factor * length * point.tangent
                ahead = self._corrected(guess, point.tangent, point.tangent)
                if ahead is not None and ahead.found.order == found.found.order:
                    there.append(point)
            if len(there) == 1:
                return there[0]
        return found

    def _add(self, change: Change, located: OrbitPoint, more: str) -> None:
        value = float(located.unknowns[-1])
        self.events.append(BranchEvent(change.kind, value, len(self.points) - 1, change.text + more))

    def _located(
        self, last: OrbitPoint, found: OrbitPoint, is_before: Callable[[OrbitPoint], bool]
    ) -> tuple[OrbitPoint, str]:
        """The first point after an event between two points, by parts of the way between them; and in words how near it
        is, where Newton's method does not come nearer.
        """
        way = self._way(last, found)
        length = np.linalg.norm(way)
        if length == 0:
            return found, self._width(last.unknowns, found.unknowns)
        low, high, before, after = 0.0, 1.0, last, found
        while high - low > _LOCATED:
            for part in _MIDDLES:
                middle = low + part * (high - low)
                guess = last.unknowns / self.scale + middle * way
                point = self._corrected(guess, way / length, last.tangent)
                if point is not None:
                    break
            else:
                return after, self._width(before.unknowns, after.unknowns)
            if is_before(point):
                low, before = middle, point
            else:
                high, after = middle, point
        return after, ""
