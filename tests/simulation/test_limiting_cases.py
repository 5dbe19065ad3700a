"""Where integration is hard: stiff tyres, creeping wheels, steering across the board, rest, reversal.

Each corner is right against scipy's implicit Radau method, or refused; never silently wrong.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.scipy_runs import integrated

from snakejax import Gait, Model, Rayleigh, Sines, preset, simulate, simulate_many, stacked
from snakejax.core.parameter import with_parameters

ROTATE, FORWARD = preset("paper-rotate"), preset("paper-forward")


def radau(model: Model, gait: Gait, seconds: float) -> np.ndarray:
    """The pose at the end, by an implicit method with the exact Jacobian."""
    return np.asarray(integrated(model, gait, [seconds], method="Radau", rtol=1e-9, atol=1e-11, most=0.05).pose[-1])


def all_solvers(model: Model, gait: Gait, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pose at the end by a single run, by Tsit5 in an ensemble, and by the fastest engine that is present."""
    times = jnp.array([seconds])
    alone = simulate(model, gait, times, throw=False).pose[-1]
    engines = ("tsit5", "fastest")
    return np.asarray(alone), *(simulate_many(stacked([model]), gait, times, engine=e)[0, -1] for e in engines)


def gait(phi: list[list[float]], psi: list[list[float]]) -> Gait:
    """Sines for the joints of `FORWARD`, so that its programs serve."""
    return eqx.tree_at(lambda g: (g.phi.command, g.psi.command), FORWARD.gait, (Sines.of(phi), Sines.of(psi)))


def steered(amplitude: float) -> Gait:
    return eqx.tree_at(lambda g: g.phi.command.amplitude, FORWARD.gait, jnp.array([amplitude]))


REVERSED = gait([[0.8, 3.0, np.pi]], [[1.2, 3.0, 0.0]])
STILL = gait([[0.0, 1.0, 0.0]], [[0.0, 1.0, 0.0]])
RIGHT = {
    "stiff coupled": (Model(ROTATE.model.board, Rayleigh(1e5), "coupled"), ROTATE.gait, 2.0),
    "stiff free": (Model(ROTATE.model.board, Rayleigh(1e4), "free"), ROTATE.gait, 2.0),
    "creep free": (
        with_parameters(Model(ROTATE.model.board, ROTATE.model.tyre, "free"), {"board.creep_speed": 1e-6}),
        ROTATE.gait,
        4.0,
    ),
    "86 degrees coupled": (FORWARD.model, steered(1.5), 4.0),
    "92 degrees free": (Model(FORWARD.model.board, FORWARD.model.tyre, "free"), steered(1.6), 4.0),
    "reversal": (FORWARD.model, REVERSED, 6.0),
    "rest": (FORWARD.model, STILL, 4.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("corner", RIGHT)
def test_a_corner_is_right(corner) -> None:
    model, gait, seconds = RIGHT[corner]
    true = radau(model, gait, seconds)
    alone, *members = all_solvers(model, gait, seconds)
    assert np.abs(alone - true).max() < 2e-6
    assert np.abs(np.array(members) - true).max() < 3e-5
    if corner == "rest":
        assert not alone.any() and not np.any(members)


@pytest.mark.slow
@pytest.mark.parametrize("constraint", ["coupled", "ideal"])
def test_steering_across_the_board_is_refused_where_wheels_cannot_slip(constraint) -> None:
    for amplitude in (1.565, 1.6, 2.5):
        model = Model(FORWARD.model.board, FORWARD.model.tyre, constraint)
        assert np.isinf(all_solvers(model, steered(amplitude), 7.7)).all()


@pytest.mark.slow
def test_a_tyre_that_is_too_stiff_is_refused_and_the_ideal_board_is_its_limit() -> None:
    too_stiff = Model(ROTATE.model.board, Rayleigh(1e6), "free")
    assert np.isinf(all_solvers(too_stiff, ROTATE.gait, 14.0)).all()
    ideal = all_solvers(Model(ROTATE.model.board, ROTATE.model.tyre, "ideal"), ROTATE.gait, 4.0)[0]
    away = [
        np.abs(all_solvers(Model(ROTATE.model.board, Rayleigh(k_s), "coupled"), ROTATE.gait, 4.0)[0] - ideal).max()
        for k_s in (1e4, 5e4)
    ]
    assert away[1] == pytest.approx(away[0] / 5, rel=0.1)
