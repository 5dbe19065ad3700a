"""`snakejax explain`: fit, compare, diagnose, add an effect and fit again, until the rest is noise."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from snakejax.core.errors import InputError, instead_of
from snakejax.core.progress import Phase, Progress, ProgressEvent
from snakejax.dynamics.kinds import CASE_STRUCTURES, TYRE_LAWS

from .animation import add_films, films, require_films
from .options import add_cases, add_command, effect_spec, given
from .pipeline import Outcome, Stopwatch, each_case

if TYPE_CHECKING:
    from snakejax.recording.run import Case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "explain",
        run,
        "find out which physical effect is missing",
        "Fit, examine the residual, add the effect that explains it, and fit again, until\n"
        "only noise is left or no known effect helps.",
        "snakejax explain data/tilted-floor --json -",
    )
    add_cases(command)
    add_candidates(command)
    command.add_argument("--plan", action="store_true", help="print what would be tried, and fit nothing")
    add_films(command)


def add_candidates(command: argparse.ArgumentParser) -> None:
    """The options of base model and candidates, shared with `diagnose`."""
    command.add_argument("--model", choices=TYRE_LAWS, default="pacejka", help="tyre law of the base model")
    command.add_argument(
        "--skid", choices=(*CASE_STRUCTURES, "ideal"), help="skid structure of the base model (default: that of CASE)"
    )
    command.add_argument("--effect", metavar="FILE.py:Class", action="append", help="a candidate effect of your own")
    command.add_argument("--with", dest="with_", metavar="NAME", action="append", help="an effect of the base model")
    command.add_argument("--without", metavar="NAME", action="append", help="an effect to exclude from the candidates")


def run(options: argparse.Namespace) -> int:
    """Explain each CASE."""
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say))


def candidates_of(options: argparse.Namespace, case: "Case") -> dict[str, Any]:
    """The candidate effects of the vehicle of `case` by name: built-in ones and those of `--effect`, less `--without`.

    **Raises:** `InputError` for an unknown name.
    """
    from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
    from snakejax.effects import library

    from .model_options import effect_class

    _require_structure(options, case)
    effects = {name: kind() for name, kind in library(case.board).items()}
    for text in options.effect or ():
        spec = effect_spec(text)
        effects[spec.name] = effect_class(spec, case.board)()
    for option in ("with_", "without"):
        for name in getattr(options, option) or ():
            if name not in effects and name != LATERAL_SLIP_SWITCH:
                where = f"option --{option.rstrip('_')}"
                raise InputError(
                    f"There is no effect `{name}`", where, instead_of(name, [*effects, LATERAL_SLIP_SWITCH])
                )
    return {name: effect for name, effect in effects.items() if name not in (options.without or ())}


def _require_structure(options: argparse.Namespace, case: "Case") -> None:
    from snakejax.recording.case import structures_of

    if options.skid is not None and options.skid not in structures_of(case.board):
        remedy = instead_of(options.skid, structures_of(case.board))
        raise InputError(f"A {case.board.noun} has no structure `{options.skid}`", "option --skid", remedy)


def wanted(options: argparse.Namespace) -> dict[str, Any]:
    """The keyword arguments of `explain()` and `diagnose()`."""
    from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH

    with_ = options.with_ or []
    return {
        "kind": options.model,
        "constraint": "free" if LATERAL_SLIP_SWITCH in with_ else options.skid,
        "with_": [name for name in with_ if name != LATERAL_SLIP_SWITCH],
        "switch": LATERAL_SLIP_SWITCH not in (options.without or ()),
    }


def plan(options: argparse.Namespace, case: Any) -> Outcome:
    """What would be tried on one case."""
    from snakejax.diagnosis.plan import plan_of
    from snakejax.present.as_text.plan import plan_text

    made = plan_of(case, candidates_of(options, case), **wanted(options))
    return Outcome(made._asdict(), plan_text(made), lambda folder: None)


def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
    """Explain one case."""
    if options.plan:
        return plan(options, case)
    from snakejax.core.files import write_whole
    from snakejax.diagnosis.explaining import explain
    from snakejax.diagnosis.latent_force.template import effect_template
    from snakejax.present import plot
    from snakejax.present.as_json.explanation import candidates_csv, explanation_json
    from snakejax.present.as_json.fit import joint_logs_json
    from snakejax.present.as_json.provenance import provenance_json
    from snakejax.present.as_text.explanation import explanation_text
    from snakejax.present.report import explanation_page
    from snakejax.present.views import views_of_steps
    from snakejax.recording.quality import noise_of

    clock = Stopwatch()
    noise = noise_of(case)
    explanation = explain(case, noise, candidates_of(options, case), **wanted(options), progress=say)
    provenance = provenance_json(options.seed, given(options), case.sha256)

    result = {**explanation_json(explanation, provenance, clock.seconds()), **joint_logs_json(explanation.case.runs)}

    def write(folder: Path) -> None:
        say(ProgressEvent(Phase.DRAWING))
        models = list(views_of_steps(explanation))
        write_whole(folder / "explain.html", explanation_page(explanation, result, models))
        plot.save(plot.fall(explanation, models), folder, "fall")
        plot.save(plot.waterfall(explanation), folder, "waterfall")
        ends = models if len(models) < 3 else [models[0], models[-1]]
        plot.save(plot.paths(ends), folder, "paths")
        plot.save(plot.residuals(models[-1]), folder, "residuals")
        plot.save(plot.tyre(ends), folder, "tyre")
        plot.save(plot.ranking(explanation.base), folder, "ranking")
        plot.save(plot.confusability(explanation.base), folder, "confusability")
        if explanation.candidates:
            write_whole(folder / "candidates.csv", candidates_csv(explanation))
        films(options, models[-1], case.board, folder, say)
        if explanation.missing is None:
            return
        plot.save(plot.missing(explanation), folder, "missing")
        if explanation.missing.shape is not None:
            write_whole(folder / "missing_force.py", effect_template(explanation.missing))

    return Outcome(result, explanation_text(explanation), write)
