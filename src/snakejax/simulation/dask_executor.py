"""Executor of chunked computations on an existing Dask cluster."""

import logging
from collections.abc import Iterator, Mapping
from typing import Any

from snakejax.core.errors import InputError

from .chunks import Columns, Executor, Work

PATIENCE = 10
"""Seconds to wait for the scheduler, and for a first worker."""


class ClusterError(RuntimeError):
    """A computation on a cluster failed after it had started."""


def _on_worker(work: Work, chunk: Columns) -> Columns:
    from snakejax.core.jax_config import prepare_jax

    prepare_jax()
    return work(chunk)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        remedy = "pip install 'snakejax[cluster]'"
        raise InputError("Dask is not installed", "option --cluster", remedy) from None
    # Errors are reported in one line, so the log of Dask is silenced.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        what = f"No Dask scheduler answers at {address}"
        raise InputError(what, "option --cluster", "start one with `dask scheduler`, and give its address") from None


def cluster(address: str) -> Executor:
    """Executor on the workers of the Dask scheduler at `address`, such as tcp://host:8786; each needs this package.

    If a worker is lost, another one computes its chunk.
    **Raises:** `InputError` if Dask is not installed, no scheduler answers, or it has no workers; during the
    computation `ClusterError` if the scheduler is lost or a chunk fails on every worker.
    """
    with _client(address) as client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            what = f"The Dask scheduler at {address} has no workers"
            raise InputError(what, "option --cluster", f"start one with `dask worker {address}`") from None

    def shared(work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]:
        from distributed import as_completed

        with _client(address) as client:
            futures = {client.submit(_on_worker, work, chunk, pure=False): k for k, chunk in pieces.items()}
            for future in as_completed(list(futures), loop=client.loop):
                try:
                    result = future.result()
                except Exception as error:
                    why = str(error).splitlines()[0] if str(error) else type(error).__name__
                    raise ClusterError(f"The cluster at {address} failed ({why})") from error
                yield futures[future], result

    return shared
