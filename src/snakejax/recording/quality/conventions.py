"""Conventions taken the other way: an x axis that does not point forward, a rotor of opposite sign, a floor from below.

Whatever the tyres are, the yaw rate is nearly r = -k psi' + c u tan(phi) + ... with k, c > 0: the board turns against
its rotor, and into the turn when it rolls forward at speed u. Seen along another axis of the board than the forward
one, the speed explains less of r, or with c < 0; a rotor of opposite sign has k < 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..run import Run
from .finding import Finding, PoseSeries
from .joint_motion import SMOOTH, JointMotion, joint_motion, yaw_regressors

CONVENTIONS = ("turned_axis", "mirrored", "rotor_sign")
POINTS = ("forward", "right", "back", "left")
"""Where the object's x axis points if the board goes along its x, y, -x or -y axis."""
POOLED, ALONE = 0.8, 0.4
"""Another axis is reported if the yaw rate that it leaves is less than this share of that of the x axis: in all runs
together, and in one run against all others."""
HARDLY = 0.5
"""If speeds and joints leave more than this share of the yaw rate, they give no information."""
LITTLE = 0.01
"""An axis must explain more of the yaw rate than the x axis by this share: the linear rule is not more accurate."""
CERTAIN = 5.0
"""Standard errors by which a rotor's sign must be clear."""


class AxisEvidence(NamedTuple):
    """What one run tells: of the yaw rate the `square`, what each axis leaves of it, and for each the rotor's factor -k
    with one over its variance.
    """

    square: float
    left: Float[np.ndarray, " 4"]
    factor: Float[np.ndarray, " 4"]
    precision: Float[np.ndarray, " 4"]


def conventions(runs: Sequence[Run]) -> list[Finding]:
    """Axes and signs in `runs` with which no board moves as these do, for all of them or for single ones."""
    evidence = {run.name: one_run for run in runs if (one_run := evidence_of(run)) is not None}
    if not evidence:
        return []
    axis = _axis(list(evidence.values()), POOLED)
    findings = _signs(list(evidence.values()), axis)
    for run in runs:
        if run.name in evidence and (own := _axis([evidence[run.name]], ALONE)) not in (0, axis):
            end = float(PoseSeries.of(run).times[-1])
            findings.append(_turned(own)._replace(run=run.name, end=end))
    return findings


def evidence_of(run: Run) -> AxisEvidence | None:
    """The evidence of `run`; None where too few samples are present, or a joint stands still."""
    motion = joint_motion(run, 0.0)
    if motion is None or not all(np.ptp(part) > 0 for part in motion.at(0.0)):
        return None
    return evidence_in(motion)


def evidence_in(motion: JointMotion) -> AxisEvidence:
    """The evidence of a motion with the angles of its joints."""
    against, steer = motion.at(0.0)
    independent = (motion.times[-1] - motion.times[0]) / SMOOTH
    axes = (motion.u, motion.w, -motion.u, -motion.w)
    fits = np.array([_beside(motion.r, yaw_regressors(against, steer, along)) for along in axes])
    left, factor, variance = fits.T
    variance = variance * motion.r.size / independent
    return AxisEvidence(float(((motion.r - motion.r.mean()) ** 2).sum()), left, factor, 1 / variance)


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


def _axis(evidence: Sequence[AxisEvidence], share: float) -> int:
    """The axis along which the board goes, as a place in `POINTS`: the first, unless another leaves clearly less."""
    left, square = np.sum([one_run.left for one_run in evidence], axis=0), sum(one_run.square for one_run in evidence)
    best = int(np.argmin(left))
    return best if left[best] < min(share * left[0], left[0] - LITTLE * square, HARDLY * square) else 0


def _signs(evidence: Sequence[AxisEvidence], axis: int) -> list[Finding]:
    """What all runs together say of axes and signs."""
    factor, precision = (np.array([part[axis] for part in parts]) for parts in list(zip(*evidence, strict=True))[2:])
    with_rotor = (factor * precision).sum() / np.sqrt(precision.sum()) > CERTAIN
    if with_rotor and POINTS[axis] == "back":
        what = "the board turns against its steering and with its rotor, as if seen from below"
        remedy = 'write up = "-z" for its runs, or give phi and psi the opposite sign'
        return [Finding("mirrored", what, remedy, 0.0, 0.0)]
    findings = [_turned(axis)] if axis else []
    if with_rotor:
        what = "the board turns with its rotor, not against it"
        findings.append(Finding("rotor_sign", what, "give psi the opposite sign", 0.0, 0.0))
    return findings


def _turned(axis: int) -> Finding:
    points = POINTS[axis]
    what = f"the board moves as if the x axis of its object pointed {points}"
    remedy = f'if so, write x_axis = "{points}" for its runs (if x_axis is set already, turn it by the same angle)'
    if points == "back":
        remedy += ", or give phi the opposite sign"
    size = float(np.pi if points == "back" else np.pi / 2)
    return Finding("turned_axis", what, remedy, 0.0, 0.0, size=size, unit="rad")
