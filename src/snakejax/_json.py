"""Results as plain dictionaries ready for JSON, saved fits read back, and files written whole or not at all.

Each part of a result has its function (`parameters_json`, `score_json`, ...), so that every command writes the same
words for the same thing; `clean` turns what is no finite number into null.
"""

import importlib.metadata
import json
import math
import os
import platform
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ._compare import Comparison, Side
from ._errors import InputError, at_line
from ._estimates import Estimate
from ._fit import Fit
from ._misfit import RunScore, Score
from ._model import Model
from ._recording import Case, Noise, Run
from ._skid import SKIDS, Ideal
from ._starting import MODELS
from ._tyre import Bakker, Rayleigh
from ._units import parameters
from .quality import Inspection

SCHEMA = 1
LIBRARIES = ("snakejax", "jax", "jaxlib", "diffrax", "optimistix", "equinox", "numpy")

Json = dict[str, Any]


def clean(value: Any) -> Any:
    """`value` with arrays as lists, tuples as lists, and every number that is not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): clean(part) for key, part in value.items()}
    if isinstance(value, np.ndarray) or hasattr(value, "__array__"):
        return clean(np.asarray(value).tolist())
    if isinstance(value, list | tuple):
        return [clean(part) for part in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


# The parts of a result.


def short(name: str) -> str:
    """A parameter as a reader knows it: `B` for `tyre.B`, and the dotted name for all others."""
    return name.removeprefix("tyre.")


def estimate_json(estimate: Estimate, interval: tuple[float | None, float | None] | None = None) -> Json:
    """One estimate; `interval`, where given, is that of its profile and stands in for value +- 1.96 sd."""
    return {
        "value": estimate.value,
        "sd": estimate.sd,
        "unit": estimate.unit,
        "determined": estimate.determined,
        "interval": estimate.interval() if interval is None else interval,
        "interval_from": "profile" if interval is not None else "sd",
        "at_bound": estimate.at_bound,
    }


def held_json(value: float, unit: str) -> Json:
    """A parameter that was given, not estimated."""
    return {"value": value, "sd": None, "unit": unit, "determined": None, "held": True}


def all_parameters_json(
    model: Model,
    estimates: Mapping[str, Estimate] | None = None,
    intervals: Mapping[str, tuple[float | None, float | None]] | None = None,
) -> dict[str, Json]:
    """What is known of each tyre parameter of `model`, of each of its effects' and of each other one estimated."""
    estimates, intervals, found = estimates or {}, intervals or {}, {}
    for name, (value, domain) in parameters(model).items():
        if name in estimates:
            found[name] = estimate_json(estimates[name], intervals.get(name))
        elif name.startswith(("tyre.", "effects.")) and not (name in ("tyre.dSh", "tyre.dSv") and float(value) == 0):
            found[name] = held_json(float(value), domain.unit)
    if isinstance(model.skid, Ideal):
        found = {name: part for name, part in found.items() if not name.startswith("tyre.")}
    return found


def parameters_json(found: Mapping[str, Json]) -> Json:
    """Those of `all_parameters_json` that belong to no effect, by their short names."""
    return {short(name): part for name, part in found.items() if not name.startswith("effects.")}


def effects_json(found: Mapping[str, Json], model: Model) -> Json:
    """Those of `all_parameters_json` that belong to effects: {effect: {parameter: ...}}."""
    grouped: Json = {name: {} for name in model.effects}
    for name, part in found.items():
        if name.startswith("effects."):
            _, effect, parameter = name.split(".", 2)
            grouped[effect][parameter] = part
    return grouped


def misfit_json(train: Score | None, heldout: Score | None) -> Json:
    """Mean squared residuals in units of the noise variance."""
    return {"train": train and train.misfit, "heldout": heldout and heldout.misfit}


def score_json(score: Score | None) -> Json | None:
    """Root mean squared errors."""
    return score and {"position_m": score.position_m, "heading_rad": score.heading_rad}


def rmse_json(train: Score | None, heldout: Score | None) -> Json:
    """Root mean squared errors of both roles."""
    return {"train": score_json(train), "heldout": score_json(heldout)}


def quality_json(seen: Inspection) -> Json:
    """What was found in the recordings, what was done about it, and how many frames count as lost for it."""
    return {
        "as_recorded": seen.as_recorded,
        "findings": [
            {
                "kind": f.kind,
                "run": f.run,
                "from_s": f.start,
                "to_s": f.end,
                "size": f.size,
                "unit": f.unit,
                "what": f.what,
                "remedy": f.remedy,
                "action": f.action,
                "applied": f.applied,
                "severity": f.severity,
            }
            for f in seen.findings
        ],
        "masked": seen.masked,
    }


def joint_logs_json(runs: Sequence[Run]) -> Json:
    """How the clocks of the joint logs go, where there are any."""
    logs = [{"run": run.name, **run.log._asdict()} for run in runs if run.log is not None]
    renamed = {"offset": "offset_s", "offset_sd": "offset_sd_s", "free": "estimated"}
    return {"joint_logs": [{renamed.get(k, k): v for k, v in log.items()} for log in logs]} if logs else {}


def run_json(score: RunScore) -> Json:
    """How one run fares."""
    return {
        "run": score.run,
        "role": score.role,
        "misfit": score.misfit,
        "worst_time_s": score.worst_time_s,
        "channels": score.channels,
        "rmse": {"position_m": score.position_m, "heading_rad": score.heading_rad},
    }


def runs_json(scores: Sequence[RunScore]) -> list[Json]:
    """How each run fares."""
    return [run_json(score) for score in scores]


def combinations_json(combinations: Mapping[str, Estimate]) -> Json:
    """The combinations of parameters that were estimated."""
    return {name: estimate_json(estimate) for name, estimate in combinations.items()}


def correlation_json(found: Fit) -> Json:
    """The correlation of the estimates: `names`, and `matrix` in that order."""
    return {"names": [short(name) for name in found.optimum.loose], "matrix": found.correlation}


def comparison_json(failing: Comparison, sides: Sequence[Side] = ()) -> Json:
    """Where a model fails; `models`, where several were put side by side."""
    return {
        "white": failing.white,
        "whiteness": [
            {"run": t.run, "channel": t.channel, "statistic": t.statistic, "lags": t.lags, "p_value": t.p_value}
            for t in failing.whiteness
        ],
        "depends_on": [
            {"variable": s.variable, "channel": s.channel, "share": s.share, "p_value": s.p_family}
            for s in failing.depends_on
        ],
        "worst": [
            {
                "run": m.run,
                "time_s": m.time,
                "channel": m.channel,
                "residual_sd": m.deviations,
                "residual": m.size,
                "unit": channel_unit(m.channel),
            }
            for m in failing.worst
        ],
        "stretches": [
            {"run": s.run, "channel": s.channel, "begin_s": s.begin, "end_s": s.end, "misfit": s.misfit}
            for s in failing.stretches
        ],
        "models": [
            {
                "model": side.model,
                "misfit": misfit_json(side.train, side.heldout),
                "rmse": rmse_json(side.train, side.heldout),
                "failure": side.failure,
            }
            for side in sides
        ],
    }


def channel_unit(channel: str) -> str:
    """The unit of x, y or heading."""
    return "rad" if channel == "heading" else "m"


def noise_json(noise: Noise) -> Json:
    """The noise that residuals are measured in."""
    return {"position_m": float(noise.position), "heading_rad": float(noise.heading), "source": noise.source}


def versions() -> dict[str, str]:
    """Python and the libraries that the numbers depend on."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def provenance_json(seed: int, options: Mapping[str, Any], sha256: Mapping[str, str]) -> Json:
    """What produced a result: versions, seed, the options given, and the SHA-256 of each input file."""
    return {"versions": versions(), "seed": seed, "options": dict(options), "sha256": dict(sha256)}


def model_kind(model: Model) -> str:
    """`pacejka`, `rayleigh`, `bakker` or `ideal`, as JSON names the model."""
    if isinstance(model.skid, Ideal):
        return "ideal"
    return {Rayleigh: "rayleigh", Bakker: "bakker"}.get(type(model.tyre), "pacejka")


def skid_kind(model: Model) -> str:
    """The structure's name."""
    names = [name for name, kind in SKIDS.items() if isinstance(model.skid, kind)]
    return names[0] if names else type(model.skid).__name__


def seconds_json(total: float, compiling: float) -> Json:
    """How long it took, and how much of it was compilation."""
    return {"total": round(total, 3), "compile": round(compiling, 3)}


# Whole results.


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


def base_json(found: Fit, intervals: Mapping[str, tuple[float | None, float | None]] | None = None) -> Json:
    """A fit as the base of a result."""
    parts = all_parameters_json(found.model, found.estimates, intervals)
    return {
        "parameters": parameters_json(parts),
        "effects": effects_json(parts, found.model),
        "misfit": misfit_json(found.train_score, found.heldout_score),
        "rmse": rmse_json(found.train_score, found.heldout_score),
    }


def fit_json(
    case: Case,
    noise: Noise,
    found: Fit,
    provenance: Json,
    intervals: Mapping[str, tuple[float | None, float | None]] | None = None,
    seconds: Json | None = None,
) -> Json:
    """The result of `snakejax fit`."""
    return clean(
        {
            **heading_json(case.name, found.model, noise, provenance),
            "base": base_json(found, intervals),
            "runs": runs_json([*found.runs, *found.heldout]),
            "correlation": correlation_json(found),
            "combinations": combinations_json(found.combinations),
            "advice": list(found.advice),
            **joint_logs_json(found.study.runs),
            "converged": found.optimum.converged,
            "seconds": seconds,
        }
    )


# Saved fits.


class SavedFit(NamedTuple):
    """A fit read back: `values` of its parameters by short name, `effects` {effect: {parameter: value}}."""

    model: str
    skid: str
    values: dict[str, float]
    effects: dict[str, dict[str, float]]


def saved_fit(path: Path | str) -> SavedFit:
    """The model of a result of `fit` or `explain`, of its `final` part where there is one.

    **Raises:** `InputError` where the file is none.
    """
    remedy = "name a file that `snakejax fit CASE --json FILE` wrote"
    try:
        whole = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"Cannot read the saved fit ({error.strerror})", str(path), remedy) from None
    except UnicodeDecodeError:
        raise InputError("The saved fit is no text", str(path), remedy) from None
    except json.JSONDecodeError as error:
        raise InputError(f"The saved fit is no JSON ({error.msg})", at_line(path, error.lineno), remedy) from None
    try:
        part = whole.get("final") or whole["base"]
        values = {name: float(entry["value"]) for name, entry in part["parameters"].items()}
        effects = {
            effect: {name: float(entry["value"]) for name, entry in entries.items()}
            for effect, entries in (part.get("effects") or {}).items()
        }
        saved = SavedFit(part.get("model", whole["model"]), part.get("skid", whole["skid"]), values, effects)
    except (KeyError, TypeError, AttributeError, ValueError):
        raise InputError("The file holds no fit", str(path), remedy) from None
    if saved.model not in MODELS or saved.skid not in SKIDS:
        raise InputError(f"The saved model is `{saved.model}`, `{saved.skid}`, which no fit has", str(path), remedy)
    return saved


# Files.


def as_text(result: Any) -> str:
    """`result` as JSON text."""
    return json.dumps(clean(result), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_whole(path: Path | str, text: str | bytes) -> Path:
    """Write `text` to `path`, which is there whole or, where the program is stopped, as it was before.

    **Raises:** `InputError` where it cannot be written.
    """
    path = Path(path)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(text.encode() if isinstance(text, str) else text)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        what = f"Cannot write ({error.strerror})"
        raise InputError(what, str(path), "name a file in a folder you may write to") from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
    return path


def require_writable(path: Path | str) -> None:
    """**Raises:** `InputError` where a file at `path` could not be written, said before the work and not after it."""
    path = Path(path).absolute()
    there = next(parent for parent in path.parents if parent.exists())
    if path.is_dir() or not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise InputError("Cannot write there", str(path), "name a file in a folder you may write to")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
