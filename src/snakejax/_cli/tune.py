"""`snakejax tune`: a better gait by gradient."""

import argparse
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError, instead_of
from ._options import add_cases, add_command, add_loading, add_model, assignments, finite, given, start_pose
from ._setup import Clock, Outcome, Say, each_case
from .fit import fitted

if TYPE_CHECKING:
    from .._gait import Gait
    from .._model import Model
    from .._objective import Objective
    from .._tune import Tuned

OBJECTIVES = (
    "distance",
    "turn",
    "reach:X,Y,HEADING",
    "effort:DISTANCE",
    "separate:EFFECT,EFFECT",
    "information",
    "FILE.py:function",
)
OVER = ("fit", "mean", "worst")
DRAWS = 12
"""Draws from a fit over which a gait is tuned, and its spread shown."""


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "tune",
        run,
        "a better gait by gradient",
        "Find the gait that does best within the limits of the joints, by the gradient of the\n"
        "simulation. The board starts at rest at --start at time 0. Without --set or --from a\n"
        "case is fitted first; where its fit leaves something open, the gait is tuned over\n"
        "draws from it. With --out the gait is written as case.toml takes it.",
        "snakejax tune data/level-board --objective reach:0.5,0.3,1 --seconds 20 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_loading(command)
    command.add_argument(
        "--objective",
        metavar="WHAT",
        default="distance",
        help="distance (default), turn, reach:X,Y,HEADING, effort:DISTANCE (the least for it), FILE.py:function (of"
        " times, pose and effort, to be made small), separate:EFFECT,EFFECT (the run that tells which of two acts;"
        " separate alone: the most confusable two) or information (the run that says most about the tyre)",
    )
    command.add_argument("--seconds", metavar="T", help="how long the run lasts [s] (default that of the first run)")
    command.add_argument(
        "--limit",
        metavar="phi=0.9,psi_rate=6.5",
        action="append",
        help="limits of the joints [rad, rad/s, rad/s^2]: phi, psi, phi_rate, psi_rate, phi_acceleration,"
        " psi_acceleration (default what the gaits of CASE reach in angle and rate)",
    )
    command.add_argument("--start", metavar="X,Y,HEADING", help="where the board starts [m, m, rad] (default 0,0,0)")
    command.add_argument(
        "--over",
        choices=OVER,
        help="tune for the fit itself, or for the mean or worst of draws from it (default fit, and mean where the fit"
        " leaves a parameter open)",
    )


def run(options: argparse.Namespace) -> int:
    """Tune each CASE."""
    seconds = None if options.seconds is None else finite(options.seconds, "option --seconds", f"`{options.seconds}`")
    limit = assignments(",".join(options.limit or ()), "option --limit")
    start = start_pose(options.start) or (0.0, 0.0, 0.0)
    return each_case(options, lambda case, say: work(options, case, seconds, limit, start, say), presets=True)


def objective(text: str) -> "Objective":
    """The objective that `--objective` names. **Raises:** `InputError`."""
    from .._objective import Distance, Effort, Own, Reach, Turn

    where = "option --objective"
    kind, _, rest = text.partition(":")
    if text in ("distance", "turn"):
        return Distance() if text == "distance" else Turn()
    if kind == "reach":
        parts = rest.split(",")
        if len(parts) != 3:
            raise InputError(f"`{text}` is no pose", where, "write reach:x,y,heading in m and rad")
        return Reach(*(finite(part, where, f"`{text}`") for part in parts))
    if kind == "effort":
        distance = finite(rest, where, f"`{text}`")
        if not distance > 0:
            raise InputError(f"A distance of {distance:g} m is none", where, "give one above 0, as in effort:0.5")
        return Effort(distance)
    if kind.endswith(".py"):
        return Own(_function(Path(kind), rest))
    raise InputError(f"There is no objective `{text}`", where, instead_of(text, OBJECTIVES))


def _function(path: Path, name: str) -> Callable:
    where = "option --objective"
    if not path.is_file():
        raise InputError(f"There is no file `{path}`", where, "name a Python file, as in my.py:cost")
    description = importlib.util.spec_from_file_location(f"_snakejax_objective_{path.stem}", path)
    assert description is not None and description.loader is not None
    module = importlib.util.module_from_spec(description)
    try:
        description.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"It cannot be run ({type(error).__name__}: {error})", str(path), "mend it") from None
    found = getattr(module, name, None)
    if not callable(found):
        there = [n for n, part in vars(module).items() if callable(part) and not n.startswith("_")]
        raise InputError(f"`{path}` has no function `{name}`", where, instead_of(name, there))
    return found


def work(
    options: argparse.Namespace,
    subject: Any,
    seconds: float | None,
    limit: dict[str, float],
    start: tuple[float, float, float],
    say: Say,
) -> Outcome:
    """Tune one case or preset."""
    if options.objective.partition(":")[0] in ("separate", "information"):
        from .separate import work as design

        return design(options, subject, seconds, limit, start, say)
    from .._fit import FitError
    from .._json import clean, heading_json, provenance_json, write_whole
    from .._limits import Limits, reached_by
    from .._presets import Preset
    from .._ran import Driver
    from .._tune import tune

    clock = Clock()
    wanted = objective(options.objective)
    preset = isinstance(subject, Preset)
    gaits, length = gaits_of(subject)
    seconds = length if seconds is None else seconds
    models, over = boards(options, subject, say)
    limits = Limits.of(limit, reached_by(gaits, models[0], length) if gaits else None)
    try:
        found = tune(
            models[0] if over == "fit" else models,
            wanted,
            limits,
            seconds,
            driver=Driver.of(gaits[0]) if gaits else Driver(),
            given=[gait for gait in gaits if gait.phi_back is None],
            start=start,
            over="worst" if over == "worst" else "mean",
            seed=options.seed,
            others=models[1:] if over == "fit" else (),
            progress=lambda done, total: say("tuning", done, total),
        )
    except RuntimeError as error:
        raise FitError(str(error)) from None
    provenance = provenance_json(options.seed, given(options), {} if preset else subject.sha256)
    result = {
        **heading_json(subject.name, models[0], None, provenance),
        **tuned_json(found, options.objective, over),
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot, plot_tune

        say("drawing")
        write_whole(folder / "gait.toml", toml(found, subject.name, options.objective))
        plot.save(plot_tune.tuned(result), folder, "tune")

    return Outcome(clean(result), report(subject.name, options.objective, found, over), write)


def gaits_of(subject: Any) -> "tuple[list[Gait], float]":
    """The gaits that are known already, of the runs from rest, and how long the first run lasts [s]."""
    from .._presets import Preset

    if isinstance(subject, Preset):
        return [subject.gait], subject.duration
    return [run_.gait for run_ in subject.runs if not run_.moving], float(subject.runs[0].times[-1])


def boards(options: argparse.Namespace, subject: Any, say: Say) -> "tuple[list[Model], str]":
    """The board, then draws from its fit where there is one; and what the gait is tuned for."""
    from .._draws import draws
    from .._presets import Preset
    from ._models import require_given, wanted_model

    wanted = wanted_model(options, subject)
    if isinstance(subject, Preset) or options.set or options.saved:
        require_given(options, wanted, own=isinstance(subject, Preset) and options.model is None)
        if options.over in ("mean", "worst"):
            what = "There are no draws from a board whose parameters are given"
            raise InputError(what, "option --over", "leave it out, or let a case be fitted")
        return [wanted.model], "fit"
    found, _ = fitted(options, subject, say)
    open_ = [name for name, e in found.estimates.items() if not e.determined]
    over = options.over or ("mean" if open_ else "fit")
    drawn = draws(found, DRAWS, options.seed, lambda done, total: say("drawing from the fit", done, total))
    return [found.model, *drawn], over


def tuned_json(found: "Tuned", asked: str, over: str) -> dict[str, Any]:
    """A tuned gait as JSON."""
    import math

    return {
        "gait": found.terms(),
        "objective": found.after.result,
        "start": list(found.start),
        "limits": {name: value for name, value in found.limits.named().items() if math.isfinite(value)},
        "asked": asked,
        "duration_s": found.seconds,
        "met": found.met,
        "reached": found.reached,
        "over": over,
        "before": found.before and journey_json(found.before),
        "after": journey_json(found.after),
        "spread": found.spread,
        "simulations": {"all": found.simulations, "with_derivative": found.slopes},
    }


def journey_json(journey: Any) -> dict[str, Any]:
    """A gait, what it achieves, and its path with the angles of the joints, 25 times a second."""
    import jax
    import numpy as np

    from .._limits import told
    from .._tune import sines

    times = np.asarray(journey.run.times)[::4]
    pose = np.asarray(journey.run.pose)[::4]
    joints = {n: np.asarray(jax.vmap(getattr(journey.gait, n).at)(times).angle) for n in ("phi", "psi")}
    try:
        gait = {name: sines(told(getattr(journey.gait, name))) for name in ("phi", "psi")}
    except ValueError:
        gait = None
    path = {"t": times, "x": pose[:, 0], "y": pose[:, 1], "heading": pose[:, 2], **joints}
    return {
        "gait": gait,
        "objective": journey.result,
        "effort_n2m2s": float(journey.run.effort),
        "path": {name: np.round(values, 7).tolist() for name, values in path.items()},
    }


def toml(found: "Tuned", name: str, asked: str) -> str:
    """The gait as two lines of a run in `case.toml`."""
    terms = found.terms()
    head = f"# {name}, {asked}: a gait tuned for {found.seconds:g} s from rest"
    return "\n".join([head, *(f"{joint} = {terms[joint]}" for joint in terms)]) + "\n"


def report(name: str, asked: str, found: "Tuned", over: str) -> Any:
    """What is said of a tuned gait."""
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, indented, plain_table

    lines: list[Any] = [Text(name, style="bold"), Text(f"{asked} in {found.seconds:g} s, {_tuned_for(over)}")]
    table = plain_table("gait", *(keys := list(_named(asked, found.after.result))), right=tuple(keys))
    if found.before is not None:
        add_row(table, "best known, within the limits", *_named(asked, found.before.result).values())
    add_row(table, "tuned", *_named(asked, found.after.result).values())
    lines += [Text(), indented(table)]
    if found.spread:
        lines.append(Text(f"over draws from the fit: {_spread(asked, found.spread)}"))
    lines += [gait_table(found), Text(limits_line(found))]
    if not found.met:
        lines.append(Text("! No gait was found that gets there: allow more time or wider limits.", style="yellow"))
    lines.append(Text(f"{found.simulations} simulations, {found.slopes} of them with their derivative"))
    return Group(*lines)


def gait_table(found: "Tuned") -> Any:
    """The terms of a gait."""
    from .._text import add_row, indented, plain_table

    gait = plain_table("joint", "amplitude\n[rad]", "frequency\n[rad/s]", "phase\n[rad]")
    for joint, terms in found.terms().items():
        for term in terms:
            add_row(gait, joint, *(f"{number:.5f}" for number in term))
    return indented(gait)


def _tuned_for(over: str) -> str:
    return "tuned for the board as it is" if over == "fit" else f"tuned for the {over} of draws from the fit"


UNITS = {"distance": ("distance [m]", 1.0), "turn": ("turn [rad]", 1.0)}


def _named(asked: str, result: Any) -> dict[str, str]:
    if isinstance(result, dict):
        return {key.replace("_", " "): f"{value:.4g}" for key, value in result.items()}
    return {UNITS.get(asked, ("cost", 1.0))[0]: f"{result:.4f}"}


def _spread(asked: str, spread: list[Any]) -> str:
    import numpy as np

    if isinstance(spread[0], dict):
        return ", ".join(f"{key.replace('_', ' ')} up to {max(one[key] for one in spread):.3g}" for key in spread[0])
    return f"mean {np.mean(spread):.4f}, from {min(spread):.4f} to {max(spread):.4f}"


def limits_line(found: "Tuned") -> str:
    """How near a gait comes to its limits."""
    import math

    parts = [
        f"{name} {found.reached[name]:.4g} of {most:.4g}"
        for name, most in found.limits.named().items()
        if math.isfinite(most)
    ]
    return "at most, command and joint: " + ", ".join(parts)
