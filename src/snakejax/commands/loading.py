"""`load_model`: the model in a result of `fit` or `explain`."""

from pathlib import Path

from snakejax.core.errors import InputError, instead_of
from snakejax.core.jax_config import prepare_jax
from snakejax.dynamics.model import Model
from snakejax.estimation.initial_model import starting_tyre
from snakejax.present.as_json.saved import SavedFit, saved_fit, saved_models
from snakejax.vehicles.registry import VEHICLES, vehicle_class

from .named_effects import EffectArguments, named_effects
from .requested_model import WITH, saved_effects, valued


def load_model(path: Path | str, with_: EffectArguments | None = None) -> Model:
    """The model in the JSON of `fit`, `compare`, `diagnose`, `simulate` or `explain`: of `explain` the final one.

    Vehicle, tyre, structure and effects are as they were written, so that it gives the same simulation.

    **Arguments:** `path`: the JSON file; `with_`: effects of your own in it: "FILE.py:Class", a class, or by name.
    **Raises:** `InputError` for a file without a model, or an effect that is neither built in nor given.
    """
    prepare_jax()
    return model_of(saved_fit(path), path, with_)


def load_models(path: Path | str, with_: EffectArguments | None = None) -> dict[str, Model]:
    """All models in a result by name: "base", each step of `explain` by the effect that it added, and "final".

    **Arguments:** as `load_model`. **Raises:** `InputError` as `load_model`.
    """
    prepare_jax()
    return {name: model_of(saved, path, with_) for name, saved in saved_models(path).items()}


def model_of(saved: SavedFit, path: Path | str, with_: EffectArguments | None) -> Model:
    """The model of one `saved` fit in the file `path`. **Raises:** `InputError` as `load_model`."""
    if saved.vehicle is None:
        raise InputError("The file does not hold the vehicle", str(path), "write it anew with this version")
    kind, constants = saved.vehicle
    if kind not in VEHICLES:
        raise InputError(f"There is no vehicle `{kind}`", str(path), instead_of(kind, VEHICLES))
    try:
        board = vehicle_class(kind)(**constants)
        named = {one.name: one for one in named_effects(with_, WITH, board) if one.name in saved.effects}
        effects, _, _ = saved_effects(named, saved, board)
        model = Model(board, starting_tyre(saved.model, board), saved.constraint, effects)
    except (TypeError, ValueError) as error:
        raise InputError(str(error).rstrip("."), str(path), "write the file anew") from None
    return valued(model, saved.values, str(path))
