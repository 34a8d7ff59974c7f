"""Random signals, among them random phases."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._fields import Checked
from .._numerics.random_bits import key_data_of, random_words, uniform
from .._types import Array, KeyData, Scalar
from .motion import Motion
from .smooth import Harmonic, Signal, SumOfHarmonics
from .voltage import SourceVoltage

_FIRST_PHASE = 0xFFFFFF00  # number of the random word that the first phase is drawn from


class RandomSignal(Checked, Motion):
    """Base class of smooth random functions of time: each realisation is a `Signal`."""

    is_random = True
    rests_on: ClassVar = {"shortest_period": ("realized",)}

    @abc.abstractmethod
    def realized(self, key_data: KeyData, dtype) -> Signal:
        """The realisation drawn by `key_data`."""

    @property
    def shortest_period(self) -> Scalar | None:
        """The period (s) of the fastest oscillation of any realisation, as that of a `Signal`."""
        return None

    def sample(self, key: Array, t1: Scalar | None = None) -> Signal:
        """The realisation drawn by `key`, from ``jax.random.key(seed)``; it has no end, and `t1` is not used."""
        return self.realized(key_data_of(key), jnp.result_type(float))


class RandomPhase(RandomSignal):
    """A signal whose phase is uniform on ``[0, 2 pi]``; each harmonic of a sum has its own, independent of the others.

    Args:
        signal: A `Harmonic`, a `SumOfHarmonics` or a `SourceVoltage` (Lima and Sampaio 2022, section 6); its phases are
            not used.

    Raises:
        ValueError: For anything else.
    """

    signal: Signal

    def check_relations(self) -> None:
        if not isinstance(self.signal, (Harmonic, SumOfHarmonics, SourceVoltage)):
            raise _checks.refused("signal", "be a Harmonic, a SumOfHarmonics or a SourceVoltage", self.signal)

    @property
    def shortest_period(self) -> Scalar | None:
        return self.signal.shortest_period

    def realized(self, key_data: KeyData, dtype) -> Signal:
        """The signal with phases drawn by `key_data`."""
        if isinstance(self.signal, SumOfHarmonics):
            first = jnp.asarray(_FIRST_PHASE, jnp.uint32)
            numbers = first + jnp.arange(len(self.signal.amplitudes), dtype=jnp.uint32)
            phases = _angle(random_words(key_data, numbers)[0], dtype)
            return eqx.tree_at(lambda signal: signal.phases, self.signal, phases, is_leaf=lambda leaf: leaf is None)
        phase = _angle(random_words(key_data, jnp.asarray(_FIRST_PHASE, jnp.uint32))[0], dtype)
        return eqx.tree_at(lambda signal: signal.phase, self.signal, phase)


def _angle(key_data: Array, dtype) -> Array:
    return 2 * np.pi * uniform(key_data, dtype)
