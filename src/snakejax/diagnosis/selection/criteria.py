"""The thresholds that decide what a diagnosis tells: one record, in which each number says its statistical meaning."""

from typing import NamedTuple

from snakejax.core.errors import InputError, instead_of
from snakejax.recording.run import Case


class SelectionCriteria(NamedTuple):
    """The thresholds of the selection of effects, and the width of the search.

    *Misfit* is chi^2 per sample: the mean squared residual over the variance of the noise, 1 where a model leaves only
    noise. *Excess* is misfit - 1: what a model leaves beyond noise. Change single numbers with
    `CRITERIA._replace(name=value)` and give the result to `diagnose` or `explain`.
    """

    # Tests
    significance_level: float = 0.01
    """A candidate is significant where its p-value, corrected for the number of candidates, is below this."""
    nominal_candidates: float = 25.0
    """By this number of candidates (the size of the library) the level is divided (Bonferroni) where the fall of chi^2
    of an addition or a removal is tested, so that the result does not depend on which candidates were asked for."""
    wald_per_parameter: float = 1e3
    """A Wald statistic (value^T covariance^-1 value) per parameter above this is more than 30 standard errors from
    neutral: no refit without the effect is needed to know that it belongs to the model."""
    smallest_change: float = 1e-3
    """A parameter that changes the residuals by less than this, in standard deviations of the noise and over its whole
    domain, is not observable in these runs."""
    confusable_cosine: float = 0.99
    """Two candidates are confusable at any strength where the cosine between the signature of one and the span of the
    other is above this, the columns of the fitted parameters projected out."""
    distinct_chi2: float = 9.0
    """So much larger a fall of chi^2 tells one candidate from another: a likelihood ratio of exp(9 / 2) = 90."""
    least_shared_information: float = 1e-9
    """Added to the scaled normal equations of the runs left together: the information that they have on a parameter at
    the least, as a share of what all runs have. It keeps the leave-one-run-out score regular."""

    # How near a fit is to the noise
    linear_misfit: float = 4.0
    """Below this misfit the residuals of whole runs are small enough for a score test, which is linear, to hold there;
    it is then sharper than on short windows."""
    far_misfit: float = 50.0
    """Above this misfit a fit of whole runs is so far from the truth that its parameters and its order among others
    mean nothing, and to polish it would only make them absurd."""
    close_windows_misfit: float = 2.0
    """Windows that leave less than this misfit have found values from which whole runs can be fitted at once."""
    explained_windows_misfit: float = 1.1
    """Windows that leave no more than this misfit are explained: no further effect is looked for on them. Windows are
    short, so that they leave less of a missing effect than whole runs do."""

    # What an effect must bring
    least_excess_share: float = 0.05
    """An effect that lowers the excess by less than this share, and does not reach the noise, is of no practical
    significance, however large its statistic."""
    further_excess_ratio: float = 0.9
    """A further effect must lower the excess of the windows to this share of what it was, or the search for sets of
    effects ends."""
    refit_tolerance: float = 0.05
    refit_tolerance_share: float = 1e-5
    """A refit that holds its base has failed where its chi^2 is larger by more than the first and this share of the
    base's chi^2: the most by which two fits of one optimum may differ when they stop."""

    # How wide the search is
    most_effects: int = 4
    """Effects that are added one by one to a model, at most: a few runs cannot distinguish more."""
    most_effects_at_once: int = 3
    """Effects that are added together to a model far from the recordings, at most."""
    beam_width: int = 3
    """Sets of effects of each size that are followed: the first alone need not belong to the best pair."""
    candidates_refitted: int = 3
    """Candidates that are refitted on whole runs, at most."""
    candidate_excess_ratio: float = 3.0
    """A candidate is refitted where its excess on the windows is below this multiple of the best candidate's."""
    subsets_refitted: int = 3
    """Sets of effects that are refitted on whole runs, at most."""
    subset_excess_ratio: float = 2.0
    """A set of effects is refitted where its excess on the windows is below this multiple of the best set's."""
    smallest_excess: float = 0.02
    """The best excess counts as this much at least in both ratios: below it, windows differ by chance."""
    log_clock_rounds: int = 2
    """How often recordings whose joint logs have free clocks are explained once more with the clocks of the result."""

    # Models that are not exact
    random_force_chi2: float = 9.0
    """A random force beside the model, wandering noise, and constants other than stated, are believed where -2 log
    restricted likelihood falls by more than this: a likelihood ratio of exp(9 / 2) = 90."""
    interval_force: float = 0.01
    """Where a random force is believed, intervals hold for a hundredth of the forces that move the vehicle more: what
    varies with the place or the motion in place of time looks weaker to the likelihood than it is."""
    cautious_force: float = 0.02
    """An effect is sure where it would be significant even if a fiftieth of the forces that move the vehicle were
    something else."""
    shortest_force: float = 0.5
    """In both cases that force changes over this time [s], or faster for intervals and slower for what is sure."""
    largest_random_force: float = 0.05
    """A random force above this share of the force that moves the vehicle is no disturbance but a law that the model
    lacks: the recordings are not explained."""
    least_inside: float = 0.5
    """Where bands of 95% hold less than this share of the samples of runs left out, what the model lacks is no random
    force: it acts in the same way for long, so that errors grow faster than those of a random force. Errors within a
    run depend on each other, so that a single run may well have less than 0.95."""

    # The latent force
    coexisting_excess_ratio: float = 0.5
    """A known effect acts beside the latent force where a force of one cause then leaves less than this share of the
    excess that it left without the effect."""
    structure_excess_ratio: float = 0.15
    """The same for the change of structure, which is asked for more because it has no value that could be far from
    neutral."""
    coexisting_sd: float = 20.0
    """An effect must be so many standard errors from neutral beside the latent force: the errors hold for a force as
    smooth as its Gaussian process, and an effect that acts like a part of the force comes ten off."""
    force_explained_excess: float = 0.05
    """Where a force of one cause leaves no more than this excess, no effect beside it is looked for."""
    least_force_share: float = 0.02
    """A variable that predicts less than this share of the excess on runs left out is not shown as a cause."""
    force_excess_sd: float = 4.0
    """So many standard deviations of the chi^2 of noise are added to the excess of which those shares are taken, so
    that no variable explains much where there is nothing to explain."""

    @staticmethod
    def of(case: Case) -> "SelectionCriteria":
        """The criteria that `[search]` in the case.toml of `case` states; all others as they are.

        **Raises:** `InputError` for a name that is not one of them.
        """
        for name in case.search:
            if name not in SelectionCriteria._fields:
                where = f"case {case.name}, [search]"
                raise InputError(f"There is no criterion `{name}`", where, instead_of(name, SelectionCriteria._fields))
        defaults = SelectionCriteria()
        stated = {name: type(getattr(defaults, name))(value) for name, value in case.search.items()}
        return defaults._replace(**stated)


CRITERIA = SelectionCriteria()
"""The criteria of every diagnosis that is given no others."""
