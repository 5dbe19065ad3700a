"""The model that `--model`, `--skid`, `--from`, `--effect` and `--set` describe."""

import argparse
from collections import OrderedDict
from collections.abc import Mapping
from typing import NamedTuple

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import own_parameters, parameters, with_parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.dynamics.tyres import AbstractTyre
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.effects import LIBRARY, library
from snakejax.estimation.initial_model import default_free, select_parameters, starting_tyre
from snakejax.present.as_json.saved import SavedFit, saved_fit
from snakejax.recording.run import Case
from snakejax.vehicles.snakeboard.paper_examples import Preset

from .options import EffectSpec, assignments, effect_spec
from .user_code import user_module


class RequestedModel(NamedTuple):
    """The requested model; `held`, the names of its fixed parameters; `given`, of all parameters with a given value."""

    model: Model
    held: frozenset[str]
    given: frozenset[str]

    @property
    def free(self) -> list[str]:
        """The parameters that a fit estimates by default: those of tyre and effects that are not fixed."""
        return [name for name in default_free(self.model) if name not in self.held]

    def freed(self, patterns: list[str] | None) -> list[str]:
        """The parameters that a fit estimates: those `patterns` name and the effects' without a value; or `free`."""
        if patterns is None:
            return self.free
        named = select_parameters(self.model, patterns)
        return [*named, *(n for n in self.free if n.startswith("effects.") and n not in named)]


def requested_model(options: argparse.Namespace, subject: Case | Preset) -> RequestedModel:
    """The requested model of `subject`. **Raises:** `InputError` where the options describe none."""
    saved = saved_fit(options.saved) if options.saved else None
    if saved and options.model and options.model != saved.model:
        what = f"The saved fit is of the model `{saved.model}`, not `{options.model}`"
        raise InputError(what, f"option --from {options.saved}", "leave out --model")
    specs = [effect_spec(text) for text in options.effect or ()]
    switched = [spec for spec in specs if spec.name == LATERAL_SLIP_SWITCH]
    if any(spec.values for spec in switched):
        raise InputError(
            f"`{LATERAL_SLIP_SWITCH}` has no parameters", "option --effect", f"write {LATERAL_SLIP_SWITCH} alone"
        )
    specs = [spec for spec in specs if spec.name != LATERAL_SLIP_SWITCH]
    board, tyre, constraint = _base(options, subject, saved, bool(switched))
    effects, held, given = _effects(specs, saved, board)
    try:
        model = Model(board, tyre, constraint, effects)
    except ValueError as error:
        raise InputError(str(error).rstrip("."), "option --effect", "leave it out or choose another --skid") from None
    if saved:
        model = valued(model, saved.values, f"option --from {options.saved}")
        given |= {select_parameters(model, [name])[0] for name in saved.values}
    values = assignments(",".join(options.set or ()), "option --set")
    model = valued(model, values, "option --set")
    named = {select_parameters(model, [name])[0] for name in values}
    return RequestedModel(model, frozenset(held | named), frozenset(given | named))


def require_given(options: argparse.Namespace, requested: RequestedModel, own: bool) -> None:
    """**Raises:** `InputError` for a parameter without a value; `own`: the tyre has values of its own."""
    missing = [name for name in requested.free if name not in requested.given]
    effects = [name.split(".", 1)[1] for name in missing if name.startswith("effects.")]
    if effects:
        effect, parameter = effects[0].split(".", 1)
        what = f"Effect `{effect}` has no value for `{parameter}`"
        raise InputError(what, "option --effect", f"write {effect}:{parameter}=NUMBER")
    tyre = [name.removeprefix("tyre.") for name in missing if name.startswith("tyre.")]
    if tyre and not own:
        where = "option --set" if options.set else "option --model"
        remedy = f"write --set {','.join(f'{name}=NUMBER' for name in tyre)}, or name a saved fit with --from"
        raise InputError(f"{', '.join(tyre)} {'has' if len(tyre) == 1 else 'have'} no value", where, remedy)


def _base(
    options: argparse.Namespace, subject: Case | Preset, saved: SavedFit | None, switched: bool
) -> tuple[AbstractVehicle, AbstractTyre, str]:
    is_preset = isinstance(subject, Preset)
    board = subject.model.board if is_preset else subject.board
    kind = saved.model if saved else options.model
    usual = "coupled" if is_preset else subject.constraint
    constraint = "free" if switched else options.skid or (saved.constraint if saved else usual)
    if kind == "ideal":
        constraint = "ideal"
    if kind is None and is_preset:
        return board, subject.model.tyre, constraint
    return board, starting_tyre(kind or "pacejka", board), constraint


def _effects(
    specs: list[EffectSpec], saved: SavedFit | None, vehicle: AbstractVehicle
) -> tuple[OrderedDict[str, Effect], set[str], set[str]]:
    """The effects by name, the names of their fixed parameters, and of all with a given value."""
    remembered = dict(saved.effects) if saved else {}
    named = {spec.name: spec for spec in specs}
    if len(named) < len(specs):
        raise InputError("An effect is given twice", "option --effect", "give each once")
    effects: OrderedDict[str, Effect] = OrderedDict()
    held, given = set(), set()
    for name in [*remembered, *(n for n in named if n not in remembered)]:
        spec = named.get(name, EffectSpec(name, None, {}))
        if name not in named and name not in library(vehicle):
            what = f"The saved fit has the effect `{name}`, which is not built in"
            raise InputError(what, "option --from", "name its file with --effect FILE.py:Class")
        kind = effect_class(spec, vehicle)
        values = {**remembered.get(name, {}), **spec.values}
        effects[name] = built(name, kind, {**kind.secant_step, **values})
        held |= {f"effects.{name}.{parameter}" for parameter in spec.values}
        given |= {f"effects.{name}.{parameter}" for parameter in values}
    return effects, held, given


def built(name: str, kind: type[Effect], values: Mapping[str, float]) -> Effect:
    """The effect `name` of class `kind` with `values`. **Raises:** `InputError` for an inadmissible value."""
    try:
        return kind(**values)
    except TypeError:
        known = [parameter for parameter, _ in own_parameters(kind())]
        wrong = next((n for n in values if n not in known), name)
        remedy = instead_of(wrong, known)
        raise InputError(f"Effect `{name}` has no parameter `{wrong}`", "option --effect", remedy) from None
    except ValueError as error:
        raise InputError(str(error).rstrip("."), "option --effect", "give a value inside its domain") from None


def effect_class(spec: EffectSpec, vehicle: AbstractVehicle | None = None) -> type[Effect]:
    """The class of an effect of `vehicle` (default: a snakeboard), built in or from a user's file.

    **Raises:** `InputError` where there is none.
    """
    if spec.source is None:
        known_effects = LIBRARY if vehicle is None else library(vehicle)
        if spec.name not in known_effects:
            known = [*known_effects, LATERAL_SLIP_SWITCH]
            remedy = f"{instead_of(spec.name, known)}; write your own as FILE.py:Class"
            raise InputError(f"There is no effect `{spec.name}`", "option --effect", remedy)
        return known_effects[spec.name]
    path, name = spec.source
    module = user_module(path, "option --effect", "my.py:Spring")
    found_class = getattr(module, name, None)
    if not (isinstance(found_class, type) and issubclass(found_class, Effect)):
        effects = [
            n
            for n, c in vars(module).items()
            if isinstance(c, type) and issubclass(c, Effect) and c.__module__ == module.__name__
        ]
        raise InputError(f"`{path}` has no effect `{name}`", "option --effect", instead_of(name, effects))
    return found_class


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
        raise InputError(f"`{name}` matches {len(matching)} parameters", where, f"write one of {', '.join(matching)}")
    return matching[0]
