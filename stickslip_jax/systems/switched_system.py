"""Systems of the user's: any ordinary differential equations with one dry-friction contact."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import FloatArray, Scalar

_SHARES = (0.0, 1.0, -1.0, 0.5)  # of the friction force, at which rates are looked at to see whether they are affine
_AFFINE = 1e-3  # of the largest rate: far above round-off in float32, far below any law that is not affine


class Base(NamedTuple):
    """The base at one instant: velocity in m/s (or rad/s) and acceleration; zeros for a base at rest."""

    velocity: FloatArray
    acceleration: FloatArray


class SwitchedSystem(eqx.Module):
    """One dry-friction contact in any system of ordinary differential equations. Subclass it and write three things.

    - `state_names`: what each number of the state is, and its unit; there are two or more.
    - `rates(t, y, base, friction)`: the time derivative of the state.
    - `relative_velocity(t, y, base)`: the velocity of one side of the contact relative to the other.

    Two masses in a row, the second of which rubs on the base::

        class TwoMasses(ss.SwitchedSystem):
            stiffness: float  # N/m, of the spring from the wall to the first mass, and of that between the masses
            mass: float  # kg, of each
            normal_force: float  # N
            mu: float
            mu_static: float

            @property
            def state_names(self):
                return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

            def rates(self, t, y, base, friction):
                x1, v1, x2, v2 = y
                pull = self.stiffness * (x2 - x1)
                rub = friction * self.mu * self.normal_force
                return v1, (pull - self.stiffness * x1) / self.mass, v2, (-pull - rub) / self.mass

            def relative_velocity(self, t, y, base):
                return y[3] - base.velocity

            @property
            def static_ratio(self):
                return self.mu_static / self.mu

            @property
            def shortest_time(self):  # the shorter one of the two natural periods
                return 2 * math.pi / (1.618 * (self.stiffness / self.mass) ** 0.5)


        system = TwoMasses(stiffness=1.0, mass=1.0, normal_force=1.0, mu=0.3, mu_static=0.4)
        one = ss.simulate(system, ss.Harmonic(1.0, 0.8), t1=50.0, y0=(0.0, 0.0, 1.0, 0.0))

    Fields hold numbers and arrays, or signals such as `Harmonic` for a force, ``self.force.value(t)``: what JAX can
    differentiate with respect to. Anything else, such as a name or a function, is declared
    ``field: str = equinox.field(static=True)``. `position` of a stick is the first number of the state.

    `simulate` and `simulate_ensemble` raise ValueError where an instance breaks these rules, as far as can be seen in
    the initial state with the base at rest. A base velocity of any kind drives the system, not a ground acceleration.
    """

    @property
    @abc.abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """What each number of the state is, with its unit: ``("angle in rad", "angular velocity in rad/s")``."""

    @abc.abstractmethod
    def rates(self, t: FloatArray, y: tuple[FloatArray, ...], base: Base, friction: FloatArray) -> tuple[Any, ...]:
        """The time derivatives of the state `y` (a tuple of scalars) at time `t` (s), as many scalars, by JAX.

        - `base`: velocity and acceleration of the base, m/s and m/s^2 (or rad/s and rad/s^2).
        - `friction`: the share of the kinetic friction force that acts: +1 while the relative velocity is positive, -1
          while it is negative, what it takes in a stick, at most `static_ratio`. The friction force is ``friction``
          times the kinetic one, and positive values act against a positive relative velocity. So rates are affine in
          `friction`: ``a + b friction``, where a and b depend on time, state and base.

        Of a kinetic force that depends on the relative velocity r, write ``friction * force(jnp.abs(r))``. Rates must
        be smooth, but for their dependence on ``jnp.abs(r)``.
        """

    @abc.abstractmethod
    def relative_velocity(self, t: FloatArray, y: tuple[FloatArray, ...], base: Base) -> FloatArray:
        """The relative velocity in the contact, m/s (or rad/s): a smooth scalar function of the state.

        It may depend on the base's velocity, not on its acceleration.
        """

    @property
    def static_ratio(self) -> Scalar:
        """What a stick holds over what a slip meets at its beginning, ``mu_static / mu``; at least 1."""
        return 1.0

    @property
    def shortest_time(self) -> Any:
        """The shortest time scale, s: the shortest natural period, or 2 pi times a shorter time constant.

        The default time step is 1/48 of it, and no step may be longer than 1/12 of it. None where it is not known; the
        step must be given then, ``method=Exact(step=...)``.
        """
        return None

    @property
    def speed_scale(self) -> Any:
        """The scale of relative velocities, m/s (or rad/s): the speed that friction takes away in one `shortest_time`.

        A smoothed friction law takes its width from it. None where it is not known.
        """
        return None


def check_fields(system: SwitchedSystem) -> None:
    """Check the numbers that describe `system`. Raises ValueError otherwise."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(system):
        if not isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array)):
            field = jax.tree_util.keystr(path).lstrip(".")
            raise ValueError(
                f"Argument {field} of a {type(system).__name__} must be a number or an array, but {_checks.show(leaf)} "
                f"was given; declare a field of another kind as {field}: ... = equinox.field(static=True)."
            )
    names = system.state_names
    if not isinstance(names, tuple) or len(names) < 2 or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"Argument state_names of a {type(system).__name__} must be a tuple of two names or more, but "
            f"{_checks.show(names)} was given."
        )
    _checks.numeric("static_ratio", system.static_ratio)
    if not _checks.is_traced(system.static_ratio) and system.static_ratio < 1:
        raise ValueError(
            f"Argument static_ratio must be at least 1, but {system.static_ratio} was given: a stick holds at least as "
            "well as a slip."
        )
    for name in ("shortest_time", "speed_scale"):
        if getattr(system, name) is not None:
            _checks.positive(name, getattr(system, name))


def check_motion(system: SwitchedSystem, y0: tuple[Any, ...]) -> None:
    """Check what `system` returns in the state `y0` at time 0, with the base at rest. Raises ValueError otherwise."""
    kind, zero = type(system).__name__, jnp.zeros(())
    y, base = tuple(jnp.asarray(value, float) for value in y0), Base(zero, zero)
    try:
        rates = [system.rates(zero, y, base, jnp.asarray(share)) for share in _SHARES]
    except ValueError as error:  # the state does not come apart into as many names as rates gives it
        raise ValueError(
            f"Argument rates of a {kind} must accept a state of {len(y)} numbers, but: {error}."
        ) from error
    _check_rates(kind, rates[0], len(y))
    velocity = system.relative_velocity(zero, y, base)
    if not _is_scalar(velocity):
        raise ValueError(
            f"Argument relative_velocity of a {kind} must return a scalar, but {_checks.show(velocity)} was given."
        )
    gradient = jax.grad(lambda y: jnp.asarray(system.relative_velocity(zero, y, base), float))(y)
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves((rates, gradient))):
        return
    _check_affine(kind, np.array([[float(rate) for rate in row] for row in rates]), np.array(gradient, float))


def _check_rates(kind: str, rates: Any, size: int) -> None:
    given = len(rates) if isinstance(rates, (tuple, list)) else None
    if given != size:
        shown = _checks.show(rates) if given is None else f"{given}"
        raise ValueError(
            f"Argument rates of a {kind} must return a tuple of {size} numbers, one for each of state_names, but "
            f"{shown} was given."
        )
    for number, rate in enumerate(rates):
        if not _is_scalar(rate):
            raise ValueError(
                f"Argument rates of a {kind} must return scalars, but number {number} of shape {np.shape(rate)} was "
                "given."
            )


def _check_affine(kind: str, rates: np.ndarray, gradient: np.ndarray) -> None:
    """`rates` at the shares (4, states) must be affine in them, and friction must not speed up what slides."""
    if not np.all(np.isfinite(rates)):
        return  # such a simulation says so by its status
    bend = np.max(np.abs([rates[1] + rates[2] - 2 * rates[0], rates[0] + rates[1] - 2 * rates[3]]), axis=0)
    wrong = np.flatnonzero(bend > _AFFINE * np.max(np.abs(rates - rates[0]), axis=0, initial=0))
    wrong = [number for number in wrong if bend[number] > 1e-5 * np.max(np.abs(rates[:, number]))]
    if wrong:
        values = ", ".join(f"{rate:.6g} at {share:g}" for share, rate in zip(_SHARES, rates[:, wrong[0]], strict=True))
        raise ValueError(
            f"Argument rates of a {kind} must be affine in friction, a + b friction, but rate number {wrong[0]} is "
            f"{values}; multiply the kinetic friction force by friction, and nothing else."
        )
    effects = gradient * (rates[1] - rates[2]) / 2
    if np.sum(effects) > _AFFINE * np.sum(np.abs(effects)):
        raise ValueError(
            f"Argument rates of a {kind} must let positive friction act against a positive relative velocity, but "
            f"friction = 1 raises the rate of the relative velocity by {np.sum(effects):.6g} against friction = 0; "
            "turn its sign round."
        )


def _is_scalar(value: Any) -> bool:
    return isinstance(value, (int, float, np.generic, np.ndarray, jax.Array)) and np.ndim(value) == 0
