"""`snakejax import`: show what a recording holds, convert it, or make a case of it."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._options import add_command, assignments
from ._places import ask, places
from ._progress import progress

if TYPE_CHECKING:
    from .._import import Wanted
    from ..readers import Capture, Hints

_EPILOG = """\
  snakejax import take.csv
  snakejax import take.csv --object board --out my-case
  snakejax import trial.c3d --object board --front nose --back tail --out case
  snakejax import lap.csv --columns "time=t,x=px,y=py,heading=yaw" --to lap.tum"""
JOINTS = ("rotor", "front_wheelset", "back_wheelset")
_ASKED = {
    "mass_kg": "mass of all of it [kg]",
    "rotor_inertia_kgm2": "inertia of the rotor about its axis [kg m^2]",
    "wheelset_inertia_kgm2": "inertia of one wheelset about its pivot [kg m^2]",
    "half_length_m": "from the middle of the board to a wheelset [m]",
}


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "import",
        run,
        "show what a recording holds, and make a case of it",
        "Show what a recording of any known format holds; convert it with --to, or make\n"
        "a case of it with --out. Formats: Vicon CSV, C3D, TRC, Motive CSV, Qualisys TSV,\n"
        "ROS bags, plain CSV, Parquet, TUM; each is recognised from its content.",
        _EPILOG.strip(),
    )
    command.add_argument("files", nargs="+", metavar="FILE", help="a recording; each becomes a run")
    command.add_argument("--out", metavar="CASE", help="make this case folder, or add a run to it")
    command.add_argument("--to", metavar="FILE", help="convert to FILE.csv or, of one object, FILE.tum")
    command.add_argument("--object", metavar="NAME", help="the board, or whose markers are on it")
    command.add_argument("--role", choices=("train", "heldout"), default="train", help="of the run (default train)")
    which = command.add_argument_group("what a file may not say")
    which.add_argument("--columns", metavar="MAP", help='of a plain table: "time=t,x=pos x,y=pos y,heading=yaw"')
    which.add_argument("--units", metavar="MAP", help="of a plain table: length=mm,angle=deg,time=ms; else SI")
    which.add_argument("--up", metavar="AXIS", help="the axis that points up; else found from the motion")
    which.add_argument("--x-axis", metavar="WHERE", help="the object's x axis: forward (default), left, back, right")
    which.add_argument("--markers", metavar="NAMES", help="those on the board (default all of the object)")
    which.add_argument("--front", metavar="NAMES", help="the marker, or markers, at the board's front end")
    which.add_argument("--back", metavar="NAMES", help="and at its back end; its middle lies between")
    which.add_argument("--template", metavar="CSV", help="or where they sit: marker,x_m,y_m,z_m")
    joints = command.add_argument_group("joints: objects of their own, or commands")
    joints.add_argument("--rotor", metavar="NAME", help="its object: its angle is measured")
    joints.add_argument("--front-wheelset", metavar="NAME", help="its object")
    joints.add_argument("--back-wheelset", metavar="NAME", help="its object, where the back is steered by itself")
    joints.add_argument("--phi", metavar="SINES", help="commanded steering: [[amplitude, frequency, phase], ...]")
    joints.add_argument("--phi-back", metavar="SINES", help="of the back, where it is steered by itself")
    joints.add_argument("--psi", metavar="SINES", help="commanded rotor, likewise")
    command.add_argument("--board", metavar="SET", action="append", help="mass_kg=7,half_length_m=0.25,...")
    command.add_argument("--json", metavar="FILE", help="write what was understood there; - for standard output")
    command.add_argument("--quiet", action="store_true", help="print nothing but complaints and --json -")


def run(options: argparse.Namespace) -> int:
    """Import each file."""
    from .._understand import facts, ground, understood
    from ..readers import read_capture

    hints = _hints(options)
    if options.to and (options.out or len(options.files) > 1):
        raise InputError("One FILE is converted at a time, without --out", "option --to", "run it again for the others")
    if options.to and options.x_axis is not None:
        where = f"option --x-axis {options.x_axis}"
        raise InputError("A converted object keeps its axes", where, "give it with --out, or in case.toml")
    if options.out and options.board and (Path(options.out) / "case.toml").exists():
        where = f"option --board {','.join(options.board)}"
        raise InputError("The case is there already, and has its board", where, "change it in its case.toml")
    captures = []
    with progress(options.quiet) as say:
        for done, path in enumerate(options.files):
            say(f"reading {path}", done, len(options.files))
            captures.append(read_capture(path, hints))
    if options.json is not None:
        from .._files import write_whole
        from .._json import as_text

        found = as_text({str(path): facts(c) for path, c in zip(options.files, captures, strict=True)})
        sys.stdout.write(found) if options.json == "-" else write_whole(Path(options.json), found)
    for capture in captures:
        wanted = _object(options, capture)
        if not options.quiet and options.json != "-":
            grounds = {} if wanted is None else {wanted: ground(capture, wanted)}
            planar = any(b.heading is not None for b in capture.bodies.values())
            print(understood(capture, {} if planar else grounds))
        if options.to:
            _convert(options, capture, hints, wanted)
        elif options.out:
            _add(options, capture, hints, wanted)
    if options.out:
        _finish(options)
    return 0


def _hints(options: argparse.Namespace) -> "Hints":
    from ..readers import POINTING, UPRIGHT, Hints

    columns, units = (_pairs(getattr(options, name), f"option --{name}") for name in ("columns", "units"))
    if options.up is not None and options.up not in UPRIGHT:
        raise InputError(f"`{options.up}` is no axis", "option --up", f"write one of {', '.join(UPRIGHT)}")
    x_axis = options.x_axis or "forward"
    if x_axis not in POINTING:
        what = f"`{x_axis}` is nowhere on a board"
        raise InputError(what, "option --x-axis", f"write one of {', '.join(POINTING)}")
    return Hints(columns, units, options.up, x_axis=x_axis)


def _pairs(text: str | None, where: str) -> dict[str, str] | None:
    if text is None:
        return None
    found: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise InputError(f"`{part}` names nothing", where, "write KEY=NAME,KEY=NAME")
        found[key] = value
    return found


def _object(options: argparse.Namespace, capture: "Capture") -> str | None:
    """The object asked for, or the only one; None where there are several and nobody was asked for."""
    from ..readers._track import listed, subjects

    of_markers = [name for name in subjects(capture) if name not in capture.bodies]
    there = [*capture.bodies] or of_markers
    if options.object is not None:
        if options.object in (*there, *of_markers) or there == [""]:
            return options.object if options.object in (*there, *of_markers) else ""
        what = f'There is no object "{options.object}" in the file'
        raise InputError(what, capture.where, listed(options.object, [name for name in there if name]))
    if len(there) == 1:
        return there[0]
    if not (options.out or (options.to or "").endswith(".tum")):
        return None
    answer = ask(options, f"Which object is the board? {', '.join(there[:12])}")
    if answer in there:
        return answer
    raise InputError(f"There are {len(there)} objects", capture.where, f"say which, with --object {there[0]}")


def _convert(options: argparse.Namespace, capture: "Capture", hints: "Hints", wanted: str | None) -> None:
    from .._understand import ground, up_of
    from ..readers import write_csv, write_tum

    if wanted is not None and hints.up is None:
        hints = hints._replace(up=up_of(capture, ground(capture, wanted)))
    if wanted is not None and wanted not in capture.bodies:
        hints = hints._replace(markers=places(options, capture, hints, wanted))
    path = Path(options.to)
    body = wanted is not None and (wanted in capture.bodies or hints.markers is not None)
    if path.suffix == ".tum":
        if not body:
            what = "A TUM file holds the poses of a body, and here are markers"
            raise InputError(what, "option --to", "say where they sit, with --front and --back or --template")
        write_tum(capture, path, wanted or "", hints)
    elif path.suffix == ".csv":
        write_csv(capture, path, [wanted] if body and wanted is not None else [], hints)
    else:
        raise InputError(f"`{options.to}` is neither .csv nor .tum", "option --to", "name FILE.csv or FILE.tum")
    if not options.quiet and options.json != "-":
        print(f"wrote {path}")


def _add(options: argparse.Namespace, capture: "Capture", hints: "Hints", wanted: str | None) -> None:
    from .._import import add_run
    from .._understand import ground, up_of

    assert wanted is not None
    if hints.up is None:
        hints = hints._replace(up=up_of(capture, ground(capture, wanted)))
    if wanted not in capture.bodies:
        hints = hints._replace(markers=places(options, capture, hints, wanted))
    folder = Path(options.out)
    board = _measures(options, (folder / "case.toml").exists())
    title = folder.resolve().name
    for note in add_run(folder, capture, _run(options, hints, wanted), title, board):
        if not options.quiet:
            print(f"  note     {note}")


def _measures(options: argparse.Namespace, there: bool) -> dict[str, float]:
    known = {**_ASKED, "inertia_kgm2": ""}
    found = assignments(",".join(options.board or ()), "option --board")
    for key in found:
        if key not in known:
            from .._errors import instead_of

            raise InputError(f"Unknown measure `{key}`", "option --board", instead_of(key, known))
    if there:
        return found
    for key, question in _ASKED.items():
        if key not in found and (answer := ask(options, question)):
            found |= assignments(f"{key}={answer}", "the answer")
    return found


def _run(options: argparse.Namespace, hints: "Hints", wanted: str) -> "Wanted":
    import json

    from .._import import Joints, Wanted

    gait = {}
    for key in ("phi", "psi", "phi_back"):
        if (text := getattr(options, key)) is None:
            continue
        try:
            rows = json.loads(text)
            gait[key] = json.dumps([[float(number) for number in row] for row in rows if len(row) == 3])
            whole = len(json.loads(gait[key])) == len(rows)
        except (ValueError, TypeError, KeyError):
            whole = False
        if not whole:
            example = "write [[amplitude, frequency, phase], ...], as in [[0.9, 4.0, 0.0]]"
            raise InputError(f"`{text}` is no list of sines", f"option --{key.replace('_', '-')}", example)
    return Wanted(wanted, options.role, hints, Joints(*(getattr(options, name) for name in JOINTS)), gait)


def _finish(options: argparse.Namespace) -> None:
    from .._import import to_fill_in

    folder = Path(options.out)
    left = to_fill_in(folder)
    if left:
        print(f'{folder / "case.toml"} is to be filled in where it says "?": {", ".join(left)}', file=sys.stderr)
    elif not options.quiet:
        print(f"wrote {folder / 'case.toml'}: now run `snakejax check {folder}`")
