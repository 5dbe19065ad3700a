"""What a made-up board is: its runs, what is true of it, and what case.toml says."""

import dataclasses

import numpy as np
from layout import vector
from noise import Noise
from solve import poses

GAITS = {
    "train-forward-1": ([[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "train-forward-2": ([[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "train-rotate-1": ([[0.916, 2.0, 0.0]], [[1.57, 4.0, 0.0]]),
    "train-arc-1": ([[0.5, 3.0, 0.0], [0.25, 0.6, 0.0]], [[1.57, 3.0, 0.0]]),
    "train-wander-1": ([[0.5, 2.1, 0.0], [0.3, 3.7, 0.4]], [[1.2, 2.1, 0.2], [0.9, 4.3, 0.0]]),
    "heldout-reverse-1": ([[0.7, 3.0, 0.0]], [[1.4, 3.0, 3.14159265]]),
    "heldout-sweep-1": ([[0.4, 1.7, 0.3], [0.4, 2.9, 0.0]], [[1.0, 1.7, 0.0], [1.0, 2.9, 1.0]]),
}
"""Steering and rotor of the runs of the recordings, sums of [amplitude in rad, rad/s, phase]."""


@dataclasses.dataclass(frozen=True)
class Run:
    """One run: its name, commands, frames in s, start of the body, and what is other in it than in the rest."""

    name: str
    phi: list
    psi: list
    times: np.ndarray
    start: np.ndarray
    odd: dict = dataclasses.field(default_factory=dict)

    @property
    def role(self) -> str:
        """`train` or `heldout`."""
        return self.name.split("-")[0]

    def path(self, values: dict) -> np.ndarray:
        """The noiseless poses of a board of `values` in this run."""
        return poses(vector(values | self.odd), self.phi, self.psi, self.times, self.start)

    def moved(self, start: np.ndarray) -> "Run":
        """The same from another start."""
        return dataclasses.replace(self, start=start)


@dataclasses.dataclass(frozen=True)
class Hidden:
    """A board: what case.toml says of it, what is true, its runs and noise, and which part each hidden effect plays."""

    name: str
    skid: str
    stated: dict
    values: dict
    runs: tuple[Run, ...]
    noise: Noise
    noise_stated: bool
    strong: str | None = None
    weak: tuple[str, ...] = ()
    strange: str | None = None

    @property
    def train(self) -> list[Run]:
        """The runs to train on."""
        return [run for run in self.runs if run.role == "train"]

    @property
    def heldout(self) -> list[Run]:
        """The others."""
        return [run for run in self.runs if run.role == "heldout"]
