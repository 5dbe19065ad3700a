"""Windows of a run: what they are called and which run they are cut from."""

import jax.numpy as jnp
import numpy as np

from snakejax import Gait, Run, Sines
from snakejax.estimation.multiple_shooting import cut_windows


def test_windows_name_the_run_they_are_cut_from_whatever_it_is_called() -> None:
    times = jnp.arange(400.0) / 100
    still = Gait(Sines.of([]), Sines.of([]))
    run = Run(
        "board[3]", "heldout", times, jnp.zeros((400, 3)), still, jnp.asarray([2.0, 0.1]), wander=jnp.ones((400, 3, 2))
    )
    windows = cut_windows(run, 1.5)
    assert [window.name for window in windows] == ["board[3][0]", "board[3][1]", "board[3][2]"]
    assert {window.recorded_as for window in windows} == {run.recorded_as} == {"board[3]"}
    assert all(window.moving and window.role == "heldout" for window in windows)
    np.testing.assert_array_equal(np.concatenate([w.times for w in windows]), times)
    assert all(w.wander is not None and w.wander.shape == (w.times.size, 3, 2) for w in windows)
    assert all(np.array_equal(w.payload, run.payload) for w in windows)
