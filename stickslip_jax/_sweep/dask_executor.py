"""Tasks done by the workers of a cluster of dask.distributed."""

import uuid
from typing import Any

import jax.numpy as jnp

from .. import _checks
from .plan import Plan, Task
from .workers import dumps, perform_in_worker, prepare_worker

_RETRIES = 3  # of a task whose worker failed


class DaskCluster:
    """The workers of a cluster, to which a ``dask.distributed.Client`` is connected.

    The plan is sent once; a task is a few numbers, its result some hundred kilobytes. At most two tasks for each thread
    of the cluster are submitted at a time, and results are released as soon as they are written.
    """

    def __init__(self, plan: Plan, client: Any):
        if not (callable(getattr(client, "submit", None)) and callable(getattr(client, "scatter", None))):
            raise ValueError(
                "Argument executor must be a dask.distributed.Client, but "
                f"{_checks.show(client)} was given; threads and workers need no client."
            )
        self._client = client
        self._plan = dumps(plan)
        self._double = jnp.result_type(float).itemsize == 8
        self._name = uuid.uuid4().hex[:8]

    @property
    def at_once(self) -> int:
        """Two tasks for each thread that there is now; workers may come and go."""
        return 2 * max(1, sum(self._client.nthreads().values()))

    def submit(self, task: Task) -> Any:
        name = f"stickslip-{self._name}-{'-'.join(map(str, task))}-{uuid.uuid4().hex[:8]}"
        return self._client.submit(_perform, self._plan, self._double, task, key=name, pure=False, retries=_RETRIES)

    def restart(self) -> bool:
        return False  # the scheduler replaces workers itself

    def close(self, *, wait: bool) -> None:
        pass  # the client is the caller's


_prepared: list[bytes] = []


def _perform(plan: bytes, double: bool, task: Task) -> bytes:
    if _prepared != [plan]:
        prepare_worker(plan, double, "")
        _prepared[:] = [plan]
    return perform_in_worker(task)
