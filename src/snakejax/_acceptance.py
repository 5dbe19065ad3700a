"""Whether a step is believed: the tests that an effect must pass to be added, and to stay."""

import numpy as np
from scipy import stats

from ._bench import HOPELESS, NEARLY, Bench, Step
from ._estimates import spread
from ._least_squares import starts_removed
from ._misfit import NOISE_SIGMAS, noise_band, only_noise
from ._score import ALPHA
from ._study import Optimum, inverse

OPEN = 1e-9
"""What runs left together tell of a parameter at the least, as a share of what all tell: it keeps matrices regular."""
TELLING = 0.05
"""An effect that lowers the excess of the misfit over noise by less than this share, short of noise, is no help."""


def by_chance(freed: int) -> float:
    """The fall of chi^2 that freeing `freed` parameters brings by chance, at a 25th of the level `ALPHA`."""
    return float(stats.chi2.isf(ALPHA / 25, max(freed, 1)))


def better(bench: Bench, now: Step, then: Step) -> bool:
    """Whether `then` predicts train runs it has not seen better than `now` does, and enough to matter.

    A fall of chi^2 within a score test's reach of zero is no evidence; with one train run it is all there is. Where
    `now` is far from the recordings the misfit of its own fit stands for what it would predict, which favours it.
    """
    samples = now.optimum.samples
    fall = samples * (now.optimum.misfit - then.optimum.misfit)
    variance = max(1.0, then.optimum.misfit)
    freed = len(then.optimum.free) - len(now.optimum.free)
    if not np.isfinite(then.optimum.misfit) or fall / variance < by_chance(freed):
        return False
    if not only_noise(then.optimum):
        excess = now.optimum.misfit - 1.0
        if now.optimum.misfit - then.optimum.misfit < TELLING * excess:
            return False
    if then.optimum.misfit > HOPELESS or len(bench.train) < 2:
        return True
    present = samples * (1 + np.log(now.optimum.misfit))
    if now.optimum.misfit < NEARLY:
        present = left_out_score(bench, now)
    return left_out_score(bench, then) < present


def better_structure(now: Step, then: Step) -> bool:
    """Whether a change of structure, which frees nothing, lowers the misfit by more than chance."""
    fall = then.optimum.samples * (now.optimum.misfit - then.optimum.misfit)
    return bool(fall > by_chance(0))


def left_out_score(bench: Bench, step: Step) -> float:
    """-2 log probability of each train run under parameters fitted to the other train runs, by the linear model.

    With r_k, J_k the residual and Jacobian of run k, starts projected out, and N the sum of J_j^T J_j over the other
    runs, leaving out run k moves the parameters by d = -N^-1 sum_(j != k) J_j^T r_j. Its residual is then
    r = r_k + J_k d, of variance s^2 V with V = 1 + J_k N^-1 J_k^T: what the others leave open does not count against
    it. The score is n ln s^2 + ln |V| + r^T V^-1 r / s^2, with s^2 the misfit, at least 1.
    """
    optimum = step.optimum
    loose = [optimum.free.index(name) for name in optimum.loose]
    free_start = np.asarray(bench.study.batch.free_start)
    parts = [starts_removed(optimum.linearised, k, bench.study.width, free_start) for k in bench.train]
    size = np.sqrt(sum((J[:, loose] ** 2).sum(axis=0) for _, J in parts))
    columns = [J[:, loose] / np.where(size > 0, size, 1.0) for _, J in parts]
    normals, slopes = [J.T @ J for J in columns], [J.T @ r for J, (r, _) in zip(columns, parts, strict=True)]
    variance, total = max(optimum.misfit, 1.0), optimum.samples * float(np.log(max(optimum.misfit, 1.0)))
    for (r, _), J, normal, slope in zip(parts, columns, normals, slopes, strict=True):
        others = sum(normals) - normal + OPEN * np.eye(len(loose))
        left = r - J @ np.linalg.solve(others, sum(slopes) - slope)
        inside = np.linalg.solve(others + normal, J.T @ left)
        total += float(np.linalg.slogdet(others + normal)[1] - np.linalg.slogdet(others)[1])
        total += float(left @ left - (J.T @ left) @ inside) / variance
    return total


def certain(bench: Bench, step: Step, name: str) -> bool:
    """Whether `name` is so far from neutral, in its standard errors, that no refit without it is needed."""
    parts = [part for part in bench.candidates[name] if part in step.optimum.loose]
    if not parts or not only_noise(step.optimum):
        return False
    rows = [step.optimum.loose.index(part) for part in parts]
    values = np.array([step.optimum.values[part] for part in parts])
    covariance = step.optimum.covariance[np.ix_(rows, rows)]
    wald = float(values @ inverse(covariance) @ values) if np.isfinite(covariance).all() else 0.0
    return wald > 1e3 * len(parts)


def heldout_noise(bench: Bench, step: Step, heldout: Optimum | None) -> bool:
    """Whether the held-out misfit is that of noise, allowing for the uncertainty of the parameters carried over.

    Where held-out runs go so far beyond the train runs that this uncertainty cannot be carried over by a linear model,
    the question is whether one set of parameters leaves only noise of all runs together.
    """
    if heldout is None:
        return True
    carried = _carried(bench, step, heldout)
    if heldout.misfit <= noise_band(heldout.samples, 0)[1] + NOISE_SIGMAS * carried / heldout.samples:
        return True
    held = bench.study.numbered("heldout")
    start = step.optimum.start.copy()
    start[held] = heldout.start[held]
    return only_noise(bench.study.fit(step.optimum.values, bench.free(step.effects), [*bench.train, *held], start))


def _carried(bench: Bench, step: Step, heldout: Optimum) -> float:
    """Expected rise of the held-out chi^2 from the errors of the parameters, trace(J cov J^T)."""
    free = bench.free(step.effects)
    at = bench.study.at(heldout.values, free, heldout.start)
    found = bench.study.evaluate(at, bench.study.numbered("heldout"))
    columns = [free.index(name) for name in step.optimum.loose]
    J = found.jacobian[bench.study.numbered("heldout")][..., columns].reshape(-1, len(columns))
    return float(np.einsum("ni,ij,nj->", J, step.optimum.covariance * spread(step.optimum) ** 2, J))
