"""Long work in pieces: shared out among the cores or a cluster, kept on disk piece by piece, and taken up again."""

import hashlib
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

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
    """A hash of trees of arrays or texts: their structure, every bit of their leaves, and this package's version."""
    digest = hashlib.sha256()
    leaves, structure = jax.tree.flatten(parts)
    digest.update(str(structure).encode())
    digest.update(version("snakejax").encode())
    for leaf in leaves:
        array = np.asarray(leaf)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


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
    count = len(next(iter(columns.values())))
    size = PIECE * jax.local_device_count()
    missing = {
        k: {name: np.asarray(column)[first : first + size] for name, column in columns.items()}
        for k, first in enumerate(range(0, count, size))
    }
    found: dict[int, Columns] = {}
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        found = {k: kept for k in missing if (kept := _kept(_file(folder, k))) is not None}
        missing = {k: piece for k, piece in missing.items() if k not in found}
    done = sum(len(next(iter(piece.values()))) for piece in found.values())
    progress(done, count)
    for k, result in executor(work, missing) if missing else ():
        found[k] = result
        if folder is not None:
            _keep(_file(folder, k), result)
        done += len(next(iter(result.values())))
        progress(done, count)
    return {name: np.concatenate([found[k][name] for k in sorted(found)]) for name in found[0]}


def _file(folder: Path, number: int) -> Path:
    return folder / f"piece-{number:06d}.npz"


def _kept(path: Path) -> dict[str, np.ndarray] | None:
    """What was kept in `path`, or None where there is nothing whole."""
    try:
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _keep(path: Path, result: Columns) -> None:
    """Write `result` whole or not at all."""
    partial = path.with_suffix(f".{os.getpid()}.tmp")
    with partial.open("wb") as file:
        np.savez(file, **{name: np.asarray(column) for name, column in result.items()})
    partial.replace(path)
