"""Effects as options name them: built in, in a file of the user, as a class or as an object."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from snakejax.core.errors import InputError, instead_of
from snakejax.core.parameter import own_parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.ports import Effect
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.effects import LIBRARY, library

from .option_texts import EffectSpec, effect_spec, snake_case
from .user_code import user_module

EffectArgument = str | type[Effect] | Effect
"""`NAME[:p=v,...]`, `FILE.py:Class[:p=v,...]`, a class of effects, or an effect with the values to start from."""
EffectArguments = EffectArgument | Iterable[EffectArgument] | Mapping[str, type[Effect] | Effect]


class NamedEffect(NamedTuple):
    """An effect `name` of class `kind` (None for `lateral_skid`), its fixed `values`, and those it starts from."""

    name: str
    kind: type[Effect] | None
    values: dict[str, float]
    start: dict[str, float]


def named_effects(given: EffectArguments | None, option: str, vehicle: AbstractVehicle) -> list[NamedEffect]:
    """The effects of `option`, such as "option --with", on `vehicle`.

    **Raises:** `InputError` for an unknown one or a repetition.
    """
    if given is None:
        return []
    if isinstance(given, Mapping):
        effects = [_of_class(name, effect) for name, effect in given.items()]
    elif isinstance(given, str | type | Effect):
        effects = [_named(given, option, vehicle)]
    else:
        effects = [_named(one, option, vehicle) for one in given]
    if len({one.name for one in effects}) < len(effects):
        raise InputError("An effect is given twice", option, "give each once")
    return effects


def _named(given: EffectArgument, option: str, vehicle: AbstractVehicle) -> NamedEffect:
    if not isinstance(given, str):
        kind = given if isinstance(given, type) else type(given)
        built_in = (name for name, known in library(vehicle).items() if known is kind)
        return _of_class(next(built_in, snake_case(kind.__name__)), given)
    spec = effect_spec(given, option)
    if spec.source is None and spec.name == LATERAL_SLIP_SWITCH:
        if spec.values:
            raise InputError(f"`{spec.name}` has no parameters", option, f"write {spec.name} alone")
        return NamedEffect(spec.name, None, {}, {})
    return NamedEffect(spec.name, effect_class(spec, vehicle, option), spec.values, {})


def _of_class(name: str, given: type[Effect] | Effect) -> NamedEffect:
    if isinstance(given, type):
        return NamedEffect(name, given, {}, {})
    return NamedEffect(name, type(given), {}, {part: float(p.value) for part, p in own_parameters(given)})


def effect_class(
    spec: EffectSpec, vehicle: AbstractVehicle | None = None, option: str = "option --effect"
) -> type[Effect]:
    """The class of an effect of `vehicle` (default: a snakeboard), built in or from a user's file.

    **Raises:** `InputError` where there is none.
    """
    if spec.source is None:
        built_in = LIBRARY if vehicle is None else library(vehicle)
        if spec.name not in built_in:
            known = [*built_in, LATERAL_SLIP_SWITCH]
            remedy = f"{instead_of(spec.name, known)}; write your own as FILE.py:Class"
            raise InputError(f"There is no effect `{spec.name}`", option, remedy)
        return built_in[spec.name]
    path, name = spec.source
    module = user_module(path, option, "my.py:Spring")
    found_class = getattr(module, name, None)
    if not (isinstance(found_class, type) and issubclass(found_class, Effect)):
        effects = [
            n
            for n, c in vars(module).items()
            if isinstance(c, type) and issubclass(c, Effect) and c.__module__ == module.__name__
        ]
        raise InputError(f"`{path}` has no effect `{name}`", option, instead_of(name, effects))
    return found_class


def built(name: str, kind: type[Effect], values: Mapping[str, float], option: str = "option --effect") -> Effect:
    """The effect `name` of class `kind` with `values`. **Raises:** `InputError` for an inadmissible value."""
    try:
        return kind(**values)
    except TypeError:
        known = [parameter for parameter, _ in own_parameters(kind())]
        wrong = next((n for n in values if n not in known), name)
        remedy = instead_of(wrong, known)
        raise InputError(f"Effect `{name}` has no parameter `{wrong}`", option, remedy) from None
    except ValueError as error:
        raise InputError(str(error).rstrip("."), option, "give a value inside its domain") from None


def barred_names(without: str | Iterable[str] | None) -> list[str]:
    """The names of `--without`."""
    return [without] if isinstance(without, str) else [*(without or ())]


def candidate_library(
    effect: EffectArguments | None, without: str | Iterable[str] | None, vehicle: AbstractVehicle
) -> dict[str, Effect]:
    """The candidates by name: the effects of `vehicle` and those of `--effect`, less those of `--without`.

    **Raises:** `InputError` for an unknown name, or a candidate with values.
    """
    candidates = {name: kind() for name, kind in library(vehicle).items()}
    for one in named_effects(effect, "option --effect", vehicle):
        if one.kind is None:
            continue
        if one.values:
            remedy = f"leave the values out, or put it into the model with --with {one.name}"
            raise InputError(f"The candidate `{one.name}` is estimated", "option --effect", remedy)
        candidates[one.name] = built(one.name, one.kind, one.start)
    barred = barred_names(without)
    known = [*candidates, LATERAL_SLIP_SWITCH]
    for name in barred:
        if name not in known:
            raise InputError(f"There is no effect `{name}`", "option --without", instead_of(name, known))
    return {name: effect for name, effect in candidates.items() if name not in barred}
