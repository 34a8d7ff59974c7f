"""Compiled functions that simulate a chunk of an ensemble: what a worker thread calls.

XLA (jaxlib 0.10.2) cannot compile every operation into a native loop (some end the process), and computes one wrong in
wide vectors (`_compiler`). The package's own laws and systems avoid these operations; where a user's functions are
compiled too, neither wide vectors nor native loops are used.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax

from .._compiler import COMPILED_QUICKLY, WIDE_VECTORS, CompiledNatively
from .._systems.built_in import is_built_in
from .common import lanes
from .common.engine import Engine
from .regularized.engine import solve_batch


class CompiledLanes(NamedTuple):
    """`lanes.summarize`, `lanes.open_lanes` and `lanes.record`, compiled."""

    summarize: Callable[..., Any]
    open: Callable[..., tuple[jax.Array, ...]]
    record: Callable[..., tuple[tuple[jax.Array, ...], lanes.Records, lanes.Blocks]]


def compiled_for(engine: Engine, *, with_records: bool = False) -> CompiledLanes:
    """The compiled functions for jobs of `engine`; `with_records`: whether every sample has a base motion of its own as
    arrays, which are too large for native loops.
    """
    return _COMPILED[is_built_in(engine) and engine.compiles_natively and not with_records]


# filter_jit, because a diffrax solver holds more than arrays. Plain numbers must be passed as arrays.
solve_chunk = eqx.filter_jit(solve_batch)


def _compiled(is_built_in: bool) -> CompiledLanes:
    options = {**WIDE_VECTORS, **COMPILED_QUICKLY} if is_built_in else {}
    compiled = partial(CompiledNatively, compiler_options=options) if is_built_in else jax.jit
    return CompiledLanes(
        compiled(lanes.summarize, static_argnames=("lanes", "rows", "dtype")),
        jax.jit(lanes.open_lanes, static_argnames=("lanes", "dtype"), compiler_options=options),
        compiled(lanes.record, static_argnames=("layout", "lanes", "blocks", "dtype")),
    )


_COMPILED = {is_built_in: _compiled(is_built_in) for is_built_in in (True, False)}
