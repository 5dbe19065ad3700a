"""Effects that a compiled program passes by change nothing."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, Model, Noise, Pacejka, Run, Sines
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.active_effects import active_effects
from snakejax.dynamics.conditions import by_condition, differences_of
from snakejax.dynamics.ports import Force, InputModifier, LateralForce, RollingForce, TyreModifier
from snakejax.effects import LIBRARY
from snakejax.estimation.linearisation import first, linearise
from snakejax.estimation.problem import Problem

TYRE = Pacejka(6.0, 1.4, 5.0, 0.2)
OTHER = {
    "effects.rolling_resistance.f": 0.1,
    "effects.quadratic_drag.c": 0.2,
    "effects.ground_slope.sx": 0.002,
    "effects.steering_gain.g": 0.05,
    "effects.grip_split.s": 0.1,
    "effects.stribeck_grip.s": 0.2,
}
"""One effect or two of each port that may be passed by."""


def all_effects() -> Model:
    """A board with every effect of the library, all neutral."""
    return Model(Board(**TABLE_II), TYRE, "free", {name: kind() for name, kind in LIBRARY.items()})


def candidates(*moving: str) -> dict[str, jnp.ndarray]:
    """The parameters of all effects, of which those `moving` are estimated."""
    names = [name for name in parameters(all_effects()) if name.startswith("effects.")]
    return {name: jnp.asarray(name in moving) for name in names}


def problem() -> Problem:
    """One run in motion for 1.2 s, with every effect of the library."""
    model, times = all_effects(), jnp.arange(60.0) * 0.02
    gait = Gait(Sines.of([[0.4, 4.0, 0.3]]), Sines.of([[1.2, 4.0, 0.9]]))
    run = Run("a", "train", times, jnp.zeros((60, 3)), gait, moving=True)
    names = [name for name in parameters(model) if name.startswith(("tyre.", "effects."))]
    return Problem.of(model, [run], Noise(4e-4, 2.5e-3, "given"), names, len(names))


@pytest.mark.parametrize("values", [{}, OTHER], ids=["all neutral", "six in force"])
def test_residuals_and_derivatives_are_those_with_all_effects_active(values, monkeypatch) -> None:
    whole = problem()
    here, names, start = whole.values() | values, whole.names, np.array([[0.1, 0.2, 0.3, 0.4, 0.02, 0.1]])
    order, count = first([0], whole.batch)
    program = eqx.filter_jit(linearise)

    def linearised(free):
        at = whole.at(here, free, start)
        steps = np.zeros(len(names)), np.zeros_like(start)
        return program(whole.model, at, whole.batch, order, count, *steps, whole.accuracy)

    alone = [linearised([name]) for name in names]
    monkeypatch.setattr(Model, "with_active", lambda model, _: model)
    program = eqx.filter_jit(linearise)
    together = linearised(names)
    for k, (name, one) in enumerate(zip(names, alone, strict=True)):
        np.testing.assert_allclose(one.residual, together.residual, rtol=1e-6, atol=1e-6, err_msg=name)
        column = np.asarray(together.jacobian[..., k])
        size = max(float(np.abs(column[np.isfinite(column)]).max(initial=0.0)), 1.0)
        np.testing.assert_allclose(one.jacobian[..., 0], column, rtol=0, atol=1e-5 * size, err_msg=name)
    used = {name for name in names if np.abs(np.nan_to_num(together.jacobian[..., names.index(name)])).max() > 1}
    for port in (Force, RollingForce, LateralForce, TyreModifier, InputModifier):
        of_port = {name for name, effect in whole.model.effects.items() if isinstance(effect, port)}
        assert any(name.split(".")[1] in of_port for name in used if name.startswith("effects.")), port


def test_an_effect_is_active_where_it_is_not_neutral_or_moves() -> None:
    model = with_parameters(all_effects(), {"effects.body_drag.c": 0.3})
    on = active_effects(model, candidates("effects.ground_slope.sy"))
    assert {name for name, active in on.items() if active} == {"body_drag", "ground_slope"}


def test_an_effect_that_differs_between_conditions_is_active() -> None:
    model = all_effects()
    differences = differences_of(model, ["effects.yaw_bias.t"], ("wet",))
    by_floor = model.add(by_floor=by_condition("floor", differences)())
    assert {name for name, is_on in active_effects(by_floor, candidates()).items() if is_on} == {"yaw_bias", "by_floor"}


class Constant(Force):
    """A force without parameters."""

    def wrench(self, motion):
        return jnp.ones_like(motion.time), jnp.zeros_like(motion.time), jnp.zeros_like(motion.time)


def test_an_effect_without_parameters_is_active() -> None:
    assert active_effects(all_effects().add(constant=Constant()), candidates())["constant"]


def test_an_effect_that_is_no_candidate_is_active() -> None:
    """Its default need not be neutral where a user has put it in."""
    of_slope = {name: moves for name, moves in candidates().items() if "ground_slope" not in name}
    assert {name for name, active in active_effects(all_effects(), of_slope).items() if active} == {"ground_slope"}
