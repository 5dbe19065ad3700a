"""`snakejax sweep`: parameters of a board, and the Rayleigh coefficient k_s that comes nearest to each value."""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError, at_line, instead_of
from ._options import Varied, add_cases, add_command, add_loading, add_model, finite, given, start_pose, varied
from ._progress import Say
from ._setup import Clock, Outcome, each_case
from .fit import fitted

if TYPE_CHECKING:
    from .._model import Model
    from .._sweep import Axes

LOADING = ("load", "camber")
"""What can be varied on the paper's gaits beside the parameters of a model."""
SHOWN = 21


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "sweep",
        run,
        "parameters against the Rayleigh coefficient k_s",
        "Vary one parameter of a board, find for each value the Rayleigh board that follows it\n"
        "best, and fit k_s as a polynomial of order 4; or vary several, every combination of\n"
        "them. A Rayleigh or ideal board is followed by none: its sweep says where it ends.\n"
        "Without --set or --from a case is fitted first. With --out the results are kept as they\n"
        "come, and a sweep that was stopped goes on from there.",
        "snakejax sweep paper-rotate --vary D=0.5:10:41 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_loading(command)
    command.add_argument(
        "--vary",
        metavar="D=0.5:10:41",
        action="append",
        help="a parameter, its first and last value, and how many. May be repeated",
    )
    command.add_argument(
        "--table", metavar="FILE.csv", help="in place of --vary: a column for each parameter, a row for each board"
    )
    command.add_argument("--start", metavar="X,Y,HEADING", help="where the boards start [m, m, rad] (default 0,0,0)")
    command.add_argument("--run", metavar="RUN", dest="gait", help="the run whose gait it follows (default the first)")
    command.add_argument(
        "--cluster", metavar="ADDRESS", help="compute on the Dask cluster of the scheduler there, as in tcp://host:8786"
    )


def run(options: argparse.Namespace) -> int:
    """Sweep each CASE."""
    if bool(options.vary) == bool(options.table):
        what = "Nothing says what to vary" if not options.vary else "Both --vary and --table are given"
        raise InputError(what, "option --vary", "write NAME=FIRST:LAST:COUNT, as in D=0.5:10:41, or name a --table")
    asked = columns_of(Path(options.table)) if options.table else None
    wanted = [varied(text) for text in options.vary or ()]
    if len({one.name for one in wanted}) < len(wanted):
        raise InputError("A parameter is varied twice", "option --vary", "give each once")
    return each_case(options, lambda case, say: work(options, case, wanted, asked, say), presets=True)


def columns_of(path: Path) -> dict[str, list[float]]:
    """The columns of a CSV file with a row of names. **Raises:** `InputError`."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [(n, row) for n, row in enumerate(csv.reader(file), 1) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = getattr(error, "strerror", None) or "it is no CSV text"
        raise InputError(f"Cannot read `{path}` ({why})", "option --table", "name a CSV file") from None
    if len(rows) < 2:
        remedy = "write a row of names and at least one of values"
        raise InputError(f"`{path}` has no boards", "option --table", remedy)
    names = [cell.strip() for cell in rows[0][1]]
    if not all(names) or len(set(names)) < len(names):
        raise InputError("A column has no name, or that of another", at_line(path, rows[0][0]), "name each once")
    for n, row in rows[1:]:
        if len(row) != len(names):
            raise InputError(f"There are {len(row)} values for {len(names)} names", at_line(path, n), "mend the row")
    return {
        name: [finite(row[k], at_line(path, n), f"`{row[k]}`") for n, row in rows[1:]] for k, name in enumerate(names)
    }


def work(
    options: argparse.Namespace,
    subject: Any,
    wanted: Sequence[Varied],
    asked: Mapping[str, list[float]] | None,
    say: Say,
) -> Outcome:
    """Sweep one case or preset over the combinations `wanted`, or the columns `asked` of a table."""
    import numpy as np

    from .._cluster import cluster
    from .._errors import FitError
    from .._files import write_whole
    from .._json import clean
    from .._pieces import local
    from .._presets import Preset
    from .._provenance import heading_json, provenance_json
    from .._rayleigh import nearest_rayleigh, polynomial
    from .._skid import Ideal
    from .._sweep import grid, sweep, table
    from .._tyre import Rayleigh

    clock = Clock()
    preset = isinstance(subject, Preset)
    start = start_pose(options.start) or (0.0, 0.0, 0.0)
    executor = cluster(options.cluster) if options.cluster else local
    run_ = None if preset else _run(options, subject)
    gait, times = (subject.gait, subject.times) if run_ is None else (run_.gait, run_.times)
    lines = {one.name: np.linspace(one.low, one.high, one.count) for one in wanted}
    axes = table(asked) if asked else grid(lines)
    model, axes = _prepared(options, subject, axes, say)
    if run_ is not None:
        # A payload fixes the yaw inertia, which otherwise follows mass and length as they are varied.
        model = model.carrying(run_.payload)
    what = f"sweeping {' and '.join(axes.coordinates)}"
    how = {
        "folder": options.out and Path(options.out) / "pieces",
        "executor": executor,
        "start": start,
        "progress": lambda done, total: say(what, done, total),
    }
    alone = isinstance(model.tyre, Rayleigh) or isinstance(model.skid, Ideal)
    curve = None
    if alone:
        found = sweep(model, gait, times[-1:], axes, **how).isel(time=0, drop=True)
    else:
        found = nearest_rayleigh(model, gait, times, axes, **how)
    if not np.isfinite(found.x.values).any():
        raise FitError("None of the boards gets to the end of its run: they are too stiff, or steered by 90 degrees")
    dims = list(axes.dims)
    if not alone and dims == list(axes.coordinates) and len(dims) == 1:
        curve = polynomial(found[dims[0]].values, found.k_s.values)
    provenance = provenance_json(options.seed, given(options), {} if preset else subject.sha256)
    ends = {"x_m": "x", "y_m": "y", "heading_rad": "heading"}
    result = {
        **heading_json(subject.name, model, None, provenance),
        "axes": dims,
        **{name: found[name].values.tolist() for name in axes.coordinates},
        **({} if alone else {"k_s": found.k_s.values.tolist(), "mismatch": found.mismatch.values.tolist()}),
        "polynomial": curve and curve.coefficients,
        "r_squared": curve and curve.r_squared,
        "fitted_range": curve and curve.fitted_range,
        "end": {key: found[name].values.tolist() for key, name in ends.items()},
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot
        from ..report import sweep_page

        say("drawing")
        write_whole(folder / "sweep.nc", bytes(found.to_netcdf(engine="scipy")))
        write_whole(folder / "sweep.html", sweep_page(written))
        if not alone and (figure := plot.sweep(found, curve, subject.name)) is not None:
            plot.save(figure, folder, "sweep")

    written = clean(result)
    return Outcome(written, _report(subject.name, found, curve, list(axes.coordinates)), write)


def _run(options: argparse.Namespace, case: Any) -> Any:
    """The run asked for. **Raises:** `InputError` for one that is not there, or was under way at its first sample."""
    names = [run_.name for run_ in case.runs]
    name = names[0] if options.gait is None else options.gait
    if name not in names:
        raise InputError(f"There is no run `{name}` in {case.name}", "option --run", instead_of(name, names))
    found = case.runs[names.index(name)]
    if found.moving:
        what = f"Run `{name}` was under way at its first sample, and boards start at rest here"
        raise InputError(what, "option --run", "name a run from rest")
    return found


def _prepared(options: argparse.Namespace, subject: Any, axes: "Axes", say: Say) -> "tuple[Model, Axes]":
    """The model, and the boards with the parameters by their full names and the coordinates as the user named them."""
    from .._model import Model
    from .._presets import LOADS, Preset, mass_under
    from .._sweep import require_possible
    from .._tyre import Bakker
    from ._models import dotted, require_given, wanted_model

    where = "option --table" if options.table else "option --vary"
    loading = [name for name in axes.columns if name in LOADING]
    if loading and not (isinstance(subject, Preset) and subject.name in LOADS):
        what = f"`{loading[0]}` is varied on {' and '.join(LOADS)} alone"
        raise InputError(what, where, "name one of those as CASE")
    wanted = wanted_model(options, subject)
    model = wanted.model
    if isinstance(model.tyre, Bakker) and len(loading) < len(axes.columns):
        if loading:
            remedy = "vary load and camber, or the parameters of the tyre"
            raise InputError(f"`{loading[0]}` already says what the tyre is", where, remedy)
        model = Model(model.board, model.tyre.coefficients(), model.skid, model.effects)
    # Before a fit of some minutes: what is varied may not be there.
    columns = {f"tyre.{n}" if n in loading else dotted(model, n, where): c for n, c in axes.columns.items()}
    if isinstance(subject, Preset) or options.set or options.saved:
        filled = wanted._replace(given=wanted.given | {*columns})
        require_given(options, filled, own=isinstance(subject, Preset) and options.model is None)
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


def _report(title: str, found: Any, curve: Any, names: list[str]) -> Any:
    import numpy as np
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, plain_table

    followed = "mismatch" in found
    heads = [*names, *(["k_s [N s/m]", "mismatch"] if followed else ["x [m]", "y [m]", "heading [rad]"])]
    table = plain_table(*heads, right=tuple(heads))
    flat = found.stack(board=found.dims) if len(found.dims) > 1 else found
    count = flat[next(iter(flat.data_vars))].size
    for k in np.unique(np.linspace(0, count - 1, min(count, SHOWN)).round().astype(int)):
        cells = [f"{float(flat[name].values[k]):.4g}" for name in names]
        if followed:
            k_s, mismatch = float(flat.k_s.values[k]), float(flat.mismatch.values[k])
            none = "none fits" if np.isfinite(flat.x.values[k]) else "too stiff"
            cells += [f"{k_s:.4g}" if np.isfinite(k_s) else none]
            cells += [f"{100 * mismatch:.2g} %" if np.isfinite(mismatch) else "-"]
        else:
            cells += [f"{float(flat[name].values[k]):.4g}" for name in ("x", "y", "heading")]
        add_row(table, *cells)
    lines: list[Any] = [Text(title, style="bold"), table]
    if count > SHOWN:
        lines.append(Text(f"{SHOWN} of {count} boards; all are in the JSON, and with --out in sweep.nc."))
    if curve is not None:
        (low, high), name = curve.fitted_range, names[0]
        powers = [f" {name}^4", f" {name}^3", f" {name}^2", f" {name}", ""]
        terms = " ".join(f"{c:+.4g}{power}" for power, c in zip(powers, curve.coefficients, strict=True))
        r_squared = "k_s does not change" if curve.r_squared is None else f"R^2 = {curve.r_squared:.5f}"
        lines.append(Text(f"k_s = {terms}, {name} from {low:.4g} to {high:.4g}, {r_squared}"))
    elif followed and len(found.dims) == 1:
        lines.append(Text("Too few values have a k_s for a polynomial."))
    return Group(*lines)
