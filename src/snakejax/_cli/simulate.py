"""`snakejax simulate`: what a model says of the runs of a case, or of an example of the paper."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ._films import add_films, films, require_films
from ._options import add_cases, add_command, add_loading, add_model, given, start_pose
from ._progress import Say
from ._setup import Clock, Outcome, each_case
from .fit import fitted

COLUMNS = "time_s,x_m,y_m,heading_rad"


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "simulate",
        run,
        "write what a model says of the runs of a case",
        "Simulate the runs of a case, or an example of the paper.\nWithout --set or --from a case is fitted first.",
        "snakejax simulate paper-rotate --model rayleigh --set k_s=9 --csv out",
    )
    add_cases(command, presets=True)
    add_model(command)
    command.add_argument(
        "--start",
        metavar="X,Y,HEADING",
        help="start pose in m and rad (default: estimated, or the origin for a preset)",
    )
    command.add_argument("--csv", metavar="DIR", help="write RUN.csv there for each run: " + COLUMNS.replace(",", ", "))
    add_loading(command)
    add_films(command)


def run(options: argparse.Namespace) -> int:
    """Simulate each CASE."""
    start_pose(options.start)
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say), presets=True)


def work(options: argparse.Namespace, subject: Any, say: Say) -> Outcome:
    """Simulate one case or preset."""
    import numpy as np

    from .._files import write_whole
    from .._json import all_parameters_json, clean, effects_json, misfit_json, parameters_json, rmse_json, run_json
    from .._presets import Preset
    from .._provenance import heading_json, provenance_json
    from .._replay import replay

    clock = Clock()
    if isinstance(subject, Preset):
        model, runs, starts, noise, scores, estimates = _of_preset(options, subject)
    else:
        model, runs, starts, noise, scores, estimates = _of_case(options, subject, say)
    say("simulating")
    poses = replay(model, runs, np.asarray(starts))
    for run_, pose in zip(runs, poses, strict=True):
        if options.csv is not None:
            folder = Path(options.csv) / subject.name if len(options.cases) > 1 else Path(options.csv)
            write_whole(folder / f"{run_.name}.csv", csv_text(np.asarray(run_.times), pose))
    by_run = {score.run: score for score in scores}
    parts = all_parameters_json(model, estimates)
    pools = [_pooled([s for s in scores if s.role == role]) for role in ("train", "heldout")]
    sha256 = {} if isinstance(subject, Preset) else subject.sha256
    rows = [
        {
            **({"run": run_.name, "role": run_.role} if run_.name not in by_run else run_json(by_run[run_.name])),
            **_journey(np.asarray(run_.times), pose),
        }
        for run_, pose in zip(runs, poses, strict=True)
    ]
    result = {
        **heading_json(subject.name, model, noise, provenance_json(options.seed, given(options), sha256)),
        "base": {
            "parameters": parameters_json(parts),
            "effects": effects_json(parts, model),
            "misfit": misfit_json(*pools),
            "rmse": rmse_json(*pools),
        },
        "runs": rows,
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot
        from .._played import played_model

        say("drawing")
        played = played_model(model, runs, np.asarray(starts))
        plot.save(plot.paths([played]), folder, "paths")
        films(options, played, model.board, folder, say)

    return Outcome(clean(result), _report(subject.name, result), write)


def _of_preset(options: argparse.Namespace, subject: Any) -> tuple:
    import jax.numpy as jnp
    import numpy as np

    from .._recording import Run
    from ._models import require_given, wanted_model

    wanted = wanted_model(options, subject)
    require_given(options, wanted, own=options.model is None)
    run_ = Run(subject.name, "preset", subject.times, jnp.full((subject.times.shape[0], 3), jnp.nan), subject.gait)
    return wanted.model, (run_,), np.array([start_pose(options.start) or (0.0, 0.0, 0.0)]), None, (), {}


def _of_case(options: argparse.Namespace, case: Any, say: Say) -> tuple:
    from .._misfit import run_scores
    from .._replay import fitted_starts, starts_of
    from .._study import Study
    from ..quality import noise_of
    from ._models import require_given, wanted_model

    pose = start_pose(options.start)
    wanted = wanted_model(options, case)
    if not (options.set or options.saved):
        require_given(options, wanted, own=True)
        found, noise = fitted(options, case, say)
        if pose is not None:
            return found.model, case.runs, starts_of(case.runs, pose), noise, (), found.estimates
        return found.model, case.runs, fitted_starts(found), noise, (*found.runs, *found.heldout), found.estimates
    require_given(options, wanted, own=False)
    if pose is not None:
        return wanted.model, case.runs, starts_of(case.runs, pose), case.noise, (), {}
    say("estimating where the runs start")
    noise = noise_of(case)
    study = Study.of(wanted.model, case.runs, noise, (), 1)
    optimum = study.fit({}, (), range(len(case.runs)))
    scores = run_scores(study, optimum, range(len(case.runs)))
    return wanted.model, case.runs, optimum.start, noise, scores, {}


def _pooled(scores: Sequence[Any]) -> Any:
    from .._misfit import pooled

    return pooled(scores) if scores else None


def _journey(times: Any, pose: Any) -> dict[str, Any]:
    """Where a run ends and how far it goes."""
    import numpy as np

    x, y, heading = (float(part) for part in pose[-1])
    return {
        "start": {"x_m": float(pose[0, 0]), "y_m": float(pose[0, 1]), "heading_rad": float(pose[0, 2])},
        "end": {"x_m": x, "y_m": y, "heading_rad": heading},
        "duration_s": float(times[-1]),
        "path_m": float(np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1).sum()),
        "distance_m": float(np.hypot(*(pose[-1, :2] - pose[0, :2]))),
        "turn_rad": float(pose[-1, 2] - pose[0, 2]),
    }


def csv_text(times: Any, pose: Any) -> str:
    """A simulated run as CSV, heading unwrapped."""
    rows = (f"{t:.6g},{x:.9g},{y:.9g},{h:.9g}" for t, (x, y, h) in zip(times, pose, strict=True))
    return "\n".join([COLUMNS, *rows]) + "\n"


def _report(name: str, result: dict[str, Any]) -> Any:
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, indented, misfit_text, plain_table

    right = ("lasts\n[s]", "path\n[m]", "distance\n[m]", "turn\n[rad]", "misfit\n[noise]")
    table = plain_table("run", *right, right=right)
    for row in result["runs"]:
        numbers = (f"{row[key]:.4g}" for key in ("duration_s", "path_m", "distance_m", "turn_rad"))
        add_row(table, row["run"], *numbers, misfit_text(row.get("misfit")))
    values = [
        f"{key} = {part['value']:.4g} {part['unit']}".removesuffix(" -")
        for parts in (result["base"]["parameters"], *result["base"]["effects"].values())
        for key, part in parts.items()
    ]
    return Group(
        Text(name, style="bold"),
        Text(f"model {result['model']}, skid {result['skid']}"),
        Text(", ".join(values)),
        Text(),
        indented(table),
    )
