"""The motion of each vehicle that the package has, drawn for the docs.

    python fit/vehicles.py [FOLDER]

simulates a car, a skid-steer robot, a sleigh and a roller racer for some seconds and writes a picture of each into
FOLDER (default `docs/gallery`): its path, and the vehicle at seven times. Some twenty seconds.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import snakejax as sj
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import no_traction
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.signals import AbstractSignal, Sines
from snakejax.present import plot
from snakejax.present.views import view_of_model
from snakejax.vehicles.car import DART, Car
from snakejax.vehicles.roller_racer import ROLLER_RACER, RollerRacer
from snakejax.vehicles.skid_steer import HUSKY, SkidSteer
from snakejax.vehicles.sleigh import ICE_SLEIGH, Sleigh

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "gallery"

REST = (0.0, 0.0, 0.0)
"""A start at the origin."""

Story = tuple[sj.Model, Mapping[str, AbstractSignal], float, tuple[float, ...]]


def stories() -> dict[str, Story]:
    """By kind: a model, its inputs, how long it is simulated [s], and its start."""
    tyre = sj.Pacejka(4.0, 1.3, 3.0, 0.0)
    car = sj.Model(Car(**DART, force_gain=20.0, speed_loss=2.0), FrontRear(tyre, tyre), "free")
    robot = sj.Model(SkidSteer(**HUSKY), sj.Pacejka(6.0, 1.2, 50.0, 0.0), "free")
    sleigh = sj.Model(Sleigh(**ICE_SLEIGH), no_traction(), "ideal")
    racer = sj.Model(RollerRacer(**ROLLER_RACER), no_traction(), "ideal")
    levels = np.array([0.0, 2.0, 5.0])
    left, right = Held.of(levels, np.array([4.0, 6.0, 1.0])), Held.of(levels, np.array([4.0, 1.0, 6.0]))
    return {
        "car": (
            car,
            {"steer": Sines.of([[0.35, 1.2, 0.0]]), "drive": Held.of(levels[:1], np.array([0.2]))},
            10.0,
            REST,
        ),
        "skid_steer": (robot, {"left": left, "right": right}, 8.0, REST),
        "sleigh": (sleigh, {}, 1.2, (*REST, 0.2, 0.0, 8.0)),
        "roller_racer": (racer, {"handle": Sines.of([[0.8, 3.0, 0.0]])}, 6.5, REST),
    }


def picture(kind: str, story: Story, folder: Path) -> None:
    """Simulate and draw one vehicle."""
    model, inputs, seconds, start = story
    times = jnp.arange(0.0, seconds, 0.01)
    unseen = jnp.full((len(times), 3), jnp.nan)
    run = sj.Run(kind, "train", times, unseen, Inputs(dict(inputs)), moving=len(start) > len(REST))
    view = view_of_model(model, [run], np.array([start]))
    plot.save(plot.snapshots(view, model.board), folder, f"vehicle-{kind}")


def main(folder: Path = FOLDER) -> None:
    """Draw everything."""
    for kind, story in stories().items():
        picture(kind, story, folder)


if __name__ == "__main__":
    sj.prepare_jax()
    main(*map(Path, sys.argv[1:]))
