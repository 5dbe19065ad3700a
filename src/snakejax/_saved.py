"""Saved fits, read back."""

import json
from pathlib import Path
from typing import NamedTuple

from ._errors import InputError, at_line
from ._skid import SKIDS
from ._starting import MODELS


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
