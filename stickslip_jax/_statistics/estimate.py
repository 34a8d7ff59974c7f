"""A number estimated from samples, with its error."""

import dataclasses
import math

from .. import _checks


@dataclasses.dataclass(frozen=True)
class Estimate:
    """An estimate: its value and standard error (one standard deviation), both in `unit`.

    `samples`: the number of independent samples it is from. A value or error that these do not determine is NaN.
    """

    name: str
    value: float
    standard_error: float
    unit: str
    samples: int

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Confidence interval at `level`, by Student's t with ``samples - 1`` degrees of freedom; NaN without error.

        Raises ValueError unless ``0 < level < 1``.
        """
        check_level(level)
        if self.samples < 2 or math.isnan(self.standard_error):
            return math.nan, math.nan
        from scipy import special  # noqa: PLC0415 - adds a filter of warnings

        half_width = float(special.stdtrit(self.samples - 1, (1 + level) / 2)) * self.standard_error
        return self.value - half_width, self.value + half_width

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"{self.name}: not defined (no such event in {self.samples} samples)"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isnan(self.standard_error):
            why = "no error from one sample" if self.samples < 2 else "error not known"
            return f"{self.name}: {self.value:.6g}{unit} ({why})"
        return f"{self.name}: {format_with_error(self.value, self.standard_error)}{unit}"


def check_level(level: float) -> None:
    """Raise ValueError unless ``0 < level < 1``."""
    _checks.numeric("level", level)
    if not 0 < level < 1:
        raise ValueError(f"Argument level must lie between 0 and 1, such as 0.9, but {level} was given.")


def format_with_error(value: float, error: float) -> str:
    """``value +- error``, the error to two digits and the value to the same decimal place."""
    if not (math.isfinite(error) and error > 0 and math.isfinite(value)):
        return f"{value:.6g} +- {error:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(error)))
    if decimals > 9:
        return f"{value:.6g} +- {error:.2g}"
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"
