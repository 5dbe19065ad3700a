"""The effects of `library(vehicle)` on every vehicle: neutral is absent, each acts or says why it cannot, and each is
what its equation says."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import Board, Model, Pacejka, Sines
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import no_traction
from snakejax.dynamics.sampled_signals import Held
from snakejax.effects import LIBRARY, library
from snakejax.vehicles.car import DART, Car
from snakejax.vehicles.roller_racer import ROLLER_RACER, RollerRacer
from snakejax.vehicles.skid_steer import HUSKY, SkidSteer
from snakejax.vehicles.sleigh import ICE_SLEIGH, Sleigh

TYRE = Pacejka(4.0, 1.3, 3.0, 0.1)
CAR = Car(**DART, force_gain=20.0, speed_loss=2.0)
VEHICLES = {
    "car": (CAR, FrontRear(TYRE, TYRE)),
    "skid_steer": (SkidSteer(**HUSKY), Pacejka(6.0, 1.2, 50.0, 0.1)),
    "sleigh": (Sleigh(**ICE_SLEIGH), TYRE),
    "roller_racer": (RollerRacer(**(ROLLER_RACER | {"handle_mass": 0.2})), TYRE),
}
INPUTS = {
    "car": {"steer": [[0.3, 2.0, 0.4]], "drive": [[0.3, 1.0, 1.2]]},
    "skid_steer": {"left": [[4.0, 0.7, 1.0]], "right": [[5.0, 0.9, 1.2]]},
    "sleigh": {},
    "roller_racer": {"handle": [[0.6, 3.0, 0.3]]},
}
T = jnp.asarray(0.6)
PAIRS = [(kind, name) for kind, (vehicle, _) in VEHICLES.items() for name in library(vehicle)]
MOTION = (0.2, -0.1, 0.5, 0.9, 0.15, 0.7)
"""x, y, heading, u, w, r."""

every_pair = pytest.mark.parametrize(("kind", "name"), PAIRS)


def model_of(kind: str, structure: str = "free") -> Model:
    vehicle, tyre = VEHICLES[kind]
    return Model(vehicle, tyre if structure == "free" else no_traction(), structure)


def inputs_of(kind: str) -> Inputs:
    return Inputs({name: Sines.of(terms) for name, terms in INPUTS[kind].items()})


def start_of(model: Model):
    """The motion of the body, and memories away from zero."""
    body, memories = model.start((jnp.zeros(()),) * 3)
    body = tuple(map(jnp.asarray, [*MOTION, 0.4][: len(body)]))
    return body, jax.tree.map(lambda leaf: jnp.full_like(leaf, 0.05), memories)


def done_and_seen(model: Model, body, memories, kind: str):
    """The rates of the body, and its observed pose."""
    done = model.rates(T - model.delay(), (body, memories), inputs_of(kind))[0]
    return jnp.stack([*done, *model.observe(body)])


def rates(model: Model, kind: str) -> np.ndarray:
    """The rates of the body where it moves, and its observed pose."""
    return np.asarray(eqx.filter_jit(done_and_seen)(model, *start_of(model), kind))


@functools.cache
def moved_by_each(kind: str, structure: str) -> dict[str, np.ndarray]:
    """How the rates change by each effect that can act, "" by all of them at their neutral values.

    One model has all of them; in each row one is well away from neutral.
    """
    model = model_of(kind, structure)
    effects = {name: effect() for name, effect in library(VEHICLES[kind][0]).items()}
    able = {name: effect for name, effect in effects.items() if effect.inapplicable_because(model) is None}
    full = model.add(**able)
    names = [f"effects.{name}.{part}" for name, effect in able.items() for part in parameters(effect)]
    neutral = np.array([float(parameters(full)[name].value) for name in names])
    rows = [neutral, *(np.where([n.split(".")[1] == name for n in names], 0.1, neutral) for name in able)]
    body, memories = start_of(full)

    def rates_at(row):
        varied = with_parameters(full, dict(zip(names, row, strict=True)))
        return done_and_seen(varied, body, memories, kind)

    found = np.asarray(jax.jit(jax.vmap(rates_at))(jnp.asarray(rows)))
    return dict(zip(["", *able], found - rates(model, kind), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["free", "ideal"])
@every_pair
def test_it_acts_or_refuses(kind: str, name: str, structure: str) -> None:
    """At an instant; a refusal is a sentence, and adding the effect all the same is an error with that sentence."""
    model, effect = model_of(kind, structure), library(VEHICLES[kind][0])[name]()
    why = effect.inapplicable_because(model)
    assert (why is not None) == (name in REFUSED[kind, structure])
    if why is not None:
        with pytest.raises(ValueError, match=f"Effect `{name}` cannot act here"):
            model.add(**{name: effect})
        assert why.endswith(".") and len(why) > 20
        return
    assert np.abs(moved_by_each(kind, structure)[name]).max() > 1e-6, f"{name} does nothing to the {kind}."


@pytest.mark.slow
@pytest.mark.parametrize("structure", ["free", "ideal"])
@pytest.mark.parametrize("kind", VEHICLES)
def test_neutral_is_absent(kind: str, structure: str) -> None:
    np.testing.assert_allclose(moved_by_each(kind, structure)[""], 0.0, rtol=0, atol=1e-12)


OF_GRIP = {"grip_split", "grip_gradient", "stribeck_grip", "tyre_relaxation"}
OF_FORCE = {
    "rolling_resistance",
    "body_drag",
    "quadratic_drag",
    "yaw_damping",
    "yaw_friction",
    "yaw_bias",
    "ground_slope",
}
NO_SUCH_THING = {"sleigh": {"com_offset", "clock_offset"}, "roller_racer": {"com_offset", "steering_drag"}}
# An axle with a tyre of its own, or wheels on one side alone: the tyre is the split.
NO_SPLIT = {"car": {"grip_split"}, "sleigh": {"grip_split"}}
REFUSED = {(kind, "free"): NO_SUCH_THING.get(kind, set()) | NO_SPLIT.get(kind, set()) for kind in VEHICLES} | {
    ("car", "ideal"): OF_GRIP | {"load_transfer", "combined_slip"},
    # The speeds of the wheels alone prescribe how it moves.
    ("skid_steer", "ideal"): OF_GRIP | OF_FORCE | {"inertia_factor"},
    ("sleigh", "ideal"): OF_GRIP | NO_SUCH_THING["sleigh"],
    ("roller_racer", "ideal"): OF_GRIP | NO_SUCH_THING["roller_racer"],
}
"""The effects that cannot act, by vehicle and structure."""


def test_only_driven_and_steered_wheels_have_their_effects() -> None:
    names = {kind: set(library(vehicle)) for kind, (vehicle, _) in VEHICLES.items()}
    driven = {"speed_resistance", "drive_friction", "load_transfer", "combined_slip"}
    assert {kind for kind in names if driven <= names[kind]} == {"car"}
    assert not any(driven & names[kind] for kind in names if kind != "car")
    assert {kind for kind in names if "steering_drag" in names[kind]} == {"car", "roller_racer"}
    assert {"left_wheels_lag", "right_wheels_gain"} <= names["skid_steer"]
    assert not any(name.endswith(("_lag", "_gain")) for name in names["sleigh"])


# --- Each is its equation --------------------------------------------------------------------------------------------


def added(name: str, **values: float) -> np.ndarray:
    """What an effect adds to (du/dt, dw/dt, dr/dt) of the car."""
    effect = library(CAR)[name](**{key: jnp.asarray(value) for key, value in values.items()})
    return (rates(model_of("car").add(**{name: effect}), "car") - rates(model_of("car"), "car"))[3:6]


def car_wheels() -> tuple[float, np.ndarray, float, float]:
    """Steering angle, rolling speeds of both axles, m and I of the car where it moves."""
    u, w, r = MOTION[3:]
    delta = 0.3 * np.sin(2.0 * 0.6 + 0.4)
    front = u * np.cos(delta) + (w + DART["front"] * r) * np.sin(delta)
    return delta, np.array([front, u]), DART["mass"], DART["inertia"]


def along_wheels(front: float, rear: float) -> np.ndarray:
    """Accelerations (du/dt, dw/dt, dr/dt) by forces along the front and the rear wheel."""
    delta, _, mass, inertia = car_wheels()
    X, Y = front * np.cos(delta) + rear, front * np.sin(delta)
    return np.array([X / mass, Y / mass, DART["front"] * Y / inertia])


def test_resistances_of_a_car() -> None:
    """-(f_1 a + f_2 a |a|) / 2, -f tanh(a / 0.13) / 2, and -k (sqrt(d^2 + 0.03^2) - 0.03) tanh(a / 0.15), by wheel."""
    delta, a, _, _ = car_wheels()
    speed = -(0.3 * a + 0.2 * a * np.abs(a)) / 2
    np.testing.assert_allclose(added("speed_resistance", f_1=0.3, f_2=0.2), along_wheels(*speed), atol=1e-9)
    np.testing.assert_allclose(added("drive_friction", f=0.4), along_wheels(*(-0.2 * np.tanh(a / 0.13))), atol=1e-9)
    drag = -2.0 * (np.sqrt(np.array([delta, 0.0]) ** 2 + 0.03**2) - 0.03) * np.tanh(a / 0.15)
    np.testing.assert_allclose(added("steering_drag", k=2.0), along_wheels(*drag), atol=1e-9)


def lateral_forces() -> np.ndarray:
    """The lateral forces of the axles by the tyre law, positive to the left."""
    u, w, r = MOTION[3:]
    delta, a, _, _ = car_wheels()
    across = np.array([(w + DART["front"] * r) * np.cos(delta) - u * np.sin(delta), w - DART["rear"] * r])
    alpha = np.arctan(across / np.sqrt(a**2 + float(CAR.creep_speed) ** 2))
    slip = 4.0 * alpha
    return -3.0 * np.sin(1.3 * np.arctan(slip - 0.1 * (slip - np.arctan(slip))))


def across_wheels(front: float, rear: float) -> np.ndarray:
    """Accelerations (du/dt, dw/dt, dr/dt) by lateral forces of the front and the rear wheel."""
    delta, _, mass, inertia = car_wheels()
    X, Y = -front * np.sin(delta), front * np.cos(delta)
    return np.array([X / mass, (Y + rear) / mass, (DART["front"] * Y - DART["rear"] * rear) / inertia])


def drive_force() -> float:
    """F = 20 T - 2 u; the dead band is zero, and its smoothing small where T is large."""
    return 20.0 * 0.3 * np.sin(1.0 * 0.6 + 1.2) - 2.0 * MOTION[3]


def test_load_transfer_and_friction_ellipse_of_a_car() -> None:
    """dN_front = -h F / (l_f + l_r) = -dN_rear; and Y sqrt(1 - (rho X / N)^2) at each axle."""
    Y, F = lateral_forces(), drive_force()
    length, weight = DART["front"] + DART["rear"], DART["mass"] * 9.81
    N = weight * np.array([DART["rear"], DART["front"]]) / length
    shift = 0.03 * F / length * np.array([-1.0, 1.0])
    np.testing.assert_allclose(added("load_transfer", h=0.03), across_wheels(*(Y * shift / N)), atol=1e-6)
    X = F * np.array([DART["front_drive"], 1 - DART["front_drive"]])
    less = Y * (np.sqrt(1 - (0.8 * X / N) ** 2) - 1)
    np.testing.assert_allclose(added("combined_slip", rho=0.8), across_wheels(*less), atol=1e-6)


def test_a_larger_inertia_turns_less() -> None:
    plain = rates(model_of("car"), "car")[5]
    np.testing.assert_allclose(added("inertia_factor", g=0.25), [0.0, 0.0, plain * (1 / 1.25 - 1)], atol=1e-9)


SHAPES = {
    "offset": ({"o": 0.05}, lambda c: c + 0.05),
    "gain": ({"g": 0.2}, lambda c: 1.2 * c),
    "asymmetry": ({"a": 0.3}, lambda c: (1 + 0.3 * np.tanh(30 * c)) * c),
    "curvature": ({"kappa": 4.0}, lambda c: c / np.sqrt(1 + 4.0 * c**2)),
}


@pytest.mark.parametrize("word", SHAPES)
def test_a_changed_input_and_its_rates(word: str) -> None:
    """The value by the equation; rate and acceleration are those of the value, by finite differences."""
    values, expected = SHAPES[word]
    effect = library(CAR)[f"steering_{word}"](**{key: jnp.asarray(value) for key, value in values.items()})
    changed = effect.gait(inputs_of("car"))
    step = 1e-4
    times = 0.05 + 0.1 * np.arange(20)
    for t in times:
        before, now, after = (changed.at(jnp.asarray(t + d))["steer"] for d in (-step, 0.0, step))
        assert float(now.angle) == pytest.approx(expected(0.3 * np.sin(2.0 * t + 0.4)), abs=1e-12)
        assert float(now.rate) == pytest.approx(float(after.angle - before.angle) / (2 * step), abs=1e-4)
        assert float(now.acceleration) == pytest.approx(float(after.rate - before.rate) / (2 * step), abs=1e-3)
        assert float(changed.at(jnp.asarray(t))["drive"].angle) == pytest.approx(0.3 * np.sin(t + 1.2))


def test_a_drive_that_fades_and_one_that_lags() -> None:
    """(1 - b t) c; and for c = sin(w t) after some tau: sin(w t - atan(w tau)) / sqrt(1 + (w tau)^2)."""
    fading = library(CAR)["drive_fading"](b=jnp.asarray(0.1)).gait(inputs_of("car"))
    assert float(fading.at(jnp.asarray(2.0))["drive"].angle) == pytest.approx(0.8 * 0.3 * np.sin(2.0 + 1.2))
    lagging = library(CAR)["steering_lag"](tau=jnp.asarray(0.2)).gait(inputs_of("car"))
    late = 0.3 * np.sin(2.0 * 5.0 + 0.4 - np.arctan(0.4)) / np.sqrt(1 + 0.4**2)
    assert float(lagging.at(jnp.asarray(5.0))["steer"].angle) == pytest.approx(late, abs=1e-6)


def test_a_gain_is_refused_where_the_constant_that_does_the_same_is_estimated() -> None:
    unknown = Car(**DART, unknown=("steering_ratio",))
    model = Model(unknown, FrontRear(TYRE, TYRE), "free")
    assert "`steering_ratio` is estimated" in str(library(unknown)["steering_gain"]().inapplicable_because(model))
    assert library(unknown)["drive_gain"]().inapplicable_because(model) is None


def test_the_library_of_a_board_is_the_24() -> None:
    board = Board(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25)
    assert library(board) is LIBRARY and len(LIBRARY) == 24


def test_input_effects_act_in_their_order_whatever_the_order_in_which_they_are_added() -> None:
    """First the lag, then the offset, then the asymmetry of what both leave: by hand, 0.1 s after a step of 0.4."""
    effects = library(CAR)
    added = {
        "steering_asymmetry": effects["steering_asymmetry"](a=-0.2),
        "steering_offset": effects["steering_offset"](o=0.05),
        "steering_lag": effects["steering_lag"](tau=0.12),
    }
    command = Inputs({"steer": Held.of([0.0, 1.0], [0.0, 0.4]), "drive": Held.of([0.0, 1.0], [0.0, 0.0])})
    late = 0.4 * (1 - np.exp(-0.1 / 0.12)) + 0.05
    expected = (1 - 0.2 * np.tanh(30 * late)) * late
    for names in (list(added), list(reversed(added))):
        model = model_of("car").add(**{name: added[name] for name in names})
        steered = model.commanded(command).signal("steer").at(jnp.asarray(1.1)).angle
        assert float(steered) == pytest.approx(expected, rel=1e-12)
