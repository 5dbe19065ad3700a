"""Boards made up: random tyres and gaits, an effect if wanted, and what motion capture would have seen of them."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax import TABLE_II, Accuracy, Board, Case, Effect, Gait, Model, Noise, Pacejka, Run, Sines, Tracked, simulate

NOISE = Noise(4e-4, 2.5e-3, "given")
SECONDS, RATE = 6.0, 100.0
TIMES = np.arange(int(SECONDS * RATE)) / RATE
TRAIN, HELDOUT = 3, 1
SKIDS = ("free", "coupled")


class Made(NamedTuple):
    """A board without an effect, the gait of each run, and where each run starts (R, 3)."""

    skid: str
    model: Model
    gaits: tuple[Gait, ...]
    start: np.ndarray


def make(seed: int, skid: str) -> Made:
    """The board of number `seed`: tyres that slide at 1 to 5 N on each wheelset, three gaits to train on and another.

    Frequencies are 2 to 5 rad/s; one run has the rotor at twice the frequency of the steering, so that the board turns.
    """
    rng = np.random.default_rng([seed, SKIDS.index(skid)])
    tyre = Pacejka(B=rng.uniform(5, 12), C=rng.uniform(1.2, 1.7), D=rng.uniform(1.0, 5.0), E=rng.uniform(-1.0, 0.6))
    gaits = []
    for k in range(TRAIN + HELDOUT):
        w = rng.uniform(2.0, 5.0) * (0.6 if k == 1 else 1.0)
        phi = [[rng.uniform(0.4, 0.9), w, rng.uniform(0, 0.5)], [rng.uniform(0, 0.15), 1.7 * w, rng.uniform(0, 6)]]
        turn = 2.0 if k == 1 else 1.0
        psi = [
            [rng.uniform(0.8, 1.6), turn * w, rng.uniform(0, 0.5)],
            [rng.uniform(0, 0.3), 0.7 * w, rng.uniform(0, 6)],
        ]
        gaits.append(Gait(*(Tracked(Sines.of(terms), kp=100.0, kd=10.0) for terms in (phi, psi))))
    start = np.column_stack([rng.uniform(-0.5, 0.5, (len(gaits), 2)), rng.uniform(-np.pi, np.pi, len(gaits))])
    return Made(skid, Model(Board(**TABLE_II, creep_speed=0.01), tyre, skid), tuple(gaits), start)


@eqx.filter_jit
def _poses(model: Model, gaits: Gait, start):
    accuracy = Accuracy(rtol=1e-9, atol=1e-10)
    return jax.lax.map(
        lambda one: simulate(model, one[0], jnp.asarray(TIMES), one[1], accuracy=accuracy).pose, (gaits, start)
    )


def case(made: Made, seed: int | None = None, **effects: Effect) -> Case:
    """What was seen of the board with `effects`, under the noise of `seed` (None: without noise), as a case."""
    gaits = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *made.gaits)
    poses = np.asarray(_poses(made.model.add(**effects), gaits, jnp.asarray(made.start)))
    if seed is not None:
        poses = poses + np.random.default_rng(seed).normal(size=poses.shape) * np.asarray(NOISE.channels)
    runs = tuple(
        Run(f"run-{k}", "train" if k < TRAIN else "heldout", jnp.asarray(TIMES), jnp.asarray(pose), gait)
        for k, (pose, gait) in enumerate(zip(poses, made.gaits, strict=True))
    )
    return Case("made", "a board made up", made.skid, made.model.board, runs, NOISE)
