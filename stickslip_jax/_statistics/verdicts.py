"""Several hypothesis tests combined into one answer, with a bound on the probability of any false rejection."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from .. import _checks
from .summary import wrapped


@dataclasses.dataclass(frozen=True, repr=False)
class HypothesisTest:
    """One test of one hypothesis.

    - `name`: of the test, with the orders or bins it used. `statistic`: its value; the function that made the test says
      which statistic.
    - `p_value`: probability of a statistic at least as extreme if the hypothesis holds; NaN if there was no test.
    - `effect`: size of the deviation from the hypothesis, in the measure `effect_name`; unlike the p-value it does not
      shrink with the number of samples. `effect_error`: its standard error, NaN where none is given.
    - `sizes`: number of values, or pairs of values, in each group.
    - `reason`: why the test could not be made, else empty.
    - `parts`: the tests that this one combines; its p-value is then the smallest of theirs, adjusted by Holm's method.
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

    @property
    def smallest_p_value(self) -> float:
        """The smallest p-value of its `parts`, not adjusted; its own where it has none."""
        return min((part.p_value for part in self.parts), default=self.p_value)

    def line(self, adjusted: float | None = None) -> str:
        """The test on one line; `adjusted` is its p-value adjusted for all tests made with it."""
        if not self.made:
            return f"{self.name}: not made, {self.reason}"
        error = "" if math.isnan(self.effect_error) else f" +- {self.effect_error:.2g}"
        own = _shown(self.p_value)
        if self.parts:
            own = f"smallest {_shown(self.smallest_p_value)}, adjusted for its {len(self.parts)} tests {own}"
        together = "" if adjusted is None else f", adjusted for all tests {_shown(adjusted)}"
        return f"{self.name}: {own}{together}; {self.effect_name} {self.effect:.3g}{error}"

    def __repr__(self) -> str:
        return self.line()


@dataclasses.dataclass(frozen=True, repr=False)
class Verdict:
    """The answer to one question, by one or several tests.

    - `question`: in words. `significance`: largest probability that any test rejects a true hypothesis.
    - `tests`: in the order in which the docstring of the function names them.
    - `samples`: number of samples given. `values`: number of values of the quantity used.
    - `reason`: why nothing can be decided, else empty.
    - `remarks`: sentences on which values were used and which were left out.
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
        """The p-value of each test, adjusted by Holm's method (see `holm`); NaN for tests that could not be made."""
        return holm([test.p_value for test in self.tests])

    @property
    def p_value(self) -> float:
        """The smallest of the adjusted p-values; NaN if no test was made.

        It answers the question as a whole. Near 1 it says no more than that no test found anything: each test's own
        ``tests[i].p_value`` is what is spread evenly from 0 to 1 where the hypothesis holds.
        """
        return min((p for p in self.adjusted_p_values if not math.isnan(p)), default=math.nan)

    @property
    def rejected(self) -> bool | None:
        """True: rejected at this significance. False: no evidence against it. None: not decided, for `reason`."""
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
        told = [wrapped(row, "  ", "    ") for row in (*rows, *self.remarks)]
        return "\n".join([wrapped(f"{self.question} {answer}", "", "    "), *told])


def _shown(p_value: float) -> str:
    return "p < 1e-300" if p_value < 1e-300 else f"p = {p_value:.2g}"


def holm(p_values: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    """P-values adjusted for several tests: rejecting those up to ``a`` is wrong with probability at most ``a``.

    Holm's method (1979, Scandinavian Journal of Statistics 6, 65): the i-th smallest of n p-values is multiplied by
    n - i + 1, and is at least as large as the adjusted one before it.

    Args:
        p_values: Numbers in [0, 1]; NaN (no test) stays NaN.
    """
    given = np.array(p_values, float)
    adjusted = np.full(given.shape, np.nan)
    order = np.argsort(given)[: np.count_nonzero(~np.isnan(given))]  # NaN are sorted to the end
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * given[order]), 1)
    return tuple(float(p) for p in adjusted)


def check_significance(significance: float) -> None:
    """Raise ValueError unless `significance` is a number between 0 and 1."""
    _checks.numeric("significance", significance)
    if not 0 < significance < 1:
        raise ValueError(f"Argument significance must lie between 0 and 1, but {_checks.show(significance)} was given.")
