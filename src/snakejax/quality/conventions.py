"""Conventions taken the other way: an x axis that does not point forward, a rotor of opposite sign, a floor from below.

Whatever the tyres are, the yaw rate is nearly r = -k psi' + c u tan(phi) + ... with k, c > 0: the board turns against
its rotor, and into the turn when it rolls forward at speed u. Seen along another axis of the board than the forward
one, the speed explains less of r, or with c < 0; a rotor of opposite sign has k < 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._recording import Run
from .finding import Finding, Track
from .joints import SMOOTH, beside_joints, yaw_terms

CONVENTIONS = ("turned_axis", "mirrored", "rotor_sign")
POINTS = ("forward", "right", "back", "left")
"""Where the object's x axis points if the board goes along its x, y, -x or -y axis."""
POOLED, ALONE = 0.8, 0.4
"""Another axis is believed where the yaw rate left beside it is less than this share of that beside the x axis: in all
runs together, and in one run against all others."""
HARDLY = 0.5
"""Speeds and joints that leave more than this share of the yaw rate tell nothing."""
CERTAIN = 5.0
"""Standard errors by which a rotor's sign must be clear."""


class _Told(NamedTuple):
    """What one run tells: of the yaw rate the `square`, what each axis leaves of it, and for each the rotor's factor -k
    with one over its variance.
    """

    square: float
    left: Float[np.ndarray, " 4"]
    factor: Float[np.ndarray, " 4"]
    precision: Float[np.ndarray, " 4"]


def conventions(runs: Sequence[Run]) -> list[Finding]:
    """Axes and signs in `runs` with which no board moves as these do, for all of them or for single ones."""
    told = {run.name: seen for run in runs if (seen := _told(run)) is not None}
    if not told:
        return []
    axis = _axis(list(told.values()), POOLED)
    found = _signs(list(told.values()), axis)
    for run in runs:
        if run.name in told and (own := _axis([told[run.name]], ALONE)) not in (0, axis):
            end = float(Track.of(run).times[-1])
            found.append(_turned(own)._replace(run=run.name, end=end))
    return found


def _told(run: Run) -> _Told | None:
    seen = beside_joints(run, 0.0)
    if seen is None:
        return None
    against, steer = seen.at(0.0)
    if not (np.ptp(steer) > 0 and np.ptp(against) > 0):
        return None
    independent = (seen.times[-1] - seen.times[0]) / SMOOTH
    axes = (seen.u, seen.w, -seen.u, -seen.w)
    found = np.array([_beside(seen.r, yaw_terms(against, steer, along)) for along in axes])
    left, factor, variance = found.T
    variance = variance * seen.r.size / independent
    return _Told(float(((seen.r - seen.r.mean()) ** 2).sum()), left, factor, 1 / variance)


def _beside(r: Float[np.ndarray, " n"], features: Float[np.ndarray, "n 5"]) -> tuple[float, float, float]:
    """What `features` leave of the yaw rate, the rotor's factor, and its variance; no board turns out of its turns."""
    solved, *_ = np.linalg.lstsq(features, r, rcond=None)
    if not solved[1] > 0:
        features = np.delete(features, 1, axis=1)
        solved, *_ = np.linalg.lstsq(features, r, rcond=None)
    rest = r - features @ solved
    square = float(rest @ rest)
    variance = square / r.size * np.linalg.pinv(features.T @ features)[0, 0]
    return square, float(solved[0]), float(max(variance, np.finfo(float).tiny))


def _axis(told: Sequence[_Told], share: float) -> int:
    """The axis along which the board goes, as a place in `POINTS`: the first, unless another leaves clearly less."""
    left = np.sum([seen.left for seen in told], axis=0)
    best = int(np.argmin(left))
    return best if left[best] < min(share * left[0], HARDLY * sum(seen.square for seen in told)) else 0


def _signs(told: Sequence[_Told], axis: int) -> list[Finding]:
    """What all runs together say of axes and signs."""
    factor, precision = (np.array([part[axis] for part in parts]) for parts in list(zip(*told, strict=True))[2:])
    with_rotor = (factor * precision).sum() / np.sqrt(precision.sum()) > CERTAIN
    if with_rotor and POINTS[axis] == "back":
        what = "the board turns out of its turns and with its rotor, as one seen from below"
        remedy = 'write up = "-z" for its runs, or give phi and psi the opposite sign'
        return [Finding("mirrored", what, remedy, 0.0, 0.0)]
    found = [_turned(axis)] if axis else []
    if with_rotor:
        what = "the board turns with its rotor, not against it"
        found.append(Finding("rotor_sign", what, "give psi the opposite sign", 0.0, 0.0))
    return found


def _turned(axis: int) -> Finding:
    points = POINTS[axis]
    what = f"the board goes as if the x axis of its object pointed {points}"
    remedy = f'if so, write x_axis = "{points}" for its runs (where one stands already, turn it as far again)'
    if points == "back":
        remedy += ", or give phi the opposite sign"
    size = float(np.pi if points == "back" else np.pi / 2)
    return Finding("turned_axis", what, remedy, 0.0, 0.0, size=size, unit="rad")
