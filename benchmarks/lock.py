"""How much of a run a thread holds Python's lock: no other thread runs Python then, which bounds what threads bring."""

import ctypes
import threading
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

_WORDS = 400  # of the state of Python's runtime, in which the lock is looked for: that of Python 3.11 is there


def held_share(run: Callable[[], Any]) -> float:
    """The share of the time of `run()` in which a thread holds the lock, looked at all along from another core.

    NaN for a Python whose lock is not found.
    """
    locked = _locked()
    if locked is None:
        return float("nan")
    over, seen, scratch = np.zeros(1, np.int64), np.zeros(2, np.int64), np.zeros(64, np.int64)
    _watch(locked, np.ones(1, np.int64), seen, scratch)  # compiled
    seen[:] = 0
    watcher = threading.Thread(target=_watch, args=(locked, over, seen, scratch))
    watcher.start()
    try:
        run()
    finally:
        over[0] = 1
        watcher.join()
    return float(seen[1] / seen.sum())


def _locked() -> np.ndarray | None:
    """The word that says whether the lock is held: it follows the pointer to the thread that holds it, this one."""
    runtime = ctypes.addressof(ctypes.c_char.in_dll(ctypes.pythonapi, "_PyRuntime"))
    ctypes.pythonapi.PyThreadState_Get.restype = ctypes.c_void_p
    me = ctypes.pythonapi.PyThreadState_Get()
    words = np.ctypeslib.as_array(ctypes.cast(runtime, ctypes.POINTER(ctypes.c_uint64)), (_WORDS,))
    for place in np.flatnonzero(words == me):
        word = ctypes.cast(runtime + 8 * (int(place) + 1), ctypes.POINTER(ctypes.c_int32))
        if word[0] == 1:
            return np.ctypeslib.as_array(word, (1,))
    return None


@numba.njit(nogil=True)
def _watch(locked: np.ndarray, over: np.ndarray, seen: np.ndarray, scratch: np.ndarray) -> None:
    at = 0
    while over[scratch[0]] == 0:
        seen[1 if locked[scratch[0]] != 0 else 0] += 1
        for _ in range(20):
            at = (7 * at + 3) % 32
            scratch[1 + at] += 1  # for all that the compiler knows, the numbers above are other ones after that
