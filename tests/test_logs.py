"""Joint logs on a clock of their own: what the motion alone says of it, what the fit says, and noise in the log."""

import dataclasses
import shutil
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from snakejax import explain, fit_logged, load_case, noise_of, simulate, simulate_many, stacked, starting_model
from snakejax._errors import InputError
from snakejax._gait import Gait, Logged, on_clock
from snakejax._log_noise import is_noisy, redrawn, wandering
from snakejax._recording import LogClock, Run
from snakejax._replay import replay
from snakejax._units import with_parameters
from snakejax._whitening import coloured, whitened, whitening
from snakejax.effects import LIBRARY
from snakejax.quality import clocks, lag, smoothed

DATA = Path(__file__).resolve().parents[1] / "data" / "level-board"
TILTED = DATA.with_name("tilted-floor")
CLOCKS = {
    "train-forward-1": (0.137, 0.0),
    "train-forward-2": (-0.2, 0.0),
    "train-rotate-1": (0.05, 0.0),
    "train-arc-1": (0.4, 1e-3),
    "train-wander-1": (-0.05, 0.0),
    "heldout-reverse-1": (0.11, 0.0),
    "heldout-sweep-1": (-0.31, 0.0),
}


def logged_case(folder: Path, keys: str, names=tuple(CLOCKS), noise: float = 0.0, data: Path = DATA) -> Path:
    """The runs `names` of `data`, with the joints' true motion and `noise` [rad] as logs, on the clocks above; `keys`
    say what is known of them.
    """
    rng = np.random.default_rng(1)
    shutil.copytree(data, folder)
    head, *runs = (data / "case.toml").read_text(encoding="utf-8").split("[[runs]]")
    text = head.split("[actuator]")[0]
    times = np.arange(0, 12.5, 0.01)
    for run, part in zip(load_case(data).runs, runs, strict=True):
        if run.name not in names:
            continue
        offset, drift = CLOCKS[run.name]
        joints = [
            np.asarray(jax.vmap(lambda t, s=s: s.at(t).angle)(jnp.asarray(times))) for s in (run.gait.phi, run.gait.psi)
        ]
        # Some time before the start, when the joints stand still.
        at = np.concatenate([times[:100] - 1.0, times]) * (1 + drift) + offset
        table = np.column_stack([at, *(np.concatenate([np.zeros(100), joint]) for joint in joints)])
        table[:, 1:] += noise * rng.normal(size=table[:, 1:].shape)
        rows = "".join(f"{t:.6f},{phi:.9f},{psi:.9f}\n" for t, phi, psi in table)
        (folder / f"{run.name}-joints.csv").write_text("time_s,phi_rad,psi_rad\n" + rows, encoding="utf-8")
        kept = [line for line in part.strip().splitlines() if not line.startswith(("phi", "psi"))]
        log = f'joint_log = {{file = "{run.name}-joints.csv", kind = "measured", {keys}}}'
        text += "\n".join(["[[runs]]", *kept, log, "", ""])
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder


def test_a_log_on_another_clock_is_the_same_motion():
    t = np.linspace(0, 3, 40)
    signal = Logged.of(t, np.sin(2 * t))
    moved = signal.on_clock(0.3, 0.02)
    for now in (0.2, 1.0, 2.2):
        angle, rate, acceleration = moved.at(jnp.asarray(now))
        there = signal.at(jnp.asarray(now * 1.02 + 0.3))
        np.testing.assert_allclose(angle, there.angle, rtol=1e-12)
        np.testing.assert_allclose(rate, 1.02 * there.rate, rtol=1e-12)
        np.testing.assert_allclose(acceleration, 1.02**2 * there.acceleration, rtol=1e-12)
    assert on_clock((signal, 1.0), 0.0, 0.0)[1] == 1.0


def test_a_given_clock_is_believed(tmp_path):
    case = load_case(logged_case(tmp_path / "case", "offset_s = -0.2, drift = -0.01"))
    raw = load_case(logged_case(tmp_path / "raw", "offset_s = -0.25"))
    assert case.runs[0].log == LogClock(-0.2, -0.01)
    t = 1.3
    expected = raw.runs[0].gait.psi.at(jnp.asarray(t * 0.99 - 0.2 + 0.25)).angle
    np.testing.assert_allclose(case.runs[0].gait.psi.at(jnp.asarray(t)).angle, expected, rtol=1e-9)


def test_the_motion_alone_tells_the_offset(tmp_path):
    """To some hundredths of a second, on every run: with its standard error of 0.05 s."""
    case = load_case(logged_case(tmp_path / "case", 'offset_s = "estimate"'))
    for run in case.runs:
        assert run.log.free == ("offset",) and run.log.source == "the motion alone"
        assert abs(run.log.offset - CLOCKS[run.name][0]) < 1.5 * run.log.offset_sd
        assert run.log.offset_sd < 0.08


def test_clocks_that_start_at_different_epochs(tmp_path):
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"')
    path = folder / "train-arc-1-joints.csv"
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    moved = [f"{float(t) + 86400:.6f},{phi},{psi}" for t, phi, psi in cells]
    path.write_text("\n".join([head, *moved]) + "\n", encoding="utf-8")
    (run,) = [run for run in load_case(folder).runs if run.name == "train-arc-1"]
    assert run.log.offset == pytest.approx(86400.4, abs=0.1)


def test_a_log_of_another_run_is_said(tmp_path):
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"')
    log = folder / "train-rotate-1-joints.csv"
    rng = np.random.default_rng(0)
    wander = np.cumsum(rng.normal(size=(1300, 2)) * 0.01, axis=0)
    rows = "".join(f"{0.01 * k:.2f},{a:.6f},{b:.6f}\n" for k, (a, b) in enumerate(wander))
    log.write_text("time_s,phi_rad,psi_rad\n" + rows, encoding="utf-8")
    with pytest.raises(InputError, match=r"does not go with the logged joints.*run train-rotate-1: check that the log"):
        load_case(folder)


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [('offset_s = "guess"', "must be a number"), ("drift = 0.5", "but is 0.5"), ("offest_s = 1", 'write "offset_s"')],
)
def test_what_cannot_be_a_clock(tmp_path, keys, complaint):
    with pytest.raises(InputError, match=complaint):
        load_case(logged_case(tmp_path / "case", keys))


def test_gaits_and_cameras_go_together_and_half_a_second_is_noticed():
    run = load_case(DATA).runs[3]
    assert clocks(run) == [] and abs(lag(run, 1.0).offset) < 0.06
    late = eqx.tree_at(lambda r: r.pose, run, run.pose[50:])
    late = eqx.tree_at(lambda r: r.times, late, run.times[:-50])
    found = clocks(late)
    assert found[0].kind == "clock_offset" and found[0].size == pytest.approx(0.5, abs=0.1)


def test_a_clock_that_runs_at_another_pace_is_noticed():
    run = load_case(DATA).runs[3]
    slow = eqx.tree_at(lambda r: r.times, run, run.times * 1.05)
    assert [f.kind for f in clocks(slow)] == ["clock_offset"]


def test_a_noisy_log_is_smoothed_and_a_clean_one_is_not():
    rng = np.random.default_rng(0)
    t = np.arange(0, 12, 0.005)
    true = 0.9 * np.sin(4 * t) + 0.2 * np.cos(7 * t)
    assert smoothed(t, true).angles is true
    for rough in (true + 5e-4 * rng.normal(size=t.size), np.round(true / 1.5e-3) * 1.5e-3):
        better = smoothed(t, rough).angles
        assert np.std(better - true) < 0.5 * np.std(rough - true)
        inner = slice(100, -100)
        raw, good, exact = (CubicSpline(t, a)(t, 2)[inner] for a in (rough, better, true))
        assert np.std(good - exact) < 0.05 * np.std(raw - exact)


def started(t: np.ndarray, at: float) -> np.ndarray:
    """A joint that rests at 0.2 rad until `at` [s], and is then accelerated with 12 rad/s^2."""
    s = np.maximum(t - at, 0.0)
    return 0.2 + 0.75 * (1 - np.cos(4 * s))


def test_the_onset_of_a_joint_is_found():
    rng = np.random.default_rng(0)
    found = []
    for k in range(30):
        rate, noise = ((100.0, 0.0), (1000.0, 0.0), (100.0, 5e-4))[k % 3]
        t, at = np.arange(-1, 4, 1 / rate), rng.uniform(-0.4, 0.4)
        seen = started(t, at) + noise * rng.normal(size=t.size)
        found.append((smoothed(t, seen, starts=True).onset - at, noise))
    exact = [abs(off) for off, noise in found if noise == 0]
    assert len(exact) == 20 and max(exact) < 5e-5
    rough = np.array([off for off, noise in found if noise > 0])
    assert np.sqrt((rough**2).mean()) < 2e-3


def test_what_has_no_onset():
    t = np.arange(-1, 4, 0.01)
    for joint in (np.full(t.size, 0.3), np.sin(4 * t), started(t, -0.99), started(t, 3.97)):
        assert smoothed(t, joint, starts=True).onset is None
    assert smoothed(t, started(t, 0.1)).onset is None


@pytest.mark.parametrize("onset", [-0.5, 0.0, 2.95, 4.0, np.nan])
def test_an_onset_outside_the_log_is_refused(onset):
    t = np.linspace(0, 3, 40)
    with pytest.raises(ValueError, match=r"begins at .* s, outside its log from 0 to 3 s"):
        Logged.of(t, np.sin(t), onset=onset)


def test_a_joint_is_followed_through_its_onset():
    """100 samples a second: the rate within 3e-4 rad/s; without the kink it is ten times as far off."""
    t, fine = np.arange(-1, 4, 0.01), jnp.arange(-0.2, 1.0, 1e-3)
    seen = started(t, 0.1234)
    kinked, smooth = Logged.of(t, *smoothed(t, seen, starts=True)), Logged.of(t, seen)
    moving = np.maximum(np.asarray(fine) - 0.1234, 0.0)
    angle, rate, _ = jax.vmap(kinked.at)(fine)
    np.testing.assert_allclose(angle, started(np.asarray(fine), 0.1234), atol=3e-5)
    np.testing.assert_allclose(rate, 3.0 * np.sin(4 * moving), atol=3e-4)
    assert np.abs(jax.vmap(smooth.at)(fine).rate - 3.0 * np.sin(4 * moving)).max() > 3e-3
    assert np.abs(jax.vmap(kinked.at)(fine[fine < 0.12]).rate).max() == 0.0


def test_a_board_at_rest_begins_with_its_joints():
    """A clock that is late moves a run in time, and changes nothing else."""
    t = np.arange(-1, 5, 0.01)
    gait = Gait(*(Logged.of(t, *smoothed(t, size * (started(t, 0.05) - 0.2), starts=True)) for size in (0.5, 1.0)))
    model = starting_model(load_case(DATA))
    times = jnp.arange(0.5, 3.0, 0.1)
    for offset in (0.02, 0.08, 0.3):
        early = on_clock(gait, jnp.asarray(offset), jnp.asarray(0.0))
        assert float(early.begins()) == pytest.approx(min(0.0, 0.05 - offset), abs=1e-5)
        for start, resting in ((jnp.zeros(3), False), (jnp.zeros(6), True)):
            moved = simulate(model, early, times, start, resting=resting).pose
            np.testing.assert_allclose(moved, simulate(model, gait, times + offset).pose, atol=1e-6)
    many = simulate_many(stacked([model, model]), early, np.asarray(times), workers=1)
    np.testing.assert_allclose(many, np.stack([simulate(model, early, times).pose] * 2), atol=1e-5)


def test_noise_that_is_drawn_anew_is_as_what_smoothing_leaves():
    """Against the truth, in angle, rate and acceleration: no smaller, and at most a third larger."""
    t = np.arange(0, 12, 0.01)
    true = 0.9 * np.sin(4 * t) + 0.2 * np.cos(7 * t)
    rng = np.random.default_rng(0)
    left, drawn = [], []
    for _ in range(30):
        log = Logged.of(t, *smoothed(t, true + 5e-4 * rng.normal(size=t.size)))
        assert 4e-4 < float(log.noise) < 6e-4
        again = redrawn(Gait(log, log), rng).phi
        at = [np.stack(jax.vmap(signal.at)(jnp.asarray(t))) for signal in (log, again, Logged.of(t, true))]
        left.append((at[0] - at[2])[:, 50:-50])
        drawn.append((at[1] - at[0])[:, 50:-50])
    sizes = np.std(np.array(drawn), axis=(0, 2)) / np.std(np.array(left), axis=(0, 2))
    assert (sizes > 0.9).all() and (sizes < 1.33).all()
    clean = Gait(Logged.of(t, true), Logged.of(t, true))
    assert not is_noisy(clean) and redrawn(clean, rng).phi is clean.phi


def test_whitened_residuals_are_independent():
    """Of covariance 1 + D D^T they have the covariance 1, and `coloured` goes back."""
    rng = np.random.default_rng(0)
    weight = np.full((2, 40, 3), 50.0)
    wander = rng.normal(size=(40, 3, 5)) * np.array([1.0, 0.3, 0.1, 0.05, 0.02]) / 10
    K = whitening([jnp.asarray(wander), None], weight)
    assert whitening([None, None], weight) is None and not np.asarray(K[1]).any()
    D = 50 * wander.reshape(120, 5)
    W = np.asarray(jax.vmap(lambda r: whitened(r, K[0]))(jnp.eye(120).reshape(120, 40, 3))).reshape(120, 120)
    np.testing.assert_allclose(W @ (np.eye(120) + D @ D.T) @ W.T, np.eye(120), atol=1e-12)
    r = rng.normal(size=(40, 3))
    np.testing.assert_allclose(coloured(np.asarray(whitened(jnp.asarray(r), K[0])), K[0]), r, atol=1e-12)
    assert whitened(r, None) is r and coloured(r, None) is r


@pytest.mark.long
def test_what_a_noisy_log_does_to_a_run_is_taken_from_its_residuals():
    """Runs under logs of 2 mrad: misfits far from 1 as they are, and 1 within 4 sigma, all draws together, whitened."""
    case, rng, noise = load_case(DATA), np.random.default_rng(1), 2e-3
    (run,) = [one for one in case.runs if one.name == "train-arc-1"]
    tyre = {"tyre.B": 7.589, "tyre.C": 1.515, "tyre.D": 8.543, "tyre.E": -0.122}
    model = with_parameters(starting_model(case), tyre)
    t, start = np.arange(-1, 13, 0.01), np.zeros((1, 3))
    weight = np.tile(1 / np.asarray(noise_of(case).channels), (run.times.size, 1))

    def logged() -> Run:
        joints = [np.where(t < 0, 0.0, jax.vmap(s.at)(jnp.asarray(t)).angle) for s in (run.gait.phi, run.gait.psi)]
        seen = [joint + noise * rng.normal(size=t.size) for joint in joints]
        return dataclasses.replace(run, gait=Gait(*(Logged.of(t, *smoothed(t, one, starts=True)) for one in seen)))

    (true,) = replay(model, [run], start)
    (mine,) = wandering(model, [logged()], start)
    K = whitening([mine.wander], weight[None])[0]
    left = [(true - replay(model, [logged()], start)[0]) * weight + rng.normal(size=weight.shape) for _ in range(20)]
    white = [np.mean(np.asarray(whitened(jnp.asarray(r), K)) ** 2) for r in left]
    assert np.mean(np.square(left)) > 1.3
    assert abs(np.mean(white) - 1) < 4 * np.sqrt(2 / (len(left) * weight.size))


@pytest.mark.long
def test_the_fit_tells_the_clocks_of_noisy_logs(tmp_path):
    """Offsets, the one drift and the tyre within 3 standard errors, which noise in the logs makes larger."""
    runs = ("train-rotate-1", "train-arc-1", "heldout-sweep-1")
    folder = logged_case(tmp_path / "case", 'offset_s = "estimate"', runs, noise=5e-4)
    text = (folder / "case.toml").read_text(encoding="utf-8")
    arc = 'file = "train-arc-1-joints.csv", kind = "measured", offset_s = "estimate"'
    (folder / "case.toml").write_text(text.replace(arc, f'{arc}, drift = "estimate"'), encoding="utf-8")
    case = load_case(folder)
    found = fit_logged(starting_model(case), case.runs, case.noise)
    assert found.train_score.misfit < 1.05 and found.heldout_score.misfit < 1.06
    for run in found.study.runs:
        offset, drift = CLOCKS[run.name]
        assert run.log.source == "the fit"
        assert abs(run.log.offset - offset) < 3 * run.log.offset_sd and run.log.offset_sd < 3e-3
        if drift:
            assert abs(run.log.drift - drift) < 3 * run.log.drift_sd and run.log.drift_sd < 3e-4
    # As it was made: see data/README.md.
    for name, true in {"tyre.B": 7.589, "tyre.C": 1.515, "tyre.D": 8.543, "tyre.E": -0.122}.items():
        estimate = found.estimates[name]
        assert abs(estimate.value - true) < 3 * estimate.sd


@pytest.mark.long
def test_what_is_missing_is_found_although_the_clocks_are_not_known(tmp_path):
    """The floor is tilted: under a model without a slope whole runs cannot tell a clock, short windows can."""
    names = ("train-forward-1", "train-rotate-1", "train-wander-1")
    case = load_case(logged_case(tmp_path / "case", 'offset_s = "estimate"', names, data=TILTED))
    few = {name: LIBRARY[name]() for name in ("ground_slope", "yaw_bias", "clock_offset")}
    found = explain(case, noise_of(case), few)
    assert (found.verdict, found.effects) == ("explained", ("ground_slope",))
    assert "joint logs" in found.left_out["clock_offset"]
    for run in found.case.runs:
        assert abs(run.log.offset - CLOCKS[run.name][0]) < 3 * run.log.offset_sd < 3e-3
    for name, value in (("sx", 0.003), ("sy", -0.002)):
        slope = found.final.estimates[f"effects.ground_slope.{name}"]
        assert abs(slope.value - value) < 3 * slope.sd < 1e-5
