"""Parameters that differ between labels of the runs, as the option `by` asks for them."""

from collections import OrderedDict
from collections.abc import Iterable

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import parameters
from snakejax.dynamics.conditions import ByCondition, by_condition, differences_of
from snakejax.dynamics.kinds import LABELS
from snakejax.dynamics.model import Model
from snakejax.estimation.initial_model import FITTED
from snakejax.recording.run import Case

BY = "option --by"
GRIP = {"D": "grip", "B": "stiffness"}
"""Parameters of both axles that a floor changes together, and the name of their common ratio."""


def labels_of(case: Case, key: str) -> list[str]:
    """The labels `key` of the train runs of `case`. **Raises:** `InputError` where there are none."""
    if key not in LABELS:
        raise InputError(f"Runs have no label `{key}`", BY, instead_of(key, LABELS))
    labels = [label for run in case.having("train") for name, label in run.labels if name == key]
    if not labels:
        what = f"No run to train on has a {key}"
        raise InputError(what, f"{BY} {key}", f'write {key} = "..." into its [[runs]] of case.toml')
    return list(dict.fromkeys(labels))


def differing(model: Model, case: Case, key: str, free: Iterable[str]) -> tuple[Model, list[str]]:
    """`model` whose parameters `free` have values of their own for each label `key` of the train runs, and the names
    of what is to be estimated. **Raises:** `InputError` where that cannot be.
    """
    free, labels = list(free), labels_of(case, key)
    name = _name(model, key)
    if not free:
        raise InputError("No parameter is free", BY, "name some with --free")
    effect = by_condition(key, differences_of(model, free, labels))()
    return model.add(**{name: effect}), [f"effects.{name}.{one.field}" for one in effect.differences]


def changes(model: Model, case: Case, key: str) -> OrderedDict[str, ByCondition]:
    """What may have changed with the label `key`, by name: each parameter of `model` has values of its own for each
    label of the train runs, those of GRIP on both axles by one ratio. **Raises:** `InputError` where that cannot be.
    """
    labels = labels_of(case, key)
    _name(model, key)
    groups: OrderedDict[str, list[str]] = OrderedDict()
    for name in _changeable(model):
        kind, *rest = name.split(".")
        both = kind == "tyre" and rest[-1] in GRIP
        groups.setdefault(GRIP[rest[-1]] if both else "_".join(rest), []).append(name)
    return OrderedDict(
        (f"{short}_by_{key}", by_condition(key, differences_of(model, names, labels, short))())
        for short, names in groups.items()
    )


def _changeable(model: Model) -> list[str]:
    """The parameters that another floor, day or load can change: of the tyre, the vehicle and the effects."""
    known = parameters(model)
    tyre = [n for n in known if n.startswith("tyre.") and n.rsplit(".", 1)[-1] in FITTED]
    own = [f"board.{name}" for name in {**dict.fromkeys(model.board.estimated), **model.board.stated_sd}]
    acting = [*(tyre if model.constraint.slips else []), *(name for name in own if name in known)]
    return [*acting, *(name for name in known if name.startswith("effects."))]


def _name(model: Model, key: str) -> str:
    name = f"by_{key}"
    if name in model.effects:
        what = f"The saved model already has separate values by {key}"
        raise InputError(what, f"{BY} {key}", f"leave it out, and free them with --free effects.{name}.NAME")
    return name
