"""What a fitted model does in each recorded run, beside what was seen: the material of every comparison and picture."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float
from scipy import optimize

from ._board import Board
from ._effect import Motion
from ._fit import Fit
from ._model import Model
from ._recording import Run
from ._replay import ACCURACY, side_by_side
from ._simulate import motions, simulate
from ._study import Optimum, Study


class Track(NamedTuple):
    """The residual of one run: `residual` (n, 3) in standard deviations `sd` [m, m, rad], NaN where nothing was seen.

    `variables`, each (n,): what the fitted model does meanwhile.
    """

    run: str
    role: str
    times: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "3"]
    variables: dict[str, Float[np.ndarray, " n"]]


class Scene(NamedTuple):
    """One run as it was seen and as the model plays it.

    `track`, the residual. `seen` (n, 3), the recorded x [m], y [m] and heading [rad], NaN where lost; `pose` (n, 3),
    the modelled ones. Of each of W wheelsets, (n, W): `steered` [rad], how it stands to the board, positive to the
    left; `slip_speed` [m/s]; `slip` [rad], its slip angle; `force` [N], the traction against it. `rotor` (n,) [rad].
    `skid_angle` (n,) [rad], the heading less the angle of the frame that forces are counted in (beta of `Coupled`).
    `states`: the state of the model at every sample, as `Model.rates` takes it.
    """

    track: Track
    seen: Float[np.ndarray, "n 3"]
    pose: Float[np.ndarray, "n 3"]
    steered: Float[np.ndarray, "n W"]
    rotor: Float[np.ndarray, " n"]
    slip_speed: Float[np.ndarray, "n W"]
    slip: Float[np.ndarray, "n W"]
    force: Float[np.ndarray, "n W"]
    skid_angle: Float[np.ndarray, " n"]
    states: Any

    @property
    def run(self) -> str:
        """The name of the run."""
        return self.track.run

    @property
    def role(self) -> str:
        """Whether the run was fitted: "train" or "heldout"."""
        return self.track.role

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """The time of each sample [s]."""
        return self.track.times


def scenes(study: Study, fitted: Optimum, judged: Optimum | None = None) -> tuple[Scene, ...]:
    """Every run of `study`: the train runs as `fitted`, the held-out ones as `judged` where they were."""
    return tuple(
        _scene(study, optimum, k)
        for role, optimum in (("train", fitted), ("heldout", judged))
        if optimum is not None
        for k in study.numbered(role)
    )


def scenes_of(found: Fit) -> tuple[Scene, ...]:
    """Every run of a fit, train runs first."""
    return scenes(found.study, found.optimum, found.heldout_optimum)


def _scene(study: Study, optimum: Optimum, k: int) -> Scene:
    run, n = study.runs[k], study.runs[k].times.shape[0]
    weight = np.asarray(study.batch.weight)[k, :n]
    residual = np.where(weight > 0, np.asarray(optimum.linearised.residual)[k, :n], np.nan)
    batch = jax.tree.map(lambda leaf: leaf[k], study.batch)
    played = _played(study.fitted(optimum), batch, optimum.start[k], study.accuracy)
    return _dressed(run, played, residual, np.asarray(study.noise.channels), study.model.board)


def simulated(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> tuple[Scene, ...]:
    """Every one of `runs` as `model` plays it from its start; residuals in m and rad, NaN where nothing was seen."""
    block = side_by_side(runs, starts)
    made = []
    for k, (run, start) in enumerate(zip(runs, np.asarray(starts, float), strict=True)):
        played = _played(model, jax.tree.map(lambda leaf, k=k: leaf[k], block), start, ACCURACY)
        residual = np.asarray(run.pose) - np.asarray(played[2])[: run.times.shape[0]]
        made.append(_dressed(run, played, residual, np.ones(3), model.board))
    return tuple(made)


def _dressed(run: Run, played: Any, residual: np.ndarray, sd: np.ndarray, board: Board) -> Scene:
    n = run.times.shape[0]
    motion, force, pose, states = jax.tree.map(lambda leaf: np.asarray(leaf)[:n], played)
    track = Track(run.name, run.role, np.asarray(run.times), residual, sd, _named(motion))
    wheels = motion.wheels
    speed = np.stack([wheel.lateral for wheel in wheels], axis=1)
    rolling = np.stack([wheel.rolling for wheel in wheels], axis=1)
    return Scene(
        track,
        np.where(np.isfinite(np.asarray(run.pose)).all(axis=1, keepdims=True), np.asarray(run.pose), np.nan),
        pose,
        np.stack([wheel.joint.angle for wheel in wheels], axis=1),
        motion.rotor.angle,
        speed,
        np.arctan2(speed, np.hypot(rolling, float(board.creep_speed))),
        np.stack(force, axis=1),
        motion.heading - motion.theta,
        states,
    )


@eqx.filter_jit
def _played(model, batch, start, accuracy):
    model = eqx.tree_at(lambda m: m.board, model, replace_fn=lambda board: board.loaded(*batch.payload))
    done = simulate(model, batch.gait, batch.times, start, accuracy=accuracy, resting=batch.resting)
    motion, force = motions(model, batch.gait, done)
    return motion, force, done.pose, done.state


def _named(motion: Motion) -> dict[str, np.ndarray]:
    """The variables by name; SI units and radians."""
    ends = ("front", "back") if len(motion.wheels) == 2 else range(len(motion.wheels))
    return {
        "gait_phase": gait_phase(motion.time, motion.steering.angle, motion.rotor.angle),
        **{f"slip_{end}": wheel.lateral for end, wheel in zip(ends, motion.wheels, strict=True)},
        "speed": np.hypot(motion.u, motion.w),
        "x": motion.x,
        "y": motion.y,
        "heading": motion.heading,
        "steering_angle": motion.steering.angle,
        "steering_rate": motion.steering.rate,
        "rotor_angle": motion.rotor.angle,
        "rotor_rate": motion.rotor.rate,
        "time": motion.time,
    }  # type: ignore[return-value]


def gait_phase(times: np.ndarray, *joints: np.ndarray) -> np.ndarray:
    """w t modulo 2 pi [rad], w the frequency at which the first of `joints` that moves swings most; 0 where none."""
    for angle in joints:
        if np.ptp(angle) > 1e-9:
            return np.mod(_fundamental(times, angle) * times, 2 * np.pi)
    return np.zeros_like(times)


def _fundamental(times: np.ndarray, angle: np.ndarray) -> float:
    """The angular frequency [rad/s] of the sine that fits `angle` best, from the peak of its periodogram."""
    size = 8 * times.size
    step = (times[-1] - times[0]) / (times.size - 1)
    power = np.abs(np.fft.rfft(angle - angle.mean(), size))
    bin_ = 2 * np.pi / (size * step)
    peak = bin_ * max(int(np.argmax(power[1:])) + 1, 1)

    def left(frequency: float) -> float:
        turn = frequency * times
        sines = np.stack([np.cos(turn), np.sin(turn), np.ones_like(turn)], axis=1)
        return float(np.sum((angle - sines @ np.linalg.lstsq(sines, angle)[0]) ** 2))

    found = optimize.minimize_scalar(left, bounds=(peak - 4 * bin_, peak + 4 * bin_), method="bounded")
    return float(found.x)  # type: ignore[attr-defined]
