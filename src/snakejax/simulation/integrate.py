"""Simulation of one run: integration of the equations of motion by Tsit5, with the derivative that is asked for."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Literal, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from snakejax.core.jax_config import require_x64
from snakejax.core.parameter import Scalar
from snakejax.dynamics.contact import Motion
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import held_signals

from .forward_loop import Rates, integrate_forward

NUDGE = 1e-9
"""Speed [m/s, rad/s] of the finite difference that gives the stiffness at rest."""
STEPS_A_SAMPLE = 8
"""Steps allowed for each sample of a long recording, if that is more than `Accuracy.max_steps`."""


class Accuracy(eqx.Module):
    """Accuracy of the integration: Tsit5 with local error below `atol + rtol |state|`, or with a fixed `step` [s].

    `derivative` is the automatic derivative that can be taken: "reverse" (`jax.grad`, `jax.vjp`) or "forward"
    (`jax.jvp`, `jax.jacfwd`). With a fixed step the steps do not depend on the parameters.
    """

    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-9)
    step: float | None = eqx.field(static=True, default=None)
    max_steps: int = eqx.field(static=True, default=65536)
    derivative: Literal["reverse", "forward"] = eqx.field(static=True, default="reverse")


class Trajectory(eqx.Module):
    """A simulated run: `times` (n,) [s] and the reported `pose` (n, 3): x, y [m], heading [rad].

    `state` is the state of the model with a leading axis n; `command_times` (n,) [s] are its times, which differ from
    `times` by the delay of the model. `finished` is False if the solver failed; the pose is then infinite.
    """

    times: Float[Array, " n"]
    pose: Float[Array, "n 3"]
    state: Any
    command_times: Float[Array, " n"]
    finished: Bool[Array, ""]


def simulate(
    model: Model,
    gait: AbstractInputs,
    times: Float[Array, " n"],
    start: Sequence[float] | Float[Array, " k"] = (0.0, 0.0, 0.0),
    *,
    accuracy: Accuracy = Accuracy(),  # noqa: B008
    throw: bool = True,
    resting: Bool[Array, ""] | bool = False,
) -> Trajectory:
    """Integrate `model` under `gait` and report its pose at `times`.

    `jax.jit`, `jax.vmap` and the derivative that `accuracy` names apply to it, over any leaf.

    **Arguments:** `times` [s] (n,), increasing. `start`: three numbers (x [m], y [m], heading [rad]) for a start at
    rest at time 0 (earlier if the logged joints begin to move earlier); or six numbers at `times[0]`, (x, y, heading,
    u, w, r) under `free` and (x, y, heading, u, beta, s) under `coupled`, optionally followed by the memories of
    `Model.initial_state`. `resting`: six numbers with zero velocities are a start at rest. `throw`: raise an error if
    the solver fails; else `Trajectory.finished` is False.

    **Raises:** `RuntimeError` without double precision; `ValueError` for a wrong shape of `start`; the error of the
    solver if it does not reach the accuracy.
    """
    require_x64()
    times, start = jnp.asarray(times), jnp.asarray(start, jnp.float64)
    if start.shape not in ((3,), (6,), (6 + model.memories,)):
        raise ValueError(f"Argument `start` must have 3 or 6 numbers, but its shape is {start.shape}.")
    return _simulate(model, gait, times, start, accuracy, throw, resting)


@eqx.filter_jit  # so that models and gaits of one structure share one program
def _simulate(model, gait, times, start, accuracy: Accuracy, throw: bool, resting) -> Trajectory:
    gait = model.prepared(gait)
    delayed, begins = times - model.delay(), gait.begins()
    if start.shape == (3,):
        t0, delayed = begins, jnp.maximum(delayed, begins)
        state = model.start((start[0], start[1], start[2]))
    else:
        # A board at rest at its start was at rest before, whatever the delay of the clocks.
        t0 = jnp.where(resting, begins, delayed[0])
        delayed = jnp.where(resting, jnp.maximum(delayed, begins), delayed)
        state = model.initial_state(tuple(start[k] for k in range(start.shape[0])), t0, gait)
    states, finished = _integrate(_Run(model, gait, state, t0, delayed), accuracy, throw)
    pose = jnp.stack(model.observe(states[0]), axis=-1)
    return Trajectory(times, jnp.where(finished, pose, jnp.inf), states, delayed, finished)


class _Run(NamedTuple):
    """A run from the `state` of the `model` at `begin` [s] over `times` (n,) [s]: all that its derivatives are by."""

    model: Model
    gait: AbstractInputs
    state: Any
    begin: Scalar
    times: Float[Array, " n"]


def _integrate(run: _Run, accuracy: Accuracy, throw: bool) -> tuple[Any, Bool[Array, ""]]:
    """The states at the times of `run`, with a leading axis n, and whether its end was reached."""
    if accuracy.derivative == "forward":
        return _by_forward_loop(run, accuracy, throw)
    return _with_reverse_derivative(run, accuracy, throw)


@eqx.filter_custom_vjp
def _with_reverse_derivative(run: _Run, accuracy: Accuracy, throw: bool) -> tuple[Any, Bool[Array, ""]]:
    """The smaller program, as long as no derivative is taken: it compiles in half the time of diffrax's."""
    return _by_forward_loop(run, accuracy, throw)


@_with_reverse_derivative.def_fwd
def _derivative_kept(perturbed, run: _Run, accuracy: Accuracy, throw: bool):
    del perturbed
    solved, pull = eqx.filter_vjp(lambda run: _by_diffrax(run, accuracy, throw), run)
    return solved, (pull, solved)


@_with_reverse_derivative.def_bwd
def _pulled_back(kept, cotangents, perturbed, run: _Run, accuracy: Accuracy, throw: bool):
    del perturbed, run, accuracy, throw
    pull, solved = kept

    def filled(out: Array | None, cotangent: Array | None) -> Array | None:
        # What does not reach the result has no cotangent.
        return jnp.zeros_like(out) if cotangent is None and out is not None else cotangent

    by_outputs = eqx.filter(solved, eqx.is_inexact_array)
    return pull(jax.tree.map(filled, by_outputs, cotangents, is_leaf=lambda part: part is None))[0]


class _Stepping(NamedTuple):
    """The `rates` of the leaves of a state, its `leaves` and their `structure`, and how the steps are chosen."""

    rates: Rates
    leaves: list[Scalar]
    structure: Any
    controller: diffrax.AbstractStepSizeController
    first_step: Scalar | float
    most_steps: int

    @staticmethod
    def of(run: _Run, accuracy: Accuracy) -> "_Stepping":
        model, gait, state = run.model, run.gait, run.state
        most_steps = max(accuracy.max_steps, STEPS_A_SAMPLE * run.times.shape[0])
        # diffrax fails on an empty tuple inside the state, so the list of leaves is integrated.
        leaves, structure = jax.tree.flatten(state)

        def rates(t: Scalar, y: list[Scalar]) -> list[Scalar]:
            return _rates(model, gait, structure, t, y)

        if accuracy.step is not None:
            return _Stepping(rates, leaves, structure, diffrax.ConstantStepSize(), accuracy.step, most_steps)
        # Near rest the tyre is stiff and stability limits the step. Beyond that limit the derivatives would grow, which
        # the error control does not measure; with these proportional and integral gains the step does not overshoot.
        gains = {"pcoeff": 0.2, "icoeff": 0.4, "safety": 0.8, "norm": _error_size(len(jax.tree.leaves(state[0])))}
        # The bound uses at most half of the steps; the others remain for the time in which the board moves.
        fixed = _without_derivative(run)
        most = jnp.maximum(_stable_at_rest(fixed), 2 * (fixed.times[-1] - fixed.begin) / most_steps)
        controller = _RestBoundedPIDController(rtol=accuracy.rtol, atol=accuracy.atol, from_rest=most, **gains)
        # A command that is held jumps at its samples: a step across a jump would have an error that no derivative
        # shows.
        jumps = [command.knots for command in held_signals(gait)]
        if jumps:
            at = jax.lax.stop_gradient(jnp.sort(jnp.concatenate(jumps)))
            controller = diffrax.ClipStepSizeController(controller, jump_ts=at)
        return _Stepping(rates, leaves, structure, controller, jnp.minimum(1e-3, most), most_steps)


@eqx.filter_jit  # so that programs that differ in their runs trace and differentiate it once
def _rates(model: Model, gait: AbstractInputs, structure: Any, t: Scalar, y: list[Scalar]) -> list[Scalar]:
    """The rates of the leaves `y` of a state with this `structure`."""
    return jax.tree.leaves(model.rates(t, jax.tree.unflatten(structure, y), gait))


def _without_derivative(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, tree)


def _by_forward_loop(run: _Run, accuracy: Accuracy, throw: bool) -> tuple[Any, Bool[Array, ""]]:
    rates, leaves, structure, *control = _Stepping.of(run, accuracy)
    samples, finished = integrate_forward(rates, leaves, run.begin, run.times, *control)
    if throw:
        samples = diffrax.RESULTS.max_steps_reached.error_if(samples, ~finished)
    return jax.tree.unflatten(structure, samples), finished


def _by_diffrax(run: _Run, accuracy: Accuracy, throw: bool) -> tuple[Any, Bool[Array, ""]]:
    how = _Stepping.of(run, accuracy)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, _: how.rates(t, y)),
        diffrax.Tsit5(),
        t0=run.begin,
        t1=jnp.maximum(run.times[-1], run.begin + 1e-9),
        dt0=how.first_step,
        y0=how.leaves,
        saveat=diffrax.SaveAt(ts=run.times),
        stepsize_controller=how.controller,
        max_steps=how.most_steps,
        throw=throw,
    )
    return jax.tree.unflatten(how.structure, solution.ys), solution.result == diffrax.RESULTS.successful


@cache
def _error_size(count: int) -> Callable[[list[Scalar]], Scalar]:
    """Error norm sqrt(sum of squares / count), with `count` the number of states of the board.

    Memories of effects at neutral value have no error; counting them would make the other errors appear smaller.
    """

    def size(errors: list[Scalar]) -> Scalar:
        square = sum((error**2 for error in errors), jnp.zeros(())) / count
        moving = square > 0
        return jnp.where(moving, jnp.sqrt(jnp.where(moving, square, 1.0)), 0.0)

    return size


class _RestBoundedPIDController(diffrax.PIDController):
    """PID step size control that also bounds the step while the board is at rest.

    At rest no step has an error, so steps would grow far beyond the stability limit: the state would stay at rest, but
    its derivatives would grow without bound. After a step that changes no state the next one is at most `from_rest`
    [s].

    A step has no derivative: its end moves as its begin. Where a run begins later the first step to a jump of a command
    is shorter by as much, and the steps after it would change by a multiple of that at each jump.
    """

    from_rest: Scalar = eqx.field(default_factory=lambda: jnp.asarray(jnp.inf))

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state):
        """The step of `diffrax.PIDController`, bounded by `from_rest` while no state changes."""
        keep, begin, end, jumped, memory, result = super().adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        same = [jnp.all(a == b) for a, b in zip(jax.tree.leaves(y0), jax.tree.leaves(y1_candidate), strict=True)]
        end = jnp.where(jnp.all(jnp.stack(same)), jnp.minimum(end, begin + self.from_rest), end)
        end = jax.lax.stop_gradient(end) + (begin - jax.lax.stop_gradient(begin))
        return keep, begin, end, jumped, memory, result


def _stable_at_rest(run: _Run) -> Scalar:
    """The longest step [s] near rest, 2 / fastest decay rate: inside the stability interval of Tsit5."""
    structure = jax.tree.structure(run.state)
    body, memories = jax.tree.map(lambda part: jnp.zeros((), jnp.result_type(part)), run.state)
    if not body[3:]:  # The inputs alone prescribe the motion.
        return jnp.asarray(jnp.inf)
    nudged = (*body[:3], *(part + NUDGE for part in body[3:]))
    pairs = zip(*(jax.tree.leaves((at, memories)) for at in (body, nudged)), strict=True)
    both = [jnp.stack(pair) for pair in pairs]
    # One after the other, so that the program holds the rates once for both.
    at_rest = jax.lax.map(lambda y: _rates(run.model, run.gait, structure, run.begin, y), both)
    velocities = jnp.stack(at_rest[3 : len(body)])
    fastest = jnp.max(jnp.abs(velocities[:, 1] - velocities[:, 0])) / NUDGE
    return 2.0 / jnp.maximum(fastest, 1.0)


def motions(
    model: Model, gait: AbstractInputs, trajectory: Trajectory
) -> tuple[Motion, tuple[Float[Array, " n"], ...]]:
    """The motion at every sample of `trajectory`, and the lateral tyre force F_i [N] (n,) of each wheelset."""

    def at(t: Scalar, state: Any) -> tuple[Any, tuple[Scalar, ...]]:
        motion = model.motion(t, state[0], gait)
        forces = model.traction(motion, state[1])
        return motion._replace(wheels=tuple(w._replace(wheelset=None) for w in motion.wheels), board=None), forces

    return jax.vmap(at)(trajectory.command_times, trajectory.state)
