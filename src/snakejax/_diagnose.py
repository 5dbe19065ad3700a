"""Diagnosis: which effect is missing?"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypedDict, Unpack

from ._bench import LATERAL_SKID, Bench, Step, structures
from ._effect import Effect
from ._rank import Ranked, placed, rank
from ._recording import Case, Noise
from ._refit import base_fit
from ._stage import Stage, stage


class Question(TypedDict, total=False):
    """What `diagnose` and `explain` can be told beyond the recordings and the candidates.

    `kind`: the tyre law of the base, "pacejka" (default) or "rayleigh"; `skid`: its structure (default: the case's);
    `with_`: effects in the base from the start; `switch`: whether the change of structure from coupled to free is a
    candidate (default True); `progress` is told what is being done.
    """

    kind: str
    skid: str | None
    with_: Sequence[str]
    switch: bool
    progress: Callable[[str], None]


def silent(_: object) -> None:
    """Nobody wants to know."""


class Diagnosis(NamedTuple):
    """The base, what its ranking says is missing, and the other skid structure beside it where there is one."""

    base: Stage
    switched: tuple[Bench, Step] | None


def diagnose(case: Case, noise: Noise, library: Mapping[str, Effect], **question: Unpack[Question]) -> Diagnosis:
    """Rank the effects of `library` by how well each would explain what the base model leaves of the train runs.

    Nothing is added: all candidates are scored at the base fit, the best few refitted beside it.

    **Arguments:** `question`, see `Question`. **Raises:** `FitError` where the base cannot be fitted.
    """
    with_, progress = question.get("with_", ()), question.get("progress", silent)
    options = structures(case, question.get("kind", "pacejka"), question.get("skid"))
    options = options[: 2 if question.get("switch", True) else 1]
    bench = Bench.of(options[0], case, noise, library)
    step = Step(tuple(with_), base_fit(bench, with_, progress))
    ranking = tuple(rank(bench, step, progress=progress))
    switched = None
    if len(options) > 1:
        progress(f"refitting with {LATERAL_SKID}")
        other = Bench.of(options[1], case, noise, library, switched=True)
        there = Step(step.effects, base_fit(other, with_, progress))
        ranking = placed(ranking, Ranked(LATERAL_SKID, None, None, there.optimum, (), None))
        switched = (other, there)
    return Diagnosis(stage(bench, "base", "", step, ranking), switched)
