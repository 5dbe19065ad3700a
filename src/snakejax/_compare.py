"""Comparison: where, when and with what a fitted model fails. Everything here is counted, nothing is refitted.

The residual e of a sample is measured minus modelled, over the standard deviation of the noise: white and of variance 1
where the model lacks nothing.
"""

from collections.abc import Sequence
from typing import NamedTuple

from ._errors import FitError
from ._fit import Fit, fit
from ._misfit import Score
from ._recording import Case, Noise
from ._scenes import scenes_of
from ._shares import Share, explained
from ._starting import starting_model
from ._stretches import Moment, Stretch, stretches, worst
from ._whiteness import Whiteness, whiteness
from .quality import noise_of

ALPHA = 0.05


class Comparison(NamedTuple):
    """Where a model fails. `stretches`, `worst` and `whiteness` are of all runs, `shares` of the train runs."""

    stretches: tuple[Stretch, ...]
    worst: tuple[Moment, ...]
    whiteness: tuple[Whiteness, ...]
    shares: tuple[Share, ...]

    @property
    def white(self) -> bool:
        """No run and channel differs from white noise, at 5% for all of them together (Bonferroni)."""
        return all(test.p_value * len(self.whiteness) > ALPHA for test in self.whiteness)

    @property
    def depends_on(self) -> tuple[Share, ...]:
        """The shares that are not chance, at 5% for all of them together, the largest first."""
        return tuple(share for share in self.shares if share.p_family <= ALPHA)


class Side(NamedTuple):
    """One model in a table of several: its scores, or in `failure` why it has none."""

    model: str
    train: Score | None
    heldout: Score | None
    failure: str | None = None


def compare(found: Fit, *, length: float = 1.0, count: int = 8) -> Comparison:
    """Where `found` fails: over stretches of `length` [s], and the `count` worst moments."""
    seen = [scene.track for scene in scenes_of(found)]
    return Comparison(
        tuple(stretch for track in seen for stretch in stretches(track, length)),
        worst(seen, count, length),
        tuple(test for track in seen for test in whiteness(track)),
        explained([track for track in seen if track.role == "train"]),
    )


def side_by_side(
    case: Case, kinds: Sequence[str] = ("ideal", "rayleigh", "pacejka"), noise: Noise | None = None
) -> tuple[Side, ...]:
    """Each kind of model fitted to the same runs, with misfit and rms error on train and held-out runs.

    `noise`: as given, else the case's own, else as the recordings show it.
    **Raises:** `InputError` for an unknown kind; a fit that fails is a row that says why.
    """
    noise = noise or noise_of(case)

    def side(kind: str) -> Side:
        try:
            found = fit(starting_model(case, kind), case.runs, noise)
        except FitError as error:
            return Side(kind, None, None, str(error))
        return Side(kind, found.train_score, found.heldout_score)

    return tuple(side(kind) for kind in kinds)
