"""What an explanation would try, before anything is fitted."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from snakejax.core.parameter import parameters
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.estimation.initial_model import default_free
from snakejax.recording.run import Case

from .selection.candidates import structures


class Plan(NamedTuple):
    """The plan of `case`: the `structures` of the wheels, the parameters that the base frees, the train and held-out
    runs, the `candidates` with their parameters, and the effects `left_out` with the reason."""

    case: str
    structures: tuple[str, ...]
    free: tuple[str, ...]
    train: tuple[str, ...]
    heldout: tuple[str, ...]
    candidates: dict[str, tuple[str, ...]]
    left_out: dict[str, str]


def plan_of(
    case: Case,
    library: Mapping[str, Effect],
    *,
    kind: str = "pacejka",
    constraint: str | None = None,
    start: Model | None = None,
    held: Collection[str] = (),
    with_: Sequence[str] = (),
    switch: bool = True,
) -> Plan:
    """The plan of `explain` with the same arguments, see `DiagnosisOptions`."""
    models = structures(case, kind, constraint, start)[: 2 if switch else 1]
    added = [f"effects.{name}" for name in with_ if name not in models[0].effects]
    free = (*default_free(models[0]), *added)
    names = {kind_: name for name, kind_ in case.board.structures.items()}
    left_out: dict[str, str] = {}
    candidates: dict[str, tuple[str, ...]] = {}
    for name, effect in library.items():
        reasons = [effect.inapplicable_because(model) for model in models]
        if all(reasons):
            left_out[name] = str(reasons[0])
        elif name not in with_:
            candidates[name] = tuple(parameters(effect))
    return Plan(
        case.name,
        tuple(names[type(model.constraint)] for model in models),
        tuple(name for name in free if name not in held),
        tuple(run.name for run in case.having("train")),
        tuple(run.name for run in case.having("heldout")),
        candidates,
        left_out,
    )
