"""What runs in worker processes, on this machine or another."""

import dataclasses
import importlib
import importlib.util
import pickle
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .pieces import perform
from .plan import Plan, Task
from .warned import collecting

_plan_of_worker: list[Plan] = []


def prepare_worker(plan: bytes, double: bool, cache: str) -> None:
    """Set JAX as in the main process, and read the plan; once in every worker."""
    jax.config.update("jax_enable_x64", double)
    if cache:
        jax.config.update("jax_compilation_cache_dir", cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    _plan_of_worker[:] = [_loads(plan)]


def perform_in_worker(task: Task) -> bytes:
    """`perform` with the plan that the worker was started with."""
    with collecting():
        return perform(_plan_of_worker[0], task)


def arguments_of_worker(plan: Plan) -> tuple[bytes, bool, str]:
    """The arguments of `prepare_worker`. Raises ValueError for a plan that cannot be sent."""
    double = jnp.result_type(float).itemsize == 8
    return dumps(plan), double, str(getattr(jax.config, "jax_compilation_cache_dir", None) or "")


def dumps(plan: Plan) -> bytes:
    """The plan as bytes for a worker. Raises ValueError for objects that cannot be sent."""
    try:
        return _pickler()(dataclasses.replace(plan))  # without what it has computed
    except Exception as error:  # pickling a user's object may raise anything
        raise ValueError(
            "Arguments system and law must be objects that can be sent to other processes, but pickling them failed "
            f"({error}); define their classes in a module, or install cloudpickle."
        ) from error


def _pickler() -> Callable[[Any], bytes]:
    if importlib.util.find_spec("cloudpickle") is None:
        return pickle.dumps
    return importlib.import_module("cloudpickle").dumps  # comes with dask; sends the classes of notebooks too


_loads = pickle.loads
