"""Diagnosis: which effect is missing? Candidates are ranked on short windows, and the best are refitted on whole runs."""

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ._effect import Effect
from ._fit import default_free, require_sensitive, require_sound, starting_model
from ._model import Model
from ._recording import Case, Noise
from ._score import ALPHA, Reduced, Scored, confusable, reduced, score
from ._skid import Coupled
from ._study import Optimum, Study
from ._units import parameters
from ._windows import Windows, wide

LATERAL_SKID = "lateral_skid"
WINDOW = 1.5
"""Length of a window [s]: long enough to see an effect, short enough that its action stays nearly linear."""
WIDTH = 12
"""How many parameters one compiled fit can free: a tyre and several effects."""
NEARLY = 4.0
"""Below this misfit the errors of whole runs are small enough for a linear score, which is sharper than windows."""
HOPELESS = 50.0
"""Above this misfit a model is far from the truth, and polishing its parameters would only make them absurd."""
REFITTED = 3



class Ranked(NamedTuple):
    """One candidate at the base: the score test, and its refit where it was among the best."""

    effect: str
    score: Scored | None
    predicted_misfit: float | None
    refit: Optimum | None
    confusable_with: tuple[str, ...]

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
    def of(
        model: Model, case: Case, noise: Noise, library: Mapping[str, Effect], switched: bool = False
    ) -> "Bench":
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
        windows = Windows.of(full, case.having("train"), noise, names, WINDOW)
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


def whole_runs(bench: Bench, optimum: Optimum) -> Reduced:
    """Residuals of whole train runs and the signatures of all candidates there."""
    study = bench.study
    return _signatures(bench, study, optimum.values, optimum.start, bench.train)


def on_windows(bench: Bench, values: Mapping[str, float], start: np.ndarray) -> Reduced:
    """Residuals of the windows and the signatures of all candidates there."""
    study = bench.windows.study
    return _signatures(bench, study, values, start, range(len(study.runs)))


def _signatures(bench: Bench, study: Study, values, start, runs) -> Reduced:
    found = wide(study, values, start, runs)
    jacobian = found.jacobian.copy()
    for name, probe in bench.probes().items():
        if values[name] == 0.0:
            there = wide(study, {**values, name: probe}, start, runs)
            jacobian[..., study.names.index(name)] = (there.residual - found.residual) / probe
    free_start = np.asarray(study.batch.free_start)
    return reduced(found._replace(jacobian=jacobian), free_start, list(runs), np.asarray(study.batch.times), WINDOW)


class Step(NamedTuple):
    """The state of an explanation: which effects are in, and the fit with them."""

    effects: tuple[str, ...]
    optimum: Optimum


def scored_at(bench: Bench, step: Step, settle: bool = True) -> tuple[list[Scored], dict[str, dict[str, float]], float]:
    """Candidates beside `step`, best first; the start values each suggests; and the misfit they were scored against.

    Near the noise whole runs are scored; further off windows are, after the fitted parameters have settled on them.
    """
    remaining = {name: parts for name, parts in bench.candidates.items() if name not in step.effects}
    fitted = [name for name in bench.free(step.effects) if name not in step.optimum.held]
    names = bench.study.names
    if step.optimum.misfit < NEARLY:
        values = step.optimum.values
        rest = whole_runs(bench, step.optimum)
    else:
        settled = bench.windows.settle(step.optimum.values, fitted)
        if settle:
            fresh = {**step.optimum.values, **{n: bench.study.values()[n] for n in bench.tyre}}
            settled = min(settled, bench.windows.settle(fresh, fitted), key=lambda s: s.cost)
        values = settled.values
        rest = on_windows(bench, values, settled.start)
    found = score(bench.study.model, names, rest, fitted, remaining, values)
    misfit = float((rest.residual**2).sum() / max(rest.residual.size - rest.lost - len(fitted), 1))
    return found, {s.effect: {**values, **s.values} for s in found}, misfit


def refit(bench: Bench, effects: Sequence[str], values: Mapping[str, float]) -> Optimum:
    """Fit a model with `effects` to whole train runs, from `values`, over a growing horizon."""
    free, train = bench.free(effects), bench.train
    neutral = bench.study.values()
    known = {name: (values[name] if name in free else neutral[name]) for name in bench.study.names}
    known = {name: _off_zero(bench, name, value) if name in free else value for name, value in known.items()}
    first = bench.study.fit(known, free, train, until=4.0, tolerance=1.0, weak_prior=True, most=6)
    rough = bench.study.fit(first.values, free, train, first.start, tolerance=1.0, weak_prior=True, most=8)
    if not rough.misfit < HOPELESS:
        return rough
    return bench.study.fit(rough.values, free, train, rough.start, most=25)


def _off_zero(bench: Bench, name: str, value: float) -> float:
    """A parameter without a derivative at zero must start beside it."""
    return bench.probes().get(name, value) if value == 0.0 else value


def rank(
    bench: Bench,
    step: Step,
    *,
    refitted: int = REFITTED,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Ranked]:
    """All candidates beside `step`: scored, and the best `refitted` of them refitted on whole runs."""
    progress("scoring candidates")
    scores, starts, misfit = scored_at(bench, step)
    alike = confusable(scores)
    dof = max(sum(np.asarray(bench.study.batch.weight)[bench.train].reshape(-1) > 0), 1)
    chi2 = misfit * dof
    shortlist = [s.effect for s in scores if s.p_value < ALPHA][:refitted]
    ranked = []
    for s in scores:
        fitted = None
        if s.effect in shortlist:
            progress(f"refitting with {s.effect}")
            fitted = refit(bench, [*step.effects, s.effect], starts[s.effect])
        predicted = max(misfit - s.reduction / dof, 0.0) if chi2 else None
        ranked.append(Ranked(s.effect, s, predicted, fitted, tuple(alike[s.effect])))
    return sorted(ranked, key=_order)


def _order(ranked: Ranked) -> tuple[int, float]:
    if ranked.refit is not None and np.isfinite(ranked.refit.misfit):
        return 0, ranked.refit.misfit
    return 1, -(ranked.score.statistic if ranked.score else 0.0)


def base_fit(bench: Bench, effects: Sequence[str] = (), progress: Callable[[str], None] = lambda _: None) -> Optimum:
    """The base: the tyre, and `effects` put in from the start, fitted to windows and then to whole train runs."""
    study, train = bench.study, bench.train
    progress("fitting windows")
    require_sensitive(study, study.values(), bench.tyre, train)
    settled = bench.windows.settle(study.values(), bench.free(effects))
    progress("fitting whole runs")
    return require_sound(study, refit(bench, effects, settled.values), train)


def structures(case: Case, kind: str, skid: str | None) -> list[tuple[str, Model]]:
    """The models a diagnosis of `case` considers: the base, and `free` where the base is `coupled`."""
    model = starting_model(case, kind, skid)
    if isinstance(model.skid, Coupled):
        return [("", model), (LATERAL_SKID, Model(model.board, model.tyre, "free", model.effects))]
    return [("", model)]
