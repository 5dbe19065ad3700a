"""Simulated vehicles a second: snakeboards and cars of two axles, by each of our engines.

    python benchmarks/vehicle_throughput.py [REPEATS]

`COUNT` boards with the tyres of recordings and `COUNT` cars with as stiff ones run under `free` for `SECONDS` s, all on
all cores. Mass, inertia or length, and each number of the tyres is varied by 10 %. Both end within `WITHIN` m of what
a hundredth of the tolerance gives. The two alternate REPEATS times; the ratio is the median of those of neighbours.
"""

import os
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from snakejax import prepare_jax

prepare_jax()

import jax.numpy as jnp  # noqa: E402

from snakejax import Accuracy, Board, Gait, Model, Pacejka, Sines, Tracked, simulate_many, stacked  # noqa: E402
from snakejax.core.parameter import parameters, with_parameters  # noqa: E402
from snakejax.dynamics.axle_tyres import FrontRear  # noqa: E402
from snakejax.dynamics.inputs import AbstractInputs, Inputs  # noqa: E402
from snakejax.simulation.ensemble import Engine  # noqa: E402
from snakejax.vehicles.car import DART, Car  # noqa: E402

COUNT, SECONDS, WITHIN = 10_000, 7.7, 1e-6
SAMPLE = 64
"""Vehicles by which the tolerance is chosen."""
TOLERANCES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8)
VARIED = 0.1


def board() -> tuple[Model, AbstractInputs, tuple[str, ...]]:
    """A snakeboard with the tyres of recordings, its inputs, and what is varied."""
    numbers = dict(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25, creep_speed=0.01)
    gait = Gait(*(Tracked(Sines.of([row]), 100.0, 10.0) for row in ([0.916, 4.0, 0.1], [1.57, 4.0, 0.1])))
    varied = ("board.mass", "board.half_length", "board.rotor_inertia", *(f"tyre.{name}" for name in "BCDE"))
    return Model(Board(**numbers), Pacejka(8.0, 1.4, 4.0, 0.1), "free"), gait, varied


def car() -> tuple[Model, AbstractInputs, tuple[str, ...]]:
    """A car with a tyre for each axle, its inputs, and what is varied."""
    tyre = Pacejka(4.0, 1.3, 3.0, 0.1)
    model = Model(Car(**DART, force_gain=20.0, speed_loss=2.0), FrontRear(tyre, tyre), "free")
    inputs = Inputs({"steer": Sines.of([[0.35, 1.2, 0.0]]), "drive": Sines.of([[0.2, 0.0, np.pi / 2]])})
    axles = (name for name in parameters(model) if name.startswith("tyre.") and name[-1] in "BCDE")
    return model, inputs, ("board.mass", "board.inertia", *axles)


def many(model: Model, varied: tuple[str, ...], count: int) -> Model:
    """`count` copies of `model` with other numbers."""
    rng, known = np.random.default_rng(0), parameters(model)
    spread = {name: rng.uniform(1 - VARIED, 1 + VARIED, count) for name in varied}
    values = {name: jnp.asarray(float(known[name].value) * spread[name]) for name in varied}
    return with_parameters(stacked([model] * count), values)


def ready(vehicle: Callable[[], tuple[Model, AbstractInputs, tuple[str, ...]]], engine: Engine) -> Callable[[], object]:
    """The simulation of all vehicles at the loosest tolerance with which the sample ends within `WITHIN`."""
    model, inputs, varied = vehicle()

    def ends(models: Model, rtol: float) -> np.ndarray:
        accuracy = Accuracy(rtol=rtol, atol=rtol / 100, max_steps=10**6)
        return simulate_many(models, inputs, [SECONDS], accuracy=accuracy, engine=engine)[:, 0, :2]

    sample = many(model, varied, SAMPLE)
    reference = ends(sample, TOLERANCES[-1] / 100)
    loosest = next(rtol for rtol in TOLERANCES if np.abs(ends(sample, rtol) - reference).max() < WITHIN)
    everyone = many(model, varied, COUNT)
    return lambda: ends(everyone, loosest)


def seconds(work: Callable[[], object]) -> float:
    """How long `work` takes."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def main(repeats: int) -> None:
    """Print a row for each engine."""
    print(f"{COUNT} of each, {SECONDS} s, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    for engine in ("tsit5", "taylor"):
        both = [ready(vehicle, engine) for vehicle in (board, car)]
        for work in both:
            work()  # compiles
        pairs = [[seconds(work) for work in both] for _ in range(repeats)]
        boards, cars = (COUNT / statistics.median(column) for column in zip(*pairs, strict=True))
        ratio = statistics.median(one / other for one, other in pairs)
        print(f"{engine:7} {boards:9.0f} boards/s {cars:9.0f} cars/s   cars over boards {ratio:.2f}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
