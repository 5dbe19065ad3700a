"""The force of laws along replayed runs, which the charts of a missing force draw over its estimate."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.parameter import Scalar
from snakejax.diagnosis.residuals.replays import RunReplay
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.law import Law
from snakejax.dynamics.model import Model
from snakejax.estimation.batch import lengthened, padded_length
from snakejax.estimation.fitted_model import FittedModel


def law_forces(fitted: FittedModel, replays: Sequence[RunReplay]) -> dict[str, Float[np.ndarray, "n 3"]]:
    """X, Y [N] and N [N m] of all laws of the `fitted` model together along each run, by its name; empty where no law
    adds a force: one of the grip changes the forces that are there."""
    model, forces = fitted.model, {}
    runs, most = {run.name: run for run in fitted.recordings}, padded_length(fitted.recordings)
    for replay in replays:
        run, count = runs[replay.run], len(replay.times)
        # Runs of all lengths share one program.
        states, times = jax.tree.map(partial(lengthened, extra=most - count), (replay.states, replay.times))
        force = _along(model.in_run(run.payload, run.codes), run.gait, times, states)
        if force is None:
            return {}
        forces[replay.run] = np.asarray(force)[:count]
    return forces


@eqx.filter_jit
def _along(model: Model, gait: AbstractInputs, times: Float[Array, " n"], states: Any) -> Float[Array, "n 3"] | None:
    """The force of all laws at each state, None without any."""
    laws = [effect for effect in model.effects.values() if isinstance(effect, Law)]

    def at(t: Scalar, state: Any) -> Float[Array, "3"] | None:
        motion = model.motion(t, state[0], gait)
        forces = [force for law in laws if (force := law.force_on_body(motion)) is not None]
        return sum((jnp.stack(force) for force in forces), jnp.zeros(3)) if forces else None

    return jax.vmap(at)(times - model.delay(), states)
