"""Forks of a process in which JAX has started: its threads are not in the fork, and what needs them waits for ever."""

import os

import jax

_PROBED = "jax_num_cpu_devices"  # which JAX refuses to change once it has started


class _State:
    """`started`: whether JAX had started when this process was forked last. `lost`: whether this is such a fork."""

    started = False
    lost = False


def require_threads_of_jax() -> None:
    """Raises RuntimeError in a fork of a process in which JAX had started."""
    if _State.lost:
        raise RuntimeError(
            "JAX cannot run in a fork of a process in which it had started, and would wait for threads that are not "
            'there; start processes by multiprocessing.get_context("spawn"), or let Sweep.run(workers=...) do it.'
        )


def _before() -> None:
    _State.started = _State.lost or _has_started()


def _in_fork() -> None:
    _State.lost = _State.started


def _has_started() -> bool:
    """Whether JAX has started. No function of JAX tells it, but it refuses another number of devices from then on."""
    now = getattr(jax.config, _PROBED)
    try:
        jax.config.update(
            _PROBED, -2 if now < 0 else now + 1
        )  # any negative number: the number that the flags of XLA say
    except RuntimeError:
        return True
    jax.config.update(_PROBED, now)
    return False


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_before, after_in_child=_in_fork)
