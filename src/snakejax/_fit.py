"""Fitting: from recorded runs to parameters, and what the runs cannot determine."""

import fnmatch
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ._board import Board
from ._errors import InputError, instead_of
from ._least_squares import domains_of
from ._model import Model, no_traction
from ._recording import Case, Noise, Run
from ._study import Optimum, Study
from ._tyre import AbstractTyre, Pacejka, Rayleigh
from ._units import parameters, with_parameters
from ._windows import LENGTH, Windows

MODELS = ("pacejka", "rayleigh", "ideal")
LACKING = 50.0
"""Above this misfit of whole runs the fit is tried once more from where windows lead it."""
HORIZONS = (1.5, 4.0)
"""The first seconds [s] on which a fit finds its way before it takes whole runs: errors have not grown there yet."""
GOOD_START = 1.1
LOOSE = 0.5
"""A parameter is undetermined where its relative standard error (for E: the standard error) is larger than this."""

NOISE_SIGMAS = 4.0
"""Only noise is left where the misfit lies within this many standard deviations of that of noise alone."""


class FitError(RuntimeError):
    """A fit that cannot succeed: which parameter or run, and why. One line."""


class Estimate(NamedTuple):
    """A fitted number: `sd` is one standard error, None where the data or a bound of the domain leave it open."""

    value: float
    sd: float | None
    unit: str
    determined: bool
    at_bound: bool = False

    def interval(self, quantile: float = 1.959964) -> tuple[float, float] | None:
        """The 95% interval."""
        return None if self.sd is None else (self.value - quantile * self.sd, self.value + quantile * self.sd)


class RunScore(NamedTuple):
    """How far one run lies from the model: misfits are mean squares in units of the noise variance."""

    run: str
    role: str
    misfit: float
    channels: dict[str, float]
    position_m: float
    heading_rad: float
    samples: int
    worst_time_s: float


class Score(NamedTuple):
    """How far several runs lie from the model."""

    misfit: float
    position_m: float
    heading_rad: float
    samples: int


class Fit(eqx.Module):
    """A fitted model and what is known about it.

    `estimates` by parameter name; `correlation` of those in `loose`; `combinations`: products of parameters that the
    runs determine where they do not determine the factors; `runs`, the train runs; `heldout`, judged with only their
    start poses estimated; `advice`, in words, what the data could not tell.
    """

    study: Study
    optimum: Optimum
    estimates: dict[str, Estimate]
    correlation: np.ndarray
    combinations: dict[str, Estimate]
    runs: tuple[RunScore, ...]
    heldout: tuple[RunScore, ...]
    heldout_optimum: Optimum | None
    advice: tuple[str, ...]

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.study.fitted(self.optimum)

    @property
    def train_score(self) -> Score:
        """All train runs together."""
        return pooled(self.runs)

    @property
    def heldout_score(self) -> Score | None:
        """All held-out runs together, or None where there are none."""
        return pooled(self.heldout) if self.heldout else None


def starting_tyre(kind: str, board: Board) -> AbstractTyre:
    """A tyre to start from: a friction coefficient of 0.2 under the board's weight; none for the ideal board.

    **Raises:** `InputError` for a `kind` that is not one of `MODELS`.
    """
    load = float(board.mass) * 9.81 / 2
    if kind == "pacejka":
        return Pacejka(B=8.0, C=1.4, D=0.2 * load, E=0.0)
    if kind == "rayleigh":
        return Rayleigh(k_s=10.0 * load)
    if kind == "ideal":
        return no_traction()
    raise InputError(f"There is no model `{kind}`", "option --model", instead_of(kind, MODELS))


def starting_model(case: Case, kind: str = "pacejka", skid: str | None = None) -> Model:
    """The model a fit of `case` starts from: its board and structure, `starting_tyre`, no effects."""
    structure = "ideal" if kind == "ideal" else (skid or case.skid)
    return Model(case.board, starting_tyre(kind, case.board), structure)


def default_free(model: Model) -> list[str]:
    """The parameters a fit frees unasked: the tyre's own, and those of every effect in the model."""
    names = [n for n in parameters(model) if n.startswith("effects.")]
    if isinstance(model.tyre, Pacejka) and type(model.skid).__name__ != "Ideal":
        return ["tyre.B", "tyre.C", "tyre.D", "tyre.E", *names]
    if isinstance(model.tyre, Rayleigh):
        return ["tyre.k_s", *names]
    return names


def chosen(model: Model, patterns: Sequence[str]) -> list[str]:
    """The parameters that `patterns` name: dotted names, their last parts (`B`), or wildcards (`effects.*`).

    **Raises:** `InputError` for a pattern that fits nothing.
    """
    known, found = list(parameters(model)), []
    for pattern in patterns:
        fits = [n for n in known if fnmatch.fnmatchcase(n, pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern and n.startswith("tyre.")]
        fits = fits or [n for n in known if fnmatch.fnmatchcase(n.split(".", 1)[-1], pattern)]
        fits = fits or [n for n in known if n.rsplit(".", 1)[-1] == pattern]
        if not fits:
            raise InputError(f"No parameter is called `{pattern}`", "option --free", instead_of(pattern, known))
        found += [name for name in fits if name not in found]
    return found


def fit(
    model: Model,
    runs: Sequence[Run],
    noise: Noise,
    free: Sequence[str] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """Fit the `free` parameters of `model`, and where each run starts, to the train runs; judge the held-out ones.

    Minimises sum_k ((measured - modelled) / sd)^2 over all present samples of x, y and heading, by optimistix
    Levenberg-Marquardt, from several starts over the first seconds to whole runs.

    **Arguments:** `free`: names or wildcards as in `chosen`; `threshold`: that of Huber's loss in standard deviations.
    **Raises:** `InputError` for names that do not exist or no train run; `FitError` where the fit cannot succeed.
    """
    names = default_free(model) if free is None else chosen(model, free)
    study = Study.of(model, runs, noise, names, max(len(names), 1))
    return fit_study(study, names, threshold=threshold, progress=progress)


def fit_study(
    study: Study,
    free: Sequence[str],
    values: Mapping[str, float] | None = None,
    *,
    threshold: float = np.inf,
    progress: Callable[[str], None] = lambda _: None,
) -> Fit:
    """`fit` for a study at hand, from `values` (default: the model's own)."""
    train = study.numbered("train")
    if not train:
        raise InputError("There is no train run to fit", "runs", 'give at least one run role = "train"')
    best = approach(study, study.values() if values is None else values, free, train, progress)
    progress("fitting whole runs")
    optimum = study.fit(best.values, free, train, best.start, threshold=threshold)
    if not optimum.misfit < LACKING and free:
        optimum = least(optimum, shot(study, free, train, threshold, progress))
    if not optimum.converged and optimum.misfit < LACKING:
        progress("fitting whole runs more accurately")
        study = study.sharper()
        optimum = study.fit(optimum.values, free, train, optimum.start, threshold=threshold)
    return described(study, require_sound(study, optimum, train))


def least(*optima: Optimum) -> Optimum:
    """The one of least misfit; one that is not finite only where none is."""
    return min(optima, key=lambda one: one.misfit if np.isfinite(one.misfit) else np.inf)


def shot(study: Study, free: Sequence[str], runs: Sequence[int], threshold: float, progress) -> Optimum:
    """The fit that short windows lead to, each with a start of its own: whole runs of a model that lacks something say
    little about its parameters.
    """
    progress("fitting windows")
    pieces = [study.runs[k] for k in runs]
    windows = Windows.of(study.model, pieces, study.noise, study.names, study.width, LENGTH)
    settled = windows.settle(study.values(), free)
    progress("fitting whole runs")
    return study.fit(settled.values, free, runs, threshold=threshold)


def approach(
    study: Study,
    values: Mapping[str, float],
    free: Sequence[str],
    runs: Sequence[int],
    progress: Callable[[str], None] = lambda _: None,
) -> Optimum:
    """Find the way to the optimum over the first seconds of the runs, from several starts where the first fails."""

    def first(candidate: Mapping[str, float]) -> Optimum:
        return study.fit(candidate, free, runs, until=HORIZONS[0], enough=2.0, weak_prior=True, most=10)

    progress("first seconds")
    require_sensitive(study, values, free, runs)
    best = first(values)
    if not best.misfit < GOOD_START:
        others = other_starts(study, values, free)
        costs = [_cost(study, other, runs, HORIZONS[0]) for other in others]
        for k in np.argsort(costs)[:2]:
            best = min(best, first(others[k]), key=study.plausibility)
    for until in HORIZONS[1:]:
        progress(f"first {until:g} seconds")
        best = study.fit(best.values, free, runs, best.start, until=until, enough=1.0, weak_prior=True, most=10)
    return best


def other_starts(study: Study, values: Mapping[str, float], free: Sequence[str]) -> list[dict[str, float]]:
    """Starts around `values`: its multiplicative tyre parameters without a typical value, times and over 3 and 9."""
    domains = dict(zip(free, domains_of(study.model, free), strict=True))
    wide = [n for n in free if n.startswith("tyre.") and domains[n].multiplicative and domains[n].typical is None]
    factors = itertools.product((1 / 3, 1.0, 3.0) if len(wide) > 1 else (1 / 9, 1 / 3, 3.0, 9.0), repeat=len(wide))
    return [
        {**values, **{n: values[n] * f for n, f in zip(wide, combination, strict=True)}}
        for combination in factors
        if any(f != 1.0 for f in combination)
    ]


def _cost(study: Study, values: Mapping[str, float], runs: Sequence[int], until: float) -> float:
    residual = study.evaluate(study.at(values, ()), runs, until).residual[list(runs)]
    cost = float((residual**2).sum())
    return cost if np.isfinite(cost) else np.inf


def require_sensitive(study: Study, values: Mapping[str, float], free: Sequence[str], runs: Sequence[int]) -> None:
    """**Raises:** `FitError` where the simulation fails at the start, or a free parameter moves nothing."""
    found = study.evaluate(study.at(values, free), runs, HORIZONS[0])
    for k in runs:
        if not np.isfinite(found.residual[k]).all():
            raise FitError(
                f"The simulation of run `{study.runs[k].name}` fails in its first {HORIZONS[0]:g} s "
                "at the start values: check the board and the start."
            )
    sizes = np.sqrt((found.jacobian[list(runs)][..., : len(free)] ** 2).sum(axis=(0, 1, 2)))
    for name, size in zip(free, sizes, strict=True):
        if not size > 1e-9:
            raise FitError(f"Parameter `{name}` moves nothing in these runs, so it cannot be fitted: leave it fixed.")


def require_sound(study: Study, optimum: Optimum, runs: Sequence[int]) -> Optimum:
    """`optimum`. **Raises:** `FitError` where it is not finite, with the run that fails."""
    for k in runs:
        if not np.isfinite(optimum.linearised.residual[k]).all():
            raise FitError(f"The simulation of run `{study.runs[k].name}` diverges: fix a parameter or the start.")
    return optimum


def judged(study: Study, values: Mapping[str, float], role: str = "heldout") -> Optimum | None:
    """The runs of `role` under fixed `values`, only their starts estimated; None where there are none."""
    runs = study.numbered(role)
    return study.fit(values, (), runs) if runs else None


def described(study: Study, optimum: Optimum) -> Fit:
    """The statistics of `optimum`, and the held-out runs judged by it."""
    estimates = estimated(study, optimum)
    heldout = judged(study, optimum.values)
    covariance = optimum.covariance
    sd = np.sqrt(np.diag(covariance)) if covariance.size else np.zeros(0)
    correlation = covariance / np.outer(sd, sd) if covariance.size else covariance
    combinations = combined(study, optimum, estimates)
    return Fit(
        study,
        optimum,
        estimates,
        correlation,
        combinations,
        run_scores(study, optimum, study.numbered("train")),
        () if heldout is None else run_scores(study, heldout, study.numbered("heldout")),
        heldout,
        tuple(advice(optimum, estimates, combinations)),
    )


def noise_band(samples: int, estimated_parameters: float) -> tuple[float, float]:
    """The misfits between which a model of `estimated_parameters` leaves only noise, for `samples` numbers."""
    dof = max(samples - estimated_parameters, 1.0)
    centre, width = dof / samples, NOISE_SIGMAS * np.sqrt(2 * dof) / samples
    return centre - width, centre + width


def only_noise(optimum: Optimum) -> bool:
    """Whether the misfit is that of noise alone."""
    return bool(optimum.misfit <= noise_band(optimum.samples, len(optimum.loose))[1])


def spread(optimum: Optimum) -> float:
    """The factor on standard errors where the misfit is larger than noise: sqrt(chi^2 / degrees of freedom), >= 1."""
    unknown = len(optimum.loose) + optimum.start.size
    return float(np.sqrt(max(1.0, optimum.misfit * optimum.samples / max(optimum.samples - unknown, 1))))


def estimated(study: Study, optimum: Optimum) -> dict[str, Estimate]:
    """Value, standard error and whether it is determined, for each free parameter."""
    factor = spread(optimum)
    variances = dict(zip(optimum.loose, np.diag(optimum.covariance), strict=True))
    found = {}
    for name, domain in zip(optimum.free, domains_of(study.model, optimum.free), strict=True):
        value = optimum.values[name]
        if name in optimum.held:
            found[name] = Estimate(value, None, domain.unit, False, True)
            continue
        step = float(np.sqrt(variances[name])) * factor
        natural = step * abs(value) if domain.multiplicative else step
        shaped = domain.multiplicative or domain.typical is not None
        determined = bool(np.isfinite(step)) and not (shaped and step > LOOSE)
        found[name] = Estimate(value, natural if np.isfinite(natural) else None, domain.unit, determined)
    return found


def combined(study: Study, optimum: Optimum, estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """BCD, the cornering stiffness [N/rad], and the sums of steps that the runs determine where single ones are not."""
    factor, loose = spread(optimum), list(optimum.loose)
    found = {}
    pacejka = ["tyre.B", "tyre.C", "tyre.D"]
    if all(name in optimum.values for name in pacejka) and any(name in loose for name in pacejka):
        weights = np.array([1.0 if name in pacejka else 0.0 for name in loose])
        relative = float(np.sqrt(weights @ optimum.covariance @ weights)) * factor
        value = float(np.prod([optimum.values[name] for name in pacejka]))
        found["BCD"] = Estimate(value, relative * value, "N/rad", relative < LOOSE)
    open_ = [name for name in loose if not estimates[name].determined]
    if len(open_) > 1:
        rows = [loose.index(name) for name in open_]
        values, vectors = np.linalg.eigh(optimum.covariance[np.ix_(rows, rows)])
        domains = domains_of(study.model, open_)
        for variance, vector in zip(values, vectors.T, strict=True):
            if np.sqrt(variance) * factor < 0.1:
                vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
                terms = [
                    f"{weight:+.2f} {'ln ' if d.multiplicative else ''}{name.rsplit('.', 1)[-1]}"
                    for weight, name, d in zip(vector, open_, domains, strict=True)
                ]
                points = [d.step_to(optimum.values[name]) for name, d in zip(open_, domains, strict=True)]
                found[" ".join(terms)] = Estimate(float(vector @ points), float(np.sqrt(variance)) * factor, "-", True)
    return found


def advice(optimum: Optimum, estimates: Mapping[str, Estimate], combinations: Mapping[str, Estimate]) -> list[str]:
    """What the user should know before believing the numbers."""
    said = []
    loose = [name.rsplit(".", 1)[-1] for name, e in estimates.items() if not e.determined and not e.at_bound]
    if loose:
        text = f"These runs cannot determine {', '.join(loose)} one by one"
        if "BCD" in combinations and combinations["BCD"].determined:
            bcd = combinations["BCD"]
            text += f"; they do determine the cornering stiffness BCD = {bcd.value:.4g} +- {bcd.sd:.2g} N/rad"
        said.append(text + ". Runs that slip past the peak of the tyre force would tell more.")
    for name in optimum.held:
        said.append(f"{name} ended on the bound of its physical domain, {optimum.values[name]:g}.")
    if not optimum.converged:
        said.append("The fit did not converge: its last steps still changed the result.")
    if optimum.misfit > 1.1:
        said.append(
            f"The misfit is {optimum.misfit:.3g} times noise: the model lacks something. "
            "`snakejax compare` shows where it fails, `snakejax explain` what is missing."
        )
    return said


def run_scores(study: Study, optimum: Optimum, runs: Sequence[int]) -> tuple[RunScore, ...]:
    """The score of each of `runs` at `optimum`."""
    weight = np.asarray(study.batch.weight)
    scores = []
    for k in runs:
        r, w = np.asarray(optimum.linearised.residual[k]), weight[k]
        seen = w > 0
        error = np.where(seen, r / np.where(seen, w, 1.0), 0.0)
        frames = max(int(seen[:, 0].sum()), 1)
        channels = {
            name: float((r[:, c] ** 2).sum() / max(seen[:, c].sum(), 1)) for c, name in enumerate(("x", "y", "heading"))
        }
        scores.append(
            RunScore(
                study.runs[k].name,
                study.runs[k].role,
                float((r**2).sum() / max(seen.sum(), 1)),
                channels,
                float(np.sqrt((error[:, :2] ** 2).sum() / frames)),
                float(np.sqrt((error[:, 2] ** 2).sum() / max(seen[:, 2].sum(), 1))),
                int(seen.sum()),
                float(np.asarray(study.batch.times)[k][int(np.argmax((r**2).sum(axis=1)))]),
            )
        )
    return tuple(scores)


def pooled(scores: Sequence[RunScore]) -> Score:
    """Several runs as one, each sample with the same weight."""
    samples = np.array([score.samples for score in scores], float)
    share = samples / samples.sum()
    return Score(
        float(share @ [score.misfit for score in scores]),
        float(np.sqrt(share @ [score.position_m**2 for score in scores])),
        float(np.sqrt(share @ [score.heading_rad**2 for score in scores])),
        int(samples.sum()),
    )


def profile(found: Fit, name: str, quantile: float = 1.959964) -> tuple[float | None, float | None]:
    """The 95% interval of one parameter from its profile: where the best fit of all others is worse by quantile^2.

    An end is None where the misfit does not rise that far before the bound of the domain.
    """
    study, best = found.study, found.optimum
    train, others = study.numbered("train"), [n for n in best.loose if n != name]
    domain = domains_of(study.model, [name])[0]
    scale, best_cost = spread(best) ** 2, best.misfit * best.samples
    step = float(np.sqrt(best.covariance[best.loose.index(name), best.loose.index(name)])) * spread(best)
    step = min(step * abs(best.values[name]) if domain.multiplicative else step, max(abs(best.values[name]), 1.0))

    def excess(value: float, near: Optimum) -> tuple[float, Optimum]:
        moved = study.fit({**near.values, name: value}, others, train, near.start)
        return (moved.misfit * moved.samples - best_cost) / scale - quantile**2, moved

    def end(sign: int) -> float | None:
        inside, near, reach = best.values[name], best, quantile * step
        low = np.nextafter(domain.low, np.inf) if domain.positive else domain.low
        for _ in range(12):
            outside = float(np.clip(best.values[name] + sign * reach, low, domain.high))
            above, moved = excess(outside, near)
            if above > 0:
                break
            if outside in (low, domain.high):
                return None
            inside, near, reach = outside, moved, reach * 1.6
        else:
            return None
        for _ in range(12):
            middle = (inside + outside) / 2
            above, moved = excess(middle, near)
            inside, outside, near = (inside, middle, near) if above > 0 else (middle, outside, moved)
            if abs(outside - inside) < 0.01 * step:
                break
        return (inside + outside) / 2

    return end(-1), end(+1)


def with_values(model: Model, values: Mapping[str, float]) -> Model:
    """`model` with the parameters that `values` names, by any name `chosen` understands."""
    return with_parameters(model, {chosen(model, [name])[0]: value for name, value in values.items()})
