"""The ``stickslip`` command: ``study`` for one ensemble; ``sweep``, ``resume``, ``status``, ``show`` for many;
``explore`` for a page with sliders.

Exit codes: 0 done, 1 failed (extra not installed, disk full), 2 bad input, 130 interrupted (Ctrl-C), 141 output closed
by who read it (``stickslip show ... | head``), 143 terminated.
"""

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import FrameType

from . import _starting

_starting.begin()


def main(tokens: Sequence[str] | None = None) -> int:
    """Run the command given by `tokens` (default: those of the process, as the console script does).

    Returns the exit code, except that an interrupted process ends here.
    """
    with _stops_raised():
        code = _answer(sys.argv[1:] if tokens is None else tokens)
        if tokens is None and code > 128:
            # JAX may still compile in other threads, and crashes if the interpreter shuts down meanwhile.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    return code


class _Terminated(BaseException):
    """Raised when the process receives SIGTERM."""


_STOPS: dict[type[BaseException], signal.Signals] = {
    KeyboardInterrupt: signal.SIGINT,
    _Terminated: signal.SIGTERM,
}


def _answer(tokens: Sequence[str]) -> int:
    """Run the command; every expected failure becomes one sentence and an exit code."""
    is_stored = list(tokens[:1]) in (["sweep"], ["resume"])
    left = "what is done is kept, and the same command goes on from there." if is_stored else "no result was written."
    left = "the explorer has ended." if list(tokens[:1]) == ["explore"] else left
    try:
        return _run_or_fail(tokens, left)
    except (KeyboardInterrupt, _Terminated) as stop:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # impatient people press Ctrl-C again
        if isinstance(stop, _Terminated):
            return _fail(f"Terminated; {left}", 143)
        return _fail(str(stop) or f"Interrupted; {left}", 130)
    except SystemExit as stop:
        if stop.code == 1:  # of what prints the help, where nobody reads it
            return _PIPE_CLOSED
        raise


def _run_or_fail(tokens: Sequence[str], left: str) -> int:
    try:
        # Imported only here, so that help and errors in the arguments appear without loading the simulation, and
        # Ctrl-C is answered again at once after the package is loaded.
        from ._ensemble.encoding import SweepError  # noqa: PLC0415
        from .study import StudyError  # noqa: PLC0415 - says which extra is missing
    except ImportError as error:
        return _fail(error, 1)
    from .study._commands import run  # noqa: PLC0415 - needs the extra

    try:
        run(tokens)
        sys.stdout.flush()
    except (StudyError, SweepError) as error:
        return _fail(error, 2)
    except BrokenPipeError as error:
        return _PIPE_CLOSED if _output_is_closed() else _fail(error, 1)
    except MemoryError as error:
        reason = f"MemoryError: {error}" if str(error) else "MemoryError"
        return _fail(f"There is not enough memory ({' '.join(reason.split())}); {left}", 1)
    except OSError as error:
        return _fail(error, 1)
    return 0


_PIPE_CLOSED = 128 + 13  # as if SIGPIPE had ended the process, which is what shells expect


def _output_is_closed() -> bool:
    """Whether who read the output stopped reading, as ``head`` does. If so, what is left of it goes nowhere."""
    try:
        output = sys.stdout.fileno()
    except (OSError, ValueError):  # it is no file
        return False
    asked = select.poll()
    asked.register(output, 0)
    if not any(events & select.POLLERR for _, events in asked.poll(0)):
        return False  # another pipe broke
    # Python flushes once more when the process ends, and would complain.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, output)
    os.close(nowhere)
    return True


def _fail(reason: object, code: int) -> int:
    print("stickslip:", *str(reason).splitlines(), file=sys.stderr)
    return code


@contextlib.contextmanager
def _stops_raised() -> Iterator[None]:
    """Make Ctrl-C and SIGTERM (sent by batch systems) raise an exception, so that the program cleans up."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {signal.SIGINT: _starting.usual(), signal.SIGTERM: signal.getsignal(signal.SIGTERM)}
    signal.signal(signal.SIGTERM, partial(_stop, _Terminated))
    if usual[signal.SIGINT] is signal.default_int_handler:  # not where Ctrl-C is ignored
        signal.signal(signal.SIGINT, partial(_stop, KeyboardInterrupt))
    usual_hook, sys.unraisablehook = sys.unraisablehook, partial(_send_again, sys.unraisablehook)
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
        sys.unraisablehook = usual_hook


def _stop(reason: type[BaseException], number: int, frame: FrameType | None) -> None:
    raise reason


def _send_again(usual: Callable[..., object], dropped: "sys.UnraisableHookArgs") -> None:
    """Send a signal again, a little later, whose exception Python dropped; leave other exceptions to the usual hook.

    Python drops what is raised in callbacks of weak references and of the garbage collector and in ``__del__``;
    such a callback, of JAX or another library, is often the first code to run after a long compilation.
    """
    number = _STOPS.get(dropped.exc_type)
    if number is None:
        usual(dropped)
        return
    later = threading.Timer(0.05, os.kill, (os.getpid(), number))
    later.daemon = True
    later.start()


if __name__ == "__main__":
    sys.exit(main())
