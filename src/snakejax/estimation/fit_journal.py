"""Journal of finished fits: a search that was interrupted goes on with the fits that it had finished.

A search is deterministic given the results of its fits. Within `keep_fits(folder)` each finished fit is written to one
file of that folder, and a fit that is found there is read instead of computed. The name of the file is the SHA-256 of
everything on which the result depends: the code of this package and of user classes, structure and every bit of model,
recordings, noise and start values, and the options. A file holds the SHA-256 of its content in front of it; a damaged
file is computed again.

Fits are called from many places and from threads, so that the journal is a context variable (PEP 567) and no argument.
"""

import contextlib
import contextvars
import functools
import io
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.files import read_sealed, write_sealed
from snakejax.simulation.chunks import fingerprint

Function = TypeVar("Function", bound=Callable)
SUFFIX = ".fit"
"""Ending of the name of a file with one fit."""


class FitJournal:
    """The finished fits in `folder`: `earlier` of them were there at the beginning; `used` and `computed` count."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.earlier = len(list(folder.glob(f"*{SUFFIX}")))
        self.used = self.computed = 0

    def result(self, parts: Any, compute: Callable[[], Any]) -> Any:
        """The result kept for `parts`, or else that of `compute`, which is kept then.

        Nothing is kept where a part has no digest, such as a function among the fields of an effect, and where the
        folder is not writable.
        """
        if not has_digest(parts):
            return compute()
        path = self.folder / f"{fingerprint(parts)}{SUFFIX}"
        content = read_sealed(path)
        if content is not None:
            with contextlib.suppress(Exception):  # A file of another origin: any error of unpickling.
                result = _Reader(io.BytesIO(content)).load()
                self.used += 1
                return result
        token = _journal.set(None)  # What a kept fit calls need not be kept.
        try:
            content = _content(compute())
        finally:
            _journal.reset(token)
        self.computed += 1
        with contextlib.suppress(InputError):
            write_sealed(path, content)
        # What is read later is what the search goes on with now, to the layout of the arrays.
        return _Reader(io.BytesIO(content)).load()


_journal: contextvars.ContextVar[FitJournal | None] = contextvars.ContextVar("journal", default=None)


@contextlib.contextmanager
def keep_fits(folder: Path) -> Iterator[FitJournal]:
    """Keep the fits that are finished within this context in `folder`, and use those that are there."""
    journal = FitJournal(folder)
    token = _journal.set(journal)
    try:
        yield journal
    finally:
        _journal.reset(token)


def kept(parts: Any, compute: Callable[[], Any]) -> Any:
    """The result of `compute`, from the journal where one is open and has it.

    `parts` is a pytree of all on which the result depends, with the name of what is computed; the result consists of
    numbers, text and arrays in tuples, lists and dictionaries.
    """
    journal = _journal.get()
    return compute() if journal is None else journal.result(parts, compute)


def kept_fit(function: Function) -> Function:
    """Decorate a function whose results a journal keeps, see `kept`; they depend on its arguments alone."""
    name = f"{function.__module__}.{function.__qualname__}"

    @functools.wraps(function)
    def wrapped(*args: Any, **options: Any) -> Any:
        return kept((name, args, options), lambda: function(*args, **options))

    return cast(Function, wrapped)


def has_digest(parts: Any) -> bool:
    """Whether no leaf of `parts` is an object, and nothing in its structure is known by its address alone."""
    leaves, structure = jax.tree.flatten(parts)
    arrays = all(isinstance(leaf, jax.Array | np.ndarray | np.generic | float | int | str | bool) for leaf in leaves)
    return arrays and not any(np.asarray(leaf).dtype == object for leaf in leaves) and " at 0x" not in str(structure)


def _content(result: Any) -> bytes:
    written = io.BytesIO()
    _Writer(written, protocol=5).dump(result)
    return written.getvalue()


def _array(kind: str, shape: tuple[int, ...], order: Any, content: bytes) -> np.ndarray:
    return np.frombuffer(content, np.dtype(kind)).reshape(shape, order=order).copy(order=order)


def _number(kind: str, content: bytes) -> np.generic:
    return np.frombuffer(content, np.dtype(kind))[0]


def _on_device(array: np.ndarray) -> jax.Array:
    return jnp.asarray(array)


class _Writer(pickle.Pickler):
    """Writes arrays by functions of this module, whatever the versions of NumPy and JAX."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, jax.Array):
            return _on_device, (np.asarray(obj),)
        if isinstance(obj, np.ndarray):
            order = "F" if obj.flags.f_contiguous and not obj.flags.c_contiguous else "C"
            return _array, (obj.dtype.str, obj.shape, order, obj.tobytes(order))
        if isinstance(obj, np.generic):
            return _number, (obj.dtype.str, obj.tobytes())
        return NotImplemented


class _Reader(pickle.Unpickler):
    """Reads arrays and named tuples of this package and nothing else: a file cannot run code."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        if module_name == __name__ and global_name in ("_array", "_number", "_on_device"):
            return globals()[global_name]
        if module_name.startswith("snakejax.") and "." not in global_name:
            class_ = super().find_class(module_name, global_name)
            if isinstance(class_, type) and issubclass(class_, tuple):
                return class_
        raise pickle.UnpicklingError(f"{module_name}.{global_name} is no result of a fit.")
