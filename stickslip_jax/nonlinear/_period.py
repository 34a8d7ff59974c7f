"""The period of what drives a system: its base, and the forces in its fields."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._excitation.motion import Motion
from .._excitation.smooth import Signal, UserMotion
from .._fields import is_of_package, modules_in
from .._numerics.known import NotKnown, values_of
from .._types import Array, Scalar

_MOST_CYCLES = 1000  # of the slowest motion until all motions begin anew
_EQUAL = 1e-9  # relative
_INSTANTS = (1024, 65_536)  # of a period, at which a signal is compared with itself one period later
_IN_FASTEST = 16  # of them in its fastest oscillation
_MOST_INSTANTS = 4_000_000  # of all cases


def repetitions(system: object, base: object, by_itself: bool = False) -> list[tuple[str, Any]]:
    """The class name of each motion that drives the system, and its `Motion.repeats_after`: numbers (s), or arrays
    (cases,) where numbers of the motion are. `by_itself`: the system changes with time in a way of its own.
    """
    found = [*_outermost(base), *_outermost(system)]
    own: list[tuple[str, Any]] = [(type(system).__name__, None)] if by_itself else []
    return [(type(motion).__name__, motion.repeats_after) for motion in found] + own


def _outermost(tree: object) -> Iterator[Motion]:
    """The motions in `tree` that hold no other motion."""
    motions = [module for module in modules_in(tree) if isinstance(module, Motion)]
    for motion in motions:
        inside = sum(isinstance(part, Motion) for part in modules_in(motion))
        if inside == 1:
            yield motion


def drives(periods: list[tuple[str, Any]]) -> bool:
    """Whether anything of what `repetitions` found changes with time."""
    return any(period is None for _, period in periods) or common_period(periods) is not None


def period_of(periods: list[tuple[str, Any]], given: Scalar | None) -> tuple[Any, bool]:
    """The period (s) of what `repetitions` found, (cases,) if its times are, or the one `given`; and whether anything
    drives the system.

    Raises ValueError where none is given or known, and where what drives the system does not repeat itself after it.
    """
    unknown = [name for name, period in periods if period is None]
    if given is not None:
        common = None if unknown else common_period(periods)
        cycles = np.ones(()) if common is None else np.asarray(given / common)
        if common is not None and not np.all(np.abs(cycles - np.round(cycles)) <= _EQUAL * cycles):
            raise ValueError(
                f"Argument period must be a whole number of periods of what drives the system, "
                f"{float(np.ravel(common)[0]):.9g} s, but {_checks.show(given)} was given."
            )
        return given, common is not None or bool(unknown)
    if unknown:
        raise ValueError(
            f"Argument period must be given (s), because none is known of the {unknown[0]} that drives the system; of "
            "a record, the duration after which it begins anew."
        )
    common = common_period(periods)
    if common is None:
        raise ValueError(
            "Argument period must be given (s), because nothing that changes with time drives the system; it is then "
            "the time after which the state is seen again and again. A section by events (event_section) needs none."
        )
    return common, True


def common_period(periods: list[tuple[str, Any]]) -> np.ndarray | None:
    """The common period; None if nothing changes with time. Raises ValueError where there is none."""
    parts = [part for _, period in periods for part in (period if isinstance(period, tuple) else (period,))]
    columns = np.broadcast_arrays(*(np.asarray(part, float) for part in parts)) if parts else []
    changing = [column for column in columns if np.any(column > 0)]
    if not changing:
        return None
    every = np.stack(changing)
    slowest = np.max(every, axis=0)
    common = np.full(slowest.shape, np.nan)
    for number in range(1, _MOST_CYCLES + 1):
        cycles = number * slowest / every
        fits = np.all(np.abs(cycles - np.round(cycles)) <= _EQUAL * cycles, axis=0)
        common = np.where(np.isnan(common) & fits, number * slowest, common)
        if not np.any(np.isnan(common)):
            return common
    bad = int(np.flatnonzero(np.isnan(np.atleast_1d(common)))[0])
    shown = ", ".join(f"{np.atleast_1d(column)[bad]:.6g}" for column in every)
    raise ValueError(
        f"Argument period must be given (s), because motions with the periods {shown} s drive the system, of which no "
        f"{_MOST_CYCLES} of the slowest are a common period."
    )


def has_known_period(system: object, base: object, by_itself: bool) -> bool:
    """Whether what drives the system has a period that is known without being given."""
    try:
        period_of(repetitions(system, base, by_itself), None)
    except ValueError:
        return False
    return True


def check_signals(tree: object, period: Array) -> None:
    """Raise ValueError where a signal of a user's own in `tree` is another one a `period` (s) later, at many instants
    of one period; of many cases, arrays have a first axis (cases,), and `period` is (cases,).
    """
    if any(map(_checks.is_traced, jax.tree.leaves((tree, period)))):
        return
    periods = np.atleast_1d(np.asarray(period, float))
    for signal in _outermost(tree):
        held = signal.motion if isinstance(signal, UserMotion) else signal
        if not isinstance(signal, Signal) or (held is signal and is_of_package(signal)):
            continue
        fastest = np.asarray(signal.shortest_period or np.inf, float)
        number = np.clip(_IN_FASTEST * np.max(periods) / np.min(fastest), *_INSTANTS)
        shares = (np.arange(int(min(number, max(_MOST_INSTANTS / len(periods), 64)))) + 0.382) / number

        def differences(signal: Signal, period: Array, shares: np.ndarray = shares) -> tuple[Array, Array, Array]:
            times = period * jnp.asarray(shares, period.dtype)
            first, second = (jax.vmap(signal.value)(at) for at in (times, times + period))
            # Beside differences of the values themselves, what the rounding of the instants makes of the rates.
            rates, eps = jax.vmap(signal.rate)(times), jnp.finfo(period.dtype).eps
            bound = jnp.sqrt(eps) * jnp.max(jnp.abs(first)) + 4 * eps * period * jnp.abs(rates)
            worst = jnp.argmax(jnp.abs(first - second) - bound)
            differs = ~(jnp.abs(first - second) <= bound)[worst]
            return differs, times[worst], jnp.stack([first[worst], second[worst]])

        found = differences if np.ndim(period) == 0 else eqx.filter_vmap(differences)
        differs, times, values = map(np.asarray, found(signal, jnp.asarray(period)))
        if np.any(differs):
            case = int(np.argmax(differs))
            one, other = values.reshape(-1, 2)[case]
            name = type(signal).__name__ if held is signal else type(getattr(held, "held", held)).__name__
            raise ValueError(
                f"Argument period must be a time after which {name} repeats itself, but its value is {one:.6g} at "
                f"{times.ravel()[case]:.6g} s and {other:.6g} {periods[case]:.9g} s later."
            )


def drive_period(system: object, base: object, given: Scalar | None, by_itself: bool) -> Scalar | None:
    """The period (s) of what drives the system, differentiable; None if nothing changes with time.

    Raises ValueError where none is given or known, and where what drives the system does not repeat itself after it.
    """
    found = repetitions(system, base, by_itself)
    parts = [part for _, period in found for part in (period if isinstance(period, tuple) else (period,))]
    if any(part is None for part in parts):
        return given if given is not None else period_of(found, None)[0]
    changing = [part for part in parts if _checks.is_traced(part) or float(part) > 0]
    if not changing or given is not None:
        if not any(map(_checks.is_traced, [*parts, given])):
            period_of(found, given or 1.0)
        return given if changing else None
    if len(changing) == 1:
        return changing[0]
    try:
        values = [values_of(part) for part in changing]
    except NotKnown:
        raise ValueError(
            "Argument period must be given (s) under jax.jit, because several motions drive the system."
        ) from None
    common = common_period([("", value) for value in values])
    cycles = np.unique(np.round(common / values[0]))
    if len(cycles) > 1:
        raise ValueError("Argument period must be given (s): the motions that drive these systems have no common one.")
    return float(cycles[0]) * changing[0]


def checked_period(period: object) -> Scalar | None:
    """`period`, a positive time (s) or None."""
    if period is None:
        return None
    _checks.positive("period", period, "s")
    return period  # pyright: ignore[reportReturnType] - checked
