"""What is fitted: numbers of a system and its base, and the states in which windows of the record begin."""

from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._dynamics.common.method import Arguments, Exact, Regularized
from .._dynamics.common.path import SegmentLaws, padded_length
from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._dynamics.sticks import ALL
from .._dynamics.switched.engine import SwitchedEngine, steps_for
from .._excitation.excitation import BaseMotion, excitation_of, merged
from .._excitation.segments import first_segment, segment_at
from .._foundation.fields import Quantity, modules_in
from .._foundation.types import BoolArray, FloatArray, Scalar
from .._systems.friction import FrictionLaw
from .._systems.system import System
from .._uncertainty.numbers import NumberPath, with_numbers
from .parameters import Transform
from .record import Observer, Windows

_ROUND_OFF = 1e-12  # relative, of static friction below kinetic


class Sensor(eqx.Module):
    """What a channel shows: what it measures, a time `delay` ago, and a constant `offset` more."""

    delay: Annotated[Scalar, Quantity("s")] = 0.0
    offset: Annotated[Scalar, Quantity()] = 0.0


class EstimatedNumbers(NamedTuple):
    """Where the numbers to be estimated stand. `clock`: a delay of the whole record; `sensors`: of the channels, or
    none if all are as they should be.
    """

    system: System
    base: BaseMotion
    clock: Sensor = Sensor()
    sensors: tuple[Sensor, ...] = ()


def static_holds(setting: EstimatedNumbers) -> BoolArray:
    """Whether in no friction law static friction is below kinetic friction."""
    holds = jnp.ones((), bool)
    for law in modules_in(setting):
        if isinstance(law, FrictionLaw) and law.inner_state is None and not law.depends_on_direction:
            kinetic = jnp.asarray(law.kinetic(jnp.zeros(())))
            holds = holds & (jnp.asarray(law.static) >= kinetic * (1 - _ROUND_OFF))
    return holds


class FittedMotion(eqx.Module):
    """The motion as a function of the numbers to be estimated (`paths`, by their `transform`) and of states at starts.

    States are searched as differences from `state_origin` (windows, coordinates); contacts that are `resting` at a
    start (windows, modes) have no relative velocity there, whatever the state.
    """

    setting: EstimatedNumbers
    state_origin: Array
    resting: Array | None
    method: Exact | Regularized
    transform: Transform
    paths: tuple[NumberPath, ...] = eqx.field(static=True)
    observers: tuple[Observer, ...] = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def setting_at(self, numbers: FloatArray) -> EstimatedNumbers:
        """System, base and sensors with other numbers, (parameters,)."""
        return with_numbers(self.setting, self.paths, numbers)

    def observed(
        self, x: FloatArray, s: FloatArray, origin: FloatArray, resting: BoolArray | None, window: Windows
    ) -> FloatArray:
        """What is seen of one window's motion, (channels, times); NaN if it does not reach the window's end, and for
        static friction below kinetic friction.
        """
        setting, y = self.setting_at(self.transform.numbers(x)), origin + s
        system, base, clock, sensors = setting
        begin, end, times = map(jnp.asarray, (window.begins, window.ends, window.times))
        if isinstance(self.method, Regularized):
            one = simulate(system, base, t1=end, y0=tuple(y), method=self.method)
        else:
            excitation, step = Arguments(system, merged(base, end), self.method, end).checked_step()
            given = end, tuple(y), step, self.steps, self.method.solver
            engine = SwitchedEngine(system, excitation, *given, quantities=ALL)
            run = engine.run(*engine.follow(y.dtype, t0=begin, resting=resting))
            one = Simulation(system, base, end, self.method, *run)
        if sensors:
            shown, late = zip(self.observers, sensors, strict=True), times - clock.delay
            seen = jnp.stack([observe(one, late - sensor.delay) + sensor.offset for observe, sensor in shown])
        else:
            seen = jnp.stack([observe(one, times) for observe in self.observers])
        return jnp.where(static_holds(setting), seen, jnp.nan)


def loop_steps(arguments: Arguments, share: float, spare: int = 0) -> int:
    """Loop steps for this share of the time until the end, and `spare` ones; as many as the method says, if it does."""
    system, _, method, t1 = arguments
    if isinstance(method, Regularized):  # knows them itself
        return 0
    if method.max_steps is not None:
        return method.max_steps
    excitation, step = arguments.checked_step()
    return padded_length(int(share * steps_for(system, excitation, t1, step)) + spare)


def with_slopes(model: FittedMotion, windows: Windows, x: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is seen of the motions in all windows, (windows, channels, times), and its derivatives by `x` and the own
    state of each window, (windows, channels, times, parameters + coordinates).

    `x` (parameters,), `s` (windows, coordinates). In forward mode: each window depends on few numbers.
    """
    number = x.shape[0]

    def both(
        joined: FloatArray, origin: FloatArray, resting: BoolArray | None, window: Windows
    ) -> tuple[FloatArray, FloatArray]:
        seen = model.observed(joined[:number], joined[number:], origin, resting, window)
        return seen, seen

    joined = jnp.concatenate([jnp.broadcast_to(x, (s.shape[0], number)), s], axis=1)
    slopes, seen = jax.vmap(jax.jacfwd(both, has_aux=True))(joined, model.state_origin, model.resting, windows)
    return seen, slopes


@eqx.filter_custom_jvp
def predicted(model: FittedMotion, windows: Windows, x: FloatArray, s: FloatArray) -> FloatArray:
    """What is seen of the motions in all windows, (windows, channels, times), with derivatives of first order by x, s.

    They are all computed at once, by `with_slopes`; reverse mode multiplies by them. Where a motion does not reach its
    end they are zero, so that a `where` can leave it out.
    """
    return jax.vmap(model.observed, in_axes=(None, 0, 0, 0, 0))(x, s, model.state_origin, model.resting, windows)


@predicted.def_jvp
def _(primals: Any, tangents: Any) -> tuple[FloatArray, FloatArray]:
    (model, windows, x, s), (of_model, of_windows, dx, ds) = primals, tangents
    assert not jax.tree.leaves((of_model, of_windows)), "only x and s have derivatives"
    dx, ds = jnp.zeros_like(x) if dx is None else dx, jnp.zeros_like(s) if ds is None else ds
    seen, slopes = with_slopes(model, windows, x, s)
    slopes = jnp.where(jnp.isfinite(seen)[..., None], slopes, 0)
    changes = jnp.concatenate([jnp.broadcast_to(dx, (s.shape[0], x.shape[0])), ds], axis=1)
    return seen, jnp.einsum("wctp,wp->wct", slopes, changes)


@eqx.filter_jit
def slip_speeds(setting: EstimatedNumbers, solver: Any, times: FloatArray, states: FloatArray) -> FloatArray:
    """The sizes of the relative velocities of contacts in `states` (times, coordinates) at `times` (s), (times, modes)
    or (times,); infinite for modes that are no contacts.
    """
    system, base, *_ = setting
    excitation, dtype = excitation_of(merged(base, times[-1])), states.dtype
    laws = SegmentLaws.of(system, excitation)
    model = system.switched_model(excitation.signal, solver)
    firsts = tuple(first_segment(law, jnp.zeros(2, jnp.uint32), dtype) for law in laws.all)

    def at(t: FloatArray, y: FloatArray) -> FloatArray:
        segments = tuple(segment_at(law, first, t) for law, first in zip(laws.all, firsts, strict=True))
        forcing, state = model.forcing(t, laws.segments(segments)), model.start(tuple(y), dtype)
        speeds = jnp.abs(model.relative_velocity(forcing, jnp.zeros((), dtype), state))
        modes = model.at_rest(forcing, state).shape
        return jnp.full(modes, jnp.inf).at[: len(speeds)].set(speeds) if modes else speeds

    return jax.vmap(at)(times, states)
