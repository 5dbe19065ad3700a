"""The acceptance criterion: the tests that an effect must pass to be added, and to stay."""

import numpy as np
from scipy import stats

from snakejax.estimation.goodness_of_fit import NOISE_SIGMAS, consistent_with_noise, largest_noise_misfit
from snakejax.estimation.linearisation import project_out_starts
from snakejax.estimation.problem import Solution, covariance_of
from snakejax.estimation.uncertainty import spread

from .candidates import CandidateFit, CandidateSet
from .criteria import CRITERIA, SelectionCriteria


def chi2_threshold(freed: int, criteria: SelectionCriteria = CRITERIA) -> float:
    """The fall of chi^2 that freeing `freed` parameters brings by chance, at the level divided by the candidates."""
    return float(stats.chi2.isf(criteria.significance_level / criteria.nominal_candidates, max(freed, 1)))


def accept_addition(candidate_set: CandidateSet, now: CandidateFit, then: CandidateFit) -> bool:
    """Whether `then` predicts train runs it has not seen better than `now` does, and enough to matter.

    A fall of chi^2 within a score test's reach of zero is no evidence; with one train run it is all there is. Where
    `now` is far from the recordings the misfit of its own fit stands for what it would predict, which favours it.
    """
    samples = now.solution.samples
    fall = samples * (now.solution.misfit - then.solution.misfit)
    variance = max(1.0, then.solution.misfit)
    freed = len(then.solution.free) - len(now.solution.free)
    if not np.isfinite(then.solution.misfit) or fall / variance < chi2_threshold(freed, candidate_set.criteria):
        return False
    if not consistent_with_noise(then.solution):
        excess = now.solution.misfit - 1.0
        if now.solution.misfit - then.solution.misfit < candidate_set.criteria.least_excess_share * excess:
            return False
    if then.solution.misfit > candidate_set.criteria.far_misfit or len(candidate_set.train) < 2:
        return True
    present = samples * (1 + np.log(now.solution.misfit))
    if now.solution.misfit < candidate_set.criteria.linear_misfit:
        present = leave_one_run_out_score(candidate_set, now)
    return leave_one_run_out_score(candidate_set, then) < present


def accept_structure(now: CandidateFit, then: CandidateFit, criteria: SelectionCriteria = CRITERIA) -> bool:
    """Whether a change of structure, which frees nothing, lowers the misfit by more than chance."""
    fall = then.solution.samples * (now.solution.misfit - then.solution.misfit)
    return bool(fall > chi2_threshold(0, criteria))


def leave_one_run_out_score(candidate_set: CandidateSet, step: CandidateFit) -> float:
    """-2 log probability of each train run under parameters fitted to the other train runs, by the linear model.

    With r_k, J_k the residual and Jacobian of run k, starts projected out, and N the sum of J_j^T J_j over the other
    runs, leaving out run k moves the parameters by d = -N^-1 sum_(j != k) J_j^T r_j. Its residual is then
    r = r_k + J_k d, of variance s^2 V with V = 1 + J_k N^-1 J_k^T: what the others leave open does not count against
    it. The score is n ln s^2 + ln |V| + r^T V^-1 r / s^2, with s^2 the misfit, at least 1.
    """
    solution = step.solution
    loose = [solution.free.index(name) for name in solution.loose]
    free_start = np.asarray(candidate_set.problem.batch.free_start)
    parts = [
        project_out_starts(solution.linearised, k, candidate_set.problem.width, free_start) for k in candidate_set.train
    ]
    size = np.sqrt(sum((J[:, loose] ** 2).sum(axis=0) for _, J in parts))
    columns = [J[:, loose] / np.where(size > 0, size, 1.0) for _, J in parts]
    normals, slopes = [J.T @ J for J in columns], [J.T @ r for J, (r, _) in zip(columns, parts, strict=True)]
    variance, total = max(solution.misfit, 1.0), solution.samples * float(np.log(max(solution.misfit, 1.0)))
    for (r, _), J, normal, slope in zip(parts, columns, normals, slopes, strict=True):
        others = sum(normals) - normal + candidate_set.criteria.least_shared_information * np.eye(len(loose))
        left = r - J @ np.linalg.solve(others, sum(slopes) - slope)
        inside = np.linalg.solve(others + normal, J.T @ left)
        total += float(np.linalg.slogdet(others + normal)[1] - np.linalg.slogdet(others)[1])
        total += float(left @ left - (J.T @ left) @ inside) / variance
    return total


def wald_significant(candidate_set: CandidateSet, step: CandidateFit, name: str) -> bool:
    """Whether `name` is so far from neutral, in its standard errors, that no refit without it is needed."""
    parts = [part for part in candidate_set.candidates[name] if part in step.solution.loose]
    if not parts or not consistent_with_noise(step.solution):
        return False
    rows = [step.solution.loose.index(part) for part in parts]
    values = np.array([step.solution.values[part] for part in parts])
    covariance = step.solution.covariance[np.ix_(rows, rows)]
    wald = float(values @ covariance_of(covariance) @ values) if np.isfinite(covariance).all() else 0.0
    return wald > candidate_set.criteria.wald_per_parameter * len(parts)


def heldout_consistent(candidate_set: CandidateSet, step: CandidateFit, heldout: Solution | None) -> bool:
    """Whether the held-out misfit is that of noise, allowing for the uncertainty of the parameters carried over.

    Where held-out runs go so far beyond the train runs that this uncertainty cannot be carried over by a linear model,
    the question is whether one set of parameters leaves only noise of all runs together.
    """
    if heldout is None:
        return True
    carried = _carried(candidate_set, step, heldout)
    if heldout.misfit <= largest_noise_misfit(heldout.samples) + NOISE_SIGMAS * carried / heldout.samples:
        return True
    held = candidate_set.problem.run_indices("heldout")
    start = step.solution.start.copy()
    start[held] = heldout.start[held]
    return consistent_with_noise(
        candidate_set.problem.fit(
            step.solution.values, candidate_set.free(step.effects), [*candidate_set.train, *held], start
        )
    )


def _carried(candidate_set: CandidateSet, step: CandidateFit, heldout: Solution) -> float:
    """Expected rise of the held-out chi^2 from the errors of the parameters, trace(J cov J^T)."""
    free = candidate_set.free(step.effects)
    at = candidate_set.problem.at(heldout.values, free, heldout.start)
    linearised = candidate_set.problem.evaluate(at, candidate_set.problem.run_indices("heldout"))
    columns = [free.index(name) for name in step.solution.loose]
    J = linearised.jacobian[candidate_set.problem.run_indices("heldout")][..., columns].reshape(-1, len(columns))
    return float(np.einsum("ni,ij,nj->", J, step.solution.covariance * spread(step.solution) ** 2, J))
