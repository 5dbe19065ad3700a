"""`snakejax import`: show the contents of a recording, convert it, or make a case of it."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, ProgressEvent

from .marker_template import ask, places
from .options import add_command, assignments
from .progress import progress

if TYPE_CHECKING:
    from snakejax.recording.case_import import ImportRequest
    from snakejax.recording.readers import Capture, FileAnnotations


_EPILOG = """\
  snakejax import take.csv
  snakejax import take.csv --object board --case my-case
  snakejax import trial.c3d --object board --front nose --back tail --case my
  snakejax import lap.csv --columns "time=t,x=px,y=py,heading=yaw" --to lap.tum"""
JOINTS = ("rotor", "front_wheelset", "back_wheelset")
_ASKED = {
    "mass_kg": "mass of the whole board, with rotor and wheelsets [kg]",
    "rotor_inertia_kgm2": "inertia of the rotor about its axis [kg m^2]",
    "wheelset_inertia_kgm2": "inertia of one wheelset about its pivot [kg m^2]",
    "half_length_m": "distance from the middle of the board to the pivot of a wheelset [m]",
}


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "import",
        run,
        "show the contents of a recording, and make a case of it",
        "Show the contents of a recording; convert it with --to, or make a case of it\n"
        "with --case. Formats: Vicon CSV, C3D, TRC, Motive CSV, Qualisys TSV, ROS bags,\n"
        "plain CSV, Parquet, TUM; the format is recognised from the content.",
        _EPILOG.strip(),
    )
    command.add_argument("files", nargs="+", metavar="FILE", help="a recording; each becomes a run")
    command.add_argument("--case", metavar="DIR", help="make this case folder, or add a run to it")
    # The spelling before `--out` meant a folder of results in all commands.
    command.add_argument("--out", dest="case", metavar="DIR", help=argparse.SUPPRESS)
    command.add_argument("--to", metavar="FILE", help="convert to FILE.csv or, of one object, FILE.tum")
    command.add_argument("--object", metavar="NAME", help="the name of the board, or of the object with its markers")
    command.add_argument(
        "--role", choices=("train", "heldout"), default="train", help="role of the run (default train)"
    )
    which = command.add_argument_group("information missing from the file")
    which.add_argument("--columns", metavar="MAP", help='of a plain table: "time=t,x=pos x,y=pos y,heading=yaw"')
    which.add_argument("--units", metavar="MAP", help="of a plain table: length=mm,angle=deg,time=ms; default SI")
    which.add_argument("--up", metavar="AXIS", help="the axis that points up (default: from the motion)")
    which.add_argument(
        "--x-axis", metavar="WHERE", help="direction of the object's x axis: forward (default), left, back, right"
    )
    which.add_argument(
        "--angles", metavar="KIND", help="RX, RY, RZ of Vicon: helical or xyz (default: from the motion)"
    )
    which.add_argument("--markers", metavar="NAMES", help="the markers on the board (default: all of the object)")
    which.add_argument("--front", metavar="NAMES", help="the marker or markers at the front end of the board")
    which.add_argument("--back", metavar="NAMES", help="those at its back end; the middle of the board lies between")
    which.add_argument(
        "--template",
        metavar="CSV",
        help="in place of --front and --back: a file of the marker positions, columns marker,x_m,y_m,z_m",
    )
    _add_joints(command)
    command.add_argument(
        "--board",
        metavar="SET",
        action="append",
        help="measures of the board for a new case: mass_kg=7,half_length_m=0.25,...",
    )
    command.add_argument(
        "--json", metavar="FILE", help="write the contents of the files to FILE; - for standard output"
    )
    command.add_argument("--quiet", action="store_true", help="print only errors and the output of --json -")


def _add_joints(command: Any) -> None:
    """Where the joints are, or what they were told to do."""
    joints = command.add_argument_group("joints: tracked objects, or commanded gaits")
    joints.add_argument("--rotor", metavar="NAME", help="the object of the rotor; its angle is measured")
    joints.add_argument("--front-wheelset", metavar="NAME", help="the object of the front wheelset")
    joints.add_argument(
        "--back-wheelset", metavar="NAME", help="the object of the back wheelset, if it is steered separately"
    )
    joints.add_argument(
        "--phi",
        metavar="SINES",
        help="commanded steering angle: [[amplitude rad, angular frequency rad/s, phase rad], ...]",
    )
    joints.add_argument(
        "--phi-back", metavar="SINES", help="commanded steering of the back, if it is steered separately"
    )
    joints.add_argument("--psi", metavar="SINES", help="commanded rotor angle, in the same form and units")


def run(options: argparse.Namespace) -> int:
    """Import each file."""
    from snakejax.recording.capture_summary import ground, summary, summary_text
    from snakejax.recording.readers import read_capture

    hints = _hints(options)
    if options.to and (options.case or len(options.files) > 1):
        raise InputError("--to converts one FILE at a time, without --case", "option --to", "run it once for each file")
    if options.to and options.x_axis is not None:
        where = f"option --x-axis {options.x_axis}"
        raise InputError("A converted object keeps its axes", where, "give it with --case, or in case.toml")
    if options.case and options.board and (Path(options.case) / "case.toml").exists():
        where = f"option --board {','.join(options.board)}"
        raise InputError("The case already exists and has its board", where, "change the board in its case.toml")
    captures = []
    with progress(options.quiet) as say:
        for done, path in enumerate(options.files):
            say(ProgressEvent(Phase.READING, f"reading {path}", done, len(options.files)))
            captures.append(read_capture(path, hints))
    if options.json is not None:
        from snakejax.core.files import write_whole
        from snakejax.present.as_json.values import as_text

        contents = as_text({str(path): summary(c) for path, c in zip(options.files, captures, strict=True)})
        sys.stdout.write(contents) if options.json == "-" else write_whole(Path(options.json), contents)
    for capture in captures:
        object_name = _object(options, capture)
        if not options.quiet and options.json != "-":
            grounds = {} if object_name is None else {object_name: ground(capture, object_name)}
            print(summary_text(capture, grounds, options.up))
        if options.to:
            _convert(options, capture, hints, object_name)
        elif options.case:
            _add(options, capture, hints, object_name)
    if options.case:
        _finish(options)
    return 0


def _hints(options: argparse.Namespace) -> "FileAnnotations":
    from snakejax.recording.readers import ANGLES, X_AXIS_DIRECTIONS, FileAnnotations

    columns, units = (_pairs(getattr(options, name), f"option --{name}") for name in ("columns", "units"))
    if options.up is not None:
        _axis(options.up, "option --up")
    x_axis = options.x_axis or "forward"
    if x_axis not in X_AXIS_DIRECTIONS:
        what = f"`{x_axis}` is not a direction on the board"
        raise InputError(what, "option --x-axis", f"write one of {', '.join(X_AXIS_DIRECTIONS)}")
    if options.angles is not None and options.angles not in ANGLES:
        raise InputError(
            f"`{options.angles}` is not a kind of angles", "option --angles", f"write {' or '.join(ANGLES)}"
        )
    return FileAnnotations(columns, units, options.up, x_axis=x_axis, angles=options.angles)


def _pairs(text: str | None, where: str) -> dict[str, str] | None:
    if text is None:
        return None
    pairs: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise InputError(f"`{part}` is not KEY=NAME", where, "write KEY=NAME,KEY=NAME")
        pairs[key] = value
    return pairs


def _object(options: argparse.Namespace, capture: "Capture") -> str | None:
    """The object of --object, or the only one; None where there are several and none is needed."""
    from snakejax.recording.readers.planar_pose import listed, subjects

    of_markers = [name for name in subjects(capture) if name not in capture.bodies]
    candidates = [*capture.bodies] or of_markers
    if not candidates and (options.case or options.to):
        raise InputError(
            "The file holds no object and no named marker", capture.where, "name the markers and export it again"
        )
    if options.object is not None:
        if options.object in (*candidates, *of_markers) or candidates == [""]:
            return options.object if options.object in (*candidates, *of_markers) else ""
        what = f'There is no object "{options.object}" in the file'
        raise InputError(what, capture.where, listed(options.object, [name for name in candidates if name]))
    if len(candidates) == 1:
        return candidates[0]
    if not (options.case or (options.to or "").endswith(".tum")):
        return None
    answer = ask(options, f"Which object is the board? {', '.join(candidates[:12])}")
    if answer in candidates:
        return answer
    raise InputError(
        f"There are {len(candidates)} objects",
        capture.where,
        f"choose one with --object, as in --object {candidates[0]}",
    )


def _upright(
    options: argparse.Namespace, capture: "Capture", hints: "FileAnnotations", object_name: str | None
) -> "FileAnnotations":
    """`hints` with the axis that points up, from the motion of the object or from the terminal."""
    from snakejax.recording.capture_summary import ground, up_of

    if hints.up is not None:
        return hints
    up = None if object_name is None else up_of(capture, ground(capture, object_name))
    if up is None and capture.up_open and (answer := ask(options, "Which axis points up? x, y, z, -x, -y, -z")):
        up = _axis(answer, "the answer")
    return hints._replace(up=up)


def _axis(text: str, where: str) -> str:
    from snakejax.recording.readers import UPRIGHT

    if text not in UPRIGHT:
        raise InputError(f"`{text}` is not an axis", where, f"write one of {', '.join(UPRIGHT)}")
    return text


def _convert(
    options: argparse.Namespace, capture: "Capture", hints: "FileAnnotations", object_name: str | None
) -> None:
    from snakejax.recording.readers import write_csv, write_tum

    hints = _upright(options, capture, hints, object_name)
    if object_name is not None and object_name not in capture.bodies:
        hints = hints._replace(markers=places(options, capture, hints, object_name))
    path = Path(options.to)
    body = object_name is not None and (object_name in capture.bodies or hints.markers is not None)
    if path.suffix == ".tum":
        if not body:
            what = "A TUM file holds the poses of a body, but this file has markers"
            raise InputError(what, "option --to", "give their positions with --front and --back or --template")
        write_tum(capture, path, object_name or "", hints)
    elif path.suffix == ".csv":
        write_csv(capture, path, [object_name] if body and object_name is not None else [], hints)
    else:
        raise InputError(f"`{options.to}` is neither .csv nor .tum", "option --to", "name FILE.csv or FILE.tum")
    if not options.quiet and options.json != "-":
        print(f"wrote {path}")


def _add(options: argparse.Namespace, capture: "Capture", hints: "FileAnnotations", object_name: str | None) -> None:
    from snakejax.recording.case_import import add_run

    assert object_name is not None
    hints = _upright(options, capture, hints, object_name)
    if object_name not in capture.bodies:
        hints = hints._replace(markers=places(options, capture, hints, object_name))
    folder = Path(options.case)
    board = _measures(options, (folder / "case.toml").exists())
    title = folder.resolve().name
    for note in add_run(folder, capture, _run(options, hints, object_name), title, board):
        if not options.quiet:
            print(f"  note     {note}")


def _measures(options: argparse.Namespace, has_board: bool) -> dict[str, float]:
    known = {**_ASKED, "inertia_kgm2": ""}
    measures = assignments(",".join(options.board or ()), "option --board")
    for key in measures:
        if key not in known:
            from snakejax.core.errors import instead_of

            raise InputError(f"Unknown measure `{key}`", "option --board", instead_of(key, known))
    if has_board:
        return measures
    for key, question in _ASKED.items():
        if key not in measures and (answer := ask(options, question)):
            measures |= assignments(f"{key}={answer}", "the answer")
    return measures


def _run(options: argparse.Namespace, hints: "FileAnnotations", object_name: str) -> "ImportRequest":
    import json

    from snakejax.recording.case_import import ImportRequest, JointObjects

    gait = {}
    for key in ("phi", "psi", "phi_back"):
        if (text := getattr(options, key)) is None:
            continue
        try:
            rows = json.loads(text)
            gait[key] = json.dumps([[float(number) for number in row] for row in rows if len(row) == 3])
            complete = len(json.loads(gait[key])) == len(rows)
        except (ValueError, TypeError, KeyError):
            complete = False
        if not complete:
            example = "write [[amplitude, frequency, phase], ...], as in [[0.9, 4.0, 0.0]]"
            raise InputError(f"`{text}` is not a list of sines", f"option --{key.replace('_', '-')}", example)
    joints = JointObjects(*(getattr(options, name) for name in JOINTS))
    return ImportRequest(object_name, options.role, hints, joints, gait, options.object or "")


def _finish(options: argparse.Namespace) -> None:
    from snakejax.core.toml_table import to_fill_in

    path = Path(options.case) / "case.toml"
    if left := [f"{key} (line {n})" for n, key in to_fill_in(path.read_text(encoding="utf-8").split("\n"))]:
        print(f'{path} needs a value for every "?": {", ".join(left)}', file=sys.stderr)
    elif not options.quiet:
        print(f"wrote {path}: now run `snakejax check {options.case}`")
