"""Diagnosis: which effect is missing? Candidates are ranked on short windows, the best refitted on whole runs."""

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy import stats

from ._approach import approach, least, require_sensitive, require_sound
from ._effect import Effect
from ._misfit import only_noise
from ._model import Model
from ._recording import Case, Noise
from ._score import ALPHA, Scored, confusable
from ._sight import Sight, tested
from ._skid import Coupled
from ._starting import default_free, starting_model
from ._study import DEPENDENT, Optimum, Study
from ._units import parameters
from ._windows import LENGTH, Settled, Windows, linearised

LATERAL_SKID = "lateral_skid"
WIDTH = 13
"""How many parameters one compiled fit can free: a tyre and several effects."""
NEARLY = 4.0
"""Below this misfit the errors of whole runs are small enough for a linear score, which is sharper than windows."""
HOPELESS = 50.0
"""Above this misfit a model is far from the truth, and polishing its parameters would only make them absurd."""
CRAWL = 2e-3
"""A model that is not the truth is fitted no further where a step lowers its misfit by less than this share."""
FAR = 1.1
"""Above this misfit of the windows, they are searched for a further effect before whole runs are believed."""
CLOSE = 2.0
"""Windows that leave less than this misfit have found values from which whole runs can be fitted at once."""
SETTLED = 4
BEAM = 3
GAIN = 0.9
"""A further effect must lower the excess of the windows' misfit over noise to this share, or the search ends."""
REFITTED = 3
WEAKER = 0.25
"""The second size of the tyre force from which windows settle."""
WORKERS = 2


class Ranked(NamedTuple):
    """One candidate at the base: the score test, and its refit where it was among the best."""

    effect: str
    score: Scored | None
    predicted_misfit: float | None
    refit: Optimum | None
    confusable_with: tuple[str, ...]
    prospect: "Prospect | None" = None

    @property
    def refit_misfit(self) -> float | None:
        """Train misfit of the refit on whole runs."""
        return None if self.refit is None else self.refit.misfit


class Bench(eqx.Module):
    """Everything one diagnosis needs at hand: the model with every candidate at its neutral value, compiled once.

    `tyre` are the names the base fit frees; `candidates` maps an effect to its parameter names; `left_out` says why a
    candidate does not apply.
    """

    study: Study
    windows: Windows
    tyre: tuple[str, ...] = eqx.field(static=True)
    candidates: OrderedDict[str, tuple[str, ...]] = eqx.field(static=True)
    left_out: dict[str, str] = eqx.field(static=True)
    switched: bool = eqx.field(static=True, default=False)

    @staticmethod
    def of(model: Model, case: Case, noise: Noise, library: Mapping[str, Effect], switched: bool = False) -> "Bench":
        """`model` with every effect of `library` that can act on it, over the runs of `case`.

        `switched` says that its structure is not the one the case names.
        """
        full, left_out, candidates = model, {}, OrderedDict()
        for name, effect in library.items():
            if name in model.effects:
                full_effect = model.effects[name]
            elif why := effect.refusal(model):
                left_out[name] = why
                continue
            else:
                full_effect = effect
                full = full.add(**{name: effect})
            candidates[name] = tuple(f"effects.{name}.{part}" for part in parameters(full_effect))
        tyre = tuple(n for n in default_free(model) if n.startswith("tyre."))
        names = [*tyre, *(part for parts in candidates.values() for part in parts)]
        study = Study.of(full, case.runs, noise, names, WIDTH)
        windows = Windows.of(full, case.having("train"), noise, names, WIDTH, LENGTH)
        return Bench(study, windows, tyre, candidates, left_out, switched)

    @property
    def train(self) -> list[int]:
        """The numbers of the train runs."""
        return self.study.numbered("train")

    def free(self, effects: Sequence[str]) -> list[str]:
        """The parameters free in a model with `effects`."""
        return [*self.tyre, *(part for effect in effects for part in self.candidates[effect])]

    def probes(self) -> dict[str, float]:
        """The parameters whose derivative at the neutral value does not exist, with the value to score them from."""
        found = {}
        for name, parts in self.candidates.items():
            probe = self.study.model.effects[name].probe
            found |= {part: probe[part.rsplit(".", 1)[-1]] for part in parts if part.rsplit(".", 1)[-1] in probe}
        return found


def sight(bench: Bench, values: Mapping[str, float], start: np.ndarray, windows: bool) -> Sight:
    """Every candidate beside the model at `values`, on `windows` or on whole train runs."""
    study = bench.windows.study if windows else bench.study
    runs = tuple(range(len(study.runs)) if windows else bench.train)
    return Sight(study, runs, values, start, linearised(study, values, start, runs))


class Step(NamedTuple):
    """The state of an explanation: which effects are in, and the fit with them."""

    effects: tuple[str, ...]
    optimum: Optimum


class Prospect(NamedTuple):
    """A candidate as its score sees it: where to start its refit, and the misfit to expect once it is in.

    `start`: where the windows start with it, if they have settled.
    """

    score: Scored
    values: dict[str, float]
    misfit: float
    start: np.ndarray | None = None


def prospects(bench: Bench, step: Step, progress: Callable[[str], None] = lambda _: None) -> list[Prospect]:
    """The candidates beside `step`, the most promising first.

    Near the noise whole runs are scored. Further off windows are, after the fitted parameters have settled on them; and
    the best few candidates settle there too, each with its own parameters free, so that their order does not rest on a
    linear model.
    """
    remaining = {name: parts for name, parts in bench.candidates.items() if name not in step.effects}
    fitted = [name for name in bench.free(step.effects) if name not in step.optimum.held]
    near = step.optimum.misfit < NEARLY
    if near:
        values, start = step.optimum.values, step.optimum.start
    else:
        progress("settling on windows")
        settled = _settled(bench, step, fitted)
        values, start = settled.values, settled.start
    scores, chi2, dof = tested(sight(bench, values, start, not near), fitted, remaining, bench.probes())
    found = [Prospect(s, {**values, **s.values}, max(chi2 - s.reduction, 0.0) / dof) for s in scores]
    if near:
        return found
    return _settle_all(bench, found, remaining, fitted, values, start, chi2 / dof, dof, progress)


def _settle_all(bench, found, remaining, fitted, values, start, misfit, dof, progress) -> list[Prospect]:
    """The best of `found`, and those without a derivative at zero, settled on the windows; they come first."""
    close = [p for p in found if p.score.effect in _probed(bench)]
    close += [p for p in found if p not in close and p.score.p_value < ALPHA][:SETTLED]
    progress(f"settling {len(close)} candidates on windows")

    def beside(prospect: Prospect) -> dict[str, float]:
        # From where the others have settled, so that all move together; only what has no slope at zero starts off it.
        parts = remaining[prospect.score.effect]
        return {n: _off_zero(bench, n, values[n]) if n in parts else values[n] for n in prospect.values}

    def settle(prospect: Prospect) -> Prospect:
        parts = remaining[prospect.score.effect]
        best = bench.windows.settle(beside(prospect), [*fitted, *parts], start, rounds=25)
        if best.cost / dof > misfit:
            return prospect._replace(misfit=misfit)
        changed = prospect.score._replace(values={n: best.values[n] for n in parts})
        if prospect.score.effect in _probed(bench):
            changed = _surer(changed, (misfit * dof - best.cost), best.cost / dof, len(parts), len(found))
        return Prospect(changed, best.values, best.cost / dof, best.start)

    with ThreadPoolExecutor(WORKERS) as pool:
        close = sorted(pool.map(settle, close), key=lambda p: p.misfit)
    done = {p.score.effect for p in close}
    return [*close, *(p for p in found if p.score.effect not in done)]


def _surer(scored: Scored, fall: float, left: float, count: int, family: int) -> Scored:
    """`scored` with the evidence of a settled fit, where it is the stronger: a candidate without a slope at its neutral
    value has no score there. Errors that are more than noise depend on each other.
    """
    statistic = fall / (max(left, 1.0) * (1.0 if left < CLOSE else DEPENDENT))
    if statistic <= scored.statistic:
        return scored
    p_value = min(1.0, family * float(stats.chi2.sf(statistic, count)))
    return scored._replace(statistic=statistic, p_value=min(p_value, scored.p_value))


class Suspects(NamedTuple):
    """A set of effects that together explain the windows, with the values found there and the misfit they leave."""

    effects: tuple[str, ...]
    values: dict[str, float]
    misfit: float
    start: np.ndarray | None


def accomplices(
    bench: Bench, step: Step, first: Sequence[Prospect], most: int, progress: Callable[[str], None] = lambda _: None
) -> list[Suspects]:
    """Sets of effects, searched on the windows alone: the best few of each size, until one leaves little.

    An effect that comes first by itself need not belong to the best pair, so several are followed.
    """
    beam = [Suspects((*step.effects, p.score.effect), p.values, p.misfit, p.start) for p in first[:BEAM]]
    everything = list(beam)
    while beam and beam[0].misfit > FAR and len(beam[0].effects) < most:
        grown: list[Suspects] = []
        for suspects in beam:
            progress(f"who acts beside {' and '.join(suspects.effects)}?")
            grown += _grown(bench, suspects, {frozenset(g.effects) for g in grown})
        grown = sorted(grown, key=lambda g: g.misfit)[:BEAM]
        if not grown or grown[0].misfit - 1 > GAIN * (beam[0].misfit - 1):
            break
        beam = grown
        everything += beam
    return sorted(everything, key=lambda g: g.misfit)


def _grown(bench: Bench, suspects: Suspects, known: set[frozenset[str]]) -> list[Suspects]:
    """`suspects` and one more, for the few that promise most."""
    free = bench.free(suspects.effects)
    settled = bench.windows.settle(suspects.values, free, suspects.start, rounds=12)
    remaining = {n: parts for n, parts in bench.candidates.items() if n not in suspects.effects}
    scores, _, dof = tested(sight(bench, settled.values, settled.start, True), free, remaining, bench.probes())
    new = [s for s in scores if frozenset((*suspects.effects, s.effect)) not in known][:BEAM]

    def settle(s: Scored) -> Suspects:
        begin = {**settled.values, **{n: _off_zero(bench, n, settled.values[n]) for n in s.values}}
        best = bench.windows.settle(begin, [*free, *remaining[s.effect]], settled.start, rounds=25)
        return Suspects((*suspects.effects, s.effect), best.values, best.cost / dof, best.start)

    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(settle, new))


def _settled(bench: Bench, step: Step, fitted: Sequence[str]) -> Settled:
    """The fitted parameters on the windows, from where they are and from where the tyre began."""
    fresh = {**step.optimum.values, **{n: bench.study.values()[n] for n in bench.tyre}}
    with ThreadPoolExecutor(WORKERS) as pool:
        both = pool.map(lambda values: bench.windows.settle(values, fitted, rounds=15), (step.optimum.values, fresh))
    return min(both, key=lambda s: s.cost)


def _probed(bench: Bench) -> set[str]:
    return {name.split(".")[1] for name in bench.probes()}


def refit(
    bench: Bench,
    effects: Sequence[str],
    values: Mapping[str, float],
    start: np.ndarray | None = None,
    *,
    near: bool = True,
) -> Optimum:
    """Fit a model with `effects` to whole train runs from `values`, and from `start` where it is known.

    Where windows leave little, the values there are `near` the optimum. Else the fit goes over a growing horizon, and
    stops early while the model stays far off: polishing it would only make its parameters absurd.
    """
    free, train = bench.free(effects), bench.train
    neutral = bench.study.values()
    known = {name: (values[name] if name in free else neutral[name]) for name in bench.study.names}
    known = {name: _off_zero(bench, name, value) if name in free else value for name, value in known.items()}
    if near:
        found = bench.study.fit(known, free, train, start, crawl=CRAWL, most=30)
        if found.misfit < HOPELESS:
            return found
    first = bench.study.fit(known, free, train, until=4.0, enough=1.0, weak_prior=True, most=6)
    rough = bench.study.fit(first.values, free, train, first.start, enough=1.0, weak_prior=True, most=4)
    if not rough.misfit < HOPELESS:
        return rough
    return bench.study.fit(rough.values, free, train, rough.start, crawl=CRAWL, most=30)


def _off_zero(bench: Bench, name: str, value: float) -> float:
    """A parameter without a derivative at zero must start beside it."""
    return bench.probes().get(name, value) if value == 0.0 else value


def rank(
    bench: Bench, step: Step, *, refitted: int = REFITTED, progress: Callable[[str], None] = lambda _: None
) -> list[Ranked]:
    """All candidates beside `step`: scored, and the best `refitted` of them refitted on whole runs."""
    progress("scoring candidates")
    found = prospects(bench, step, progress)
    alike = confusable([p.score for p in found])
    sure = [p for p in found if p.score.p_value < ALPHA]
    best = min((p.misfit for p in sure), default=np.inf)
    # One that stays far behind the best on the windows is not worth the time of a refit.
    shortlist = sorted((p for p in sure if p.misfit - 1 < 3 * max(best - 1, 0.02)), key=lambda p: p.misfit)[:refitted]
    progress(f"refitting {len(shortlist)} candidates on whole runs")

    def again(prospect: Prospect) -> Optimum:
        near = prospect.misfit < CLOSE
        return refit(bench, [*step.effects, prospect.score.effect], prospect.values, near=near)

    with ThreadPoolExecutor(WORKERS) as pool:
        refits = dict(zip([p.score.effect for p in shortlist], pool.map(again, shortlist), strict=True))
    ranked = [
        Ranked(p.score.effect, p.score, p.misfit, refits.get(p.score.effect), tuple(alike[p.score.effect]), p)
        for p in found
    ]
    return sorted(ranked, key=_order)


def _order(ranked: Ranked) -> tuple[int, float]:
    if ranked.refit is not None and np.isfinite(ranked.refit.misfit):
        return 0, ranked.refit.misfit
    return 1, -(ranked.score.statistic if ranked.score else 0.0)


def base_fit(bench: Bench, effects: Sequence[str] = (), progress: Callable[[str], None] = lambda _: None) -> Optimum:
    """The base: the tyre, and `effects` put in from the start, fitted to windows and then to whole train runs."""
    require_sensitive(bench.study, bench.study.values(), bench.tyre, bench.train)
    return require_sound(bench.study, fresh_fit(bench, effects, bench.study.values(), progress), bench.train)


def fresh_fit(
    bench: Bench, effects: Sequence[str], values: Mapping[str, float], progress: Callable[[str], None] = lambda _: None
) -> Optimum:
    """The tyre fitted from where it began, and `effects` from `values`, to windows and then to whole train runs.

    Windows settle from two sizes of the tyre force. Where the fit ends near the noise but not in it, or not at all, the
    growing horizon is tried too: it may have missed the optimum, which must not be taken for a missing effect.
    """
    study, train, free = bench.study, bench.train, bench.free(effects)
    progress("fitting windows")
    began = {name: study.values()[name] for name in bench.tyre}
    weaker = {name: value * WEAKER for name, value in began.items() if name in ("tyre.D", "tyre.k_s")}
    values = {name: _off_zero(bench, name, value) if name in free else value for name, value in values.items()} | began
    with ThreadPoolExecutor(WORKERS) as pool:
        settled = pool.map(lambda start: bench.windows.settle(start, free), (values, values | weaker))
        best = min(settled, key=lambda s: s.cost)
    progress("fitting whole runs")
    misfit = best.cost / max(best.found.residual.size, 1)
    found = refit(bench, effects, best.values, near=misfit < CLOSE)
    if (only_noise(found) and found.converged) or not found.misfit < HOPELESS:
        return found
    first = approach(study, values, free, train, progress)
    return least(found, study.fit(first.values, free, train, first.start, crawl=CRAWL, most=30))


def structures(case: Case, kind: str, skid: str | None) -> list[tuple[str, Model]]:
    """The models a diagnosis of `case` considers: the base, and `free` where the base is `coupled`."""
    model = starting_model(case, kind, skid)
    if isinstance(model.skid, Coupled):
        return [("", model), (LATERAL_SKID, Model(model.board, model.tyre, "free", model.effects))]
    return [("", model)]
