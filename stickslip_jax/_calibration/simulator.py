"""`stick_simulator`: from parameters to summaries of the sticks, for inference that needs no likelihood."""

import dataclasses
import warnings
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.validation import check_method
from .._ensemble.call import simulate_ensemble
from .._ensemble.result import Ensemble
from .._ensemble.setup import MOST_SAMPLES
from .._excitation.excitation import BaseMotion
from .._status import Status
from .._systems.system import System
from .._types import Array, InitialState
from .._uncertainty.numbers import matching, numbers_in
from .._uncertainty.value_designs import table
from .stick_parameters import checked_model

Summaries = Callable[[Ensemble], npt.ArrayLike]


@dataclasses.dataclass(frozen=True, eq=False)
class StickSimulator:
    """A function of parameters and a key; see `stick_simulator`, which makes it.

    - `system`, `law`, `t1` (s), `y0`, `method`: what is simulated.
    - `wrt`: the names of the parameters, in the order of their columns.
    - `realizations`: how many each row's summaries are the mean of.
    - `summaries`: the function that makes them; None for the number of sticks and the total stick time (s).
    - `threads`: worker threads, None for all cores.
    """

    system: System
    law: BaseMotion
    wrt: tuple[str, ...]
    t1: float
    y0: InitialState | None
    method: Exact | Regularized
    realizations: int
    summaries: Summaries | None
    threads: int | None

    def __call__(self, parameters: npt.ArrayLike, key: Array | None) -> np.ndarray:
        """The summaries of each row of `parameters` (batch, parameters), simulated with `key`: (batch, summaries).

        Row i uses the realisations ``i * realizations``, ... that `key` draws (None where nothing is random): give each
        batch a key of its own. Rows of which a realisation did not reach `t1` are NaN, and a warning says how many.

        Raises:
            ValueError: For another shape, and for numbers that are not finite or outside the bounds of their fields.
        """
        rows = _checks.numbers("parameters", parameters)
        if rows.ndim != 2 or rows.shape[1] != len(self.wrt) or not len(rows):
            demand = f"be an array (batch, {len(self.wrt)}) with a column for each of {', '.join(self.wrt)}"
            raise _checks.refused("parameters", demand, f"an array of shape {rows.shape}")
        number = self.realizations
        many = simulate_ensemble(
            self.system, self.law, t1=self.t1, samples=table(np.repeat(rows, number, axis=0), self.wrt), key=key,
            y0=self.y0, method=self.method, keep="totals" if self.summaries is None else "sticks",
            threads=self.threads, progress=False,
        )  # fmt: skip
        found = self._summaries_of(many)
        finished = np.all(np.equal(many.totals.status, Status.FINISHED).reshape(-1, number), axis=1)
        means = np.mean(found.reshape(len(rows), number, -1), axis=1)
        if not np.all(finished):
            means[~finished] = np.nan
            warnings.warn(
                f"{np.count_nonzero(~finished)} of {len(rows)} rows did not reach t1 = {self.t1:g} s and are NaN; see "
                "the status of simulate with these numbers.",
                RuntimeWarning,
                stacklevel=2,
            )
        return means

    def _summaries_of(self, many: Ensemble) -> np.ndarray:
        """Of each sample, (samples, summaries)."""
        if self.summaries is None:
            return np.column_stack([many.totals.sticks, many.totals.stick_time])
        found = np.asarray(self.summaries(many), float)
        if found.ndim != 2 or len(found) != many.samples:
            raise ValueError(
                f"Argument summaries must return an array ({many.samples}, summaries), a row for each sample of the "
                f"ensemble, but one of shape {found.shape} was returned."
            )
        return found


def stick_simulator(
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    y0: InitialState | None = None,
    realizations: int = 1,
    summaries: Summaries | None = None,
    method: Exact | Regularized = EXACT,
    threads: int | None = None,
) -> StickSimulator:
    """A simulator of the sticks of many parameters at once, as tools for likelihood-free inference take it.

    ``simulator(parameters, key)`` takes an array (batch, parameters), or what NumPy makes one of, such as a tensor of
    PyTorch, and returns an array (batch, summaries). All rows are simulated side by side, each with random numbers of
    its own: approximate Bayesian computation with a million rows takes seconds (docs/howto/posteriors.md).

    Args:
        system: The system; the numbers that `wrt` names are replaced.
        law: A random excitation, as for `simulate_ensemble`.
        wrt: The names of the parameters, in the order of the columns: those of fields of the system or the law, such as
            "mu" or "rate", and "y0[0]", "y0[1]".
        t1: Duration, s.
        y0: Initial state, as for `simulate_ensemble`.
        realizations: Of each row, independent of each other; its summaries are their mean. As many as recordings were
            made.
        summaries: A function of the `Ensemble` of all samples, with all their sticks, to an array (samples, summaries);
            it must give each row by the sample's own sticks. By default the number of sticks and the total stick time
            (s) of each sample: the fastest, as no stick is kept.
        method: As for `simulate_ensemble`.
        threads: Worker threads (default: all cores).

    Returns:
        A `StickSimulator`.

    Raises:
        ValueError: For arguments outside these bounds, by the first call where they are those of `simulate_ensemble`.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> simulator = ss.stick_simulator(
    ...     system, law, wrt=("mu", "rate"), t1=50.0, realizations=100
    ... )
    >>> print(simulator([[0.5, 1.0], [1.5, 1.0]], jax.random.key(0)).round(2))
    [[ 6.22  0.83]
     [18.25  6.82]]
    """
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, (tuple, list)) else ()
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise _checks.refused("wrt", "be a parameter's name or several different ones", wrt)
    check_method(method)
    known = [path for path, _ in numbers_in(checked_model(system, law, y0)._asdict(), whole=True)]
    for name in names:
        matching("wrt", name, known)
    _checks.positive("t1", t1, "s")
    number = _checks.whole_number("realizations", realizations, maximum=MOST_SAMPLES)
    if threads is not None:
        _checks.whole_number("threads", threads)
    if summaries is not None and not callable(summaries):
        raise _checks.refused("summaries", "be a function of an Ensemble, or None", summaries)
    return StickSimulator(system, law, names, float(t1), y0, method, number, summaries, threads)
