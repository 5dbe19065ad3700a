"""The model that the options `model`, `skid`, `set`, `with` and `from` describe."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypedDict

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import parameters, short_name, with_parameters
from snakejax.dynamics.kinds import MODEL_KINDS
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.dynamics.tyres import AbstractTyre
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.effects import library
from snakejax.estimation.initial_model import default_free, select_parameters, starting_tyre
from snakejax.present.as_json.saved import SavedFit, saved_fit
from snakejax.recording.run import Case
from snakejax.vehicles.snakeboard.paper_examples import Preset

from .named_effects import EffectArguments, NamedEffect, built, named_effects
from .option_texts import numbers_by_name

WITH = "option --with"


class ModelOptions(TypedDict, total=False):
    """The options of the model, in the order of the command line.

    `model`: tyre law, "pacejka" (default), "rayleigh" or "ideal"; `skid`: one of the structures of the vehicle, "free",
    "coupled" or "printed" for a snakeboard (default: that of the case); `set`: values of parameters in SI units, kept
    fixed: `{"B": 6.0}` or "B=6,C=1.4"; `with_`: effects in the model: names ("ground_slope", "ground_slope:sx=0.01"
    with that value fixed, "FILE.py:Class"), classes, or effects; `from_`: the file of a saved fit, whose model,
    parameters and effects are used.
    """

    model: str | None
    skid: str | None
    set: Mapping[str, float] | str | Sequence[str] | None
    with_: EffectArguments | None
    from_: Path | str | None


class RequestedModel(NamedTuple):
    """The requested model; `held`, the names of its fixed parameters; `given`, of all parameters with a given value;
    `saved`, of those that have their value from a saved fit."""

    model: Model
    held: frozenset[str]
    given: frozenset[str]
    saved: frozenset[str] = frozenset()

    @property
    def free(self) -> list[str]:
        """The parameters that a fit estimates by default: those of tyre and effects that are not fixed."""
        return [name for name in default_free(self.model) if name not in self.held]

    def freed(self, patterns: list[str] | None) -> list[str]:
        """The parameters that a fit estimates: those `patterns` name and the effects' without a value; or `free`."""
        if patterns is None:
            return self.free
        named = select_parameters(self.model, patterns)
        known = {*named, *self.saved}
        return [*named, *(n for n in self.free if n.startswith("effects.") and n not in known)]


def requested_model(subject: Case | Preset, options: ModelOptions) -> RequestedModel:
    """The requested model of `subject`. **Raises:** `InputError` where the options describe none."""
    vehicle = vehicle_of(subject)
    for key, known in (("model", MODEL_KINDS), ("skid", tuple(vehicle.structures))):
        if (value := options.get(key)) is not None and value not in known:
            what = f"There is no model `{value}`" if key == "model" else f"A {vehicle.noun} has no structure `{value}`"
            raise InputError(what, f"option --{key}", instead_of(str(value), known))
    path, kind = options.get("from_"), options.get("model")
    saved = None if path is None else saved_fit(path)
    if saved and kind and kind != saved.model:
        what = f"The saved fit is of the model `{saved.model}`, not `{kind}`"
        raise InputError(what, f"option --from {path}", "leave out --model")
    named = named_effects(options.get("with_"), WITH, vehicle)
    switched = any(one.kind is None for one in named)
    board, tyre, constraint = _base(subject, saved, kind, options.get("skid"), switched)
    effects, held, given = saved_effects({one.name: one for one in named if one.kind is not None}, saved, vehicle)
    try:
        model = Model(board, tyre, constraint, effects)
    except ValueError as error:
        raise InputError(str(error).rstrip("."), WITH, "leave it out or choose another --skid") from None
    if saved:
        model = valued(model, saved.values, f"option --from {path}")
        given |= {select_parameters(model, [name])[0] for name in saved.values}
    values = numbers_by_name(options.get("set"), "option --set")
    model = valued(model, values, "option --set")
    fixed = {select_parameters(model, [name])[0] for name in values}
    remembered = {f"effects.{e}.{p}" for e, parts in saved.effects.items() for p in parts} if saved else set()
    return RequestedModel(model, frozenset(held | fixed), frozenset(given | fixed), frozenset(remembered))


def require_given(requested: RequestedModel, own: bool, options: ModelOptions) -> None:
    """**Raises:** `InputError` for a parameter without a value; `own`: the tyre has values of its own."""
    missing = [name for name in requested.free if name not in requested.given]
    effects = [name.split(".", 1)[1] for name in missing if name.startswith("effects.")]
    if effects:
        effect, parameter = effects[0].split(".", 1)
        what = f"Effect `{effect}` has no value for `{parameter}`"
        raise InputError(what, WITH, f"write {effect}:{parameter}=NUMBER")
    tyre = [short_name(name) for name in missing if name.startswith("tyre.")]
    if tyre and not own:
        where = "option --set" if options.get("set") else "option --model"
        remedy = f"write --set {','.join(f'{name}=NUMBER' for name in tyre)}, or name a saved fit with --from"
        raise InputError(f"{', '.join(tyre)} {'has' if len(tyre) == 1 else 'have'} no value", where, remedy)


def _base(
    subject: Case | Preset, saved: SavedFit | None, kind: str | None, skid: str | None, switched: bool
) -> tuple[AbstractVehicle, AbstractTyre, str]:
    board = vehicle_of(subject)
    kind = saved.model if saved else kind
    usual = "coupled" if isinstance(subject, Preset) else subject.constraint
    constraint = "free" if switched else skid or (saved.constraint if saved else usual)
    if kind == "ideal":
        constraint = "ideal"
    if kind is None and isinstance(subject, Preset):
        return board, subject.model.tyre, constraint
    return board, starting_tyre(kind or "pacejka", board), constraint


def vehicle_of(subject: Case | Preset) -> AbstractVehicle:
    """The vehicle of a case or preset."""
    return subject.model.board if isinstance(subject, Preset) else subject.board


def saved_effects(
    named: Mapping[str, NamedEffect], saved: SavedFit | None, vehicle: AbstractVehicle
) -> tuple[OrderedDict[str, Effect], set[str], set[str]]:
    """The effects by name, the names of their fixed parameters, and of all with a given value."""
    remembered = dict(saved.effects) if saved else {}
    built_in = {**library(vehicle), **(saved.kinds if saved else {})}
    effects: OrderedDict[str, Effect] = OrderedDict()
    held, given = set(), set()
    for name in [*remembered, *(n for n in named if n not in remembered)]:
        if name not in named and name not in built_in:
            what = f"The saved fit has the effect `{name}`, which is not built in"
            raise InputError(what, "option --from", "give its file with --with FILE.py:Class")
        one = named.get(name, NamedEffect(name, built_in.get(name), {}, {}))
        assert one.kind is not None
        values = {**one.start, **remembered.get(name, {}), **one.values}
        effects[name] = built(name, one.kind, {**one.kind.secant_step, **values}, WITH)
        held |= {f"effects.{name}.{parameter}" for parameter in one.values}
        given |= {f"effects.{name}.{parameter}" for parameter in values}
    return effects, held, given


def valued(model: Model, values: Mapping[str, float], where: str) -> Model:
    """`model` with `values`. **Raises:** `InputError` at `where` for an unknown name or an inadmissible value."""
    try:
        return with_parameters(model, {dotted(model, name, where): value for name, value in values.items()})
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error).rstrip("."), where, "give a value inside its domain") from None


def dotted(model: Model, name: str, where: str) -> str:
    """The full name of the one parameter that `name` matches. **Raises:** `InputError` where none or several do."""
    if name == "k_s" and "tyre.k_s" not in parameters(model):
        raise InputError("Only the Rayleigh tyre has the parameter `k_s`", where, "add --model rayleigh")
    try:
        matching = select_parameters(model, [name])
    except InputError as error:
        raise InputError(error.what, where, error.remedy) from None
    if len(matching) > 1:
        remedy = f"write one of {', '.join(map(short_name, matching))}"
        raise InputError(f"`{name}` matches {len(matching)} parameters", where, remedy)
    return matching[0]
