"""The motion that cameras saw beside the joints of the same run: what the board did when they moved."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.signal import savgol_filter

from .._gait import AbstractSignal
from .._recording import Run
from .finding import Track

SMOOTH = 0.21
"""Width [s] of the cubics that give the rates."""
STEP = 0.01
"""Time [s] between the joint angles."""
STEEPEST = 1.4
"""Beyond this steering angle [rad] its tangent says nothing any more."""
FEWEST = 50


class Joints(NamedTuple):
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
        rate = _rates(turn[:, None], float(self.times[1] - self.times[0]))[:, 0]
        return rate, np.clip(steer, -STEEPEST, STEEPEST)


def yaw_terms(against: np.ndarray, steer: np.ndarray, along: np.ndarray) -> Float[np.ndarray, "n 5"]:
    """What the yaw rate is nearly linear in, for a board that goes `along`: first the rotor's rate `against` which it
    turns, second its way into the turn.
    """
    return np.stack([against, along * np.tan(steer), np.ones_like(along), steer, along], axis=1)


def beside_joints(run: Run, most: float) -> Joints | None:
    """The motion of `run` with its joints up to `most` [s] before and after; None where too little was seen."""
    seen = Track.of(run).seen()
    if len(seen.times) < FEWEST:
        return None
    frame = float(np.median(np.diff(seen.times)))
    times = np.arange(seen.times[0], seen.times[-1], frame)
    pose = np.stack([np.interp(times, seen.times, channel) for channel in seen.pose.T], axis=1)
    x, y, r = _rates(pose, frame).T
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    fine = np.arange(times[0] - most - 0.5, times[-1] + most + 0.5, STEP)
    phi, psi = (angles(signal, fine) for signal in (run.gait.phi, run.gait.psi))
    return Joints(times, x * c + y * s, y * c - x * s, r, fine, phi, psi)


def _rates(values: Float[np.ndarray, "n c"], frame: float) -> Float[np.ndarray, "n c"]:
    width = max(5, round(SMOOTH / frame) // 2 * 2 + 1)
    return np.asarray(savgol_filter(values, width, 3, deriv=1, delta=frame, axis=0))


def angles(signal: AbstractSignal, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The joint's angle; before time 0 it stands where it starts."""
    return np.asarray(_at(signal, jnp.asarray(np.maximum(times, 0.0))))


@eqx.filter_jit
def _at(signal: AbstractSignal, times: Float[Array, " n"]) -> Float[Array, " n"]:
    return jax.vmap(lambda t: signal.at(t).angle)(times)
