"""How far the clock of the joints is ahead of that of the cameras, without a model of the board's forces.

Whatever the tyres are, the yaw rate r is nearly r = -k psi' + c u tan(phi) + ... with k, c > 0: the board turns against
its rotor, and into the turn when it rolls at speed u. The lag at which the joints explain r best, with those signs, is
that of the clocks, to some hundredths of a second; joints that lag behind their commands are part of it.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import numpy as np

from snakejax.core.errors import InputError
from snakejax.dynamics.inputs import on_clock

from ..run import LogClock, Run
from .finding import Finding, PoseSeries, finding
from .joint_motion import SMOOTH, STEP, JointMotion, joint_motion, yaw_regressors

FAR = 3.0
"""Within this [s] the clocks of a log and of the cameras are searched for their lag."""
COARSE = 0.05
WHOLE = 1.0
"""Lags of commanded gaits are looked for within this [s]."""
APART = 0.25
"""A lag [s] beyond what tyres and lagging joints were seen to look like: 0.06 s."""
CLEARLY, HARDLY = 0.2, 0.5
"""Joints that leave less of the yaw rate than the first share tell the lag; more than the second, nothing at all."""
MODEL_ERROR = 0.05
"""What the tyres, and joints that lag, move the lag by [s]: the standard error where the noise is smaller."""


class Lag(NamedTuple):
    """The joints' clock less the cameras' [s], its standard error, and the share of the yaw rate left unexplained."""

    offset: float
    sd: float
    left: float


def lag(run: Run, most: float = 2.0) -> Lag | None:
    """The lag between the joints of `run` and its motion, within `most` [s] either way; None where they do not go
    together: the board or its joints stand still.
    """
    motion = joint_motion(run, most)
    return None if motion is None else _best(motion, 0.0, most)


def with_log_clock(run: Run, clock: LogClock, begins: float) -> Run:
    """`run`, whose joint log begins at `begins` [s] of its own `clock`; an offset that is free is first estimated here.

    Clocks so far apart that the log would begin seconds before or after the run are laid side by side first.
    **Raises:** `InputError` where the motion does not go with the joints, so that it does not tell.
    """
    if "offset" not in clock.free:
        return dataclasses.replace(run, log=clock)
    far = begins if abs(begins) > FAR else 0.0
    run = eqx.tree_at(lambda r: r.gait, run, on_clock(run.gait, far, 0.0))
    estimate = lag(run, FAR)
    if estimate is None:
        what = "The motion does not match the logged joints, so their clocks cannot be compared"
        raise InputError(
            what, f"run {run.name}", "check that the log is of this run, or give joint_log.offset_s in seconds"
        )
    clock = clock._replace(offset=far + estimate.offset, offset_sd=estimate.sd, source="the motion alone")
    run = eqx.tree_at(lambda r: r.gait, run, on_clock(run.gait, estimate.offset, 0.0))
    return dataclasses.replace(run, log=clock)


def clocks(run: Run) -> list[Finding]:
    """Clocks of gait and cameras that are apart, or drift apart, by more than tyres and lagging joints look like."""
    estimate = lag(run, WHOLE)
    if estimate is None or estimate.left > CLEARLY or abs(estimate.offset) < APART:
        return []
    track, late = PoseSeries.of(run), "later" if estimate.offset < 0 else "earlier"
    what = f"the joints move {abs(estimate.offset):.2g} s {late} than commanded, or their clock runs at another pace"
    remedy = "correct the start of the recording or its frame rate, or let the fit find it: --with clock_offset"
    every = np.flatnonzero(track.present)
    return [finding("clock_offset", track, every, what, remedy, size=abs(estimate.offset), unit="s")]


def _best(motion: JointMotion, around: float, most: float) -> Lag | None:
    def unexplained(offsets: np.ndarray) -> np.ndarray:
        return np.array([_left(motion, offset) for offset in offsets])

    coarse = around + np.arange(-most, most + COARSE / 2, COARSE)
    shares = unexplained(coarse)
    if not shares.min() < HARDLY:
        return None
    # Of periods equally good the nearest to no lag.
    best = coarse[min(np.flatnonzero(shares <= shares.min() + 0.03), key=lambda j: abs(coarse[j] - around))]
    near, k = coarse, int(shares.argmin())
    for _ in range(5):
        near = best + STEP * np.arange(-6, 7)
        shares = unexplained(near)
        k = int(shares.argmin())
        best = near[k]
        if 0 < k < len(near) - 1:
            break
    curve = (shares[-1] + shares[0] - 2 * shares[k]) / ((near[-1] - near[0]) / 2) ** 2
    independent = (motion.times[-1] - motion.times[0]) / SMOOTH
    noisy = np.sqrt(2 * shares[k] / (independent * curve)) if 0 < curve < np.inf else 0.0
    return Lag(float(best), float(np.hypot(noisy, MODEL_ERROR)), float(shares[k]))


def _left(motion: JointMotion, offset: float) -> float:
    """The share of the yaw rate that joints `offset` ahead leave; inf where the signs are wrong."""
    r, features = motion.r, yaw_regressors(*motion.at(offset), motion.u)
    sizes = np.sqrt((features**2).sum(axis=0))
    if not (sizes[:2] > 1e-9).all():
        return np.inf
    solution, *_ = np.linalg.lstsq(features, r, rcond=None)
    if solution[0] > 0 or solution[1] < 0:
        return np.inf
    rest = r - features @ solution
    return float((rest @ rest) / ((r - r.mean()) @ (r - r.mean())))
