"""Parallel computations: their number, and threads that know the context of their caller."""

import contextvars
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")
Value = TypeVar("Value")

WORKERS = 2
"""Threads side by side: what they do uses several cores by itself, or the memory that all cores share."""


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class ContextThreads(ThreadPoolExecutor):
    """Threads in which the context variables (PEP 567) have the values that they have where work is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Schedule `fn(*args, **kwargs)` in a copy of the present context."""
        return super().submit(contextvars.copy_context().run, fn, *args, **kwargs)


def in_threads(function: Callable[[Item], Value], items: Iterable[Item]) -> list[Value]:
    """The values of `function` for `items`, in their order, computed in `WORKERS` threads, or as many as there are
    cores."""
    with ContextThreads(min(WORKERS, cores())) as threads:
        return list(threads.map(function, items))
