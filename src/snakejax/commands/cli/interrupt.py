"""Reliable handling of Ctrl-C."""

import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any, Self

AGAIN = 1.0
"""Time [s] after which a lost interrupt is raised again."""

AFTER_IMPORT = 0.05
"""Time [s] after which an interrupt that arrived during an import is tried again."""


class PersistentInterrupt:
    """A block in which Ctrl-C raises `KeyboardInterrupt`, and again every second until the block ends.

    An interrupt that Python raises inside a callback of a library is lost; `requested` says whether Ctrl-C was pressed,
    whatever became of the exception, and the interrupts that libraries print are not shown. A compiled module that is
    interrupted during its import can crash the process, so an interrupt waits for the end of an import.
    """

    def __init__(self) -> None:
        self.requested = False
        self._active = False

    def __enter__(self) -> Self:
        default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        self._active = default and threading.current_thread() is threading.main_thread()
        if self._active:
            self._hooks = sys.unraisablehook, sys.excepthook
            sys.unraisablehook, sys.excepthook = self._unraisable, self._printed
            signal.signal(signal.SIGINT, self._raise)
            if hasattr(signal, "setitimer"):
                signal.signal(signal.SIGALRM, self._raise)
        return self

    def __exit__(self, *_: object) -> None:
        if self._active:
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            sys.unraisablehook, sys.excepthook = self._hooks

    def _raise(self, _: int, frame: FrameType | None) -> None:
        self.requested = True
        if hasattr(signal, "setitimer"):
            importing = _importing(frame)
            signal.setitimer(signal.ITIMER_REAL, AFTER_IMPORT if importing else AGAIN)
            if importing:
                return
        raise KeyboardInterrupt

    def _unraisable(self, unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            self._hooks[0](unraisable)

    def _printed(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not issubclass(kind, KeyboardInterrupt):
            self._hooks[1](kind, error, trace)


def _importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported in `frame` or one of its callers."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
