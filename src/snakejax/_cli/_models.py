"""From options to a model: `--model`, `--skid`, `--from`, `--effect`, `--set`."""

import argparse
from collections import OrderedDict
from collections.abc import Mapping
from typing import NamedTuple

from .._bench import LATERAL_SKID
from .._board import Board
from .._effect import Effect
from .._errors import InputError, instead_of
from .._model import Model
from .._presets import Preset
from .._recording import Case
from .._saved import SavedFit, saved_fit
from .._starting import chosen, default_free, starting_tyre
from .._tyre import AbstractTyre
from .._units import own_parameters, parameters, with_parameters
from ..effects import LIBRARY
from ._options import EffectSpec, assignments, effect_spec
from ._own import own_module


class Wanted(NamedTuple):
    """The model that the options ask for; `held`, the parameters given a value to keep; `given`, all given a value."""

    model: Model
    held: frozenset[str]
    given: frozenset[str]

    @property
    def free(self) -> list[str]:
        """What a fit frees unasked: the tyre's parameters and the effects' that are not held."""
        return [name for name in default_free(self.model) if name not in self.held]

    def freed(self, patterns: list[str] | None) -> list[str]:
        """What a fit frees: what `--free` names and the effects' parameters without a value, or else `free`."""
        if patterns is None:
            return self.free
        named = chosen(self.model, patterns)
        return [*named, *(n for n in self.free if n.startswith("effects.") and n not in named)]


def wanted_model(options: argparse.Namespace, subject: Case | Preset) -> Wanted:
    """The model for `subject`. **Raises:** `InputError` where the options do not make one."""
    saved = saved_fit(options.saved) if options.saved else None
    if saved and options.model and options.model != saved.model:
        what = f"The saved fit is of the model `{saved.model}`, not `{options.model}`"
        raise InputError(what, f"option --from {options.saved}", "leave out --model")
    specs = [effect_spec(text) for text in options.effect or ()]
    switched = [spec for spec in specs if spec.name == LATERAL_SKID]
    if any(spec.values for spec in switched):
        raise InputError(f"`{LATERAL_SKID}` has no parameters", "option --effect", f"write {LATERAL_SKID} alone")
    specs = [spec for spec in specs if spec.name != LATERAL_SKID]
    board, tyre, skid = _base(options, subject, saved, bool(switched))
    effects, held, given = _effects(specs, saved)
    try:
        model = Model(board, tyre, skid, effects)
    except ValueError as error:
        raise InputError(str(error).rstrip("."), "option --effect", "leave it out or take another --skid") from None
    if saved:
        model = valued(model, saved.values, f"option --from {options.saved}")
        given |= {chosen(model, [name])[0] for name in saved.values}
    values = assignments(",".join(options.set or ()), "option --set")
    model = valued(model, values, "option --set")
    named = {chosen(model, [name])[0] for name in values}
    return Wanted(model, frozenset(held | named), frozenset(given | named))


def require_given(options: argparse.Namespace, wanted: Wanted, own: bool) -> None:
    """**Raises:** `InputError` for a parameter that has no value; `own`: the tyre has values of its own."""
    missing = [name for name in wanted.free if name not in wanted.given]
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
) -> tuple[Board, AbstractTyre, str]:
    is_preset = isinstance(subject, Preset)
    board = subject.model.board if is_preset else subject.board
    kind = saved.model if saved else options.model
    usual = "coupled" if is_preset else subject.skid
    skid = "free" if switched else options.skid or (saved.skid if saved else usual)
    if kind == "ideal":
        skid = "ideal"
    if kind is None and is_preset:
        return board, subject.model.tyre, skid
    return board, starting_tyre(kind or "pacejka", board), skid


def _effects(specs: list[EffectSpec], saved: SavedFit | None) -> tuple[OrderedDict[str, Effect], set[str], set[str]]:
    """The effects by name, the names of the parameters held, and of those given a value."""
    remembered = dict(saved.effects) if saved else {}
    named = {spec.name: spec for spec in specs}
    if len(named) < len(specs):
        raise InputError("An effect is given twice", "option --effect", "give each once")
    effects: OrderedDict[str, Effect] = OrderedDict()
    held, given = set(), set()
    for name in [*remembered, *(n for n in named if n not in remembered)]:
        spec = named.get(name, EffectSpec(name, None, {}))
        if name not in named and name not in LIBRARY:
            what = f"The saved fit has the effect `{name}`, which is not built in"
            raise InputError(what, "option --from", "say where it is, with --effect FILE.py:Class")
        kind = effect_class(spec)
        values = {**remembered.get(name, {}), **spec.values}
        effects[name] = built(name, kind, {**kind.probe, **values})
        held |= {f"effects.{name}.{parameter}" for parameter in spec.values}
        given |= {f"effects.{name}.{parameter}" for parameter in values}
    return effects, held, given


def built(name: str, kind: type[Effect], values: Mapping[str, float]) -> Effect:
    """The effect `name`, of class `kind`, with `values`. **Raises:** `InputError`."""
    try:
        return kind(**values)
    except TypeError:
        known = [parameter for parameter, _ in own_parameters(kind())]
        wrong = next((n for n in values if n not in known), name)
        remedy = instead_of(wrong, known)
        raise InputError(f"Effect `{name}` has no parameter `{wrong}`", "option --effect", remedy) from None
    except ValueError as error:
        raise InputError(str(error).rstrip("."), "option --effect", "give a value inside its domain") from None


def effect_class(spec: EffectSpec) -> type[Effect]:
    """The class of an effect, built in or from a user's file. **Raises:** `InputError`."""
    if spec.source is None:
        if spec.name not in LIBRARY:
            known = [*LIBRARY, LATERAL_SKID]
            remedy = f"{instead_of(spec.name, known)}; one of your own is FILE.py:Class"
            raise InputError(f"There is no effect `{spec.name}`", "option --effect", remedy)
        return LIBRARY[spec.name]
    path, name = spec.source
    module = own_module(path, "option --effect", "my.py:Spring")
    found = getattr(module, name, None)
    if not (isinstance(found, type) and issubclass(found, Effect)):
        there = [
            n
            for n, c in vars(module).items()
            if isinstance(c, type) and issubclass(c, Effect) and c.__module__ == module.__name__
        ]
        raise InputError(f"`{path}` has no effect `{name}`", "option --effect", instead_of(name, there))
    return found


def valued(model: Model, values: Mapping[str, float], where: str) -> Model:
    """`model` with `values`; what is wrong with them is said of `where`."""
    try:
        return with_parameters(model, {dotted(model, name, where): value for name, value in values.items()})
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error).rstrip("."), where, "give a value inside its domain") from None


def dotted(model: Model, name: str, where: str) -> str:
    """The full name of the one parameter that `name` means. **Raises:** `InputError`."""
    if name == "k_s" and "tyre.k_s" not in parameters(model):
        raise InputError("Only the Rayleigh tyre has a `k_s`", where, "add --model rayleigh")
    try:
        found = chosen(model, [name])
    except InputError as error:
        raise InputError(error.what, where, error.remedy) from None
    if len(found) > 1:
        raise InputError(f"`{name}` names {len(found)} parameters", where, f"write one of {', '.join(found)}")
    return found[0]
