"""What a fitted model does in each recorded run, beside what was seen: the material of every comparison and picture."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from snakejax.core.periodogram import fundamental_frequency
from snakejax.dynamics.contact import Motion, slip_angle
from snakejax.dynamics.model import Model
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.estimation.batch import batch
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.replay import ACCURACY, batch_of_runs
from snakejax.recording.run import Run
from snakejax.simulation.integrate import motions, simulate


class ResidualSeries(NamedTuple):
    """The residual of one run: `residual` (n, 3) in standard deviations `sd` [m, m, rad], NaN where nothing was seen.

    `variables`, each (n,): what the fitted model does meanwhile.
    """

    run: str
    role: str
    times: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, "n 3"]
    sd: Float[np.ndarray, "3"]
    variables: dict[str, Float[np.ndarray, " n"]]


class RunReplay(NamedTuple):
    """One run as recorded and as simulated.

    `track`, the residual. `measured` (n, 3), the recorded x [m], y [m] and heading [rad], NaN where lost; `pose` (n,
    3), the modelled ones. Of each of W wheelsets: `wheels` (n, W, 3), its place x, y [m] and its angle [rad], positive
    to the left, in the base frame; (n, W): `slip_speed` [m/s]; `slip` [rad], its slip angle; `force` [N], the traction
    against it. `joints`: the angle (n,) [rad] of each joint by name. `skid_angle` (n,) [rad], the heading less the
    angle of the frame that forces are counted in (beta of `Coupled`); `velocity` (n, 3): u and w [m/s] along and across
    that frame, r [rad/s]. `states`: the state of the model at every sample, as `Model.rates` takes it.
    """

    track: ResidualSeries
    measured: Float[np.ndarray, "n 3"]
    pose: Float[np.ndarray, "n 3"]
    wheels: Float[np.ndarray, "n W 3"]
    joints: dict[str, Float[np.ndarray, " n"]]
    slip_speed: Float[np.ndarray, "n W"]
    slip: Float[np.ndarray, "n W"]
    force: Float[np.ndarray, "n W"]
    skid_angle: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, "n 3"]
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


def replay_runs(fitted: FittedModel) -> tuple[RunReplay, ...]:
    """Every recording of `fitted` from its fitted start, train runs first."""
    stacked, sd = batch(fitted.recordings, fitted.noise), np.asarray(fitted.noise.channels)
    replays = []
    for k in (*fitted.numbered("train"), *fitted.numbered("heldout")):
        one = jax.tree.map(lambda leaf, k=k: leaf[k], stacked)
        simulated = _simulated(fitted.model, one, fitted.starts[k], fitted.accuracy)
        replays.append(_replay_of(fitted.recordings[k], simulated, fitted.residuals[k], sd, fitted.model.board))
    return tuple(replays)


def replay_fit(fit: Fit) -> tuple[RunReplay, ...]:
    """Every run of a fit, train runs first."""
    return replay_runs(fit.fitted)


def replay_model(model: Model, runs: Sequence[Run], starts: Float[np.ndarray, "R S"]) -> tuple[RunReplay, ...]:
    """Every one of `runs` as `model` plays it from its start; residuals in m and rad, NaN where nothing was seen."""
    block = batch_of_runs(runs, starts)
    replays = []
    for k, (run, start) in enumerate(zip(runs, np.asarray(starts, float), strict=True)):
        simulated = _simulated(model, jax.tree.map(lambda leaf, k=k: leaf[k], block), start, ACCURACY)
        residual = np.asarray(run.pose) - np.asarray(simulated[2])[: run.times.shape[0]]
        replays.append(_replay_of(run, simulated, residual, np.ones(3), model.board))
    return tuple(replays)


def _replay_of(run: Run, simulated: Any, residual: np.ndarray, sd: np.ndarray, board: AbstractVehicle) -> RunReplay:
    n = run.times.shape[0]
    motion, force, pose, states = jax.tree.map(lambda leaf: np.asarray(leaf)[:n], simulated)
    track = ResidualSeries(run.name, run.role, np.asarray(run.times), residual, sd, _named(motion, board))
    wheels, joints = motion.wheels, {name: joint.angle for name, joint in motion.inputs.items()}
    speed = np.stack([wheel.lateral for wheel in wheels], axis=1)
    rolling = np.stack([wheel.rolling for wheel in wheels], axis=1)
    return RunReplay(
        track,
        np.where(np.isfinite(np.asarray(run.pose)).all(axis=1, keepdims=True), np.asarray(run.pose), np.nan),
        pose,
        _placed(board, motion, joints),
        joints,
        speed,
        np.asarray(slip_angle(speed, rolling, board.creep_speed)),
        np.stack(force, axis=1),
        motion.heading - motion.theta,
        np.stack([motion.u, motion.w, motion.r], axis=1),
        states,
    )


def _placed(
    vehicle: AbstractVehicle, motion: Motion, angles: dict[str, Float[np.ndarray, " n"]]
) -> Float[np.ndarray, "n W 3"]:
    """Place and angle of each wheelset in the base frame, at the joint `angles`."""
    placed = []
    for wheelset, wheel in zip(vehicle.wheelsets, motion.wheels, strict=True):
        x, y, angle = vehicle.placement(wheelset, angles)
        parts = np.broadcast_arrays(x, y, np.asarray(angle) + np.asarray(wheel.joint.angle))
        placed.append(np.stack(parts, axis=1))
    return np.stack(placed, axis=1)


@eqx.filter_jit
def _simulated(model, batch, start, accuracy):
    model = model.in_run(batch.payload, batch.codes)
    done = simulate(model, batch.gait, batch.times, start, accuracy=accuracy, resting=batch.resting)
    motion, force = motions(model, batch.gait, done)
    return motion, force, done.pose, done.state


def _named(motion: Motion, vehicle: AbstractVehicle) -> dict[str, np.ndarray]:
    """The variables by name; SI units and radians."""
    names = [wheelset.name or str(k) for k, wheelset in enumerate(vehicle.wheelsets)]
    ends = ("front", "back") if names == ["0", "1"] else names
    return {
        "gait_phase": gait_phase(motion.time, *(joint.angle for joint in motion.inputs.values())),
        **{f"slip_{end}": wheel.lateral for end, wheel in zip(ends, motion.wheels, strict=True)},
        "speed": np.hypot(motion.u, motion.w),
        "x": motion.x,
        "y": motion.y,
        "heading": motion.heading,
        **{name: np.asarray(values) for name, values in vehicle.variables(motion.inputs).items()},
        "time": motion.time,
    }  # type: ignore[return-value]


def gait_phase(times: np.ndarray, *joints: np.ndarray) -> np.ndarray:
    """w t modulo 2 pi [rad], w the frequency at which the first of `joints` that moves swings most; 0 where none."""
    for angle in joints:
        if np.ptp(angle) > 1e-9:
            return np.mod(fundamental_frequency(times, angle) * times, 2 * np.pi)
    return np.zeros_like(times)
