"""How the windows of a board that is driven by a free force change with its knots."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import with_parameters
from snakejax.dynamics.contact import Motion, Wheel, Wrench
from snakejax.dynamics.floor import placement_of, wrench_at, wrench_of_wheel
from snakejax.dynamics.law import WHEEL_VARIABLES, wheel_variables
from snakejax.dynamics.model import Model
from snakejax.dynamics.vehicle import AbstractVehicle, Wheelset
from snakejax.estimation.batch import Batch
from snakejax.estimation.kept_program import KeptProgram
from snakejax.estimation.linearisation import Variables, derivatives, domains_of, retract
from snakejax.simulation.integrate import Accuracy, motions, simulate

from .piecewise_force import SPACING, FreeForce, FreeGrip

ACCURACY = Accuracy(rtol=1e-6, atol=1e-8, max_steps=6000, derivative="forward")
"""Finer than windows otherwise need: the steps of the solver must not jump over a knot."""

AT_WHEEL = ("resistance", "lateral", "fall_x", "fall_y")
"""What acts at a wheel, see `MotionSamples`."""


class MotionSamples(NamedTuple):
    """How the board moves at every sample of every window, each (W, n); the wheelsets ahead of the middle first."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    theta: np.ndarray
    heading: np.ndarray
    u: np.ndarray
    w: np.ndarray
    r: np.ndarray
    inputs: dict[str, np.ndarray]
    """What the vehicle names beside: angles and rates of its joints, see `AbstractVehicle.variables`."""
    accelerations: dict[str, np.ndarray]
    """Those of its joints, see `AbstractVehicle.accelerations`."""
    wheels: dict[str, tuple[np.ndarray, np.ndarray]]
    """Variables of a wheel, see `wheel_variables`: the mean of those ahead of the middle, and of those behind it."""
    at_wheels: dict[str, tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]]
    """The wrench of what acts at each wheel, the sum of those ahead, and of those behind: a unit force forward along
    it, `resistance`, or to its left, `lateral` [-, -, m], and its weight on a floor that falls by 1 along x or y,
    `fall_x`, `fall_y` [N, N, N m]."""


class ForceLinearisation(NamedTuple):
    """Residuals (W, n, 3) and their derivatives by parameters, start states, force and grip knots, and the motion."""

    residual: np.ndarray
    by_parameters: np.ndarray
    by_start: np.ndarray
    by_force: np.ndarray
    by_grip: np.ndarray
    track: MotionSamples


def _linearise_in_force(model: Model, at: Variables, batch: Batch, grid, knots):
    """Everything at one point, window by window: `grid` (W,) is the time of the first knot, `knots` (W, K, 3)."""
    domains = domains_of(model, at.names)
    P, S, K = len(at.names), at.start.shape[1], knots.shape[1]
    size = P + S + 5 * K

    def window(arrays):
        piece, start, free, first, force = arrays

        def residual(z):
            p, s, f, g = jnp.split(z, (P, P + S, P + S + 3 * K))
            values = retract(domains, at, p)
            at_values = with_parameters(model, {name: values[k] for k, name in enumerate(at.names)})
            h = jnp.asarray(SPACING)
            driven = at_values.in_run(piece.payload, piece.codes).add(
                free_force=FreeForce(first, h, force + f.reshape(K, 3)), free_grip=FreeGrip(first, h, g.reshape(K, 2))
            )
            how = {"accuracy": ACCURACY, "throw": False, "resting": piece.resting}
            path = simulate(driven, piece.gait, piece.times, start + free * s, **how)
            weighted = jnp.where(piece.weight > 0, (piece.pose - path.pose) * piece.weight, 0.0)
            return weighted, _track(driven, piece.gait, path)

        return derivatives(residual, size, has_aux=True)

    return jax.lax.map(window, (batch, at.start, at.free_start, grid, knots))


linearise_in_force = KeptProgram(_linearise_in_force, MotionSamples)


def _track(model: Model, gait, path) -> MotionSamples:
    return motion_samples(model, motions(model, gait, path)[0])


def motion_samples(model: Model, motion: Motion) -> MotionSamples:
    """The samples of a `motion` whose numbers have one value a sample."""
    board = model.board
    pairs = list(zip(motion.wheels, board.wheelsets, strict=True))
    sides, acting, zero = [], [], jnp.zeros_like(motion.u)
    for ahead in (True, False):
        on_side = [pair for pair in pairs if (pair[1].place > 0) == ahead]
        every = [wheel_variables(board, wheelset, wheel, motion) for wheel, wheelset in on_side or pairs]
        sides.append({name: sum(own[name] for own in every) / len(every) for name in WHEEL_VARIABLES})
        every = [_at_wheel(board, wheelset, wheel, motion) for wheel, wheelset in on_side]
        acting.append(jax.tree.map(lambda *parts: sum(parts, zero), {name: (zero,) * 3 for name in AT_WHEEL}, *every))
    place = (motion.time, motion.x, motion.y, motion.theta, motion.heading, motion.u, motion.w, motion.r)
    of_joints = (board.variables(motion.inputs), board.accelerations(motion.inputs))
    wheels = {name: (sides[0][name], sides[1][name]) for name in WHEEL_VARIABLES}
    at_wheels = {name: (acting[0][name], acting[1][name]) for name in AT_WHEEL}
    return MotionSamples(*place, *of_joints, wheels, at_wheels)


def _at_wheel(board: AbstractVehicle, wheelset: Wheelset, wheel: Wheel, motion: Motion) -> dict[str, Wrench]:
    """The wrenches of a `wheel` by the names `AT_WHEEL`."""
    at, none = placement_of(board, wheelset, motion), jnp.zeros_like(motion.u)
    one, load = none + 1.0, board.load(wheelset) + none
    falls = (wrench_at(at, *motion.into_body(*force)) for force in ((load, none), (none, load)))
    own = (wrench_of_wheel(at, wheel.joint.angle, *force) for force in ((one, none), (none, one)))
    return dict(zip(AT_WHEEL, (*own, *falls), strict=True))
