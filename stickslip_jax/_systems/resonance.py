"""Forces at the natural frequency of an undamped system."""

import numpy as np

from .._excitation.smooth import Harmonic, Signal, SumOfHarmonics

_RESONANCE = 1e-7  # relative distance of the frequencies below which the closed form loses all its digits


def check_no_resonance(force: Signal, omega: float) -> None:
    """Raises ValueError for a harmonic `force` at the natural angular frequency `omega` (rad/s) of undamped motion:
    the closed form is the steady response, and there is none at resonance.
    """
    if not isinstance(force, (Harmonic, SumOfHarmonics)):
        return
    frequencies = force.angular_frequency if isinstance(force, Harmonic) else force.angular_frequencies
    for w in np.atleast_1d(np.asarray(frequencies)):
        if abs(w - omega) < _RESONANCE * omega:
            raise ValueError(
                f"Argument force must not have the natural angular frequency of {omega:.6g} rad/s where there is no "
                f"damping, but {w:.9g} rad/s was given; use method=Exact(solver=diffrax.Dopri8()), which needs no "
                "closed form."
            )
