"""The clocks of joint logs from short windows, where what a model lacks does little.

Over whole runs a missing effect leads the clocks astray. Over windows with starts of their own the residuals r depend
on the clocks and the parameters almost linearly, and one step of Gauss and Newton over both moves the clocks.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from ._least_squares import starts_removed
from ._log_clocks import STILL, by_clock, by_clocks, free_clocks, moved_clock
from ._model import Model
from ._recording import Noise, Run
from ._skid import Coupled, Free
from ._study import Study, dependence_of, inverse
from ._units import parameters
from ._windows import LENGTH, Settled, Windows

ROUNDS = 8
FARTHEST = {"offset": 0.05, "drift": 5e-3}
"""How far one step moves a clock at the most: [s] and [-]."""


def window_clocks(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Run, ...]:
    """`runs` with their free clocks where the windows want them, with standard errors; the parameters `free` are fitted
    beside, for held-out runs by themselves.

    The ideal structure, whose wheels do not skid, has no windows, and the runs are as they were.
    """
    moved = list(runs)
    if not isinstance(model.skid, Coupled | Free):
        return tuple(moved)
    known = parameters(model)
    values = {name: float(known[name].value) for name in free}
    for role in ("train", "heldout"):
        numbers = [k for k, run in enumerate(runs) if run.role == role]
        if not any(free_clocks(runs[k]) for k in numbers):
            continue
        start = None
        for _ in range(ROUNDS):
            progress("aligning the clocks of the joint logs")
            windows = Windows.of(model, [moved[k] for k in numbers], noise, free, max(len(free), 1), LENGTH)
            settled = windows.settle(values, free, start)
            values, start = settled.values, settled.start
            step, precise, sd = _step(windows, settled, moved, numbers, free)
            sds = by_clock(moved, numbers, sd)
            for k, steps in by_clock(moved, numbers, step).items():
                moved[k] = moved_clock(moved[k], steps, sds[k], "short windows")
            if (np.abs(step) < STILL * precise).all():
                break
    return tuple(moved)


def _step(
    windows: Windows, settled: Settled, runs: Sequence[Run], numbers: Sequence[int], free: Sequence[str]
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """How far the clocks of the runs `numbers` should move, and the standard errors: of noise alone, and of all that is
    left.
    """
    study, found = windows.study, settled.found
    clocks = [(runs[k].name, name) for k in numbers for name in free_clocks(runs[k])]

    def residual(moved: Study) -> np.ndarray:
        return np.asarray(Windows(moved).at(settled.values, settled.start, ()).residual)

    slopes = {name: by_clocks(study, name, residual) for name in {name for _, name in clocks}}
    count, P, free_start = len(clocks), len(free), np.asarray(study.batch.free_start)
    normal, right = np.zeros((count + P,) * 2), np.zeros(count + P)
    for w, window in enumerate(study.runs):
        own = np.zeros((found.residual[w].size, count))
        for place, (run, name) in enumerate(clocks):
            if window.name.rsplit("[", 1)[0] == run:
                own[:, place] = slopes[name][w].reshape(-1)
        if not all(np.isfinite(part).all() for part in (found.residual[w], found.jacobian[w], own)):
            continue
        r, J = starts_removed(found, w, study.width, free_start, own)
        columns = np.concatenate([J[:, study.width :], J[:, :P]], axis=1)
        normal += columns.T @ columns
        right -= columns.T @ r
    pull, strength = study.typical(settled.values, free)
    misfit = settled.cost / max(found.residual.size, 1)
    precision = dependence_of(misfit) * strength[:P] ** 2
    normal[count:, count:] += np.diag(precision)
    right[count:] += precision * pull[:P]
    covariance = inverse(normal)
    most = np.array([FARTHEST[name] for _, name in clocks])
    step = np.clip((covariance @ right)[:count], -most, most)
    sd = np.sqrt(np.diag(covariance)[:count])
    return step, sd, sd * np.sqrt(max(misfit, 1.0) * dependence_of(misfit))
