"""Work on an existing Dask cluster, the one room that knows Dask."""

import sys
from collections.abc import Iterator, Mapping

from ._errors import InputError
from ._pieces import Columns, Executor, Work

PATIENCE = 10
"""Seconds to wait for the scheduler."""


def _on_worker(work: Work, piece: Columns) -> Columns:
    from ._prepare import prepare_jax

    prepare_jax()
    return work(piece)


def cluster(address: str) -> Executor:
    """The workers of the Dask scheduler at `address`, such as tcp://host:8786; each needs this package.

    A piece whose worker dies is computed by another. **Raises:** `InputError` where Dask is not installed or no
    scheduler answers.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        what = "Dask is not installed"
        raise InputError(what, "option --cluster", "pip install 'snakejax[cluster]'") from None
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        what = f"No Dask scheduler answers at {address}"
        raise InputError(what, "option --cluster", "start one with `dask scheduler`, and give its address") from None

    def shared(work: Work, pieces: Mapping[int, Columns]) -> Iterator[tuple[int, Columns]]:
        _by_value(work)
        with client:
            futures = {client.submit(_on_worker, work, piece, pure=False): k for k, piece in pieces.items()}
            for future, result in as_completed(list(futures), loop=client.loop, with_results=True):
                yield futures[future], result

    return shared


def _by_value(work: Work) -> None:
    """Send classes that a user loaded from a file of their own along, since no worker could import them."""
    import cloudpickle

    for name, module in list(sys.modules.items()):
        if name.startswith("_snakejax_effect_"):
            cloudpickle.register_pickle_by_value(module)
