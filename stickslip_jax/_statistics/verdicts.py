"""Hypothesis tests gathered into one plain answer, with the chance of a false alarm kept over all of them."""

import dataclasses
import math
from typing import Any

import numpy as np

from .. import _checks


@dataclasses.dataclass(frozen=True, repr=False)
class HypothesisTest:
    """One test of one hypothesis.

    - `name`: of the test and what it looked at. `statistic`: its value; what it is stands with the function that tests.
    - `p_value`: chance of a statistic at least as extreme if the hypothesis holds. NaN if the test could not be made.
    - `effect`: how far from the hypothesis, whatever the number of samples; `effect_name` says in which measure.
    - `effect_error`: the effect's standard error, NaN where none is given.
    - `sizes`: how many values, or pairs of values, each group has.
    - `reason`: why the test could not be made, else empty.
    - `parts`: the tests of which this one is made (its p-value is then the smallest of theirs after Holm's rule).
    """

    name: str
    statistic: float = math.nan
    p_value: float = math.nan
    effect: float = math.nan
    effect_name: str = ""
    effect_error: float = math.nan
    sizes: tuple[int, ...] = ()
    reason: str = ""
    parts: "tuple[HypothesisTest, ...]" = ()

    @property
    def made(self) -> bool:
        """Whether there is a p-value."""
        return not math.isnan(self.p_value)

    def line(self, adjusted: float | None = None) -> str:
        """The test on one line; `adjusted` is its p-value with regard to all tests made along with it."""
        if not self.made:
            return f"{self.name}: not made, {self.reason}"
        together = "" if adjusted is None else f" (with regard to all tests {_shown(adjusted)})"
        error = "" if math.isnan(self.effect_error) else f" +- {self.effect_error:.2g}"
        return f"{self.name}: {_shown(self.p_value)}{together}, {self.effect_name} {self.effect:.3g}{error}"

    def __repr__(self) -> str:
        return self.line()


@dataclasses.dataclass(frozen=True, repr=False)
class Verdict:
    """The answer to one question, by one or several tests.

    - `question`: in words. `significance`: the largest chance of rejecting what is true, over all tests together.
    - `tests`: those tried, in the order in which the function that asks the question names them.
    - `samples`: how many samples were given. `values`: how many values of the quantity were used.
    - `reason`: why nothing can be decided, else empty.
    - `remarks`: sentences on what was used and what was left out.
    """

    question: str
    significance: float
    tests: tuple[HypothesisTest, ...]
    samples: int
    values: int
    reason: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def adjusted_p_values(self) -> tuple[float, ...]:
        """The p-value of each test by Holm's rule (see `holm`); NaN for those not made."""
        return holm([test.p_value for test in self.tests])

    @property
    def p_value(self) -> float:
        """The smallest of the adjusted p-values; NaN if no test was made."""
        return min((p for p in self.adjusted_p_values if not math.isnan(p)), default=math.nan)

    @property
    def rejected(self) -> bool | None:
        """True: no, at this significance. False: no evidence against it. None: not decided, for `reason`."""
        if self.p_value <= self.significance:
            return True
        return None if self.reason else False

    def __repr__(self) -> str:
        level = f"at the {100 * self.significance:g} % level"
        answers = {
            True: f"Rejected {level}.",
            False: f"No evidence against it {level}.",
            None: f"Not decided: {self.reason}.",
        }
        answer = answers[self.rejected]
        rows = [test.line(p) for test, p in zip(self.tests, self.adjusted_p_values, strict=True)]
        return "\n".join([f"{self.question} {answer}", *(f"  {row}" for row in (*rows, *self.remarks))])


def _shown(p_value: float) -> str:
    return "p < 1e-300" if p_value < 1e-300 else f"p = {p_value:.2g}"


def holm(p_values: Any) -> tuple[float, ...]:
    """Adjusted p-values of several tests: rejecting those at most ``a`` has a total false-alarm rate of at most ``a``.

    `p_values` is a sequence of numbers in [0, 1], of which NaN (no test) stay NaN. Holm 1979, Scandinavian Journal of
    Statistics 6, 65: the i-th smallest of n is multiplied by n - i + 1, and none is smaller than one before it.
    """
    given = np.array(p_values, float)
    adjusted = np.full(given.shape, np.nan)
    order = np.argsort(given)[: np.count_nonzero(~np.isnan(given))]  # NaN are sorted to the end
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * given[order]), 1)
    return tuple(float(p) for p in adjusted)


def check_significance(significance: Any) -> None:
    """Raise ValueError unless `significance` is a number between 0 and 1."""
    _checks.numeric("significance", significance)
    if not 0 < significance < 1:
        raise ValueError(f"Argument significance must lie between 0 and 1, but {_checks.show(significance)} was given.")
