"""Compiled functions that simulate a chunk of an ensemble: what a worker thread calls.

512-bit vectors halve the time where the CPU has them, and change nothing where it has not. But with them jaxlib
(0.10.2) computes ``jnp.arctan`` wrong, by up to pi/2. The package's own laws and systems do not use it; where a user's
functions are compiled too, the vectors stay as they are.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax

from ..base_motion.smooth import UserMotion
from ..systems.friction import FrictionCurve
from . import lanes, regularized_lanes

_PACKAGE = __name__.partition(".")[0]
_THEIRS = (FrictionCurve, UserMotion)  # what wraps a user's function
_OPTIONS = {True: {"xla_cpu_prefer_vector_width": 512}, False: None}


def summarise_chunk(job: lanes.Job, **how: Any) -> lanes.LaneResults:
    """`lanes.summarise`."""
    return _summarise[_is_own(job.engine)](job, **how)


def open_chunk(job: lanes.Job, **how: Any) -> lanes.Stream:
    """`lanes.open_stream`."""
    return _open[_is_own(job.engine)](job, **how)


def record_chunk(job: lanes.Job, stream: lanes.Stream, room: lanes.Records, **how: Any) -> Any:
    """`lanes.record`; `room` is used up."""
    return _record[_is_own(job.engine)](job, stream, room, **how)


# A solver of diffrax holds more than arrays; plain numbers must be arrays here.
solve_chunk = eqx.filter_jit(regularized_lanes.solve_batch)


def _compiled(function: Any, **how: Any) -> dict[bool, Any]:
    return {own: jax.jit(function, compiler_options=options, **how) for own, options in _OPTIONS.items()}


_summarise = _compiled(lanes.summarise, static_argnames=("lanes", "rows", "dtype"))
_open = _compiled(lanes.open_stream, static_argnames=("lanes", "rows", "dtype"))
# The room is handed on from call to call: fresh memory for each would cost a third of the time.
_record = _compiled(lanes.record, static_argnames=("dtype",), donate_argnames=("room",))


def _is_own(engine: lanes.Engine) -> bool:
    """Whether nothing but the package's own functions is compiled with the engine."""
    return all(
        type(module).__module__.startswith((f"{_PACKAGE}.", "diffrax.")) and not isinstance(module, _THEIRS)
        for module in _modules(engine)
    )


def _modules(tree: Any) -> Iterator[eqx.Module]:
    if isinstance(tree, eqx.Module):
        yield tree
        for field in dataclasses.fields(tree):
            yield from _modules(getattr(tree, field.name, None))
    elif isinstance(tree, (tuple, list)):
        for entry in tree:
            yield from _modules(entry)
