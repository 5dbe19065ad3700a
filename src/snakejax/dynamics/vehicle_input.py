"""What a vehicle takes: an input has a name, a kind with its unit, and a word for messages."""

from typing import Literal, NamedTuple

INPUT_UNITS = {"angle": "rad", "speed": "m/s", "torque": "N m", "command": "-"}
"""Unit of an input of each kind."""
FOLLOWS_OPPOSITE = "-"
"""First character of `Input.follows` where the input that stands in is taken with the opposite sign."""


class Input(NamedTuple):
    """One input of a vehicle: an `angle` prescribes a joint, a `speed` the rim of a wheel; a `command` is raw.

    `name`: key in case.toml and column of a log; `label`: the word for it in messages and in names of effects;
    `follows`: the input that stands in where it is not given, as "-phi".
    """

    name: str
    kind: Literal["angle", "speed", "torque", "command"]
    label: str
    follows: str | None = None

    @property
    def unit(self) -> str:
        """Its unit."""
        return INPUT_UNITS[self.kind]
