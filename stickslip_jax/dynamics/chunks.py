"""Compiled functions that simulate a chunk of an ensemble: what a worker thread calls."""

from functools import partial

import jax

from . import lanes

# 512-bit vectors halve the time where the CPU has them, and change nothing where it has not.
_compile = partial(jax.jit, compiler_options={"xla_cpu_prefer_vector_width": 512})

summarise_chunk = _compile(lanes.summarise, static_argnames=("lanes", "rows", "dtype"))
open_chunk = _compile(lanes.open_stream, static_argnames=("lanes", "rows", "dtype"))
# The room is handed on from call to call: fresh memory for each would cost a third of the time.
record_chunk = _compile(lanes.record, static_argnames=("dtype",), donate_argnames=("room",))
