"""`tune`: a better gait."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from snakejax.core.errors import FitError, InputError, instead_of
from snakejax.core.progress import no_progress
from snakejax.design.limits import Limits, input_names, limits_of, reached_by
from snakejax.design.objectives import Custom, Distance, Effort, Objective, Reach, Turn
from snakejax.design.rollouts import Controller
from snakejax.design.tuning import TuningResult
from snakejax.design.tuning import tune as tuned
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Logged, Sines
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.posterior import posterior_samples
from snakejax.recording.run import Case
from snakejax.vehicles.snakeboard.board import Board
from snakejax.vehicles.snakeboard.paper_examples import Preset

from .case_argument import sound_subject, takes
from .fitting import FitOptions, fit_case
from .option_texts import finite, numbers_by_name
from .requested_model import requested_model, require_given
from .user_code import user_module

OBJECTIVES = ("distance", "turn", "reach:X,Y,HEADING", "effort:DISTANCE", "FILE.py:function")
DRAWS = 12
"""Number of samples of the fitted parameters over which a gait is tuned and its result is shown."""


class TuneOptions(FitOptions, total=False):
    """The options of `tune`: those of the model and of the fit that comes first, and those of the run.

    `seconds`: duration of the run [s] (default: that of the first run); `limit`: limits of the inputs [rad, rad/s,
    rad/s^2], {"phi": 0.9, "psi_rate": 6.5} or "phi=0.9,psi_rate=6.5" (default: the largest angle and rate of the gaits
    of the case); `payload`: mass [kg] and yaw inertia [kg m^2] (default: those of the first run); `start`: pose
    [m, m, rad] (default: the origin); `over`: "fit", "mean" or "worst" of samples of the parameters (default: "fit",
    or "mean" where the fit does not determine a parameter); `seed`: of the random numbers.
    """

    seconds: float | None
    limit: Mapping[str, float] | str | Sequence[str] | None
    payload: tuple[float, float] | None
    start: tuple[float, float, float] | None
    over: str | None
    seed: int


class Boards(NamedTuple):
    """The boards of a tuning: the given or fitted model first, then samples of the fit; `over` which of them it goes,
    and the `fit`, where there was one."""

    models: list[Model]
    over: str
    fit: Fit | None = None


@takes(TuneOptions, as_recorded=False, progress=no_progress, seed=0)
def tune(
    case: Case | Preset | Model | Path | str, objective: Objective | str = "distance", **options: Unpack[TuneOptions]
) -> TuningResult:
    """Find the gait that is best for `objective` within the limits of the joints, as `snakejax tune` does.

    Without `set` or `from_` the case is fitted first. See `snakejax.design.tune` for the method.

    **Arguments:** `case`: a `Case`, the folder of one, a `Preset` or its name, or a `Model`, which needs `seconds` and
    `limit`; `objective`: "distance", "turn", "reach:X,Y,HEADING", "effort:DISTANCE", "FILE.py:function", or an
    `Objective`; `options`: see `TuneOptions`.
    **Raises:** as `fit`; `InputError` for an objective or a limit that is none; `FitError` where no gait is found.
    """
    target = objective_of(objective) if isinstance(objective, str) else objective
    subject = sound_subject(case, options.get("as_recorded", False))
    return tune_subject(subject, target, options)[0]


def tune_subject(
    subject: Case | Preset | Model, target: Objective, options: TuneOptions
) -> tuple[TuningResult, Boards, tuple[float, float]]:
    """The tuned gait of an inspected case, the boards it was tuned for, without payload, and the payload.

    **Raises:** as `tune`.
    """
    limit = numbers_by_name(options.get("limit"), "option --limit")
    gaits, length = gaits_of(subject)
    boards = _boards(subject, options)
    payload = options.get("payload")
    payload = payload_of(subject) if payload is None else payload
    models = [model.with_payload(payload) for model in boards.models]
    names = input_names(models[0])
    limits = Limits.of(limit, reached_by(gaits, models[0], length or 0.0) if gaits else None, names)
    seconds = options.get("seconds")
    seconds = length if seconds is None else seconds
    if seconds is None:
        raise InputError("A model alone has no duration of a run", "option --seconds", "give the seconds of the run")
    start = options.get("start")
    how = {
        "seconds": seconds,
        "start": (0.0, 0.0, 0.0) if start is None else start,
        "seed": options.get("seed", 0),
        "progress": options.get("progress", no_progress),
    }
    return _tuned(models, target, limits, gaits, boards.over, how), boards, payload


def _tuned(
    models: Sequence[Model],
    target: Objective,
    limits: Limits,
    gaits: Sequence[AbstractInputs],
    over: str,
    how: Mapping[str, Any],
) -> TuningResult:
    """The gait tuned for the first model, or over all of them. **Raises:** `FitError` where no gait is found."""
    try:
        return tuned(
            models[0] if over == "fit" else models,
            target,
            limits,
            driver=Controller.of(gaits[0], limits.names) if gaits else Controller(),
            given=[gait for gait in gaits if gait.names == limits.names],
            over="worst" if over == "worst" else "mean",
            others=models[1:] if over == "fit" else (),
            **how,
        )
    except RuntimeError as error:
        raise FitError(str(error)) from None


def _boards(subject: Case | Preset | Model, options: TuneOptions) -> Boards:
    given = isinstance(subject, Preset | Model) or options.get("set") or options.get("from_")
    over = options.get("over")
    if over not in (None, "fit", "mean", "worst"):
        raise InputError(f"There is no way to tune over `{over}`", "option --over", "take fit, mean or worst")
    if given and over in ("mean", "worst"):
        what = "`--over` needs samples of a fit, but the parameters of this board are given"
        raise InputError(what, "option --over", "leave it out, or fit a case (without --set and --from)")
    if isinstance(subject, Model):
        return Boards([subject], "fit")
    if isinstance(subject, Preset) or given:
        requested = requested_model(subject, options)
        own = isinstance(subject, Preset) and options.get("model") is None
        require_given(requested, own, options)
        return Boards([requested.model], "fit")
    fit, _ = fit_case(subject, options)
    undetermined = [name for name, e in fit.estimates.items() if not e.determined]
    drawn = posterior_samples(fit, DRAWS, options.get("seed", 0), options.get("progress", no_progress))
    return Boards([fit.model, *drawn], over or ("mean" if undetermined else "fit"), fit)


def gaits_of(subject: Case | Preset | Model) -> tuple[list[AbstractInputs], float | None]:
    """The gaits of the runs from rest, and the duration of the first run [s]; a model has neither. Commands of another
    vehicle than a snakeboard count where they are smooth.

    **Raises:** `InputError` for a vehicle without inputs, or where no commands of a snakeboard are smooth.
    """
    if isinstance(subject, Preset):
        return [subject.gait], subject.duration
    if not subject.board.inputs:
        what = f"A {subject.board.noun} has no inputs, so there is no gait to tune"
        raise InputError(what, "argument CASE", "take a vehicle with inputs")
    if isinstance(subject, Model):
        return [], None
    rested = [run.gait for run in subject.runs if not run.moving]
    smooth = [g for g in rested if all(isinstance(limits_of(g.signal(name)), Sines | Logged) for name in g.names)]
    if rested and not smooth and isinstance(subject.board, Board):
        what = "The commands of these runs jump or pass through an actuator that is none of kp and kd"
        raise InputError(what, "argument CASE", "`tune` and `design` take gaits of sines or smooth logs")
    return smooth, float(subject.runs[0].times[-1])


def payload_of(subject: Case | Preset | Model) -> tuple[float, float]:
    """The payload of the first run [kg, kg m^2]."""
    runs = subject.runs if isinstance(subject, Case) else ()
    return (float(runs[0].payload[0]), float(runs[0].payload[1])) if runs else (0.0, 0.0)


def objective_of(text: str) -> Objective:
    """The objective that `text` names. **Raises:** `InputError` where it names none."""
    where = "option --objective"
    kind, _, rest = text.partition(":")
    if text in ("distance", "turn"):
        return Distance() if text == "distance" else Turn()
    if kind == "reach":
        parts = rest.split(",")
        if len(parts) != 3:
            raise InputError(f"`{text}` is not a pose", where, "write reach:x,y,heading in m and rad")
        return Reach(*(finite(part, where, f"`{text}`") for part in parts))
    if kind == "effort":
        distance = finite(rest, where, f"`{text}`")
        if not distance > 0:
            raise InputError(
                f"The distance {distance:g} m is not positive", where, "give one above 0, as in effort:0.5"
            )
        return Effort(distance)
    if kind.endswith(".py"):
        return Custom(_function(Path(kind), rest))
    raise InputError(f"There is no objective `{text}`", where, instead_of(text, OBJECTIVES))


def _function(path: Path, name: str) -> Callable:
    where = "option --objective"
    module = user_module(path, where, "my.py:cost")
    function = getattr(module, name, None)
    if not callable(function):
        functions = [n for n, part in vars(module).items() if callable(part) and not n.startswith("_")]
        raise InputError(f"`{path}` has no function `{name}`", where, instead_of(name, functions))
    return function
