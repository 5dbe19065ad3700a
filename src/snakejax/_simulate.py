"""Simulation: the only room that knows diffrax."""

from collections.abc import Sequence
from typing import Any, Literal

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._effect import Motion
from ._gait import Gait
from ._model import Model
from ._units import Scalar, require_x64

NUDGE = 1e-9
"""Speeds [m/s, rad/s] that tell how stiff rest is."""
STEPS_A_SAMPLE = 8
"""So many steps may a long recording take for each of its samples, where that is more than `Accuracy.max_steps`."""


class Accuracy(eqx.Module):
    """How accurately to integrate: Tsit5 with local error below `atol + rtol |state|`, or with a fixed step [s].

    `derivative` says which automatic derivative can be taken: "reverse" (`jax.grad`, `jax.vjp`) or "forward"
    (`jax.jvp`, `jax.jacfwd`). With a fixed step the solver takes the same steps whatever the parameters.
    """

    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-9)
    step: float | None = eqx.field(static=True, default=None)
    max_steps: int = eqx.field(static=True, default=65536)
    derivative: Literal["reverse", "forward"] = eqx.field(static=True, default="reverse")


class Trajectory(eqx.Module):
    """A simulated run: `times` [s] (n,), and at each of them the reported `pose` (n, 3): x, y [m], heading [rad].

    `state` is the model's state with a leading axis n, and `command_times` (n,) the times at which it held, which
    differ from `times` by the clock's delay. `finished` is False where the solver gave up; the pose is then infinite.
    """

    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    state: Any
    command_times: Float[Array, " n"]
    finished: Bool[Array, ""]


def simulate(
    model: Model,
    gait: Gait,
    times: Float[Array, " n"],
    start: Sequence[float] | Float[Array, " k"] = (0.0, 0.0, 0.0),
    *,
    accuracy: Accuracy = Accuracy(),  # noqa: B008
    throw: bool = True,
    resting: Bool[Array, ""] | bool = False,
) -> Trajectory:
    """Integrate `model` under `gait` and report its pose at `times`.

    Can be transformed by `jax.jit`, `jax.vmap` and the derivative that `accuracy` names, over any leaf.

    **Arguments:** `times` [s] (n,), increasing. `start`: (x [m], y [m], heading [rad]) of a board at rest at time 0, or
    when its logged joints begin to move where that is before; or six numbers, (x, y, heading, u, w, r) under `free` and
    (x, y, heading, u, beta, s) under `coupled`, of a board under way at `times[0]`, and then, if wanted, the memories
    of `Model.start_moving`; where `resting`, of a board at rest at time 0 after all, whose speeds are zero. `throw`:
    raise where the solver fails, else say so in the result.

    **Raises:** `RuntimeError` without double precision; the solver's error where it cannot reach the accuracy.
    """
    require_x64()
    times, start = jnp.asarray(times), jnp.asarray(start, jnp.float64)
    if start.shape not in ((3,), (6,), (6 + model.memories,)):
        raise ValueError(f"Argument `start` must have 3 or 6 numbers, but its shape is {start.shape}.")
    delayed, begins = times - model.delay(), gait.begins()
    if start.shape == (3,):
        t0, delayed = begins, jnp.maximum(delayed, begins)
        state = model.start((start[0], start[1], start[2]))
    else:
        # A board that rests when it begins rested before, whatever the clocks.
        t0 = jnp.where(resting, begins, delayed[0])
        delayed = jnp.where(resting, jnp.maximum(delayed, begins), delayed)
        state = model.start_moving(tuple(start[k] for k in range(start.shape[0])), t0, gait)
    states, finished = _integrate(model, gait, state, t0, delayed, accuracy, throw)
    pose = jnp.stack(model.observe(states[0]), axis=-1)
    return Trajectory(times, jnp.where(finished, pose, jnp.inf), states, delayed, finished)


def _integrate(
    model: Model, gait: Gait, state: Any, t0: Scalar, times: Float[Array, " n"], accuracy: Accuracy, throw: bool
) -> tuple[Any, Bool[Array, ""]]:
    forward = accuracy.derivative == "forward"
    most_steps = max(accuracy.max_steps, STEPS_A_SAMPLE * times.shape[0])
    if accuracy.step is None:
        # Near rest the tyre is stiff and the step stands at the limit of stability. Where it overshoots the limit, what
        # the error control does not see, the derivatives, would grow; these gains hold it there quietly.
        gains = {"pcoeff": 0.2, "icoeff": 0.4, "safety": 0.8}
        # Half of the steps are left for the time in which the board moves.
        most = jnp.maximum(_stable_at_rest(model, gait, state, t0), 2 * (times[-1] - t0) / most_steps)
        controller = _Patient(rtol=accuracy.rtol, atol=accuracy.atol, at_rest=most, **gains)
        dt0 = jnp.minimum(1e-3, most)
    else:
        controller, dt0 = diffrax.ConstantStepSize(), accuracy.step
    # An empty tuple inside diffrax's state breaks its buffers, so it gets the leaves alone.
    leaves, structure = jax.tree.flatten(state)

    def rates(t: Scalar, y: list[Scalar], args: Gait) -> list[Scalar]:
        return jax.tree.leaves(model.rates(t, jax.tree.unflatten(structure, y), args))

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        diffrax.Tsit5(),
        t0=t0,
        t1=jnp.maximum(times[-1], t0 + 1e-9),
        dt0=dt0,
        y0=leaves,
        args=gait,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=controller,
        adjoint=diffrax.ForwardMode() if forward else diffrax.RecursiveCheckpointAdjoint(),
        max_steps=most_steps,
        throw=throw,
    )
    return jax.tree.unflatten(structure, solution.ys), solution.result == diffrax.RESULTS.successful


class _Patient(diffrax.PIDController):
    """Error control that bounds the steps of a board at rest as well.

    While nothing moves no step has an error, and steps would grow far beyond the limit of stability; the state would
    rest all the same, but its derivatives by whatever could move it would grow without bound. Where a step has changed
    nothing, the next one is no longer than `at_rest` [s].
    """

    at_rest: Scalar = eqx.field(default_factory=lambda: jnp.asarray(jnp.inf))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, *more):
        """As `diffrax.PIDController` has it, but for a board at rest."""
        keep, begin, end, *rest = super().adapt_step_size(t0, t1, y0, y1_candidate, *more)
        same = [jnp.all(a == b) for a, b in zip(jax.tree.leaves(y0), jax.tree.leaves(y1_candidate), strict=True)]
        return keep, begin, jnp.where(jnp.all(jnp.stack(same)), jnp.minimum(end, begin + self.at_rest), end), *rest


def _stable_at_rest(model: Model, gait: Gait, state: Any, t: Scalar) -> Scalar:
    """The longest step [s] with which small motions about rest die out as they should: 2 over their fastest rate."""
    body, memories = jax.tree.map(jnp.zeros_like, state)
    nudged = (*body[:3], *(part + NUDGE for part in body[3:]))
    rates = [jax.tree.leaves(model.rates(t, (at, memories), gait)[0])[3:] for at in (body, nudged)]
    fastest = jnp.max(jnp.abs(jnp.stack(rates[1]) - jnp.stack(rates[0]))) / NUDGE
    return 2.0 / jnp.maximum(jax.lax.stop_gradient(fastest), 1.0)


def motions(model: Model, gait: Gait, trajectory: Trajectory) -> tuple[Motion, tuple[Float[Array, " n"], ...]]:
    """The motion at every sample of `trajectory`, and the traction F_i [N] (n,) of each wheelset there."""

    def at(t: Scalar, state: Any) -> tuple[Any, tuple[Scalar, ...]]:
        motion = model.motion(t, state[0], gait)
        forces = model.traction(motion, state[1])
        return motion._replace(wheels=tuple(w._replace(wheelset=None) for w in motion.wheels), board=None), forces

    return jax.vmap(at)(trajectory.command_times, trajectory.state)
