"""One simulated trajectory: `Simulation`, with its friction force, energies and labelled arrays."""

import dataclasses
import math
import os
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compiler.programs import is_compiling, kept_jit
from .._excitation.excitation import BaseMotion
from .._foundation import checks, html
from .._foundation.extras import flags, labeled_dataset, variable
from .._foundation.fields import WithMethods, in_one_line, with_fields
from .._foundation.files import Columns, table_of, write_table
from .._foundation.types import AnyArray, FloatArray, IntArray, Scalar, Status
from .._numerics.matrices import MANY, stacked
from .._systems.switched_model import Form, OneContactModel, is_observed, of_form, require_energy_model
from .._systems.system import Coordinate, System
from .common.lanes import SIGNS, Asked, Sums
from .common.method import Exact, Regularized
from .common.path import CHECK_EVERY, MotionPath, padded_length
from .energies import Energies, energies, forces, forces_of_contacts, rule_for
from .interval.engine import IntervalPath
from .sticks import (
    NUMBERS,
    FlatSticks,
    Slips,
    Sticks,
    Totals,
    of_contact,
    shown_counts,
    slip_variables,
    slips_between,
    stick_columns,
    stick_variables,
)
from .switched.engine import MOST_STEPS, StepPath, follow_steps
from .switched.inside import halves_for

if TYPE_CHECKING:
    import pandas
    import xarray


T = TypeVar("T")

_ROOMS = (16, 1 << 12, 1 << 16)  # numbers of times that programs are made for; more: one part after the other


# One trajectory as a table of its sticks and as labelled arrays.


def columns_of(sticks: Sticks, position: Coordinate) -> Columns:
    """The columns of the table of the sticks of one trajectory. `position`: what the position of a stick is.

    Of several contacts, those of one after those of another, with the number of the contact.
    """
    if sticks.contact is None:
        return stick_columns(*_in_order(sticks), position)
    last = int(np.max(np.asarray(sticks.contact), initial=-1))
    parts = [columns_of(of_contact(sticks, number), position) for number in range(last + 1)]
    numbers = np.repeat(np.arange(last + 1), [len(part["order"]) for part in parts])
    empty = columns_of(of_contact(sticks, -2), position)
    columns = {name: np.concatenate([empty[name], *(part[name] for part in parts)]) for name in empty}
    return {"contact": numbers} | columns


def source() -> dict[str, object]:
    """Attributes that say which program made a data set."""
    from .. import __version__  # noqa: PLC0415 - the package imports this module

    return {"source": f"stickslip_jax {__version__}", "stickslip_jax_version": __version__}


def provenance(system: object, base: object, method: object, t1: float | None = None) -> dict[str, object]:
    """Attributes that say what was simulated and how, and for how long. Numbers are in SI units."""
    horizon = {} if t1 is None else {"t1": t1}
    return {"system": in_one_line(system), "base": in_one_line(base), **horizon, **method_attributes(method)}


def method_attributes(method: object) -> dict[str, object]:
    """Attributes that state the method and its criterion of a stick, in SI units: numbers, or arrays (contacts,)."""
    if isinstance(method, Exact):
        return {"method": "exact"} if method.step is None else {"method": "exact", "time_step": float(method.step)}
    if not isinstance(method, Regularized):
        return {"method": "none" if method is None else str(method)}
    numbers = {
        "width": method.width,
        "stick_threshold": method.threshold,
        "stick_minimum_duration": method.minimum_duration,
        "time_step": method.step,
    }
    known = {name: np.asarray(number, float) for name, number in numbers.items() if number is not None}
    known = {name: number if number.ndim else float(number) for name, number in known.items()}
    return {"method": "regularised", "shape": method.shape, **known}


def _in_order(sticks: Sticks) -> tuple[FlatSticks, np.ndarray]:
    """The sticks without empty slots, and the number of each from 1; 0 for one that begins at t = 0.

    So ensembles count by default.
    """
    mask = np.asarray(sticks.mask)
    columns = {name: np.asarray(getattr(sticks, name))[mask] for name in (*NUMBERS, "ending")}
    flat = FlatSticks.of(np.array([mask.sum()]), **columns)
    return flat, np.arange(len(flat.start)) + (0 if flat.begins_at_zero[0] else 1)


# One simulated trajectory: `Simulation`.


class Simulation(WithMethods):
    """One simulated trajectory on ``[0, t1]``.

    Attributes:
        sticks: Every stick (`Sticks`).
        slips: Every slip (`Slips`).
        totals: The number of sticks (`sticks`), how many the end, `t1`, cut (`censored`), and their total time
            (`stick_time`, s).
        stick_time: Total time in sticks, s.
        slip_time: Total time in slips, s.
        stick_fraction: Total stick time over ``t1``.
        final_state: Position (m) and velocity (m/s), for a `MotorCart` angle (rad), angular velocity (rad/s) and
            current (A), at `time_reached`.
        time_reached: Where the simulation ended, s; ``t1`` if the trajectory is FINISHED.
        status: A `Status` code; 0 is FINISHED. With any other code do not use the numbers.
        near_grazing_count: Number of instants at which round-off decided whether there was an event: the relative
            velocity had an extremum near zero, or the force that a stick needs one near the friction limit; the mass
            came to rest where friction could just hold it; or a jump of the base or `t1` came just before or
            after an event. Near means within about 1e-9 of the scale (float32: 1e-3). Where the motion is known in
            closed form: the number of intervals of the base in which an error of up to 256 units in the last place
            (float32: 64) would have decided; a slip tangent to the base velocity from which it was released is none.
            Not counted by `Regularized` (0).
        step_starts: The instants at which the steps of the simulation begin, s: time steps or, where the motion is
            known in closed form, whole intervals of the base velocity.
        system: The argument of `simulate`.
        base: The excitation, as given to `simulate`.
        t1: The duration, s.
        method: The method; of a `Regularized` one all options are filled in.
    """

    system: System
    base: BaseMotion
    t1: Scalar
    method: Exact | Regularized
    sticks: Sticks
    totals: Totals
    status: Int[Array, "*batch"]
    time_reached: Float[Array, "*batch"]
    final_state: tuple[Float[Array, "*batch"], ...]
    near_grazing_count: Int[Array, "*batch"]
    _path: MotionPath
    _of_all_contacts: tuple[Sticks, Totals] | None = None

    @property
    def slips(self) -> Slips:
        checks.require_threads_of_jax()
        if self.sticks.contact is not None:
            raise ValueError(
                "Slips are those of one contact here: take simulation.of_contact(number).slips, or those of "
                "simulation.of_all_contacts()."
            )
        return slips_between(self.sticks, self.time_reached)

    def of_contact(self, number: int) -> "Simulation":
        """The same trajectory with the sticks, slips and totals of one contact.

        Args:
            number: Of the contact, from 0.

        Returns:
            A simulation whose sticks and totals are those of this contact, as of ``system.of_contact(number)``.

        Raises:
            ValueError: For a system without a list of contacts, and for a number that is not one of its contacts.
        """
        if self._of_all_contacts is None:
            raise ValueError("This system has one contact: its sticks are in simulation.sticks.")
        contacts = 1 if self.sticks.contact is None else self.totals.sticks.shape[-1]
        checks.whole_number("number", number, minimum=0, maximum=contacts - 1)
        system = cast(Any, self.system).of_contact(number)
        if self.sticks.contact is None:
            return with_fields(self, type(self), system=system, _of_all_contacts=None)
        parts = self.totals._replace(**{name: values[..., number] for name, values in self.totals._asdict().items()})
        own = of_contact(self.sticks, number)
        return with_fields(self, type(self), system=system, sticks=own, totals=parts, _of_all_contacts=None)

    def of_all_contacts(self) -> "Simulation":
        """The same trajectory with the times in which every closed contact sticks, such as the arrest of a chain.

        Returns:
            A simulation whose sticks and totals are these; positions are those of the first coordinate. A time in which
            no contact is closed is no stick.

        Raises:
            ValueError: For a system with one contact.
        """
        if self._of_all_contacts is None:
            raise ValueError("This system has one contact: its sticks are in simulation.sticks.")
        sticks, totals = self._of_all_contacts
        return with_fields(self, type(self), sticks=sticks, totals=totals, _of_all_contacts=None)

    @property
    def stick_time(self) -> Float[Array, "*batch"]:
        return self.totals.stick_time

    @property
    def slip_time(self) -> Float[Array, "*batch"]:
        checks.require_threads_of_jax()
        return self.time_reached - self.totals.stick_time

    @property
    def stick_fraction(self) -> Float[Array, "*batch"]:
        checks.require_threads_of_jax()
        return self.totals.stick_time / self.t1

    def stick_time_between(self, begin: Scalar, end: Scalar | None = None) -> Float[Array, "*batch"]:
        """The time in sticks from `begin` to `end`; by its derivative too, with ends that JAX may trace.

        Args:
            begin: s.
            end: s; by default ``t1``.

        Returns:
            s. Over a whole period of a steady motion, divided by that period, it is the stick share of the motion.

        Raises:
            ValueError: Unless both are numbers, and where several contacts stick: ask one, ``of_contact(number)``.
        """
        checks.require_threads_of_jax()
        if self.sticks.contact is not None:
            raise ValueError(
                "stick_time_between needs the sticks of one contact, but a simulation of several was given; call it on "
                "of_contact(number) or of_all_contacts()."
            )
        last = self.t1 if end is None else end
        for name, value in (("begin", begin), ("end", last)):
            checks.numeric(name, value)
        first, last = (jnp.asarray(value)[..., None] for value in (begin, last))
        first_of, last_of = (jnp.where(self.sticks.mask, times, 0) for times in (self.sticks.start, self.sticks.end))
        return jnp.maximum(jnp.minimum(last_of, last) - jnp.maximum(first_of, first), 0).sum(axis=-1)

    @property
    def step_starts(self) -> Float[Array, "*batch steps"]:
        """The instants at which the steps of the simulation begin, s; unused slots hold the end."""
        return self._path.times

    def evaluate(self, times: AnyArray | float) -> tuple[FloatArray, ...]:
        """The state at `times` (s, any shape), as exact as the simulation.

        Under ``jax.jit`` write ``jax.jit(lambda t: one.evaluate(t))``.

        Args:
            times: s, any shape.

        Returns:
            Position (m) and velocity (m/s), for a `MotorCart` angle (rad), angular velocity (rad/s) and current (A);
            NaN outside ``[0, time_reached]``.
        """
        size = len(self.final_state)
        found = self._at(partial(_evaluate, self, size=size), self._checked(times))
        return found if isinstance(found, tuple) else tuple(found[..., i] for i in range(size))

    def base_velocity(self, times: AnyArray | float) -> FloatArray:
        """The base velocity at `times` (s, any shape), m/s; at a jump, the one after it. 0 for a `MotorCart`."""
        return self._at(partial(_base_velocities, self._path), self._checked(times))

    def maximum(self, coordinate: str | None = None) -> FloatArray:
        """The largest value of a coordinate over ``[0, time_reached]``, as exact as the simulation: not on a grid.

        Where the motion is known in closed form, so is this: on an arc the position is largest where the velocity is 0.
        Elsewhere a zero of the slope is located inside each time step. Under ``jit`` and ``vmap`` as well, and with
        exact derivatives: that of the value at the instant of the maximum. (Where several maxima are equal, as on a
        periodic motion, it is that of one of them.)

        Args:
            coordinate: Its name, "position" or "velocity"; for a `MotorCart` "angle", "angular velocity" or "current".
                Or what `response` knows beside the coordinates, such as "total acceleration". Or the difference of two
                of one unit, as the drift of a storey, ``"position 2 - position 1"``. By default the first.

        Returns:
            The maximum, in the unit of the coordinate.

        Raises:
            ValueError: For another name, and for a batch.

        >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
        >>> one = ss.simulate(system, ss.Constant(1.0), t1=10.0, y0=(0.0, 1.0))
        >>> print(f"{one.maximum():.4f} m, {one.maximum('velocity'):.4f} m/s, {one.peak():.4f} m")
        0.7500 m, 1.0000 m/s, 0.7500 m
        """
        return self._largest(self._form_of(coordinate), 1)

    def minimum(self, coordinate: str | None = None) -> FloatArray:
        """The smallest value of a coordinate over ``[0, time_reached]``; as `maximum`."""
        return -self._largest(self._form_of(coordinate), -1)

    def peak(self, coordinate: str | None = None) -> FloatArray:
        """The largest absolute value of a coordinate over ``[0, time_reached]``; as `maximum`.

        ``one.peak("position")`` is the peak displacement.
        """
        form = self._form_of(coordinate)
        return jnp.maximum(self._largest(form, 1), self._largest(form, -1))

    def _largest(self, form: Form, sign: int) -> FloatArray:
        if not is_observed(form, len(self.final_state)):
            return _largest(self, form, sign)
        return self._along_steps("maximum", Asked(observed=(form,)))[0][SIGNS.index(sign), 0]

    def _form_of(self, coordinate: str | None) -> Form:
        """A coordinate, or what is observed beside them, or the difference of two of a kind, by their places."""
        self._require_one()
        coordinates = self.system.coordinates + self.system.observed
        if coordinate is None:
            return ((0, 1.0),)
        names = [one.name for one in coordinates]
        parts = coordinate.split(" - ") if isinstance(coordinate, str) else []
        if len(parts) == 2 and all(part in names for part in parts):
            first, second = map(names.index, parts)
            if coordinates[first].unit == coordinates[second].unit:
                return (first, 1.0), (second, -1.0)
        return ((names.index(checks.chosen("coordinate", coordinate, names)), 1.0),)

    def friction_force(self, times: AnyArray | float) -> FloatArray:
        """The friction force on the mass at `times` (s, any shape), N: positive in the direction of positive velocity.

        In a slip it opposes the velocity relative to the base; in a stick it is what the stick needs (Lima and Sampaio
        2015, eqs 1 and 2). With `Regularized` it is the smoothed force. Of a `MotorCart` it is the force on the cart,
        in the direction of ``eccentricity cos(angle)`` (Lima and Sampaio 2022, eq. 4). It jumps at events; there it is
        that of the stick or slip that follows. Of a list of contacts, it is that in each, in the direction of positive
        relative velocity; behind a spring, the spring's.

        Args:
            times: s, any shape.

        Returns:
            The force, N; NaN outside ``[0, time_reached]``. Of several contacts (contacts, ...), unless one of them is
            counted (`LinearStructure.of_contact`).

        Raises:
            ValueError: For a `SwitchedSystem`, a list of contacts with `Regularized`, and a batch.
        """
        return self._friction(times)[0]

    def relative_velocity(self, times: AnyArray | float) -> FloatArray:
        """The velocity of the mass relative to the base, which friction opposes, at `times` (s, any shape), m/s.

        Of a `MotorCart` it is that of the cart. ``-friction_force * relative_velocity`` is the power that friction
        dissipates. 0 in a stick; with `Regularized`, and of friction with an inner state, the velocity of the creep.

        Args:
            times: s, any shape.

        Returns:
            The velocity, m/s; NaN outside ``[0, time_reached]``.

        Raises:
            ValueError: As `friction_force`.
        """
        return self._friction(times)[1]

    def _friction(self, times: AnyArray | float) -> tuple[FloatArray, FloatArray]:
        times = self._checked(times)
        inner = self.system.inner_model(self._path.smooth)
        if inner is not None and isinstance(inner.inner, OneContactModel):
            model, known = inner, inner.inner
        else:
            model = self.system.switched_model(self._path.smooth, None)
            known, _ = model.without_memory(())
        require_energy_model(known, "friction_force")
        if not isinstance(known, OneContactModel):
            if not isinstance(self.method, Exact):
                raise checks.refused("method", "be Exact() for friction forces in a list of contacts", self.method)
            found = self._at(partial(forces_of_contacts, model, self._path, self.time_reached), times)
            tracks = self.system.tracks
            counted = 0 if tracks.contacts == 1 else tracks.counted
            force, velocity = (jnp.moveaxis(one, -1, 0) for one in found)
            return (force, velocity) if counted in (None, -1) else (force[counted], velocity[counted])
        return self._at(partial(forces, model, self._path, self.method, self.sticks, self.time_reached), times)

    def energies(self, times: AnyArray | float) -> Energies:
        """Stored, supplied and dissipated energies at `times` (s, any shape), J: an `Energies`.

        Integrals of the powers over each time step, by Gauss's rule with 8 points; sums over all contacts.
        Where the motion is known in closed form over whole intervals, it is followed again in time steps for this.

        Args:
            times: s, any shape.

        Returns:
            The energies, J; NaN outside ``[0, time_reached]``.

        Raises:
            ValueError: For a `SwitchedSystem`, a `Regularized` method, a `MotorCart` with the printed equation, a
                batch, and under ``jit`` where `t1` is traced.
        """
        times = self._checked(times)
        path, last = self._in_steps("energies"), self.time_reached
        assert isinstance(path, StepPath)
        model = path.model
        known, _ = model.without_memory(())
        require_energy_model(known, "energies")
        known.check_energy()
        lengths = jnp.append(path.beginnings.t[1:], last) - path.beginnings.t
        rule = rule_for(known.fastest_decay, jnp.max(lengths))
        return self._at(partial(energies, model, path.beginnings, last, rule), times)

    def response(self, name: str, times: AnyArray | float) -> FloatArray:
        """What is called `name`, at `times` (s, any shape): a coordinate, what follows from them, or a difference.

        Of a `MassSpring` "position" and "velocity", "acceleration", "total acceleration" (with that of the ground),
        "relative velocity" (of the contact), "friction force" and "base shear". Of a `LinearStructure` the same with
        the number of the mass or contact: "total acceleration 2". With `rotates`, "angular acceleration 0" and "base
        torque".
        The base shear is the force of ground and base on all masses, of a building on sliding bearings that in the
        bearings: the sum of mass times total acceleration, less the external forces.

        Accelerations and friction forces jump at events; there they are those after it.

        Args:
            name: One of the names above, or a difference of two of one unit:
                "total acceleration 1 - total acceleration 0".
            times: s, any shape.

        Returns:
            The values, in their unit (m, m/s, m/s^2, N); NaN outside ``[0, time_reached]``.

        Raises:
            ValueError: For another name, for a batch, and for what is no coordinate with a `Regularized` method.

        >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
        >>> one = ss.simulate(system, ss.Constant(0.0), t1=10.0, y0=(1.0, 0.0))
        >>> print(f"{one.response('acceleration', 0.0):.4f} m/s^2, {one.peak('base shear'):.4f} N")
        -3.5000 m/s^2, 3.5000 N
        """
        form, times = self._form_of(name), self._checked(times)
        path = self._in_steps("response") if is_observed(form, len(self.final_state)) else self._path
        return self._at(partial(_responses, path, form, self.time_reached), times)

    def residual(self, coordinate: str | None = None) -> FloatArray:
        """The value of a coordinate, or of the difference of two, at the end: `final_state` by name.

        Args:
            coordinate: Its name, or the difference of two, ``"position 2 - position 1"``; by default the first.

        Raises:
            ValueError: For another name, for a batch, and for what is no coordinate.
        """
        form = self._form_of(coordinate)
        if is_observed(form, len(self.final_state)):
            raise checks.refused("coordinate", "be a coordinate for a residual", coordinate)
        return of_form(form, self.final_state)

    @property
    def slip_path(self) -> FloatArray:
        """The length of the path slid in the contact until the end, there and back, m; of several (contacts,).

        Of contacts behind springs that of the slider. Raises ValueError as `energies`.
        """
        return self._sums("slip_path")

    @property
    def slip_reversals(self) -> IntArray:
        """How many slips go the other way than the slip before them; of several contacts (contacts,).

        Raises ValueError as `energies`.
        """
        return self._sums("reversals")

    @property
    def input_energy(self) -> FloatArray:
        """The energy that ground, base and external forces have supplied until the end, J.

        That of the ground's acceleration is relative to the ground. Raises ValueError as `energies`.
        """
        return self._sums("supplied")

    @property
    def friction_energy(self) -> FloatArray:
        """The energy that friction has dissipated until the end, in all contacts, J.

        Raises ValueError as `energies`.
        """
        return self._sums("friction")

    @property
    def damping_energy(self) -> FloatArray:
        """The energy that viscous damping has dissipated until the end, J. Raises ValueError as `energies`."""
        return self._sums("damping")

    def _sums(self, name: str) -> Array:
        self._require_one()
        sums = self._along_steps(name, Asked(sums=True))[1]
        assert sums is not None
        value, tracks = getattr(sums, name), self.system.tracks
        counted = 0 if tracks.contacts == 1 else tracks.counted
        return value if not value.ndim or counted in (None, -1) else value[counted]

    def _along_steps(self, call: str, asked: Asked) -> tuple[FloatArray, Sums | None]:
        path = self._in_steps(call)
        if not isinstance(path, StepPath):
            return path.along_steps(self.time_reached, asked)
        known, begun = path.model.without_memory(())[0], path.beginnings.t
        halves = halves_for(known.fastest_decay, jnp.max(jnp.append(begun[1:], self.time_reached) - begun))
        return _along_steps(path, self.time_reached, dataclasses.replace(asked, halves=halves))

    def _in_steps(self, call: str) -> MotionPath:
        """The path in time steps that end at all events, whose system has an energy."""
        require_energy_model(self.system.switched_model(None, None).without_memory(())[0], call)
        if not isinstance(self.method, Exact):
            raise ValueError(
                f"{call} needs a simulation with method=Exact(), but one with {checks.show(self.method)} was given."
            )
        path, last = self._path, self.time_reached
        if not isinstance(path, IntervalPath):
            return path
        # Steps end at each change of sign of the relative velocity, which intervals do not record.
        y0 = tuple(path.state(jnp.zeros_like(last)))
        return follow_steps(self.system, self.base, Exact(), self.t1, y0, last.dtype).path

    def to_pandas(self) -> "pandas.DataFrame":
        """The sticks as a table of pandas, one row each; names of columns include the units.

        The columns are those of `Ensemble.write_sticks` without the number of the sample:

        - `contact`, only of a system with several: the number of the contact, from 0;
        - `order`: 0 for a stick that begins at t = 0 (`is_initial_rest`), else from 1;
        - `start_s`, `end_s`, `duration_s`;
        - `position_m`, `slip_displacement_m`: of a `MotorCart` in rad, of a system of your own in the unit of its first
          `state_names`;
        - `is_initial_rest`, `ending`: the name of an `Ending`.

        ``Ensemble.from_sticks(table.assign(sample=0), t1=t1)`` makes an ensemble of it, with all statistics; tables of
        several trajectories are joined by ``pandas.concat``, each with a `sample` of its own.

        Raises:
            ValueError: For a batch, and inside ``jit``, ``vmap`` or ``grad``.
            ImportError: Without the extra ``tables``.
        """
        return table_of(self._stick_columns("to_pandas"))

    def to_xarray(self) -> "xarray.Dataset":
        """Sticks, slips and totals as an ``xarray.Dataset`` with units and long names.

        Sticks along ``stick`` and slips along ``slip``, named as those of `Ensemble.to_xarray`; the attributes say what
        was simulated and how.

        Raises:
            ValueError: For a batch, and inside ``jit``, ``vmap`` or ``grad``.
            ImportError: Without the extra ``study``.
        """
        self._require_numbers("to_xarray")
        slips, position = self.slips, self.system.stick_position
        mask = np.asarray(slips.mask)
        variables = {
            **stick_variables(*_in_order(self.sticks), position),
            **slip_variables(*(np.asarray(column)[mask] for column in (slips.start, slips.end, slips.censored))),
            "stick_count": variable((), np.asarray(self.sticks.count), "number of sticks"),
            "slip_count": variable((), np.asarray(slips.count), "number of slips"),
            "stick_time": variable((), np.asarray(self.stick_time), "total stick time", "s"),
            "near_grazing_count": variable(
                (), np.asarray(self.near_grazing_count), "number of events decided by round-off"
            ),
            "status": variable((), np.asarray(self.status), "whether the trajectory reached t1", **flags(Status)),
            "time_reached": variable((), np.asarray(self.time_reached), "where the simulation ended", "s"),
        }
        about = provenance(self.system, self.base, self.method, float(self.t1))
        return labeled_dataset(variables, {}, {**source(), **about})

    def write_sticks(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> FilePath:
        """Write the sticks as a table, one row each, with the columns of `to_pandas`.

        Args:
            path: A file name that ends in .csv or .parquet.
            overwrite: Whether to replace a file of that name. Until the table is whole, an older one stays.

        Returns:
            The path.

        Raises:
            ValueError: For another name, for a batch, and inside ``jit``, ``vmap`` or ``grad``.
            ImportError: Without the extra ``tables``.
            FileExistsError: Where a file of that name would be replaced.
            FileNotFoundError: For a folder that does not exist.
            OSError: Where it cannot be written.
        """
        return write_table(self._stick_columns("write_sticks"), path, overwrite)

    def _stick_columns(self, call: str) -> dict[str, np.ndarray]:
        self._require_numbers(call)
        return columns_of(self.sticks, self.system.stick_position)

    def _require_numbers(self, call: str) -> None:
        """Check that this is one trajectory with known numbers, which `call` asks for; warn if it did not finish."""
        if checks.holds_traced(self):
            raise ValueError(
                f"{call} needs numbers, but JAX is tracing this simulation; return it from the function that jit, vmap "
                f"or grad transforms, and call {call} on what comes back."
            )
        if np.ndim(self.status) > 0:
            raise ValueError(
                f"{call} is for one simulation, but this is a batch of {np.shape(self.status)} simulations; make an "
                "ensemble of it, Ensemble.from_simulations(result), which has to_xarray and write_sticks, or take one "
                "out: jax.tree.map(lambda leaf: leaf[0], result)."
            )
        status = Status(int(self.status))
        if status != Status.FINISHED:
            warnings.warn(
                f"This simulation did not finish: it stopped at {float(self.time_reached):g} of {float(self.t1):g} s, "
                f"because {status.meaning}; {call} gives the sticks until there.",
                RuntimeWarning,
                stacklevel=4,
            )

    def _at(self, compute: Callable[..., T], times: Array, *along: Array) -> T:
        """What `compute` gives at times (n,) and values `along` them, at these `times` of any shape.

        Few numbers of times are compiled.
        """
        shape, given = times.shape, [values.reshape(-1) for values in (times, *along)]
        if is_compiling() or checks.holds_traced(self, times):
            return jax.tree.map(lambda values: values.reshape(shape + values.shape[1:]), compute(*given))
        size, given = times.size, [np.asarray(values) for values in given]
        room = next((room for room in _ROOMS if size <= room), _ROOMS[-1])
        parts = [[values[at : at + room] for values in given] for at in range(0, max(size, 1), room)]
        # `device_put`, since ``jnp.asarray`` compiles a program for each new shape.
        found = [compute(*(jax.device_put(np.resize(values, room)) for values in part)) for part in parts]

        def whole(*values: Array) -> Array:
            joined = np.concatenate([np.asarray(part) for part in values])[:size]
            return jax.device_put(joined.reshape(shape + joined.shape[1:]))

        return jax.tree.map(whole, *found)

    def _checked(self, times: AnyArray | float) -> Array:
        checks.numeric("times", times, ndim=None)
        self._require_one()
        dtype = self.sticks.start.dtype
        return jnp.asarray(times, dtype) if is_compiling() else jax.device_put(np.asarray(times, dtype))

    def _require_one(self) -> None:
        if np.ndim(self.status) > 0:
            raise ValueError(
                f"This is a batch of {np.shape(self.status)} simulations; evaluate one, or jax.vmap over them."
            )

    def _repr_html_(self) -> str | None:
        if not self._is_one or self.sticks.contact is not None:
            return None  # then __repr__ is shown
        status = Status(int(self.status))
        rows = [
            ("system", type(self.system).__name__),
            ("base", type(self.base).__name__),
            ("method", str(self.method)),
            ("status", status.meaning),
            ("sticks", f"{int(self.sticks.count):,}"),
            ("slips", f"{int(self.slips.count):,}"),
            ("total stick time", f"{float(self.stick_time):.6g} s"),
            ("stick fraction", f"{float(self.stick_time) / float(self.t1):.6g}"),
            ("near-grazing instants", f"{int(self.near_grazing_count):,}"),
        ]
        title, reached = f"Simulation on [0, {float(self.t1):g}] s", float(self.time_reached)
        title += "" if status == Status.FINISHED else f", NOT FINISHED: stopped at {reached:g} s"
        return html.titled(title) + html.table(rows) + (html.small_figure(self) if reached > 0 else "")

    @property
    def _is_one(self) -> bool:
        """Whether this is a single trajectory, which JAX does not trace."""
        return np.ndim(self.status) == 0 and not checks.holds_traced(self)

    def __repr__(self) -> str:
        checks.require_threads_of_jax()
        if not self._is_one:
            return f"Simulation(status={self.status}, sticks={self.sticks!r})"
        status = Status(int(self.status))
        if status != Status.FINISHED:
            reached, t1 = float(self.time_reached), float(self.t1)
            why = f"stopped at {reached:g} of {t1:g} s, because {status.meaning}"
            if status == Status.OUT_OF_STEPS and self.method.max_steps and reached > 0:
                # Steps are taken in blocks of `CHECK_EVERY`.
                enough = padded_length(math.ceil(1.5 * max(self.method.max_steps, CHECK_EVERY) * t1 / reached))
                if enough <= MOST_STEPS:
                    method = f"ss.{type(self.method).__name__}(..., max_steps={enough})"
                    why += f"; at this pace method={method} is enough"
            return f"Simulation of {type(self.system).__name__}, NOT FINISHED: {why}"
        near = f", {int(self.near_grazing_count)} near-grazing" if self.near_grazing_count else ""
        if self.sticks.contact is not None:
            counts = shown_counts([int(count) for count in self.totals.sticks])
            return (
                f"Simulation of {type(self.system).__name__} on [0, {float(self.t1):g}] s: sticks of its contacts: "
                f"{counts}{near}, {status.meaning}"
            )
        fraction = 100 * float(self.stick_time) / float(self.t1)
        return (
            f"Simulation of {type(self.system).__name__} on [0, {float(self.t1):g}] s: "
            f"{int(self.sticks.count)} sticks, {int(self.slips.count)} slips{near}, "
            f"stick fraction {fraction:.4g} %, {status.meaning}"
        )


@kept_jit(static_argnames="form")
def _largest(one: Simulation, form: Form, sign: Scalar) -> FloatArray:
    """The largest value of `sign` times a `form` of the state."""
    return one._path.largest(form, sign, one.time_reached, one.final_state)


@kept_jit
def _along_steps(path: MotionPath, last: FloatArray, asked: Asked) -> tuple[FloatArray, Sums | None]:
    return path.along_steps(last, asked)


@kept_jit(static_argnames="form")
def _responses(path: MotionPath, form: Form, last: FloatArray, times: FloatArray) -> FloatArray:
    """The values of a `form`, (times,)."""

    def at(time: FloatArray) -> FloatArray:
        numbers = path.state(time)
        if is_observed(form, len(numbers)):
            numbers = path.with_observed(time)
        return jnp.where((time >= 0) & (time <= last), of_form(form, numbers), jnp.nan)

    return jax.vmap(at)(times)


@kept_jit(static_argnames="size")
def _evaluate(one: Simulation, times: FloatArray, *, size: int) -> tuple[FloatArray, ...] | FloatArray:
    """Each number (times,); many as one array (times, numbers): XLA would compute the motion anew for each of them."""

    def at(time):
        inside, numbers = (time >= 0) & (time <= one.time_reached), one._path.state(time)[:size]
        return jax.tree.map(
            lambda value: jnp.where(inside, value, jnp.nan),
            stacked(numbers, time.dtype) if size > MANY else numbers,
        )

    return jax.vmap(at)(times)


@kept_jit
def _base_velocities(path: MotionPath, times: FloatArray) -> FloatArray:
    return jax.vmap(path.base_velocity)(times)
