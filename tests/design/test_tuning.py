"""Tuned gaits against dense sampling, energy, and an integration that shares nothing with the package."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA
from helpers.schema import deviations
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.interpolate import CubicSpline

from snakejax import (
    Board,
    Controller,
    Distance,
    Effort,
    Fourier,
    Gait,
    Limits,
    Logged,
    Model,
    Pacejka,
    Reach,
    Sines,
    Spline,
    SumsOfSines,
    Tracked,
    simulate,
)
from snakejax.commands.cli import main
from snakejax.core.errors import InputError
from snakejax.design import joint_log, spline, tune
from snakejax.design.limits import peaks, slack, within
from snakejax.design.tuning import sines
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import no_traction
from snakejax.recording.readers import read_joint_log
from snakejax.simulation import torques
from snakejax.vehicles.roller_racer import ROLLER_RACER, RollerRacer
from snakejax.vehicles.snakeboard.board import TABLE_II

TYRE = dict(B=6.0, C=1.4, D=6.0, E=0.3)
BOARD = Board(**TABLE_II | {"creep_speed": 0.01})
LIMITS = Limits.of({"phi": 0.9, "psi": 1.6, "phi_rate": 4.0, "psi_rate": 6.5, "psi_acceleration": 40.0})
GAINS = dict(kp=100.0, kd=10.0)
SECONDS = 1.5


def independent(terms, seconds, start=(0.0, 0.0, 0.0), tyre=TYRE, creep=0.01):
    """(pose, greatest |phi|, |psi|, |phi'|, |psi'|) of the `free` board under eq. (8), its joints integrated too."""
    m, Jr, L = TABLE_II["mass"], TABLE_II["rotor_inertia"], TABLE_II["half_length"]
    inertia = m * L**2

    def command(rows, t):
        a, w, p = np.array(rows).T[:, :, None]
        turn = w * t + p
        parts = (a * np.sin(turn), a * w * np.cos(turn), -a * w**2 * np.sin(turn))
        return [part.sum(axis=0) for part in parts]

    def rates(t, state):
        heading, u, w, r, *joints = state[2:]
        moves = []
        for rows, angle, rate in (("phi", *joints[:2]), ("psi", *joints[2:])):
            wanted, wanted_rate, wanted_acceleration = (float(q[0]) for q in command(terms[rows], np.array([t])))
            moves += [rate, wanted_acceleration + 10 * (wanted_rate - rate) + 100 * (wanted - angle)]
        X = Y = N = 0.0
        for place, phi in ((L, joints[0]), (-L, -joints[0])):
            across = w + place * r
            slip, roll = -u * np.sin(phi) + across * np.cos(phi), u * np.cos(phi) + across * np.sin(phi)
            delta = np.arctan(slip / np.hypot(roll, creep))
            eta = (1 - tyre["E"]) * delta + tyre["E"] / tyre["B"] * np.arctan(tyre["B"] * delta)
            F = tyre["D"] * np.sin(tyre["C"] * np.arctan(tyre["B"] * eta))
            X, Y, N = X + F * np.sin(phi), Y - F * np.cos(phi), N - place * F * np.cos(phi)
        c, s = np.cos(heading), np.sin(heading)
        turning = (N - Jr * moves[3]) / inertia
        return [u * c - w * s, u * s + w * c, r, X / m + r * w, Y / m - r * u, turning, *moves]

    times = np.linspace(0, seconds, 4001)
    found = solve_ivp(rates, (0, seconds), [*start, *[0.0] * 7], "LSODA", times, rtol=1e-9, atol=1e-11).y
    commands = [command(terms[joint], times)[k] for k in (0, 1) for joint in ("phi", "psi")]
    joints = [found[6], found[8], found[7], found[9]]
    most = [max(np.abs(a).max(), np.abs(b).max()) for a, b in zip(commands, joints, strict=True)]
    return found[:3, -1], dict(zip(("phi", "psi", "phi_rate", "psi_rate"), most, strict=True))


def some_gaits():
    rng = np.random.default_rng(0)
    shapes = (SumsOfSines((0.9, 1.6), (0.4, 16.0)), Fourier((0.9, 1.6), (0.4, 6.0)), Spline((0.9, 1.6), 5.0, 14))
    for shape, gains in zip((*shapes, shapes[0]), (GAINS, {}, GAINS, {}), strict=True):
        yield Controller(**gains).driven(shape.gait(jnp.asarray(shape.guess(rng) * rng.uniform(0.5, 2.0))))


@pytest.mark.slow
def test_limits_hold_between_the_points_of_a_grid_too() -> None:
    """Bounds are never below a sampling a hundred times as dense, and hardly above it."""
    model = Model(BOARD, Pacejka(**TYRE), "free")
    times = jnp.linspace(0.0, 5.0, 200_001)
    sample = jax.jit(jax.vmap(lambda signal, t: signal.at(t), in_axes=(None, 0)))

    def dense(gait):
        found = {}
        for name in ("phi", "psi"):
            joint = getattr(gait, name)
            each = [sample(s, times) for s in (joint, getattr(joint, "command", joint))]
            for quantity, values in zip(("", "_rate", "_acceleration"), zip(*each, strict=True), strict=True):
                found[name + quantity] = max(float(jnp.abs(v).max()) for v in values)
        return found

    for gait in some_gaits():
        bound, there = peaks(model, gait, 5.0), dense(gait)
        for name in bound:
            margin = 0.05 if "acceleration" in name else 1e-3
            assert there[name] <= bound[name] * (1 + 1e-12) and bound[name] <= there[name] * (1 + margin) + 1e-9
        kept = dense(within(model, gait, LIMITS, 5.0))
        assert all(kept[name] <= most * (1 + 1e-12) for name, most in LIMITS.named().items())
        if (np.asarray(slack(model, gait, LIMITS, 5.0)) >= 0).all():
            assert all(there[name] <= most for name, most in LIMITS.named().items())


def test_a_spline_is_that_of_scipy_and_a_series_that_of_fourier() -> None:
    knots = np.linspace(0.0, 3.0, 7)
    angles = np.sin(knots**2)
    wave, theirs = spline(knots)(jnp.asarray(angles)), CubicSpline(knots, angles, bc_type="natural")
    shape = Fourier((0.5, 1.5), (1.0, 4.0), 2)
    z = jnp.array([np.log(2.0), 0.1, 0.2, 0.3, 0.4, 0.5, -0.1, 0.6, 0.0, 0.2, 0.1])
    gait = shape.gait(z)
    for t in (0.0, 0.3, 1.7, 2.9):
        for order, part in enumerate(wave.at(jnp.asarray(t))):
            assert float(part) == pytest.approx(float(theirs(t, order)), abs=1e-12)
        turns = np.array([2 * t, 4 * t])
        series = 0.5 * (0.1 + np.array([0.2, 0.3]) @ np.sin(turns) + np.array([0.4, 0.5]) @ np.cos(turns))
        assert float(gait.phi.at(jnp.asarray(t)).angle) == pytest.approx(series, abs=1e-9)


def test_a_known_gait_has_unknowns_that_make_it() -> None:
    shape = SumsOfSines((0.9, 1.6), (0.4, 16.0))
    gait = Gait(Sines.of([[0.5, 3.0, 0.3], [0.2, 1.1, -2.0]]), Sines.of([[1.5, 4.0, 0.0]]))
    z = shape.like(gait)
    again = shape.gait(jnp.asarray(z))
    for t in (0.0, 1.0, 2.5):
        for joint in ("phi", "psi"):
            mine, theirs = (getattr(g, joint).at(jnp.asarray(t)) for g in (again, gait))
            np.testing.assert_allclose(mine, theirs, atol=1e-9)
    assert shape.like(Gait(gait.phi, Logged.of([0, 1, 2, 3], [0, 1, 0, 1]))) is None


@pytest.mark.slow
def test_torques_do_the_work_that_the_ideal_board_gains() -> None:
    """Without friction the work of the joints is the kinetic energy (matrix M of eq. 2)."""
    model = Model(BOARD, Pacejka(**TYRE), "ideal")
    gait = Gait(*(Tracked(Sines.of(rows), **GAINS) for rows in ([[0.5, 3.0, 0.2]], [[1.2, 3.0, 1.0]])))
    times = jnp.linspace(0.0, 2.0, 2001)
    ran = simulate(model, gait, times)
    torque = np.asarray(torques(model, gait, ran))
    phi, psi = (jax.vmap(signal.at)(times) for signal in (gait.phi, gait.psi))
    power = torque[:, 0] * np.asarray(phi.rate) + torque[:, 1] * np.asarray(psi.rate)
    work = cumulative_simpson(power, x=np.asarray(times), initial=0.0)
    motion = jax.vmap(lambda t, state: model.motion(t, state[0], gait)[5:8])(times, ran.state)
    u, w, r = (np.asarray(part) for part in motion)
    m, I, Jr, Jw = BOARD.mass, BOARD.total_inertia, BOARD.rotor_inertia, BOARD.wheelset_inertia  # noqa: E741
    rotor = np.asarray(psi.rate)
    energy = m * (u**2 + w**2) / 2 + I * r**2 / 2 + Jr * (rotor**2 / 2 + r * rotor) + Jw * np.asarray(phi.rate) ** 2
    np.testing.assert_allclose(work, energy, atol=2e-6)
    assert energy.max() > 0.1


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The JSON of a short tuning by the command line, on a board whose tyre is given."""
    path = tmp_path_factory.mktemp("tuned") / "tune.json"
    values = ",".join(f"{name}={value}" for name, value in TYRE.items())
    limits = "phi=0.9,psi=1.6,phi_rate=4,psi_rate=6.5"
    case = [
        str(DATA / "level-board"),
        "--set",
        values,
        "--seconds",
        str(SECONDS),
        "--limit",
        limits,
        "--start",
        "1,2,0.5",
    ]
    assert main(["tune", *case, "--json", str(path), "--out", str(path.parent), "--quiet"]) == 0
    return json.loads(path.read_text()), path.parent


@pytest.mark.slow
def test_what_the_json_says_is_what_an_independent_simulation_gives(told) -> None:
    found, folder = told
    pose, most = independent(found["gait"], SECONDS, found["start"])
    assert found["objective"] == pytest.approx(np.hypot(pose[0] - 1, pose[1] - 2), abs=1e-5)
    assert all(most[name] <= found["limits"][name] * (1 + 1e-9) for name in most)
    assert all(most[name] <= found["reached"][name] * (1 + 1e-9) for name in most)
    known = [independent(found["before"]["gait"], SECONDS)[0]]
    assert found["before"]["objective"] == pytest.approx(np.hypot(*known[0][:2]), abs=1e-5)
    assert found["objective"] > 1.2 * found["before"]["objective"]
    assert (folder / "tune.png").stat().st_size > 10_000
    assert f"phi = {found['gait']['phi']}" in (folder / "tune-gait.toml").read_text()
    assert deviations("tune", found) == []


@pytest.fixture(scope="module")
def pose():
    """A pose that some gait of three sines within the limits reaches in 1.5 s."""
    shape = SumsOfSines((0.9, 1.6), (2.0, 16.0))
    gait = Controller(**GAINS).driven(shape.gait(jnp.asarray(shape.guess(np.random.default_rng(3)))))
    model = Model(BOARD, Pacejka(**TYRE), "free")
    kept = within(model, gait, LIMITS, SECONDS)
    terms = {name: sines(getattr(kept, name).command) for name in ("phi", "psi")}
    return independent(terms, SECONDS)[0]


@pytest.mark.slow
def test_a_pose_is_reached_and_an_own_objective_is_followed(pose) -> None:
    model = Model(BOARD, Pacejka(**TYRE), "free")
    found = tune(model, Reach(*pose), LIMITS, SECONDS, driver=Controller(**GAINS))
    there, most = independent(found.terms(), SECONDS)
    assert found.met and np.abs(there - pose).max() < 1e-4
    assert all(value <= LIMITS.named()[name] * (1 + 1e-9) for name, value in most.items())


@pytest.mark.slow
def test_several_boards_are_tuned_for_together(pose) -> None:
    """Under the gait for the worst of two boards that is better off than under the gait for the other."""
    grips = [Model(BOARD, Pacejka(**TYRE | {"D": D}), "free") for D in (6.0, 2.0)]
    how = dict(driver=Controller(**GAINS), starts=2, most=20)
    alone = tune(grips[0], Reach(*pose), LIMITS, SECONDS, others=grips, **how)
    worst = tune([grips[0], *grips], Reach(*pose), LIMITS, SECONDS, over="worst", **how)

    def misses(tuned):
        return [np.hypot(one["position_error_m"] / 0.01, np.rad2deg(one["heading_error_rad"])) for one in tuned.spread]

    assert len(misses(alone)) == len(misses(worst)) == 2
    assert max(misses(worst)) < max(misses(alone))


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--objective", "reach:1,2"], "is not a pose"),
        (["--objective", "speed"], "no objective `speed`"),
        (["--objective", "effort:-1"], "is not positive"),
        (["--objective", "nowhere.py:cost"], "no file `nowhere.py`"),
        (["--limit", "chi=1"], "no limit `chi`"),
        (["--limit", "phi=-1"], "above 0"),
        (["--limit", "phi=1.57"], "across the board"),
        (["--seconds", "0"], "cannot last 0 s"),
        (["--over", "worst"], "needs samples of a fit"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(options, why, capsys) -> None:
    assert main(["tune", "paper-rotate", *options]) == 2
    said = capsys.readouterr().err
    assert why in said and said.count("\n") == 1 and "Traceback" not in said


def test_a_spline_becomes_a_joint_log_of_the_same_gait(tmp_path) -> None:
    shape = Spline((0.9, 1.6), 5.0, 14)
    gait = Controller(**GAINS).driven(shape.gait(jnp.asarray(shape.guess(np.random.default_rng(0)))))
    (tmp_path / "log.csv").write_text(joint_log(gait))
    log = read_joint_log(tmp_path / "log.csv")
    for mine, angles in ((gait.phi, log.phi), (gait.psi, log.psi)):
        np.testing.assert_allclose(Logged.of(log.times, angles).coefficients, mine.command.coefficients, atol=1e-12)


@pytest.mark.long
def test_another_vehicle_is_tuned_by_the_names_of_its_inputs() -> None:
    """A roller racer: its one input keeps its limits at every sampled instant and carries it as far as is said."""
    racer = Model(RollerRacer(**ROLLER_RACER), no_traction(), "ideal")
    known = Inputs({"handle": Sines.of([[0.6, 3.0, 0.0]])})
    limits = Limits(handle=0.8, handle_rate=4.0)
    best = tune(racer, Distance(), limits, 2.0, given=[known], starts=1, most=5)
    assert best.before is not None and best.after.result > 1.1 * best.before.result
    assert list(best.terms()) == ["handle"] and best.units == {"handle": "rad"}
    rows = np.array(best.terms()["handle"]).T[:, :, None]
    times = np.linspace(0.0, 2.0, 20_001)
    angle = (rows[0] * np.sin(rows[1] * times + rows[2])).sum(axis=0)
    rate = (rows[0] * rows[1] * np.cos(rows[1] * times + rows[2])).sum(axis=0)
    assert 0.5 < np.abs(angle).max() <= 0.8 and np.abs(rate).max() <= 4.0
    pose = np.asarray(simulate(racer, Inputs({"handle": Sines.of(rows[:, :, 0].T)}), jnp.array([0.0, 2.0])).pose)
    assert best.after.result == pytest.approx(np.hypot(*(pose[-1] - pose[0])[:2]), abs=1e-6)


def test_limits_and_objectives_that_another_vehicle_does_not_have_are_refused() -> None:
    racer, limits = Model(RollerRacer(**ROLLER_RACER), no_traction(), "ideal"), Limits(handle=0.8, handle_rate=4.0)
    with pytest.raises(InputError, match="The limits are of phi, psi, but the inputs are handle"):
        tune(racer, Distance(), LIMITS, 2.0)
    with pytest.raises(InputError, match="joint torques of a racer are not known"):
        tune(racer, Effort(0.5), limits, 2.0)


def test_a_log_cannot_be_written_as_sines() -> None:
    with pytest.raises(ValueError, match="joint log"):
        sines(Logged.of([0, 1, 2, 3], [0, 1, 0, 1]))
    with pytest.raises(ValueError, match=r"case\.toml"):
        joint_log(Gait(Sines.of([]), Sines.of([])))
    with pytest.raises(InputError, match="Nothing limits"):
        Limits.of({"phi": 0.5})


def test_limits_by_keyword() -> None:
    assert Limits(phi=0.9, psi=1.6, psi_rate=6.5) == Limits.of({"phi": 0.9, "psi": 1.6, "psi_rate": 6.5})
    with pytest.raises(InputError, match="Nothing limits the angle of `psi`"):
        Limits(phi=0.9, psi_rate=6.5)
    with pytest.raises(InputError, match="There is no limit `psi_speed`"):
        Limits(phi=0.9, psi=1.6, psi_speed=6.5)
