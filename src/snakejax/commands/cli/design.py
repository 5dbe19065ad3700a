"""`snakejax design`: which run to record next. `tune --objective separate` and `information` are its old spelling."""

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError, instead_of
from snakejax.core.progress import Phase, Progress, ProgressEvent

from .fit_pipeline import fitted
from .gait_options import GaitRequest, add_gait, design_payload, gait_request, payload_json
from .gait_output import GaitOutput, gait_outcome
from .options import (
    EffectSpec,
    add_cases,
    add_command,
    add_fitting,
    add_model,
    add_output,
    effect_spec,
    finite,
    given,
)
from .pipeline import Outcome, Stopwatch, each_case

if TYPE_CHECKING:
    from snakejax.design.experiments import DiscriminationDesign, PrecisionDesign
    from snakejax.design.fisher_information import PriorInformation
    from snakejax.design.limits import Limits
    from snakejax.dynamics.ports import Effect
    from snakejax.dynamics.vehicle import AbstractVehicle
    from snakejax.recording.run import Run


WHERE = "option --objective"


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "design",
        run,
        "find the run to record next",
        "Find the run that best distinguishes two effects that may be missing, or that\n"
        "determines the tyre parameters best, from the runs recorded so far. --out writes\n"
        "its gait in the form of case.toml.",
        "snakejax design data/level-board --objective separate:body_drag,yaw_damping",
    )
    add_cases(command)
    add_model(command, candidates=True)
    add_fitting(command)
    group = command.add_argument_group("candidates")
    group.add_argument(
        "--effect",
        metavar="NAME[:p=v,...]",
        action="append",
        help="an effect of the pair, FILE.py:Class of your own or with values that are fixed. May be repeated",
    )
    add_gait(
        command,
        "separate",
        "separate (default: the two effects that are hardest to distinguish), separate:EFFECT,EFFECT, or information"
        " (the run that determines the tyre parameters best)",
    )
    add_output(command)


def run(options: argparse.Namespace) -> int:
    """Design the next run of each CASE."""
    request = gait_request(options)
    return each_case(options, lambda case, say: work(options, case, request, say))


def effects_of(text: str) -> tuple[tuple[str, str] | None, dict[str, float]]:
    """The two effects of `separate:A,B` and the strengths of `separate:A=0.1,B=0.2`; None for `separate` alone.

    **Raises:** `InputError`.
    """
    kind, _, rest = text.partition(":")
    if kind != "separate" or not rest:
        if text not in ("separate", "information"):
            raise InputError(f"There is no objective `{text}`", WHERE, "write separate:EFFECT,EFFECT or information")
        return None, {}
    parts = [part.partition("=") for part in rest.split(",")]
    if len(parts) != 2 or not all(name.strip() for name, _, _ in parts):
        raise InputError(f"`{text}` does not name two effects", WHERE, "write separate:body_drag,longitudinal_slip")
    strengths = {name.strip(): finite(value, WHERE, f"`{text}`") for name, sign, value in parts if sign}
    return (parts[0][0].strip(), parts[1][0].strip()), strengths


def work(options: argparse.Namespace, case: Any, request: GaitRequest, say: Progress) -> Outcome:
    """Design the next run of one case."""
    from snakejax.design.fisher_information import prior_information, require_strengths
    from snakejax.design.limits import Limits, reached_by
    from snakejax.design.rollouts import Controller
    from snakejax.present.as_json.provenance import heading_json, provenance_json
    from snakejax.vehicles.snakeboard.board import Board
    from snakejax.vehicles.snakeboard.paper_examples import Preset

    from ..gaits import gaits_of

    effects, strengths = effects_of(options.objective)
    if isinstance(case, Preset):
        what = "The next run is designed from the recorded runs of a case"
        raise InputError(what, WHERE, "name a recorded case")
    if not isinstance(case.board, Board):
        what = f"Runs are designed for a snakeboard, but the vehicle is a {case.board.noun}"
        raise InputError(what, "argument CASE", "take a case of a snakeboard; `tune` takes any vehicle")
    require_strengths(effects or ())
    effects_by_name, fixed, fit_options = candidates(options, effects, case.board)
    clock = Stopwatch()
    gaits, length = gaits_of(case)
    assert length is not None
    fit, noise = fitted(fit_options, case, say)
    limits = Limits.of(request.limit, reached_by(gaits, fit.model, length) if gaits else None)
    payload, with_payload = design_payload(request.payload, case)
    say(ProgressEvent(Phase.PRIOR_INFORMATION))
    information = prior_information(fit, effects_by_name, fixed)
    how = {
        "driver": Controller.of(gaits[0]) if gaits else Controller(),
        "given": [gait for gait in gaits if gait.names == limits.names],
        "start": request.start,
        "payload": payload,
        "seed": options.seed,
        "rate": frame_rate(case.runs[0]),
        "progress": say,
    }
    seconds = length if request.seconds is None else request.seconds
    design = _designed(options.objective, information, effects, strengths, limits, seconds, case.runs, how)
    heading = heading_json(case.name, fit.model, noise, provenance_json(options.seed, given(options), case.sha256))
    output = _output(options.objective, case.name, design, heading, (payload, with_payload))
    return gait_outcome(options, case.name, output, clock, say)


def _designed(
    objective: str,
    information: "PriorInformation",
    effects: tuple[str, str] | None,
    strengths: Mapping[str, float],
    limits: "Limits",
    seconds: float,
    runs: "Sequence[Run]",
    how: Mapping[str, Any],
) -> "DiscriminationDesign | PrecisionDesign":
    """The designed run; without `effects`, for the most confusable pair. **Raises:** `FitError` where none is found."""
    from snakejax.core.errors import FitError
    from snakejax.design.experiments import design_discrimination, design_precision
    from snakejax.design.fisher_information import most_confusable

    try:
        if objective == "information":
            return design_precision(information, limits, seconds, **how)
        pair = most_confusable(information) if effects is None else effects
        return design_discrimination(information, pair, limits, seconds, runs, strengths=strengths, **how)
    except FitError:
        raise
    except RuntimeError as error:
        raise FitError(str(error)) from None


def _output(
    objective: str,
    name: str,
    design: "DiscriminationDesign | PrecisionDesign",
    heading: dict[str, Any],
    payload: tuple[tuple[float, float], str],
) -> GaitOutput:
    """What is delivered of the design; `payload` with the words that describe it."""
    from snakejax.design.experiments import PrecisionDesign
    from snakejax.present.as_json.design import discrimination_json, precision_json
    from snakejax.present.as_text.design import discrimination_report, precision_report

    if isinstance(design, PrecisionDesign):
        parts, text = precision_json(design, objective), precision_report(name, design, payload[1])
    else:
        parts, text = discrimination_json(design, objective), discrimination_report(name, design, payload[1])
    return GaitOutput(design.tuned, {**heading, **parts, **payload_json(payload[0])}, text, "designed")


def candidates(
    options: argparse.Namespace, effects: tuple[str, str] | None, vehicle: "AbstractVehicle"
) -> "tuple[dict[str, Effect], set[str], argparse.Namespace]":
    """The effects to distinguish, the names of their fixed parameters, and the options of the fitted model.

    An effect of the pair is a candidate whose given values are fixed; any other belongs to the fitted model.
    **Raises:** `InputError` where an effect is unknown, given twice, or has no free parameter.
    """
    from snakejax.core.parameter import parameters
    from snakejax.effects import library

    from ..named_effects import built, effect_class

    built_in = library(vehicle)
    given_texts = [*(options.with_ or ()), *(getattr(options, "effect", None) or ())]
    if effects is None:
        every = {} if options.objective == "information" else {name: kind() for name, kind in built_in.items()}
        return every, set(), argparse.Namespace(**{**vars(options), "with_": given_texts})
    texts = {text: effect_spec(text) for text in given_texts}
    own = {spec.name: spec for spec in texts.values() if spec.name in effects}
    if len({spec.name for spec in texts.values()}) < len(given_texts):
        raise InputError("An effect is given twice", "option --effect", "give each once")
    effects_by_name, held = {}, set()
    for name in effects:
        if name not in own and name not in built_in:
            known = [*built_in, *(spec.name for spec in texts.values())]
            remedy = f"{instead_of(name, known)}; name your own with --effect FILE.py:Class too"
            raise InputError(f"There is no effect `{name}`", WHERE, remedy)
        spec = own.get(name, EffectSpec(name, None, {}))
        effects_by_name[name] = built(name, effect_class(spec, vehicle), spec.values)
        if len(spec.values) == len(parameters(effects_by_name[name])) > 0:
            raise InputError(f"All parameters of `{name}` are fixed", "option --effect", "leave one without a value")
        held |= {f"effects.{name}.{part}" for part in spec.values}
    rest = [text for text, spec in texts.items() if spec.name not in effects]
    return effects_by_name, held, argparse.Namespace(**{**vars(options), "with_": rest})


def frame_rate(run: Any) -> float:
    """Frame rate of a run [Hz]."""
    return (run.times.shape[0] - 1) / float(run.times[-1] - run.times[0])
