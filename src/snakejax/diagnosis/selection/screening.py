"""What each candidate promises, by its score and on short windows."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from snakejax.core.parallel import in_threads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.estimation.block_linearisation import linearise_runs
from snakejax.estimation.goodness_of_fit import largest_noise_misfit
from snakejax.estimation.linearisation import Linearised, widened
from snakejax.estimation.multiple_shooting import Windows, WindowSolution
from snakejax.estimation.problem import DEPENDENT
from snakejax.estimation.sensitivity import NEARER, Sensitivities

from .candidates import CandidateFit, CandidateSet
from .criteria import SelectionCriteria
from .score_test import ScoreTest, projected, score, significant_alone, tested


class ScreenedCandidate(NamedTuple):
    """A candidate as its score sees it: where to start its refit, and the misfit to expect once it is in.

    All of it but the correction of the p-value for their number is a matter of the recordings, the base and this
    candidate: which others there are changes nothing. `dof`: the degrees of freedom of what `misfit` is of. `start`:
    where the windows start with it, if they have settled. `without`: the misfit without it.
    """

    score: ScoreTest
    values: dict[str, float]
    misfit: float
    dof: int
    start: np.ndarray | None = None
    without: float | None = None

    @property
    def is_fitted(self) -> bool:
        """Whether it was fitted to windows, and not scored alone."""
        return self.start is not None

    @property
    def chi2(self) -> float:
        """chi^2 with it."""
        return self.misfit * self.dof

    @property
    def leaves_only_noise(self) -> bool:
        """Whether `misfit` is consistent with noise."""
        return self.misfit <= largest_noise_misfit(self.dof)


def window_sensitivities(
    candidate_set: CandidateSet, values: Mapping[str, float], start: np.ndarray, windows: bool
) -> Sensitivities:
    """Every candidate beside the model at `values`, on `windows` or on whole train runs."""
    problem = candidate_set.windows.problem if windows else candidate_set.problem
    runs = tuple(range(len(problem.runs)) if windows else candidate_set.train)
    return Sensitivities(problem, runs, values, start, linearise_runs(problem, values, start, runs))


def screen_candidates(
    candidate_set: CandidateSet, step: CandidateFit, progress: Progress = no_progress
) -> list[ScreenedCandidate]:
    """The candidates beside `step`, the most promising first.

    Near the noise whole runs are scored. Further off windows are, after the fitted parameters have settled on them; and
    each candidate that promises much settles there too, with its own parameters free, so that their order does not rest
    on a linear model.
    """
    remaining = {name: parts for name, parts in candidate_set.candidates.items() if name not in step.effects}
    fitted = [name for name in candidate_set.free(step.effects) if name not in step.solution.held]
    near = step.solution.misfit < candidate_set.criteria.linear_misfit
    if near:
        values, start = step.solution.values, step.solution.start
    else:
        progress(ProgressEvent(Phase.SCREENING))
        settled = _settled(candidate_set, step, fitted)
        values, start = settled.values, settled.start
    sensitivities = window_sensitivities(candidate_set, values, start, not near)
    scores, chi2, dof = tested(sensitivities, fitted, remaining, candidate_set.probes(), candidate_set.criteria)
    screened = [
        ScreenedCandidate(s, {**values, **s.values}, max(chi2 - s.reduction, 0.0) / dof, dof, without=chi2 / dof)
        for s in scores
    ]
    if near:
        return screened
    base = _WindowBase(fitted, values, start, chi2 / dof, dof, sensitivities.linearised)
    return _refit_on_windows(candidate_set, screened, base, progress)


class _WindowBase(NamedTuple):
    """The model without the candidates on the windows: `fitted` parameters, `values`, `start` states (W, S), `misfit`
    and its degrees of freedom `dof`, and residuals with their Jacobian by all parameters (`linearised`).
    """

    fitted: Sequence[str]
    values: Mapping[str, float]
    start: np.ndarray
    misfit: float
    dof: int
    linearised: Linearised

    def by(self, windows: Windows, free: Sequence[str]) -> Linearised:
        """The residuals with their Jacobian by the parameters `free` and the start states, as `windows.at` has it."""
        problem, (residual, jacobian) = windows.problem, self.linearised
        starts = range(len(problem.names), jacobian.shape[-1])
        columns = [*(problem.names.index(name) for name in free), *starts]
        return widened(Linearised(residual, jacobian[..., columns]), problem.width - len(free), len(free))


def _settled(candidate_set: CandidateSet, step: CandidateFit, fitted: Sequence[str]) -> WindowSolution:
    """The fitted parameters on the windows: from where they settled before, else from where they are and from where the
    tyre began."""
    if step.windows is not None:
        return candidate_set.windows.settle(step.windows.values, fitted, step.windows.start, rounds=15)
    fresh = {**step.solution.values, **{n: candidate_set.problem.values()[n] for n in candidate_set.tyre}}
    both = in_threads(
        lambda values: candidate_set.windows.settle(values, fitted, rounds=15), (step.solution.values, fresh)
    )
    return min(both, key=lambda s: s.cost)


def _refit_on_windows(
    candidate_set: CandidateSet, screened: Sequence[ScreenedCandidate], base: _WindowBase, progress: Progress
) -> list[ScreenedCandidate]:
    """`screened`, with those that promise much, and those without a derivative at zero, fitted to the windows; these
    come first.
    """
    criteria = candidate_set.criteria
    probes = candidate_set.probes()
    without_slope = {name.split(".")[1] for name in probes}
    chosen = [
        c for c in screened if c.score.effect in without_slope or _promises(c.score, base.misfit, base.dof, criteria)
    ]
    # What has no slope takes longest and begins first, so that both cores end at about the same time.
    chosen.sort(key=lambda c: c.score.effect not in without_slope)
    progress(ProgressEvent(Phase.SCREENING_CANDIDATES, f"fitting {len(chosen)} candidates on windows"))

    def settle(candidate: ScreenedCandidate) -> ScreenedCandidate:
        effect, parts = candidate.score.effect, candidate_set.candidates[candidate.score.effect]
        # From where the others have settled, so that all move together; only what has no slope at zero starts off it,
        # where its score sees it.
        at = dict(base.values)
        for name in parts:
            if name in probes and at[name] == 0.0:
                estimate = candidate.score.values[name]
                at[name] = estimate if estimate > 0 else NEARER * probes[name]
        windows, free = candidate_set.windows, [*base.fitted, *parts]
        known = base.by(windows, free) if at == base.values else None
        best = windows.settle(at, free, base.start, 25, base.misfit * base.dof, known)
        misfit = best.cost / base.dof
        if misfit > base.misfit:
            return candidate._replace(misfit=base.misfit)
        sd = candidate.score.sd | _sd_at(candidate_set, best, base.fitted, effect)
        scored = candidate.score._replace(values={n: best.values[n] for n in parts}, sd=sd)
        if effect in without_slope:
            scored = _surer(scored, base.misfit * base.dof - best.cost, misfit, len(screened), criteria)
        return ScreenedCandidate(scored, best.values, misfit, base.dof, best.start, base.misfit)

    refitted = sorted(in_threads(settle, chosen), key=lambda c: c.misfit)
    done = {c.score.effect for c in refitted}
    return [*refitted, *(c for c in screened if c.score.effect not in done)]


def _promises(scored: ScoreTest, misfit: float, dof: int, criteria: SelectionCriteria) -> bool:
    """Whether a candidate is significant by itself and would lower the excess of `misfit` over noise enough to help."""
    return (
        significant_alone(scored, criteria)
        and scored.reduction > criteria.least_excess_share * max(misfit - 1, 0.0) * dof
    )


def _sd_at(
    candidate_set: CandidateSet, settled: WindowSolution, fitted: Sequence[str], effect: str
) -> dict[str, float]:
    """The standard errors of the parameters of `effect` where the windows have `settled` with it."""
    problem, parts = candidate_set.windows.problem, candidate_set.candidates[effect]
    runs = tuple(range(len(problem.runs)))
    rest = projected(Sensitivities(problem, runs, settled.values, settled.start, settled.linearised))
    names, values = [*fitted, *parts], settled.values
    scored = score(problem.model, names, rest, fitted, {effect: parts}, values, candidate_set.criteria)
    return scored[0].sd if scored else {}


def _surer(scored: ScoreTest, fall: float, misfit: float, family: int, criteria: SelectionCriteria) -> ScoreTest:
    """`scored` with the evidence of a fit to the windows that lowered chi^2 by `fall` to `misfit`, where it is the
    stronger: a candidate without a slope at its neutral value has no score there. Errors that are more than noise
    depend on each other. The p-value is corrected for the `family` of candidates.
    """
    statistic = fall / (max(misfit, 1.0) * (1.0 if misfit < criteria.close_windows_misfit else DEPENDENT))
    if statistic <= scored.statistic:
        return scored
    p_value = min(1.0, family * float(stats.chi2.sf(statistic, len(scored.values))))
    return scored._replace(statistic=statistic, p_value=min(p_value, scored.p_value))
