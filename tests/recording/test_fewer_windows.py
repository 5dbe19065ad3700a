"""A tenth of the windows of a case."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Case, Gait, Run, Sines
from snakejax.core.errors import InputError
from snakejax.recording.fewer_windows import with_fewer_windows

GAIT = Gait(Sines.of([[0.35, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]]))
WINDOW = Run("window", "train", jnp.arange(5.0), jnp.zeros((5, 3)), GAIT)


def of_windows(**counts: int) -> Case:
    """A case with so many windows of each recording; `heldout_` begins the name of one that is held out."""
    windows: list[Run] = []
    for recording, count in counts.items():
        role = "heldout" if recording.startswith("heldout") else "train"
        windows += [
            dataclasses.replace(WINDOW, name=f"{recording}@{k}", role=role, cut_from=recording) for k in range(count)
        ]
    return Case("laps", "", "free", Board(**TABLE_II), tuple(windows))


def test_a_tenth_of_each_recording_is_kept_and_at_least_one_window() -> None:
    kept = with_fewer_windows(of_windows(slow=3, laps=40, ramp=11, heldout_ramp=10))
    assert [run.name for run in kept.runs] == [
        "slow@1",
        *("laps@5", "laps@15", "laps@25", "laps@35"),
        *("ramp@2", "ramp@8"),
        "heldout_ramp@5",
    ]
    assert [run.role for run in kept.runs][-1] == "heldout"


@pytest.mark.parametrize("count", range(1, 60))
def test_windows_are_spread_evenly(count: int) -> None:
    kept = [int(run.name.split("@")[1]) for run in with_fewer_windows(of_windows(laps=count)).runs]
    assert len(kept) == int(np.ceil(count / 10)) and len(set(kept)) == len(kept)
    gaps = np.diff(kept)
    assert gaps.size == 0 or gaps.max() - gaps.min() <= 1


def test_a_case_of_whole_recordings_is_refused() -> None:
    with pytest.raises(InputError, match="is a whole recording, of which no tenth is taken") as refused:
        with_fewer_windows(Case("laps", "", "free", Board(**TABLE_II), (WINDOW,)))
    assert "case.toml" in str(refused.value)
