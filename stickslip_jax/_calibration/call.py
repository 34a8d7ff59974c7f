"""`calibrate`: numbers of a system and its base from a record of motion."""

import warnings
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.common.time_scales import slowest_time
from .._dynamics.common.validation import Arguments
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._systems.system import System
from .._types import InitialState
from .._uncertainty.numbers import Parameter, Path, parameters_of
from .asked import asked
from .problem import Sensor, Setting
from .record import Observer, Record
from .report import result_of
from .result import Calibration
from .search import Found, Search, as_one, fitted
from .transform import Transform, transform_of

_PERIODS = 2.0  # of the slowest known time scale, in a window
_FEWEST = 12  # measurements in a window
_MOST_WINDOWS = 128
_DELAYED, _DELAYED_TIME = 0.05, 0.25  # of the record, and of the slowest known time scale: the longest delay searched


def calibrate(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    *,
    wrt: str | tuple[str, ...] | list[str],
    noise: Mapping[str, float] | None = None,
    y0: InitialState | None = None,
    windows: int | None = None,
    observe: Mapping[str, Observer] | None = None,
    method: Exact | Regularized = EXACT,
) -> Calibration:
    """Estimate numbers of a system and its base from a record of motion, by maximum likelihood.

    The motion is simulated exactly, with exact derivatives; noise is independent, Gaussian, and of one standard
    deviation in each channel. Long records are cut into windows, in each of which the motion starts anew from a state
    that is estimated too (multiple shooting): one motion over the whole record would be far from it in the end, until
    the numbers are nearly right. From there one motion over the whole record is fitted, and is the result if the record
    allows it; chaotic motions, and those that something unknown disturbs, are left in windows.

    Args:
        system: With first guesses of the numbers.
        base: What drives it, as for `simulate`: a motion without randomness, measured ones as a `Recorded`.
        times: Of the measurements, s, increasing, from 0 on, (times,); they need not be equally spaced.
        measured: What was measured, (times,) each, NaN where it was not. By the names of the system's coordinates
            ("position" in m, "velocity" in m/s; "angle", "current", "position 2", ...), as "acceleration" (m/s^2;
            where a coordinate is called "velocity 2", "acceleration 2"), as "friction force" (N), or by the names in
            `observe`. Accelerations and friction forces jump where a stick begins or a slip reverses, and the search
            does not see how a jump moves past a measurement: set those next to jumps to NaN, and measure positions too.
        wrt: The names of the numbers to be estimated, as for `sensitivity`: those of fields of the system or the base,
            such as "mu" or "friction.forward.mu". They stay inside the bounds of these fields: positive ones are
            searched by their logarithms, those that may be zero are found there, and `mu_static` is never below `mu`.
            Of the sensors too: "clock.delay" (s) of the whole record, "position.delay" (s) and "position.offset" of a
            channel, which shows what it measures so much later, and so much more. Of the record so much is left out
            at both ends as a delay may be long: 5 % of it, or a quarter of the slowest known time scale.
        noise: The standard deviation of the noise of each channel, in its unit; of those left out it is estimated.
        y0: The state at t = 0, where it is known; it is estimated otherwise (None).
        windows: How many. By default as many as have two periods of the system's slowest known time scale, and then
            one, as said above. With several, `y0` is not used.
        observe: A function of simulation (a `Simulation`, which begins where its window does) and times (s, (times,))
            for each channel with a name of its own, in JAX.
        method: As for `simulate`. With `Regularized` there is one window, which begins at t = 0.

    Returns:
        The estimates, with their errors; print it. Warns (RuntimeWarning) with each of its remarks: of numbers that the
        record does not tell (their error is infinite), of numbers at their bounds, of residuals that are not white,
        with what may be wrong, and of a search that did not converge.

    Raises:
        ValueError: For arguments outside these bounds, for names that fit no number, for measurements that are all the
            same without their noise, and for a first guess from which
            no motion reaches the end of its window.

    >>> system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    >>> base = ss.Harmonic(0.8, 1.3)
    >>> times = jax.numpy.linspace(0.0, 9.9, 100)
    >>> seen = ss.simulate(system, base, t1=10.0, y0=(0.3, 0.0)).evaluate(times)[0]
    >>> guess = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
    >>> found = ss.calibrate(guess, base, times, {"position": seen}, wrt="mu")
    >>> print(f"mu = {found['mu'].value:.6f}")
    mu = 0.700000
    """
    require_threads_of_jax()
    search = _checked(system, base, times, measured, wrt, noise, y0, observe, method)
    if isinstance(method, Regularized) and windows not in (None, 1):
        raise _checks.refused("windows", "be 1 with the method Regularized", windows)
    number = (
        _usual_windows(search)
        if windows is None
        else _checks.whole_number("windows", windows, maximum=len(search.record.times))
    )
    found = fitted(search, search.cuts(number), np.zeros(len(search.parameters)))
    given_up = None
    if windows is None and found.problem.windows.begins.shape[0] > 1:
        whole = as_one(search, found)
        given_up = None if isinstance(whole, Found) else whole
        found = whole if isinstance(whole, Found) else found
    done = result_of(search.record, search.arguments, search.parameters, found, search.y0, given_up)
    for remark in done.remarks:
        warnings.warn(remark, RuntimeWarning, stacklevel=2)
    return done


def _checked(
    system: System,
    base: BaseMotion,
    times: npt.ArrayLike,
    measured: Mapping[str, npt.ArrayLike],
    wrt: object,
    noise: Mapping[str, float] | None,
    y0: InitialState | None,
    observe: Mapping[str, Observer] | None,
    method: Exact | Regularized,
) -> Search:
    arguments, start, record = asked(system, base, times, measured, noise, y0, observe, method)
    setting, parameters = _setting_and_parameters(arguments, record, wrt)
    transform = transform_of(setting, parameters)
    if setting.sensors:
        record, transform = _with_sensors(record, arguments, parameters, transform)
    for channel, row, sigma in zip(record.channels, record.values, record.noise, strict=True):
        if np.isnan(sigma) and not np.nanmax(row, initial=-np.inf) > np.nanmin(row, initial=np.inf):
            raise ValueError(
                f"Argument noise must give the standard deviation of {channel.name!r}, whose measurements are all the "
                f'same, so that it cannot be estimated: noise={{"{channel.name}": ...}}.'
            )
    return Search(record, arguments, parameters, transform, None if y0 is None else start, setting)


def _setting_and_parameters(arguments: Arguments, record: Record, wrt: object) -> tuple[Setting, tuple[Parameter, ...]]:
    """Where the numbers stand, and those named by `wrt`: of system and base, and offsets and delays."""
    own: dict[str, Path] = {"clock.delay": ("clock", "delay")}
    for i, channel in enumerate(record.channels):
        own |= {f"{channel.name}.{kind}": ("sensors", i, kind) for kind in ("delay", "offset")}
    where = {"system": arguments.system, "base": arguments.base}
    names = (wrt,) if isinstance(wrt, str) else wrt
    if not isinstance(names, (tuple, list)) or not any(name in own for name in names if isinstance(name, str)):
        return Setting(arguments.system, arguments.base), parameters_of(where, wrt)
    others = tuple(name for name in names if name not in own)
    if len(set(names)) < len(names):
        raise _checks.refused("wrt", "be a parameter's name or several different ones", wrt)
    known = {one.name: one for one in parameters_of(where, others)} if others else {}
    parameters = tuple(known.get(name) or Parameter(name, own[name], 0.0) for name in names)
    sensors = tuple(Sensor() for _ in record.channels)
    return Setting(arguments.system, arguments.base, sensors=sensors), parameters


def _with_sensors(
    record: Record, arguments: Arguments, parameters: tuple[Parameter, ...], transform: Transform
) -> tuple[Record, Transform]:
    """The record, less what is too near to its ends for delays to be searched, and offsets and delays in their units.

    Raises ValueError where too little is left.
    """
    spread = np.nanstd(record.values, axis=1)
    low, high, closed, scale = (np.array(one) for one in transform[1:5])
    slowest = slowest_time(arguments.system, arguments.base)
    longest = min(_DELAYED * float(np.ptp(record.times)), _DELAYED_TIME * slowest)
    for i, parameter in enumerate(parameters):
        if parameter.path[-1] == "offset" and parameter.path[0] == "sensors":
            scale[i] = spread[parameter.path[1]] or 1.0  # pyright: ignore[reportArgumentType, reportCallIssue]
        elif parameter.path[0] in ("clock", "sensors"):
            low[i], high[i], closed[i], scale[i] = -longest, longest, 1.0, 2 * longest
    delays = [parameter.path[0] for parameter in parameters if parameter.path[-1] == "delay"]
    if delays and {"clock", "sensors"} <= set(delays) and delays.count("sensors") == len(record.channels):
        raise ValueError(
            'Argument wrt must leave one channel without a delay of its own if "clock.delay" is searched, which delays '
            "all of them."
        )
    kinds = sum(kind in delays for kind in ("clock", "sensors"))
    record = record._replace(reach=kinds * longest * (1 + 1e-9))
    if kinds and record.counts.sum() < 3:
        raise ValueError(
            f"Argument times must hold measurements more than {record.reach:.3g} s away from the ends of the record if "
            "delays are searched, which need the motion before and after a measurement, but it holds fewer than three."
        )
    return record, transform._replace(low=low, high=high, closed=closed, scale=scale)


def _usual_windows(search: Search) -> int:
    """As many windows as have some periods of the slowest time scale, and enough measurements."""
    system, base, method, t1 = search.arguments
    if isinstance(method, Regularized):
        return 1
    by_time = (t1 - search.record.times[0]) / (_PERIODS * slowest_time(system, base))
    by_number = len(search.record.times) / _FEWEST
    return int(np.clip(min(by_time, by_number), 1, _MOST_WINDOWS))
