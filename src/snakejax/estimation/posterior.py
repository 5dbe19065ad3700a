"""Samples from the posterior of a fit: models that the recordings do not distinguish."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from snakejax.core.parameter import with_parameters
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.model import Model

from .fit_record import Fit
from .fit_workspace import problem_of
from .linearisation import domains_of, project_out_starts
from .problem import Problem, Solution, covariance_of
from .uncertainty import spread

LIKELY = 0.99
"""Samples lie within the confidence region of this probability."""
_HALVINGS = 8
"""Largest number of times that a sampled step outside the region is halved."""


def posterior_samples(fit: Fit, count: int, seed: int = 0, progress: Progress = no_progress) -> list[Model]:
    """`count` models sampled from the normal approximation of the posterior of a fit.

    Steps of the interior parameters are sampled from N(0, covariance spread^2). A parameter at a bound is sampled
    around its unconstrained optimum and stays at the bound unless the sample lies inside; the interior parameters
    follow by the linear model. A step that raises chi^2, with the start states refitted, beyond the 99 % region is
    halved until it does not: there the problem is far from linear.
    """
    problem, best = problem_of(fit)
    names, train = list(best.free), problem.run_indices("train")
    if not names:
        return [fit.model] * count
    rng = np.random.default_rng(seed)
    scale, best_cost = spread(best), problem.cost(best, train)
    limit = stats.chi2.ppf(LIKELY, len(names)) * scale**2
    domains = domains_of(problem.model, names)
    bound = _BoundParameters.of(problem, best, train)
    root, held_root = _root(best.covariance), _root(bound.covariance)
    loose, held = bound.loose, bound.held

    def moved(step: np.ndarray) -> dict[str, float]:
        values = dict(best.values)
        for name, domain, move in zip(names, domains, step, strict=True):
            values[name] = domain.moved_inside(values[name], move)
        return values

    def drawn() -> np.ndarray:
        step = np.zeros(len(names))
        outward = bound.centre + held_root @ rng.standard_normal(len(held)) * scale
        step[held] = np.where(outward * bound.inward > 0, outward, 0.0)
        step[loose] = bound.follow @ step[held] + root @ rng.standard_normal(len(loose)) * scale
        return step

    def likely(values: dict[str, float]) -> bool:
        refitted = problem.fit(values, (), train, best.start, most=6)
        return bool(problem.cost(refitted, train) - best_cost <= limit)

    models = []
    for k in range(count):
        progress(ProgressEvent(Phase.POSTERIOR_SAMPLES, done=k, total=count))
        step = drawn()
        for _ in range(_HALVINGS):
            if likely(moved(step)):
                break
            step = step / 2
        models.append(with_parameters(problem.model, moved(step)))
    return models


class _BoundParameters(NamedTuple):
    """Parameters at bounds, which have no standard error from the fit, in the linear model without bounds.

    `loose`, `held`: indices of interior parameters and of those at bounds; `centre`: unconstrained step of `held`;
    `covariance`: theirs, for unit noise; `inward`: sign of a step into the domain; `follow`: derivative of the steps of
    `loose` by those of `held`.
    """

    loose: list[int]
    held: list[int]
    centre: Float[np.ndarray, " h"]
    covariance: Float[np.ndarray, "h h"]
    inward: Float[np.ndarray, " h"]
    follow: Float[np.ndarray, "l h"]

    @staticmethod
    def of(problem: Problem, best: Solution, runs: list[int]) -> "_BoundParameters":
        names = list(best.free)
        loose, held = ([k for k, name in enumerate(names) if (name in best.held) is on] for on in (False, True))
        free_start = np.asarray(problem.batch.free_start)
        parts = [project_out_starts(best.linearised, k, problem.width, free_start) for k in runs]
        residual, J = np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])
        jacobians = J[:, loose], J[:, held]
        follow = -best.covariance @ jacobians[0].T @ jacobians[1]
        projected = jacobians[1] + jacobians[0] @ follow
        covariance = covariance_of(projected.T @ projected)
        domains = domains_of(problem.model, [names[k] for k in held])
        values = [best.values[names[k]] for k in held]
        inward = np.array([1.0 if value <= domain.low else -1.0 for value, domain in zip(values, domains, strict=True)])
        centre = -np.where(np.isfinite(covariance), covariance, 0.0) @ projected.T @ residual
        return _BoundParameters(loose, held, centre, covariance, inward, follow)


def _root(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """A square root of `covariance`; eigenvalues are limited to 1, infinite variances count as large."""
    values, vectors = np.linalg.eigh(np.where(np.isfinite(covariance), covariance, 1e6))
    return vectors * np.sqrt(np.clip(values, 0.0, 1.0))
