"""`snakejax sweep`: the Rayleigh coefficient k_s of the nearest Rayleigh board against other parameters."""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError, at_line, instead_of
from snakejax.core.progress import Phase, Progress, ProgressEvent

from .fit_pipeline import fitted
from .options import (
    Varied,
    add_cases,
    add_command,
    add_loading,
    add_model,
    add_output,
    finite,
    given,
    model_options,
    start_state,
    varied,
)
from .pipeline import Outcome, Stopwatch, each_case

if TYPE_CHECKING:
    from xarray import Dataset

    from snakejax.dynamics.inputs import Gait
    from snakejax.dynamics.model import Model
    from snakejax.simulation.parameter_sweep import Axes
    from snakejax.simulation.rayleigh_match import Polynomial


LOADING = ("load", "camber")
"""The loading of the paper's gaits, which can be varied in addition to model parameters."""
FIRST_SAMPLE = 1e-6
"""A run whose first sample is at less than this [s] begins at 0 s."""
SHOWN = 21
"""Rows of the printed table, evenly spaced over the sweep; the JSON has all."""


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "sweep",
        run,
        "vary parameters, and find the Rayleigh coefficient k_s of the nearest board",
        "Vary one parameter of a board, find for each value the Rayleigh board with the\n"
        "nearest path, and fit k_s by a polynomial of order 4; or vary several in all\n"
        "combinations. For a Rayleigh or ideal board no k_s is fitted; the sweep lists\n"
        "the end poses. Without --set or --from the case is fitted first. --out saves\n"
        "results as they are computed; an interrupted sweep then continues from there.",
        "snakejax sweep paper-rotate --vary D=0.5:10:41 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_loading(command)
    command.add_argument(
        "--vary",
        metavar="D=0.5:10:41",
        action="append",
        help="NAME=FIRST:LAST:COUNT: a parameter, its first and last value [SI], the number of values. May be repeated",
    )
    command.add_argument(
        "--table", metavar="FILE.csv", help="in place of --vary: a column for each parameter, a row for each board"
    )
    start = "start pose [m, m, rad] (default 0,0,0); for a start in motion also u,w [m/s] and the yaw rate [rad/s]"
    command.add_argument("--start", metavar="X,Y,HEADING[,U,W,R]", help=start)
    command.add_argument("--run", metavar="RUN", dest="gait", help="the run whose gait is used (default: the first)")
    command.add_argument(
        "--cluster", metavar="ADDRESS", help="compute on the Dask cluster with this scheduler, as in tcp://host:8786"
    )
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Sweep each CASE."""
    if bool(options.vary) == bool(options.table):
        what = "No parameter is varied" if not options.vary else "Both --vary and --table are given"
        raise InputError(what, "option --vary", "write NAME=FIRST:LAST:COUNT, as in D=0.5:10:41, or name a --table")
    columns = columns_of(Path(options.table)) if options.table else None
    ranges = [varied(text) for text in options.vary or ()]
    if len({one.name for one in ranges}) < len(ranges):
        raise InputError("A parameter is varied twice", "option --vary", "give each once")
    return each_case(options, lambda case, say: work(options, case, ranges, columns, say), presets=True)


def columns_of(path: Path) -> dict[str, list[float]]:
    """The columns of a CSV file with a row of names. **Raises:** `InputError`."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [(n, row) for n, row in enumerate(csv.reader(file), 1) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = getattr(error, "strerror", None) or "it is not CSV text"
        raise InputError(f"Cannot read `{path}` ({why})", "option --table", "name a CSV file") from None
    if len(rows) < 2:
        remedy = "write a row of names and at least one of values"
        raise InputError(f"`{path}` has no rows of values", "option --table", remedy)
    names = [cell.strip() for cell in rows[0][1]]
    if not all(names) or len(set(names)) < len(names):
        raise InputError(
            "Column names are missing or repeated", at_line(path, rows[0][0]), "give each column its own name"
        )
    for n, row in rows[1:]:
        if len(row) != len(names):
            raise InputError(f"There are {len(row)} values for {len(names)} names", at_line(path, n), "correct the row")
    return {
        name: [finite(row[k], at_line(path, n), f"`{row[k]}`") for n, row in rows[1:]] for k, name in enumerate(names)
    }


def work(
    options: argparse.Namespace,
    subject: Any,
    ranges: Sequence[Varied],
    columns: Mapping[str, list[float]] | None,
    say: Progress,
) -> Outcome:
    """Sweep one case or preset over all combinations of `ranges`, or over the rows of the `columns` of a table."""
    import numpy as np

    from snakejax.dynamics.tyres import Rayleigh
    from snakejax.simulation.chunks import local_executor
    from snakejax.simulation.dask_executor import cluster
    from snakejax.simulation.parameter_sweep import grid, table
    from snakejax.simulation.rayleigh_match import polynomial
    from snakejax.vehicles.snakeboard.board import Board
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    clock = Stopwatch()
    preset = isinstance(subject, Preset)
    # Before a fit of some minutes: the cluster may not be reachable.
    executor = cluster(options.cluster) if options.cluster else local_executor
    run_ = None if preset else _run(options, subject)
    gait, times = (subject.gait, subject.times) if run_ is None else (run_.gait, run_.times)
    lines = {one.name: np.linspace(one.low, one.high, one.number) for one in ranges}
    model, axes = _prepared(options, subject, table(columns) if columns else grid(lines), say)
    if run_ is not None:
        # With a payload the yaw inertia is fixed; otherwise it follows from the varied mass and length.
        model = model.with_payload(run_.payload)
    matched = isinstance(model.board, Board) and not isinstance(model.tyre, Rayleigh) and model.constraint.slips
    what = f"sweeping {' and '.join(axes.coordinates)}"
    how = {
        "folder": options.out and Path(options.out) / "sweep-pieces",
        "executor": executor,
        "start": start_state(options.start) or (0.0, 0.0, 0.0),
        "progress": lambda event: say(event._replace(text=what)),
    }
    boards = _swept(model, gait, times, axes, matched, how)
    dims = list(axes.dims)
    curve = None
    if matched and dims == list(axes.coordinates) and len(dims) == 1:
        curve = polynomial(boards[dims[0]].values, boards.k_s.values)
    result = _result(options, subject.name, model, {} if preset else subject.sha256, axes, boards, curve)
    return _outcome(subject.name, {**result, "seconds": clock.seconds()}, axes, boards, curve, say)


def _swept(model: "Model", gait: "Gait", times: Any, axes: "Axes", matched: bool, how: Mapping[str, Any]) -> "Dataset":
    """The end pose of each board, and where `matched` the nearest Rayleigh board.

    **Raises:** `FitError` where no board reaches the end of its run.
    """
    import numpy as np

    from snakejax.core.errors import FitError
    from snakejax.simulation.parameter_sweep import sweep
    from snakejax.simulation.rayleigh_match import nearest_rayleigh

    if matched:
        boards = nearest_rayleigh(model, gait, times, axes, **how)
    else:
        boards = sweep(model, gait, times[-1:], axes, **how).isel(time=0, drop=True)
    if not np.isfinite(boards.x.values).any():
        raise FitError("No board reaches the end of its run: they are too stiff, or steered by 90 degrees")
    return boards


def _result(
    options: argparse.Namespace,
    name: str,
    model: "Model",
    sha256: Mapping[str, str],
    axes: "Axes",
    boards: "Dataset",
    curve: "Polynomial | None",
) -> dict[str, Any]:
    """The JSON of a sweep, without its seconds."""
    from snakejax.present.as_json.provenance import heading_json, provenance_json

    end = {"x_m": "x", "y_m": "y", "heading_rad": "heading"}
    matched = ("k_s", "mismatch") if "mismatch" in boards else ()
    return {
        **heading_json(name, model, None, provenance_json(options.seed, given(options), sha256)),
        "axes": list(axes.dims),
        "units": {name: boards[name].attrs["units"] for name in axes.coordinates},
        **{column: boards[column].values.tolist() for column in (*axes.coordinates, *matched)},
        "polynomial": curve and curve.coefficients,
        "r_squared": curve and curve.r_squared,
        "fitted_range": curve and curve.fitted_range,
        "end": {key: boards[column].values.tolist() for key, column in end.items()},
        "engine": boards.attrs["engine"],
    }


def _outcome(
    name: str, result: dict[str, Any], axes: "Axes", boards: "Dataset", curve: "Polynomial | None", say: Progress
) -> Outcome:
    """JSON, text and files of a sweep."""
    from snakejax.core.files import write_whole
    from snakejax.present.as_json.values import clean

    written = clean(result)

    def write(folder: Path) -> None:
        from snakejax.present import plot
        from snakejax.present.report import sweep_page

        say(ProgressEvent(Phase.DRAWING))
        write_whole(folder / "sweep.nc", bytes(boards.to_netcdf(engine="scipy")))
        write_whole(folder / "sweep.html", sweep_page(written))
        if "mismatch" in boards and (figure := plot.sweep(boards, curve, name)) is not None:
            plot.save(figure, folder, "sweep")

    return Outcome(written, _report(name, boards, curve, list(axes.coordinates)), write)


def _run(options: argparse.Namespace, case: Any) -> Any:
    """The run of `--run`. **Raises:** `InputError` where there is none, or where it is in motion and `--start` has no
    velocities."""
    names = [run_.name for run_ in case.runs]
    name = names[0] if options.gait is None else options.gait
    if name not in names:
        raise InputError(f"There is no run `{name}` in {case.name}", "option --run", instead_of(name, names))
    run_ = case.runs[names.index(name)]
    in_motion = len(start_state(options.start) or ()) > 3
    if run_.moving and not in_motion:
        what = f"Run `{name}` is already moving at its first sample"
        remedy = "name a run that starts at rest, or give the velocities too: --start X,Y,HEADING,U,W,R"
        raise InputError(what, "option --run", remedy)
    if in_motion and abs(first := float(run_.times[0])) > FIRST_SAMPLE:
        what = f"Run `{name}` begins at {first:g} s, but a sweep in motion begins at 0 s"
        raise InputError(what, "option --run", "name a run whose first sample is at 0 s")
    return run_


def _prepared(options: argparse.Namespace, subject: Any, axes: "Axes", say: Progress) -> "tuple[Model, Axes]":
    """The model, and the axes with parameters by their full names and coordinates as the user named them."""
    from snakejax.dynamics.model import Model
    from snakejax.dynamics.tyres import Bakker
    from snakejax.simulation.parameter_sweep import require_possible
    from snakejax.vehicles.snakeboard.paper_examples import LOADS, Preset, mass_under

    from ..requested_model import dotted, requested_model, require_given

    where = "option --table" if options.table else "option --vary"
    loading = [name for name in axes.columns if name in LOADING]
    if loading and not (isinstance(subject, Preset) and subject.name in LOADS):
        what = f"`{loading[0]}` can only be varied for {' and '.join(LOADS)}"
        raise InputError(what, where, "name one of those as CASE")
    model_request = model_options(options)
    requested = requested_model(subject, model_request)
    model = requested.model
    if isinstance(model.tyre, Bakker) and len(loading) < len(axes.columns):
        if loading:
            remedy = "vary load and camber, or the parameters of the tyre"
            raise InputError(f"`{loading[0]}` already determines the tyre", where, remedy)
        model = Model(model.board, model.tyre.coefficients(), model.constraint, model.effects)
    # Before a fit of some minutes: a varied parameter may not exist.
    columns = {f"tyre.{n}" if n in loading else dotted(model, n, where): c for n, c in axes.columns.items()}
    if isinstance(subject, Preset) or options.set or options.saved:
        filled = requested._replace(given=requested.given | {*columns})
        require_given(filled, isinstance(subject, Preset) and options.model is None, model_request)
    else:
        model = fitted(options, subject, say)[0].model
    if len(columns) < len(axes.columns):
        raise InputError("A parameter is named twice", where, "give each once")
    axes = axes._replace(columns=columns)
    if "load" in loading:
        axes = axes.moving("board.mass", mass_under(columns["tyre.load"]))
    try:
        require_possible(model, axes)
    except ValueError as error:
        raise InputError(str(error).rstrip("."), where, "keep to values inside its domain") from None
    return model, axes


def _report(title: str, boards: Any, curve: Any, names: list[str]) -> Any:
    import numpy as np
    from rich.console import Group
    from rich.text import Text

    from snakejax.present.as_text.tables import add_row, plain_table, with_unit
    from snakejax.simulation.rayleigh_match import FEWEST

    matched = "mismatch" in boards
    heads = [
        *(with_unit(name, boards[name].attrs["units"]) for name in names),
        *(["k_s [N s/m]", "mismatch"] if matched else ["x [m]", "y [m]", "heading [rad]"]),
    ]
    table = plain_table(*heads, right=tuple(heads))
    flat = boards.stack(board=boards.dims) if len(boards.dims) > 1 else boards
    count = flat[next(iter(flat.data_vars))].size
    for k in np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int)):
        cells = [f"{float(flat[name].values[k]):.4g}" for name in names]
        if matched:
            k_s, mismatch = float(flat.k_s.values[k]), float(flat.mismatch.values[k])
            no_value = "none fits" if np.isfinite(flat.x.values[k]) else "too stiff"
            cells += [f"{k_s:.4g}" if np.isfinite(k_s) else no_value]
            cells += [f"{100 * mismatch:.2g} %" if np.isfinite(mismatch) else "-"]
        else:
            cells += [f"{float(flat[name].values[k]):.4g}" for name in ("x", "y", "heading")]
        add_row(table, *cells)
    lines: list[Any] = [Text(title, style="bold"), table]
    if count > SHOWN:
        lines.append(Text(f"{SHOWN} of {count} boards; all are in the JSON, and with --out in sweep.nc."))
    lines.append(Text(boards.attrs["engine"]))
    if matched:
        lines.append(Text("mismatch: root mean square distance of both paths, as a share of the length of the path"))
    if curve is not None:
        (low, high), name = curve.fitted_range, names[0]
        powers = [f" {name}^4", f" {name}^3", f" {name}^2", f" {name}", ""]
        terms = " ".join(f"{c:+.4g}{power}" for power, c in zip(powers, curve.coefficients, strict=True))
        r_squared = "k_s is constant" if curve.r_squared is None else f"R^2 = {curve.r_squared:.5f}"
        lines.append(Text(f"k_s = {terms}, {name} from {low:.4g} to {high:.4g}, {r_squared}"))
    elif matched and len(boards.dims) == 1:
        lines.append(Text(f"No polynomial: it needs a k_s at {FEWEST} values in a row."))
    return Group(*lines)
