"""Ctrl-C that is always heard."""

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

AGAIN = 1.0
"""After so many seconds an interrupt that was lost is raised once more."""


@contextlib.contextmanager
def persistent_interrupt() -> Iterator[None]:
    """Raise `KeyboardInterrupt` on Ctrl-C, and again until the block ends.

    Python raises it wherever it is, and where that is a callback that a library makes, it is lost.
    """
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not heard or threading.current_thread() is not threading.main_thread():
        yield
        return
    timed = hasattr(signal, "setitimer")

    def interrupt(*_: Any) -> None:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise KeyboardInterrupt

    def lost(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)

    shown, sys.unraisablehook = sys.unraisablehook, lost
    signal.signal(signal.SIGINT, interrupt)
    if timed:
        signal.signal(signal.SIGALRM, interrupt)
    try:
        yield
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = shown
