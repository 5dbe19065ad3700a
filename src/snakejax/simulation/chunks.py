"""Chunked computation over many members: on the cores or a cluster, with results saved by chunk and resumable."""

import dataclasses
import functools
import hashlib
import os
import sys
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Protocol

import equinox as eqx
import jax
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.parallel import cores
from snakejax.core.parameter import own_parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.law import Law

from .ensemble import CHUNK

Columns = Mapping[str, np.ndarray]
"""Arrays by name: input with one number for each member (V,), or results of each member (V, ...)."""
Work = Callable[[Columns], Columns]
"""A deterministic function of some members: the same result in every process and at every call."""


class Executor(Protocol):
    """Distributes chunks: yields (index, result) of each chunk as soon as it is computed."""

    def __call__(self, work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]: ...


def local_executor(work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]:
    """Compute chunks on the cores of this machine; if JAX has several devices, each chunk is distributed over them."""
    with ThreadPoolExecutor(1 if jax.local_device_count() > 1 else cores()) as pool:
        futures = {pool.submit(work, chunk): number for number, chunk in pieces.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def fingerprint(*parts: Any) -> str:
    """Hash (SHA-256, hexadecimal) of everything on which a saved result depends.

    It covers structure and every bit of the leaves of `parts`, the code of user classes in them and of this package,
    the version of JAX, and the chunk size.
    """
    digest = hashlib.sha256()
    leaves, structure = jax.tree.flatten(parts)
    digest.update(f"{structure} {jax.__version__} {chunk_size()}".encode())
    digest.update(_own_code())
    for kind in sorted(user_classes(parts), key=lambda kind: kind.__qualname__):
        for name, method in vars(kind).items():
            code = getattr(method, "__code__", None)
            digest.update(f"{name} {code and (code.co_code, code.co_consts, code.co_names)}".encode())
        # What stands beside a class in its file, such as a constant, may be used by it.
        file = getattr(sys.modules.get(kind.__module__), "__file__", None)
        digest.update(Path(file).read_bytes() if file and Path(file).is_file() else b"")
    for law in _laws(parts):
        digest.update(law.encode())
    for leaf in leaves:
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


@functools.cache
def _own_code() -> bytes:
    """Hash of the code of this package."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


def _modules(tree: Any) -> Iterator[eqx.Module]:
    """The equinox modules in `tree`, each before those in its fields."""
    for node in jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, eqx.Module)):
        if isinstance(node, eqx.Module):
            yield node
            yield from _modules([getattr(node, field.name) for field in dataclasses.fields(node)])  # type: ignore


def user_classes(tree: Any) -> set[type]:
    """The user-defined classes of equinox modules in `tree`."""
    return {type(node) for node in _modules(tree) if not type(node).__module__.startswith("snakejax.")}


def _laws(tree: Any) -> list[str]:
    """The laws in `tree`, whose classes have one name: each with its expression and the domains of its parameters."""
    return [
        f"{node.expression} {[(name, domain) for name, (_, domain) in own_parameters(node)]}"
        for node in _modules(tree)
        if isinstance(node, Law)
    ]


def chunk_size() -> int:
    """Number of members in one chunk."""
    return CHUNK * jax.local_device_count()


def map_chunks(
    work: Work,
    columns: Columns,
    *,
    folder: Path | None = None,
    executor: Executor = local_executor,
    progress: Progress = no_progress,
) -> dict[str, np.ndarray]:
    """Apply `work` to all members of `columns`, chunk by chunk, and concatenate the results.

    With a `folder` each chunk is saved there when it is computed, and a later call computes only the missing chunks;
    the folder must belong to this work and these members. `progress` counts members.
    **Raises:** `InputError` if the folder is not writable.
    """
    count, size = length(columns), chunk_size()
    missing = {
        k: {name: np.asarray(column)[first : first + size] for name, column in columns.items()}
        for k, first in enumerate(range(0, count, size))
    }
    results: dict[int, Columns] = {}
    if folder is not None:
        _writable(folder)
        results = {k: saved for k, chunk in missing.items() if (saved := load_chunk(_file(folder, k), length(chunk)))}
        missing = {k: chunk for k, chunk in missing.items() if k not in results}
    done = sum(map(length, results.values()))
    progress(ProgressEvent(Phase.SWEEP, done=done, total=count))
    for k, result in executor(work, missing) if missing else ():
        results[k] = result
        if folder is not None:
            save_chunk(_file(folder, k), result)
        done += length(result)
        progress(ProgressEvent(Phase.SWEEP, done=done, total=count))
    return {name: np.concatenate([results[k][name] for k in sorted(results)]) for name in results[0]}


def _file(folder: Path, number: int) -> Path:
    return folder / f"piece-{number:06d}.npz"


def length(columns: Columns) -> int:
    """Number of members in `columns`."""
    return len(next(iter(columns.values())))


def _writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"Cannot keep the results there ({error.strerror})"
        raise InputError(what, str(folder), "name a folder you may write to") from None


def load_chunk(path: Path, count: int) -> dict[str, np.ndarray] | None:
    """The saved result of a chunk of `count` members in `path`, or None if there is no complete one."""
    try:
        with np.load(path) as file:
            result = {name: file[name] for name in file.files}
        return result if all(len(column) == count for column in result.values()) else None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def save_chunk(path: Path, result: Columns) -> None:
    """Save `result` atomically: write a temporary file, then rename it. **Raises:** `InputError` if that fails."""
    partial = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        with partial.open("wb") as file:
            np.savez(file, **{name: np.asarray(column) for name, column in result.items()})
        partial.replace(path)
    except OSError as error:
        what = f"Cannot keep the results there ({error.strerror})"
        raise InputError(what, str(path.parent), "make room, or name another folder") from None
    finally:
        partial.unlink(missing_ok=True)
