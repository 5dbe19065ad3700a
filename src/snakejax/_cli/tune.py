"""`snakejax tune`: a better gait by gradient."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError, instead_of
from ._options import add_cases, add_command, add_loading, add_model, assignments, finite, given, start_pose
from ._own import own_module
from ._progress import Say
from ._setup import Clock, Outcome, each_case
from .fit import fitted

if TYPE_CHECKING:
    from .._gait import Gait
    from .._model import Model
    from .._objective import Objective

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
    command.add_argument(
        "--payload",
        metavar="KG[,KGM2]",
        help="what the board carries: mass [kg] and yaw inertia [kg m^2] (default as the first run)",
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
    payload = payload_of(options.payload)
    return each_case(options, lambda case, say: work(options, case, seconds, limit, start, payload, say), presets=True)


def payload_of(text: str | None) -> tuple[float, float] | None:
    """`KG` or `KG,KGM2`. **Raises:** `InputError`."""
    if text is None:
        return None
    where = "option --payload"
    parts = [finite(part, where, f"`{text}`") for part in text.split(",")]
    if len(parts) > 2 or min(parts) < 0:
        raise InputError(f"`{text}` is no payload", where, "write mass in kg and yaw inertia in kg m^2, as in 2,0.01")
    return parts[0], parts[1] if len(parts) == 2 else 0.0


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
    module = own_module(path, where, "my.py:cost")
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
    payload: tuple[float, float] | None,
    say: Say,
) -> Outcome:
    """Tune one case or preset."""
    if options.objective.partition(":")[0] in ("separate", "information"):
        from .separate import work as design

        return design(options, subject, seconds, limit, start, payload, say)
    from .._errors import FitError
    from .._files import write_whole
    from .._json import clean
    from .._limits import Limits, reached_by
    from .._presets import Preset
    from .._provenance import heading_json, provenance_json
    from .._ran import Driver
    from .._tune import tune
    from .._tuned import report, toml, tuned_json

    clock = Clock()
    wanted = objective(options.objective)
    preset = isinstance(subject, Preset)
    gaits, length = gaits_of(subject)
    seconds = length if seconds is None else seconds
    bare, over = boards(options, subject, say)
    payload, carrying = carried(payload, subject)
    models = [model.carrying(payload) for model in bare]
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
        **payload_json(payload),
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot
        from ..report import tune_page

        say("drawing")
        write_whole(folder / "gait.toml", toml(found, subject.name, options.objective))
        write_whole(folder / "tune.html", tune_page(clean(result)))
        plot.save(plot.tuned(result), folder, "tune")

    return Outcome(clean(result), report(subject.name, options.objective, found, over, carrying), write)


def carried(payload: tuple[float, float] | None, subject: Any) -> tuple[tuple[float, float], str]:
    """The payload asked for, or else that of the first run; and what is said of it where any is carried."""
    from .._presets import Preset

    runs = () if isinstance(subject, Preset) else subject.runs
    each = [(float(run_.payload[0]), float(run_.payload[1])) for run_ in runs]
    mass, inertia = (each[0] if each else (0.0, 0.0)) if payload is None else payload
    said = f", carrying {mass:g} kg and {inertia:g} kg m^2" if mass or inertia else ", carrying nothing"
    as_run = f" as in {runs[0].name}" if payload is None and runs else ""
    return (mass, inertia), f"{said}{as_run}" if any(any(one) for one in [*each, (mass, inertia)]) else ""


def payload_json(payload: tuple[float, float]) -> dict[str, Any]:
    """What the board carries, as JSON."""
    return {"payload": {"mass_kg": payload[0], "inertia_kgm2": payload[1]}}


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
