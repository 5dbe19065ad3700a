"""The JSON Schema of the results (draft 2020-12), which `schema.json` beside this file holds."""

import json
from importlib.resources import files

from .values import Json


def schema_of(command: str) -> Json:
    """The JSON Schema of the result of a `command` ("fit", "explain", ...). **Raises:** `KeyError` for no command."""
    whole = json.loads(files(__package__).joinpath("schema.json").read_text(encoding="utf-8"))
    part = whole["$defs"][command]
    return {"$schema": whole["$schema"], "title": f"snakejax {command}", **part, "$defs": whole["$defs"]}
