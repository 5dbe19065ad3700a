"""The missing force: recovered within its band, named by what it depends on, and written as an effect of one's own."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.commands.named_effects import effect_class
from snakejax.commands.option_texts import effect_spec
from snakejax.core.parameter import Scalar, own_parameters, param
from snakejax.diagnosis.latent_force.dependence import FittedFunction
from snakejax.diagnosis.latent_force.missing_force import LatentForce, choose_structure, estimate_latent_force
from snakejax.diagnosis.latent_force.piecewise_force import FreeForce
from snakejax.diagnosis.latent_force.template import effect_template
from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet, structures
from snakejax.dynamics.contact import Motion, Wrench
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Force
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.dynamics.tyres import Pacejka
from snakejax.effects import LIBRARY
from snakejax.recording.case import load_case
from snakejax.recording.run import Case, Noise, Run
from snakejax.simulation.integrate import simulate
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

NOISE = Noise(4e-4, 2.5e-3, "test")
TYRE = Pacejka(B=6.0, C=1.4, D=7.0, E=0.0)
GAITS = [
    ([[0.9, 4.0, 0.0]], [[1.57, 4.0, 0.0]], (0.4, -0.3, 1.0)),
    ([[0.5, 3.0, 0.0], [0.25, 0.6, 0.0]], [[1.5, 3.0, 0.0]], (-0.5, 0.6, -2.0)),
    ([[0.5, 2.1, 0.0], [0.3, 3.7, 0.4]], [[1.2, 2.1, 0.2], [0.9, 4.3, 0.0]], (0.1, 0.9, 2.5)),
]


class Spring(Force):
    """A spring to the point (0.5, 0.8) m of the floor."""

    k: Scalar = param("N/m", default=0.3)

    def wrench(self, motion: Motion) -> Wrench:
        X, Y = motion.into_body(-self.k * (motion.x - 0.5), -self.k * (motion.y - 0.8))
        return X, Y, jnp.zeros_like(X)


def made(constraint: str = "free", **effects) -> Case:
    """Three runs of 6 s with `effects` hidden in them."""
    board = Board(**TABLE_II, creep_speed=0.01)
    model = Model(board, TYRE, constraint).add(**effects)
    times, draw, runs = jnp.arange(300) / 50, np.random.default_rng(3), []
    for k, (phi, psi, start) in enumerate(GAITS):
        gait = Gait(Tracked(Sines.of(phi), 100.0, 10.0), Tracked(Sines.of(psi), 100.0, 10.0))
        pose = simulate(model, gait, times, start).pose + draw.normal(size=(300, 3)) * np.asarray(NOISE.channels)
        runs.append(Run(f"run-{k}", "train", times, pose, gait))
    return Case("made", "made", constraint, board, tuple(runs), NOISE)


def searched(case: Case) -> LatentForce:
    bench = CandidateSet.of(structures(case, "pacejka", None)[0], case, case.noise, {"yaw_bias": LIBRARY["yaw_bias"]()})
    return estimate_latent_force(bench, CandidateFit((), SimpleNamespace(values=bench.problem.values(), misfit=np.inf)))


@pytest.fixture(scope="module")
def spring() -> LatentForce:
    return searched(made(spring=Spring()))


def true_force(case: Case, missing: LatentForce) -> list[np.ndarray]:
    """(X, Y) of the spring at the knots of each run, from the recorded pose."""
    found = []
    for run, force in zip(case.runs, missing.runs, strict=True):
        x, y, heading = (np.interp(force.t, np.asarray(run.times), np.asarray(run.pose)[:, c]) for c in range(3))
        east, north = -0.3 * (x - 0.5), -0.3 * (y - 0.8)
        c, s = np.cos(heading), np.sin(heading)
        found.append(np.stack([east * c + north * s, north * c - east * s], axis=1))
    return found


def test_a_free_force_is_linear_between_its_knots():
    values = np.arange(12.0).reshape(4, 3) ** 2
    force = FreeForce(jnp.asarray(2.0), jnp.asarray(0.5), jnp.asarray(values))
    times = np.array([0.0, 2.0, 2.2, 2.75, 3.5, 9.0])
    motion = Motion(*(None,) * len(Motion._fields))
    found = np.array([force.wrench(motion._replace(time=jnp.asarray(t))) for t in times])
    knots = 2.0 + 0.5 * np.arange(4)
    np.testing.assert_allclose(found, np.stack([np.interp(times, knots, v) for v in values.T], axis=1), atol=1e-12)


@pytest.mark.slow
def test_the_force_is_recovered_within_its_band(spring):
    truth = np.concatenate(true_force(made(spring=Spring()), spring))
    force, sd = (np.concatenate([getattr(run, part)[:, :2] for run in spring.runs]) for part in ("force", "sd"))
    assert np.corrcoef(force[:, 0], truth[:, 0])[0, 1] > 0.95
    assert np.mean(np.abs(force - truth) < 3 * sd) > 0.9
    assert spring.misfit[0] > 1.2 and abs(spring.misfit[1] - 1) < 0.15


@pytest.mark.slow
def test_a_spring_in_the_world_depends_on_the_place(spring):
    assert spring.depends_on[0][0] == "world_position"
    assert spring.depends_on[0][1] > 0.8
    assert spring.shape.carrier == "world"


@pytest.mark.long
def test_of_two_structures_the_force_is_counted_beside_the_one_that_leaves_less():
    """A spring pulls at a coupled board, which feels nothing lateral."""
    case, few = made("coupled", spring=Spring()), {"yaw_bias": LIBRARY["yaw_bias"]()}
    both = []
    for k, model in enumerate(structures(case, "pacejka", None)):
        bench = CandidateSet.of(model, case, NOISE, few, switched=k == 1)
        both.append((bench, CandidateFit((), SimpleNamespace(values=bench.problem.values(), misfit=np.inf))))
    found = choose_structure(both[::-1], both[0][0], ())
    assert not found.switched and found.left < 1.2
    assert np.isnan(np.concatenate([run.sd[:, 1] for run in found.runs])).all()
    assert np.isfinite(np.concatenate([run.sd[:, [0, 2]] for run in found.runs])).all()
    assert found.depends_on[0][0] == "world_position"


@pytest.mark.long
def test_a_known_effect_survives_beside_the_force_and_a_mere_helper_does_not():
    """A spring pulls at a board whose steering lags: beside the lag the spring is seen alone, a bias makes no odds."""
    case = made(spring=Spring(), steering_lag=LIBRARY["steering_lag"](0.04))
    few = {name: LIBRARY[name]() for name in ("yaw_bias", "steering_lag")}
    bench = CandidateSet.of(structures(case, "pacejka", None)[0], case, NOISE, few)
    step = CandidateFit((), SimpleNamespace(values=bench.problem.values(), misfit=np.inf))
    found = choose_structure([(bench, step)], bench, tuple(few))
    assert found.beside == ("steering_lag",)
    assert found.depends_on[0][0] == "world_position"
    lag = found.estimates["effects.steering_lag.T"]
    assert abs(lag.value - 0.04) < 3 * lag.sd and lag.sd < 0.01


VALUES = np.linspace(-3, 3, 25)
SHAPES = {
    "place": FittedFunction("world_position", "place", "world", *(np.stack([VALUES, VALUES**2], 1),) * 2),
    "grip": FittedFunction("rotor_rate", "rotor_rate", "grip", VALUES, -0.3 * np.tanh(VALUES[:, None] ** 2)),
    "slip": FittedFunction("slip", "slip_angle", "grip", VALUES, 0.1 * VALUES[:, None]),
    "turn": FittedFunction("heading", "heading", "world", VALUES, np.stack([np.cos(VALUES), np.sin(VALUES)], 1)),
    "phase": FittedFunction("gait_phase", "gait_phase", "N", VALUES, np.cos(VALUES)[:, None]),
    "drag": FittedFunction("speed", "speed", "drag", VALUES, np.cos(VALUES)[:, None]),
    "damping": FittedFunction("slip", "slip_speed", "yaw_drag", VALUES, np.cos(VALUES)[:, None]),
    "late": FittedFunction("time", "time", "Y", VALUES, VALUES[:, None] ** 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_the_starter_loads_and_is_neutral_at_its_default(name, tmp_path):
    text = effect_template(LatentForce((), ((SHAPES[name].variable, 1.0),), SHAPES[name], (9.0, 1.0), {}, False))
    assert len(text.splitlines()) <= 30 and max(map(len, text.splitlines())) <= 120
    (tmp_path / "mine.py").write_text(text)
    kind = effect_class(effect_spec(f"{tmp_path / 'mine.py'}:MissingForce"))
    model = Model(Board(**TABLE_II, creep_speed=0.01), TYRE, "free")
    gait = Gait(Sines.of(GAITS[0][0]), Sines.of(GAITS[0][1]))
    state = model.initial_state((0.4, -0.3, 1.0, 0.3, 0.05, 0.4), jnp.asarray(0.3), gait)
    names = [part for part, _ in own_parameters(kind())]

    @jax.jit
    def rates(step):
        acting = model.add(mine=kind(**{part: step[k] for k, part in enumerate(names)}))
        return jnp.stack(acting.rates(jnp.asarray(0.3), state, gait)[0])

    zero = jnp.zeros(len(names))
    np.testing.assert_allclose(rates(zero), jnp.stack(model.rates(jnp.asarray(0.3), state, gait)[0]), atol=1e-12)
    slopes = jax.jit(jax.jacfwd(rates))(zero)
    assert np.isfinite(slopes).all() and (np.abs(slopes).sum(axis=0) > 0).all()


@pytest.mark.long
@pytest.mark.parametrize(("board", "variable"), [("board-j", "world_position"), ("board-d", "rotor_rate")])
def test_what_a_recording_hides_is_named(recordings, board, variable):
    """`board-j` hides a spring of 0.15 N/m to (0.5, 0.8) m, `board-d` a grip that falls with the rotor's rate."""
    case = load_case(recordings / board)
    bench = CandidateSet.of(
        structures(case, "pacejka", None)[0], case, case.noise, {n: k() for n, k in LIBRARY.items()}
    )
    found = estimate_latent_force(
        bench, CandidateFit((), SimpleNamespace(values=bench.problem.values(), misfit=np.inf))
    )
    assert found.depends_on[0][0] == variable
    assert found.depends_on[0][1] > max(0.6, found.depends_on[1][1] + 0.1)
    assert found.misfit[1] < 1.1
    if board != "board-j":
        return
    truth, estimate = [], []
    for run, force in zip(case.having("train"), found.runs, strict=True):
        seen = np.isfinite(np.asarray(run.pose)).all(axis=1)
        t, pose = np.asarray(run.times)[seen], np.asarray(run.pose)[seen]
        x, y, heading = (np.interp(force.t, t, pose[:, c]) for c in range(3))
        truth.append(-0.15 * ((x - 0.5) * np.cos(heading) + (y - 0.8) * np.sin(heading)))
        estimate.append(force.force[:, 0])
    assert np.corrcoef(np.concatenate(estimate), np.concatenate(truth))[0, 1] > 0.95
