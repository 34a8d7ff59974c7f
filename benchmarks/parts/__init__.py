"""The parts of the benchmarks: each measures (`measure`) and writes its table (`table`)."""

from . import (
    compiling,
    composed,
    contacts,
    derivatives,
    inner_states,
    intervals,
    motor_cart,
    nonlinear,
    one_trajectory,
    outputs,
    regularized,
    sensitivity,
    sequence,
    shares,
    stepping,
    sweeps,
)

PARTS = {
    "intervals": intervals,
    "shares": shares,
    "composed": composed,
    "derivatives": derivatives,
    "stepping": stepping,
    "contacts": contacts,
    "outputs": outputs,
    "one trajectory": one_trajectory,
    "nonlinear": nonlinear,
    "compiling": compiling,
    "motor cart": motor_cart,
    "regularised": regularized,
    "inner states": inner_states,
    "sensitivity": sensitivity,
    "sequence": sequence,
    "sweeps": sweeps,
}
