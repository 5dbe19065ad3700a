"""Score tests: what each candidate effect would change, beside what is left unexplained, without refitting anything."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from snakejax.dynamics.model import Model
from snakejax.estimation.goodness_of_fit import largest_noise_misfit
from snakejax.estimation.jackknife import left_out_sd
from snakejax.estimation.linearisation import Linearised, domains_of, orthonormal_basis, project_out_starts
from snakejax.estimation.multiple_shooting import LENGTH
from snakejax.estimation.sensitivity import DETECTABLE_SD, NEARER, Sensitivities

from .criteria import CRITERIA, SelectionCriteria


class ProjectedResiduals(NamedTuple):
    """Residual (N,) and parameter columns (N, P), with what the starts of runs or windows explain projected out.

    `block` (N,) numbers stretches of a second or two: the errors within one may depend on each other. `lost` counts the
    start components that were estimated. `run` (N,) numbers the runs as they come; None where they are one.
    """

    residual: np.ndarray
    columns: np.ndarray
    block: np.ndarray
    lost: int
    run: np.ndarray | None = None


class ScoreTest(NamedTuple):
    """One candidate: expected values of its parameters with standard errors, and how sure it is that it acts.

    `reduction` is the fall of chi^2 that the linear model predicts, `statistic` the same in units of the residual
    variance, corrected for correlation; `p_value` is corrected for the number of candidates. `detectable`: the smallest
    values that these data reveal with power 0.8. `signature` (N,) is the direction in residual space, unit length, and
    `span` (N, q) an orthonormal basis of all that its parameters can change.
    """

    effect: str
    values: dict[str, float]
    sd: dict[str, float]
    reduction: float
    statistic: float
    p_value: float
    detectable: dict[str, float]
    signature: np.ndarray
    span: np.ndarray


def project_starts(
    linearised: Linearised,
    free_start: np.ndarray,
    runs: Sequence[int],
    times: np.ndarray,
    length: float,
    cut_from: Sequence[str],
) -> ProjectedResiduals:
    """Project the starts of `runs` out of residuals and Jacobian; blocks are `length` [s] long, and `cut_from` names
    the run that each was cut from, where they are windows.
    """
    width = linearised.jacobian.shape[-1] - free_start.shape[1]
    rows, columns, blocks, count = [], [], [], 0
    for k in runs:
        present = np.abs(linearised.jacobian[k][..., width:]).sum(axis=-1).reshape(-1) > 0
        block = np.repeat(np.floor((times[k] - times[k][0]) / length).astype(int), 3)[present]
        r, J = project_out_starts(linearised, k, width, free_start)
        rows.append(r[present])
        columns.append(J[present])
        blocks.append(count + block)
        count = int(blocks[-1].max()) + 1
    observable = (linearised.jacobian[list(runs)][..., width:] ** 2).sum(axis=(1, 2)) > 0
    lost = int((observable & (free_start[list(runs)] > 0)).sum())
    number = {name: k for k, name in enumerate(dict.fromkeys(cut_from[k] for k in runs))}
    run = np.repeat([number[cut_from[k]] for k in runs], [len(part) for part in rows])
    return ProjectedResiduals(np.concatenate(rows), np.concatenate(columns), np.concatenate(blocks), lost, run)


def score(
    model: Model,
    names: Sequence[str],
    rest: ProjectedResiduals,
    fitted: Sequence[str],
    candidates: Mapping[str, Sequence[str]],
    values: Mapping[str, float],
    criteria: SelectionCriteria = CRITERIA,
) -> list[ScoreTest]:
    """Score `candidates` (parameter names of each) beside the `fitted` parameters, best first.

    With r the residual, A the columns of the fitted parameters, E those of a candidate, both with the starts projected
    out, and E_ = E - A A^+ E: the expected change is -E_^+ r, the predicted fall of chi^2 |E_ E_^+ r|^2. Its statistic
    is divided by the variance left after it, where that is above one, and by the variance inflation of the scores
    summed block by block, so that neither another missing effect nor correlated errors make it look surer than it is. A
    parameter that the domain bounds at its present value is tested one-sidedly. Standard errors are those of the noise
    times the roots of both factors; where more than noise is left, and the jackknife over runs says more, they are its:
    what a model lacks acts alike in all blocks of a run.
    """
    columns = {name: rest.columns[:, k] for k, name in enumerate(names)}
    base = _Base.of(model, rest, [columns[name] for name in fitted], values)
    scored = []
    for effect, parts in candidates.items():
        E = np.stack([columns[name] for name in parts], axis=1)
        size = np.sqrt((E**2).sum(axis=0))
        E = E - base.columns @ (base.columns.T @ E)
        remaining = np.sqrt((E**2).sum(axis=0))
        usable = (remaining > 1e-6 * size) & (size * np.minimum(_ends(model, parts), 1.0) > criteria.smallest_change)
        if usable.any():
            scored.append(_score_one(base, effect, list(parts), E * usable, usable))
    count = max(len(scored), 1)
    corrected = [s._replace(p_value=float(-np.expm1(count * np.log1p(-min(s.p_value, 1 - 1e-16))))) for s in scored]
    return sorted(corrected, key=lambda s: -s.reduction)


class _Base(NamedTuple):
    """What the candidates are scored beside: an orthonormal basis `columns` (N, a) of the fitted parameters, the
    `residual` (N,) orthogonal to it, and its degrees of freedom `dof`.
    """

    model: Model
    values: Mapping[str, float]
    rest: ProjectedResiduals
    columns: np.ndarray
    residual: np.ndarray
    dof: int

    @staticmethod
    def of(
        model: Model, rest: ProjectedResiduals, fitted: Sequence[np.ndarray], values: Mapping[str, float]
    ) -> "_Base":
        none = np.zeros((rest.residual.size, 0))
        A = orthonormal_basis(np.stack(fitted, axis=1), 1e-10) if fitted else none
        dof = max(rest.residual.size - rest.lost - len(fitted), 1)
        return _Base(model, values, rest, A, rest.residual - A @ (A.T @ rest.residual), dof)


def _ends(model: Model, parts: Sequence[str]) -> np.ndarray:
    """How far the parameters `parts` can be from neutral: the upper ends of their domains, and 1 for a mere number."""
    return np.array([1.0 if d.unit == "-" else d.high for d in domains_of(model, parts)])


def _score_one(base: _Base, effect: str, parts: list[str], E: np.ndarray, usable: np.ndarray) -> ScoreTest:
    """The score test of one candidate with the columns `E` (N, q), of which those that are not `usable` are zero."""
    r, chi2 = base.residual, float(base.residual @ base.residual)
    covariance = _covariance(E, usable)
    free_change = -(covariance @ (E.T @ r)) * usable
    change, bounded = _within_domains(base, parts, free_change)
    after = r + E @ change
    fall = float(chi2 - (after**2).sum())
    variance = max(1.0, (chi2 - fall) / base.dof)
    inflation = _inflation(E[:, usable], after, base.rest.block, variance)
    statistic = max(fall, 0.0) / variance / inflation
    p_value = stats.chi2.sf(statistic, int(usable.sum()))
    if bounded and usable.sum() == 1:
        p_value = p_value / 2 if fall > 0 else 1.0
    sd = np.sqrt(np.diag(covariance) * variance * inflation)
    if base.rest.run is not None and variance > largest_noise_misfit(base.dof):
        both = np.concatenate([base.columns, E], axis=1)
        sd = np.maximum(sd, left_out_sd(both, r + E @ free_change, base.rest.run)[base.columns.shape[1] :])
    signature = E @ change if fall > 0 else E[:, int(np.argmax(usable))]
    size = float(np.linalg.norm(signature))
    return ScoreTest(
        effect,
        {name: float(base.values[name] + c) for name, c in zip(parts, change, strict=True)},
        {name: float(s) if ok else np.inf for name, s, ok in zip(parts, sd, usable, strict=True)},
        fall,
        float(statistic),
        float(p_value),
        _minimum_detectable(base.model, parts, covariance, usable),
        signature / (size if size > 0 else 1.0),
        orthonormal_basis(E[:, usable], 1e-6),
    )


def _covariance(E: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(E^T E)^+ (q, q), with 1 on the diagonal for a parameter that is not `usable`."""
    normal = E.T @ E
    normal[~usable, ~usable] = 1.0
    return np.linalg.pinv(normal, hermitian=True)


def _within_domains(base: _Base, parts: Sequence[str], free_change: np.ndarray) -> tuple[np.ndarray, bool]:
    """`free_change` (q,) cut off at the ends of the domains, and whether a parameter is at such an end now."""
    change, bounded = free_change.copy(), False
    for k, domain in enumerate(domains_of(base.model, parts)):
        at = base.values[parts[k]]
        bounded = bounded or at <= domain.low or at >= domain.high
        change[k] = np.clip(at + change[k], domain.low, domain.high) - at
    return change, bounded


def _minimum_detectable(
    model: Model, parts: Sequence[str], covariance: np.ndarray, usable: np.ndarray
) -> dict[str, float]:
    """The smallest values that these data reveal once everything else is explained (noise of variance one).

    Infinite where that is so far from neutral that the domain ends, or that a relative change is no longer small.
    """
    smallest = np.where(usable, DETECTABLE_SD * np.sqrt(np.diag(covariance)), np.inf)
    smallest = np.where(smallest > _ends(model, parts), np.inf, smallest)
    return {name: float(size) for name, size in zip(parts, smallest, strict=True)}


def _inflation(E: np.ndarray, after: np.ndarray, block: np.ndarray, variance: float) -> float:
    """How much larger the variance of E^T after is, summed over blocks, than independent errors would make it; >= 1."""
    size = np.sqrt((E**2).sum(axis=0))
    unit = E / np.where(size > 0, size, 1.0)
    count = int(block.max()) + 1
    sums = np.stack([np.bincount(block, unit[:, k] * after, count) for k in range(unit.shape[1])], axis=1)
    return max(1.0, float((sums**2).sum(axis=0).max()) / variance)


def significant_alone(scored: ScoreTest, criteria: SelectionCriteria = CRITERIA) -> bool:
    """Whether a candidate is significant were it the only one: what is done with it must not depend on the others."""
    return bool(stats.chi2.sf(scored.statistic, len(scored.values)) < criteria.significance_level)


def confusable(scored: Sequence[ScoreTest], criteria: SelectionCriteria = CRITERIA) -> dict[str, list[str]]:
    """For each candidate those that these runs cannot tell from it.

    With s_i the signature of candidate i, S_i its statistic and Q_j the span of candidate j, j would leave
    S_i (1 - |Q_j^T s_i|^2) of what i explains, and the two were found to explain |S_i - S_j| more or less. They are
    confusable at any strength where |Q_j^T s_i| > `confusable_cosine`, and at that of a significant i where both are
    below `distinct_chi2`.
    """
    share = np.array([[min(float(((o.span.T @ s.signature) ** 2).sum()), 1.0) for o in scored] for s in scored])
    size = np.array([s.statistic for s in scored])
    close = np.maximum(size[:, None] * (1 - share), np.abs(size[:, None] - size)) < criteria.distinct_chi2
    sure = np.array([s.p_value < criteria.significance_level for s in scored], bool)
    alike = (share > criteria.confusable_cosine**2) | (sure[:, None] & close)
    alike = alike | alike.T
    return {s.effect: [o.effect for j, o in enumerate(scored) if alike[i, j] and i != j] for i, s in enumerate(scored)}


class Tested(NamedTuple):
    """The score tests of candidates, best first; `chi2` and `dof` are those of what the starts and the fit leave."""

    scores: list[ScoreTest]
    chi2: float
    dof: int


def projected(sensitivities: Sensitivities) -> ProjectedResiduals:
    """What is left of `sensitivities` when the starts have explained what they can."""
    batch = sensitivities.problem.batch
    free_start, times = np.asarray(batch.free_start), np.asarray(batch.times)
    cut_from = [run.recorded_as for run in sensitivities.problem.runs]
    return project_starts(sensitivities.linearised, free_start, sensitivities.runs, times, LENGTH, cut_from)


def tested(
    sensitivities: Sensitivities,
    fitted: Sequence[str],
    candidates: Mapping[str, Sequence[str]],
    probes: Mapping[str, float],
    criteria: SelectionCriteria = CRITERIA,
) -> Tested:
    """Score `candidates` beside the `fitted` parameters.

    A parameter without a derivative at zero is scored by secants, from its value in `probes`, from a `NEARER` one, and
    from the value found with the better of these: far from that value a secant has another shape than the effect.
    """
    model, names = sensitivities.problem.model, sensitivities.problem.names
    probes = {name: secant_step for name, secant_step in probes.items() if sensitivities.values[name] == 0.0}

    def scores(rest: ProjectedResiduals) -> dict[str, ScoreTest]:
        return {s.effect: s for s in score(model, names, rest, fitted, candidates, sensitivities.values, criteria)}

    rest = projected(sensitivities.probed(probes) if probes else sensitivities)
    best = scores(rest)
    if probes:
        nearer = {name: secant_step * NEARER for name, secant_step in probes.items()}
        best = _better(best, scores(projected(sensitivities.probed(nearer))), probes)
        settled_at = {
            n: s.values[n]
            for s in best.values()
            if significant_alone(s, criteria)
            for n in probes.keys() & s.values.keys()
        }
        settled_at = {name: value for name, value in settled_at.items() if value > 0}
        best = _better(best, scores(projected(sensitivities.probed(settled_at))), settled_at) if settled_at else best
    dof = max(rest.residual.size - rest.lost - len(fitted), 1)
    return Tested(sorted(best.values(), key=lambda s: -s.reduction), float((rest.residual**2).sum()), dof)


def _better(old: dict[str, ScoreTest], new: dict[str, ScoreTest], probed: Mapping[str, float]) -> dict[str, ScoreTest]:
    """`old`, and where one of the `probed` parameters explains more in `new`, that."""
    return {
        effect: max(s, new.get(effect, s), key=lambda one: one.reduction) if probed.keys() & s.values.keys() else s
        for effect, s in (new | old).items()
    }
