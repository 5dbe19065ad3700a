"""Long work in pieces: shared out among the cores or a cluster, kept on disk piece by piece, and taken up again."""

import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Protocol

import equinox as eqx
import jax
import numpy as np

from ._errors import InputError
from ._lanes import PIECE, cores

Columns = Mapping[str, np.ndarray]
"""Numbers by name, one a lane each (V,), or what was found of each lane (V, ...)."""
Work = Callable[[Columns], Columns]
"""A function of some lanes alone, which gives the same numbers wherever and however often it runs."""


class Executor(Protocol):
    """Who computes: yields (number, result) of each piece as it is done."""

    def __call__(self, work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]: ...


def local(work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]:
    """The cores of this machine; where JAX has several devices each piece is shared out among them."""
    with ThreadPoolExecutor(1 if jax.local_device_count() > 1 else cores()) as pool:
        futures = {pool.submit(work, piece): number for number, piece in pieces.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def fingerprint(*parts: Any) -> str:
    """A hash of trees of arrays or texts: their structure, every bit of their leaves, the code of the classes in them
    and of this package, JAX's version, and how lanes are cut into pieces.
    """
    digest = hashlib.sha256()
    leaves, structure = jax.tree.flatten(parts)
    digest.update(f"{structure} {jax.__version__} {piece_size()}".encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    for kind in sorted(_classes(parts), key=lambda kind: kind.__qualname__):
        for name, method in vars(kind).items():
            code = getattr(method, "__code__", None)
            digest.update(f"{name} {code and (code.co_code, code.co_consts, code.co_names)}".encode())
    for leaf in leaves:
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def _classes(tree: Any) -> set[type]:
    """The classes of modules below `tree` that a user wrote."""
    found: set[type] = set()
    for node in jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, eqx.Module)):
        if isinstance(node, eqx.Module):
            if not type(node).__module__.startswith("snakejax."):
                found.add(type(node))
            found |= _classes([getattr(node, field.name) for field in dataclasses.fields(node)])  # type: ignore
    return found


def piece_size() -> int:
    """Lanes of one piece."""
    return PIECE * jax.local_device_count()


def in_pieces(
    work: Work,
    columns: Columns,
    *,
    folder: Path | None = None,
    executor: Executor = local,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, np.ndarray]:
    """`work` on all lanes of `columns`, piece by piece.

    With a `folder` each piece is kept there as soon as it is done, and a call that finds pieces there does the rest
    alone; the folder must belong to this work and these lanes. `progress` is told how many lanes are done, of how many.
    """
    count, size = length(columns), piece_size()
    missing = {
        k: {name: np.asarray(column)[first : first + size] for name, column in columns.items()}
        for k, first in enumerate(range(0, count, size))
    }
    found: dict[int, Columns] = {}
    if folder is not None:
        _writable(folder)
        found = {k: kept for k, piece in missing.items() if (kept := _kept(_file(folder, k), length(piece)))}
        missing = {k: piece for k, piece in missing.items() if k not in found}
    done = sum(map(length, found.values()))
    progress(done, count)
    for k, result in executor(work, missing) if missing else ():
        found[k] = result
        if folder is not None:
            _keep(_file(folder, k), result)
        done += length(result)
        progress(done, count)
    return {name: np.concatenate([found[k][name] for k in sorted(found)]) for name in found[0]}


def _file(folder: Path, number: int) -> Path:
    return folder / f"piece-{number:06d}.npz"


def length(columns: Columns) -> int:
    """How many lanes there are."""
    return len(next(iter(columns.values())))


def _writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"Cannot keep the results there ({error.strerror})"
        raise InputError(what, str(folder), "name a folder you may write to") from None


def _kept(path: Path, count: int) -> dict[str, np.ndarray] | None:
    """What was kept of a piece of `count` lanes in `path`, or None where there is nothing whole."""
    try:
        with np.load(path) as file:
            found = {name: file[name] for name in file.files}
        return found if all(len(column) == count for column in found.values()) else None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _keep(path: Path, result: Columns) -> None:
    """Write `result` whole or not at all."""
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
