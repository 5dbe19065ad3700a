"""Boards that the recordings do not tell apart: draws from an uncertain fit."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from ._estimates import spread
from ._fit import Fit
from ._least_squares import domains_of, starts_removed
from ._model import Model
from ._study import Optimum, Study, inverse
from ._units import with_parameters

LIKELY = 0.99
"""A draw is within this confidence region of the fit."""
_HALVINGS = 8


def draws(
    found: Fit, count: int, seed: int = 0, progress: Callable[[int, int], None] = lambda done, total: None
) -> list[Model]:
    """`count` models drawn from what the fit leaves open.

    Steps of the loose parameters are drawn from the normal distribution of their covariance. A parameter that is held
    on a bound is drawn around where it would go without one, and stays there unless that is inside; the others follow.
    Where the fit is far from linear some draws would contradict the recordings: a step that raises chi^2, the starts
    fitted anew, beyond the 99 % region is halved until it does not.
    """
    study, best = found.study, found.optimum
    names, train = list(best.free), study.numbered("train")
    if not names:
        return [found.model] * count
    rng = np.random.default_rng(seed)
    scale = spread(best)
    limit = stats.chi2.ppf(LIKELY, len(names)) * scale**2
    domains = domains_of(study.model, names)
    pressed = _Pressed.of(study, best, train)
    root, held_root = _root(best.covariance), _root(pressed.covariance)
    loose, held = pressed.loose, pressed.held

    def moved(step: np.ndarray) -> dict[str, float]:
        there = dict(best.values)
        for name, domain, move in zip(names, domains, step, strict=True):
            there[name] = float(np.clip(domain.moved(there[name], move), domain.low, domain.high))
        return there

    def drawn() -> np.ndarray:
        step = np.zeros(len(names))
        outward = pressed.centre + held_root @ rng.standard_normal(len(held)) * scale
        step[held] = np.where(outward * pressed.inward > 0, outward, 0.0)
        step[loose] = pressed.follow @ step[held] + root @ rng.standard_normal(len(loose)) * scale
        return step

    def likely(there: dict[str, float]) -> bool:
        again = study.fit(there, (), train, best.start, most=6)
        return bool((again.misfit - best.misfit) * best.samples <= limit)

    models = []
    for k in range(count):
        progress(k, count)
        step = drawn()
        for _ in range(_HALVINGS):
            if likely(moved(step)):
                break
            step = step / 2
        models.append(with_parameters(study.model, moved(step)))
    return models


class _Pressed(NamedTuple):
    """The parameters numbered `held` on bounds, of which the fit knows no error: where they want to go (`centre`)
    with which `covariance` for unit noise, which sign of a step leads `inward`, and how the `loose` ones `follow`.
    """

    loose: list[int]
    held: list[int]
    centre: Float[np.ndarray, " h"]
    covariance: Float[np.ndarray, "h h"]
    inward: Float[np.ndarray, " h"]
    follow: Float[np.ndarray, "l h"]

    @staticmethod
    def of(study: Study, best: Optimum, runs: list[int]) -> "_Pressed":
        names = list(best.free)
        loose, held = ([k for k, name in enumerate(names) if (name in best.held) is on] for on in (False, True))
        free_start = np.asarray(study.batch.free_start)
        parts = [starts_removed(best.linearised, k, study.width, free_start) for k in runs]
        residual, J = np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])
        towards = J[:, loose], J[:, held]
        follow = -best.covariance @ towards[0].T @ towards[1]
        alone = towards[1] + towards[0] @ follow
        covariance = inverse(alone.T @ alone)
        domains = domains_of(study.model, [names[k] for k in held])
        at = [best.values[names[k]] for k in held]
        inward = np.array([1.0 if value <= domain.low else -1.0 for value, domain in zip(at, domains, strict=True)])
        centre = -np.where(np.isfinite(covariance), covariance, 0.0) @ alone.T @ residual
        return _Pressed(loose, held, centre, covariance, inward, follow)


def _root(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """A root of `covariance`; no direction is wider than 1."""
    values, vectors = np.linalg.eigh(np.where(np.isfinite(covariance), covariance, 1e6))
    return vectors * np.sqrt(np.clip(values, 0.0, 1.0))
