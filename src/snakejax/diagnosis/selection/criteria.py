"""The thresholds of a diagnosis in one record; each number states its statistical meaning."""

from typing import NamedTuple

from snakejax.core.errors import InputError, instead_of
from snakejax.recording.run import Case


class SelectionCriteria(NamedTuple):
    """The thresholds of the selection of effects, and the width of the search.

    *Misfit* is chi^2 per sample: the mean squared residual divided by the variance of the noise; it is 1 if only noise
    remains. *Excess* is misfit - 1, the part above the noise. Change single numbers with
    `CRITERIA._replace(name=value)` and give the result to `diagnose` or `explain`. `benchmarks/criteria.txt` shows how
    the verdicts change if a criterion is halved or doubled.
    """

    # Tests
    significance_level: float = 0.01
    """A candidate is significant if its p-value, corrected for the number of candidates, is below this."""
    nominal_candidates: float = 25.0
    """The level is divided by this number (Bonferroni) in the tests of an addition and of a removal. It is the size of
    the library, so the result does not depend on which candidates the user asks for."""
    wald_per_parameter: float = 1e3
    """If the Wald statistic (value^T covariance^-1 value) per parameter is above this, the value is more than 30
    standard errors from neutral. The effect then belongs to the model without a refit."""
    smallest_change: float = 1e-3
    """A parameter is not observable in these runs if, over its whole domain, it changes the residuals by less than
    this, in standard deviations of the noise."""
    confusable_cosine: float = 0.99
    """Two candidates are confusable at any strength if the cosine between the signature of one and the span of the
    other is above this. The columns of the fitted parameters are projected out first."""
    distinct_chi2: float = 9.0
    """Two candidates are distinguished if their falls of chi^2 differ by more than this: a likelihood ratio of exp(9 /
    2) = 90."""
    least_shared_information: float = 1e-9
    """Least information of the remaining runs on a parameter in the leave-one-run-out score, as a share of the
    information of all runs. It is added to the scaled normal equations, so the score stays regular."""

    agreement_level: float = 0.05
    """In windows, the recordings agree on an effect if its 95% interval, by the jackknife over recordings, excludes the
    neutral value. A few recordings seldom exclude it at 1%. The effect must also lower the error of omitted recordings.
    `sure` asks for `significance_level`, corrected for the number of candidates."""

    # How near a fit is to the noise
    linear_misfit: float = 4.0
    """Below this misfit the residuals of whole runs are small enough for the score test, which is linear. It is then
    more sensitive than the test on short windows."""
    far_misfit: float = 50.0
    """Above this misfit the parameters of a fit of whole runs have no meaning, and an iteration to convergence would
    only move them further from the truth."""
    close_windows_misfit: float = 2.0
    """If the windows leave less than this misfit, whole runs can be fitted at once from the values of the windows."""
    explained_windows_misfit: float = 1.1
    """If the windows leave no more than this misfit, no further effect is searched on them. Windows are short, so a
    missing effect changes them less than whole runs."""

    # How much an effect must improve
    least_excess_share: float = 0.05
    """An effect that lowers the excess by less than this share, and does not reach the noise, has no practical
    significance, however large its statistic is."""
    further_excess_ratio: float = 0.9
    """The search for sets of effects ends if a further effect does not lower the excess of the windows to this
    share."""
    refit_tolerance: float = 0.05
    refit_tolerance_share: float = 1e-5
    """A refit that contains its base has failed if its chi^2 is larger by more than the first number and this share of
    the chi^2 of the base: the largest difference between two converged fits of one optimum."""

    # How wide the search is
    most_effects: int = 4
    """Largest number of effects that are added one by one: a few runs cannot distinguish more."""
    most_effects_at_once: int = 3
    """Largest number of effects that are added together to a model far from the recordings."""
    beam_width: int = 3
    """Sets of effects of each size that the beam search keeps: the best single effect need not belong to the best
    pair."""
    candidates_refitted: int = 3
    """Largest number of candidates that are refitted on whole runs."""
    candidate_excess_ratio: float = 3.0
    """A candidate is refitted if its excess on the windows is below this multiple of that of the best candidate."""
    subsets_refitted: int = 3
    """Largest number of sets of effects that are refitted on whole runs."""
    subset_excess_ratio: float = 2.0
    """A set of effects is refitted if its excess on the windows is below this multiple of that of the best set."""
    smallest_excess: float = 0.02
    """Lower limit of the best excess in both ratios: below it, windows differ by chance."""
    log_clock_rounds: int = 2
    """Number of repetitions for joint logs with free clocks: each explains the recordings again, with the clocks of the
    previous result."""

    # Models that are not exact
    random_force_chi2: float = 9.0
    """A random force, correlated noise and corrected constants are accepted if they lower -2 log restricted likelihood
    by more than this: a likelihood ratio of exp(9 / 2) = 90."""
    interval_force: float = 0.01
    """If the model is not exact, the intervals include a further force of this share of the forces that move the
    vehicle. A force that depends on the place or the motion is larger than its estimate as a random force, or is not
    seen as one."""
    cautious_force: float = 0.02
    """An effect is likely if its fall is half significant even if this share of the forces that move the vehicle had
    another cause; a smaller share if the model is exact and the recordings exclude so large a random force. Exact: no
    random force, no law beside it, white noise, constants as stated."""
    shortest_force: float = 0.5
    """Time constant [s] of these forces: an upper limit for intervals, a lower limit for likely and sure effects."""
    largest_random_force: float = 0.05
    """A random force above this share of the forces that move the vehicle is a law that the model lacks: the recordings
    are then not explained. An effect is sure if it would be significant beside the largest force with which they are;
    beside a smaller one as for `cautious_force`."""
    least_inside: float = 0.5
    """If the 95% bands hold less than this share of the samples of omitted runs, the model lacks more than a random
    force: its errors grow over a longer time. The errors within a run are correlated, so a single run may have less
    than 0.95."""

    # The latent force
    coexisting_excess_ratio: float = 0.5
    """A known effect is kept together with the latent force if a force that depends on one variable then leaves less
    than this share of the excess that it leaves without the effect."""
    structure_excess_ratio: float = 0.15
    """The same for the change of structure. It is stricter, because a structure has no value that could be far from
    neutral."""
    coexisting_sd: float = 20.0
    """Together with the latent force, an effect must be so many standard errors from neutral. The standard errors
    assume a force as smooth as its Gaussian process; an effect that acts like a part of the force was up to ten of them
    from neutral."""
    force_explained_excess: float = 0.05
    """If a force that depends on one variable leaves no more than this excess, no further effect is searched."""
    least_force_share: float = 0.02
    """A variable that predicts less than this share of the excess on omitted runs is not shown as a cause."""
    force_excess_sd: float = 4.0
    """So many standard deviations of the chi^2 of noise are added to the excess to which the shares refer. Without
    excess, no variable then explains much."""

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
"""The default criteria."""
