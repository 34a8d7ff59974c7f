"""`simulate_contacts`: many samples of a system with several contacts, with the statistics of each contact."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._simulation.outputs import Outputs, checked_outputs
from .._statistics.accumulator import Numbering
from .._status import Status
from .._systems.system import System
from .._systems.with_contacts import WithContacts
from .._types import Array, InitialState
from .._uncertainty.copula import GaussianCopula
from .._uncertainty.design import Design
from .._uncertainty.inputs import Model
from .call import found_by
from .data import Fields, Keep
from .origins import Realization
from .outputs import TAKEN, fields_of_outputs
from .parts import EnsembleAccumulator
from .result import Ensemble
from .setup import EnsembleSetup


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
        return self._ensembles[_checks.whole_number("number", number, minimum=0, maximum=self.contacts - 1)]

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
    numbering, model = Numbering.checked(orders, count_initial_rest), Model(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(
        model, t1, samples, first_sample, key, correlation, method, keep, numbering, of_every_contact=True
    )
    if setup.tracks == (None,) or not isinstance(system, WithContacts):
        raise _checks.refused("system", "have a list of contacts, of which all are counted", system)
    number, first = setup.inputs.samples - int(first_sample), int(first_sample)
    accumulators = [EnsembleAccumulator(number, keep) for _ in setup.tracks]
    found = found_by(setup, first, accumulators, threads, chunk, progress, wanted)
    contacts = len(setup.tracks) - 1
    shared: Fields = setup.fields() | {"samples": number, "first_sample": first} | fields_of_outputs(wanted)
    ensembles = [
        Ensemble(**{**shared, "system": counted, **fields})
        for counted, fields in zip(_counted(system, contacts), found, strict=True)
    ]
    return ContactEnsembles(system, contacts, tuple(ensembles))


def _counted(system: WithContacts, contacts: int) -> Sequence[WithContacts]:
    return [*(system.of_contact(number) for number in range(contacts)), system.of_all_contacts()]
