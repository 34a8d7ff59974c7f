"""How one trajectory among many is followed: what each engine of ensembles defines."""

import abc
import dataclasses
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import equinox as eqx

from ..._types import AnyArray, Array, BoolArray

Shared = TypeVar("Shared")  # what all steps of all samples share
Sample = TypeVar("Sample")  # the constants of a sample
Motion = TypeVar("Motion")  # its state of motion, which every step changes
Record = TypeVar("Record")  # what a step leaves: a `StickRecord`, or an object that holds one
Results = TypeVar("Results")  # of a sample


class SampleTotals(NamedTuple):
    """What is recorded of each sample: numbers of sticks and slips, total stick time (s), `Status` code, and number of
    near-grazing instants (see `Simulation`); one entry for each sample.

    Of a system with several contacts, an engine's first three are arrays (samples, tracks).
    """

    sticks: AnyArray
    slips: AnyArray
    stick_time: AnyArray
    status: AnyArray
    near_grazing_count: AnyArray

    def of_track(self, track: int | None) -> "SampleTotals":
        """Those of one track; all of them where there is one contact."""
        if track is None:
            return self
        sticks, slips, stick_time = (column[:, track] for column in (self.sticks, self.slips, self.stick_time))
        return SampleTotals(sticks, slips, stick_time, self.status, self.near_grazing_count)


class Engine(eqx.Module, Generic[Shared, Sample, Motion, Record, Results]):
    """How one lane is simulated step by step; a step is a time step, or a whole interval of the base."""

    looks_back: ClassVar[bool] = False
    """Whether `after_block` reads the records of the block."""

    @property
    def tracks(self) -> int | None:
        """Of a system with several contacts, how many of its results and records are of something that sticks: each
        contact, and all at once. None for one contact.
        """
        return None

    @property
    def compiles_natively(self) -> bool:
        """Whether its steps can be compiled into native loops."""
        return True

    def asked(self, quantities: tuple[str, ...]) -> "Engine":
        """The same engine, whose records hold these `quantities` of each stick; without them it computes none."""
        return dataclasses.replace(self, quantities=quantities)

    @abc.abstractmethod
    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Sample, Motion]:
        """The constants of the sample that `key_data` choose, and its motion at t = 0."""

    def columns(self, varying: tuple[AnyArray, ...]) -> tuple[AnyArray, ...]:
        """The varying leaves of all samples, from what `Job.varying` holds of them."""
        return varying

    def begin_varying(self, key_data: tuple[Array, Array], varying: tuple[Array, ...], dtype) -> tuple[Sample, Motion]:
        """As `begin`, for the sample with these `varying` leaves; none where samples differ in their key data only."""
        return self.begin(key_data, dtype)

    @abc.abstractmethod
    def shared(self, dtype) -> Shared:
        """Quantities that all steps of all samples share, computed once per block."""

    def draw(self, sample: Sample, number: Array, dtype) -> Any:
        """The random (or looked-up) numbers of step `number`; drawn for a whole block at once."""
        return None

    @abc.abstractmethod
    def step(self, shared: Shared, sample: Sample, motion: Motion, drawn: Any) -> tuple[Motion, Record]:
        """Take one step: returns the motion after it and its record."""

    def after_block(self, samples: Sample, motions: Motion, records: Record) -> Motion:
        """The motions of ALL lanes, corrected after a block with these records, (BLOCK, lanes)."""
        return motions

    @abc.abstractmethod
    def ended(self, motion: Motion, before: Motion) -> BoolArray:
        """Whether the sample has ended, for whatever reason; `before`: its motion a block ago."""

    @abc.abstractmethod
    def results(self, sample: Sample, motion: Motion) -> Results:
        """The results of one sample."""
