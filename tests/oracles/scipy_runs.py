"""Runs of any model by scipy: the rates are the package's, the steps are not."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Trajectory


def integrated(
    model: Model,
    inputs: AbstractInputs,
    times: Any,
    start: Any = (0.0, 0.0, 0.0),
    *,
    method: str = "DOP853",
    rtol: float = 1e-11,
    atol: float = 1e-12,
    most: float = np.inf,
) -> Trajectory:
    """What `simulate` returns, by a method of scipy in steps of at most `most` [s].

    `start` is a pose at rest at time 0, or a pose and the velocities (6) or a whole state of the model at the first of
    `times`.
    """
    inputs = model.prepared(inputs)
    times = np.asarray(times, float)
    asked = times - float(model.delay())
    whole, resting = isinstance(start[0], tuple), len(start) == 3
    begin = 0.0 if resting else asked[0]
    if not whole:
        numbers = tuple(jnp.asarray(float(number)) for number in start)
        start = model.start(numbers) if resting else model.initial_state(numbers, jnp.asarray(begin), inputs)
    y0, structure = jax.tree.flatten(start)
    leaves, kind = jax.tree.flatten((model, inputs))
    leaves = [jnp.asarray(leaf, float) for leaf in leaves]
    numbers = np.concatenate([np.zeros(0), *(np.ravel(leaf) for leaf in leaves)])
    rates, jacobian = _compiled(kind, structure, tuple(leaf.shape for leaf in leaves))
    how: dict[str, Any] = {"rtol": rtol, "atol": atol, "max_step": most}
    if method == "Radau":
        how["jac"] = lambda t, y: np.asarray(jacobian(numbers, t, y))
    at, back = np.unique(np.maximum(asked, begin), return_inverse=True)
    span = (begin, max(at[-1], begin + 1e-12))
    done = solve_ivp(lambda t, y: np.asarray(rates(numbers, t, y)), span, np.array(y0, float), method, at, **how)
    assert done.success, done.message
    states = jax.tree.unflatten(structure, list(jnp.asarray(done.y[:, back])))
    pose = jnp.stack(model.observe(states[0]), axis=-1)
    return Trajectory(jnp.asarray(times), pose, states, jnp.asarray(asked), jnp.asarray(True))


@cache
def _compiled(kind, structure, shapes):
    """The rates and their Jacobian as functions of all numbers of model and inputs, time and state; compiled once for
    each structure."""
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])

    def rates(numbers, t, y):
        parts = [numbers[a:b].reshape(shape) for a, b, shape in zip(ends, ends[1:], shapes, strict=False)]
        model, inputs = jax.tree.unflatten(kind, parts)
        return jnp.stack(jax.tree.leaves(model.rates(t, jax.tree.unflatten(structure, list(y)), inputs)))

    return jax.jit(rates), jax.jit(jax.jacfwd(rates, argnums=2))
