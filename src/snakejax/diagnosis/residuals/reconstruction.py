"""The traction of the tyre against slip: the curve that was fitted, and what the recordings ask of it.

What a recording asks for needs no tyre law. The model's run is corrected by the smoothed residual, so that place,
velocity and acceleration are those of the real board; then the traction is the one that gives this acceleration:

    F = F0 + A^+ S (a_seen - a(F0))        A = S da/dF

with a the acceleration (x'', y'', heading'') of the model at the corrected state, S = diag(m, m, I / L), and A^+ the
pseudo-inverse: a structure that does not let some part be felt leaves that part as the tyre law has it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.core.local_polynomials import even_local_cubics
from snakejax.core.parameter import Scalar, param, parameters, with_parameters
from snakejax.dynamics.contact import Motion, Wheel, slip_angle
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import LateralForce, Sensor
from snakejax.dynamics.tyres import Rayleigh
from snakejax.estimation.batch import lengthened, padded_length
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.linearisation import domains_of

from .replays import RunReplay

HALF_SPAN = 0.2
"""Half the time [s] over which the residual is smoothed: a cubic, short against half a period of a gait."""
RCOND = 1e-3
CLEAR = 5.0
"""A wheelset whose speed is not above this many of its errors has no slip angle that can be seen."""
BINS = 15
FEWEST = 8
"""A bin holds at least so many samples."""
POINTS = 161
"""Points of the drawn curve of a tyre law."""


class ReconstructedForces(NamedTuple):
    """What one run asks of the tyre: `slip` (n, W), `force` [N] (n, W) and the `weight` (n, W) of both.

    `slip` is an angle [rad], or a speed [m/s] for a viscous tyre; `modelled` (n, W) is the one that the model has. NaN
    where too little was seen. The n instants are half a smoothing apart, so that their errors are nearly independent.
    """

    modelled: Float[np.ndarray, "n W"]
    slip: Float[np.ndarray, "n W"]
    force: Float[np.ndarray, "n W"]
    weight: Float[np.ndarray, "n W"]


class Binned(NamedTuple):
    """Means over bins of slip: `slip`, `force` [N] and the standard errors `slip_sd` and `sd` [N], all (b,)."""

    slip: Float[np.ndarray, " b"]
    force: Float[np.ndarray, " b"]
    slip_sd: Float[np.ndarray, " b"]
    sd: Float[np.ndarray, " b"]


class Curve(NamedTuple):
    """The fitted tyre: `force` [N] at `slip`, with the standard error `sd` [N] that the fit leaves, all (p,)."""

    slip: Float[np.ndarray, " p"]
    force: Float[np.ndarray, " p"]
    sd: Float[np.ndarray, " p"]


class TyreForces(NamedTuple):
    """The tyre of one fit: its `curve`, and the `demand` of the train runs on it; `viscous`: slip is a speed [m/s]."""

    curve: Curve
    demand: Binned | None
    viscous: bool


class _Push(LateralForce):
    """An extra traction of the wheelset at `place`."""

    force: Scalar = param("N", default=0.0)
    place: float = eqx.field(static=True, default=1.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        del motion
        return force + self.force if wheel.wheelset.place == self.place else force


def tyre_forces(fitted: FittedModel, scenes: Sequence[RunReplay]) -> TyreForces:
    """The tyre of `fitted` and what the train runs among the `scenes` of its recordings ask of it."""
    viscous = isinstance(fitted.model.tyre.of_axle("front"), Rayleigh)
    train = [scene for scene in scenes if scene.role == "train"]
    felt = [a for scene in train if (a := reconstruct_forces(fitted, scene)) is not None]
    means = binned(felt)
    reached = [np.abs(s.slip_speed if viscous else s.slip).max() for s in train]
    reached += [float(np.abs(means.slip).max())] if means is not None and means.slip.size else []
    return TyreForces(curve(fitted, np.linspace(-1.0, 1.0, POINTS) * max(reached, default=1.0)), means, viscous)


def curve(fitted: FittedModel, slip: Float[np.ndarray, " p"]) -> Curve:
    """The traction law at `slip`, and its standard error from the covariance of the fit by the linear rule."""
    model, known = fitted.model, parameters(fitted.model)
    names = [name for name in fitted.loose if name.startswith("tyre.")]
    rows = [fitted.loose.index(name) for name in names]

    def force(values: Float[np.ndarray, " k"]):
        tyre = with_parameters(model, dict(zip(names, values, strict=True))).tyre
        # Of different tyres the curve is that of the first wheel.
        first = model.board.wheelsets[0]
        own = tyre.of_axle(first.axle).under(model.board.load(first))
        return jax.vmap(own.force)(jnp.asarray(slip), jnp.asarray(slip))

    at = jnp.asarray([float(known[name].value) for name in names])
    sd = np.zeros_like(slip)
    if names:
        # The covariance is one of steps, which for a multiplicative parameter are those of its logarithm.
        unit = [v if d.multiplicative else 1.0 for v, d in zip(at, domains_of(model, names), strict=True)]
        slope = np.asarray(jax.jacfwd(force)(at)) * np.asarray(unit)
        covariance = fitted.covariance[np.ix_(rows, rows)] * fitted.spread**2
        sd = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", slope, covariance, slope), 0.0))
    return Curve(slip, np.asarray(force(at)), sd)


def reconstruct_forces(fitted: FittedModel, scene: RunReplay) -> ReconstructedForces | None:
    """What the run of `scene` asks of the tyre; None for a structure on which a traction does not act as on a board.

    Effects that change what the cameras report make the correction one of the report, not of the board: None too.
    """
    model = fitted.model
    sensors = [e for e in model.effects_of(Sensor) if any(float(p) for p in jax.tree.leaves(e))]
    if not model.constraint.tyre_acts or sensors:
        return None
    run = next(run for run in fitted.recordings if run.name == scene.run)
    shift, sd = even_local_cubics(scene.times, scene.track.residual * scene.track.sd, scene.track.sd, HALF_SPAN)
    stride = max(round(HALF_SPAN / float(np.median(np.diff(scene.times)))), 1)
    kept = slice(stride // 2, None, stride)
    usable = np.asarray(np.isfinite(shift[kept]).all(axis=(1, 2)))
    if not usable.any():
        return None
    # The rate of a cubic is off by about the span times its acceleration's error over pi.
    slowest = CLEAR * HALF_SPAN * float(np.nanmedian(np.hypot(sd[:, 0], sd[:, 1]))) / np.pi
    # All runs of a study are padded alike, so that they are compiled once.
    extra = -(-padded_length(fitted.recordings) // stride) - usable.size
    every = (scene.times, scene.states, np.nan_to_num(shift), np.nan_to_num(sd))
    times, states, shift, sd = jax.tree.map(lambda a: lengthened(a[kept], extra), every)
    in_run = model.in_run(run.payload, run.codes)
    viscous = isinstance(model.tyre.of_axle("front"), Rayleigh)
    reconstruction = _slip_and_force(in_run, run.gait, times, states, shift, sd, viscous)
    slip, force, error, speed = (np.asarray(part)[: usable.size] for part in reconstruction)
    clear = usable[:, None] & (speed > slowest) & (error > 0)
    modelled = (scene.slip_speed if viscous else scene.slip)[kept]
    # A slip angle is the less certain, the slower the wheelset.
    weight = (1.0 if viscous else speed**2) / np.where(clear, error, 1.0) ** 2
    return ReconstructedForces(*(np.where(clear, part, np.nan) for part in (modelled, slip, force, weight)))


@eqx.filter_jit
def _slip_and_force(model: Model, gait, times, states, shift, sd, viscous: bool):
    """Slip and force at each instant, the force's standard deviation, and the speed."""
    board = model.effective_vehicle()
    places = [wheelset.place for wheelset in board.wheelsets]
    size = jnp.stack([board.mass, board.mass, board.total_inertia / board.length])

    def world(t, state, push):
        """Velocity and acceleration (x, y, heading), under extra tractions `push`."""
        pushed = model.add(**{f"push{i}": _Push(push[i], place) for i, place in enumerate(places)})

        def velocity(t, body):
            rates = pushed.rates(t, (body, state[1]), gait)[0]
            return jnp.stack(jax.jvp(lambda b: pushed.constraint.pose(b), (body,), (rates,))[1])

        rates = pushed.rates(t, state, gait)[0]
        return jax.jvp(velocity, (t, state[0]), (jnp.ones_like(t), rates))

    def one(t, state, move, error):
        zero = jnp.zeros(len(places))
        rate, acceleration = world(t, state, zero)
        body = state[0]
        pose = jnp.stack(model.constraint.pose(body)) + move[0]
        real = (model.constraint.corrected(body, tuple(pose), tuple(rate + move[1])), state[1])
        motion = model.motion(t, real[0], gait)
        as_law = jnp.stack(model.traction(motion, real[1]))
        A = size[:, None] * jax.jacfwd(lambda push: world(t, real, push)[1])(zero)
        back = jnp.linalg.pinv(A, rtol=RCOND)
        force = as_law + back @ (size * (acceleration + move[2] - world(t, real, zero)[1]))
        lateral = jnp.stack([wheel.lateral for wheel in motion.wheels])
        rolling = jnp.stack([wheel.rolling for wheel in motion.wheels])
        slip = lateral if viscous else slip_angle(lateral, rolling, board.creep_speed)
        return slip, force, jnp.sqrt(back**2 @ (size * error) ** 2), jnp.hypot(lateral, rolling)

    return jax.vmap(one)(times, states, shift, sd)


def binned(parts: Sequence[ReconstructedForces]) -> Binned | None:
    """Weighted means of slip and force over bins of equal counts, the standard error of each force from its spread.

    The bins are those of the slip that the model has (Wald's grouping, Annals of Mathematical Statistics 1940): sorted
    by the slip that was seen, its errors would flatten the curve.
    """
    if not parts:
        return None
    modelled, slip, force, weight = (
        np.concatenate([getattr(p, n).ravel() for p in parts]) for n in ReconstructedForces._fields
    )
    usable = np.isfinite(force)
    if usable.sum() < FEWEST:
        return None
    modelled, slip, force, weight = (part[usable] for part in (modelled, slip, force, weight))
    rows = []
    for members in np.array_split(np.argsort(modelled), min(BINS, usable.sum() // FEWEST)):
        w = weight[members] / weight[members].sum()
        means = [w @ part[members] for part in (slip, force)]
        errors = [
            np.sqrt(w @ w / (1 - w @ w) * (w @ (part[members] - mean) ** 2))
            for part, mean in zip((slip, force), means, strict=True)
        ]
        rows.append((*means, *errors))
    return Binned(*np.array(rows).T)
