"""The heading of a result: case, model, noise and provenance."""

import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

from snakejax.core.parameter import own_parameters
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Bakker, Rayleigh
from snakejax.recording.run import Noise

from .values import Json

SCHEMA = 1
"""Version of the keys of the JSON; docs/json.md describes it."""
LIBRARIES = ("snakejax", "jax", "jaxlib", "diffrax", "optimistix", "equinox", "numpy")


def heading_json(name: str, model: Model, noise: Noise | None, provenance: Json) -> Json:
    """The first keys of every result; `name` is that of the case."""
    return {
        "schema": SCHEMA,
        "case": name,
        "model": model_kind(model),
        "skid": constraint_kind(model),
        "vehicle": vehicle_json(model),
        "noise": noise and noise_json(noise),
        "provenance": provenance,
    }


def vehicle_json(model: Model) -> Json:
    """The kind of the vehicle, the name of its class where it is one of your own, and its constants."""
    constants = {name: {"value": float(p.value), "unit": p.domain.unit} for name, p in own_parameters(model.board)}
    return {"kind": model.board.kind or type(model.board).__name__, "constants": constants}


def model_kind(model: Model) -> str:
    """`pacejka`, `rayleigh`, `bakker` or `ideal`, as JSON names the model."""
    if not model.constraint.slips:
        return "ideal"
    return {Rayleigh: "rayleigh", Bakker: "bakker"}.get(type(model.tyre), "pacejka")


def constraint_kind(model: Model) -> str:
    """The name of the constraint structure."""
    return model.structure


def noise_json(noise: Noise) -> Json:
    """The noise that scales the residuals."""
    return {"position_m": float(noise.position), "heading_rad": float(noise.heading), "source": noise.source}


def provenance_json(seed: int, options: Mapping[str, Any], sha256: Mapping[str, str]) -> Json:
    """Versions, seed, given options, and the SHA-256 of each input file."""
    return {"versions": versions(), "seed": seed, "options": dict(options), "sha256": dict(sha256)}


def versions() -> dict[str, str]:
    """Python and the libraries that the numbers depend on."""
    by_name = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            by_name[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            by_name[name] = "unknown"
    return by_name


def seconds_json(total: float, compiling: float) -> Json:
    """Duration of the computation [s], and of the compilation in it."""
    return {"total": round(total, 3), "compile": round(compiling, 3)}
