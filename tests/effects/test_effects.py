"""Every effect of the library, in every structure that takes it: one set of properties for all, definitions one by one.

A structure is compiled once, with all its effects in it at their neutral values; a test moves the values of one. The
independent side of the forces is `oracles/full_equations.py`, of the rest numpy and closed forms.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import full_equations as full

from snakejax.core.parameter import Scalar, param, parameters, with_parameters
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.ports import Effect, Force, Linkage, RollingForce
from snakejax.dynamics.signals import AbstractSignal, Joint, Sines, Tracked
from snakejax.dynamics.tyres import Bakker, Pacejka, Rayleigh
from snakejax.effects import LIBRARY, SteeringBacklash, TyreOffset, TyreRelaxation
from snakejax.simulation.integrate import Accuracy, simulate
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

STRUCTURES = ("coupled", "free", "ideal")
STEPPED = Accuracy(step=0.005, derivative="forward")
TYRE = Pacejka(B=4.0, C=1.4, D=5.0, E=-0.3)
BOARD = Board(**TABLE_II, creep_speed=0.02)
TIMES = jnp.linspace(0.0, 3.0, 31)


FREE = -np.inf
# fmt: off
TABLE: dict[str, dict[str, tuple[str, float, float]]] = {
    "longitudinal_slip": {"k": ("N s/m", 0.0, 0.8)},
    "rolling_resistance": {"f": ("N", 0.0, 0.2)},
    "body_drag": {"c": ("N s/m", 0.0, 1.5)},
    "quadratic_drag": {"c": ("N s^2/m^2", 0.0, 3.0)},
    "yaw_damping": {"c": ("N m s", 0.0, 0.1)},
    "yaw_friction": {"t": ("N m", 0.0, 0.05)},
    "yaw_bias": {"t": ("N m", FREE, 0.06)},
    "ground_slope": {"sx": ("rad", FREE, 0.01), "sy": ("rad", FREE, 0.02)},
    "steering_offset": {"o": ("rad", FREE, 0.04)},
    "steering_crab": {"o": ("rad", FREE, 0.05)},
    "steering_lag": {"T": ("s", 0.0, 0.06)},
    "rotor_lag": {"T": ("s", 0.0, 0.07)},
    "steering_gain": {"g": ("-", FREE, 0.1)},
    "rotor_gain": {"g": ("-", FREE, -0.1)},
    "steering_backlash": {"b": ("rad", 0.0, 0.05)},
    "grip_split": {"s": ("-", -0.99, 0.3)},
    "com_offset": {"a": ("m", FREE, 0.03)},
    "tyre_relaxation": {"sigma": ("m", 0.0, 0.05)},
    "tyre_offset": {"dSh": ("rad", FREE, 0.03), "dSv": ("N", FREE, 0.1)},
    "stribeck_grip": {"s": ("-", -0.99, 0.4)},
    "grip_gradient": {"g": ("1/m", FREE, 0.2)},
    "marker_offset": {"mx": ("m", FREE, 0.04), "my": ("m", FREE, -0.03)},
    "heading_offset": {"h": ("rad", FREE, 0.05)},
    "clock_offset": {"T": ("s", FREE, 0.04)},
}
"""Of each parameter the unit, the least value, and one that is not neutral."""
# fmt: on
NO_LATERAL_FORCE = {"grip_split", "stribeck_grip", "grip_gradient", "tyre_relaxation", "tyre_offset"}
NO_SLIP_ANGLE = {"tyre_relaxation", "tyre_offset"}
SPACE_BROKEN = {
    "translation": {"grip_gradient"},
    "rotation": {"grip_gradient", "ground_slope"},
    "mirror": {
        "yaw_bias",
        "ground_slope",
        "steering_offset",
        "steering_crab",
        "tyre_offset",
        "marker_offset",
        "heading_offset",
    },
}
"""The symmetries of the plane, and the effects that break them."""


def strength(name: str, factor: float = 1.0) -> dict[str, float]:
    """The values of TABLE for one effect."""
    return {parameter: factor * value for parameter, (_, _, value) in TABLE[name].items()}


@cache
def bare(constraint: str) -> Model:
    return Model(BOARD, TYRE, constraint)


@cache
def neutral(constraint: str) -> Model:
    """The model of a structure with every effect it takes, all neutral."""
    return bare(constraint).add(
        **{name: kind() for name, kind in LIBRARY.items() if kind().inapplicable_because(bare(constraint)) is None}
    )


def having(constraint: str, effects: Mapping[str, Mapping[str, float]]) -> Model:
    """`neutral` with the values given, so that no new program need be compiled."""
    values = {f"effects.{name}.{p}": v for name, given in effects.items() for p, v in given.items()}
    return with_parameters(neutral(constraint), values)


each_skid = pytest.mark.parametrize("constraint", STRUCTURES)
each_effect = pytest.mark.parametrize("name", LIBRARY)
each_pair = pytest.mark.parametrize(
    ("name", "constraint"),
    [(name, constraint) for constraint in STRUCTURES for name in LIBRARY if name in neutral(constraint).effects],
)


def joint(*terms: tuple[float, float, float]) -> Tracked:
    return Tracked(Sines.of([*terms, *[(0.0, 0.0, 0.0)] * (2 - len(terms))]), 100.0, 10.0)


TURNING = Gait(phi=joint((0.5, 3.0, 0.2), (0.25, 0.6, 0.0)), psi=joint((1.5, 3.0, 0.0)))
SOFT = Gait(phi=joint((0.5, 4.0, 0.0), (-1.0, 2.0, 0.0)), psi=joint((1.2, 4.0, 0.0), (-2.4, 2.0, 0.0)))
"""It starts without a jump of the joint acceleration, so that a fixed step sees no corner when it is delayed."""
STILL = Gait(phi=joint(), psi=joint())


@eqx.filter_jit
def _poses(model: Model, gait: Gait, times, start, accuracy: Accuracy):
    return simulate(model, gait, times, start, accuracy=accuracy).pose


def poses(model: Model, gait: Gait = TURNING, start=(0.3, -0.2, 0.5), times=TIMES) -> np.ndarray:
    """Reported poses (n, 3), in fixed steps."""
    return np.asarray(_poses(model, gait, jnp.asarray(times), jnp.asarray(start), STEPPED))


@cache
def acted(constraint: str, name: str) -> np.ndarray:
    """The poses of TURNING from the usual start with one effect at its strength."""
    return poses(having(constraint, {name: strength(name)}))


@cache
def untouched(constraint: str) -> np.ndarray:
    """The same with every effect neutral."""
    return poses(neutral(constraint))


# --- The list --------------------------------------------------------------------------------------------------------


def test_the_library_is_the_list() -> None:
    assert list(LIBRARY) == list(TABLE)


@each_effect
def test_parameters_units_and_domains(name: str) -> None:
    effect = LIBRARY[name]()
    found = {key: (p.domain.unit, p.domain.low) for key, p in parameters(effect).items()}
    assert found == {key: row[:2] for key, row in TABLE[name].items()}
    assert all(float(p.value) == 0.0 for p in parameters(effect).values()), "The neutral value is 0."
    assert effect.description.endswith(".")


@each_effect
def test_refusals_and_their_reasons(name: str) -> None:
    refused_by = {
        "coupled": name == "com_offset",
        "free": False,
        "ideal": name in NO_LATERAL_FORCE,
        "rayleigh": name in NO_SLIP_ANGLE,
    }
    models = {constraint: bare(constraint) for constraint in STRUCTURES} | {
        "rayleigh": Model(BOARD, Rayleigh(9.0), "free")
    }
    for kind, model in models.items():
        why = LIBRARY[name]().inapplicable_because(model)
        assert (why is not None) == refused_by[kind], kind
        if why is not None:
            with pytest.raises(ValueError, match=f"Effect `{name}` cannot act here: ") as complaint:
                model.add(**{name: LIBRARY[name]()})
            assert str(complaint.value).endswith(why) and len(why) > 20


# --- Properties of every effect --------------------------------------------------------------------------------------


@pytest.mark.slow
@each_skid
def test_all_neutral_is_all_absent_over_a_run(constraint: str) -> None:
    np.testing.assert_allclose(untouched(constraint), poses(bare(constraint)), rtol=0, atol=1e-12)


@each_pair
def test_neutral_is_absent(name: str, constraint: str) -> None:
    """One by one, at an instant, where two effects cannot make up for each other."""
    with_, without = bare(constraint).add(**{name: LIBRARY[name]()}), bare(constraint)
    body, t = moving_state(constraint), jnp.asarray(0.7)
    slip = tuple(jnp.asarray(0.1) for _ in BOARD.wheelsets)
    memory = (slip,) if name == "tyre_relaxation" else ()
    rates, _ = with_.rates(t, (body, memory), TURNING)
    expected, _ = without.rates(t, (body, ()), TURNING)
    np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(with_.observe(body), without.observe(body), rtol=0, atol=0)
    assert float(with_.delay()) == 0.0


@pytest.mark.slow
@each_pair
def test_it_acts(name: str, constraint: str) -> None:
    moved = acted(constraint, name) - untouched(constraint)
    mute = (name, constraint) == ("grip_split", "coupled")
    if mute:
        assert np.abs(moved).max() < 1e-12 and "coupled" in LIBRARY[name].unobservable_because
    else:
        assert np.abs(moved).max() > 1e-5


@eqx.filter_jit
def _jacobians(model: Model, names: tuple[str, ...], values, gait: Gait, start):
    def run(values, start):
        moved = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
        return simulate(moved, gait, jnp.linspace(0.0, 0.3, 4), start, accuracy=STEPPED).pose

    return jax.jacfwd(run, argnums=(0, 1))(values, start)


@pytest.mark.slow
@pytest.mark.parametrize(
    "constraint", ["free", *(pytest.param(each, marks=pytest.mark.long) for each in ("coupled", "ideal"))]
)
def test_gradients_at_rest_are_finite(constraint: str) -> None:
    """For every parameter and the start: all neutral, each effect at its strength, and with joints that stay still."""
    names = tuple(name for name in parameters(neutral(constraint)) if name.startswith("effects."))
    start = jnp.asarray([0.3, -0.2, 0.5])
    cases = {"neutral": neutral(constraint)} | {
        name: having(constraint, {name: strength(name)}) for name in neutral(constraint).effects
    }
    for case, model in cases.items():
        values = jnp.asarray([float(parameters(model)[name].value) for name in names])
        for gait in (TURNING, STILL):
            by_values, by_start = map(np.asarray, _jacobians(neutral(constraint), names, values, gait, start))
            assert np.isfinite(by_values).all() and np.isfinite(by_start).all(), case
            assert np.linalg.matrix_rank(by_start[0]) == 3, "Each start has its own first pose."


@each_effect
def test_round_trip_through_jit(name: str) -> None:
    """Values survive, and effects keep an order that is not the alphabet's."""
    effect = LIBRARY[name](**strength(name))
    model = bare("free").add(zebra=effect, marker=LIBRARY["marker_offset"](mx=0.1), aardvark=LIBRARY[name]())
    returned = eqx.filter_jit(lambda m: m)(model)
    assert list(returned.effects) == ["zebra", "marker", "aardvark"]
    assert type(returned.effects["zebra"]) is LIBRARY[name]
    assert {k: float(p.value) for k, p in parameters(returned).items()} == {
        k: float(p.value) for k, p in parameters(model).items()
    }


# --- Symmetries of the plane -----------------------------------------------------------------------------------------


def turned(pose: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    x, y, heading = np.asarray(pose).T
    return np.stack([c * x - s * y, s * x + c * y, heading + angle], axis=-1)


SYMMETRIES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], bool]] = {
    "translation": (lambda pose: np.add(pose, [0.7, -1.1, 0.0]), False),
    "rotation": (lambda pose: turned(pose, 0.9), False),
    "mirror": (lambda pose: np.multiply(pose, [1.0, -1.0, -1.0]), True),
}
"""What is done to poses, and whether the gait is turned over too."""


def turned_over(gait: Gait) -> Gait:
    def amplitudes(g: Any) -> list[Any]:
        return [g.phi.command.amplitude, g.psi.command.amplitude]

    return eqx.tree_at(amplitudes, gait, [-amplitude for amplitude in amplitudes(gait)])


@each_pair
@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_symmetry_is_kept_or_broken(name: str, constraint: str, symmetry: str) -> None:
    change, over = SYMMETRIES[symmetry]
    model, start = having(constraint, {name: strength(name)}), np.array([0.3, -0.2, 0.5])
    expected = change(acted(constraint, name))
    found = poses(model, turned_over(TURNING) if over else TURNING, change(start))
    if name in SPACE_BROKEN[symmetry]:
        assert np.abs(found - expected).max() > 1e-5
    else:
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_a_slope_along_the_mirror_keeps_it() -> None:
    change, _ = SYMMETRIES["mirror"]
    for effects in ({"ground_slope": {"sx": 0.01}}, {"marker_offset": {"mx": 0.04}}):
        model = having("free", effects)
        mirrored = poses(model, turned_over(TURNING), (0.3, 0.2, -0.5))
        np.testing.assert_allclose(mirrored, change(poses(model)), rtol=0, atol=1e-9)


# --- Forces against the full equations -------------------------------------------------------------------------------


class Given(AbstractSignal):
    """A joint as it is at one instant."""

    angle: Scalar = param("rad")
    rate: Scalar = param("rad/s")
    acceleration: Scalar = param("rad/s^2")

    def at(self, t):
        return Joint(*(jnp.asarray(part) + 0.0 * t for part in (self.angle, self.rate, self.acceleration)))


def moving_state(constraint: str) -> tuple[Scalar, ...]:
    """A state under way, twisting and skidding."""
    numbers = {
        "coupled": (0.4, -0.3, 0.8, 0.2, 0.5, 0.7),
        "free": (0.4, -0.3, 0.8, 0.5, -0.2, 0.7),
        "ideal": (0.4, -0.3, 0.8, 0.5),
    }
    return tuple(jnp.asarray(number) for number in numbers[constraint])


class Felt(NamedTuple):
    """What an effect may feel, from the coordinates of the reference."""

    mass: float
    theta: float
    u: float
    w: float
    r: float
    rolling: np.ndarray


def _along_world(felt: Felt, east: float, north: float) -> tuple[float, float, float]:
    c, s = np.cos(felt.theta), np.sin(felt.theta)
    return east * c + north * s, north * c - east * s, 0.0


WRENCHES: dict[str, Callable[..., tuple[float, float, float]]] = {
    "body_drag": lambda felt, c: (-c * felt.u, -c * felt.w, 0.0),
    "quadratic_drag": lambda felt, c: (
        -c * np.hypot(felt.u, felt.w) * felt.u,
        -c * np.hypot(felt.u, felt.w) * felt.w,
        0.0,
    ),
    "yaw_damping": lambda felt, c: (0.0, 0.0, -c * felt.r),
    "yaw_friction": lambda felt, t: (0.0, 0.0, -t * np.tanh(felt.r / 0.02)),
    "yaw_bias": lambda felt, t: (0.0, 0.0, t),
    "ground_slope": lambda felt, sx, sy: _along_world(felt, -felt.mass * 9.81 * sx, -felt.mass * 9.81 * sy),
}
RESISTANCES: dict[str, Callable[..., np.ndarray]] = {
    "longitudinal_slip": lambda felt, k: k * felt.rolling,
    "rolling_resistance": lambda felt, f: f * np.tanh(felt.rolling / 0.005),
}
FORCES = [*WRENCHES, *RESISTANCES]
DISSIPATIVE = [name for name in FORCES if name not in ("yaw_bias", "ground_slope")]


class Instant:
    """One random instant of a random board, for both sides."""

    def __init__(self, constraint: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.constraint = constraint
        offset = 0.0 if constraint == "coupled" else rng.uniform(-0.05, 0.05)
        self.board = full.Board(
            rng.uniform(1.0, 9.0), rng.uniform(0.1, 0.6), 0.03, 0.002, rng.uniform(0.1, 0.4), offset
        )
        self.steering = full.Steering(*rng.uniform(-1.0, 1.0, 2), *rng.uniform(-4.0, 4.0, 2))
        self.rotor = rng.uniform(-3.0, 3.0, 3)
        self.x, self.y, self.theta, self.beta = rng.uniform(-2.0, 2.0, 4)
        speed, drift, spin = rng.uniform(-0.8, 0.8, 3)
        self.velocity = full.starting_velocity(self.board, self.theta, self.steering, speed, spin, constraint)
        self.velocity[full.PSI] = self.rotor[1]
        if constraint == "free":
            self.velocity[:2] += drift * np.array([-np.sin(self.theta), np.cos(self.theta)])

    @property
    def felt(self) -> Felt:
        c, s = np.cos(self.theta), np.sin(self.theta)
        x, y, theta, _, _, beta = self.velocity
        rolling = full.rolling_matrix(self.board, self.theta, self.steering) @ self.velocity
        return Felt(self.board.mass, self.theta, c * x + s * y, c * y - s * x, theta + beta, rolling)

    @property
    def state(self) -> tuple[Scalar, ...]:
        felt = self.felt
        numbers = {
            "coupled": (self.x, self.y, self.theta, self.beta, felt.u, felt.r),
            "free": (self.x, self.y, self.theta, felt.u, felt.w, felt.r),
            "ideal": (self.x, self.y, self.theta, felt.u),
        }
        return tuple(jnp.asarray(number) for number in numbers[self.constraint])

    def model(self, **effects: Effect) -> Model:
        b = self.board
        board = Board(b.mass, b.rotor_inertia, b.wheel_inertia, b.half_length, 1e-3, b.inertia, b.offset)
        return Model(board, TYRE, self.constraint).add(**effects)

    def rates(self, **effects: Effect) -> np.ndarray:
        """Time derivatives of the package's speeds."""
        front, back, front_rate, back_rate = self.steering
        gait = Gait(Given(front, front_rate, 0.0), Given(*self.rotor), Given(back, back_rate, 0.0))
        (rates, _) = self.model(**effects).rates(jnp.asarray(0.0), (self.state, ()), gait)
        return np.asarray(rates[{"coupled": 4, "free": 3, "ideal": 3}[self.constraint] :])

    def reference(self, wrench: tuple[float, float, float], resistances: np.ndarray) -> np.ndarray:
        """The same from the full equations, turned into the body frame."""
        tyre = full.pacejka(float(TYRE.B), float(TYRE.C), float(TYRE.D), float(TYRE.E))
        loads: dict[str, Any] = {"wrench": full.Wrench(*wrench), "rolling_forces": tuple(resistances)}
        felt, spin = self.felt, self.velocity[full.THETA]
        if self.constraint == "free":
            acceleration = full.free_accelerations(
                self.board, tyre, self.theta, self.velocity[:3], self.steering, self.rotor[2], **loads
            )
        else:
            position = np.array([self.x, self.y, self.theta, 0.0, 0.0, self.beta])
            acceleration = full.constrained_accelerations(
                self.board,
                None if self.constraint == "ideal" else tyre,
                position,
                self.velocity,
                self.steering,
                (self.rotor[2], 0.0),
                structure=self.constraint,
                **loads,
            ).acceleration
        c, s = np.cos(self.theta), np.sin(self.theta)
        along = c * acceleration[0] + s * acceleration[1] + spin * felt.w
        across = c * acceleration[1] - s * acceleration[0] - spin * felt.u
        return np.array({
            "coupled": [along, acceleration[full.THETA] + acceleration[-1]],
            "free": [along, across, acceleration[full.THETA]],
            "ideal": [along],
        }[self.constraint])  # fmt: skip


def test_the_forces_are_all_here() -> None:
    assert set(FORCES) == {name for name, kind in LIBRARY.items() if issubclass(kind, Force | RollingForce)}


@pytest.mark.parametrize("name", FORCES)
@each_skid
def test_forces_agree_with_the_full_equations(name: str, constraint: str) -> None:
    for seed in range(3):
        instant, values = Instant(constraint, seed), strength(name)
        wrench = WRENCHES[name](instant.felt, **values) if name in WRENCHES else (0.0, 0.0, 0.0)
        resistances = RESISTANCES[name](instant.felt, **values) if name in RESISTANCES else np.zeros(2)
        found = instant.rates(**{name: LIBRARY[name](**values)})
        np.testing.assert_allclose(found, instant.reference(wrench, resistances), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", DISSIPATIVE)
@each_skid
def test_drags_take_energy(name: str, constraint: str) -> None:
    """The change of the accelerations, times the momenta, is a power below zero."""
    for seed in range(3):
        instant = Instant(constraint, seed)
        change = instant.rates(**{name: LIBRARY[name](**strength(name))}) - instant.rates()
        board, felt = instant.board, instant.felt
        turn, drift = felt.r / felt.u, felt.w / felt.u
        momenta = {
            "coupled": [board.mass * (1 + drift**2) * felt.u, board.inertia * felt.r],
            "free": [board.mass * felt.u, board.mass * felt.w, board.inertia * felt.r],
            "ideal": [(board.mass * (1 + drift**2) + board.inertia * turn**2) * felt.u],
        }
        assert change @ momenta[constraint] < 0.0


# --- The sign a physicist expects ------------------------------------------------------------------------------------

X, Y, HEADING = range(3)
BOTH = ("coupled", "free")


class Expected(NamedTuple):
    """A board coasts along +x, skidding to its left (`free`): which way does the effect move its last pose?"""

    name: str
    values: dict[str, float]
    channel: int
    sign: float
    skids: tuple[str, ...] = STRUCTURES


SIGNS = [
    Expected("longitudinal_slip", {"k": 1.0}, X, -1),
    Expected("rolling_resistance", {"f": 0.2}, X, -1),
    Expected("body_drag", {"c": 1.0}, X, -1),
    Expected("quadratic_drag", {"c": 1.0}, X, -1),
    Expected("yaw_damping", {"c": 0.2}, HEADING, -1, BOTH),
    Expected("yaw_friction", {"t": 0.05}, HEADING, -1, BOTH),
    Expected("yaw_bias", {"t": 0.05}, HEADING, +1, BOTH),
    Expected("ground_slope", {"sx": 0.01}, X, -1),
    Expected("ground_slope", {"sx": -0.01}, X, +1),
    Expected("ground_slope", {"sy": 0.01}, Y, -1, ("free",)),
    Expected("steering_offset", {"o": 0.05}, HEADING, +1),
    Expected("steering_crab", {"o": 0.05}, Y, +1),
    Expected("com_offset", {"a": 0.05}, HEADING, +1, ("free",)),  # the back one, further behind, brakes the skid more
    Expected("grip_split", {"s": 0.3}, HEADING, -1, ("free",)),  # so does the front one where it grips better
    Expected("tyre_relaxation", {"sigma": 0.05}, Y, -1, ("free",)),  # under way, the force outlives the slip
    Expected("stribeck_grip", {"s": 0.5}, Y, -1, ("free",)),
    Expected("grip_gradient", {"g": 0.5}, Y, -1, ("free",)),
    Expected("tyre_offset", {"dSh": 0.05}, Y, -1, ("free",)),
    Expected("tyre_offset", {"dSv": 0.2}, Y, -1, ("free",)),
    Expected("tyre_offset", {"dSh": 0.05}, HEADING, -1, ("coupled",)),
    Expected("tyre_offset", {"dSv": 0.2}, HEADING, -1, ("coupled",)),
    Expected("marker_offset", {"mx": 0.1}, X, +1),
    Expected("marker_offset", {"my": 0.1}, Y, +1),
    Expected("heading_offset", {"h": 0.1}, HEADING, +1),
]
COASTING = {
    "coupled": (0.5, 0.0, 0.0, 0.5, 0.0, 0.4),
    "free": (0.5, 0.0, 0.0, 0.5, 0.1, 0.4),
    "ideal": (0.5, 0.0, 0.0, 0.5, 0.0, 0.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("expected", SIGNS, ids=lambda e: f"{e.name} {e.values}")
def test_sign(expected: Expected) -> None:
    for constraint in expected.skids:
        with_, without = (
            poses(model, STILL, COASTING[constraint], [0.0, 0.6])[-1]
            for model in (having(constraint, {expected.name: expected.values}), neutral(constraint))
        )
        assert expected.sign * (with_ - without)[expected.channel] > 1e-4, constraint


def test_signs_of_the_commands() -> None:
    t = jnp.asarray(0.9)

    def commanded(**effects: Effect) -> Gait:
        return bare("free").add(**effects).commanded(SOFT)

    def phi(at: float) -> Joint:
        return SOFT.phi.at(jnp.asarray(at))

    late = commanded(lag=LIBRARY["steering_lag"](T=0.2))
    np.testing.assert_allclose(late.phi.at(t), phi(0.7), rtol=0, atol=1e-14)
    np.testing.assert_allclose(late.phi.at(jnp.asarray(0.19)), 0.0, atol=0)
    np.testing.assert_allclose(late.psi.at(t), SOFT.psi.at(t), atol=0)
    late = commanded(lag=LIBRARY["rotor_lag"](T=0.2))
    np.testing.assert_allclose(late.psi.at(t), SOFT.psi.at(jnp.asarray(0.7)), rtol=0, atol=1e-14)
    np.testing.assert_allclose(late.phi.at(t), phi(0.9), atol=0)
    more = commanded(gain=LIBRARY["steering_gain"](g=0.25))
    np.testing.assert_allclose(more.phi.at(t), 1.25 * np.array(phi(0.9)), rtol=1e-14)
    more = commanded(gain=LIBRARY["rotor_gain"](g=0.25))
    np.testing.assert_allclose(more.psi.at(t), 1.25 * np.array(SOFT.psi.at(t)), rtol=1e-14)


# --- Definitions -----------------------------------------------------------------------------------------------------


@each_skid
def test_both_lags_are_a_clock_offset_for_an_idle_board(constraint: str) -> None:
    """And the pose reported at t is that of t - T, at rest before."""
    T = 0.2
    plain = poses(neutral(constraint), SOFT)
    lagged = poses(having(constraint, {"steering_lag": {"T": T}, "rotor_lag": {"T": T}}), SOFT)
    clock = poses(having(constraint, {"clock_offset": {"T": T}}), SOFT)
    np.testing.assert_allclose(lagged, clock, rtol=0, atol=1e-6)
    np.testing.assert_allclose(clock[2:], plain[:-2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(clock[:2], np.tile(plain[0], (2, 1)), rtol=0, atol=1e-12)
    assert np.abs(clock - plain).max() > 1e-2


@each_skid
def test_the_marker_turns_with_the_heading_and_its_offset_comes_last(constraint: str) -> None:
    x, y, heading = poses(neutral(constraint)).T
    mx, my, h = 0.04, -0.03, 0.2
    found = poses(having(constraint, {"heading_offset": {"h": h}, "marker_offset": {"mx": mx, "my": my}}))
    c, s = np.cos(heading), np.sin(heading)
    expected = np.stack([x + c * mx - s * my, y + s * mx + c * my, heading + h], axis=-1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", [kind for kind in LIBRARY.values() if issubclass(kind, Linkage)])
def test_the_wheel_angle_has_true_derivatives(kind: type[Linkage]) -> None:
    effect = kind(0.05)

    def angle(t):
        return effect.steer(TURNING.phi.at(t), BOARD.wheelsets[1]).angle

    t = jnp.asarray(0.61)
    rate = jax.grad(angle)
    expected = (angle(t), rate(t), jax.grad(rate)(t))
    np.testing.assert_allclose(effect.steer(TURNING.phi.at(t), BOARD.wheelsets[1]), expected, rtol=1e-9)


def test_backlash_is_a_dead_zone_and_zero_bypasses_it() -> None:
    wheelset, b = BOARD.wheelsets[0], 0.05
    for angle in (-0.8, -0.01, 0.0, 0.02, 0.6):
        given = Joint(*map(jnp.asarray, (angle, 0.7, -1.1)))
        loose = SteeringBacklash(b=b).steer(given, wheelset)
        np.testing.assert_allclose(loose.angle, angle - b * np.tanh(angle / b), rtol=0, atol=1e-15)
        assert SteeringBacklash(b=0.0).steer(given, wheelset) == given
        vanishing = SteeringBacklash(b=1e-9).steer(given, wheelset)
        np.testing.assert_allclose(vanishing.angle, angle, rtol=0, atol=2e-9)


def test_the_chain_from_command_to_wheel() -> None:
    """Command -> lag, gain -> joint -> backlash -> offset, crab, in whatever order the effects were added."""
    t, T, g, b, o, crab = jnp.asarray(0.83), 0.1, 0.2, 0.05, 0.03, 0.02
    parts = {
        "steering_crab": LIBRARY["steering_crab"](o=crab),
        "steering_offset": LIBRARY["steering_offset"](o=o),
        "steering_backlash": LIBRARY["steering_backlash"](b=b),
        "steering_gain": LIBRARY["steering_gain"](g=g),
        "steering_lag": LIBRARY["steering_lag"](T=T),
    }
    phi = (1 + g) * float(TURNING.phi.at(t - T).angle)
    loose = phi - b * np.tanh(phi / b)
    for order in (list(parts), list(reversed(parts))):
        model = bare("free").add(**{name: parts[name] for name in order})
        front, back = (wheel.joint.angle for wheel in model.motion(t, moving_state("free"), TURNING).wheels)
        np.testing.assert_allclose([front, back], [loose + o + crab, -loose - o + crab], rtol=0, atol=1e-14)


def test_com_offset_moves_the_wheelsets() -> None:
    board = bare("free").add(com=LIBRARY["com_offset"](a=0.03)).effective_vehicle()
    np.testing.assert_allclose([board.arm(w) for w in board.wheelsets], [0.25 - 0.03, -(0.25 + 0.03)], rtol=1e-14)
    why = LIBRARY["com_offset"]().inapplicable_because(bare("coupled"))
    assert why is not None and "free" in why


class Slid(NamedTuple):
    """The wheels of an instant and their traction with and without an effect."""

    slip: np.ndarray
    lateral: np.ndarray
    rolling: np.ndarray
    force: np.ndarray
    plain: np.ndarray


def slid(constraint: str, tyre: Any, memory: tuple[float, float] | None = None, **effects: Effect) -> Slid:
    body, t = moving_state(constraint), jnp.asarray(0.7)
    model, plain = Model(BOARD, tyre, constraint).add(**effects), Model(BOARD, tyre, constraint)
    motion = model.motion(t, body, TURNING)
    lateral, rolling = (np.array([getattr(w, k) for w in motion.wheels]) for k in ("lateral", "rolling"))
    slip = np.arctan(lateral / np.hypot(rolling, float(BOARD.creep_speed)))
    memories = () if memory is None else (tuple(map(jnp.asarray, memory)),)
    forces = np.array(model.traction(motion, memories)), np.array(plain.traction(motion, ()))
    return Slid(slip, lateral, rolling, *forces)


def law(slip: np.ndarray, shift: float = 0.0, lift: float = 0.0) -> np.ndarray:
    """The magic formula of TYRE, by the reference."""
    six = (float(TYRE.B), float(TYRE.C), float(TYRE.D), float(TYRE.E), shift, lift)
    return np.array([full.magic_formula(float(each), *six) for each in slip])


@pytest.mark.parametrize("constraint", BOTH)
def test_tyre_offset_is_in_the_law(constraint: str) -> None:
    found = slid(constraint, TYRE, offset=TyreOffset(dSh=0.03, dSv=0.2))
    np.testing.assert_allclose(found.force, law(found.slip, 0.03, 0.2), rtol=1e-12)
    bakker = slid(constraint, Bakker(load=34.0), offset=TyreOffset(dSh=0.0, dSv=0.2))
    np.testing.assert_allclose(bakker.force, bakker.plain + 0.2, rtol=1e-12)


def test_tyre_offset_is_mirrored_under_coupled_and_of_one_sign_under_free() -> None:
    """At rest: `coupled` twists the board, -L sum_i F_i / 2 = I sdot; `free` pushes it to one side."""
    zero, lift = jnp.asarray(0.0), 0.2
    for constraint, expected in {
        "coupled": [0.0, -0.25 * lift / float(BOARD.total_inertia)],
        "free": [0.0, -2 * lift / 7.0, 0.0],
    }.items():
        model = bare(constraint).add(offset=TyreOffset(dSv=lift))
        rates, _ = model.rates(zero, (model.constraint.from_rest(zero, zero, zero), ()), STILL)
        np.testing.assert_allclose(rates[-len(expected) :], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("constraint", BOTH)
@pytest.mark.parametrize("tyre", [TYRE, Rayleigh(9.0)], ids=["Pacejka", "Rayleigh"])
def test_grip_is_scaled(constraint: str, tyre: Any) -> None:
    x = float(moving_state(constraint)[0])
    split = slid(constraint, tyre, grip=LIBRARY["grip_split"](s=0.3))
    np.testing.assert_allclose(split.force, split.plain * [1.3, 0.7], rtol=1e-12)
    slow = slid(constraint, tyre, grip=LIBRARY["stribeck_grip"](s=0.4))
    expected = slow.plain * (1 + 0.4 * np.exp(-((slow.lateral / 0.05) ** 2)))
    np.testing.assert_allclose(slow.force, expected, rtol=1e-12)
    floor = slid(constraint, tyre, grip=LIBRARY["grip_gradient"](g=0.2))
    np.testing.assert_allclose(floor.force, floor.plain * (1 + 0.2 * x), rtol=1e-12)


def test_stribeck_takes_the_whole_of_the_force() -> None:
    """Offsets and relaxation come before it; the gradient of the floor scales D alone, not dSv."""
    both = {"offset": TyreOffset(dSv=0.2), "slow": LIBRARY["stribeck_grip"](s=0.4)}
    found = slid("free", TYRE, **both)
    gain = 1 + 0.4 * np.exp(-((found.lateral / 0.05) ** 2))
    np.testing.assert_allclose(found.force, gain * law(found.slip, 0.0, 0.2), rtol=1e-12)
    floor = slid("free", TYRE, offset=TyreOffset(dSv=0.2), floor=LIBRARY["grip_gradient"](g=0.5))
    np.testing.assert_allclose(floor.force, law(floor.slip) * (1 + 0.5 * 0.4) + 0.2, rtol=1e-12)


def test_relaxation_lags_the_slip_angle_before_its_shift() -> None:
    sigma, memory = 0.04, (0.05, -0.02)
    effects = {"offset": TyreOffset(dSh=0.03), "lag": TyreRelaxation(sigma=sigma)}
    found = slid("free", TYRE, memory, **effects)
    np.testing.assert_allclose(found.force, law(np.array(memory), 0.03), rtol=1e-12)
    model = bare("free").add(**effects)
    state = (moving_state("free"), (tuple(map(jnp.asarray, memory)),))
    _, (rates,) = model.rates(jnp.asarray(0.7), state, TURNING)
    expected = (np.abs(found.rolling) + 0.02) / sigma * (found.slip - memory)
    np.testing.assert_allclose(rates, expected, rtol=1e-10)


def test_relaxation_starts_at_zero_and_zero_length_bypasses_it() -> None:
    zero = jnp.asarray(0.0)
    model = bare("free").add(lag=TyreRelaxation(sigma=0.04))
    _, memories = model.start((zero, zero, zero))
    assert [[float(m) for m in lags] for lags in memories] == [[0.0, 0.0]]
    found = slid("free", TYRE, (0.5, -0.5), lag=TyreRelaxation(sigma=0.0))
    np.testing.assert_array_equal(found.force, found.plain)


def test_grip_split_says_where_it_is_silent() -> None:
    crab = {"steering_crab": {"o": 0.05}}
    plain, split = (poses(having("coupled", crab | more)) for more in ({}, {"grip_split": {"s": 0.5}}))
    assert np.abs(split - plain).max() > 1e-5, "With angles that are not opposite it is not silent."
    assert "opposite" in LIBRARY["grip_split"].unobservable_because


# --- A user's own ----------------------------------------------------------------------------------------------------


class Spring(Force):
    """A spring from the centre of mass to a nail in the floor at (x, y)."""

    description = "A rubber band pulls the board to a nail."
    k: Scalar = param("N/m", low=0.0, default=0.0)
    x: Scalar = param("m", default=0.0)
    y: Scalar = param("m", default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(self.k * (self.x - motion.x), self.k * (self.y - motion.y))
        return X, Y, jnp.zeros_like(X)


@pytest.mark.slow
def test_an_effect_of_ones_own() -> None:
    """On a frictionless board it swings: position = nail + cos(sqrt(k / m) t) (start - nail)."""
    model = Model(BOARD, no_traction(), "free").add(band=Spring(k=20.0, x=0.5, y=-0.1))
    nail, start, times = np.array([0.5, -0.1]), np.array([0.3, -0.2, 0.5]), np.linspace(0.0, 2.0, 5)
    found = poses(model, STILL, start, times)
    expected = nail + np.cos(np.sqrt(20.0 / 7.0) * times)[:, None] * (start[:2] - nail)
    np.testing.assert_allclose(found[:, :2], expected, rtol=0, atol=1e-9)
    assert {"effects.band.k", "effects.band.x", "effects.band.y"} <= set(parameters(model))
    with pytest.raises(ValueError, match="must be at least 0"):
        Spring(k=-1.0)
