"""The push along the board, which tells how heavy, how long and how inert it is, whatever the tyres are.

A wheel pushes across itself alone. With wheelsets at L and -L ahead of the middle, steered by f and b, the two unknown
pushes drop out of Newton's equations and leave

    a_x + W a_y = -D (I r' + J_r psi'') / (m L)        W = (tan f + tan b) / 2        D = (tan f - tan b) / 2

with a_x, a_y the acceleration of the middle along and across the board, and r its yaw rate.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float

from snakejax.core.local_polynomials import derivative, derivative_gain, window_of
from snakejax.dynamics.inputs import Gait, as_gait
from snakejax.vehicles.snakeboard.board import Board

from ..run import Run
from .finding import PoseSeries
from .joint_motion import STEEPEST, angles, steady_poses
from .kinematics import scale, third_difference

WIDTH = 0.35
"""Width [s] of the quartics that give the accelerations."""
STEEP = 1.2
"""Beyond this steering angle [rad] its tangent is not known well enough."""
SLOWLY = 0.05
"""Speed [m/s] from which rolling resistance is whole."""
PAUSE = 4.0
"""After so many frames in a row that are lost no acceleration is known."""

NOISY = 0.5
"""A yaw acceleration more than this share of whose square is noise tells nothing."""

SEEN, YAW, ROTOR = range(3)
"""Columns of the regression: the measured push, that of the yaw inertia and that of the rotor."""


class Push(NamedTuple):
    """What runs show of the push along the board.

    `gram` (3, 3): the sums of products of a_x + W a_y, -D r' I / (m L) and -D psi'' / (m L), less what constant forces,
    drag, rolling resistance and a slope explain of each. `noise`: how much of the second's square is noise of the
    heading. `independent`: how many independent samples there are.
    """

    gram: Float[np.ndarray, "3 3"]
    noise: float
    independent: float

    @property
    def square(self) -> float:
        """The square of the push."""
        return float(self.gram[SEEN, SEEN])

    def left(self, yaw: Float[np.ndarray, "..."], rotor: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """What `yaw` times the second and `rotor` times the third leave of the square, noise of the heading apart."""
        G = self.gram
        crossed = yaw * G[SEEN, YAW] + rotor * G[SEEN, ROTOR] - yaw * rotor * G[YAW, ROTOR]
        return self.square - 2 * crossed + yaw**2 * (G[YAW, YAW] - self.noise) + rotor**2 * G[ROTOR, ROTOR]

    def best(self) -> tuple[float, float]:
        """The `yaw` and `rotor` that leave least."""
        normal = self.gram[1:, 1:] - np.diag([self.noise, 0.0])
        yaw, rotor = np.linalg.lstsq(normal, self.gram[1:, SEEN], rcond=None)[0]
        return float(yaw), float(rotor)

    def deviations(self, more: float, less: float) -> float:
        """By how many standard errors leaving `less` is better than leaving `more`."""
        return float(np.sqrt(self.independent * max(more - less, 0.0) / max(less, 1e-6 * self.square)))


class RunMotion(NamedTuple):
    """What cameras saw of a run, whatever its joints did, at steady `times` [s], `frame` [s] apart.

    Speed `u` [m/s] along the heading; acceleration [m/s^2] `along` it and `across`, to its left; the yaw acceleration
    `ar` [rad/s^2], and the variance `noise` of it that is noise; `c`, `s`: cosine and sine of the heading; `known`:
    where no long pause of the frames is near. `gait` and `payload` are those of the run.
    """

    times: Float[np.ndarray, " n"]
    frame: float
    u: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    across: Float[np.ndarray, " n"]
    ar: Float[np.ndarray, " n"]
    noise: float
    c: Float[np.ndarray, " n"]
    s: Float[np.ndarray, " n"]
    known: Bool[np.ndarray, " n"]
    gait: Gait
    payload: Float[np.ndarray, " 2"]

    @classmethod
    def of(cls, run: Run) -> Self | None:
        """That of `run`; None where too little was seen."""
        steady = steady_poses(run)
        if steady is None:
            return None
        times, pose = steady
        frame = float(times[1] - times[0])
        window = window_of(WIDTH, frame)
        if len(times) < window:
            return None
        (vx, vy, _), (ax, ay, ar) = (derivative(pose, frame, window, order).T for order in (1, 2))
        theta = derivative(pose[:, 2:], frame, window, 0)[:, 0]
        c, s = np.cos(theta), np.sin(theta)
        along, across = ax * c + ay * s, ay * c - ax * s
        series = PoseSeries.of(run)
        noise, known = _heading_noise(series, frame), _known(series, times)
        gait, payload = as_gait(run.gait), np.asarray(run.payload)
        return cls(times, frame, vx * c + vy * s, along, across, ar, noise, c, s, known, gait, payload)


def push(motion: RunMotion, board: Board, lag: float = 0.0) -> Push | None:
    """What `motion` shows of the push, where its joints do `lag` [s] earlier what they are said to; None where too
    little was seen.
    """
    gait, frame, u = motion.gait, motion.frame, motion.u
    front, turned = (angles(signal, motion.times + lag) for signal in (gait.phi, gait.psi))
    back = -front if gait.phi_back is None else angles(gait.phi_back, motion.times + lag)
    kept = motion.known & (np.abs(front) < STEEP) & (np.abs(back) < STEEP)
    window = window_of(WIDTH, frame)
    if kept.sum() < 2 * window:
        return None
    front, back = (np.tan(np.clip(angle, -STEEPEST, STEEPEST)) for angle in (front, back))
    W, D = (front + back) / 2, (front - back) / 2
    with_payload = board.with_payload(*motion.payload)
    m, L, total = (float(part) for part in (with_payload.mass, with_payload.half_length, with_payload.total_inertia))
    spun = derivative(turned[:, None], frame, window, 2)[:, 0]
    parts = [motion.along + W * motion.across, -D * motion.ar * total / (m * L), -D * spun / (m * L)]
    columns = np.stack(parts, axis=1)[kept]
    constants = [np.ones_like(u), u, np.tanh(u / SLOWLY), motion.c, motion.s]
    nuisance, _ = np.linalg.qr(np.stack(constants, axis=1)[kept])
    columns = columns - nuisance @ (nuisance.T @ columns)
    noise = motion.noise * float(((D[kept] * total / (m * L)) ** 2).sum())
    return Push(columns.T @ columns, noise, float(kept.sum()) * frame / WIDTH)


def motions(runs: Sequence[Run]) -> list[RunMotion]:
    """`RunMotion` of those of the `runs` that were seen for long enough."""
    return [motion for run in runs if (motion := RunMotion.of(run)) is not None]


def pushes(of_runs: Sequence[RunMotion], board: Board, lag: float = 0.0) -> list[Push]:
    """`push` of those of the runs that show any."""
    return [one for motion in of_runs if (one := push(motion, board, lag)) is not None]


def together(pushes_of_runs: Sequence[Push]) -> Push | None:
    """The pushes of several runs as one; None where they show none but in noise."""
    if not pushes_of_runs:
        return None
    gram, noise, independent = zip(*pushes_of_runs, strict=True)
    pooled = Push(np.sum(gram, axis=0), sum(noise), sum(independent))
    return pooled if pooled.square > 0 and pooled.noise < NOISY * pooled.gram[YAW, YAW] else None


def _heading_noise(track: PoseSeries, frame: float) -> float:
    """The variance that noise of the heading brings into the yaw acceleration."""
    present = track.complete()
    return float(
        scale(third_difference(present.times, present.pose))[2] ** 2
        * derivative_gain(frame, window_of(WIDTH, frame), 2)
    )


def _known(track: PoseSeries, times: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which of `times` lie in no long pause of the frames that were seen, nor close to one."""
    present = track.complete().times
    known = np.ones(len(times), bool)
    for k in np.flatnonzero(np.diff(present) > PAUSE * np.median(np.diff(present))):
        known &= (times < present[k] - WIDTH / 2) | (times > present[k + 1] + WIDTH / 2)
    return known
