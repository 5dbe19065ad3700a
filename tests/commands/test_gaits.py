"""The gaits with which tuning begins."""

import dataclasses

import numpy as np
import pytest
from helpers.folders import DATA

from snakejax import Gait, InputError, load_case
from snakejax.commands.gaits import gaits_of
from snakejax.dynamics.sampled_signals import Held


def test_commands_that_jump_are_refused_before_any_fit() -> None:
    case = load_case(DATA / "level-board")
    times = np.arange(0.0, 12.0, 0.1)
    held = Gait(*(Held.of(times, size * np.sin(4 * times)) for size in (0.9, 1.6)))
    mixed = (dataclasses.replace(case.runs[0], gait=held), *case.runs[1:])
    assert len(gaits_of(dataclasses.replace(case, runs=mixed))[0]) == len(gaits_of(case)[0]) - 1
    with pytest.raises(InputError, match="jump or pass through an actuator"):
        gaits_of(dataclasses.replace(case, runs=mixed[:1]))
