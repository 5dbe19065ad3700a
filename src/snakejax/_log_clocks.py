"""The free clocks of joint logs, and runs whose clocks have moved."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._gait import on_clock
from ._recording import LogClock, Run
from ._study import Study

STILL = 0.2
"""Clocks that move by less than this share of their standard error stand still."""
STEPS = {"offset": 4e-3, "drift": 4e-4}
"""Steps of the central differences: [s] and [-]; smaller ones would show the solver's errors along a noisy log."""


def free_clocks(run: Run) -> tuple[str, ...]:
    """Those of "offset" and "drift" that are to be estimated."""
    return run.log.free if run.log is not None else ()


def by_clock(
    runs: Sequence[Run], numbers: Sequence[int], values: Float[np.ndarray, " m"]
) -> dict[int, dict[str, float]]:
    """The first of `values` as they belong to the free clocks of the runs `numbers`: by number, and by name."""
    place = iter(values)
    return {k: {name: float(next(place)) for name in names} for k in numbers if (names := free_clocks(runs[k]))}


def moved_clock(run: Run, step: Mapping[str, float], sd: Mapping[str, float], source: str) -> Run:
    """`run` with its log's clock moved by `step`: what the clock shows at t, t (1 + d) + o, gets both parts of it."""
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


def by_clocks(
    study: Study, name: str, residual: Callable[[Study], Float[np.ndarray, "R n 3"]]
) -> Float[np.ndarray, "R n 3"]:
    """The derivative of the whitened `residual` by the "offset" [s] or the "drift" of every log's clock."""

    def side(amount: float) -> np.ndarray:
        offset, drift = (amount * (name == kind) for kind in ("offset", "drift"))
        gaits = jax.vmap(lambda gait: on_clock(gait, offset, drift))(study.batch.gait)
        return np.asarray(residual(eqx.tree_at(lambda s: s.batch.gait, study, gaits)))

    return (side(STEPS[name]) - side(-STEPS[name])) / (2 * STEPS[name])
