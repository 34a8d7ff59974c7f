"""Ctrl-C while the command ``stickslip`` is being loaded, which takes a moment: a sentence in place of a traceback.

Importing this module begins that; for other programs than the command nothing changes.
"""

import os
import signal
import sys
import threading
from typing import Any

_FILES = ("stickslip", "stickslip.exe", "_cli.py")
_MODULE = "stickslip_jax._cli"


def begin() -> None:
    """Answer Ctrl-C from now on, if this program is the command, and Ctrl-C is not ignored or answered already."""
    program = sys.argv[0] if sys.argv else ""
    # With "-m" the package is loaded before the module that is to run.
    is_command = _MODULE in sys.orig_argv if program == "-m" else os.path.basename(program) in _FILES
    if not is_command or threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)


def end() -> None:
    """Leave Ctrl-C to Python again."""
    if signal.getsignal(signal.SIGINT) is _interrupted:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def usual() -> Any:
    """What answers Ctrl-C without this module."""
    now = signal.getsignal(signal.SIGINT)
    return signal.default_int_handler if now is _interrupted else now


def _interrupted(*_: object) -> None:
    os.write(2, b"stickslip: Interrupted; nothing was begun.\n")
    os._exit(130)


begin()
