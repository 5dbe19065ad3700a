"""What the JSON of a command is held against: the schema that is shipped."""

from typing import Any

from jsonschema import Draft202012Validator

from snakejax.present.as_json.schema import schema_of


def deviations(command: str, written: Any) -> list[str]:
    """Where `written` does not follow the schema of `command`."""
    errors = Draft202012Validator(schema_of(command)).iter_errors(written)
    return [f"{'/'.join(map(str, error.absolute_path))}: {error.message[:300]}" for error in errors]
