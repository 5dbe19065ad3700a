"""`snakejax tune`: optimise a gait by its gradient."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError, instead_of
from snakejax.core.progress import Progress

from .fit_pipeline import fitted
from .gait_options import GaitRequest, carried, gait_request, gaits_of, payload_json
from .gait_output import GaitOutput, gait_outcome
from .options import add_cases, add_command, add_loading, add_model, finite, given
from .pipeline import Outcome, Stopwatch, each_case
from .user_code import user_module

if TYPE_CHECKING:
    from snakejax.design.limits import Limits
    from snakejax.design.objectives import Objective
    from snakejax.design.tuning import TuningResult
    from snakejax.dynamics.inputs import Gait
    from snakejax.dynamics.model import Model


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
"""Number of samples of the fitted parameters over which a gait is tuned and its result is shown."""


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "tune",
        run,
        "optimise a gait by gradient",
        "Find the gait that is best for an objective within the limits of the joints, by\n"
        "the gradient of the simulation. The board starts at rest at --start at time 0.\n"
        "Without --set or --from the case is fitted first; if the fit does not determine\n"
        "all parameters, the gait is tuned over samples of them. --out writes the gait\n"
        "in the form of case.toml.",
        "snakejax tune data/level-board --objective reach:0.5,0.3,1 --seconds 20 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_loading(command)
    command.add_argument(
        "--objective",
        metavar="WHAT",
        default="distance",
        help="distance (default), turn, reach:X,Y,HEADING, effort:DISTANCE (least effort for this distance),"
        " FILE.py:function (a cost of times, pose and effort, minimised), separate:EFFECT,EFFECT (the run that best"
        " distinguishes two effects; separate alone: the two most confusable ones) or information (the run that"
        " determines the tyre parameters best)",
    )
    command.add_argument("--seconds", metavar="T", help="duration of the run [s] (default: that of the first run)")
    command.add_argument(
        "--limit",
        metavar="phi=0.9,psi_rate=6.5",
        action="append",
        help="limits of the joints [rad, rad/s, rad/s^2]: phi, psi, phi_rate, psi_rate, phi_acceleration,"
        " psi_acceleration (default: the largest angle and rate of the gaits of CASE)",
    )
    command.add_argument(
        "--payload",
        metavar="KG[,KGM2]",
        help="payload of the board: mass [kg] and yaw inertia [kg m^2] (default: that of the first run)",
    )
    command.add_argument("--start", metavar="X,Y,HEADING", help="start pose of the board [m, m, rad] (default 0,0,0)")
    command.add_argument(
        "--over",
        choices=OVER,
        help="tune for the fitted model, or for the mean or the worst of samples of its parameters (default fit; mean"
        " where the fit does not determine a parameter)",
    )


def run(options: argparse.Namespace) -> int:
    """Tune each CASE."""
    request = gait_request(options)
    return each_case(options, lambda case, say: work(options, case, request, say), presets=True)


def objective(text: str) -> "Objective":
    """The objective that `--objective` names. **Raises:** `InputError` where `text` names none."""
    from snakejax.design.objectives import Custom, Distance, Effort, Reach, Turn

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


def work(options: argparse.Namespace, subject: Any, request: GaitRequest, say: Progress) -> Outcome:
    """Tune one case or preset."""
    if options.objective.partition(":")[0] in ("separate", "information"):
        from .design import work as design

        return design(options, subject, request, say)
    from snakejax.design.limits import Limits, reached_by
    from snakejax.present.as_json.design import tuned_json
    from snakejax.present.as_json.provenance import heading_json, provenance_json
    from snakejax.present.as_text.design import report
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    clock = Stopwatch()
    target = objective(options.objective)
    gaits, length = gaits_of(subject)
    unloaded, over = boards(options, subject, say)
    payload, with_payload = carried(request.payload, subject)
    models = [model.with_payload(payload) for model in unloaded]
    limits = Limits.of(request.limit, reached_by(gaits, models[0], length) if gaits else None)
    seconds = length if request.seconds is None else request.seconds
    how = {"seconds": seconds, "start": request.start, "seed": options.seed, "progress": say}
    tuned = _tuned(models, target, limits, gaits, over, how)
    sha256 = {} if isinstance(subject, Preset) else subject.sha256
    result = {
        **heading_json(subject.name, models[0], None, provenance_json(options.seed, given(options), sha256)),
        **tuned_json(tuned, options.objective, over),
        **payload_json(payload),
    }
    text = report(subject.name, options.objective, tuned, over, with_payload)
    return gait_outcome(options, subject.name, GaitOutput(tuned, result, text, "tuned"), clock, say)


def _tuned(
    models: "Sequence[Model]",
    target: "Objective",
    limits: "Limits",
    gaits: "Sequence[Gait]",
    over: str,
    how: Mapping[str, Any],
) -> "TuningResult":
    """The gait tuned for the first model, or over all of them. **Raises:** `FitError` where no gait is found."""
    from snakejax.core.errors import FitError
    from snakejax.design.rollouts import Controller
    from snakejax.design.tuning import tune

    try:
        return tune(
            models[0] if over == "fit" else models,
            target,
            limits,
            driver=Controller.of(gaits[0]) if gaits else Controller(),
            given=[gait for gait in gaits if gait.phi_back is None],
            over="worst" if over == "worst" else "mean",
            others=models[1:] if over == "fit" else (),
            **how,
        )
    except RuntimeError as error:
        raise FitError(str(error)) from None


def boards(options: argparse.Namespace, subject: Any, say: Progress) -> "tuple[list[Model], str]":
    """The models (the given or fitted one first, then samples of the fit), and the value of `--over` that is used."""
    from snakejax.estimation.posterior import posterior_samples
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    from .model_options import requested_model, require_given

    requested = requested_model(options, subject)
    if isinstance(subject, Preset) or options.set or options.saved:
        require_given(options, requested, own=isinstance(subject, Preset) and options.model is None)
        if options.over in ("mean", "worst"):
            what = "A board with given parameters has no samples"
            raise InputError(what, "option --over", "leave it out, or fit a case (without --set and --from)")
        return [requested.model], "fit"
    fit, _ = fitted(options, subject, say)
    undetermined = [name for name, e in fit.estimates.items() if not e.determined]
    over = options.over or ("mean" if undetermined else "fit")
    drawn = posterior_samples(fit, DRAWS, options.seed, say)
    return [fit.model, *drawn], over
