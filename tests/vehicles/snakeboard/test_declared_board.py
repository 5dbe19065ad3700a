"""The snakeboard's closed-form equations against those that follow from its declaration by `jax.jvp`."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.dynamics.constraints import AbstractConstraint, NonSlipping, Slipping
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.dynamics.tyres import Pacejka
from snakejax.effects import LIBRARY
from snakejax.vehicles.snakeboard.board import Board

EFFECTS = {
    "ground_slope": dict(sx=0.02, sy=-0.01),
    "longitudinal_slip": dict(k=0.7),
    "steering_crab": dict(o=0.05),
    "grip_split": dict(s=0.2),
}


def random_model(rng: np.random.Generator, constraint: AbstractConstraint | str) -> tuple[Model, Gait]:
    board = Board(
        mass=rng.uniform(2, 9), rotor_inertia=0.03, wheelset_inertia=0.001, half_length=0.3, inertia=rng.uniform(0.3, 1)
    )
    board = eqx.tree_at(lambda b: b.offset, board, jnp.asarray(0.04))
    joint = [Tracked(Sines.of(rng.uniform(0.1, 0.6, (2, 3)) * [1, 6, 6]), 80.0, 9.0) for _ in range(3)]
    back = joint[2] if rng.uniform() < 0.5 else None
    tyre = Pacejka(B=rng.uniform(2, 9), C=1.4, D=rng.uniform(1, 6), E=0.2)
    effects = {} if constraint == "ideal" else {name: LIBRARY[name](**values) for name, values in EFFECTS.items()}
    effects.pop("grip_split", None) if isinstance(constraint, NonSlipping) else None
    return Model(board, tyre, constraint, effects), Gait(joint[0], joint[1], back)


@pytest.mark.slow
@pytest.mark.parametrize(("own", "general"), [("free", Slipping()), ("ideal", NonSlipping())])
def test_the_rates_are_those_of_the_declaration(own: str, general: AbstractConstraint) -> None:
    for seed in range(20):
        model, gait = random_model(np.random.default_rng(seed), own)
        declared = Model(model.board, model.tyre, general, model.effects)
        t = jnp.asarray(0.7)
        six = tuple(map(jnp.asarray, np.random.default_rng(seed).uniform(-1, 1, 6)))
        state, same = model.initial_state(six, t, gait), declared.initial_state(six, t, gait)
        np.testing.assert_allclose(same[0], state[0], rtol=0, atol=0)
        ours, theirs = model.rates(t, state, gait)[0], declared.rates(t, same, gait)[0]
        np.testing.assert_allclose(theirs, ours, rtol=1e-12, atol=1e-12)
        assert np.abs(np.asarray(ours)[3:]).max() > 1e-3
