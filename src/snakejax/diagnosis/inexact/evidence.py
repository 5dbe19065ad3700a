"""What the recordings say of the model: is a random force there, does noise wander, are the constants as stated?"""

from typing import NamedTuple

import numpy as np

from snakejax.estimation.discrepancy.least_squares import Prior, optimum
from snakejax.estimation.discrepancy.restricted_likelihood import restricted_likelihood

from .search import Linear, Search

FORCE_STEP, MOST_FORCE_STEPS = 1.5, 16
"""The largest force that recordings do not exclude is searched for in steps of this factor, down to a thousandth of
that at which the search begins."""


class ModelEvidence(NamedTuple):
    """-2 log restricted likelihood more without each: a random `force`, noise that is `wandering`, and `constants`
    other than stated (with their priors counted). `drifting`: noise wanders as slowly as an estimate of it allows."""

    force: float
    wandering: float
    constants: float
    least: float
    drifting: bool = False

    @property
    def has_force(self) -> bool:
        """Whether a random force acts beside the model."""
        return self.force > self.least

    @property
    def noise_wanders(self) -> bool:
        """Whether noise is not white."""
        return self.wandering > self.least

    @property
    def suggests_law(self) -> bool:
        """Whether a random force, or noise, stands in for a law, with which there may be nothing but white noise.

        What the force cannot follow of a law seems to be noise that wanders. It matters less than the force does, or
        drifts on and on, as cameras do not; then it may stand in for all of the law.
        """
        drifts = self.drifting and (self.has_force or self.noise_wanders)
        return drifts or (self.has_force and self.force > self.wandering)

    @property
    def exact(self) -> bool:
        """Whether the model with the stated constants and white noise is all that there is."""
        return not (self.has_force or self.noise_wanders or self.constants > self.least)


def model_evidence(search: Search, linear: Linear) -> ModelEvidence:
    """The evidence at `linear`, whose discrepancy has been estimated."""
    point, free = linear.point, search.model.free(linear.point.effects)
    prior = search.prior_at(point.values)
    low, _ = search.scales.bounds()
    without_force = point.discrepancy.without_force(search.scales.least_force)
    white_noise = point.discrepancy._replace(
        white=np.hypot(point.discrepancy.white, point.discrepancy.wander), wander=np.exp(low[[2, 2, 3]])
    )
    deviance = restricted_likelihood(linear.data, point.discrepancy, free, prior)
    return ModelEvidence(
        restricted_likelihood(linear.data, without_force, free, prior) - deviance,
        restricted_likelihood(linear.data, white_noise, free, prior) - deviance,
        _gain_of_free_constants(search, linear, linear.under(without_force).gram),
        search.criteria.random_force_chi2,
        search.scales.drifts(point.discrepancy),
    )


def largest_force(search: Search, linear: Linear, most: float) -> float:
    """The largest random force, as a share of the forces that move the vehicle and at most `most`, with which -2 log
    restricted likelihood is not larger by more than `random_force_chi2`, within a factor of `FORCE_STEP`."""
    criteria, free = search.criteria, search.model.free(linear.point.effects)
    prior, now = search.prior_at(linear.point.values), linear.point.discrepancy
    least = restricted_likelihood(linear.data, now, free, prior)
    share = most
    for _ in range(MOST_FORCE_STEPS):
        wider = now.enlarged(share * search.scales.force, criteria.shortest_force)
        if restricted_likelihood(linear.data, wider, free, prior) - least <= criteria.random_force_chi2:
            break
        share /= FORCE_STEP
    return share


def _gain_of_free_constants(search: Search, linear: Linear, gram: np.ndarray) -> float:
    """By how much the constants of the vehicle as stated are less likely than free ones within their priors."""
    free, prior = search.model.free(linear.point.effects), search.prior_at(linear.point.values)
    others = np.array([k for k in free if k not in search.model.constants], int)
    return _evidence(gram, others, prior) - _evidence(gram, free, prior)


def _evidence(gram: np.ndarray, free: np.ndarray, prior: Prior) -> float:
    """chi^2 + ln |normal equations| - ln |prior precision| of the parameters `free`, the others at their prior mean."""
    unbounded = np.full(len(prior.mean), np.inf)
    best = optimum(gram, list(free), prior, prior.mean, -unbounded, unbounded)
    return float(best.chi2 - np.linalg.slogdet(best.covariance)[1] - np.log(prior.precision[free]).sum())
