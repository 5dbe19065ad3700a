"""Clock offset and drift of joint logs: which are estimated, and runs with changed clocks."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from snakejax.dynamics.inputs import on_clock
from snakejax.recording.run import LogClock, Run

from ..problem import Problem

STILL = 0.2
"""The estimate of clocks has converged if no step is larger than this fraction of its standard error."""
STEPS = {"offset": 4e-3, "drift": 4e-4}
"""Steps of the central differences, [s] and [-]; with smaller ones the errors of the solver along a noisy log show."""


def free_clocks(run: Run) -> tuple[str, ...]:
    """Those of "offset" and "drift" that are estimated for `run`."""
    return run.log.free if run.log is not None else ()


def clock_sensitivity(
    runs: Sequence[Run], numbers: Sequence[int], values: Float[np.ndarray, " m"]
) -> dict[int, dict[str, float]]:
    """The leading `values` assigned to the free clocks of the runs `numbers`: by index of the run, then by name."""
    place = iter(values)
    return {k: {name: float(next(place)) for name in names} for k in numbers if (names := free_clocks(runs[k]))}


def moved_clock(run: Run, step: Mapping[str, float], sd: Mapping[str, float], source: str) -> Run:
    """`run` with the clock of its log, t (1 + d) + o, changed by the steps of offset o [s] and drift d [-]."""
    log = run.log
    assert log is not None
    offset, drift = step.get("offset", 0.0), step.get("drift", 0.0)
    new = LogClock(
        log.offset + (1 + log.drift) * offset,
        log.drift + (1 + log.drift) * drift,
        sd.get("offset", log.offset_sd),
        sd.get("drift", log.drift_sd),
        source,
        log.free,
    )
    return dataclasses.replace(run, gait=on_clock(run.gait, jnp.asarray(offset), jnp.asarray(drift)), log=new)


def clock_sensitivities(
    problem: Problem, name: str, residual: Callable[[Problem], Float[np.ndarray, "R n 3"]]
) -> Float[np.ndarray, "R n 3"]:
    """The derivative (R, n, 3) of the whitened `residual` by the "offset" [1/s] or "drift" of each log, by central
    differences."""

    def side(amount: float) -> np.ndarray:
        offset, drift = (amount * (name == kind) for kind in ("offset", "drift"))
        gaits = jax.vmap(lambda gait: on_clock(gait, offset, drift))(problem.batch.gait)
        return np.asarray(residual(eqx.tree_at(lambda s: s.batch.gait, problem, gaits)))

    return (side(STEPS[name]) - side(-STEPS[name])) / (2 * STEPS[name])
