"""The loop: fit, compare, diagnose, add, refit, until only noise is left or nothing known explains the rest."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypedDict, Unpack

import equinox as eqx
import numpy as np
from scipy import stats

from ._approach import least
from ._diagnose import (
    CLOSE,
    HOPELESS,
    LATERAL_SKID,
    NEARLY,
    Bench,
    Ranked,
    Step,
    accomplices,
    base_fit,
    fresh_fit,
    rank,
    refit,
    structures,
)
from ._effect import Effect
from ._estimates import Estimate, estimated, spread
from ._fit import judged
from ._least_squares import starts_removed
from ._misfit import NOISE_SIGMAS, RunScore, Score, noise_band, only_noise, pooled, run_scores
from ._missing import Missing, missing_force
from ._recording import Case, Noise
from ._score import ALPHA
from ._study import Optimum, inverse

MOST_EFFECTS = 4
OPEN = 1e-9
"""What runs left together tell of a parameter at the least, as a share of what all tell: it keeps matrices regular."""
TELLING = 0.05
"""An effect that lowers the excess of the misfit over noise by less than this share, short of noise, is no help."""


class Stage(NamedTuple):
    """The loop after one step: what was `added` or `dropped`, the fit, its scores, and the candidates beside it."""

    change: str
    name: str
    bench: Bench
    step: Step
    train: Score
    heldout: Score | None
    runs: tuple[RunScore, ...]
    estimates: dict[str, Estimate]
    ranking: tuple[Ranked, ...]
    judgement: Optimum | None
    """The held-out runs, opened once for this stage."""

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects in the model, `lateral_skid` among them where the structure was changed."""
        switched = (LATERAL_SKID,) if self.bench.switched else ()
        return (*switched, *self.step.effects)

    @property
    def left_out(self) -> dict[str, str]:
        """The candidates that were not ranked, with the reason: they do not apply, or these runs do not show them."""
        ranked = {candidate.effect for candidate in self.ranking} | set(self.step.effects)
        known = self.bench.study.model.effects
        silent = {name: known[name].silent for name in self.bench.candidates if name not in ranked}
        return self.bench.left_out | silent


class Explanation(eqx.Module):
    """The whole story: `stages[0]` is the base, the last one the final model.

    `verdict`: "adequate", "explained" or "unexplained". `effects`: what explains the recordings. `partial`: what helped
    without explaining. `left_out`: candidates that do not apply, with the reason. `missing`: the force that the base
    lacks, where nothing explains it; None where there is but one train run to learn it from.
    """

    case: Case
    noise: Noise
    stages: tuple[Stage, ...]
    verdict: str
    effects: tuple[str, ...]
    partial: tuple[str, ...]
    left_out: dict[str, str]
    missing: Missing | None

    @property
    def base(self) -> Stage:
        """The fit before anything was added."""
        return self.stages[0]

    @property
    def final(self) -> Stage:
        """The fit with all that was added."""
        return self.stages[-1]


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


def stage(bench: Bench, change: str, name: str, step: Step, ranking: Sequence[Ranked] = ()) -> Stage:
    """Judge `step`: train and held-out scores, estimates."""
    runs = run_scores(bench.study, step.optimum, bench.train)
    heldout = judged(bench.study, step.optimum.values)
    unseen = () if heldout is None else run_scores(bench.study, heldout, bench.study.numbered("heldout"))
    return Stage(
        change,
        name,
        bench,
        step,
        pooled(runs),
        pooled(unseen) if unseen else None,
        (*runs, *unseen),
        estimated(bench.study, step.optimum),
        tuple(ranking),
        heldout,
    )


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


def better(bench: Bench, now: Step, then: Step) -> bool:
    """Whether `then` predicts train runs it has not seen better than `now` does, and enough to matter.

    A fall of chi^2 within a score test's reach of zero is no evidence; with one train run it is all there is. Where
    `now` is far from the recordings the misfit of its own fit stands for what it would predict, which favours it.
    """
    samples = now.optimum.samples
    fall = samples * (now.optimum.misfit - then.optimum.misfit)
    variance = max(1.0, then.optimum.misfit)
    freed = len(then.optimum.free) - len(now.optimum.free)
    if not np.isfinite(then.optimum.misfit) or fall / variance < stats.chi2.isf(ALPHA / 25, max(freed, 1)):
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


class Question(TypedDict, total=False):
    """What `diagnose` and `explain` can be told beyond the recordings and the candidates.

    `kind`: the tyre law of the base, "pacejka" (default) or "rayleigh"; `skid`: its structure (default: the case's);
    `with_`: effects in the base from the start; `switch`: whether the change of structure from coupled to free is a
    candidate (default True); `progress` is told what is being done.
    """

    kind: str
    skid: str | None
    with_: Sequence[str]
    switch: bool
    progress: Callable[[str], None]


def _silent(_: object) -> None:
    """Nobody wants to know."""


class Diagnosis(NamedTuple):
    """The base, what its ranking says is missing, and the other skid structure beside it where there is one."""

    base: Stage
    switched: tuple[Bench, Step] | None


def diagnose(case: Case, noise: Noise, library: Mapping[str, Effect], **question: Unpack[Question]) -> Diagnosis:
    """Rank the effects of `library` by how well each would explain what the base model leaves of the train runs.

    Nothing is added: all candidates are scored at the base fit, the best few refitted beside it.

    **Arguments:** `question`, see `Question`. **Raises:** `FitError` where the base cannot be fitted.
    """
    with_, progress = question.get("with_", ()), question.get("progress", _silent)
    options = structures(case, question.get("kind", "pacejka"), question.get("skid"))
    options = options[: 2 if question.get("switch", True) else 1]
    bench = Bench.of(options[0][1], case, noise, library)
    step = Step(tuple(with_), base_fit(bench, with_, progress))
    ranking = tuple(rank(bench, step, progress=progress))
    switched = None
    if len(options) > 1:
        progress(f"refitting with {LATERAL_SKID}")
        other = Bench.of(options[1][1], case, noise, library, switched=True)
        there = Step(step.effects, base_fit(other, with_, progress))
        ranking = _placed(ranking, Ranked(LATERAL_SKID, None, None, there.optimum, (), None))
        switched = (other, there)
    return Diagnosis(stage(bench, "base", "", step, ranking), switched)


def explain(
    case: Case,
    noise: Noise,
    library: Mapping[str, Effect],
    *,
    show: Callable[[Stage], None] = _silent,
    **question: Unpack[Question],
) -> Explanation:
    """Find out which effects of `library` the recordings of `case` show beyond the base model.

    **Arguments:** `show` is given each stage; `question`, see `Question`.
    **Raises:** `FitError` where the base cannot be fitted.
    """
    progress = question.get("progress", _silent)
    found = diagnose(case, noise, library, **question)
    stages = [found.base]
    show(found.base)
    stages += _beyond(found, progress, show)
    return _concluded(case, noise, stages, progress)


def _beyond(found: Diagnosis, progress, show) -> list[Stage]:
    """The stages after the base."""
    base = found.base
    bench, step, ranking = base.bench, base.step, base.ranking
    if only_noise(step.optimum) and not _significant(ranking):
        return []
    if found.switched is None:
        return _follow(bench, step, ranking, [], progress, show)
    best = min((r.refit_misfit for r in ranking if r.refit is not None), default=np.inf)
    other, there = found.switched

    def on_the_other(show: Callable[[Stage], None]) -> list[Stage]:
        first = stage(other, "added", LATERAL_SKID, there, rank(other, there, progress=progress))
        show(first)
        return _follow(other, there, first.ranking, [first], progress, show)

    if there.optimum.misfit <= best and better_structure(step, there):
        return on_the_other(show)
    here = _follow(bench, step, ranking, [], progress, _silent)
    if not (here and only_noise(here[-1].step.optimum)):
        # This structure does not explain by itself: follow the other one too, and keep what gets further.
        beside = on_the_other(_silent)
        reached = here[-1].step.optimum.misfit if here else step.optimum.misfit
        here = beside if beside[-1].step.optimum.misfit < reached else here
    for one in here:
        show(one)
    return here


def _follow(bench, step, ranking, before, progress, show) -> list[Stage]:
    """Add what helps most, one effect after the other, then try to do without each."""
    stages = list(before)
    if step.optimum.misfit > NEARLY and not _ends_in_noise(ranking):
        for name, then, ranks in _together(bench, step, ranking, progress):
            step, ranking = then, ranks
            stages.append(stage(bench, "added", name, step, ranking))
            show(stages[-1])
    while len(step.effects) < MOST_EFFECTS and not (only_noise(step.optimum) and not _significant(ranking)):
        found = None
        for candidate in promising(ranking):
            then = Step((*step.effects, candidate.effect), candidate.refit)
            progress(f"does {candidate.effect} predict runs it has not seen?")
            if better(bench, step, then):
                found = (candidate.effect, then)
                break
        if found is None:
            break
        name, step = found[0], _polished(bench, found[1], progress)
        ranking = tuple(rank(bench, step, progress=progress))
        stages.append(stage(bench, "added", name, step, ranking))
        show(stages[-1])
    for name in step.effects:
        if len(step.effects) < 2 or _certain(bench, step, name):
            continue
        progress(f"can the model do without {name}?")
        rest = tuple(effect for effect in step.effects if effect != name)
        without = Step(rest, _settled_without(bench, step, rest))
        lost = step.optimum.samples * (without.optimum.misfit - step.optimum.misfit)
        freed = len(step.optimum.free) - len(without.optimum.free)
        if lost / max(1.0, step.optimum.misfit) < stats.chi2.isf(ALPHA / 25, max(freed, 1)):
            step = without
            stages.append(stage(bench, "dropped", name, step))
            show(stages[-1])
    return stages


def _settled_without(bench: Bench, step: Step, rest: Sequence[str]) -> Optimum:
    """The fit with the effects `rest` alone, from where that of `step` ended; taken up again where it is on its way."""
    found = refit(bench, rest, step.optimum.values, step.optimum.start)
    if found.converged or not found.misfit < NEARLY:
        return found
    return least(found, bench.study.fit(found.values, bench.free(rest), bench.train, found.start))


def _polished(bench: Bench, step: Step, progress) -> Step:
    """`step`, or a better optimum of the same model where it ended near the noise but not in it, or on the way."""
    if only_noise(step.optimum) and not step.optimum.converged:
        ended = step.optimum
        further = bench.study.fit(ended.values, bench.free(step.effects), bench.train, ended.start)
        step = Step(step.effects, least(further, ended))
    if (only_noise(step.optimum) and step.optimum.converged) or not step.optimum.misfit < HOPELESS:
        return step
    again = fresh_fit(bench, step.effects, step.optimum.values, progress)
    return Step(step.effects, least(step.optimum, again))


def _certain(bench: Bench, step: Step, name: str) -> bool:
    """Whether `name` is so far from neutral, in its standard errors, that no refit without it is needed."""
    parts = [part for part in bench.candidates[name] if part in step.optimum.loose]
    if not parts or not only_noise(step.optimum):
        return False
    rows = [step.optimum.loose.index(part) for part in parts]
    values = np.array([step.optimum.values[part] for part in parts])
    covariance = step.optimum.covariance[np.ix_(rows, rows)]
    wald = float(values @ inverse(covariance) @ values) if np.isfinite(covariance).all() else 0.0
    return wald > 1e3 * len(parts)


def _together(bench, step, ranking, progress) -> list[tuple[str, Step, tuple[Ranked, ...]]]:
    """The steps to the set of effects that explains the windows together and whole runs best, or none.

    Far from the recordings whole runs cannot say which of two missing effects comes first; short windows can say which
    pair leaves least.
    """
    first = [r.prospect for r in sorted(ranking, key=lambda r: r.predicted_misfit or np.inf) if r.prospect is not None]
    sets = accomplices(bench, step, first, len(step.effects) + 3, progress)
    best_on_windows = sets[0].misfit if sets else np.inf
    tried = [s for s in sets if s.misfit - 1 < 2 * max(best_on_windows - 1, 0.02)][:3]
    progress(f"refitting {len(tried)} sets of effects on whole runs")
    refits = [Step(s.effects, refit(bench, s.effects, s.values, near=s.misfit < CLOSE)) for s in tried]
    refits = [r for r in refits if r.optimum.misfit < step.optimum.misfit]
    if not refits:
        return []
    best = min(
        refits,
        key=lambda r: (not only_noise(r.optimum), len(r.effects) if only_noise(r.optimum) else 0, r.optimum.misfit),
    )
    if not better(bench, step, best):
        return []
    path = []
    for count in range(len(step.effects) + 1, len(best.effects)):
        part = best.effects[:count]
        path.append((part[-1], Step(part, refit(bench, part, best.optimum.values, near=False)), ()))
    path.append((best.effects[-1], best, tuple(rank(bench, best, progress=progress))))
    return path


def promising(ranking: Sequence[Ranked]) -> list[Ranked]:
    """The refitted candidates in the order to try them: by refit where one comes near, else by the windows.

    Two refits that are both far from the recordings say little about which effect is missing.
    """
    refitted = [r for r in ranking if r.refit is not None and r.effect != LATERAL_SKID]
    if any(r.refit is not None and r.refit.misfit < HOPELESS for r in refitted):
        return refitted
    return sorted(refitted, key=lambda r: np.inf if r.predicted_misfit is None else r.predicted_misfit)


def better_structure(now: Step, then: Step) -> bool:
    """Whether a change of structure, which frees nothing, lowers the misfit by more than chance."""
    fall = then.optimum.samples * (now.optimum.misfit - then.optimum.misfit)
    return bool(fall > stats.chi2.isf(ALPHA / 25, 1))


def _significant(ranking: Sequence[Ranked]) -> bool:
    return any(r.score is not None and r.score.p_value < ALPHA for r in ranking)


def _ends_in_noise(ranking: Sequence[Ranked]) -> bool:
    return any(r.refit is not None and only_noise(r.refit) for r in ranking)


def _placed(ranking: Sequence[Ranked], new: Ranked) -> tuple[Ranked, ...]:
    """`ranking` with `new`, which has a refit, in its place."""
    refitted = [(r.refit.misfit, r) for r in (*ranking, new) if r.refit is not None]
    return (*(r for _, r in sorted(refitted, key=lambda pair: pair[0])), *(r for r in ranking if r.refit is None))


def _concluded(case: Case, noise: Noise, stages: list[Stage], progress) -> Explanation:
    last = stages[-1]
    clean = only_noise(last.step.optimum) and heldout_noise(last.bench, last.step, last.judgement)
    if clean:
        verdict = "explained" if last.effects else "adequate"
        return Explanation(case, noise, tuple(stages), verdict, last.effects, (), stages[0].left_out, None)
    missing = None
    if len(last.bench.train) > 1:
        # Helpers that do not explain would hide a part of it, so it is counted from the structure alone.
        bare = next(stage for stage in stages if stage.bench is last.bench)
        missing = missing_force(bare.bench, bare.step, progress)
    return Explanation(case, noise, tuple(stages), "unexplained", (), last.effects, stages[0].left_out, missing)
