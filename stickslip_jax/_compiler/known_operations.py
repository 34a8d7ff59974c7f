"""Operations that XLA is known to compile into native loops, and rightly.

Others are refused by it (sorting, linear algebra, calls of Python), and some end the process: functions that hold what
users write are compiled natively only where all of their operations stand here.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
from jax.extend import core

_INSIDE = [
    "cond",
    "custom_jvp_call",
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "remat2",
    "checkpoint",
    "scan",
    "while",
]
_OF_OWN = ["call_with_own_derivative", "tangent_of_call"]  # `_numerics/own_derivative.py`
_MOVING = [
    "bitcast_convert_type",
    "broadcast_in_dim",
    "concatenate",
    "convert_element_type",
    "copy",
    "dynamic_slice",
    "dynamic_update_slice",
    "expand_dims",
    "gather",
    "iota",
    "optimization_barrier",
    "pad",
    "reshape",
    "rev",
    "slice",
    "split",
    "squeeze",
    "stack",
    "stop_gradient",
    "transpose",
    "xla_metadata_value",
]
_ARITHMETIC = [
    "abs",
    "acos",
    "acosh",
    "add",
    "add_any",
    "and",
    "argmax",
    "argmin",
    "asin",
    "asinh",
    "atan",
    "atan2",
    "atanh",
    "bessel_i0e",
    "bessel_i1e",
    "cbrt",
    "ceil",
    "clamp",
    "cos",
    "cosh",
    "cumlogsumexp",
    "cummax",
    "cummin",
    "cumprod",
    "cumsum",
    "digamma",
    "div",
    "dot_general",
    "eq",
    "erf",
    "erf_inv",
    "erfc",
    "exp",
    "exp2",
    "expm1",
    "floor",
    "ge",
    "gt",
    "integer_pow",
    "is_finite",
    "le",
    "le_to",
    "lgamma",
    "log",
    "log1p",
    "logistic",
    "lt",
    "lt_to",
    "max",
    "min",
    "mul",
    "ne",
    "neg",
    "nextafter",
    "not",
    "or",
    "polygamma",
    "pow",
    "reduce_and",
    "reduce_max",
    "reduce_min",
    "reduce_or",
    "reduce_prod",
    "reduce_sum",
    "rem",
    "round",
    "rsqrt",
    "select_n",
    "shift_left",
    "shift_right_arithmetic",
    "shift_right_logical",
    "sign",
    "sin",
    "sinh",
    "sqrt",
    "square",
    "sub",
    "tan",
    "tanh",
    "unvmap_all",
    "unvmap_any",
    "unvmap_max",
    "xor",
]
_LARGEST = 64
"""Numbers in an array that is computed with. The usual kernels are faster with more, as where many trajectories advance
side by side; and XLA cannot put sums over thousands into a native loop."""


def compilable(jaxpr: core.Jaxpr) -> bool:
    """Whether XLA is known to compile `jaxpr` into a native loop."""
    return all(map(_is_known, jaxpr.eqns))


def _is_known(equation: core.JaxprEqn) -> bool:
    name = equation.primitive.name
    if name in _INSIDE:
        return all(map(compilable, _jaxprs_in(list(equation.params.values()))))
    if name in _OF_OWN:
        run = partial(equation.primitive.impl, **equation.params)
        return compilable(jax.make_jaxpr(run)(*(atom.aval for atom in equation.invars)).jaxpr)
    if name in _MOVING:
        return True
    sizes = [math.prod(getattr(atom.aval, "shape", ())) for atom in (*equation.invars, *equation.outvars)]
    return name in _ARITHMETIC and max(sizes) <= _LARGEST


def _jaxprs_in(params: Any) -> Iterator[core.Jaxpr]:
    """The functions among the parameters of an equation."""
    for param in params:
        if isinstance(param, (tuple, list)):
            yield from _jaxprs_in(param)
        elif isinstance(param, core.ClosedJaxpr):
            yield param.jaxpr
        elif isinstance(param, core.Jaxpr):
            yield param
