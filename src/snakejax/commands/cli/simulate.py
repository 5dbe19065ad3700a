"""`snakejax simulate`: simulate the runs of a case, or an example of the paper."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from snakejax.core.progress import Phase, Progress, ProgressEvent

from .animation import add_films, films, require_films
from .fit_pipeline import fitted
from .options import add_cases, add_command, add_loading, add_model, add_output, given, model_options, start_pose
from .pipeline import Outcome, Stopwatch, each_case

if TYPE_CHECKING:
    from snakejax.dynamics.model import Model
    from snakejax.estimation.fit_record import Fit
    from snakejax.estimation.goodness_of_fit import RunScore
    from snakejax.recording.run import Noise, Run


COLUMNS = "time_s,x_m,y_m,heading_rad"


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "simulate",
        run,
        "simulate the runs of a case",
        "Simulate the runs of a case, or an example of the paper.\nWithout --set or --from the case is fitted first.",
        "snakejax simulate paper-rotate --model rayleigh --set k_s=9 --csv out",
    )
    add_cases(command, presets=True)
    add_model(command)
    command.add_argument(
        "--start",
        metavar="X,Y,HEADING",
        help="start pose in m and rad (default: estimated, or the origin for a preset)",
    )
    command.add_argument(
        "--csv", metavar="DIR", help="write RUN.csv into DIR for each run: " + COLUMNS.replace(",", ", ")
    )
    add_loading(command)
    add_output(command)
    add_films(command)


def run(options: argparse.Namespace) -> int:
    """Simulate each CASE."""
    start_pose(options.start)
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say), presets=True)


class Simulation(NamedTuple):
    """What is simulated: `runs` of `model` from `starts` (R, 3 or S), with their noise and scores.

    `fit`: that of the model, where it was fitted here.
    """

    model: "Model"
    runs: "tuple[Run, ...]"
    starts: Any
    noise: "Noise | None" = None
    scores: "Sequence[RunScore]" = ()
    fit: "Fit | None" = None


def work(options: argparse.Namespace, subject: Any, say: Progress) -> Outcome:
    """Simulate one case or preset."""
    import numpy as np

    from snakejax.estimation.replay import replay
    from snakejax.present.as_json.provenance import heading_json, provenance_json
    from snakejax.present.as_json.values import clean
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    clock = Stopwatch()
    preset = isinstance(subject, Preset)
    simulation = _of_preset(options, subject) if preset else _of_case(options, subject, say)
    model, runs, starts = simulation.model, simulation.runs, np.asarray(simulation.starts)
    say(ProgressEvent(Phase.SIMULATION))
    poses = replay(model, runs, starts)
    if options.csv is not None:
        folder = Path(options.csv) / subject.name if len(options.cases) > 1 else Path(options.csv)
        _write_csv(folder, runs, poses)
    provenance = provenance_json(options.seed, given(options), {} if preset else subject.sha256)
    result = {
        **heading_json(subject.name, model, simulation.noise, provenance),
        "base": _base_json(simulation),
        "runs": _runs_json(simulation, poses),
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from snakejax.present import plot
        from snakejax.present.views import view_of_model

        say(ProgressEvent(Phase.DRAWING))
        view = view_of_model(model, runs, starts)
        plot.save(plot.paths([view]), folder, "simulate-paths")
        films(options, view, model.board, folder, say)

    return Outcome(clean(result), _report(subject.name, result), write)


def _write_csv(folder: Path, runs: "Sequence[Run]", poses: Sequence[Any]) -> None:
    import numpy as np

    from snakejax.core.files import write_whole

    for run_, pose in zip(runs, poses, strict=True):
        write_whole(folder / f"{run_.name}.csv", csv_text(np.asarray(run_.times), pose))


def _base_json(simulation: Simulation) -> dict[str, Any]:
    """The parameters of the model, and how far it is from the train and the held-out runs."""
    from snakejax.present.as_json.values import (
        all_parameters_json,
        effects_json,
        misfit_json,
        parameters_json,
        rmse_json,
    )

    fit = simulation.fit
    parts = all_parameters_json(simulation.model, fit.estimates if fit else {})
    pools = [_pooled([s for s in simulation.scores if s.role == role]) for role in ("train", "heldout")]
    return {
        "parameters": parameters_json(parts),
        "effects": effects_json(parts, simulation.model),
        "misfit": misfit_json(*pools),
        "rmse": rmse_json(*pools),
        "converged": fit and fit.converged,
    }


def _runs_json(simulation: Simulation, poses: Sequence[Any]) -> list[dict[str, Any]]:
    """Score and path of each run."""
    import numpy as np

    from snakejax.present.as_json.values import run_json

    by_run = {score.run: score for score in simulation.scores}
    return [
        {
            **({"run": run_.name, "role": run_.role} if run_.name not in by_run else run_json(by_run[run_.name])),
            **_journey(np.asarray(run_.times), pose, run_.moving),
        }
        for run_, pose in zip(simulation.runs, poses, strict=True)
    ]


def _of_preset(options: argparse.Namespace, subject: Any) -> Simulation:
    import jax.numpy as jnp
    import numpy as np

    from snakejax.recording.run import Run

    from ..requested_model import requested_model, require_given

    model_request = model_options(options)
    requested = requested_model(subject, model_request)
    require_given(requested, options.model is None, model_request)
    run_ = Run(subject.name, "preset", subject.times, jnp.full((subject.times.shape[0], 3), jnp.nan), subject.gait)
    return Simulation(requested.model, (run_,), np.array([start_pose(options.start) or (0.0, 0.0, 0.0)]))


def _of_case(options: argparse.Namespace, case: Any, say: Progress) -> Simulation:
    """The runs of `case` under the model of the options, or under one that is fitted here."""
    from snakejax.estimation.goodness_of_fit import run_scores
    from snakejax.estimation.problem import Problem
    from snakejax.estimation.replay import fitted_starts, starts_of
    from snakejax.recording.quality import noise_of

    from ..requested_model import requested_model, require_given

    pose = start_pose(options.start)
    model_request = model_options(options)
    requested = requested_model(case, model_request)
    if not (options.set or options.saved):
        require_given(requested, True, model_request)
        fit, noise = fitted(options, case, say)
        if pose is not None:
            return Simulation(fit.model, case.runs, starts_of(case.runs, pose), noise, (), fit)
        return Simulation(fit.model, case.runs, fitted_starts(fit), noise, (*fit.runs, *fit.heldout), fit)
    require_given(requested, False, model_request)
    if pose is not None:
        return Simulation(requested.model, case.runs, starts_of(case.runs, pose), case.noise)
    say(ProgressEvent(Phase.START_STATES))
    noise = noise_of(case)
    problem = Problem.of(requested.model, case.runs, noise, (), 1)
    solution = problem.fit({}, (), range(len(case.runs)))
    scores = run_scores(problem, solution, range(len(case.runs)))
    return Simulation(requested.model, case.runs, solution.start, noise, scores)


def _pooled(scores: Sequence[Any]) -> Any:
    from snakejax.estimation.goodness_of_fit import pooled_score

    return pooled_score(scores) if scores else None


def _journey(times: Any, pose: Any, moving: bool = False) -> dict[str, Any]:
    """Start and end pose, duration, path length, distance and turn of a run, with `pose` (n, 3) [m, m, rad]."""
    import numpy as np

    x, y, heading = (float(part) for part in pose[-1])
    return {
        "start": {"x_m": float(pose[0, 0]), "y_m": float(pose[0, 1]), "heading_rad": float(pose[0, 2])},
        "end": {"x_m": x, "y_m": y, "heading_rad": heading},
        "duration_s": float(times[-1] - times[0]) if moving else float(times[-1]),
        "path_m": float(np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1).sum()),
        "distance_m": float(np.hypot(*(pose[-1, :2] - pose[0, :2]))),
        "turn_rad": float(pose[-1, 2] - pose[0, 2]),
    }


def csv_text(times: Any, pose: Any) -> str:
    """A simulated run as CSV text: `times` (n,) [s] and `pose` (n, 3) [m, m, rad], heading unwrapped."""
    rows = (f"{t:.9g},{x:.9g},{y:.9g},{heading:.9g}" for t, (x, y, heading) in zip(times, pose, strict=True))
    return "\n".join([COLUMNS, *rows]) + "\n"


def _report(name: str, result: dict[str, Any]) -> Any:
    from rich.console import Group
    from rich.text import Text

    from snakejax.present.as_json.values import EXPRESSION
    from snakejax.present.as_text.errors import times_noise_text
    from snakejax.present.as_text.tables import add_row, indented, not_converged_line, plain_table

    measured = any("misfit" in row for row in result["runs"])
    right = ("duration\n[s]", "path\n[m]", "distance\n[m]", "turn\n[rad]", *["error\n/ noise"] * measured)
    table = plain_table("run", *right, right=right)
    for row in result["runs"]:
        numbers = (f"{row[key]:.4g}" for key in ("duration_s", "path_m", "distance_m", "turn_rad"))
        add_row(table, row["run"], *numbers, *[times_noise_text(row.get("misfit"))] * measured)
    base = result["base"]
    values = [
        f"{key} = {part['value']:.4g} {part['unit']}".removesuffix(" -")
        for parts in (base["parameters"], *base["effects"].values())
        for key, part in parts.items()
        if key != EXPRESSION
    ]
    return Group(
        Text(name, style="bold"),
        Text(f"model {result['model']}, skid {result['skid']}"),
        Text(", ".join(values)),
        *([Text(f"! {not_converged_line('the model')}", style="yellow")] if base["converged"] is False else []),
        Text(),
        indented(table),
    )
