"""Laws given by a formula act as the same effect written by hand does."""

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import (
    TABLE_II,
    Board,
    Force,
    Gait,
    InputError,
    LateralForce,
    Model,
    Pacejka,
    Scalar,
    Sines,
    Tracked,
    param,
    simulate,
)
from snakejax.core.parameter import parameters
from snakejax.dynamics.law import LawParameter, law, law_class

TIMES = np.arange(200) / 100
GAIT = Gait(*(Tracked(Sines.of([[size, 4.0, 0.0]]), kp=100.0, kd=10.0) for size in (0.9, 1.6)))


def driven(effect) -> np.ndarray:
    model = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=7.0, C=1.4, D=5.0, E=0.0), "free")
    return np.asarray(simulate(model.add(other=effect), GAIT, TIMES, (0.1, 0.2, 0.3)).pose)


class Spring(Force):
    k: Scalar = param("N/m", default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(self.k * (0.5 - motion.x), self.k * (0.8 - motion.y))
        return X, Y, 0.1 * motion.r


class Shake(LateralForce):
    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        return force * (1 - self.g * jnp.tanh((motion.rotor.rate / 4) ** 2) + 0.2 * wheel.lateral)


@pytest.mark.slow
def test_a_law_of_a_force_acts_as_the_effect_written_by_hand() -> None:
    units, values = {"k": "N/m", "x0": "m", "c": "N m s"}, {"k": 0.5, "x0": 0.5, "c": 0.1}
    formula = law("east = k * (x0 - x); north = k * (0.8 - y); N = c * r", units, values)
    assert np.allclose(driven(formula), driven(Spring(0.5)), rtol=0, atol=1e-9)
    assert not np.allclose(driven(formula), driven(Spring(0.4)), rtol=0, atol=1e-4)


class OfPlace(LateralForce):
    """A grip by where a wheel stands, how fast it turns on the floor, and on which axle it is."""

    g: Scalar = param("-", default=0.0)

    def lateral(self, force, wheel, motion):
        arm = motion.board.half_length * wheel.wheelset.place
        x, y = motion.x + arm * jnp.cos(motion.theta), motion.y + arm * jnp.sin(motion.theta)
        turning = motion.r + wheel.wheelset.steering * motion.steering.rate
        return force * (1 - self.g * (x - 2 * y + 0.1 * turning**2 + wheel.wheelset.place * motion.rotor.angle))


@pytest.mark.slow
def test_a_law_of_a_wheel_acts_as_the_effect_written_by_hand() -> None:
    text = "grip = 1 - g * (wheel_x - 2 * wheel_y + 0.1 * turn_rate ** 2 + axle * rotor_angle)"
    by_hand = driven(OfPlace(0.2))
    assert np.allclose(driven(law(text, {"g": "-"}, {"g": 0.2})), by_hand, rtol=0, atol=1e-9)
    for name in ("wheel_x", "wheel_y", "turn_rate", "axle"):
        other = law(text.replace(name, f"1.05 * {name}"), {"g": "-"}, {"g": 0.2})
        assert not np.allclose(driven(other), by_hand, rtol=0, atol=1e-5), name


@pytest.mark.slow
def test_a_law_of_the_grip_acts_as_the_effect_written_by_hand() -> None:
    text = "grip = 1 - g * tanh((rotor_rate / 4) ** 2) + 0.2 * slip_speed"
    assert np.allclose(driven(law(text, {"g": "-"}, {"g": 0.4})), driven(Shake(0.4)), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_smooth_function_through_values_on_a_line_is_that_line() -> None:
    units, values = {"a": "N", "b": "N", "c": "N"}, {"a": 0.5, "b": 0.0, "c": -0.5}
    smooth = law("X = spline(u, -1, 1, a, b, c)", units, values)
    assert np.allclose(driven(smooth), driven(law("X = -k * u", {"k": "N s/m"}, {"k": 0.5})), rtol=0, atol=1e-9)
    assert smooth.description.startswith("A smooth function found in the recordings: X = spline(u, -1, 1, a, b, c).")


def test_parameters_have_units_and_domains_and_the_class_is_one() -> None:
    given = (LawParameter("a", "N"), LawParameter("s", "m/s", 0.2, low=0.01))
    one, same = (law_class("X = a * tanh(u / s)", given) for _ in range(2))
    assert one is same
    known = parameters(one(), "law_1.")
    assert [p.domain.unit for p in known.values()] == ["N", "m/s"]
    assert known["law_1.s"].domain.low == 0.01 and float(known["law_1.s"].value) == 0.2


@pytest.mark.parametrize("text", ["X", "Z = a", "X = a; X = a", "grip = 1 + a; X = a", "X = b"])
def test_an_expression_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        law_class(text, (LawParameter("a", "N"),))


def test_a_law_of_a_variable_that_the_vehicle_lacks_is_refused() -> None:
    for text in ("X = a * throttle", "X = a * slip_speed"):
        with pytest.raises(ValueError, match="no variable"):
            driven(law(text, {"a": "N"}, {"a": 1.0}))


@pytest.mark.parametrize("name", ["u", "x", "rotor_angle", "slip_speed"])
def test_a_height_depends_on_the_place_of_a_wheel_alone(name: str) -> None:
    given = (LawParameter("a", "m"),)
    with pytest.raises(InputError, match=f"cannot depend on `{name}`"):
        law_class(f"height = a * wheel_x * {name}", given)
    assert law_class("height = a * wheel_x * wheel_y", given).expression == "height = a * wheel_x * wheel_y"
