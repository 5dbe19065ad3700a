"""Prior information of a design: Fisher information of the recorded runs on the tyre and on every candidate effect."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import FitError, InputError, instead_of
from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Effect
from snakejax.estimation.block_linearisation import linearise_runs
from snakejax.estimation.fit_record import Fit
from snakejax.estimation.linearisation import domains_of, project_out_starts
from snakejax.estimation.problem import Problem
from snakejax.estimation.sensitivity import DETECTABLE_SD, Sensitivities

from .discrimination import UNSURE, EffectPair, marginal_information, noncentralities, scale_for_probability

WHERE = "option --objective"
TYRE_STEP = 0.02
"""Step of the finite difference for a fitted parameter (relative, where it is multiplicative)."""


class PriorInformation(NamedTuple):
    """Fisher information of the given runs, and the model at which it is taken.

    `model`: the fitted model with all candidates at neutral value; `names`: the K parameters, of which the first `tyre`
    were fitted; `places`: indices in `names` of the parameters of each effect; `G` (K, K): information; `weight` (3,):
    1 / standard deviation of the noise of x, y [m] and heading [rad]; `left_out`: excluded effects with the reason.
    """

    model: Model
    names: tuple[str, ...]
    tyre: int
    places: dict[str, tuple[int, ...]]
    G: Float[np.ndarray, "K K"]
    weight: Float[np.ndarray, " 3"]
    left_out: dict[str, str]

    def detectable(self, effect: str) -> Float[np.ndarray, " q"]:
        """The minimum detectable value (q,) of each parameter of `effect` in the given runs; infinite if there is none.

        It is `DETECTABLE_SD` standard errors over sqrt(q), at most the upper end of the domain.
        """
        places = self.places[effect]
        S = marginal_information(self.G, places, range(self.tyre))
        if not (np.diag(S) > 0).all():
            return np.full(len(places), np.inf)
        sd = np.sqrt(np.diag(np.linalg.pinv(S, hermitian=True)) / len(places))
        reach = [1.0 if d.unit == "-" else d.high for d in domains_of(self.model, [self.names[k] for k in places])]
        return np.minimum(DETECTABLE_SD * sd, reach)

    def pair(self, first: str, second: str, strengths: Mapping[str, float] | None = None) -> EffectPair:
        """Two effects with the `strengths` at which a design is to distinguish them.

        By default the strengths are proportional to the minimum detectable ones, with the factor at which the given
        runs select the right effect with probability `UNSURE`.

        **Raises:** `InputError` for effects that cannot be distinguished or do not show in the given runs.
        """
        require_strengths((first, second))
        for name in (first, second):
            if name in self.left_out:
                raise InputError(f"`{name}` cannot act here: {self.left_out[name].rstrip('.')}", WHERE, "take another")
            if name not in self.places:
                raise InputError(f"There is no effect `{name}`", WHERE, instead_of(name, self.places))
            if not self.places[name]:
                raise InputError(f"All parameters of `{name}` are held", WHERE, "leave one of them without a value")
            if insensitive := [self.names[k].rsplit(".", 1)[-1] for k in self.places[name] if not self.G[k, k] > 0]:
                what = f"The given runs do not show `{insensitive[0]}` of `{name}` at all"
                remedy = f"take another, or hold it at a value with --effect, as in NAME:{insensitive[0]}=1"
                raise InputError(what, WHERE, remedy)
            if not np.isfinite(self.detectable(name)).all():
                raise InputError(f"The given runs do not show `{name}` at all", WHERE, "take another")
        if first == second:
            raise InputError(f"`{first}` cannot be distinguished from itself", WHERE, "name two effects")
        sizes, given_strengths = np.zeros(len(self.names)), dict(strengths or {})
        domains = domains_of(self.model, self.names)
        values = np.array([float(parameters(self.model)[n].value) for n in self.names])
        low = np.array([d.low for d in domains]) - values
        high = np.array([d.high for d in domains]) - values
        for effect in (first, second):
            sizes[list(self.places[effect])] = self.detectable(effect)
        pair = EffectPair(self.places[first], self.places[second], tuple(range(self.tyre)), sizes, low, high)
        if not given_strengths:
            factor = min(scale_for_probability(self.G, pair, UNSURE), 1e3)
            return pair._replace(sizes=np.clip(factor * sizes, low, high))
        for effect, value in given_strengths.items():
            sizes[list(self.places[effect])] = value
        return pair._replace(sizes=np.clip(sizes, low, high))

    def used(self, pair: EffectPair | None) -> list[int]:
        """Indices of the parameters in use: those of the tyre, then those of the effects of `pair`."""
        return [*range(self.tyre), *(() if pair is None else (*pair.first, *pair.second))]

    def steps(self, pair: EffectPair | None) -> Float[np.ndarray, " k"]:
        """The step (k,) of the finite difference for each parameter in use, towards the inside of its domain.

        For an effect it is ten times the minimum detectable value (at most 0.5), far above the error of a simulation.
        """
        sizes = np.full(len(self.names), TYRE_STEP)
        for effect, places in self.places.items():
            if pair is not None and set(places) & {*pair.first, *pair.second}:
                sizes[list(places)] = np.minimum(10 * self.detectable(effect), 0.5)
        known, steps = parameters(self.model), []
        for k in self.used(pair):
            value, domain = float(known[self.names[k]].value), known[self.names[k]].domain
            steps.append(sizes[k] if domain.low <= domain.moved(value, sizes[k]) <= domain.high else -sizes[k])
        return np.array(steps)

    def boards(self, pair: EffectPair | None, model: Model | None = None) -> list[Model]:
        """The fitted model, followed by models with one parameter in use moved by its step."""
        base = self.model if model is None else model
        known, models = parameters(base), [base]
        for k, step in zip(self.used(pair), self.steps(pair), strict=True):
            value, domain = float(known[self.names[k]].value), known[self.names[k]].domain
            models.append(with_parameters(base, {self.names[k]: domain.moved(value, step)}))
        return models

    def restricted(self, pair: EffectPair | None) -> "tuple[np.ndarray, EffectPair | None]":
        """The information (k, k) of the parameters in use, and `pair` with indices among them."""
        used = self.used(pair)
        if pair is None:
            return self.G[np.ix_(used, used)], None
        first = tuple(range(self.tyre, self.tyre + len(pair.first)))
        second = tuple(range(self.tyre + len(pair.first), len(used)))
        parts = (pair.sizes[used], pair.low[used], pair.high[used])
        return self.G[np.ix_(used, used)], EffectPair(first, second, tuple(range(self.tyre)), *parts)


def require_strengths(effects: Collection[str]) -> None:
    """Check that every effect has a continuous strength.

    **Raises:** `InputError` if one of `effects` is the switch to slipping wheels, which has none.
    """
    if LATERAL_SLIP_SWITCH in effects:
        what = f"`{LATERAL_SLIP_SWITCH}` is a change of structure: it has no strength that a design could vary"
        raise InputError(what, WHERE, "let `snakejax explain` decide it by a refit, and name two other effects")


def prior_information(fit: Fit, library: Mapping[str, Effect], held: Collection[str] = ()) -> PriorInformation:
    """Fisher information of the train runs of a fit on its parameters and on every applicable effect of `library`.

    The parameters `held`, by their full names, keep the values that the effects have.
    **Raises:** `FitError` if the sensitivities of a run are not finite.
    """
    model, places, left_out = fit.model, {}, {}
    names = [name for name in fit.fitted.loose if not name.startswith("effects.")]
    names += [name for name in fit.fitted.loose if name.startswith("effects.")]
    tyre = len(names)
    for name, effect in library.items():
        if name in model.effects:
            left_out[name] = "the model has it already."
        elif why := effect.inapplicable_because(model):
            left_out[name] = why
        else:
            model = model.add(**{name: effect})
            parameter_names = [full for part in parameters(effect) if (full := f"effects.{name}.{part}") not in held]
            places[name] = tuple(range(len(names), len(names) + len(parameter_names)))
            names += parameter_names
    problem = Problem.of(model, fit.recordings, fit.fitted.noise, names, max(len(names), 1))
    train, values, start = problem.run_indices("train"), problem.values(), fit.fitted.starts
    sensitivities = Sensitivities(problem, tuple(train), values, start, linearise_runs(problem, values, start, train))
    probes = {f"effects.{name}.{part}": value for name in places for part, value in library[name].secant_step.items()}
    probes = {name: secant_step for name, secant_step in probes.items() if name not in held}
    sensitivities = sensitivities.probed(probes) if probes else sensitivities
    free_start = np.asarray(problem.batch.free_start)
    G = np.zeros((len(names), len(names)))
    for k in train:
        J = project_out_starts(sensitivities.linearised, k, len(names), free_start)[1]
        if not np.isfinite(J).all():
            raise FitError(f"The sensitivities of run `{problem.runs[k].name}` cannot be computed")
        G += J.T @ J
    return PriorInformation(model, tuple(names), tyre, places, G, np.asarray(1 / problem.noise.channels), left_out)


def most_confusable(given: PriorInformation) -> tuple[str, str]:
    """The two effects of least noncentrality in the given runs, each at its minimum detectable strength.

    **Raises:** `FitError` if fewer than two effects show in the runs.
    """
    effects = [name for name in given.places if np.isfinite(given.detectable(name)).all()]
    sizes = np.zeros(len(given.names))
    for name in effects:
        sizes[list(given.places[name])] = given.detectable(name)
    pairs = []
    for i, one in enumerate(effects):
        for other in effects[i + 1 :]:
            places = (given.places[one], given.places[other])
            pair = EffectPair(*places, tuple(range(given.tyre)), sizes, -sizes, sizes)
            pairs.append((float(min(noncentralities(given.G, pair))), one, other))
    if not pairs:
        raise FitError("There are no two effects that these runs show")
    _, one, other = min(pairs)
    return one, other
