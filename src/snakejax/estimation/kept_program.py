"""Programs that are traced once and kept beside the compiled ones, where JAX keeps these.

JAX finds a compiled program on disk by the program that was traced, and to trace a simulation with its derivatives
takes some ten times as long as to read what was compiled of it. Here the traced program (StableHLO, by `jax.export`) is
found by what it was traced from: code, structure and shapes of its arguments.
"""

import contextlib
import functools
import gc
import importlib.metadata
import os
import threading
import weakref
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax import export

from snakejax.core.errors import InputError
from snakejax.core.files import read_sealed, write_sealed
from snakejax.simulation.chunks import fingerprint, user_classes

from .fit_journal import has_digest

SUFFIX = ".traced"
"""Ending of the name of a file with one traced program."""
_PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "numpy")
"""The packages whose code is traced."""
_tracing = threading.Lock()
"""One program is traced at a time: the next one finds in the caches of JAX what both have in common."""
_programs: "weakref.WeakSet[KeptProgram]" = weakref.WeakSet()
"""All that there are, whose compiled programs can be dropped."""


class KeptProgram:
    """`function`, compiled once for each structure and shape of its arguments, as `equinox.filter_jit` compiles it.

    Where JAX keeps compiled programs in a folder (`jax_compilation_cache_dir`), traced ones are kept there too, and are
    not traced again by another process, but for those of a user's classes: nobody knows what code these call. Threads
    that need one program wait until the first of them has compiled it.
    The arguments hold arrays of numbers, and no traced ones; `named_tuples` are the classes of those in the result.
    """

    def __init__(self, function: Callable, *named_tuples: type) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        for kind in named_tuples:
            _may_be_written(kind)
        self.compiled: dict[Hashable, Future] = {}
        self.lock = threading.Lock()
        _programs.add(self)

    def __call__(self, *args: Any) -> Any:
        """The result of the function for `args`. **Raises:** what the function raises while it is traced."""
        leaves, structure = jax.tree.flatten(args)
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        # Of 1, 1.0 and True, which are equal, each makes another program.
        key = structure, tuple(_shape(leaf) if eqx.is_array(leaf) else (type(leaf), leaf) for leaf in leaves)
        with self.lock:
            first = key not in self.compiled
            program = self.compiled.setdefault(key, Future())
        if first:
            try:
                program.set_result(self._compile(args, arrays))
            except BaseException as error:
                self.compiled.pop(key, None)
                program.set_exception(error)
        return program.result()(*arrays)

    def _compile(self, args: Any, arrays: list) -> Callable:
        dynamic, static = eqx.partition(args, eqx.is_array)
        structure = jax.tree.structure(dynamic)

        def flat(*arrays: Any) -> Any:
            return self.function(*eqx.combine(jax.tree.unflatten(structure, arrays), static))

        flat.__name__ = self.function.__name__  # by which benchmarks and JAX's messages name the program
        with _tracing:
            lowered = jax.jit(self._kept(args, flat, arrays)).lower(*arrays)
        return lowered.compile()

    def _kept(self, args: Any, flat: Callable, arrays: list) -> Callable:
        """`flat`, of the folder if it is there, else traced now and written there."""
        folder = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
        parts = jax.tree.map(lambda leaf: repr(_shape(leaf)) if eqx.is_array(leaf) else leaf, args)
        # An empty environment variable gives an empty name: that is no folder, and not the present one.
        if not folder or user_classes(args) or not has_digest(parts):
            return flat
        name = f"{self.function.__module__}.{self.function.__qualname__}"
        path = Path(folder) / f"{fingerprint(name, _environment(), parts)}{SUFFIX}"
        content = read_sealed(path)
        if content is None:
            content = bytes(export.export(jax.jit(flat))(*arrays).serialize())
            with contextlib.suppress(InputError):
                write_sealed(path, content)
        traced = export.deserialize(bytearray(content))
        return functools.wraps(flat)(lambda *arrays: traced.call(*arrays))


@functools.cache  # JAX takes each class once
def _may_be_written(kind: type) -> None:
    export.register_namedtuple_serialization(kind, serialized_name=f"{kind.__module__}.{kind.__qualname__}")


def drop_programs() -> None:
    """Remove all compiled programs from memory, those that JAX holds too."""
    jax.clear_caches()
    for program in _programs:
        program.compiled.clear()
    gc.collect()  # The functions and programs refer to each other.


def _shape(array: Any) -> tuple:
    """What a traced program knows of an array."""
    return array.shape, array.dtype, getattr(array, "weak_type", False)


def _environment() -> list[str]:
    """What a traced program depends on beside its arguments and the code of this package."""
    versions = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
    return [*versions, jax.default_backend(), str(jax.config.jax_enable_x64), os.environ.get("EQX_ON_ERROR", "")]  # type: ignore[attr-defined]
