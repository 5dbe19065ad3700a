"""The speed of this checkout against that of another one: boards simulated a second, and a fit of recordings.

    python benchmarks/side_by_side.py OTHER_CHECKOUT [REPEATS]

One process for each checkout has its programs compiled. Then the two take turns, REPEATS times, so that a busy machine
slows both. The table has the median seconds of the wall clock and of the processors, and the ratio of this checkout to
the other: the median over the pairs, with its quartiles. Only public names are used, which both checkouts must have.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
BOARDS = 2048
SECONDS = 7.7
USUAL = {
    "board.mass": 7.0,
    "board.rotor_inertia": 0.0238,
    "board.half_length": 0.25,
    "tyre.B": 8.0,
    "tyre.C": 1.4,
    "tyre.D": 4.0,
    "tyre.E": 0.1,
}
"""Stiff tyres as in recordings; each board's are varied by 10 %."""


def boards() -> Callable[[], object]:
    """Simulate BOARDS different boards in one process on one core."""
    import equinox as eqx
    import jax.numpy as jnp
    import numpy as np

    from snakejax import Accuracy, Board, Gait, Model, Pacejka, Sines, Tracked, simulate_many, stacked

    board = Board(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25, creep_speed=0.01)
    models = stacked([Model(board, Pacejka(8.0, 1.4, 4.0, 0.1), "free")] * BOARDS)
    rng = np.random.default_rng(0)

    def leaves(model):
        return [getattr(getattr(model, name.split(".")[0]), name.split(".")[1]) for name in USUAL]

    varied = [jnp.asarray(value * rng.uniform(0.9, 1.1, BOARDS)) for value in USUAL.values()]
    models = eqx.tree_at(leaves, models, varied)
    amplitudes = [jnp.asarray(a * rng.uniform(0.9, 1.1, (BOARDS, 1))) for a in (0.916, 1.57)]
    joints = [Tracked(Sines(a, jnp.full_like(a, 4.0), jnp.full_like(a, 0.1)), *gains(BOARDS)) for a in amplitudes]
    start = np.full((BOARDS, 3), 0.1)
    how = dict(own_gaits=True, accuracy=Accuracy(rtol=1e-6, atol=1e-8), workers=1)
    return lambda: simulate_many(models, Gait(*joints), [SECONDS], start, **how)


def gains(count: int):
    """The gains of `count` controllers of a joint."""
    import jax.numpy as jnp

    return jnp.full(count, 100.0), jnp.full(count, 10.0)


def one_fit() -> Callable[[], object]:
    """Fit the tyre of level-board to its five recordings and score the runs held out."""
    from snakejax import load_case, starting_model
    from snakejax.estimation import fit

    case = load_case(HERE / "data" / "level-board")
    return lambda: fit(starting_model(case), case.runs, case.noise)


WORKS = {
    f"{BOARDS} boards, {SECONDS} s each, one core": boards,
    "fit of level-board, five runs, warm": one_fit,
}


def worker() -> None:
    """Do the work of a number that standard input names, and print the seconds it took."""
    from snakejax import prepare_jax

    prepare_jax()
    works = [make() for make in WORKS.values()]
    for work in works:
        work()
    print("ready", flush=True)
    for line in sys.stdin:
        begun = time.perf_counter(), time.process_time()
        works[int(line)]()
        print(time.perf_counter() - begun[0], time.process_time() - begun[1], flush=True)


def started(checkout: Path) -> subprocess.Popen:
    """A worker that imports the package of `checkout`."""
    path = {"PYTHONPATH": str(checkout / "src")}
    command = [sys.executable, __file__, "--worker"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, env={**os.environ, **path}, cwd=checkout, **pipes)
    if (answer := process.stdout.readline()) != "ready\n":
        raise SystemExit(f"The worker of {checkout} did not start: {answer!r}")
    return process


def timed(process: subprocess.Popen, work: int) -> tuple[float, ...]:
    """Seconds of the wall clock and of the processors."""
    process.stdin.write(f"{work}\n")
    process.stdin.flush()
    return tuple(map(float, process.stdout.readline().split()))


def main(other: str, repeats: str = "15") -> None:
    """Print the table."""
    pair = [started(HERE), started(Path(other).resolve())]
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {repeats} pairs")
    print(f"{'':<52} {'this':>8} {'other':>8} {'ratio':>7} {'quartiles':>14}")
    for number, name in enumerate(WORKS):
        rows = []
        for turn in range(int(repeats)):
            order = (0, 1) if turn % 2 else (1, 0)
            one = {k: timed(pair[k], number) for k in order}
            rows.append((one[0], one[1]))
        for clock, label in enumerate(("wall", "processor")):
            mine, theirs = ([row[k][clock] for row in rows] for k in (0, 1))
            ratios = [a / b for a, b in zip(mine, theirs, strict=True)]
            low, mid, high = statistics.quantiles(ratios, n=4)
            medians = f"{statistics.median(mine):8.3f} {statistics.median(theirs):8.3f}"
            ratio = f"{mid:7.3f} {low:7.3f} {high:6.3f}"
            print(f"{name if not clock else '':<42} {label:>9} {medians} {ratio}", flush=True)
    for process in pair:
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    worker() if sys.argv[1:] == ["--worker"] else main(*sys.argv[1:])
