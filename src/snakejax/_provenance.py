"""What a result begins with: the case, the model, the noise, and what produced it."""

import importlib.metadata
import platform
from collections.abc import Mapping
from typing import Any

from ._json import Json
from ._model import Model
from ._recording import Noise
from ._skid import SKIDS, Ideal
from ._tyre import Bakker, Rayleigh

SCHEMA = 1
LIBRARIES = ("snakejax", "jax", "jaxlib", "diffrax", "optimistix", "equinox", "numpy")


def heading_json(name: str, model: Model, noise: Noise | None, provenance: Json) -> Json:
    """What every result begins with; `name` is that of the case."""
    return {
        "schema": SCHEMA,
        "case": name,
        "model": model_kind(model),
        "skid": skid_kind(model),
        "noise": noise and noise_json(noise),
        "provenance": provenance,
    }


def model_kind(model: Model) -> str:
    """`pacejka`, `rayleigh`, `bakker` or `ideal`, as JSON names the model."""
    if isinstance(model.skid, Ideal):
        return "ideal"
    return {Rayleigh: "rayleigh", Bakker: "bakker"}.get(type(model.tyre), "pacejka")


def skid_kind(model: Model) -> str:
    """The structure's name."""
    names = [name for name, kind in SKIDS.items() if isinstance(model.skid, kind)]
    return names[0] if names else type(model.skid).__name__


def noise_json(noise: Noise) -> Json:
    """The noise that residuals are measured in."""
    return {"position_m": float(noise.position), "heading_rad": float(noise.heading), "source": noise.source}


def provenance_json(seed: int, options: Mapping[str, Any], sha256: Mapping[str, str]) -> Json:
    """What produced a result: versions, seed, the options given, and the SHA-256 of each input file."""
    return {"versions": versions(), "seed": seed, "options": dict(options), "sha256": dict(sha256)}


def versions() -> dict[str, str]:
    """Python and the libraries that the numbers depend on."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def seconds_json(total: float, compiling: float) -> Json:
    """How long it took, and how much of it was compilation."""
    return {"total": round(total, 3), "compile": round(compiling, 3)}
