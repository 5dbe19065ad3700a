"""The push along the board, which tells how heavy, how long and how inert it is, whatever the tyres are.

A wheel pushes across itself alone. With wheelsets at L and -L ahead of the middle, steered by f and b, the two unknown
pushes drop out of Newton's equations and leave

    a_x + W a_y = -D (I r' + J_r psi'') / (m L)        W = (tan f + tan b) / 2        D = (tan f - tan b) / 2

with a_x, a_y the acceleration of the middle along and across the board, and r its yaw rate.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from snakejax.core.local_polynomials import derivative, derivative_gain, window_of
from snakejax.dynamics.inputs import as_gait
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


def push(run: Run, board: Board, lag: float = 0.0) -> Push | None:
    """What `run` shows of the push, where its joints do `lag` [s] earlier what they are said to; None where too little
    was seen.
    """
    steady = steady_poses(run)
    if steady is None:
        return None
    times, pose = steady
    frame = float(times[1] - times[0])
    gait = as_gait(run.gait)
    front, turned = (angles(signal, times + lag) for signal in (gait.phi, gait.psi))
    back = -front if gait.phi_back is None else angles(gait.phi_back, times + lag)
    kept = _known(PoseSeries.of(run), times) & (np.abs(front) < STEEP) & (np.abs(back) < STEEP)
    window = window_of(WIDTH, frame)
    if kept.sum() < 2 * window:
        return None
    front, back = (np.tan(np.clip(angle, -STEEPEST, STEEPEST)) for angle in (front, back))
    W, D = (front + back) / 2, (front - back) / 2
    with_payload = board.with_payload(*np.asarray(run.payload))
    m, L, total = (float(part) for part in (with_payload.mass, with_payload.half_length, with_payload.total_inertia))
    (vx, vy, _), (ax, ay, ar) = (derivative(pose, frame, window, order).T for order in (1, 2))
    theta = derivative(pose[:, 2:], frame, window, 0)[:, 0]
    c, s = np.cos(theta), np.sin(theta)
    u = vx * c + vy * s
    spun = derivative(turned[:, None], frame, window, 2)[:, 0]
    parts = [ax * c + ay * s + W * (ay * c - ax * s), -D * ar * total / (m * L), -D * spun / (m * L)]
    columns = np.stack(parts, axis=1)[kept]
    nuisance, _ = np.linalg.qr(np.stack([np.ones_like(u), u, np.tanh(u / SLOWLY), c, s], axis=1)[kept])
    columns = columns - nuisance @ (nuisance.T @ columns)
    noise = _heading_noise(run, frame) * float(((D[kept] * total / (m * L)) ** 2).sum())
    return Push(columns.T @ columns, noise, float(kept.sum()) * frame / WIDTH)


def pushes(runs: Sequence[Run], board: Board, lag: float = 0.0) -> list[Push]:
    """`push` of those of the `runs` that show any."""
    return [one for run in runs if (one := push(run, board, lag)) is not None]


def together(pushes_of_runs: Sequence[Push]) -> Push | None:
    """The pushes of several runs as one; None where they show none but in noise."""
    if not pushes_of_runs:
        return None
    gram, noise, independent = zip(*pushes_of_runs, strict=True)
    pooled = Push(np.sum(gram, axis=0), sum(noise), sum(independent))
    return pooled if pooled.square > 0 and pooled.noise < NOISY * pooled.gram[YAW, YAW] else None


def _heading_noise(run: Run, frame: float) -> float:
    """The variance that noise of the heading brings into the yaw acceleration."""
    present = PoseSeries.of(run).complete()
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
