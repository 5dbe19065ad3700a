"""Boards that the recordings do not tell apart: draws from an uncertain fit."""

from collections.abc import Callable

import numpy as np
from scipy import stats

from ._estimates import spread
from ._fit import Fit
from ._least_squares import domains_of
from ._model import Model
from ._units import with_parameters

LIKELY = 0.99
"""A draw is within this confidence region of the fit."""
_HALVINGS = 8


def draws(
    found: Fit, count: int, seed: int = 0, progress: Callable[[int, int], None] = lambda done, total: None
) -> list[Model]:
    """`count` models drawn from what the fit leaves open.

    Steps of the loose parameters are drawn from the normal distribution of their covariance. Where the fit is far from
    linear some of them would contradict the recordings: a step that raises chi^2, the starts fitted anew, beyond the
    99 % region is halved until it does not.
    """
    study, best = found.study, found.optimum
    names, train = list(best.loose), study.numbered("train")
    if not names:
        return [found.model] * count
    rng = np.random.default_rng(seed)
    scale = spread(best)
    values, vectors = np.linalg.eigh(np.where(np.isfinite(best.covariance), best.covariance, 1e6))
    root = vectors * np.sqrt(np.clip(values, 0.0, 1.0))
    limit = stats.chi2.ppf(LIKELY, len(names)) * scale**2
    domains = domains_of(study.model, names)

    def moved(step: np.ndarray) -> dict[str, float]:
        there = dict(best.values)
        for name, domain, move in zip(names, domains, step, strict=True):
            there[name] = float(np.clip(domain.moved(there[name], move), domain.low, domain.high))
        return there

    def likely(there: dict[str, float]) -> bool:
        again = study.fit(there, (), train, best.start, most=6)
        return bool((again.misfit - best.misfit) * best.samples <= limit)

    models = []
    for k in range(count):
        progress(k, count)
        step = root @ rng.standard_normal(len(names)) * scale
        for _ in range(_HALVINGS):
            if likely(moved(step)):
                break
            step = step / 2
        models.append(with_parameters(study.model, moved(step)))
    return models
