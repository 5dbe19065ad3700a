"""How often the hidden effect is found on other vehicles than the board: made-up recordings of each.

    python benchmarks/vehicles.py SCRATCH [--kind KIND] [--number N] [--table FILE]

Each recording holds one effect of `library(vehicle)`, drawn without repetition, with a random sign where both signs
mean something. Its size is the one that moves the runs of the train set, tyre unchanged, by STRENGTH times the noise
(root mean square). The tyre differs by up to 15% from a preset and is unknown to the case; the constants of the vehicle
are stated as they are. Four train runs and two held-out runs of SECONDS s, a pose every 0.02 s with 0.2 mm and
0.5 mrad of white noise. `right` is a recording that is "explained" by that effect alone, or by one of which the result
says that these runs cannot tell the two apart. Where the model without the effect leaves only noise once its tyre and
constants are fitted, held-out runs included, the runs do not show it: "adequate" is right then, and it is not counted.
SCRATCH keeps cases and results, so that a stopped benchmark goes on.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from snakejax import prepare_jax

prepare_jax()

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from helpers.vehicle_case import HEADING, POSITION, Commands, Runs, poses, steps, write_case  # noqa: E402

import snakejax as sj  # noqa: E402
from snakejax.core.parameter import parameters  # noqa: E402
from snakejax.dynamics.axle_tyres import FrontRear  # noqa: E402
from snakejax.dynamics.model import Model  # noqa: E402
from snakejax.dynamics.tyres import AbstractTyre, Pacejka  # noqa: E402
from snakejax.effects import Effect, library  # noqa: E402
from snakejax.vehicles.car import DART  # noqa: E402
from snakejax.vehicles.registry import vehicle_class  # noqa: E402
from snakejax.vehicles.roller_racer import ROLLER_RACER  # noqa: E402
from snakejax.vehicles.skid_steer import HUSKY  # noqa: E402
from snakejax.vehicles.sleigh import ICE_SLEIGH  # noqa: E402

SECONDS, LEVEL = 5.0, 0.7
"""Length of a run, and for which a commanded level lasts [s]."""

STRENGTH = 40.0
"""What the hidden effect moves, in multiples of the noise: some 8 mm and 20 mrad."""

NOISE_ALONE = 1.2
"""Two held-out runs of 250 frames without an effect stay below this mean square, in units of the noise: 1 +- 0.04."""

RUNS = ("train-1", "train-2", "train-3", "train-4", "held-1", "held-2")


class Vehicle(NamedTuple):
    """What is drawn for a kind of vehicle: its constants, a tyre, the commands of a run, and how a run starts."""

    constants: Mapping[str, float]
    tyre: Callable[[np.random.Generator], AbstractTyre]
    commands: Callable[[np.random.Generator], Commands]
    start: Callable[[np.random.Generator], tuple[float, ...]]


def near(rng: np.random.Generator, *values: float) -> list[float]:
    """`values`, each up to 15% larger or smaller."""
    return [value * rng.uniform(0.85, 1.15) for value in values]


def levels(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """Commands that hold random levels for LEVEL seconds each."""
    return steps(rng, SECONDS, low, high, LEVEL)


def resting(rng: np.random.Generator) -> tuple[float, ...]:
    """A start at rest."""
    return (*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))


def pushed(rng: np.random.Generator) -> tuple[float, ...]:
    """A sleigh that is pushed off, turning, its blade without slip."""
    rate = rng.choice([-1, 1]) * rng.uniform(2.0, 5.0)
    return (*resting(rng), rng.uniform(0.8, 1.5), ICE_SLEIGH["arm"] * rate, rate)


VEHICLES = {
    "car": Vehicle(
        {**DART, "steering_ratio": 0.45, "force_gain": 22.0, "speed_loss": 1.5},
        lambda rng: FrontRear(Pacejka(*near(rng, 6, 1.4, 6, 0.1)), Pacejka(*near(rng, 8, 1.4, 5.5, 0.1))),
        lambda rng: {"steer": levels(rng, -0.6, 0.6), "drive": levels(rng, 0.03, 0.15)},
        resting,
    ),
    "skid_steer": Vehicle(
        HUSKY,
        lambda rng: Pacejka(*near(rng, 5.0, 1.3, 60.0, 0.1)),
        lambda rng: {side: levels(rng, -2.0, 7.0) for side in ("left", "right")},
        resting,
    ),
    "sleigh": Vehicle(ICE_SLEIGH, lambda rng: Pacejka(*near(rng, 4.0, 1.3, 6.0, 0.1)), lambda _: {}, pushed),
    "roller_racer": Vehicle(
        ROLLER_RACER,
        lambda rng: Pacejka(*near(rng, 5.0, 1.3, 4.0, 0.1)),
        lambda rng: {"handle": np.array([[rng.uniform(0.4, 0.9), rng.uniform(2.0, 4.0), rng.uniform(0, 6.3)]])},
        resting,
    ),
}


class Recording(NamedTuple):
    """One made-up recording: its true model without the effect, and the commands and starts of its runs."""

    vehicle: Vehicle
    model: Model
    runs: Runs

    def moved(self, before: list[np.ndarray], name: str, effect: Effect) -> float:
        """What an effect moves, root mean square over the train runs, in multiples of the noise."""
        after = poses(self.model.add(**{name: effect}), self.runs, SECONDS)
        off = [
            (then - now) / [POSITION, POSITION, HEADING]
            for run, then, now in zip(RUNS, after, before, strict=True)
            if run.startswith("train")
        ]
        return float(np.sqrt(np.mean(np.square(off))))


def recording(kind: str, number: int) -> Recording:
    """The recording of this kind and number."""
    rng = np.random.default_rng([19, list(VEHICLES).index(kind), number])
    vehicle = VEHICLES[kind]
    model = Model(vehicle_class(kind)(**vehicle.constants), vehicle.tyre(rng), "free")
    return Recording(vehicle, model, {run: (vehicle.commands(rng), vehicle.start(rng)) for run in RUNS})


def sized(made: Recording, name: str, rng: np.random.Generator) -> Effect | None:
    """The effect at the size that moves STRENGTH times the noise, by bisection; None where no size does."""
    neutral = library(made.model.board)[name]()
    if neutral.inapplicable_because(made.model):
        return None
    fields = {f: p.domain for f, p in parameters(neutral).items()}
    towards = {
        f: rng.uniform(0.5, 1.0) * (1.0 if d.positive or d.low == 0 else rng.choice([-1.0, 1.0]))
        for f, d in fields.items()
    }
    before = poses(made.model, made.runs, SECONDS)

    def effect(size: float) -> Effect | None:
        values = {f: size * t for f, t in towards.items()}
        inside = all(fields[f].low < v < fields[f].high for f, v in values.items())
        return library(made.model.board)[name](**values) if inside else None

    low, high = 0.0, 1e-4
    while (tried := effect(high)) is not None and (m := made.moved(before, name, tried)) < STRENGTH:
        low, high = high, 3 * high
        if not np.isfinite(m):
            return None
    if tried is None:
        return None
    for _ in range(8):
        middle = (low + high) / 2 if low else high / 3
        tried = effect(middle)
        low, high = (middle, high) if tried and made.moved(before, name, tried) < STRENGTH else (low, middle)
    return effect(high)


def hidden(kind: str, number: int, taken: set[str]) -> tuple[Recording, str, Effect]:
    """A recording with its effect: the first in a random order that is not `taken` yet and that shows at some size."""
    made, rng = recording(kind, number), np.random.default_rng([19, 7, list(VEHICLES).index(kind)])
    for name in map(str, rng.permutation(list(library(made.model.board)))):
        if name not in taken:
            found = sized(made, name, np.random.default_rng([19, 8, number]))
            if found is not None:
                return made, name, found
    raise ValueError(f"no further effect of a {kind} shows")


def judged(folder: Path, name: str, effect: Effect) -> dict[str, Any]:
    """What `explain` says of a case, beside the truth."""
    begin = time.perf_counter()
    found = sj.explain(folder)
    alike = {r.effect: r.confusable_with for r in found.final.ranking or found.base.ranking}
    same = len(found.effects) == 1 and (name == found.effects[0] or name in alike.get(found.effects[0], ()))
    return {
        "effect": name,
        "values": {f: float(p.value) for f, p in parameters(effect).items()},
        "verdict": found.verdict,
        "effects": list(found.effects),
        "estimates": {name: [e.value, e.sd] for name, e in found.final.estimates.items()},
        "held_out": [step.heldout.misfit if step.heldout else None for step in (found.base, found.final)],
        "right": found.verdict == "explained" and same,
        "shown": not (found.verdict == "adequate" and found.final.heldout.misfit < NOISE_ALONE),
        "seconds": time.perf_counter() - begin,
    }


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """The results, kind by kind."""
    lines = []
    for kind, rows in results.items():
        shown = [row for row in rows if row["shown"]]
        lines.append(f"{kind}: {sum(row['right'] for row in shown)} of {len(shown)} right")
        for row in rows:
            values = ", ".join(f"{value:.3g}" for value in row["values"].values())
            held = " -> ".join("none" if m is None else f"{m:.4g}" for m in row["held_out"])
            said = ", ".join(row["effects"]) or "nothing"
            said, seconds = f"{row['verdict']}: {said}", f"{row['seconds']:.0f} s"
            mark = " " if row["right"] else "x" if row["shown"] else "-"
            lines.append(f"  {mark} {row['effect']:22} {values:18} {said}; held out {held}; {seconds}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make and explain the recordings that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--kind", choices=list(VEHICLES), help="this kind only")
    parser.add_argument("--number", type=int, default=10, help="so many recordings of a kind (default 10)")
    parser.add_argument("--table", type=Path, help="write the table there too")
    asked = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {}
    for kind in [asked.kind] if asked.kind else VEHICLES:
        for number in range(asked.number):
            folder, result = asked.scratch / f"{kind}-{number}", asked.scratch / f"{kind}-{number}.json"
            if not result.is_file():
                made, name, effect = hidden(kind, number, {row["effect"] for row in results.get(kind, [])})
                if not folder.is_dir():
                    seed = [19, 9, list(VEHICLES).index(kind), number]
                    truth = made.model.add(**{name: effect})
                    write_case(folder, kind, made.vehicle.constants, truth, made.runs, SECONDS, seed)
                result.write_text(json.dumps(judged(folder, name, effect)), encoding="utf-8")
            results.setdefault(kind, []).append(json.loads(result.read_text(encoding="utf-8")))
        print(table({kind: results[kind]}), flush=True)
    if asked.table:
        asked.table.write_text(table(results), encoding="utf-8")


if __name__ == "__main__":
    main()
