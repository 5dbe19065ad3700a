"""`diagnose` and `explain`."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple, Unpack

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import parameters
from snakejax.core.progress import no_progress
from snakejax.diagnosis.diagnosing import Diagnosis, DiagnosisOptions
from snakejax.diagnosis.diagnosing import diagnose as diagnosed
from snakejax.diagnosis.explaining import explain as explained
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.plan import Plan, plan_of
from snakejax.diagnosis.windows import explaining as windows
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.kinds import TYRE_LAWS
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.estimation.initial_model import default_free
from snakejax.estimation.joint_logs.fitting import with_estimated_logs
from snakejax.recording.case import structures_of
from snakejax.recording.fewer_windows import with_fewer_windows
from snakejax.recording.quality import noise_of
from snakejax.recording.run import Case, Noise

from .case_argument import sound_case, takes
from .conditions import BY, changes
from .fitting import FitOptions
from .named_effects import EffectArguments, barred_names, candidate_library
from .option_texts import names, threshold
from .requested_model import requested_model


class ExplainOptions(FitOptions, total=False):
    """The options of `diagnose` and `explain`: those of `fit` for the base, and its candidates.

    `effect`: candidates beside the built-in ones: "FILE.py:Class", classes, or effects with the values to start from;
    `without`: names of effects that are no candidates; `quick`: take a tenth of the windows of each recording.
    """

    effect: EffectArguments | None
    without: str | Iterable[str] | None
    quick: bool


class Question(NamedTuple):
    """What `diagnose` and `explain` of `snakejax.diagnosis` are asked: from `start`, with `library` and `options`."""

    start: Model
    noise: Noise
    library: dict[str, Effect]
    options: DiagnosisOptions


@takes(ExplainOptions, as_recorded=False, quick=False, progress=no_progress)
def diagnose(case: Case | Path | str, **options: Unpack[ExplainOptions]) -> Diagnosis:
    """Rank the effects that may be missing, without adding any, as `snakejax diagnose` does.

    **Arguments:** `case`: a `Case` or the folder of one; `options`: see `ExplainOptions`.
    **Raises:** as `fit`.
    """
    return diagnose_case(sound_case(case, options.get("as_recorded", False)), options)


def diagnose_case(case: Case, options: ExplainOptions) -> Diagnosis:
    """The diagnosis of an inspected `case`. **Raises:** as `fit`."""
    case = as_wide_as_asked(case, options)
    question = question_of(case, options)
    if windows.supports(case):
        return windows.diagnose_windows(case, question.noise, question.library, **question.options)
    progress = question.options.get("progress", no_progress)
    logged = with_estimated_logs(question.start, case, question.noise, progress)
    return diagnosed(logged, question.noise, question.library, **question.options)


@takes(ExplainOptions, as_recorded=False, quick=False, progress=no_progress)
def explain(case: Case | Path | str, **options: Unpack[ExplainOptions]) -> Explanation:
    """Find out which effects the recordings of `case` show beyond the base model, as `snakejax explain` does.

    **Arguments:** `case`: a `Case` or the folder of one; `options`: see `ExplainOptions`.
    **Raises:** as `fit`.
    """
    return explain_case(sound_case(case, options.get("as_recorded", False)), options)


def explain_case(case: Case, options: ExplainOptions) -> Explanation:
    """The explanation of an inspected `case`. **Raises:** as `fit`."""
    if key := options.get("by"):
        what = f"`explain` does not search for differences by {key}"
        raise InputError(what, f"{BY} {key}", "rank what differs with `snakejax diagnose`, estimate it with `fit`")
    case = as_wide_as_asked(case, options)
    question = question_of(case, options)
    return explained(case, question.noise, question.library, **question.options)


def plan_case(case: Case, options: ExplainOptions) -> Plan:
    """What `explain` would try on an inspected `case`. **Raises:** `InputError` as `explain`."""
    case = as_wide_as_asked(case, options)
    question = question_of(case, options)
    options_of_plan = {key: value for key, value in question.options.items() if key in ("held", "with_", "switch")}
    return plan_of(case, question.library, start=question.start, **options_of_plan)  # type: ignore[arg-type]


def as_wide_as_asked(case: Case, options: ExplainOptions) -> Case:
    """`case`, or with `quick` a tenth of the windows of each of its recordings."""
    return with_fewer_windows(case) if options.get("quick") else case


def question_of(case: Case, options: ExplainOptions) -> Question:
    """What is asked about an inspected `case`. **Raises:** `InputError` where the options contradict the question."""
    base = requested_model(case, options)
    if options.get("model") == "ideal":
        what = "A diagnosis cannot start from the model `ideal`, which has no tyre"
        raise InputError(what, "option --model", f"take one of {', '.join(TYRE_LAWS)}")
    if base.model.structure not in (known := structures_of(case.board)):
        what = f"A diagnosis cannot start from the structure `{base.model.structure}`"
        where = "option --skid" if options.get("skid") or not options.get("from_") else "option --from"
        raise InputError(what, where, instead_of(base.model.structure, known))
    effects = dict(base.model.effects)
    usual = default_free(base.model)
    if key := options.get("by"):
        if not windows.supports(case):
            what = f"`diagnose --by {key}` needs train runs that are windows of recordings"
            raise InputError(what, f"{BY} {key}", "leave it out, or estimate parameters by it with `snakejax fit`")
        library, freed = dict(changes(base.model, case, key)), []
        usual = [*usual, *(name for name in parameters(base.model) if name.startswith("board."))]
    else:
        library = candidate_library(options.get("effect"), options.get("without"), case.board)
        freed = base.freed(names(options.get("free")))
    for name in freed:
        if name not in usual:
            what = f"`{name}` is not one of the parameters that the base can estimate"
            raise InputError(what, "option --free", instead_of(name, usual))
    diagnosis_options = DiagnosisOptions(
        start=base.model,
        held=frozenset(usual) - frozenset(freed),
        with_=tuple(effects),
        switch=LATERAL_SLIP_SWITCH not in barred_names(options.get("without")) and not key,
        threshold=threshold(options.get("robust")),
        progress=options.get("progress", no_progress),
    )
    return Question(base.model, noise_of(case), {**library, **effects}, diagnosis_options)
