"""Reading of saved fits."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from snakejax.core.errors import InputError, at_line
from snakejax.dynamics.conditions import FURTHEST, Difference, by_condition
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.kinds import MODEL_KINDS, STRUCTURES
from snakejax.dynamics.law import Law, law
from snakejax.dynamics.ports import Effect

from .values import EXPRESSION, LABEL


class SavedFit(NamedTuple):
    """A saved fit: `values` of its parameters by short name, of estimated constants too; `effects` {effect: {parameter:
    value}}; the kind of the `vehicle` and its constants, None in files of versions that did not write them; the `kinds`
    of effects that the file itself defines: laws, and differences by condition."""

    model: str
    constraint: str
    values: dict[str, float]
    effects: dict[str, dict[str, float]]
    vehicle: tuple[str, dict[str, float]] | None = None
    kinds: Mapping[str, type[Effect]] = MappingProxyType({})


def saved_fit(path: Path | str) -> SavedFit:
    """The model in a result of `fit` or `explain`; from its `final` part where there is one.

    **Raises:** `InputError` where the file does not hold such a result.
    """
    return _saved(result_of(path), path)


def saved_models(path: Path | str) -> dict[str, SavedFit]:
    """The models in a result by name: "base", each step of `explain` by what it added or dropped, and "final".

    Steps of files that do not hold their models are left out. **Raises:** `InputError` as `saved_fit`.
    """
    result = result_of(path)
    models = {}
    try:
        if "base" in result:
            models["base"] = _saved({key: part for key, part in result.items() if key != "final"}, path)
        for step in result.get("steps", ()):
            if "fitted" in step:
                models[str(step.get("added") or step.get("dropped"))] = _saved(
                    {**result, "final": step["fitted"]}, path
                )
    except (TypeError, AttributeError):
        raise InputError("The file does not hold a fit", str(path), _REMEDY) from None
    return {**models, "final": _saved(result, path)}


_REMEDY = "name a file that `snakejax fit CASE --json FILE` wrote"


def result_of(path: Path | str) -> dict[str, Any]:
    """The JSON at `path`. **Raises:** `InputError` where it is none."""
    try:
        result = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"Cannot read the saved fit ({error.strerror})", str(path), _REMEDY) from None
    except UnicodeDecodeError:
        raise InputError("The saved fit is not text", str(path), _REMEDY) from None
    except json.JSONDecodeError as error:
        raise InputError(f"The saved fit is not JSON ({error.msg})", at_line(path, error.lineno), _REMEDY) from None
    if not isinstance(result, dict):
        raise InputError("The file does not hold a fit", str(path), _REMEDY)
    return result


def _saved(result: dict[str, Any], path: Path | str) -> SavedFit:
    try:
        part = result.get("final") or result["base"]
        values = {name: float(entry["value"]) for name, entry in part["parameters"].items()}
        # Constants that `explain` estimated belong to the saved model as its other parameters do.
        values |= {f"board.{name}": float(entry["value"]) for name, entry in (part.get("constants") or {}).items()}
        effects = {
            effect: {name: float(entry["value"]) for name, entry in entries.items() if name != EXPRESSION}
            for effect, entries in (part.get("effects") or {}).items()
            if effect != LATERAL_SLIP_SWITCH  # It is the structure.
        }
        kinds = {effect: kind for effect, entries in (part.get("effects") or {}).items() if (kind := _kind(entries))}
        kind, structure = part.get("model", result["model"]), part.get("skid", result["skid"])
        vehicle = part.get("vehicle", result.get("vehicle"))
        if vehicle is not None:
            vehicle = vehicle["kind"], {name: float(c["value"]) for name, c in vehicle["constants"].items()}
        saved = SavedFit(kind, structure, values, effects, vehicle, kinds)
    except (KeyError, TypeError, AttributeError, ValueError):
        raise InputError("The file does not hold a fit", str(path), _REMEDY) from None
    if saved.model not in MODEL_KINDS or saved.constraint not in STRUCTURES:
        raise InputError(
            f"The saved model is `{saved.model}`, `{saved.constraint}`, which no fit has", str(path), _REMEDY
        )
    return saved


def _kind(entries: Mapping[str, Any]) -> type[Effect] | None:
    """The class of effects that `entries` of a result define; None where they name one of a library."""
    if EXPRESSION in entries:
        return type(_law(entries))
    if not any(isinstance(entry, Mapping) and LABEL in entry for entry in entries.values()):
        return None
    key = str(next(iter(entries.values()))["by"])
    return by_condition(key, tuple(_difference(field, entry) for field, entry in entries.items()))


def _difference(field: str, entry: Mapping[str, Any]) -> Difference:
    """How parameters differ in runs with a label, as an `entry` of a result says."""
    low, high = (1 / FURTHEST, FURTHEST) if entry["ratio"] else (-math.inf, math.inf)
    return Difference(field, tuple(entry["of"]), entry[LABEL], entry["ratio"], entry["unit"], low, high)


def _law(entries: Mapping[str, Any]) -> Law:
    """The law that `entries` of a result describe."""
    parameters = {name: entry for name, entry in entries.items() if name != EXPRESSION}
    units = {name: str(entry["unit"]) for name, entry in parameters.items()}
    return law(entries[EXPRESSION], units, {name: float(entry["value"]) for name, entry in parameters.items()})
