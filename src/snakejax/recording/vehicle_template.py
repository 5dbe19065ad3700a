"""A commented `case.toml` for any vehicle but a snakeboard, from the declaration of the vehicle."""

import dataclasses

from snakejax.core.toml_table import TO_FILL_IN
from snakejax.dynamics.vehicle_input import Input
from snakejax.vehicles.registry import example_values, vehicle_class

from .case_vehicle import fields_of, sd_keys_of

_BLANK = f'"{TO_FILL_IN}"'
_FORMS = {"angle": "angle, rad", "speed": "speed of the rim, m/s", "torque": "torque, N m", "command": "command"}
_RUN = """\

# One table for each run. Fit on "train" runs; "heldout" runs check what the fit predicts.
[[runs]]
role = "{role}"
mocap = "{role}-1.csv"              # any format `snakejax import` reads; a table with time_s, x_m, y_m, heading_rad
object = "body"                     # its name in the file
{inputs}
"""
_MORE = """\
# A log in place of these: CSV with the columns {columns}. With hold = true a value lasts until the next.
# joint_log = {{file = "inputs.csv", kind = "commanded", hold = true}}
# start = "moving"                  # under way at the first sample: its velocities are estimated then
# window_s = [0.5, 8.0]             # use these seconds only; name = "..." tells two windows of one file apart
# In place of mocap, all tables of a pattern, each a long recording with its inputs in further columns. It is cut into
# windows at gaps, at most so many of a file, chosen so that slow and fast, steady and varying ones are among them:
# files = "day1_*.csv"              # or a list of patterns
# group = "circles"                 # `snakejax predict` lists the errors of each group; left out: the role
# floor = "rubber"                  # `snakejax fit --by floor` estimates values of their own for each floor,
# day = "2024-09-04"                # day
# session = "morning"               # or session
# windows = {{length_s = 1.5, most = 20, rate_hz = 20.0}}
# inputs = {{{mapped}, stamp = "clock of the sender", enable = "safety"}}
# kind = "commanded"                # held until the next message; or "measured"
# each = "window"                   # a column: the rows with one value in it are one run
"""


def vehicle_template(kind: str) -> str:
    """A `case.toml` for the vehicle `kind`: "?" for each value to be measured, and every key explained."""
    vehicle, values = vehicle_class(kind), example_values(kind)
    lines = [
        "# A case: a vehicle and its recorded runs. Units are in the names of the keys.",
        '# Write a value in place of every "?".',
        f'title = "my {vehicle.noun}"',
        f'skid = "{next(iter(vehicle.structures))}"                       # {" or ".join(vehicle.structures)}: '
        "wheels that slip, or not",
        "",
        "[vehicle]",
        f'kind = "{kind}"',
    ]
    for key, field in fields_of(vehicle).items():
        unit, meaning = field.metadata["domain"].unit, field.metadata["meaning"]
        if field.default is dataclasses.MISSING:
            example = f", such as {values[field.name]:g}"
            lines.append(f"{key} = {_BLANK}".ljust(36) + f"# {meaning} [{unit}]{example}")
        else:
            lines.append(f"# {key} = {float(field.default)!r}".ljust(36) + f"# {meaning} [{unit}]")
    if "unknown" in {f.name for f in dataclasses.fields(vehicle)}:  # type: ignore[arg-type]
        lines.append(
            '# An optional one may be "estimate", or {estimate = 1.0} with a first guess: a fit finds it then.'
        )
    lines.append(f"# Standard deviations, where they are known: {', '.join(sd_keys_of(vehicle))}")
    for given in vehicle.inputs:
        lines += [
            "",
            f"# How the actuator changes the command `{given.name}` before it acts. Every key is optional.",
            f"# [actuator.{given.name}]",
        ]
        lines += ["# gain = 1.0", "# offset = 0.0", "# dead_band = 0.0", "# saturation = 1.0", "# lag_s = 0.1"]
    return "\n".join(lines) + "\n" + "".join(_run(role, vehicle.inputs) for role in ("train", "heldout"))


def _run(role: str, inputs: tuple[Input, ...]) -> str:
    rows = []
    for one in inputs:
        terms = f"{one.name} = {_BLANK}".ljust(36)
        rows.append(f"{terms}# {one.label} ({_FORMS[one.kind]}): [[a, w, p], ...], a sin(w t + p) summed")
    text = _RUN.format(role=role, inputs="\n".join(rows))
    columns = ", ".join(["time_s", *(one.name for one in inputs)])
    mapped = ", ".join(f'{one.name} = "{one.label}"' for one in inputs)
    return text + (_MORE.format(columns=columns, mapped=mapped) if role == "train" else "")
