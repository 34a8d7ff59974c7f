"""Steady responses to harmonic forces, and their absence at the natural frequency of an undamped system."""

from typing import Any

import numpy as np

from .._excitation.smooth import Tones, added_up, angle
from .._numerics.elementary import sincos
from .._numerics.known import bounds_of, values_of
from .._types import FloatScalar, Number, Scalar, State

_RESONANCE = 1e-7  # relative distance of the frequencies below which the closed form loses all its digits


def steady_response(tones: Tones, mass: Scalar, stiffness: Scalar, damping: Scalar, t: FloatScalar) -> State:
    """Position (m) and velocity (m/s) of the steady vibration under harmonic forces of amplitude, frequency, phase."""

    def answer(amplitude, w, phase):
        elastic, viscous = stiffness - mass * w * w, damping * w
        gain = amplitude / (elastic * elastic + viscous * viscous)
        sine, cosine = sincos(angle(w, t, phase))
        return gain * (elastic * cosine + viscous * sine), gain * w * (viscous * cosine - elastic * sine)

    position, velocity = added_up(answer, tones)
    return position, velocity


def check_no_resonance(force: Any, omega: Scalar) -> None:
    """Raises ValueError for a harmonic `force` at the natural angular frequency `omega` (rad/s) of undamped motion:
    the closed form is the steady response, and there is none at resonance. Under vmap that of every sample is checked;
    raises NotKnown under jit.
    """
    if not force.is_harmonic:
        return
    frequencies = force.tones[1]
    if np.any(np.abs(values_of(frequencies - omega)) < _RESONANCE * values_of(omega)):
        raise ValueError(
            f"Argument force must not have the natural angular frequency of {_shown(omega)} rad/s where there is no "
            f"damping, but {_shown(frequencies)} rad/s was given; use method=Exact(solver=diffrax.Dopri8()), which "
            "needs no closed form."
        )


def _shown(value: Number) -> str:
    low, high = bounds_of(value)
    return f"{low:.9g}" if low == high else f"{low:.9g} to {high:.9g}"
