"""What is doubtful in a case: nothing in a clean one, and each fault by its own sentence."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.core.errors import InputError
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import Sines, Tracked
from snakejax.present.as_text.check import check_text
from snakejax.recording.case import load_case
from snakejax.recording.case_check import Issue, check, run_summary
from snakejax.recording.quality import estimate_noise
from snakejax.recording.run import Case, Noise, Run
from snakejax.vehicles.snakeboard.board import TABLE_II, Board

RATE, FRAMES = 100.0, 1201
POSITION, HEADING = 4e-4, 2.5e-3


def run(name="train-1", role="train", seed=0, noise=1.0, amplitude=0.9, moving=False, rotor=((1e-9, 29.0, 0.0),)):
    """Twelve seconds of a board that starts from rest on a smooth curve, with white noise; its rotor hardly
    turns."""
    t = np.arange(FRAMES) / RATE
    rng = np.random.default_rng(seed)
    wave = 1 - np.cos(0.5 * t)
    pose = np.stack([wave + 0.1 * np.sin(4 * t) ** 2, 0.5 * wave, 0.6 * np.sin(2 * t) ** 2], axis=1)
    pose += noise * rng.normal(size=pose.shape) * [POSITION, POSITION, HEADING]
    gait = Gait(Tracked(Sines.of([[amplitude, 4.0, 0.0]]), 100.0, 10.0), Sines.of(rotor))
    return Run(name, role, jnp.asarray(t), jnp.asarray(pose), gait, moving=moving)


def case(*runs, noise=None):
    noise = Noise(jnp.asarray(POSITION), jnp.asarray(HEADING), "case.toml") if noise is None else noise
    return Case("a", "a test", "free", Board(**TABLE_II), runs, noise)


def changed(run, change):
    """`run` after `change(pose)` has altered its poses in place."""
    pose = np.array(run.pose)
    change(pose)
    return eqx.tree_at(lambda r: r.pose, run, jnp.asarray(pose))


def doubts(change, noise=1.0):
    """What is said of a run once `change` has altered its poses."""
    found = check(case(changed(run(noise=noise), change), run("train-2", "train", 1, amplitude=0.5), OTHER))
    return [doubt.what for doubt in found if doubt.run == "train-1"]


OTHER = run("heldout-1", "heldout", 2, amplitude=0.6)
CLEAN = case(run(), run("train-2", "train", 1, amplitude=0.5), OTHER)


@pytest.mark.slow
def test_a_clean_case():
    assert check(CLEAN) == []


@pytest.mark.slow
def test_noise_is_estimated():
    for seed in range(4):
        noise = estimate_noise([run(seed=10 * seed + i) for i in range(6)])
        assert float(noise.position) == pytest.approx(POSITION, rel=0.03)
        assert float(noise.heading) == pytest.approx(HEADING, rel=0.04)
        assert noise.source == "estimated from the recordings; repeated runs agree"


def test_noise_estimate_withstands_jumps_and_gaps():
    def spoil(pose):
        pose[100:1200:50] += 0.5
        pose[30:1200:40] = np.nan

    assert float(estimate_noise([changed(run(seed=i), spoil) for i in range(4)]).position) == pytest.approx(
        POSITION, rel=0.05
    )


def set_frozen(pose):
    pose[300:308] = pose[300]


def set_repeat(pose):
    pose[301] = pose[300]


def set_copy(pose):
    pose[800:810] = pose[300:310]


def set_jump(pose):
    pose[500, 0] += 0.2


def set_switch(pose):
    pose[500:, 1] += 0.2


def set_late(pose):
    pose[:50] = np.nan


def set_gap(pose):
    pose[400:480] = np.nan


def set_sparse(pose):
    pose[::3] = np.nan


def set_half_turn(pose):
    pose[400:480] = np.nan
    pose[480:, 2] += 3.6


def set_moving(pose):
    pose[:, 0] += 0.3 * np.arange(FRAMES) / RATE


def set_metres(pose):
    pose[:, :2] *= 1000


def set_millimetres(pose):
    pose[:, :2] *= 1e-4


FAULTS = [
    (set_frozen, "the pose is frozen for 8 frames at 3.00 s (7 repeats in all)"),
    (set_repeat, "1 frames repeat the pose before them"),
    (set_copy, "10 poses occur again elsewhere in the run, as if copied"),
    (set_jump, "one frame lies 0.2 m off the path at 5.00 s"),
    (set_switch, "off the path at 0.00 s, as if the cameras followed another body; it is not clear which is the board"),
    (set_late, "the first sample comes 0.50 s after the start"),
    (set_gap, "a gap of 0.81 s at 3.99 s"),
    (set_sparse, "33% of the frames are lost"),
    (set_half_turn, "rad across a gap: its direction is uncertain"),
    (set_moving, "m/s at the start, which is to be at rest"),
    (set_metres, "m away: is the unit of length right?"),
    (set_millimetres, "m away: did it move, and is the unit of length right?"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "said"), FAULTS, ids=lambda value: getattr(value, "__name__", ""))
def test_fault(fault, said):
    assert any(said in what for what in doubts(fault)), doubts(fault)


def test_a_gap_is_no_jump():
    assert len(doubts(set_gap)) == 1


def test_a_run_that_starts_in_motion_may_move():
    moving = changed(run(moving=True), set_moving)
    assert not [d for d in check(case(moving, run("train-2", seed=1, amplitude=0.5), OTHER)) if d.run == "train-1"]


def test_a_run_without_noise_has_no_jumps():
    assert doubts(lambda pose: None, noise=0.0) == []


def test_steep_steering():
    steep = case(run(amplitude=1.5), OTHER)
    assert Issue(
        "train-1", "phi is commanded to 86 degrees: above 80 degrees the wheels may hit the board", "doubtful"
    ) in check(steep)


def test_wrong_noise():
    wrong = Noise(jnp.asarray(4 * POSITION), jnp.asarray(HEADING), "case.toml")
    (found,) = check(case(*CLEAN.runs, noise=wrong))
    assert found.what.startswith("position noise is given as 0.0016 m, but the recordings give 0.00039")


def test_no_noise_given():
    notes = check(eqx.tree_at(lambda c: c.noise, CLEAN, None))
    assert [note.severity for note in notes] == ["note", "note"]
    assert "no heading noise is given; the recordings give 0.00249 rad" in notes[1].what


def test_noise_that_cannot_be_estimated():
    def spoil(pose):
        pose[::4] = np.nan

    with pytest.raises(InputError, match=r"Only 0 stretches of 6 frames .* all runs: give position_m and heading_rad"):
        estimate_noise([changed(run(), spoil)])


def test_no_noise_to_estimate():
    with pytest.raises(InputError, match=r"Most samples repeat the one before"):
        estimate_noise([changed(run(), lambda pose: pose.fill(1.0))])


def test_nothing_held_out_and_one_gait():
    said = [doubt.what for doubt in check(case(run(), run("train-2", seed=1)))]
    assert said[0].startswith("no run is held out") and said[1].startswith("the gait is the same in all train runs")
    assert "there is only one train run" in [doubt.what for doubt in check(case(run(), OTHER))]


def test_the_same_recording_twice():
    twice = case(run(), run("train-2", amplitude=0.5), OTHER)
    assert Issue("train-2", "holds the same poses as train-1", "doubtful") in check(twice)


def test_unused_files(tmp_path):
    (tmp_path / "spare.csv").touch()
    assert check(CLEAN, tmp_path) == [Issue(None, "spare.csv is in the folder, but no run uses it", "note")]


def test_text():
    text = check_text(CLEAN, [Issue("train-1", "something odd", "doubtful"), Issue(None, "a remark", "note")])
    assert "a: a test\n2 train and 1 heldout runs, skid free\n" in text
    assert "train-1    train      12.00 s   100.0 Hz     1201      0\n" in text
    assert text.endswith("issues:\n  ? train-1: something odd\n    the case: a remark")
    assert check_text(CLEAN, []).endswith("no issues")


def test_holding():
    held = run_summary(changed(run(), set_gap))
    assert (held.run, held.role, held.duration, held.samples, held.lost) == ("train-1", "train", 12.0, 1201, 80)
    assert held.rate == pytest.approx(100.0)


@pytest.mark.long
def test_the_recordings_are_clean_and_their_noise_is_as_given(recordings):
    for folder in sorted(path for path in recordings.iterdir() if path.is_dir()):
        recorded = load_case(folder)
        doubts = [issue for issue in check(recorded, folder) if issue.severity == "doubtful" or recorded.noise]
        assert doubts == [], folder.name
        if recorded.noise is None:
            continue
        noise = estimate_noise(recorded.runs)
        assert float(noise.position) == pytest.approx(float(recorded.noise.position), rel=0.03)
        assert float(noise.heading) == pytest.approx(float(recorded.noise.heading), rel=0.05)


def test_a_board_that_nothing_drives() -> None:
    def boards(moving: bool) -> Case:
        roles = {"train-1": "train", "train-2": "train", "heldout-1": "heldout"}
        return case(*(run(*one, k, 1.0, 0.5 + k / 10, moving, ()) for k, one in enumerate(roles.items())))

    (doubt,) = check(boards(moving=False))
    assert doubt.what.startswith("nothing turns the rotor") and "--vehicle car" in doubt.remedy
    assert check(boards(moving=True)) == []


def test_a_creep_speed_above_that_of_the_board() -> None:
    fast = dataclasses.replace(CLEAN, board=Board(**{**TABLE_II, "creep_speed": 10.0}))
    (doubt,) = check(fast)
    assert doubt.what.startswith("creep_speed_mps is 10, but the board moves at 0.")


@pytest.mark.parametrize(("kp", "kd", "words"), [(1.0, 20.0, "only after 60 s"), (100.0, 0.0, "never")])
def test_a_controller_that_does_not_reach_its_command(kp: float, kd: float, words: str) -> None:
    def slow(one: Run) -> Run:
        steering = one.gait.signal("phi")
        return dataclasses.replace(one, gait=Gait(Tracked(steering.command, kp, kd), one.gait.signal("psi")))

    doubts = [issue.what for issue in check(case(*map(slow, CLEAN.runs))) if issue.run is None]
    assert any(what.startswith(f"phi reaches its command {words}, and the longest run has 12 s") for what in doubts)
