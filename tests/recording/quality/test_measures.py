"""Measures of the board and units of the gait that do not go with how the board moves are found before any fit."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA, beside

from snakejax import Board, Case, Gait, Model, Noise, Pacejka, Run, Sines, Tracked, check, load_case, simulate
from snakejax.commands.cli.main import main
from snakejax.dynamics.signals import Delayed
from snakejax.dynamics.tyres import Rayleigh
from snakejax.recording.quality import inspect
from snakejax.recording.quality.frequency import TURN
from snakejax.recording.quality.measures import by_motion, by_range
from snakejax.recording.quality.push import RunMotion, motions, push, pushes, together
from snakejax.vehicles.snakeboard.paper_examples import PRESETS, preset

KINDS = ("frequency_unit", "board_measure")
NOISE = np.array([4e-4, 4e-4, 2.5e-3])
LEVEL = load_case(DATA / "level-board")
GAIT = Gait(Sines.of([[0.5, 2.1, 0.0], [0.3, 3.7, 0.4]]), Sines.of([[1.2, 2.1, 0.2], [0.9, 4.3, 0.0]]))
CRAB = Gait(GAIT.phi, GAIT.psi, Sines.of([[-0.3, 2.1, 0.3], [0.1, 3.7, 0.4]]))


def with_board(case: Case, **measures: float) -> Case:
    """`case` with other measures of its board."""
    return dataclasses.replace(case, board=dataclasses.replace(case.board, **measures))


def paced(case: Case, phi: float, psi: float) -> Case:
    """`case` with the frequencies of its commands times `phi` and `psi`."""

    def faster(signal: Tracked, factor: float) -> Tracked:
        command = dataclasses.replace(signal.command, frequency=factor * signal.command.frequency)
        return dataclasses.replace(signal, command=command)

    gaits = [Gait(faster(run.gait.phi, phi), faster(run.gait.psi, psi)) for run in case.runs]
    runs = tuple(dataclasses.replace(run, gait=gait) for run, gait in zip(case.runs, gaits, strict=True))
    return dataclasses.replace(case, runs=runs)


def said(case: Case) -> list[tuple[str, str]]:
    """What is found in `case`, and how severe it is."""
    return [(f.what, f.severity) for f in inspect(case).findings]


@pytest.mark.parametrize("where", ["bundled", pytest.param("recordings", marks=pytest.mark.long)])
def test_no_recording_gives_a_false_alarm(where) -> None:
    folders = DATA.glob("*-*") if where == "bundled" else beside("recordings").glob("board-?")
    for folder in sorted(folders):
        case = load_case(folder)
        assert not set(KINDS) & {f.kind for f in inspect(case).findings}
        seen = together(pushes(motions(case.runs), case.board))
        assert seen is not None
        yaw, rotor = seen.best()
        # Effects are hidden in these: the push tells both parts all the same.
        assert 0.8 < yaw < 1.25 and 0.8 < rotor / float(case.board.rotor_inertia) < 1.25


WRONG = [
    ({"half_length": 250.0}, "half_length_m were 0.25, not 250", "refused"),
    ({"half_length": 0.5}, "half_length_m were 0.25, not 0.5", "doubtful"),
    ({"mass": 7000.0}, "rotor_inertia_kgm2 were 24, not 0.0238, or mass_kg were 7.1, not 7000", "refused"),
    ({"rotor_inertia": 0.0}, "rotor_inertia_kgm2 were 0.024, not 0", "refused"),
    ({"rotor_inertia": 0.238}, "rotor_inertia_kgm2 were 0.024, not 0.238, or mass_kg were 71, not 7", "doubtful"),
    ({"rotor_inertia": 0.00238}, "rotor_inertia_kgm2 were 0.024, not 0.00238, or mass_kg were 0.71, not 7", "doubtful"),
    ({"inertia": 4.375}, "inertia_kgm2 were 0.44, not 4.375", "doubtful"),
    ({"inertia": 0.4375, "mass": 0.7}, "mass_kg were 7, not 0.7, or half_length_m were 2.5, not 0.25", "doubtful"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("measures", "words", "severity"), WRONG, ids=lambda value: str(value)[:40])
def test_a_wrong_measure_is_found(measures, words, severity) -> None:
    assert said(with_board(LEVEL, **measures)) == [(f"the board moves as if {words}", severity)]


@pytest.mark.slow
def test_a_measure_that_is_somewhat_off_is_not_doubted() -> None:
    assert said(with_board(LEVEL, half_length=0.3)) == said(with_board(LEVEL, rotor_inertia=0.018)) == []


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "length"), [(0.01, 0.02), (7.0, 0.25), (2000.0, 1.3)])
@pytest.mark.parametrize("constraint", ["free", pytest.param("coupled", marks=pytest.mark.long)])
def test_the_push_tells_the_measures_of_any_board(mass, length, constraint) -> None:
    """Whatever the tyre: the simulator knows nothing of the rule by which they are told. The factor on the mass, 3, and
    that on the inertia, 2, come back.
    """
    total = 0.6 * mass * length**2
    board = Board(mass, 0.08 * total, 0.002 * total, length, 0.05 * length, total)
    wrong = dataclasses.replace(board, mass=jnp.asarray(3 * mass), inertia=jnp.asarray(2 * total))
    load, times = 9.81 * mass / 2, jnp.arange(1200) / 100
    noise = np.random.default_rng(0).normal(size=(1200, 3)) * NOISE * [length / 0.25, length / 0.25, 1.0]
    for tyre in (Pacejka(8.0, 1.4, 0.8 * load * length, 0.0), Rayleigh(3.0 * load)):
        for gait in (CRAB, GAIT):
            pose = simulate(Model(board, tyre, constraint), gait, times).pose
            motion = RunMotion.of(Run("made", "train", times, pose, gait))
            assert motion is not None
            seen = push(motion, wrong)
            assert seen is not None
            yaw, rotor = seen.best()
            assert yaw == pytest.approx(1.5, rel=0.02)
            assert rotor == pytest.approx(3 * float(board.rotor_inertia), rel=0.02)
        assert by_motion([Run("made", "train", times, pose + noise, GAIT)], board) == by_range(board) == []


@pytest.mark.slow
def test_clocks_apart_are_not_blamed_on_the_board() -> None:
    late = [Gait(Delayed(run.gait.phi, 0.25), Delayed(run.gait.psi, 0.25)) for run in LEVEL.runs]
    runs = [dataclasses.replace(run, gait=gait) for run, gait in zip(LEVEL.runs, late, strict=True)]
    assert by_motion(runs, LEVEL.board) == []
    assert by_motion(runs, with_board(LEVEL, half_length=0.5).board) != []


def test_one_run_that_is_odd_is_not_blamed_on_the_board() -> None:
    """The rotor of one run turned the other way, among others that want the measures as they are."""
    odd = [
        dataclasses.replace(run, pose=run.pose + jnp.array([[0.0, 0.0, np.pi]])) if "rotate" in run.name else run
        for run in LEVEL.runs
    ]
    assert by_motion(odd, LEVEL.board) == []


def test_a_recording_that_shows_no_push_tells_nothing() -> None:
    """A board at rest, one seen in nothing but noise, and one of too few frames."""
    times = jnp.arange(600) / 100
    noise = np.random.default_rng(0).normal(size=(600, 3)) * NOISE
    wrong = with_board(LEVEL, mass=7000.0).board
    for poses in (np.zeros((600, 3)), noise):
        assert by_motion([Run("made", "train", times, jnp.asarray(poses), GAIT)], wrong) == []
    assert by_motion([Run("made", "train", times[:20], jnp.asarray(noise[:20]), GAIT)], wrong) == []


@pytest.mark.parametrize(
    ("measures", "words"),
    [
        ((7.0, 250.0, None), "half_length_m is 250: no board is 500 m long"),
        ((7.0, 15.0, None), None),
        ((7.0, 5e-4, None), "half_length_m is 0.0005: no board is 0.001 m long"),
        ((7000.0, 0.25, None), "mass_kg = 7000 on half_length_m = 0.25 is heavier than solid steel"),
        ((1e-3, 15.0, None), "mass_kg = 0.001 on half_length_m = 15 is lighter than air"),
        (
            (7.0, 0.25, 4375.0),
            "inertia_kgm2 = 4380 is 10000 times mass half_length^2: it is 0.3 to 3 times for most",
        ),
        ((0.01, 0.02, 1e-6), None),
        ((2000.0, 1.3, 3000.0), None),
    ],
)
def test_measures_that_no_vehicle_has(measures, words) -> None:
    mass, length, inertia = measures
    found = by_range(Board(mass, 0.0, 0.0, length, 0.01, inertia))
    assert [f.what for f in found] == ([] if words is None else [words])


def in_degrees(case: Case, *joints: str) -> Case:
    """`case` with the amplitudes of `joints` in degrees."""

    def larger(gait: Gait) -> Gait:
        signals = {name: getattr(gait, name) for name in joints}
        commands = {
            name: dataclasses.replace(tracked.command, amplitude=jnp.rad2deg(tracked.command.amplitude))
            for name, tracked in signals.items()
        }
        return dataclasses.replace(
            gait, **{name: dataclasses.replace(signals[name], command=commands[name]) for name in joints}
        )

    runs = tuple(dataclasses.replace(run, gait=larger(run.gait)) for run in case.runs)
    return dataclasses.replace(case, runs=runs)


@pytest.mark.parametrize("joints", [("phi",), ("phi", "psi")])
def test_steering_in_degrees_is_refused_and_nothing_else_is_said(joints) -> None:
    case = in_degrees(LEVEL, *joints)
    (found,) = inspect(case).findings
    assert (found.kind, found.severity, found.run) == ("angle_unit", "refused", None)
    assert found.what.startswith("phi is commanded to 52.5 rad in train-")
    assert found.what.endswith(", beyond half a turn: is this in degrees?")
    assert found.remedy == "give phi and psi in rad: 1 degree is 0.01745 rad"
    assert [doubt.what for doubt in check(case)] == [found.what]


@pytest.mark.slow
def test_a_rotor_in_degrees_is_named_before_wrong_measures() -> None:
    words = "the board moves as if psi were in degrees, or rotor_inertia_kgm2 were 0.00041, not 0.0238, or mass_kg were"
    assert said(in_degrees(LEVEL, "psi")) == [(f"{words} 410, not 7", "refused")]


HERTZ = [
    ((1 / TURN, 1 / TURN), "phi and psi are at 0.64: are these Hz?"),
    ((1 / TURN, 1.0), "phi is at 0.64: are these Hz?"),
    ((1.0, 1 / TURN), "psi is at 0.64: are these Hz?"),
    ((TURN, TURN), "phi and psi are at 25: are these 2 pi times too high?"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("factors", "words"), HERTZ)
def test_frequencies_in_another_unit_are_found_and_nothing_else_is_said(factors, words) -> None:
    case = paced(LEVEL, *factors)
    (found,) = inspect(case).findings
    assert found.kind == "frequency_unit" and found.severity == "refused" and found.run is None
    assert found.what.startswith("the board swings at 4.0 rad/s in train-forward-") and found.what.endswith(words)
    assert found.remedy.startswith("multiply" if min(factors) < 1 else "divide") and "by 2 pi" in found.remedy
    assert [doubt.what for doubt in check(case)] == [found.what]


@pytest.mark.slow
def test_one_short_run_is_enough_to_tell_a_rotor_in_hertz() -> None:
    times = jnp.arange(800) / 100
    model = Model(LEVEL.board, Pacejka(8.0, 1.4, 0.1, 0.0), "free")
    pose = simulate(model, Gait(Sines.of([[0.2, 1.3, 0.0]]), Sines.of([[1.5, 4.0, 0.0]])), times).pose
    pose = pose + np.random.default_rng(0).normal(size=pose.shape) * NOISE
    for frequency, found in ((4.0, []), (4.0 / TURN, ["frequency_unit"])):
        gait = Gait(Sines.of([[0.2, 1.3, 0.0]]), Sines.of([[1.5, frequency, 0.0]]))
        case = Case("made", "", "free", LEVEL.board, (Run("made", "train", times, pose, gait),), LEVEL.noise)
        assert [f.kind for f in inspect(case).findings if f.kind in KINDS] == found


@pytest.mark.slow
@pytest.mark.parametrize("name", [PRESETS[0], *(pytest.param(name, marks=pytest.mark.long) for name in PRESETS[1:])])
def test_the_boards_of_the_paper_are_not_doubted(name) -> None:
    given = preset(name)
    for tyre in (given.model.tyre, Rayleigh(9.0)):
        pose = simulate(dataclasses.replace(given.model, tyre=tyre), given.gait, given.times).pose
        noisy = pose + np.random.default_rng(0).normal(size=pose.shape) * NOISE
        run = Run(name, "train", given.times, noisy, given.gait)
        case = Case(name, "", "coupled", given.model.board, (run,), Noise(NOISE[0], NOISE[2], "made"))
        assert said(case) == []


@pytest.mark.slow
def test_a_case_in_hertz_is_refused_before_any_fit(tmp_path, capsys) -> None:
    text = (DATA / "level-board" / "case.toml").read_text(encoding="utf-8")
    for given in ("4.0", "2.0", "3.0", "0.6", "2.1", "3.7", "4.3", "1.7", "2.9"):
        text = text.replace(f", {given}, ", f", {float(given) / TURN:.6f}, ")
    for path in (DATA / "level-board").glob("*.csv"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "case.toml").write_text(text, encoding="utf-8")
    assert main(["fit", str(tmp_path), "--json", str(tmp_path / "fit.json")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "are these Hz?" in said and "--as-recorded" in said and "Traceback" not in said
    assert not (tmp_path / "fit.json").exists()
    assert main(["check", str(tmp_path), "--json", str(tmp_path / "check.json"), "--quiet"]) == 0
    doubts = json.loads((tmp_path / "check.json").read_text(encoding="utf-8"))["doubts"]
    assert [doubt["severity"] for doubt in doubts] == ["doubtful"] and "are these Hz?" in doubts[0]["what"]
