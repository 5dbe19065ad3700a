"""The boards of the paper and how they move."""

import numpy as np

import snakejax as sj

FRAMES = 701
STRUCTURES = ("coupled", "free")


def times(example: sj.Preset) -> np.ndarray:
    return np.linspace(0.0, example.duration, FRAMES)


def board(example: sj.Preset, tyre=None, constraint: str = "coupled") -> sj.Model:
    """The board of an example with another tyre or structure; a car tyre as its six coefficients."""
    own = example.model.tyre
    own = own.coefficients() if isinstance(own, sj.Bakker) else own
    return sj.Model(example.model.board, own if tyre is None else tyre, constraint)


def mass(example: sj.Preset) -> float:
    return float(example.model.board.mass)


def poses(models: list[sj.Model], example: sj.Preset, gait: sj.Gait | None = None) -> np.ndarray:
    """(V, n, 3)."""
    return sj.simulate_many(sj.stacked(models), gait or example.gait, times(example))
