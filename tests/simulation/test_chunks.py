"""Work in pieces: stopped and taken up again, and on a real cluster of processes."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from snakejax import preset
from snakejax.simulation.chunks import fingerprint, map_chunks
from snakejax.simulation.ensemble import CHUNK

LANES = {"a": np.arange(3.0 * CHUNK + 5), "b": np.ones(3 * CHUNK + 5)}


def square(columns):
    return {"square": columns["a"] ** 2 + columns["b"]}


def test_pieces_come_together_in_order_and_progress_is_told(tmp_path) -> None:
    told = []
    found = map_chunks(square, LANES, folder=tmp_path, progress=lambda event: told.append((event.done, event.total)))
    np.testing.assert_array_equal(found["square"], LANES["a"] ** 2 + 1)
    assert told[0] == (0, 3 * CHUNK + 5) and told[-1] == (3 * CHUNK + 5,) * 2 and len(told) == 5
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_what_is_kept_is_not_computed_again_and_what_is_broken_is(tmp_path) -> None:
    map_chunks(square, LANES, folder=tmp_path)
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == 4
    kept[1].unlink()
    kept[2].write_bytes(kept[2].read_bytes()[:100])
    seen = []

    def watched(columns):
        seen.append(float(columns["a"][0]))
        return square(columns)

    found = map_chunks(watched, LANES, folder=tmp_path)
    assert sorted(seen) == [CHUNK, 2 * CHUNK]
    np.testing.assert_array_equal(found["square"], LANES["a"] ** 2 + 1)


def test_a_failure_in_a_piece_is_raised_and_the_others_are_kept(tmp_path) -> None:
    def failing(columns):
        if columns["a"][0] == CHUNK:
            raise ArithmeticError("no")
        return square(columns)

    def in_turn(work, pieces):
        for k in (0, 2, 3, 1):
            yield k, work(pieces[k])

    with pytest.raises(ArithmeticError):
        map_chunks(failing, LANES, folder=tmp_path, executor=in_turn)
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
    from snakejax.simulation.chunks import local_executor
    for k, found in local_executor(work, pieces):
        yield k, found
        time.sleep({pause})
found = sj.sweep(example.model, example.gait, [1.0, 2.0], {{"tyre.D": D}}, folder=sys.argv[1], executor=slowly)
np.save(sys.argv[2], found.heading.values)
"""


@pytest.mark.slow
def test_a_sweep_killed_half_way_goes_on_and_ends_the_same_to_the_last_bit(tmp_path) -> None:
    def started(pause: float, folder: str) -> subprocess.Popen:
        script = tmp_path / f"sweep-{pause}.py"
        script.write_text(SCRIPT.format(lanes=5 * CHUNK, pause=pause))
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


def test_a_fingerprint_knows_the_code_of_an_effect_of_ones_own() -> None:
    def with_payload(slope: float):
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

    assert fingerprint(with_payload(1.0)) == fingerprint(with_payload(1.0)) != fingerprint(with_payload(2.0))
