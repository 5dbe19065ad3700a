"""Parallel computations: their number, and threads that know the context of their caller."""

import contextvars
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ContextThreads(ThreadPoolExecutor):
    """Threads in which the context variables (PEP 567) have the values that they have where work is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Schedule `fn(*args, **kwargs)` in a copy of the present context."""
        return super().submit(contextvars.copy_context().run, fn, *args, **kwargs)
