"""Work in pieces: stopped and taken up again, and on a real cluster of processes."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from snakejax import cluster, preset, sweep
from snakejax._cluster import ClusterError
from snakejax._errors import InputError
from snakejax._lanes import PIECE
from snakejax._pieces import fingerprint, in_pieces, local

LANES = {"a": np.arange(3.0 * PIECE + 5), "b": np.ones(3 * PIECE + 5)}


def square(columns):
    return {"square": columns["a"] ** 2 + columns["b"]}


def test_pieces_come_together_in_order_and_progress_is_told(tmp_path) -> None:
    told = []
    found = in_pieces(square, LANES, folder=tmp_path, progress=lambda done, total: told.append((done, total)))
    np.testing.assert_array_equal(found["square"], LANES["a"] ** 2 + 1)
    assert told[0] == (0, 3 * PIECE + 5) and told[-1] == (3 * PIECE + 5,) * 2 and len(told) == 5
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_what_is_kept_is_not_computed_again_and_what_is_broken_is(tmp_path) -> None:
    in_pieces(square, LANES, folder=tmp_path)
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == 4
    kept[1].unlink()
    kept[2].write_bytes(kept[2].read_bytes()[:100])
    seen = []

    def watched(columns):
        seen.append(float(columns["a"][0]))
        return square(columns)

    found = in_pieces(watched, LANES, folder=tmp_path)
    assert sorted(seen) == [PIECE, 2 * PIECE]
    np.testing.assert_array_equal(found["square"], LANES["a"] ** 2 + 1)


def test_a_failure_in_a_piece_is_raised_and_the_others_are_kept(tmp_path) -> None:
    def failing(columns):
        if columns["a"][0] == PIECE:
            raise ArithmeticError("no")
        return square(columns)

    def in_turn(work, pieces):
        for k in (0, 2, 3, 1):
            yield k, work(pieces[k])

    with pytest.raises(ArithmeticError):
        in_pieces(failing, LANES, folder=tmp_path, executor=in_turn)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_fingerprint_knows_every_bit() -> None:
    model = preset("paper-rotate").model
    other = preset("paper-forward").model.add()
    assert fingerprint(model, [1.0]) == fingerprint(other, [1.0])
    assert len({fingerprint(model, [1.0]), fingerprint(model, [np.nextafter(1.0, 2)]), fingerprint([1.0], model)}) == 3


SCRIPT = """
import sys, time, numpy as np, snakejax as sj
sj.prepare_jax()
example = sj.preset("paper-rotate")
D = np.linspace(0.5, 10, {lanes})
def slowly(work, pieces):
    from snakejax._pieces import local
    for k, found in local(work, pieces):
        yield k, found
        time.sleep({pause})
found = sj.sweep(example.model, example.gait, [1.0, 2.0], {{"tyre.D": D}}, folder=sys.argv[1], executor=slowly)
np.save(sys.argv[2], found.heading.values)
"""


@pytest.mark.slow
def test_a_sweep_killed_half_way_goes_on_and_ends_the_same_to_the_last_bit(tmp_path) -> None:
    def started(pause: float, folder: str) -> subprocess.Popen:
        script = tmp_path / f"sweep-{pause}.py"
        script.write_text(SCRIPT.format(lanes=5 * PIECE, pause=pause))
        return subprocess.Popen([sys.executable, script, tmp_path / folder, tmp_path / f"{folder}.npy"])

    broken = started(0.5, "broken")
    deadline = time.monotonic() + 240
    while len(kept := list((tmp_path / "broken").glob("*/*.npz"))) < 2 and broken.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    broken.send_signal(signal.SIGKILL)
    assert broken.wait() == -signal.SIGKILL
    kept = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "broken").glob("*/*.npz")}
    assert 2 <= len(kept) < 5
    assert started(0.0, "broken").wait() == 0 and started(0.0, "whole").wait() == 0
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "broken").glob("*/*.npz")}
    assert len(after) == 5 and all(after[name] == when for name, when in kept.items())
    np.testing.assert_array_equal(np.load(tmp_path / "broken.npy"), np.load(tmp_path / "whole.npy"))


@pytest.mark.slow
def test_a_cluster_of_processes_finds_the_same_and_a_killed_worker_loses_nothing() -> None:
    from distributed import Client, LocalCluster

    example = preset("paper-rotate")
    over = {"tyre.D": np.linspace(0.5, 10, 6 * PIECE)}
    here = sweep(example.model, example.gait, [1.0, 2.0], over)
    told = []

    def watch(done, total):
        told.append(done)
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
    assert told[-1] == 6 * PIECE and len(told) == 7


def fail(columns):
    raise ArithmeticError("the third wheel came off")


@pytest.mark.slow
def test_what_goes_wrong_on_a_cluster_is_one_line() -> None:
    from distributed import LocalCluster

    with LocalCluster(1, threads_per_worker=1, dashboard_address=None, processes=False) as workers:
        work = cluster(workers.scheduler_address)
        for _ in range(2):  # it can be used again
            assert dict(work(square, {3: {"a": np.ones(1), "b": np.ones(1)}}))[3]["square"] == [2.0]
        with pytest.raises(ClusterError, match="the third wheel came off"):
            dict(work(fail, {0: {"a": np.ones(1)}}))
    nobody = LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None, processes=False)
    with nobody, pytest.raises(InputError, match="has no workers"):
        cluster(nobody.scheduler_address)


def test_a_fingerprint_knows_the_code_of_an_effect_of_ones_own() -> None:
    def loaded(slope: float):
        space: dict = {"__name__": "mine"}
        exec(
            "from snakejax import Force, param\n"
            "class Spring(Force):\n"
            "    k: float = param('N/m', default=0.0)\n"
            "    def wrench(self, motion):\n"
            f"        return {slope} * self.k * motion.x, 0.0 * motion.x, 0.0 * motion.x\n",
            space,
        )
        return preset("paper-rotate").model.add(spring=space["Spring"]())

    assert fingerprint(loaded(1.0)) == fingerprint(loaded(1.0)) != fingerprint(loaded(2.0))


def test_a_scheduler_that_is_not_there_is_one_line() -> None:
    with pytest.raises(InputError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        cluster("tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="No Dask scheduler answers at nonsense"):
        cluster("nonsense://x")


def test_all_is_local_without_a_cluster() -> None:
    assert dict(local(square, {3: {"a": np.zeros(1), "b": np.ones(1)}}))[3]["square"] == [1.0]
