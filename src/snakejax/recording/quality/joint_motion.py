"""The motion that cameras saw beside the joints of the same run: what the board did when they moved."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.local_polynomials import derivative, window_of
from snakejax.dynamics.inputs import Gait
from snakejax.dynamics.signals import AbstractSignal, angles_at

from ..run import Run
from .finding import PoseSeries

SMOOTH = 0.21
"""Width [s] of the cubics that give the rates."""
STEP = 0.01
"""Time [s] between the joint angles."""
STEEPEST = 1.4
"""Beyond this steering angle [rad] its tangent says nothing any more."""
FEWEST = 50
"""Frames below which no motion is analysed: half a second at 100 Hz."""


class JointMotion(NamedTuple):
    """The motion at steady `times` [s]: speed `u` along the heading, `w` to its left, yaw rate `r`; and the joint
    angles at the times `fine`.
    """

    times: Float[np.ndarray, " n"]
    u: Float[np.ndarray, " n"]
    w: Float[np.ndarray, " n"]
    r: Float[np.ndarray, " n"]
    fine: Float[np.ndarray, " m"]
    phi: Float[np.ndarray, " m"]
    psi: Float[np.ndarray, " m"]

    def at(self, offset: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """The rotor's rate and the steering angle `offset` [s] later."""
        turn, steer = (np.interp(self.times + offset, self.fine, angle) for angle in (self.psi, self.phi))
        frame = float(self.times[1] - self.times[0])
        rate = derivative(turn[:, None], frame, window_of(SMOOTH, frame), 1)[:, 0]
        return rate, np.clip(steer, -STEEPEST, STEEPEST)


def yaw_regressors(against: np.ndarray, steer: np.ndarray, along: np.ndarray) -> Float[np.ndarray, "n 5"]:
    """What the yaw rate is nearly linear in, for a board that goes `along`: first the rotor's rate `against` which it
    turns, second its way into the turn.
    """
    return np.stack([against, along * np.tan(steer), np.ones_like(along), steer, along], axis=1)


def joint_motion(run: Run, most: float) -> JointMotion | None:
    """The motion of `run` with its joints up to `most` [s] before and after; None where too little was seen."""
    steady = steady_poses(run)
    if steady is None or not isinstance(run.gait, Gait):
        return None
    times, pose = steady
    frame = float(times[1] - times[0])
    x, y, r = derivative(pose, frame, window_of(SMOOTH, frame), 1).T
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    fine = np.arange(times[0] - most - 0.5, times[-1] + most + 0.5, STEP)
    phi, psi = (angles(signal, fine) for signal in (run.gait.phi, run.gait.psi))
    return JointMotion(times, x * c + y * s, y * c - x * s, r, fine, phi, psi)


def steady_poses(run: Run) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]] | None:
    """Steady times [s] and the poses at them; None where too little was seen."""
    present = PoseSeries.of(run).complete()
    if len(present.times) < FEWEST:
        return None
    times = np.arange(present.times[0], present.times[-1], float(np.median(np.diff(present.times))))
    return times, np.stack([np.interp(times, present.times, channel) for channel in present.pose.T], axis=1)


def angles(signal: AbstractSignal, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The joint's angle; before time 0 it stands where it starts."""
    return np.asarray(angles_at(signal, jnp.asarray(np.maximum(times, 0.0))))
