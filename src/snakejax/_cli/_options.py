"""The options that commands share, and how their values are read. Nothing here needs JAX."""

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .._errors import InputError

MODELS = ("pacejka", "rayleigh", "ideal")
SKIDS = ("coupled", "free", "printed")
USUAL_THRESHOLD = 3.0


class Formatter(argparse.RawDescriptionHelpFormatter):
    """Help of 80 columns at most, its examples as they are written."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=80)


def add_command(commands: Any, name: str, run: Any, help: str, description: str, example: str) -> Any:
    """A command's parser."""
    made = commands.add_parser(
        name,
        help=help,
        description=description,
        epilog=f"example:\n  {example}",
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    made.set_defaults(run=run)
    return made


def add_cases(command: Any, presets: bool = False) -> None:
    """CASE ..., and where results go."""
    what = "a folder with case.toml" + (
        ", or a preset of the paper: paper-gait1, paper-gait2, paper-forward, paper-rotate" if presets else ""
    )
    command.add_argument("cases", nargs="+", metavar="CASE", help=what)
    command.add_argument(
        "--json", metavar="FILE", help="write the result there; - for standard output, a folder for several CASEs"
    )
    command.add_argument("--out", metavar="DIR", help="write result and figures into this folder")
    command.add_argument(
        "--as-recorded", action="store_true", help="use the recordings as they are: mask no frame that is wrong"
    )
    command.add_argument("--seed", type=int, default=0, help="seed of all that is random (default 0)")
    command.add_argument("--quiet", action="store_true", help="print nothing but complaints and --json -")


def add_loading(command: Any) -> None:
    """What the gaits of the paper's Table I carry."""
    command.add_argument("--load", type=float, metavar="N", help="paper-gait1 and paper-gait2: load on a wheelset [N]")
    command.add_argument("--camber", type=float, metavar="RAD", help="paper-gait1 and paper-gait2: camber [rad]")


def add_model(command: Any) -> None:
    """What model to take."""
    command.add_argument("--model", choices=MODELS, help="tyre law (default pacejka, or that of the preset)")
    command.add_argument("--skid", choices=SKIDS, help="skid structure (default that of CASE)")
    command.add_argument(
        "--set", metavar="B=6,C=1.4", action="append", help="values of parameters, in SI units; they are held"
    )
    command.add_argument(
        "--effect",
        metavar="NAME[:p=v,...]",
        action="append",
        help="add an effect, built in or FILE.py:Class; values given are held. May be repeated",
    )
    command.add_argument(
        "--from", dest="saved", metavar="FIT.json", help="take model, parameters and effects of a saved fit"
    )


def add_fitting(command: Any) -> None:
    """How to fit."""
    command.add_argument(
        "--free", metavar="B,C,D,E", help="parameters to estimate (default: all of the tyre and the effects)"
    )
    command.add_argument(
        "--robust",
        metavar="SD",
        nargs="?",
        const="",
        help="count residuals above this many standard deviations linearly (default 3)",
    )


class EffectSpec(NamedTuple):
    """One `--effect`: `source` is None for a built-in one, else the file and class to take it from."""

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
        raise InputError(f"`{text}` names no class", "option --effect", f"write {text}:Class")
    name, _, values = text.partition(":")
    return EffectSpec(name, None, assignments(values, "option --effect"))


def snake_case(name: str) -> str:
    """The name of an effect from that of its class: `CableSpring` is `cable_spring`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def assignments(text: str, where: str) -> dict[str, float]:
    """`B=6,C=1.4` as a dictionary. **Raises:** `InputError`."""
    found: dict[str, float] = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals):
            raise InputError(f"`{part}` sets nothing", where, "write NAME=NUMBER, as in B=6,C=1.4")
        if name in found:
            raise InputError(f"`{name}` is given twice", where, "give it once")
        found[name] = finite(value, where, f"`{part}`")
    return found


def finite(text: str, where: str, what: str) -> float:
    """A finite number. **Raises:** `InputError`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{what} has no finite number", where, "write a number such as 0.25")
    return value


class Varied(NamedTuple):
    """One `--vary`: a parameter and the values it takes."""

    name: str
    low: float
    high: float
    count: int


def varied(text: str) -> Varied:
    """`D=0.5:10:41`. **Raises:** `InputError`."""
    where, remedy = "option --vary", "write NAME=FIRST:LAST:COUNT, as in D=0.5:10:41"
    name, _, values = text.partition("=")
    parts = values.split(":")
    if not name.strip() or len(parts) != 3:
        raise InputError(f"`{text}` names no values", where, remedy)
    low, high = (finite(part, where, f"`{text}`") for part in parts[:2])
    if not parts[2].strip().isdigit() or int(parts[2]) < 2 or not low < high:
        raise InputError(f"`{text}` is no ascending row of two values or more", where, remedy)
    return Varied(name.strip(), low, high, int(parts[2]))


def start_pose(text: str | None) -> tuple[float, float, float] | None:
    """`x,y,heading`. **Raises:** `InputError`."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"`{text}` is no pose", "option --start", "write x,y,heading in m and rad, as in 0,0,1.57")
    x, y, heading = (finite(part, "option --start", f"`{text}`") for part in parts)
    return x, y, heading


def threshold(text: str | None) -> float:
    """The threshold of `--robust` in standard deviations of the noise; inf where it is not given."""
    if text is None:
        return math.inf
    value = finite(text, "option --robust", f"`{text}`") if text else USUAL_THRESHOLD
    if value <= 0:
        raise InputError(f"A threshold of {value:g} is none", "option --robust", "give a number above 0, such as 3")
    return value


def names(text: str | None) -> list[str] | None:
    """`B,C` as a list."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def given(options: argparse.Namespace) -> Mapping[str, Any]:
    """The options a user gave, for the record."""
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
        raise InputError(f"{len(cases)} CASEs need as many files", "option --json", "name a folder")
    if len(cases) > 1 or path.is_dir() or options.json.endswith("/"):
        return {case: path / f"{case}.json" for case in cases}
    return {cases[0]: path}
