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
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from snakejax import prepare_jax

prepare_jax()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import snakejax as sj  # noqa: E402
from snakejax.core.parameter import parameters  # noqa: E402
from snakejax.dynamics.axle_tyres import FrontRear  # noqa: E402
from snakejax.dynamics.inputs import Inputs  # noqa: E402
from snakejax.dynamics.model import Model  # noqa: E402
from snakejax.dynamics.sampled_signals import Held  # noqa: E402
from snakejax.dynamics.signals import AbstractSignal, Sines  # noqa: E402
from snakejax.dynamics.tyres import AbstractTyre, Pacejka  # noqa: E402
from snakejax.effects import Effect, library  # noqa: E402
from snakejax.recording.case_vehicle import key_of  # noqa: E402
from snakejax.simulation.integrate import simulate  # noqa: E402
from snakejax.vehicles.car import DART  # noqa: E402
from snakejax.vehicles.registry import vehicle_class  # noqa: E402
from snakejax.vehicles.roller_racer import ROLLER_RACER  # noqa: E402
from snakejax.vehicles.skid_steer import HUSKY  # noqa: E402
from snakejax.vehicles.sleigh import ICE_SLEIGH  # noqa: E402

POSITION, HEADING = 2e-4, 5e-4
"""Noise of a frame [m, rad]."""

SECONDS, FRAME, COMMAND, LEVEL = 5.0, 0.02, 0.1, 0.7
"""Length of a run, time between frames, between commands, and for which a commanded level lasts [s]."""

STRENGTH = 40.0
"""What the hidden effect moves, in multiples of the noise: some 8 mm and 20 mrad."""

NOISE_ALONE = 1.2
"""Two held-out runs of 250 frames without an effect stay below this mean square, in units of the noise: 1 +- 0.04."""

RUNS = ("train-1", "train-2", "train-3", "train-4", "held-1", "held-2")

Terms = Mapping[str, np.ndarray]


class Vehicle(NamedTuple):
    """What is drawn for a kind of vehicle: its constants, a tyre, the commands of a run, and how a run starts."""

    constants: Mapping[str, float]
    tyre: Callable[[np.random.Generator], AbstractTyre]
    commands: Callable[[np.random.Generator], Terms]
    held: bool
    start: Callable[[np.random.Generator], tuple[float, ...]]


def near(rng: np.random.Generator, *values: float) -> list[float]:
    """`values`, each up to 15% larger or smaller."""
    return [value * rng.uniform(0.85, 1.15) for value in values]


def levels(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    """Commands that hold random levels for LEVEL seconds each."""
    drawn = rng.uniform(low, high, int(SECONDS / LEVEL) + 2)
    return drawn[(np.arange(round(SECONDS / COMMAND) + 1) * COMMAND / LEVEL).astype(int)]


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
        True,
        resting,
    ),
    "skid_steer": Vehicle(
        HUSKY,
        lambda rng: Pacejka(*near(rng, 5.0, 1.3, 60.0, 0.1)),
        lambda rng: {side: levels(rng, -2.0, 7.0) for side in ("left", "right")},
        True,
        resting,
    ),
    "sleigh": Vehicle(ICE_SLEIGH, lambda rng: Pacejka(*near(rng, 4.0, 1.3, 6.0, 0.1)), lambda _: {}, False, pushed),
    "roller_racer": Vehicle(
        ROLLER_RACER,
        lambda rng: Pacejka(*near(rng, 5.0, 1.3, 4.0, 0.1)),
        lambda rng: {"handle": np.array([[rng.uniform(0.4, 0.9), rng.uniform(2.0, 4.0), rng.uniform(0, 6.3)]])},
        False,
        resting,
    ),
}


def signals(terms: Terms, held: bool) -> Inputs:
    """The inputs of a run."""

    def signal(values: np.ndarray) -> AbstractSignal:
        return Held.of(np.arange(len(values)) * COMMAND, values) if held else Sines.of(values)

    return Inputs({name: signal(values) for name, values in terms.items()})


def stack(*leaves: np.ndarray) -> np.ndarray:
    """One leaf of the inputs of all runs."""
    return np.stack(leaves)


@eqx.filter_jit
def simulated(model: Model, inputs: Inputs, starts: jax.Array) -> jax.Array:
    """The poses of all runs."""
    times = jnp.arange(0.0, SECONDS, FRAME)
    return jax.vmap(lambda given, start: simulate(model, given, times, tuple(start)).pose)(inputs, starts)


class Recording(NamedTuple):
    """One made-up recording: its true model without the effect, and the commands and starts of its runs."""

    vehicle: Vehicle
    model: Model
    runs: dict[str, tuple[Terms, tuple[float, ...]]]

    def poses(self, **effects: Effect) -> dict[str, np.ndarray]:
        """Of each run, without noise."""
        inputs = [signals(terms, self.vehicle.held) for terms, _ in self.runs.values()]
        model, stacked = jax.tree.map(jnp.asarray, (self.model.add(**effects), jax.tree.map(stack, *inputs)))
        starts = jnp.asarray([start for _, start in self.runs.values()])
        return dict(zip(self.runs, np.asarray(simulated(model, stacked, starts)), strict=True))

    def moved(self, before: dict[str, np.ndarray], name: str, effect: Effect) -> float:
        """What an effect moves, root mean square over the train runs, in multiples of the noise."""
        after = self.poses(**{name: effect})
        off = [(after[run] - before[run]) / [POSITION, POSITION, HEADING] for run in RUNS if run.startswith("train")]
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
    before = made.poses()

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


def write(made: Recording, name: str, effect: Effect, kind: str, number: int, folder: Path) -> None:
    """The case folder, with truth.json beside it for whoever wants to look."""
    rng = np.random.default_rng([19, 9, list(VEHICLES).index(kind), number])
    folder.mkdir(parents=True)
    units = {f: p.domain.unit for f, p in parameters(made.model.board).items()}
    lines = ['skid = "free"', "[vehicle]", f'kind = "{kind}"']
    lines += [f"{key_of(f, units[f])} = {float(value)!r}" for f, value in made.vehicle.constants.items()]
    lines += ["[noise]", f"position_m = {POSITION}", f"heading_rad = {HEADING}"]
    for run, pose in made.poses(**{name: effect}).items():
        terms, start = made.runs[run]
        noisy = pose + rng.normal(size=pose.shape) * [POSITION, POSITION, HEADING]
        table = np.column_stack([np.arange(len(pose)) * FRAME, noisy])
        np.savetxt(folder / f"{run}.csv", table, "%.7f", ",", header="time_s,x_m,y_m,heading_rad", comments="")
        lines += ["[[runs]]", f'role = "{"train" if run.startswith("train") else "heldout"}"']
        lines += [f'mocap = "{run}.csv"', 'object = "body"']
        lines += ['start = "moving"'] if len(start) > 3 else []
        if made.vehicle.held:
            at = np.arange(len(next(iter(terms.values())))) * COMMAND
            log, header = np.column_stack([at, *terms.values()]), ",".join(["time_s", *terms])
            np.savetxt(folder / f"{run}-log.csv", log, "%.6f", ",", header=header, comments="")
            lines += [f'joint_log = {{file = "{run}-log.csv", kind = "commanded", hold = true}}']
        else:
            lines += [f"{signal} = {values.tolist()!r}" for signal, values in terms.items()]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


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
                    write(made, name, effect, kind, number, folder)
                result.write_text(json.dumps(judged(folder, name, effect)), encoding="utf-8")
            results.setdefault(kind, []).append(json.loads(result.read_text(encoding="utf-8")))
        print(table({kind: results[kind]}), flush=True)
    if asked.table:
        asked.table.write_text(table(results), encoding="utf-8")


if __name__ == "__main__":
    main()
