"""One simulated trajectory: `Simulation`."""

import os
import warnings
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import _checks, _html
from .._conventions import flags, variable
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.path import Path
from .._events.sticks import Slips, Sticks, Totals, of_contact, slips_between
from .._events.tables import table_of, write_table
from .._excitation.excitation import BaseMotion
from .._fields import with_fields
from .._forks import require_threads_of_jax
from .._methods import WithMethods
from .._status import Status
from .._systems.system import System
from .._types import AnyArray, FloatArray, Scalar
from .energy import Energies, energies_of, friction_force_of
from .labeled import columns_of, dataset_of, provenance

if TYPE_CHECKING:
    import pandas
    import xarray


class Simulation(WithMethods):
    """One simulated trajectory on ``[0, t1]``.

    Attributes:
        sticks: Every stick (`Sticks`).
        slips: Every slip (`Slips`).
        totals: The number of sticks (`sticks`), how many the horizon cut (`censored`), and their total time
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
            came to rest where friction could just hold it; or a jump of the base or the horizon came just before or
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
    _path: Path
    _of_all_contacts: tuple[Sticks, Totals] | None = None

    @property
    def slips(self) -> Slips:
        require_threads_of_jax()
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
            A simulation whose sticks and totals are those of this contact.

        Raises:
            ValueError: For a system with one contact, and for a number that is not one of its contacts.
        """
        if self.sticks.contact is None:
            raise ValueError("This system has one contact: its sticks are in simulation.sticks.")
        contacts = self.totals.sticks.shape[-1]
        _checks.whole_number("number", number, minimum=0, maximum=contacts - 1)
        parts = self.totals._replace(**{name: values[..., number] for name, values in self.totals._asdict().items()})
        return with_fields(
            self, type(self), sticks=of_contact(self.sticks, number), totals=parts, _of_all_contacts=None
        )

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
        require_threads_of_jax()
        return self.time_reached - self.totals.stick_time

    @property
    def stick_fraction(self) -> Float[Array, "*batch"]:
        require_threads_of_jax()
        return self.totals.stick_time / self.t1

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
        times = self._checked(times)
        return _evaluate(self, times, len(self.final_state))

    def base_velocity(self, times: AnyArray | float) -> FloatArray:
        """The base velocity at `times` (s, any shape), m/s; at a jump, the one after it. 0 for a `MotorCart`."""
        times = self._checked(times)
        return jax.vmap(self._path.base_velocity)(times.reshape(-1)).reshape(times.shape)

    def maximum(self, coordinate: str | None = None) -> FloatArray:
        """The largest value of a coordinate over ``[0, time_reached]``, as exact as the simulation: not on a grid.

        Where the motion is known in closed form, so is this: on an arc the position is largest where the velocity is 0.
        Elsewhere a zero of the slope is located inside each time step. Under ``jit`` and ``vmap`` as well, and with
        exact derivatives: that of the value at the instant of the maximum. (Where several maxima are equal, as on a
        periodic motion, it is that of one of them.)

        Args:
            coordinate: Its name, "position" or "velocity"; for a `MotorCart` "angle", "angular velocity" or "current".
                By default the first.

        Returns:
            The maximum, in the unit of the coordinate.

        Raises:
            ValueError: For another name, and for a batch.

        >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
        >>> one = ss.simulate(system, ss.Constant(1.0), t1=10.0, y0=(0.0, 1.0))
        >>> print(f"{one.maximum():.4f} m, {one.maximum('velocity'):.4f} m/s, {one.peak():.4f} m")
        0.7500 m, 1.0000 m/s, 0.7500 m
        """
        return _largest(self, self._number_of(coordinate), 1)

    def minimum(self, coordinate: str | None = None) -> FloatArray:
        """The smallest value of a coordinate over ``[0, time_reached]``; as `maximum`."""
        return -_largest(self, self._number_of(coordinate), -1)

    def peak(self, coordinate: str | None = None) -> FloatArray:
        """The largest absolute value of a coordinate over ``[0, time_reached]``; as `maximum`.

        ``one.peak("position")`` is the peak displacement.
        """
        number = self._number_of(coordinate)
        return jnp.maximum(_largest(self, number, 1), _largest(self, number, -1))

    def _number_of(self, coordinate: str | None) -> int:
        """The place of a coordinate in the state."""
        self._require_one()
        names = [one.name for one in self.system.coordinates]
        return 0 if coordinate is None else names.index(_checks.chosen("coordinate", coordinate, names))

    def friction_force(self, times: AnyArray | float) -> FloatArray:
        """The friction force on the mass at `times` (s, any shape), N: positive in the direction of positive velocity.

        In a slip it opposes the velocity relative to the base; in a stick it is what the stick needs (Lima and Sampaio
        2015, eqs 1 and 2). With `Regularized` it is the smoothed force. Of a `MotorCart` it is the force on the cart,
        in the direction of ``eccentricity cos(angle)`` (Lima and Sampaio 2022, eq. 4). It jumps at events; there it is
        that of the stick or slip that follows.

        Args:
            times: s, any shape.

        Returns:
            The force, N; NaN outside ``[0, time_reached]``.

        Raises:
            ValueError: For a `SwitchedSystem`, and for a batch.
        """
        return friction_force_of(self, self._checked(times))

    def energies(self, times: AnyArray | float) -> Energies:
        """Stored, supplied and dissipated energies at `times` (s, any shape), J: an `Energies`.

        Integrals of the powers over each time step, by Gauss's rule with 8 points.
        Where the motion is known in closed form over whole intervals, it is followed again in time steps for this.

        Args:
            times: s, any shape.

        Returns:
            The energies, J; NaN outside ``[0, time_reached]``.

        Raises:
            ValueError: For a `SwitchedSystem`, a `Regularized` method, a `MotorCart` with the printed equation, a
                batch, and under ``jit`` where `t1` is traced.
        """
        return energies_of(self, self._checked(times))

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
        totals = {
            "stick_count": variable((), np.asarray(self.sticks.count), "number of sticks"),
            "slip_count": variable((), np.asarray(self.slips.count), "number of slips"),
            "stick_time": variable((), np.asarray(self.stick_time), "total stick time", "s"),
            "near_grazing_count": variable(
                (), np.asarray(self.near_grazing_count), "number of events decided by round-off"
            ),
            "status": variable((), np.asarray(self.status), "whether the trajectory reached t1", **flags(Status)),
            "time_reached": variable((), np.asarray(self.time_reached), "where the simulation ended", "s"),
        }
        about = provenance(self.system, self.base, self.method, float(self.t1))
        return dataset_of(self.sticks, self.slips, self.system.stick_position, totals, about)

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
        if _checks.holds_traced(self):
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

    def _checked(self, times: AnyArray | float) -> Array:
        _checks.numeric("times", times, ndim=None)
        self._require_one()
        return jnp.asarray(times, self.sticks.start.dtype)

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
            ("stick fraction", f"{float(self.stick_fraction):.6g}"),
            ("near-grazing instants", f"{int(self.near_grazing_count):,}"),
        ]
        title = f"Simulation on [0, {float(self.t1):g}] s"
        if status != Status.FINISHED:
            reached = f", NOT FINISHED: stopped at {float(self.time_reached):g} s"
            return _html.titled(title + reached) + _html.table(rows)
        return _html.titled(title) + _html.table(rows) + _html.small_figure(self)

    @property
    def _is_one(self) -> bool:
        """Whether this is a single trajectory, which JAX does not trace."""
        return np.ndim(self.status) == 0 and not _checks.holds_traced(self)

    def __repr__(self) -> str:
        require_threads_of_jax()
        if not self._is_one:
            return f"Simulation(status={self.status}, sticks={self.sticks!r})"
        status = Status(int(self.status))
        if status != Status.FINISHED:
            stopped = f"stopped at {float(self.time_reached):g} of {float(self.t1):g} s"
            return f"Simulation of {type(self.system).__name__}, NOT FINISHED: {stopped}, because {status.meaning}"
        near = f", {int(self.near_grazing_count)} near-grazing" if self.near_grazing_count else ""
        if self.sticks.contact is not None:
            counts = ", ".join(str(int(count)) for count in self.totals.sticks)
            return (
                f"Simulation of {type(self.system).__name__} on [0, {float(self.t1):g}] s: sticks of its contacts: "
                f"{counts}{near}, {status.meaning}"
            )
        fraction = 100 * float(self.stick_fraction)
        return (
            f"Simulation of {type(self.system).__name__} on [0, {float(self.t1):g}] s: "
            f"{int(self.sticks.count)} sticks, {int(self.slips.count)} slips{near}, "
            f"stick fraction {fraction:.4g} %, {status.meaning}"
        )


@partial(jax.jit, static_argnums=1)
def _largest(one: Simulation, number: int, sign: Scalar) -> FloatArray:
    """The largest value of `sign` times one number of the state."""
    return one._path.largest(number, sign, one.time_reached, one.final_state[number])


@partial(jax.jit, static_argnums=2)
def _evaluate(one: Simulation, times: FloatArray, size: int) -> tuple[FloatArray, ...]:
    def at(time):
        inside = (time >= 0) & (time <= one.time_reached)
        return tuple(jnp.where(inside, value, jnp.nan) for value in one._path.state(time))

    states = jax.vmap(at)(times.reshape(-1))
    return tuple(value.reshape(times.shape) for value in states[:size])
