"""`simulate_ensemble` and `simulate_contacts`: many samples in chunks and threads, with streaming statistics;
`concatenate` and `load`.
"""

import dataclasses
import itertools
import os
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Array

from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.simulate import Output, Outputs, checked_outputs
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.processes import require_threads_of_jax
from .._foundation.types import InitialState, Status
from .._statistics.quantities import Numbering
from .._systems.system import System, WithContacts
from .._uncertainty.design import Design
from .._uncertainty.inputs import GaussianCopula, StochasticModel
from .data import Fields, Keep, Origin, Realization, Unknown, UnknownSystem, same_object
from .dataset import fields_of_file
from .parts import EnsembleAccumulator
from .result import Ensemble
from .setup import NO_OUTPUTS, TAKEN, EnsembleSetup, fields_of_outputs, found_by, found_here

# `simulate_ensemble`: many samples of a random excitation, in chunks and threads, with streamed statistics.


def simulate_ensemble(
    system: System,
    law: BaseMotion,
    *,
    t1: float,
    samples: int | Design,
    key: Array | None = None,
    correlation: GaussianCopula | None = None,
    y0: InitialState | None = None,
    method: Exact | Regularized = EXACT,
    keep: Keep = "statistics",
    orders: int = 10,
    count_initial_rest: bool = False,
    threads: int | None = None,
    chunk: int | None = None,
    progress: bool | None = None,
    first_sample: int = 0,
    outputs: Outputs | None = None,
) -> Ensemble:
    """Simulate `samples` independent realisations of the excitation `law`.

    Sample i is ``simulate(system, law.sample(jax.random.fold_in(key, i), t1), ...)``, whatever the number of samples,
    the chunk size or the threads; ``system, base, y0 = many.realization(i)`` returns what it is simulated with. Any
    single number of `system`, `law` or `y0` may differ from sample to sample: an array (samples,), or a distribution
    (see docs/uncertain.md); ``many.input_values`` gives what was drawn.

    Args:
        system: A `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own.
        law: A random excitation, any that `simulate` takes, or an object with ``sample(key, t1)`` that returns one.
        t1: Duration, s.
        samples: Their number, or a design (`stickslip_jax.design`) with a row for each.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        correlation: Of random numbers; by default they are independent.
        y0: Initial state as in `simulate`, or an array (samples, coordinates).
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        keep: "totals" (fastest): ``many.totals`` of each sample, and their statistics; "statistics": all of these, in
            memory that does not grow with `samples`; "sticks" keeps every stick and the totals too.
        orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
        count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.
        threads: Worker threads (default: all cores).
        chunk: Samples simulated per call (default: chosen for speed).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        first_sample: The number i of the first, where several machines share one ensemble (see `concatenate`).
        outputs: Numbers of your own: a dict from names to functions of a `Simulation` that return one number, or to
            `Output` objects, which have a unit, such as ``{"peak": lambda one: one.peak("position")}``. For them every
            sample is simulated once more and recorded, batch by batch. ``many.outputs["peak"]`` is their distribution,
            ``many.output_values["peak"]`` the number of each sample.

    Returns:
        An `Ensemble`. Samples that did not reach ``t1`` are counted in ``many.status_counts`` and in no statistic.

    Raises:
        ValueError: For arguments outside these bounds.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)
    ... )
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> many = ss.simulate_ensemble(
    ...     system, law, t1=50.0, samples=1000, key=jax.random.key(0), y0=(0.0, 1.0)
    ... )
    >>> print(ss.mean_stick_duration(many))
    mean stick duration (pooled): 0.2540 +- 0.0011 s
    """
    require_threads_of_jax()
    numbering, model = Numbering.checked(orders, count_initial_rest), StochasticModel(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(model, t1, samples, first_sample, key, correlation, method, keep, numbering)
    samples, first = setup.inputs.samples - int(first_sample), int(first_sample)
    (found,) = found_by(setup, first, (EnsembleAccumulator(samples, keep),), threads, chunk, progress, wanted)
    return Ensemble(**setup.fields(), samples=samples, first_sample=first, **found, **fields_of_outputs(wanted))


def simulate_batch(
    setup: EnsembleSetup, first: int, samples: int, keep: Keep, *, retained: int, fewest: int,
    outputs: Mapping[str, Output] = NO_OUTPUTS,
) -> Ensemble:  # fmt: skip
    """Samples `first`, ``first + 1``, ... of a larger whole, simulated in this thread.

    `retained`: the most sticks that are retained for standard errors. `fewest`: of samples that any batch of the whole
    has; programs compiled for one batch fit all others with the same `fewest`.
    """
    found = found_here(setup, first, EnsembleAccumulator(samples, keep, retained), fewest, outputs)
    return Ensemble(**setup.fields(), samples=samples, first_sample=first, **found, **fields_of_outputs(outputs))


# `simulate_contacts`: many samples of a system with several contacts, with the statistics of each contact.


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class ContactEnsembles:
    """The result of `simulate_contacts`: an `Ensemble` for each contact, and one for all contacts at once.

    - `system`: as it was given. `contacts`: how many it has. `samples`: their number. `t1`: s.
    """

    system: System
    contacts: int
    _ensembles: tuple[Ensemble, ...]

    def of_contact(self, number: int) -> Ensemble:
        """The ensemble in which the sticks of one contact are counted, that of ``system.of_contact(number)``.

        Args:
            number: Of the contact, from 0.

        Raises:
            ValueError: For a number that is not one of its contacts.
        """
        return self._ensembles[checks.whole_number("number", number, minimum=0, maximum=self.contacts - 1)]

    def of_all_contacts(self) -> Ensemble:
        """The ensemble in which the times are counted when every closed contact sticks."""
        return self._ensembles[-1]

    @property
    def samples(self) -> int:
        """The number of samples."""
        return self._ensembles[0].samples

    @property
    def t1(self) -> float:
        """Their duration, s."""
        return self._ensembles[0].t1

    @property
    def status_counts(self) -> dict[Status, int]:
        """As of an `Ensemble`."""
        return self._ensembles[0].status_counts

    @property
    def near_grazing_samples(self) -> int:
        """As of an `Ensemble`."""
        return self._ensembles[0].near_grazing_samples

    @property
    def input_values(self) -> dict[str, np.ndarray]:
        """The values of the numbers that differ from sample to sample, by name, arrays (samples,)."""
        return self._ensembles[0].input_values

    def realization(self, number: int) -> Realization:
        """The system, the base motion and the initial state of sample `number`, with which `simulate` repeats it."""
        system, base, y0 = self._ensembles[0].realization(number)
        assert isinstance(system, WithContacts)
        return Realization(system._counting(None), base, y0)

    def __repr__(self) -> str:
        first, *lines = repr(dataclasses.replace(self._ensembles[0], system=self.system)).split("\n")
        counts = ", ".join(f"{_sticks(one):,}" for one in self._ensembles[:-1])
        found = f"  sticks    {counts} of the contacts, {_sticks(self._ensembles[-1]):,} of all at once"
        return "\n".join([first, *(found if line.startswith("  sticks") else line for line in lines)])


def _sticks(ensemble: Ensemble) -> int:
    return round(float(ensemble.moments.mean[1] * ensemble.moments.number))


def simulate_contacts(
    system: System,
    law: BaseMotion,
    *,
    t1: float,
    samples: int | Design,
    key: Array | None = None,
    correlation: GaussianCopula | None = None,
    y0: InitialState | None = None,
    method: Exact | Regularized = EXACT,
    keep: Keep = "statistics",
    orders: int = 10,
    count_initial_rest: bool = False,
    threads: int | None = None,
    chunk: int | None = None,
    progress: bool | None = None,
    first_sample: int = 0,
    outputs: Outputs | None = None,
) -> ContactEnsembles:
    """Simulate many samples of a system with a list of contacts, and count the sticks of every contact.

    The samples are simulated once. ``many.of_contact(0)`` is the same `Ensemble` to the last bit as
    ``simulate_ensemble(system.of_contact(0), ...)``: statistics, tests, figures, files and tables take it.

    Args:
        system: A `LinearStructure`, or a `SwitchedSystem` of your own with `contacts`.
        law: As in `simulate_ensemble`.
        t1: As in `simulate_ensemble`.
        samples: As in `simulate_ensemble`.
        key: As in `simulate_ensemble`.
        correlation: As in `simulate_ensemble`.
        y0: As in `simulate_ensemble`.
        method: As in `simulate_ensemble`.
        keep: As in `simulate_ensemble`.
        orders: As in `simulate_ensemble`.
        count_initial_rest: As in `simulate_ensemble`.
        threads: As in `simulate_ensemble`.
        chunk: As in `simulate_ensemble`.
        progress: As in `simulate_ensemble`.
        first_sample: As in `simulate_ensemble`.
        outputs: As in `simulate_ensemble`.

    Returns:
        A `ContactEnsembles`.

    Raises:
        ValueError: For a system with one contact, and as `simulate_ensemble`.

    >>> row = ss.block_row(
    ...     2, mass=1.0, between=1.0, to_ground=0.5, normal_force=1.0, friction=ss.Coulomb(0.3)
    ... )
    >>> law = ss.PoissonSwitching(speed=0.5, rate=0.5)
    >>> many = ss.simulate_contacts(
    ...     row, law, t1=20.0, samples=200, key=jax.random.key(0), y0=(0.5, -0.5, 0.0, 0.0)
    ... )
    >>> print(ss.stick_fraction(many.of_contact(1)))
    stick fraction: 0.1151 +- 0.0048
    >>> print(ss.stick_fraction(many.of_all_contacts()))
    stick fraction: 0.0555 +- 0.0037
    """
    require_threads_of_jax()
    numbering, model = Numbering.checked(orders, count_initial_rest), StochasticModel(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(
        model, t1, samples, first_sample, key, correlation, method, keep, numbering, of_every_contact=True
    )
    if setup.tracks == (None,) or not isinstance(system, WithContacts):
        raise checks.refused("system", "have a list of contacts, of which all are counted", system)
    number, first = setup.inputs.samples - int(first_sample), int(first_sample)
    accumulators = [EnsembleAccumulator(number, keep) for _ in setup.tracks]
    found = found_by(setup, first, accumulators, threads, chunk, progress, wanted)
    contacts = len(setup.tracks) - 1
    counted = [*(system.of_contact(number) for number in range(contacts)), system.of_all_contacts()]
    shared: Fields = setup.fields() | {"samples": number, "first_sample": first} | fields_of_outputs(wanted)
    ensembles = [Ensemble(**{**shared, "system": one, **fields}) for one, fields in zip(counted, found, strict=True)]
    return ContactEnsembles(system, contacts, tuple(ensembles))


# `concatenate` joins ensembles, `load` reads one from a file.


def load(path: str | os.PathLike[str]) -> Ensemble:
    """Read an ensemble that `Ensemble.save` or ``stickslip study`` wrote.

    Args:
        path: The file, or the folder of a study.

    Returns:
        The `Ensemble` with the statistics it had, to the last bit; figures, ``realization(i)`` and ``extended`` work as
        before. Objects of your own classes (systems, laws, distributions) come back as stand-ins that hold their name
        and how they printed: statistics and figures of the sticks still work, what needs the object raises ValueError.

    Raises:
        FileNotFoundError: For a missing file.
        ValueError: For one that is damaged or cut short, of another program, or of a newer format.
        ImportError: Without the extra ``study``.
    """
    return Ensemble(**fields_of_file(checks.path("path", path, "a file name")))


def concatenate(ensembles: Sequence[Ensemble]) -> Ensemble:
    """Join ensembles into one, whose samples are those of the first, then of the second, and so on.

    Where samples follow each other (the same system, law, method, start and key, and ``first_sample`` of one is the
    number after the last of the one before), the result is that of one run. Otherwise `origins` holds where each part
    came from, and ``realization(i)`` looks there; what differs from part to part is `Unknown` in the result, so that it
    cannot be extended. Sticks and counts are those of the parts to the last bit; means and other sums differ from those
    of one run by round-off only, since they are merged from sums.

    Args:
        ensembles: At least one, of the same duration, `keep`, `orders`, `count_initial_rest`, dtype, and kind of
            position. Their systems, laws, keys, methods and starts may differ.

    Raises:
        ValueError: For anything else, and for parts that hold the same random samples twice.
    """
    if not isinstance(ensembles, Sequence) or not ensembles or not all(isinstance(one, Ensemble) for one in ensembles):
        raise checks.refused("ensembles", "be a list of results of simulate_ensemble", ensembles)
    for what, of in _SAME.items():
        for number, one in enumerate(ensembles):
            if of(one) != of(ensembles[0]):
                raise ValueError(
                    f"Argument ensembles must have the same {what}, but the first has {checks.show(of(ensembles[0]))} "
                    f"and ensembles[{number}] has {checks.show(of(one))}."
                )
    accumulator = EnsembleAccumulator(sum(one.samples for one in ensembles), ensembles[0].keep)
    for one in ensembles:
        accumulator.add_ensemble(one)
    origins = _joined([origin for one in ensembles for origin in one._origins])
    # What its origins give; `Unknown` for what differs among them.
    given: Fields = {**origins[0]._asdict(), "origins": ()}
    if len(origins) > 1:
        given |= {"origins": origins, "key_data": None, "first_sample": 0, "design": None, "copula": None}
        for name in ("system", "law", "method", "y0"):
            if not all(same_object(getattr(origin, name), given[name]) for origin in origins):
                unknown = Unknown(f"differs among the {len(origins)} parts")
                position = origins[0].system.stick_position
                stands_for = {"system": UnknownSystem(unknown.name, "", position), "y0": (unknown,)}
                given[name] = stands_for.get(name, unknown)
    functions, *others = (one.output_functions for one in ensembles)
    return Ensemble(
        t1=ensembles[0].t1,
        numbering=ensembles[0].numbering,
        dtype=ensembles[0].dtype,
        **{**given, "samples": accumulator.samples},
        **accumulator.found(),
        output_units=dict(ensembles[0].output_units),
        output_functions={
            name: function for name, function in functions.items() if all(one.get(name) is function for one in others)
        },
        threads=max(one.threads for one in ensembles),
        compile_seconds=sum(one.compile_seconds for one in ensembles),
        run_seconds=sum(one.run_seconds for one in ensembles),
    )


_SAME: dict[str, Callable[[Ensemble], object]] = {
    "duration t1": lambda one: one.t1,
    "keep": lambda one: one.keep,
    "numbering": lambda one: one.numbering,
    "dtype": lambda one: one.dtype,
    "names and units of outputs": lambda one: dict(sorted(one.output_units.items())),
    "contact whose sticks are counted": lambda one: getattr(one.system, "counted_contact", None),
    "unit and period of the position": lambda one: one.system.stick_position[1::2],
}
"""In what ensembles that are joined must be the same, in words."""


def _joined(origins: list[Origin]) -> tuple[Origin, ...]:
    """The origins, those that follow each other made one. Raises ValueError if one holds samples of another."""
    for one, other in itertools.combinations(origins, 2):
        apart = one.first_sample + one.samples <= other.first_sample
        apart = apart or other.first_sample + other.samples <= one.first_sample
        if one.key_data is not None and not apart and one.same_run(other):
            raise ValueError(
                "Argument ensembles must hold different samples, but two parts have the same key and samples "
                f"{max(one.first_sample, other.first_sample)} and on; simulate them with different keys, or with "
                "first_sample=... after one another."
            )
    joined = origins[:1]
    for origin in origins[1:]:
        last = joined[-1]
        if origin.follows(last):
            joined[-1] = last._replace(samples=last.samples + origin.samples)
        else:
            joined.append(origin)
    return tuple(joined)
