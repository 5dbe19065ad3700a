"""Chunks on a real cluster of processes."""

import os
import signal

import numpy as np
import pytest

from snakejax import cluster, preset, sweep
from snakejax.core.errors import InputError
from snakejax.simulation import dask_executor
from snakejax.simulation.chunks import local_executor
from snakejax.simulation.dask_executor import ClusterError
from snakejax.simulation.ensemble import CHUNK


def square(columns):
    return {"square": columns["a"] ** 2 + columns["b"]}


@pytest.mark.slow
def test_a_cluster_of_processes_finds_the_same_and_a_killed_worker_loses_nothing() -> None:
    from distributed import Client, LocalCluster

    example = preset("paper-rotate")
    over = {"tyre.D": np.linspace(0.5, 10, 6 * CHUNK)}
    here = sweep(example.model, example.gait, [1.0, 2.0], over)
    told = []

    def watch(event):
        told.append(event.done)
        if len(told) == 3:
            with Client(workers.scheduler_address, set_as_default=False) as client:
                os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

    with LocalCluster(2, threads_per_worker=1, dashboard_address=None) as workers:
        there = sweep(
            example.model,
            example.gait,
            [1.0, 2.0],
            over,
            executor=cluster(workers.scheduler_address),
            progress=watch,
        )
    np.testing.assert_array_equal(here.heading, there.heading)
    assert told[-1] == 6 * CHUNK and len(told) == 7


def fail(columns):
    raise ArithmeticError("the third wheel came off")


@pytest.mark.slow
def test_what_goes_wrong_on_a_cluster_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    with LocalCluster(1, threads_per_worker=1, dashboard_address=None, processes=False) as workers:
        work = cluster(workers.scheduler_address)
        for _ in range(2):  # it can be used again
            assert dict(work(square, {3: {"a": np.ones(1), "b": np.ones(1)}}))[3]["square"] == [2.0]
        with pytest.raises(ClusterError, match="the third wheel came off"):
            dict(work(fail, {0: {"a": np.ones(1)}}))
    monkeypatch.setattr(dask_executor, "PATIENCE", 1.0)
    nobody = LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None, processes=False)
    with nobody, pytest.raises(InputError, match="has no workers"):
        cluster(nobody.scheduler_address)


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_executor, "PATIENCE", 1.0)
    with pytest.raises(InputError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        cluster("tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="No Dask scheduler answers at nonsense"):
        cluster("nonsense://x")


def test_all_is_local_without_a_cluster() -> None:
    assert dict(local_executor(square, {3: {"a": np.zeros(1), "b": np.ones(1)}}))[3]["square"] == [1.0]
