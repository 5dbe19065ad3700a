"""The options that commands share, and the functions that parse them. This module does not need JAX."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from snakejax.core.errors import InputError
from snakejax.dynamics.kinds import LABELS, MODEL_KINDS, STRUCTURES

from ..option_texts import EffectSpec as EffectSpec
from ..option_texts import assignments as assignments
from ..option_texts import effect_spec as effect_spec
from ..option_texts import finite as finite
from ..option_texts import names as names
from ..option_texts import threshold as threshold


class Formatter(argparse.RawDescriptionHelpFormatter):
    """Help of at most 80 columns with unchanged examples."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=80)


def add_command(commands: Any, name: str, run: Any, help: str, description: str, example: str) -> Any:
    """The parser of a command."""
    command = commands.add_parser(
        name,
        help=help,
        description=description,
        epilog=f"example:\n  {example}",
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    command.set_defaults(run=run)
    return command


def add_cases(command: Any, presets: bool = False) -> None:
    """CASE and how it is read."""
    what = "a folder with case.toml" + (
        ", or a preset of the paper: paper-gait1, paper-gait2, paper-forward, paper-rotate" if presets else ""
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help=what)
    command.add_argument(
        "--as-recorded", action="store_true", help="use the recordings unchanged: mask no wrong frames"
    )
    command.add_argument("--seed", type=int, default=0, help="seed of the random numbers (default 0)")


def add_output(command: Any) -> None:
    """Where results go."""
    output = command.add_argument_group("output")
    output.add_argument(
        "--json", metavar="FILE", help="write the result to FILE; - for standard output, a folder for several CASEs"
    )
    output.add_argument(
        "--out",
        metavar="DIR",
        help="write the result, and the report and figures where there are any, into this folder as COMMAND.json, ...",
    )
    output.add_argument("--quiet", action="store_true", help="print only errors and the output of --json -")


def add_loading(command: Any) -> None:
    """The loading of the gaits of the paper's Table I."""
    group = command.add_argument_group("presets")
    group.add_argument("--load", type=float, metavar="N", help="paper-gait1 and paper-gait2: load on a wheelset [N]")
    group.add_argument("--camber", type=float, metavar="RAD", help="paper-gait1 and paper-gait2: camber [rad]")


def add_model(command: Any, candidates: bool = False) -> None:
    """The options of the model; with `candidates`, `--effect` names one of them."""
    group = command.add_argument_group("model")
    group.add_argument("--model", choices=MODEL_KINDS, help="tyre law (default: pacejka, or that of the preset)")
    group.add_argument("--skid", choices=STRUCTURES, help="skid structure (default: that of CASE)")
    group.add_argument(
        "--set", metavar="B=6,C=1.4", action="append", help="values of parameters in SI units, kept fixed"
    )
    _add_effects_and_saved_fit(group)
    if not candidates:
        # The spelling before there was one for all commands.
        group.add_argument("--effect", dest="with_", action="append", help=argparse.SUPPRESS)


def add_saved_models(command: Any) -> None:
    """The options of a command that takes its models from a saved fit."""
    _add_effects_and_saved_fit(command.add_argument_group("model"), required=True)


def _add_effects_and_saved_fit(group: Any, required: bool = False) -> None:
    group.add_argument(
        "--with",
        dest="with_",
        metavar="NAME[:p=v,...]",
        action="append",
        help="an effect in the model, built in or FILE.py:Class; given values are fixed. May be repeated",
    )
    group.add_argument(
        "--from",
        dest="saved",
        metavar="FIT.json",
        required=required,
        help="use model, parameters and effects of a saved fit",
    )


def add_fitting(command: Any) -> Any:
    """The options of a fit; the group of them."""
    group = command.add_argument_group("estimation")
    group.add_argument(
        "--free", metavar="B,C,D,E", help="parameters to estimate (default: all of the tyre and the effects)"
    )
    group.add_argument(
        "--by", choices=LABELS, help="estimate separate values of them for each floor, day, session or group of runs"
    )
    group.add_argument(
        "--robust",
        metavar="SD",
        nargs="?",
        const="",
        help="Huber's loss: residuals above SD standard deviations of the noise count linearly (without a number: SD ="
        " 3). Without --robust: least squares, or SD = 3 where a case has more than 40 windows",
    )
    return group


def add_question(command: Any) -> None:
    """The options of `diagnose` and `explain`: case, base and its fit, candidate effects, and which windows to take."""
    add_cases(command)
    add_model(command, candidates=True)
    add_fitting(command)
    group = command.add_argument_group("candidates")
    group.add_argument(
        "--effect",
        metavar="NAME",
        action="append",
        help="one more candidate effect: FILE.py:Class of your own. May be repeated",
    )
    group.add_argument("--without", metavar="NAME", action="append", help="an effect that is no candidate")
    what = "a first look: take a tenth of the windows of each recording, and at least one"
    command.add_argument("--quick", action="store_true", help=what)


def model_options(options: argparse.Namespace) -> dict[str, Any]:
    """What the options say of model and estimation, as `snakejax.commands` takes it."""
    return {
        "model": options.model,
        "skid": options.skid,
        "set": options.set,
        "with_": options.with_,
        "from_": options.saved,
        "free": getattr(options, "free", None),
        "by": getattr(options, "by", None),
        "robust": getattr(options, "robust", None),
    }


class Varied(NamedTuple):
    """One `--vary`: a parameter and `number` values of it, evenly from `low` to `high`."""

    name: str
    low: float
    high: float
    number: int


def varied(text: str) -> Varied:
    """`D=0.5:10:41`. **Raises:** `InputError`."""
    where, remedy = "option --vary", "write NAME=FIRST:LAST:COUNT, as in D=0.5:10:41"
    name, _, values = text.partition("=")
    parts = values.split(":")
    if not name.strip() or len(parts) != 3:
        raise InputError(f"`{text}` does not name values", where, remedy)
    low, high = (finite(part, where, f"`{text}`") for part in parts[:2])
    if not parts[2].strip().isdigit() or int(parts[2]) < 2 or not low < high:
        raise InputError(f"`{text}` is not an ascending range of two or more values", where, remedy)
    return Varied(name.strip(), low, high, int(parts[2]))


def start_pose(text: str | None) -> tuple[float, float, float] | None:
    """`x,y,heading`. **Raises:** `InputError`."""
    if text is None:
        return None
    x, y, heading = _start_numbers(text, (3,), "write x,y,heading in m and rad, as in 0,0,1.57")
    return x, y, heading


def start_state(text: str | None) -> tuple[float, ...] | None:
    """`x,y,heading` at rest, or `x,y,heading,u,w,yaw_rate` in motion. **Raises:** `InputError`."""
    remedy = "write x,y,heading in m and rad, as in 0,0,1.57; in motion add u,w in m/s and the yaw rate in rad/s"
    return None if text is None else _start_numbers(text, (3, 6), remedy)


def _start_numbers(text: str, counts: Sequence[int], remedy: str) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) not in counts:
        raise InputError(f"`{text}` is not a pose", "option --start", remedy)
    return tuple(finite(part, "option --start", f"`{text}`") for part in parts)


def given(options: argparse.Namespace) -> Mapping[str, Any]:
    """The options given by the user, for the provenance of a result."""
    skipped = ("run", "command", "cases", "seed", "json", "out", "quiet")
    renamed = {"saved": "from", "with_": "with"}
    if getattr(options, "robust", None) is not None:
        options = argparse.Namespace(**{**vars(options), "robust": threshold(options.robust)})
    return {
        renamed.get(name, name): value
        for name, value in vars(options).items()
        if name not in skipped and value is not None and value is not False
    }


def targets(options: argparse.Namespace, cases: Sequence[str]) -> dict[str, Path | None]:
    """Where the JSON of each case goes: None for standard output. Empty without `--json`. **Raises:** `InputError`."""
    if options.json is None:
        return {}
    path = Path(options.json)
    if len(cases) == 1 and options.json == "-":
        return {cases[0]: None}
    if options.json == "-" or (len(cases) > 1 and path.is_file()):
        raise InputError(f"{len(cases)} CASEs need {len(cases)} files", "option --json", "name a folder")
    if len(cases) > 1 or path.is_dir() or options.json.endswith("/"):
        return {case: path / f"{case}.json" for case in cases}
    return {cases[0]: path}
