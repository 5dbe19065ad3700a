"""A commented `case.toml` to start from."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from snakejax.core.errors import InputError
from snakejax.core.toml_table import TO_FILL_IN

from .vehicle_template import vehicle_template

_HEAD = """\
# A case: a board and its recorded runs. Units are in the names of the keys. Write a value in place of every "?".
title = "my snakeboard"             # free text; may be left out
skid = "free"                       # what to start from: "free" (each wheelset skids by itself) or "coupled"
# area_m = [-2.0, -1.5, 2.0, 1.5]   # lowest x, lowest y, highest x, highest y of the floor: samples outside are wrong

# A snakeboard; another vehicle has a table [vehicle] with its kind in place of this: `snakejax new --vehicle car`.
[board]
mass_kg = "?"                       # the whole board, with rotor and wheelsets
rotor_inertia_kgm2 = "?"            # of the rotor about its axis
wheelset_inertia_kgm2 = "?"         # of one wheelset about its pivot
half_length_m = "?"                 # from the middle to a wheelset
creep_speed_mps = 0.01              # keeps slip finite at rest; well below the rolling speed
# inertia_kgm2 = 0.4375             # yaw inertia of all of it, with rotor and wheelsets; left out: m L^2
# How well these are known, as standard deviations; left out: 3% of the mass, 0.5% of the length, 7% of inertias
# mass_sd_kg = 0.05
# half_length_sd_m = 0.0005
# inertia_sd_kgm2 = 0.01
# rotor_inertia_sd_kgm2 = 0.0005

# Standard deviation of one sample. Leave the table out and it is estimated from the recordings.
# [noise]
# position_m = 0.0004
# heading_rad = 0.0025
# correlation_s = 0.2               # time over which the noise wanders; left out: estimated

# What you need of a simulation: errors of at most so much after so long. `explain` says whether it is good enough.
# [accuracy]
# position_m = 0.005
# heading_rad = 0.01
# horizon_s = 3.0

# Criteria of the search for missing effects, by the names of snakejax.diagnosis.SelectionCriteria.
# [search]
# significance_level = 0.01

# Gains of the joint controllers. With this table each joint starts at angle zero and at rest at t = 0.
# Omit the table if the joints follow their commands exactly, in angle and rate.
# [actuator]
# kp = 100.0                        # 1/s^2
# kd = 10.0                         # 1/s
"""
_TEMPLATE_RUNS = """\

# One table for each run. Fit on "train" runs; "heldout" runs check what the fit predicts.
[[runs]]
role = "train"
mocap = "train-1.csv"               # Vicon CSV, C3D, TRC, Motive CSV, Qualisys TSV, a ROS bag, CSV or Parquet
object = "board:board"              # its name in the file, in Vicon's subject:segment
# name = "first-lap"                # of the run; left out: the file's stem
# group = "circles"                 # `snakejax predict` lists the errors of each group; left out: the role
# floor = "rubber"                  # `snakejax fit --by floor` estimates values of their own for each floor,
# day = "2024-09-04"                # day
# session = "morning"               # or session
# The next keys give what the file does not state; omit the others. `columns`: the names of the columns of a plain
# table; `units`: their units, if they are not SI.
# columns = {time = "t", x = "pos x", y = "pos y", heading = "yaw"}
# units = {length = "mm", angle = "deg", time = "ms"}
# up = "z"                          # the axis that points up, or its components: [0.01, 0.0, 1.0]
# angles = "helical"                # RX, RY, RZ of a Vicon CSV: "helical" (rotation vector) or "xyz" (Euler angles)
# x_axis = "forward"                # where on the board the object's x axis points: forward, left, back or right
# Where markers sit on the board, in m from its middle: forward, left, up. For files with markers only.
# markers = {nose = [0.3, 0.0, 0.1], tail = [-0.3, 0.0, 0.1], mast = [0.0, 0.1, 0.3]}
# Commanded angles: [[amplitude rad, angular frequency rad/s, phase rad], ...], each a sin(w t + p), summed
phi = "?"                           # steering of the front wheelset, as [[0.916, 4.0, 0.0]]; [] stays at zero
psi = "?"                           # rotor, as [[1.57, 4.0, 0.0]]
# phi_back = [[0.9, 4.0, 3.1416]]   # steering of the back wheelset, same sense; left out: opposite of phi
# A CSV with columns time_s, phi_rad, psi_rad and, if wanted, phi_back_rad replaces phi, psi and phi_back.
# "commanded" angles pass through [actuator]; "measured" ones are what the joints did.
# joint_log = {file = "joints.csv", kind = "measured"}
# A log has a clock of its own, which shows t (1 + drift) + offset_s at the cameras' time t; "estimate" lets a fit find
# them: joint_log = {file = "joints.csv", kind = "measured", offset_s = "estimate", drift = 0.0}
# With hold = true in it, a log's values last until the next sample, as commands to a robot do.
# window_s = [0.5, 8.0]             # use the samples from 0.5 to 8 s after the first row only
# payload_kg = 2.0                  # extra mass at the centre of mass in this run
# payload_inertia_kgm2 = 0.01       # and its yaw inertia
# start = "rest"                    # or "moving": already under way at the first sample used
# In place of mocap, whole tables that hold poses and inputs: files = "day1_*.csv" (see `snakejax new --vehicle car`).

[[runs]]
role = "heldout"
mocap = "heldout-1.csv"
object = "board:board"
phi = "?"
psi = "?"
"""


MEASURES = ("mass_kg", "rotor_inertia_kgm2", "wheelset_inertia_kgm2", "half_length_m")
_FIRST_RUN = """\

# One table for each run. Fit on "train" runs; "heldout" runs check what the fit predicts. `snakejax new` explains all
# keys a run may have.
"""
BLANK = f'"{TO_FILL_IN}"'


def template() -> str:
    """A `case.toml` with two runs, "?" for each value to be measured, and every key explained in a comment."""
    return _HEAD + _TEMPLATE_RUNS


def filled(title: str, board: Mapping[str, float], runs: Sequence[str]) -> str:
    """The template with `title`, the measures of [board] that are known, and `runs`; what is not known is "?"."""
    text = _HEAD
    known = {key: repr(float(board[key])) if key in board else BLANK for key in MEASURES}
    for key, value in {**known, "title": toml_string(title)}.items():
        text = re.sub(rf'^{key} = (".*?"|\S+)', lambda _, k=key, v=value: f"{k} = {v}", text, flags=re.MULTILINE)
    if "inertia_kgm2" in board:
        text = text.replace("# inertia_kgm2 = 0.4375 ", f"inertia_kgm2 = {board['inertia_kgm2']!r} ")
    return text + _FIRST_RUN + "\n".join(runs)


def toml_string(text: str) -> str:
    """`text` as a string of TOML."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def write_template(folder: Path | str, kind: str = "snakeboard") -> Path:
    """Write a commented `case.toml` for the vehicle `kind` into `folder`, and return its path.

    **Raises:** `InputError` where there already is a `case.toml`, or `folder` cannot be written.
    """
    path = Path(folder) / "case.toml"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(template() if kind == "snakeboard" else vehicle_template(kind))
    except FileExistsError:
        raise InputError(f"{path.name} already exists", str(path.parent), "choose another folder") from None
    except OSError as error:
        raise InputError(f"Cannot write ({error.strerror})", str(path), "name a folder you may write to") from None
    return path
