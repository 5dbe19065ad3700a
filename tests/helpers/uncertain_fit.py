"""A fit that leaves its parameters uncertain, of one short run with much noise."""

from functools import cache

import jax.numpy as jnp
import numpy as np

from helpers.payload_case import BOARD, GAINS, TYRE
from snakejax import Force, Gait, Model, Noise, Pacejka, Run, Sines, Tracked, param, simulate
from snakejax.estimation import fit

SLIDING = 0.8
"""A grip [N] at which the board slides: its B and D are two numbers, not one stiffness."""


class Drag(Force):
    """Against the motion along the board: never below zero."""

    c: jnp.ndarray = param("N s/m", low=0.0, default=0.0)

    def wrench(self, motion):
        return -self.c * motion.u, jnp.zeros_like(motion.u), jnp.zeros_like(motion.u)


@cache
def uncertain(noisier: float, drag: float):
    """A fit of B and D (their logarithms) and a drag to one run of 2 s of so many times the usual noise."""
    noise = Noise(jnp.asarray(4e-4 * noisier), jnp.asarray(2.5e-3 * noisier), source="test")
    gait = Gait(*(Tracked(Sines.of(rows), **GAINS) for rows in ([[0.7, 4.0, 0.0]], [[1.4, 4.0, 0.3]])))
    times = jnp.arange(101) / 50
    truth = Model(BOARD, Pacejka(**TYRE | {"D": SLIDING}), "free", {"drag": Drag(drag)})
    errors = np.random.default_rng(3).normal(size=(101, 3)) * np.asarray(noise.channels)
    run = Run("one", "train", times, simulate(truth, gait, times).pose + jnp.asarray(errors), gait)
    return fit(truth, [run], noise, ["tyre.B", "tyre.D", "effects.drag.c"])
