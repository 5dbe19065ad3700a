"""Case folders: what is loaded, and what is said about what cannot be."""

import hashlib
import math
import re
import tomllib
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.command_inputs import BOARD_TOML

from snakejax.core.errors import InputError
from snakejax.dynamics.signals import Logged, Sines, Tracked
from snakejax.recording import case as _case
from snakejax.recording import case_inputs
from snakejax.recording.case import load_case
from snakejax.recording.case_template import template, write_template
from snakejax.recording.case_vehicle import fields_of, sd_keys_of
from snakejax.vehicles.snakeboard.board import Board

FRAMES = 101
TOML = f"""\
title = "a test"
skid = "free"

{BOARD_TOML}[[runs]]
role = "train"
mocap = "train-1.csv"
object = "board:board"
phi = [[0.9, 4.0, 0.0]]
psi = [[1.5, 4.0, 0.0]]

[[runs]]
role = "heldout"
mocap = "heldout-1.csv"
object = "board:board"
phi = [[0.5, 2.0, 0.0], [0.2, 3.0, 0.1]]
psi = [[1.0, 3.0, 3.0]]
"""
LOG = "time_s,phi_rad,psi_rad\n" + "".join(f"{0.1 * i:.1f},{math.sin(i)},{math.cos(i)}\n" for i in range(11))


def recording(frames=FRAMES, lost=()):
    """One second of a board in motion."""
    rows = [f"{i + 1},0,0,0,{0.01 * i:.4f},{3.0 * i:.3f},{0.1 * i**2:.3f},60" for i in range(frames)]
    for i in lost:
        rows[i] = f"{i + 1},0" + "," * 6
    head = ["Objects", "100", ",,Global Angle board:board,,,,,", "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ"]
    return "\r\n".join([*head, ",,rad,rad,rad,mm,mm,mm", *rows]) + "\r\n"


def write(folder: Path, text: str = TOML, log: str = LOG) -> Path:
    (folder / "case.toml").write_text(text, encoding="utf-8")
    (folder / "train-1.csv").write_text(recording(), encoding="utf-8")
    (folder / "heldout-1.csv").write_text(recording(lost=(5, 6)), encoding="utf-8")
    (folder / "joints.csv").write_text(log, encoding="utf-8")
    return folder


def with_run(extra: str) -> str:
    """The case with `extra` at the end of its train run."""
    return TOML.replace("psi = [[1.5, 4.0, 0.0]]\n", f"psi = [[1.5, 4.0, 0.0]]\n{extra}\n")


def logged(extra: str = "") -> str:
    """The case with a joint log in its train run; `extra` is that key's kind and more."""
    log = f'joint_log = {{file = "joints.csv", {extra}}}'
    return TOML.replace("phi = [[0.9, 4.0, 0.0]]\npsi = [[1.5, 4.0, 0.0]]", log)


def test_what_is_loaded(tmp_path):
    case = load_case(write(tmp_path))
    assert (case.name, case.title, case.constraint) == (tmp_path.name, "a test", "free")
    assert float(case.board.mass) == 7.0 and case.board.inertia is None
    assert float(case.board.total_inertia) == 7.0 * 0.25**2
    assert (float(case.noise.position), float(case.noise.heading)) == (0.0004, 0.0025)
    assert case.noise.source == "case.toml"
    train, heldout = case.runs
    assert (train.name, train.role, heldout.name, heldout.role) == ("train-1", "train", "heldout-1", "heldout")
    np.testing.assert_allclose(train.pose[10], [0.03, 0.01, 0.1])
    np.testing.assert_array_equal(train.payload, [0.0, 0.0])
    assert not train.moving and float(train.times[-1]) == 1.0
    assert list(np.flatnonzero(np.isnan(heldout.pose[:, 0]))) == [5, 6]
    digest = hashlib.sha256((tmp_path / "train-1.csv").read_bytes()).hexdigest()
    assert case.sha256["train-1.csv"] == digest and set(case.sha256) == {"case.toml", "train-1.csv", "heldout-1.csv"}


def test_gaits_are_alike_and_tracked(tmp_path):
    train, heldout = load_case(write(tmp_path)).runs
    assert eqx.tree_equal(*(eqx.filter(run.gait, eqx.is_array, inverse=True) for run in (train, heldout)))
    phi = train.gait.phi
    assert isinstance(phi, Tracked) and float(phi.kp) == 100.0 and phi.command.amplitude.shape == (2,)
    t = jnp.asarray(0.7)
    assert float(phi.command.at(t).angle) == pytest.approx(0.9 * math.sin(4 * 0.7))
    assert train.gait.phi_back is None


def test_without_actuator_the_command_is_the_joint(tmp_path):
    text = TOML.replace("[actuator]\nkp = 100.0\nkd = 10.0\n", "")
    assert isinstance(load_case(write(tmp_path, text)).runs[0].gait.psi, Sines)


def test_optional_parts(tmp_path):
    text = TOML.replace("[noise]\nposition_m = 0.0004\nheading_rad = 0.0025\n", "").replace('title = "a test"\n', "")
    case = load_case(write(tmp_path, text.replace("mass_kg = 7.0", "mass_kg = 7\ninertia_kgm2 = 0.3")))
    assert case.noise is None and case.title == tmp_path.name and float(case.board.total_inertia) == 0.3


def test_payload_and_start_in_motion(tmp_path):
    extra = 'payload_kg = 2\npayload_inertia_kgm2 = 0.01\nstart = "moving"\nwindow_s = [0.2, 0.8]'
    run = load_case(write(tmp_path, with_run(extra))).runs[0]
    np.testing.assert_array_equal(run.payload, [2.0, 0.01])
    assert run.moving
    np.testing.assert_allclose(run.times, np.arange(20, 81) / 100)
    np.testing.assert_allclose(run.pose[:, 0], 0.003 * np.arange(20, 81), atol=1e-9)


def test_window_of_a_run_from_rest_keeps_its_start(tmp_path):
    run = load_case(write(tmp_path, with_run("window_s = [0.2, 0.8]"))).runs[0]
    np.testing.assert_allclose(run.times, np.arange(81) / 100)
    np.testing.assert_array_equal(np.isnan(run.pose[:, 0]), run.times < 0.195)


def test_back_steering_is_the_opposite_where_another_run_has_its_own(tmp_path):
    train, heldout = load_case(write(tmp_path, with_run("phi_back = [[0.3, 5.0, 0.0]]"))).runs
    t = jnp.asarray(0.4)
    assert float(train.gait.phi_back.command.at(t).angle) == pytest.approx(0.3 * math.sin(2.0))
    np.testing.assert_allclose(heldout.gait.phi_back.at(t), [-float(part) for part in heldout.gait.phi.at(t)])


def test_measured_log_is_the_joint(tmp_path):
    case = load_case(write(tmp_path, logged('kind = "measured"')))
    gait = case.runs[0].gait
    assert isinstance(gait.phi, Logged) and "joints.csv" in case.sha256
    assert float(gait.psi.at(jnp.asarray(0.3)).angle) == pytest.approx(math.cos(3))


def test_commanded_log_is_tracked(tmp_path):
    gait = load_case(write(tmp_path, logged('kind = "commanded"'))).runs[0].gait
    assert isinstance(gait.phi, Tracked) and isinstance(gait.phi.command, Logged)


def test_log_with_the_back(tmp_path):
    rows = "".join(f"{0.1 * i:.1f},0.1,0.2,{0.01 * i}\n" for i in range(11))
    log = "time_s,phi_rad,psi_rad,phi_back_rad\n" + rows
    train, heldout = load_case(write(tmp_path, logged('kind = "measured"'), log)).runs
    assert float(train.gait.phi_back.at(jnp.asarray(0.5)).angle) == pytest.approx(0.05)
    assert heldout.gait.phi_back is not None


BOARDLESS = TOML[: TOML.index("[board]")] + TOML[TOML.index("[noise]") :]
# (text, a text in the line that is named, what is wrong, remedy)
COMPLAINTS = {
    "unknown key": (TOML.replace("mass_kg", "mas_kg"), "mas_kg", 'Unknown key "mas_kg" in [board]', 'write "mass_kg"'),
    "unknown key at the top": ("colour = 1\n" + TOML, "colour", 'Unknown key "colour"', "remove it or write one"),
    "unknown key in a run": (with_run("payload = 1"), "payload", 'Unknown key "payload" in [[runs]] 1', "payload_kg"),
    "unknown key in noise": (TOML.replace("position_m", "position"), "position", '"position"', 'write "position_m"'),
    "unknown key in actuator": (TOML.replace("kp", "kq"), "kq", 'Unknown key "kq" in [actuator]', '"kp"'),
    "unknown key in a log": (logged('kinds = "measured"'), "joint_log", 'Unknown key "kinds"', 'write "kind"'),
    "negative mass": (TOML.replace("7.0", "-7.0"), "mass_kg", "must be above 0, but is -7", "in kg"),
    "infinite mass": (TOML.replace("7.0", "inf"), "mass_kg", "must be a finite number", "in kg"),
    "negative inertia": (TOML.replace("0.0238", "-1.0"), "rotor_inertia", "must be at least 0, but is -1", "kg m^2"),
    "no creep speed": (TOML.replace("0.01", "0.0"), "creep_speed", "must be above 0, but is 0", "in m/s"),
    "no noise": (TOML.replace("0.0004", "0"), "position_m", "must be above 0, but is 0", "in m"),
    "negative gain": (TOML.replace("kd = 10.0", "kd = -1"), "kd", "must be at least 0, but is -1", "in 1/s"),
    "inertia below the rotor's": (TOML.replace("0.0238", "0.5"), "half_length", "not above 0.502", "inertia_kgm2"),
    "total inertia": (TOML.replace("[noise]", "inertia_kgm2 = 0.02\n[noise]"), "inertia_kgm2 = 0.02", "0.0258", "with"),
    "negative payload": (with_run("payload_kg = -1"), "payload_kg", "must be at least 0, but is -1", "in kg"),
    "text for a number": (TOML.replace("7.0", '"7 kg"'), "mass_kg", "must be a number", "without quotes"),
    "truth for a number": (TOML.replace("7.0", "true"), "mass_kg", "must be a number", "in kg"),
    "number for text": (TOML.replace('"a test"', "3"), "title", "must be a string", "title ="),
    "missing key": (TOML.replace("half_length_m = 0.25\n", ""), "[board]", "Missing key half_length_m in [board]", ""),
    "missing board": (BOARDLESS, "title", "Missing key board", "add [board]"),
    "noise as an array": (TOML.replace("[noise]", "[[noise]]"), "[[noise]]", "must be a table", "write [noise] with"),
    "missing psi": (TOML.replace("psi = [[1.5, 4.0, 0.0]]\n", ""), "[[runs]]", "Missing key psi in [[runs]] 1", "add"),
    "role": (TOML.replace('"train"', '"trian"'), "trian", "role in [[runs]] 1 cannot be 'trian'", 'write "train"'),
    "skid": (TOML.replace('"free"', '"loose"'), "skid", "cannot be 'loose'", "known: free, coupled"),
    "start": (with_run('start = "move"'), "start", "cannot be 'move'", 'write "moving"'),
    "kind": (logged('kind = "measure"'), "joint_log", "cannot be 'measure'", 'write "measured"'),
    "no train run": (TOML.replace('"train"', '"heldout"'), "role", "a fit needs a run with", 'write role = "train"'),
    "no runs": (TOML[: TOML.index("[[runs]]")], "title", "Missing key runs", "add [[runs]]"),
    "runs as one table": (TOML[: TOML.index("\n[[runs]]\nrole = \"held")].replace("[[runs]]", "[runs]"), "[runs]",
                          "must be an array of tables", "[[runs]]"),
    "same stem": (TOML.replace("heldout-1.csv", "old/train-1.csv"), "old/train-1", 'same name "train-1"', "rename one"),
    "up": (with_run('up = "w"'), "up = ", "up in [[runs]] 1 cannot be 'w'", "known: z, y"),
    "up in components": (with_run("up = [0.0, 0.0]"), "up = ", "must be a list of 3 finite numbers", "up = ["),
    "up to nowhere": (with_run("up = [0, 0, 0]"), "up = ", "has no direction", "components"),
    "columns": (with_run("columns = 3"), "columns = ", "must be a table", "columns = {time"),
    "units": (with_run("units = {length = 3}"), "units = ", "must be a string", "length = "),
    "markers": (with_run("markers = {a = [0, 1]}"), "markers = ", "must be a list of 3", "in m"),
    "left open": (TOML.replace("mass_kg = 7.0", 'mass_kg = "?"'), "mass_kg", '(line 5) is still "?"', "quotes"),
    "gait left open": (TOML.replace("phi = [[0.9, 4.0, 0.0]]", 'phi = "?"'), "phi = ", 'is still "?"', "quotes"),
    "missing file": (TOML.replace('"train-1.csv', '"train-l.csv'), "train-l.csv", "no such file", '"train-1.csv"'),
    "missing log": (logged('kind = "measured"').replace("joints.", "jonts."), "jonts", "no such", 'write "joints.csv"'),
    "terms": (TOML.replace("[[0.9, 4.0, 0.0]]", "[0.9, 4.0, 0.0]"), "phi = [0.9", "of 3 finite numbers", "write"),
    "nan in a term": (TOML.replace("0.9", "nan"), "phi = [[nan", "of 3 finite numbers", "write"),
    "window": (with_run("window_s = [0.5, 3.0]"), "window_s", "but the run goes from 0 to 1 s", "within the run"),
    "window backwards": (with_run("window_s = [0.5, 0.1]"), "window_s", "is [0.5, 0.1], but the run", "within the run"),
    "window of one": (with_run("window_s = [0.5]"), "window_s", "a list of 2 finite numbers", "write window_s"),
    "short window": (with_run("window_s = [0.5, 0.55]"), "window_s", "leaves 6 present samples", "widen"),
    "syntax": (TOML.replace("mass_kg = 7.0", "mass_kg = 7.0 kg"), "7.0 kg", "Not valid TOML", "correct the syntax"),
    "key twice": (TOML.replace("kp = 100.0", "kp = 100.0\nkp = 90.0"), "kp = 90", "Not valid TOML", "correct"),
    "end of file": (TOML + "x = [1,\n", "x = [1", "Not valid TOML", "correct"),
}  # fmt: skip


@pytest.mark.parametrize("name", COMPLAINTS)
def test_complaint(tmp_path, name):
    text, named, what, remedy = COMPLAINTS[name]
    with pytest.raises(InputError) as caught:
        load_case(write(tmp_path, text))
    assert what in caught.value.what and remedy in caught.value.remedy
    path, _, line = caught.value.where.rpartition(" line ")
    assert path == str(tmp_path / "case.toml") and named in text.split("\n")[int(line) - 1]
    assert str(caught.value).startswith(f"{caught.value.what}, {path} line {line}: ") and "\n" not in str(caught.value)


def test_complaint_names_the_line_of_its_own_run(tmp_path):
    with pytest.raises(InputError, match=r'"roll" in \[\[runs\]\] 2, .*case.toml line 27: write "role"'):
        load_case(write(tmp_path, TOML.replace('role = "heldout"', 'roll = "heldout"')))


def test_commented_keys_are_not_taken_for_the_line(tmp_path):
    text = TOML.replace("mass_kg = 7.0", "# mass_kg = 7.0\nmass_kg = -7.0")
    with pytest.raises(InputError, match=r"case.toml line 6: "):
        load_case(write(tmp_path, text))


def test_log_shorter_than_the_run(tmp_path):
    short = "\n".join(LOG.split("\n")[:8])
    with pytest.raises(InputError) as caught:
        load_case(write(tmp_path, logged('kind = "measured"'), short))
    message = str(caught.value)
    assert "joint_log in [[runs]] 1 is shorter than the run: joints.csv goes from 0 to 0.6 s" in message
    assert "the run from 0 to 1 s" in message and "case.toml line 23: log it all, or set window_s" in message


def test_a_window_within_the_log_will_do(tmp_path):
    text = logged('kind = "measured"').replace("joint_log", "window_s = [0.1, 0.6]\njoint_log")
    assert load_case(write(tmp_path, text, "\n".join(LOG.split("\n")[:8]))).runs[0].times[-1] == 0.6


def test_complaint_about_a_recording_comes_through(tmp_path):
    write(tmp_path)
    (tmp_path / "train-1.csv").write_text(recording(frames=9), encoding="utf-8")
    with pytest.raises(InputError, match=r"Only 9 samples .*train-1.csv line 6: "):
        load_case(tmp_path)


def test_folder_without_case(tmp_path):
    with pytest.raises(InputError) as caught:
        load_case(tmp_path)
    assert str(caught.value) == f"The folder has no case.toml, {tmp_path}: write one; `snakejax new` makes a template"


def test_no_such_folder(tmp_path):
    with pytest.raises(InputError, match=r"There is no such folder, .*nowhere: give the folder"):
        load_case(tmp_path / "nowhere")


def test_file_for_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"A case is a folder, but this is a file, .*case.toml: give the folder"):
        load_case(write(tmp_path) / "case.toml")


def test_empty_case(tmp_path):
    with pytest.raises(InputError, match=r"The file is empty, .*case.toml line 1: "):
        load_case(write(tmp_path, "\n"))


def test_case_that_is_not_utf8(tmp_path):
    write(tmp_path)
    (tmp_path / "case.toml").write_bytes(TOML.replace("a test", "ä").encode("latin-1"))
    with pytest.raises(InputError, match=r"not UTF-8, .*case.toml line 1: save it again"):
        load_case(tmp_path)


MEASURED = {"mass": 7.0, "rotor_inertia": 0.0238, "wheelset_inertia": 0.001, "half_length": 0.25}


def filled_in(text: str) -> str:
    """The template as a user fills it in, for the board of the paper."""
    for key, value in MEASURED.items():
        text = re.sub(rf'^({key}\w*) = "\?"', rf"\1 = {value}", text, flags=re.MULTILINE)
    return re.sub(r'^(phi|psi) = "\?"', r"\1 = [[0.9, 4.0, 0.0]]", text, flags=re.MULTILINE)


def test_template_loads(tmp_path):
    path = write_template(tmp_path / "new")
    assert path.read_text(encoding="utf-8") == template()
    for name in ("train-1.csv", "heldout-1.csv"):
        (path.parent / name).write_text(recording(), encoding="utf-8")
    with pytest.raises(InputError, match=r'half_length_m .*, phi .*, psi .*, phi .*, psi .* are still "\?"') as told:
        load_case(path.parent)
    lines = path.read_text(encoding="utf-8").split("\n")
    stated = re.findall(r"(\w+) \(line (\d+)\)", str(told.value))
    assert len(stated) == 8 and all(lines[int(n) - 1].startswith(f'{key} = "?"') for key, n in stated)
    path.write_text(filled_in(template()), encoding="utf-8")
    case = load_case(path.parent)
    assert float(case.board.rotor_inertia) == 0.0238 and [run.role for run in case.runs] == ["train", "heldout"]


def test_template_with_all_its_comments_loads(tmp_path):
    text = re.sub(
        r"^# (?=[a-z_0-9]+ = |\[(noise|accuracy|search|actuator)\]$)", "", filled_in(template()), flags=re.MULTILINE
    )
    assert set(tomllib.loads(text)["runs"][0]) == {*_case.RUN_KEYS, "phi", "psi", "phi_back"}
    write(tmp_path, text.replace("[0.5, 8.0]", "[0.5, 0.8]"))
    case = load_case(tmp_path)
    assert case.noise is not None and case.runs[0].payload[0] == 2.0 and isinstance(case.runs[0].gait.phi, Logged)


def test_template_explains_every_key():
    known = {*_case.CASE_KEYS, *fields_of(Board), *_case.NOISE_KEYS, *case_inputs.GAINS, *_case.RUN_KEYS}
    known |= {
        *sd_keys_of(Board),
        *_case.ACCURACY_KEYS,
        _case.CORRELATION,
        *case_inputs.LOG_KEYS,
        *_case.STARTS,
        *case_inputs.KINDS,
        *_case.CASE_STRUCTURES,
    }
    assert all(key in template() for key in known)


def test_template_overwrites_nothing(tmp_path):
    write(tmp_path)
    with pytest.raises(InputError, match=r"case.toml already exists, .*: choose another"):
        write_template(tmp_path)
    assert (tmp_path / "case.toml").read_text(encoding="utf-8") == TOML


@pytest.mark.slow
def test_the_eleven_recordings_load(recordings):
    folders = sorted(path for path in recordings.iterdir() if path.is_dir())
    assert len(folders) >= 11
    for folder in folders:
        case = load_case(folder)
        assert (case.name, len(case.having("train")), len(case.having("heldout"))) == (folder.name, 5, 2)
        for run in case.runs:
            assert run.pose.shape == (1201, 3) and float(run.times[-1]) == 12.0
            assert np.isfinite(run.pose).all(axis=1).mean() > 0.9
            assert np.nanmax(np.abs(np.diff(run.pose[:, 2]))) < 0.5


def test_what_is_known_of_constants_and_noise_and_what_is_needed(tmp_path):
    needed = "[accuracy]\nposition_m = 0.005\nheading_rad = 0.01\nhorizon_s = 3\n\n"
    text = (
        TOML.replace("[board]\n", "[board]\nmass_sd_kg = 0.05\nrotor_inertia_sd_kgm2 = 1e-3\n")
        .replace("heading_rad = 0.0025\n", "heading_rad = 0.0025\ncorrelation_s = 0.2\n")
        .replace("[actuator]", f"{needed}[search]\nsignificance_level = 0.05\n\n[actuator]")
    )
    case = load_case(write(tmp_path, text))
    assert case.constant_sd == {"mass": 0.05, "rotor_inertia": 1e-3}
    assert case.noise.correlation == 0.2
    assert tuple(case.needed) == (0.005, 0.01, 3.0)
    assert case.search == {"significance_level": 0.05}
    with pytest.raises(InputError, match="must be above 0, but is -3"):
        load_case(write(tmp_path, text.replace("horizon_s = 3", "horizon_s = -3")))
