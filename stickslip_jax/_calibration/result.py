"""The result of a calibration."""

import dataclasses
import math

import numpy as np

from .._excitation.excitation import BaseMotion
from .._statistics.estimate import Estimate
from .._statistics.summary import wrapped
from .._statistics.verdicts import HypothesisTest
from .._systems.system import System
from .bounds import Bounds


@dataclasses.dataclass(frozen=True, repr=False)
class Calibration:
    """Numbers estimated from a record of motion by `calibrate`, with their errors.

    ``found["mu"]`` is the `Estimate` of a number, which can be computed with: estimates of one calibration know how
    they are correlated.

    - `estimates`: by name. The standard errors hold for white noise. That of a number that
      the record does not tell is infinite, and it is printed as not determined.
    - `covariance`: of the estimates in their order, (numbers, numbers), for white noise.
    - `covariance_by_blocks`: the same from the scatter of 40 parts of the record, which are taken as independent: for
      residuals that are not white.
    - `bounds`: the smallest and the largest value that the record allows, each with 95 % confidence by the profile of
      the likelihood, None where there is none, of each number on which the motion does not depend at its first guess,
      such as the friction coefficient of a mass that never slips, of each that is less than three standard errors
      away from a bound of its own, such as a damping near zero: its error is to one side there; and of each whose
      standard error does not tell how far it can go, because a slip appears within it, or because it is large. Static
      friction that is fitted together with kinetic friction has bounds of the difference, "mu_static - mu", up to ten
      standard errors away.
    - `system`, `base`: with the estimates in place; of a number that the record does not tell, its first guess.
    - `start`: the estimated state at the first measurement, by the names of the coordinates; None where `y0` was given,
      or where several windows were fitted.
    - `start_times` (s, (windows,)) and `start_states` (windows, coordinates): where the fitted motions begin.
    - `channels`: the names of what was measured. `times`: of the measurements, s, (times,).
    - `measured`, `fitted`, `residuals` (measured less fitted): (channels, times), in the channels' units, NaN where
      nothing was measured.
    - `units`: of the channels, "" where not known.
    - `noise`: standard deviation of each channel, by name; given, or estimated from the residuals.
    - `chi_squared`, `degrees_of_freedom`: the sum of squares of the standardised residuals, and what it should be near.
    - `whiteness`: a test of each channel's residuals, by name (Ljung and Box).
    - `converged`: whether the search did. `remarks`: what to know about the result, sentences.
    """

    estimates: dict[str, Estimate]
    covariance: np.ndarray
    covariance_by_blocks: np.ndarray
    bounds: dict[str, Bounds]
    system: System
    base: BaseMotion
    start: dict[str, Estimate] | None
    start_times: np.ndarray
    start_states: np.ndarray
    channels: tuple[str, ...]
    units: tuple[str, ...]
    times: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    noise: dict[str, float]
    noise_is_known: dict[str, bool]
    chi_squared: float
    degrees_of_freedom: int
    whiteness: dict[str, HypothesisTest]
    converged: bool
    remarks: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of one number."""
        return self.estimates[name]

    @property
    def residuals(self) -> np.ndarray:
        return self.measured - self.fitted

    @property
    def windows(self) -> int:
        """How many motions were fitted, each with a start of its own."""
        return len(self.start_times)

    def __repr__(self) -> str:
        number = np.count_nonzero(np.isfinite(self.measured))
        lines = [
            f"Calibration from {number:,} measurements over {np.ptp(self.times):g} s"
            + ("" if self.windows == 1 else f", in {self.windows} windows")
            + ("" if self.converged else ", NOT CONVERGED")
        ]
        for name, one in self.estimates.items():
            limits = self.bounds[name].in_words if name in self.bounds and math.isfinite(one.standard_error) else ""
            said = f" ({limits}, 95 % confidence each)" if limits else ""
            lines.append(f"  {name} = {one.without_name()}{said}")
        for name, bounds in self.bounds.items():
            if name not in self.estimates:  # a difference
                lines.append(f"  {name}: {bounds.in_words or 'no bounds'}, 95 % confidence each")
        for name in self.channels:
            kind = "given" if self.noise_is_known[name] else "estimated"
            test = self.whiteness[name]
            white = f"residuals white: p = {test.p_value:.2g}" if test.made else f"no test of residuals: {test.reason}"
            lines.append(f"  noise of {name}: {self.noise[name]:.3g} ({kind}), {white}")
        lines.append(f"  chi-squared {self.chi_squared:.1f} for {self.degrees_of_freedom} degrees of freedom")
        return "\n".join([*lines, *(wrapped(remark, "  ", "  ") for remark in self.remarks)])
