"""The options that commands share, and the functions that parse them. This module does not need JAX."""

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from snakejax.core.errors import InputError
from snakejax.dynamics.kinds import MODEL_KINDS, STRUCTURES

USUAL_THRESHOLD = 3.0


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
    """CASE and the options of the output."""
    what = "a folder with case.toml" + (
        ", or a preset of the paper: paper-gait1, paper-gait2, paper-forward, paper-rotate" if presets else ""
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help=what)
    command.add_argument(
        "--json", metavar="FILE", help="write the result to FILE; - for standard output, a folder for several CASEs"
    )
    command.add_argument("--out", metavar="DIR", help="write result, report and figures into this folder")
    command.add_argument(
        "--as-recorded", action="store_true", help="use the recordings unchanged: mask no wrong frames"
    )
    command.add_argument("--seed", type=int, default=0, help="seed of the random numbers (default 0)")
    command.add_argument("--quiet", action="store_true", help="print only errors and the output of --json -")


def add_loading(command: Any) -> None:
    """The loading of the gaits of the paper's Table I."""
    command.add_argument("--load", type=float, metavar="N", help="paper-gait1 and paper-gait2: load on a wheelset [N]")
    command.add_argument("--camber", type=float, metavar="RAD", help="paper-gait1 and paper-gait2: camber [rad]")


def add_model(command: Any) -> None:
    """The options of the model."""
    command.add_argument("--model", choices=MODEL_KINDS, help="tyre law (default: pacejka, or that of the preset)")
    command.add_argument("--skid", choices=STRUCTURES, help="skid structure (default: that of CASE)")
    command.add_argument(
        "--set", metavar="B=6,C=1.4", action="append", help="values of parameters in SI units, kept fixed"
    )
    command.add_argument(
        "--effect",
        metavar="NAME[:p=v,...]",
        action="append",
        help="add an effect, built in or FILE.py:Class; given values are fixed. May be repeated",
    )
    command.add_argument(
        "--from", dest="saved", metavar="FIT.json", help="use model, parameters and effects of a saved fit"
    )


def add_fitting(command: Any) -> None:
    """The options of a fit."""
    command.add_argument(
        "--free", metavar="B,C,D,E", help="parameters to estimate (default: all of the tyre and the effects)"
    )
    command.add_argument(
        "--robust",
        metavar="SD",
        nargs="?",
        const="",
        help="Huber loss: residuals above SD standard deviations count linearly (default 3)",
    )


class EffectSpec(NamedTuple):
    """One `--effect`; `source` is its file and class, None for a built-in effect."""

    name: str
    source: tuple[Path, str] | None
    values: dict[str, float]


def effect_spec(text: str) -> EffectSpec:
    """`NAME`, `NAME:p=v,...`, `FILE.py:Class` or `FILE.py:Class:p=v,...`."""
    own = re.fullmatch(r"(?P<file>.+\.py):(?P<name>\w+)(:(?P<values>.*))?", text)
    if own is not None:
        values = assignments(own["values"] or "", "option --effect")
        return EffectSpec(snake_case(own["name"]), (Path(own["file"]), own["name"]), values)
    if text.endswith(".py"):
        raise InputError(f"`{text}` does not name a class", "option --effect", f"write {text}:Class")
    name, _, values = text.partition(":")
    return EffectSpec(name, None, assignments(values, "option --effect"))


def snake_case(name: str) -> str:
    """The name of an effect from that of its class: `CableSpring` gives `cable_spring`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def assignments(text: str, where: str) -> dict[str, float]:
    """`B=6,C=1.4` as a dictionary. **Raises:** `InputError`."""
    values: dict[str, float] = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals):
            raise InputError(f"`{part}` is not NAME=NUMBER", where, "write NAME=NUMBER, as in B=6,C=1.4")
        if name in values:
            raise InputError(f"`{name}` is given twice", where, "give it once")
        values[name] = finite(value, where, f"`{part}`")
    return values


def finite(text: str, where: str, what: str) -> float:
    """A finite number. **Raises:** `InputError`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{what} does not contain a finite number", where, "write a number such as 0.25")
    return value


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
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"`{text}` is not a pose", "option --start", "write x,y,heading in m and rad, as in 0,0,1.57")
    x, y, heading = (finite(part, "option --start", f"`{text}`") for part in parts)
    return x, y, heading


def threshold(text: str | None) -> float:
    """The threshold of `--robust` in standard deviations of the noise; inf where it is not given."""
    if text is None:
        return math.inf
    value = finite(text, "option --robust", f"`{text}`") if text else USUAL_THRESHOLD
    if value <= 0:
        raise InputError(
            f"The threshold {value:g} is not positive", "option --robust", "give a number above 0, such as 3"
        )
    return value


def names(text: str | None) -> list[str] | None:
    """`B,C` as a list."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def given(options: argparse.Namespace) -> Mapping[str, Any]:
    """The options given by the user, for the provenance of a result."""
    skipped = ("run", "command", "cases", "seed", "json", "out", "quiet")
    renamed = {"saved": "from"}
    if getattr(options, "robust", None) is not None:
        options = argparse.Namespace(**{**vars(options), "robust": threshold(options.robust)})
    return {
        renamed.get(name, name): value
        for name, value in vars(options).items()
        if name not in skipped and value not in (None, False)
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
