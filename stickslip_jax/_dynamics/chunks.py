"""Compiled functions that simulate a chunk of an ensemble: what a worker thread calls.

512-bit vectors halve the run time on CPUs that have them, and change nothing on others. But with them jaxlib (0.10.2)
computes ``jnp.arctan`` wrong, by up to pi/2; and it cannot compile every operation into a native loop (some end the
process). The package's own laws and systems avoid these operations; where a user's functions are compiled too, neither
512-bit vectors nor native loops are used.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax

from .._numerics.compiling import CompiledNatively
from .._systems.built_in import is_built_in
from . import lanes
from .regularized import lanes as regularized_lanes


class Chunks(NamedTuple):
    """`lanes.summarize`, `lanes.open_lanes` and `lanes.record`, compiled."""

    summarize: Callable[..., Any]
    open: Callable[..., tuple[Any, ...]]
    record: Callable[..., tuple[tuple[Any, ...], lanes.Records, lanes.Blocks]]


def chunks_of(engine: lanes.Engine, *, with_records: bool = False) -> Chunks:
    """The compiled functions for jobs of `engine`; `with_records`: whether every sample has a base motion of its own as
    arrays, which are too large for native loops.
    """
    return _COMPILED[is_built_in(engine) and not with_records]


# filter_jit, because a diffrax solver holds more than arrays. Plain numbers must be passed as arrays.
solve_chunk = eqx.filter_jit(regularized_lanes.solve_batch)


def _compiled(is_built_in: bool) -> Chunks:
    compiled = partial(CompiledNatively, compiler_options=_WIDE) if is_built_in else jax.jit
    options = _WIDE if is_built_in else None
    return Chunks(
        compiled(lanes.summarize, static_argnames=("lanes", "rows", "dtype")),
        jax.jit(lanes.open_lanes, static_argnames=("lanes", "dtype"), compiler_options=options),
        compiled(lanes.record, static_argnames=("layout", "lanes", "blocks", "dtype")),
    )


# The disabled LLVM passes do not speed up these loops, and take a quarter of the compilation time.
_WIDE = {"xla_cpu_prefer_vector_width": 512, "xla_llvm_disable_expensive_passes": True}
_COMPILED = {is_built_in: _compiled(is_built_in) for is_built_in in (True, False)}
