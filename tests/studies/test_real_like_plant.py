"""The independent plant that makes boards as real ones are, against published numbers, solve_ivp and recordings."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.folders import ROOT
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import chi2

sys.path.insert(0, str(ROOT / "benchmarks" / "real_like"))

from joints import joint
from layout import NAMES, vector
from noise import Noise
from plant import rates
from solve import poses

TABLE_II = {"m": 7.0, "I": 0.4375, "Jr": 0.0238, "L": 0.25, "B": 0.09, "C": 2.0, "D": 1.0, "E": 0.6, "creep": 1e-4}
ROTATE = ([[0.916, 2.0, 0.0]], [[1.57, 4.0, 0.0]])
KEY_NAMES = {
    "patch": "grip_gradient.g",
    "rotor_gain": "rotor_gain.g",
    "yaw_torque": "yaw_bias.t",
    "washboard": "washboard.f",
    "slope_x": "ground_slope.sx",
    "slope_y": "ground_slope.sy",
    "com_x": "com_offset.a",
    "spin_grip": "spin_grip.s",
    "f_roll": "rolling_resistance.f",
    "c_yaw": "yaw_damping.c",
    "steer_delay": "steering_lag.T",
    "steer_bias": "steering_offset.o",
    "Sh": "tyre_offset.dSh",
    "grip_split": "grip_split.s",
    "magnus": "magnus_force.c",
}
"""What the key of the boards l to o calls the numbers of the plant."""


@pytest.mark.slow
@pytest.mark.parametrize(("free", "turned"), [(0.0, 0.919), (1.0, 2.076)])
def test_the_rotating_gait_turns_as_far_as_an_independent_integration_says(free, turned):
    """Table II, 14 s: 0.919 rad with coupled skids, 2.076 with free ones; three digits are given."""
    times = np.linspace(0, 14, 141)
    path = poses(vector(TABLE_II | {"free": free}), *ROTATE, times, np.zeros(3))
    assert abs(path[-1, 2]) == pytest.approx(turned, abs=1e-3)


def ideal(times: np.ndarray, phi: np.ndarray, psi: np.ndarray, known: dict) -> np.ndarray:
    """Poses of a board that does not skid: (m + I D^2) u' = -I D D' u - D Jr psi'', D = tan(phi) / L."""

    def slope(t, state):
        """Rates of x, y, heading and u."""
        angle, rate, _ = joint(t, phi, 0.0, 0.0, 100.0, 10.0)
        push = joint(t, psi, 0.0, 0.0, 100.0, 10.0)[2]
        D = np.tan(angle) / known["L"]
        D_rate = rate / np.cos(angle) ** 2 / known["L"]
        u = state[3]
        force = -known["I"] * D * D_rate * u - D * known["Jr"] * push
        return [u * np.cos(state[2]), u * np.sin(state[2]), D * u, force / (known["m"] + known["I"] * D * D)]

    found = solve_ivp(slope, (0, times[-1]), np.zeros(4), "DOP853", times, rtol=1e-10, atol=1e-12)
    return found.y[:3].T


@pytest.mark.slow
def test_a_tyre_that_grips_ever_more_leads_to_the_board_that_does_not_skid():
    """The error falls with the inverse of the grip: half of it at twice the grip, to the next order."""
    times = np.linspace(0, 3, 61)
    phi, psi = np.array([[0.6, 4.0, 0.3]]), np.array([[1.57, 4.0, 0.0]])
    away = []
    for grip in (1000.0, 2000.0):
        tyre = {"B": 8.0, "C": 1.4, "D": grip / 8.0 / 1.4, "E": 0.0, "creep": 1.0}
        path = poses(vector(TABLE_II | tyre), phi, psi, times, np.zeros(3), rtol=1e-9)
        away.append(np.sqrt(np.mean((path - ideal(times, phi, psi, TABLE_II)) ** 2)))
    assert away[1] < 0.01 * np.ptp(path[:, 0])
    assert away[0] / away[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_wheels_and_drags_take_energy_as_fast_as_their_forces_say():
    """Power of the plant against that of each force at its wheel, from vectors in the world; none is ever gained."""
    rng, dry = np.random.default_rng(0), {"longitudinal_slip.k": 0.6, "body_drag.c": 0.5, "yaw_damping.c": 0.02}
    angle, L, m, inertia, out = 0.4, 0.25, 7.0, 0.4375, np.zeros(8)
    with_drags = vector({"steering_offset.o": angle, "E": 0.0, **dry})
    for _ in range(50):
        state = np.concatenate([rng.normal(size=6), np.zeros(2)])
        rates(0.0, state, with_drags, np.zeros((0, 3)), np.zeros((0, 3)), out)
        theta, (u, w, r) = state[2], state[3:6]
        power = m * (u * out[3] + w * out[4]) + inertia * r * out[5]
        forward = np.array([np.cos(theta), np.sin(theta)])
        velocity = u * forward + w * np.array([-forward[1], forward[0]])
        expected = -0.5 * velocity @ velocity - 0.02 * r * r
        for side in (1, -1):
            hub = velocity + r * side * L * np.array([-forward[1], forward[0]])
            along = np.array([np.cos(theta + side * angle), np.sin(theta + side * angle)])
            rolls, slides = hub @ along, hub @ np.array([-along[1], along[0]])
            slip = np.arctan(slides / np.hypot(rolls, 0.01))
            expected -= 0.6 * rolls**2 + 6.0 * np.sin(1.4 * np.arctan(8.0 * slip)) * slides
        assert power == pytest.approx(expected, rel=1e-9)
        assert power < 0


@pytest.mark.parametrize("kd", [10.0, 20.0, 30.0])
def test_joints_are_what_their_controller_makes_of_the_command(kd):
    """angle'' = command'' + kd (command' - angle') + kp (command - angle), damped less, just and more than enough."""
    terms, lag, gain = np.array([[0.9, 4.0, 0.3], [0.2, 1.1, 1.0]]), 0.05, 0.1

    def slope(t, state):
        """Rates of angle and rate."""
        a, w, p = terms.T
        wanted = (1 + gain) * np.array([np.sum(a * np.sin(w * t + p)), np.sum(a * w * np.cos(w * t + p))])
        push = -(1 + gain) * np.sum(a * w * w * np.sin(w * t + p))
        return [state[1], push + kd * (wanted[1] - state[1]) + 100.0 * (wanted[0] - state[0])]

    times = np.linspace(0, 3, 31)
    found = solve_ivp(slope, (0, 3), [0.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12).y.T
    mine = np.array([joint(t + lag, terms, gain, lag, 100.0, kd) for t in times])
    assert mine[:, :2] == pytest.approx(found, abs=1e-8)
    assert mine[:, 2] == pytest.approx([slope(t, s)[1] for t, s in zip(times, found, strict=True)], abs=1e-6)
    assert joint(0.04, terms, gain, lag, 100.0, kd) == (0.0, 0.0, 0.0)


def test_noise_that_wanders_is_white_after_its_filter():
    """The filter against the covariance of the process, with a gap: it maps that matrix to the identity."""
    noise, times = Noise((3e-4, 1e-3), (5e-4, 1.5e-3)), np.delete(np.arange(60) / 100, range(20, 29))
    away = np.abs(times[:, None] - times)
    for part, channel in ((0, 0), (1, 2)):
        covariance = noise.wander[part] ** 2 * np.exp(-away / 0.2) + noise.white[part] ** 2 * np.eye(len(times))
        units = np.zeros((len(times), 3, len(times)))
        units[:, channel] = np.eye(len(times))
        filtered = noise.whiten(times, units)[:, channel]
        assert filtered @ covariance @ filtered.T == pytest.approx(np.eye(len(times)), abs=1e-9)
    drawn = noise.draw(np.random.default_rng(0), np.arange(20000) / 100)
    assert np.mean(noise.whiten(np.arange(20000) / 100, drawn) ** 2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 60000))


def entries(recordings: Path) -> list[tuple[str, dict, Noise]]:
    """Name, numbers of the plant and noise of each recording with a key."""
    found = []
    for one in json.loads((recordings.parent / "recordings-key.json").read_text()):
        if one["tyre"]:
            free = "free" in (recordings / one["case"] / "case.toml").read_text() or "lateral_skid" in one["effects"]
            strange = {
                "board-d": {"spin_grip.s": -0.32},
                "board-j": {"spring.k": 0.15, "spring.x": 0.5, "spring.y": 0.8},
            }
            known = one["tyre"] | one["values"] | strange.get(one["case"], {}) | {"free": float(free)}
            found.append((one["case"], known, Noise((4e-4, 2.5e-3))))
    for one in json.loads((recordings.parent / "recordings-key-real-like.json").read_text()):
        named = {KEY_NAMES.get(name, name): value for name, value in one["params"].items()}
        known = one["tyre"] | {name: value for name, value in named.items() if name in NAMES}
        found.append((one["case"], known, Noise((3e-4, 1e-3), (5e-4, 1.5e-3))))
    return found


def exported(path: Path) -> np.ndarray:
    """Poses (n, 3) of a Vicon Tracker export in mm and rad, lost frames NaN, the heading as it is."""
    rows = [line.split(",") for line in path.read_text().splitlines()[5:]]
    cells = np.array([[float(row[k]) if row[k] else np.nan for k in (5, 6, 4)] for row in rows])
    return cells * [1e-3, 1e-3, 1.0]


@pytest.mark.long
def test_with_the_numbers_of_the_key_the_plant_leaves_only_noise_of_every_recording(recordings):
    """Each run, its start pose fitted: whitened squares are chi-squared; one in a thousand such tests would fail."""
    pytest.importorskip("numba", reason="numba, of the extra `bench`, is not here: without it this takes half an hour.")
    board_runs = [
        (name, known, noise, run)
        for name, known, noise in entries(recordings)
        for run in tomllib.loads((recordings / name / "case.toml").read_text())["runs"]
    ]
    assert len(board_runs) >= 98
    for name, known, noise, run in board_runs:
        seen = exported(recordings / name / run["mocap"])
        present = np.isfinite(seen).all(1)
        times, p = np.arange(len(seen)) / 100, vector(known)

        def error(start, run=run, seen=seen, present=present, times=times, p=p, noise=noise):
            """Whitened errors from that start; the heading's to the nearest turn."""
            off = (poses(p, run["phi"], run["psi"], times, start) - seen)[present]
            off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
            return noise.whiten(times[present], off).ravel()

        found = least_squares(error, seen[present][0], x_scale=1e-3)
        freedom = len(found.fun) - 3
        low, high = chi2.ppf([0.0005 / len(board_runs), 1 - 0.0005 / len(board_runs)], freedom) / freedom
        left = np.sum(found.fun**2) / freedom
        assert low < left < high, f"{name} {run['mocap']}: {left:.3f}"
