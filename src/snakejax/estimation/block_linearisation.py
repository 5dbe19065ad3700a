"""Linearisation of runs or windows by any number of parameters, in blocks that one compiled program serves."""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import parameters
from snakejax.dynamics.ports import Delay
from snakejax.dynamics.sampled_signals import held_signals

from .least_squares import linearise_in_threads
from .linearisation import LANES, Linearised, Variables
from .problem import Problem

DELAY_STEP = 0.02
"""Step [s] of the difference quotient by a delay: commands are held for some 0.1 s."""
BLOCK = 2 * LANES
"""Directions, start state and all, of a block: it serves every choice of parameters, where one program for each number
of them would take longer to compile than its fewer directions save."""


def _delays(problem: Problem) -> list[str]:
    """The parameters that delay commands which are held between samples: where a window begins at a jump of a command,
    the derivative by them is that of one side, and a step to the other side is misled."""
    if not held_signals(problem.batch.gait):
        return []
    late = {name: effect for name, effect in problem.model.effects.items() if isinstance(effect, Delay)}
    return [f"effects.{name}.{part}" for name, effect in late.items() for part in parameters(effect)]


def linearise_runs(
    problem: Problem,
    values: Mapping[str, float],
    start: np.ndarray,
    runs: Sequence[int],
    free: Sequence[str] | None = None,
) -> Linearised:
    """Residuals of `runs` and their Jacobian by the parameters `free` (default: all of `problem.names`) and the start.

    Threads share the runs. The columns are computed in blocks, by one program. The column of a parameter that delays
    held commands is the central difference quotient over `DELAY_STEP`.
    """
    columns = problem.names if free is None else free
    width = len(columns) if free is None else problem.width
    size = _block_size(problem)
    parts = [
        _linearised_block(problem, values, start, runs, columns[k : k + size], size)
        for k in range(0, max(len(columns), 1), size)
    ]
    by_columns = np.concatenate([part.jacobian[..., :size] for part in parts], axis=-1)[..., : len(columns)]
    padded = np.pad(by_columns, [(0, 0)] * 3 + [(0, width - len(columns))])
    by_start = parts[0].jacobian[..., size:]
    linearised = Linearised(parts[0].residual, np.concatenate([padded, by_start], axis=-1))
    for name in (delay for delay in _delays(problem) if delay in columns):
        late, early = (
            linearise_runs(problem, {**values, name: values[name] + step}, start, runs, ()).residual
            for step in (DELAY_STEP, -DELAY_STEP)
        )
        with np.errstate(invalid="ignore"):
            quotient = (late - early) / (2 * DELAY_STEP)
        linearised.jacobian[..., list(columns).index(name)] = np.where(np.isfinite(quotient), quotient, 0.0)
    return linearised


def _block_size(problem: Problem) -> int:
    """The number of parameters in a block: with the start state they fill `BLOCK` or the next multiple of `LANES`."""
    depth = problem.batch.start.shape[1]
    return max(BLOCK, -(-(depth + 1) // LANES) * LANES) - depth


def _linearised_block(
    problem: Problem,
    values: Mapping[str, float],
    start: np.ndarray,
    runs: Sequence[int],
    block: Sequence[str],
    width: int,
) -> Linearised:
    """Residuals of `runs` and their Jacobian by the parameters `block`, in `width` columns, and the start."""
    directions = np.zeros((width, len(problem.names)))
    directions[range(len(block)), [problem.names.index(name) for name in block]] = 1.0
    vector = jnp.asarray([values[name] for name in problem.names])
    point = Variables(problem.names, vector, jnp.asarray(directions), jnp.asarray(start), problem.batch.free_start)
    steps = np.zeros(width), np.zeros(problem.batch.start.shape)
    return linearise_in_threads(problem.model, point, problem.batch, list(runs), problem.accuracy, *steps)
