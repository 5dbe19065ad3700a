"""Sweeps against single runs."""

import numpy as np
import pytest

from snakejax import Accuracy, grid, nearest_rayleigh, preset, simulate, sweep, table
from snakejax.core.parameter import with_parameters
from snakejax.effects import BodyDrag

SHARP = Accuracy(rtol=1e-9, atol=1e-11)


@pytest.mark.slow
def test_a_grid_has_an_axis_for_each_parameter_and_the_poses_of_single_runs() -> None:
    example = preset("paper-rotate")
    model = example.model.add(body_drag=BodyDrag())
    times = [0.5, 2.0]
    found = sweep(model, example.gait, times, {"tyre.D": [0.5, 2.0], "effects.body_drag.c": [0.0, 1.0, 3.0]})
    assert found.heading.dims == ("tyre.D", "effects.body_drag.c", "time")
    assert found["tyre.D"].attrs["units"] == "N" and found["effects.body_drag.c"].attrs["units"] == "N s/m"
    for D in (0.5, 2.0):
        for c in (0.0, 3.0):
            board = with_parameters(model, {"tyre.D": D, "effects.body_drag.c": c})
            alone = np.asarray(simulate(board, example.gait, times, accuracy=SHARP).pose)
            here = found.sel({"tyre.D": D, "effects.body_drag.c": c})
            np.testing.assert_allclose(np.stack([here.x, here.y, here.heading], axis=1), alone, atol=2e-6)


@pytest.mark.slow
def test_a_table_has_one_row_for_each_board() -> None:
    example = preset("paper-rotate")
    rows = table({"tyre.D": [0.5, 1.0], "board.mass": [6.0, 7.0]})
    found = sweep(example.model, example.gait, [2.0], rows, start=(1.0, 2.0, 3.0))
    assert found.x.dims == ("row", "time") and list(found["board.mass"].values) == [6.0, 7.0]
    same = sweep(example.model, example.gait, [2.0], grid({"tyre.D": [1.0]}), start=(1.0, 2.0, 3.0))
    np.testing.assert_array_equal(found.heading.values[1], same.heading.values[0])


@pytest.mark.parametrize(
    ("over", "why"),
    [
        ({}, "nothing to vary"),
        ({"tyre.D": []}, "nothing to vary"),
        ({"tyre.Q": [1.0]}, "no parameter `tyre.Q`"),
        ({"tyre.D": [1.0, -1.0]}, "`tyre.D` must be at least 0"),
        ({"tyre.D": [1.0, np.nan]}, "must be a finite number"),
    ],
)
def test_boards_that_cannot_be_are_refused(over, why) -> None:
    example = preset("paper-rotate")
    for question in (sweep, nearest_rayleigh):
        with pytest.raises(ValueError, match=why):
            question(example.model, example.gait, [1.0], over)
    with pytest.raises(ValueError, match=r"tyre\.D 2, tyre\.B 1"):
        table({"tyre.D": [1.0, 2.0], "tyre.B": [1.0]})
