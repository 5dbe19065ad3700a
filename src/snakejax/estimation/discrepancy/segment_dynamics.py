"""The dynamics of a short segment of a run under a model and a constant force, with its derivatives.

The state z of a segment is (body state, memories of the effects, force). With p the parameters in the coordinates that
a fit moves, sample j of a segment and its end are h_j(z, p) and F(z, p), by the Runge-Kutta method of order 4.
"""

from collections import OrderedDict

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from snakejax.core.parameter import Scalar, param, with_parameters
from snakejax.dynamics.contact import Motion, Wrench
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Force

from ..kept_program import KeptProgram
from ..linearisation import derivatives

NODES, WEIGHTS = np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
"""The classical Runge-Kutta method of order 4: a stage begins at the slope of the one before it."""
BODY, FORCE = 6, 3
"""Numbers of the state of the body and of the force."""


class ConstantForce(Force):
    """A constant force `X`, `Y` along and across the body, and a yaw moment `N`."""

    X: Scalar = param("N", default=0.0)
    Y: Scalar = param("N", default=0.0)
    N: Scalar = param("N m", default=0.0)

    def wrench(self, motion: Motion) -> Wrench:
        """(X, Y, N)."""
        zero = jnp.zeros_like(motion.r)
        return zero + self.X, zero + self.Y, zero + self.N


def inertia(model: Model) -> tuple[Scalar, Scalar, Scalar]:
    """Mass [kg], twice, and yaw inertia [kg m^2] of the vehicle without payload."""
    return model.board.mass, model.board.mass, model.board.total_inertia


def _integrated(model: Model, stated, sub: Int[Array, ""], segment, z: Float[Array, " nz"]):
    """Poses (n, 3) and end state (nz - 3,) of one segment; `segment` is (gait, times, rest, begins, payload,
    codes), `stated` the inertia to which the force in `z` belongs."""
    gait, times, rest, begins, payload, codes = segment
    force = [f * now / then for f, now, then in zip(z[-FORCE:], inertia(model), stated, strict=True)]
    model = model.in_run(payload, codes)
    model = with_parameters(model, dict(zip(_FORCE_NAMES, force, strict=True)))
    gait = model.prepared(gait)
    template = jax.tree.structure(model.start((z[0], z[1], z[2])))
    delayed = times - model.delay()
    # A board at rest at its start was at rest before, whatever the delay of the clocks.
    delayed = jnp.where(rest, jnp.maximum(delayed, begins), delayed)
    start = jnp.where(rest, begins, delayed[0])

    def rates(t, y):
        return jax.tree.leaves(model.rates(t, jax.tree.unflatten(template, y), gait))

    def integrate(y, span):
        t0, t1 = span
        h = (t1 - t0) / sub.astype(jnp.float64)

        # Steps and stages are loops, so that `rates` stands in the compiled program only once.
        def step(i, y):
            t = t0 + i.astype(jnp.float64) * h

            def stage(state, tableau):
                last, total = state
                node, weight = tableau
                slope = rates(t + node * h, [u + node * h * s for u, s in zip(y, last, strict=True)])
                return (slope, [sum_ + weight * s for sum_, s in zip(total, slope, strict=True)]), None

            zeros = [jnp.zeros_like(u) for u in y]
            (_, slope), _ = jax.lax.scan(stage, (zeros, zeros), (jnp.asarray(NODES), jnp.asarray(WEIGHTS)))
            return [u + h * s for u, s in zip(y, slope, strict=True)]

        y = jax.lax.fori_loop(0, sub, step, y)
        return y, jnp.stack(model.observe(tuple(y[:BODY])))

    # From the start to the first sample, from there to each of the others, and to the start of the next segment.
    at = jnp.concatenate([start[None], delayed])
    y, pose = jax.lax.scan(integrate, [z[i] for i in range(z.shape[0] - FORCE)], (at[:-1], at[1:]))
    return pose[:-1], jnp.stack(y)


_FORCE_NAMES = tuple(f"effects.segment_force.{part}" for part in "XYN")


def _at(model: Model, names, multiplicative, values, step):
    moved = jnp.where(multiplicative, values * jnp.exp(step), values + step)
    return with_parameters(model, {name: moved[k] for k, name in enumerate(names)})


def in_parts(model: Model) -> Model:
    """`model`, where the effects of each port stand in a conditional that is always true.

    What is inside is compiled on its own. In one piece, the derivatives of all effects compute again and again what
    they share, which takes twice as long.
    """
    return model.with_active(OrderedDict((name, jnp.asarray(True)) for name in model.effects))


@KeptProgram
def linearised_segments(model: Model, stated, names, multiplicative, values, sub, segments, z):
    """Poses (S, n, 3) and end states (S, nz - 3) of segments, and the derivatives of both by (p, z)."""
    P, nz = len(names), z.shape[-1]

    def one(segment, z):
        def outputs(d):
            return _integrated(_at(model, names, multiplicative, values, d[:P]), stated, sub, segment, z + d[P:])

        return derivatives(outputs, P + nz)

    return jax.vmap(one)(segments, z)


@KeptProgram
def segment_ends(model: Model, stated, names, values, sub, segments, z):
    """The end states (S, nz - 3) of segments."""
    model = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
    return jax.vmap(lambda segment, z: _integrated(model, stated, sub, segment, z)[1])(segments, z)


@KeptProgram
def fastest_decay(model: Model, names, values, segments, states):
    """The largest |d(rate of a velocity) / d(the same velocity)| in each segment, (S,) [1/s]."""
    model = with_parameters(model, {name: values[k] for k, name in enumerate(names)})

    def one(segment, states):
        gait, times, _, _, payload, codes = segment
        loaded = model.in_run(payload, codes)
        start = loaded.start((states[0, 0], states[0, 1], states[0, 2]))[1]

        def rates(v, t, z):
            body = (z[0], z[1], z[2], v[0], v[1], v[2])
            return jnp.stack(loaded.rates(t, (body, start), gait)[0][3:])

        jacobians = jax.vmap(lambda t, z: jax.jacfwd(rates)(z[3:], t, z))(times[:-1], states)
        return jnp.max(jnp.abs(jnp.diagonal(jacobians, axis1=-2, axis2=-1)))

    return jax.vmap(one)(segments, states)


@KeptProgram
def steady_memories(model: Model, segments, bodies):
    """The memories (S, memories) of the effects in the steady motion of the states `bodies` (S, 6)."""

    def one(segment, body):
        gait, times, _, _, payload, codes = segment
        memories = model.in_run(payload, codes).initial_state(tuple(body[k] for k in range(BODY)), times[0], gait)[1]
        return jnp.stack([memory for pair in memories for memory in pair])

    return jax.vmap(one)(segments, bodies)
