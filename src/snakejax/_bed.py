"""What recorded runs say already: about the tyre, and about every effect that may act beside it."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from ._apart import UNSURE, Pair, both_gaps, strength, without_tyre
from ._bench import LATERAL_SKID
from ._effect import Effect
from ._errors import FitError, InputError, instead_of
from ._fit import Fit
from ._least_squares import domains_of, starts_removed
from ._model import Model
from ._score import ALPHA, POWER
from ._sight import Sight
from ._study import Study
from ._units import parameters, with_parameters
from ._windows import linearised

WHERE = "option --objective"
TYRE_STEP = 0.02
"""The step of a tyre parameter by which its column is taken."""
DETECTED = float(stats.norm.isf(ALPHA / 50) + stats.norm.ppf(POWER))
"""The strength that the given runs just reveal is so many standard errors."""


class Bed(NamedTuple):
    """What a design starts from: the fitted `model` with all candidates at neutral, the K parameters `names`, of which
    the first `tyre` were fitted, the given information `G` (K, K), and one over the noise.

    `places` maps an effect to the places of its parameters in `names`.
    """

    model: Model
    names: tuple[str, ...]
    tyre: int
    places: dict[str, tuple[int, ...]]
    G: Float[np.ndarray, "K K"]
    weight: Float[np.ndarray, " 3"]
    left_out: dict[str, str]

    def detectable(self, effect: str) -> Float[np.ndarray, " q"]:
        """The strength of each parameter of `effect` that the given runs just reveal; infinite where they do not."""
        places = self.places[effect]
        S = without_tyre(self.G, places, range(self.tyre))
        if not (np.diag(S) > 0).all():
            return np.full(len(places), np.inf)
        sd = np.sqrt(np.diag(np.linalg.pinv(S, hermitian=True)) / len(places))
        reach = [1.0 if d.unit == "-" else d.high for d in domains_of(self.model, [self.names[k] for k in places])]
        return np.minimum(DETECTED * sd, reach)

    def pair(self, first: str, second: str, strengths: Mapping[str, float] | None = None) -> Pair:
        """Two effects at the `strengths` given (by effect), or else at those at which the given runs are right in
        `UNSURE` of the cases, in the proportion in which they reveal them.

        **Raises:** `InputError` for effects that cannot be told apart.
        """
        require_strengths((first, second))
        for name in (first, second):
            if name in self.left_out:
                raise InputError(f"`{name}` cannot act here: {self.left_out[name].rstrip('.')}", WHERE, "take another")
            if name not in self.places:
                raise InputError(f"There is no effect `{name}`", WHERE, instead_of(name, self.places))
            if not self.places[name]:
                raise InputError(f"All parameters of `{name}` are held", WHERE, "leave one of them without a value")
            if unseen := [self.names[k].rsplit(".", 1)[-1] for k in self.places[name] if not self.G[k, k] > 0]:
                what = f"The given runs do not show `{unseen[0]}` of `{name}` at all"
                remedy = f"take another, or hold it at a value with --effect, as in NAME:{unseen[0]}=1"
                raise InputError(what, WHERE, remedy)
            if not np.isfinite(self.detectable(name)).all():
                raise InputError(f"The given runs do not show `{name}` at all", WHERE, "take another")
        if first == second:
            raise InputError(f"`{first}` is to be told from itself", WHERE, "name two effects")
        sizes, known = np.zeros(len(self.names)), dict(strengths or {})
        domains = domains_of(self.model, self.names)
        values = np.array([float(parameters(self.model)[n].value) for n in self.names])
        low = np.array([d.low for d in domains]) - values
        high = np.array([d.high for d in domains]) - values
        for effect in (first, second):
            sizes[list(self.places[effect])] = self.detectable(effect)
        pair = Pair(self.places[first], self.places[second], tuple(range(self.tyre)), sizes, low, high)
        if not known:
            factor = min(strength(self.G, pair, UNSURE), 1e3)
            return pair._replace(sizes=np.clip(factor * sizes, low, high))
        for effect, value in known.items():
            sizes[list(self.places[effect])] = value
        return pair._replace(sizes=np.clip(sizes, low, high))

    def used(self, pair: Pair | None) -> list[int]:
        """The places of the parameters in use: the tyre's, then the effects'."""
        return [*range(self.tyre), *(() if pair is None else (*pair.first, *pair.second))]

    def steps(self, pair: Pair | None) -> Float[np.ndarray, " k"]:
        """The step of each parameter in use by which its column is taken, to the side where its domain goes on.

        For an effect it is ten times what the given runs just reveal: clear of the rounding of a simulation.
        """
        sizes = np.full(len(self.names), TYRE_STEP)
        for effect, places in self.places.items():
            if pair is not None and set(places) & {*pair.first, *pair.second}:
                sizes[list(places)] = np.minimum(10 * self.detectable(effect), 0.5)
        known, found = parameters(self.model), []
        for k in self.used(pair):
            value, domain = float(known[self.names[k]].value), known[self.names[k]].domain
            found.append(sizes[k] if domain.low <= domain.moved(value, sizes[k]) <= domain.high else -sizes[k])
        return np.array(found)

    def boards(self, pair: Pair | None, model: Model | None = None) -> list[Model]:
        """The board as fitted, and with each parameter in use moved by its step."""
        base = self.model if model is None else model
        known, made = parameters(base), [base]
        for k, step in zip(self.used(pair), self.steps(pair), strict=True):
            value, domain = float(known[self.names[k]].value), known[self.names[k]].domain
            made.append(with_parameters(base, {self.names[k]: domain.moved(value, step)}))
        return made

    def restricted(self, pair: Pair | None) -> "tuple[np.ndarray, Pair | None]":
        """G of the parameters in use, and `pair` as it counts among them."""
        used = self.used(pair)
        if pair is None:
            return self.G[np.ix_(used, used)], None
        first = tuple(range(self.tyre, self.tyre + len(pair.first)))
        second = tuple(range(self.tyre + len(pair.first), len(used)))
        parts = (pair.sizes[used], pair.low[used], pair.high[used])
        return self.G[np.ix_(used, used)], Pair(first, second, tuple(range(self.tyre)), *parts)


def require_strengths(effects: Collection[str]) -> None:
    """**Raises:** `InputError` where one of `effects` has no strength that could be small."""
    if LATERAL_SKID in effects:
        what = f"`{LATERAL_SKID}` is a change of structure, with no strength that could be small, as a design needs it"
        raise InputError(what, WHERE, "let `snakejax explain` decide it by a refit, and name two other effects")


def bed(found: Fit, library: Mapping[str, Effect], held: Collection[str] = ()) -> Bed:
    """What the train runs of a fit say about its tyre and about every effect of `library` that can act.

    The parameters `held`, by their full names, keep the values that the effects have.
    """
    model, places, left_out = found.model, {}, {}
    names = [name for name in found.optimum.loose if not name.startswith("effects.")]
    names += [name for name in found.optimum.loose if name.startswith("effects.")]
    tyre = len(names)
    for name, effect in library.items():
        if name in model.effects:
            left_out[name] = "the model has it already."
        elif why := effect.refusal(model):
            left_out[name] = why
        else:
            model = model.add(**{name: effect})
            own = [full for part in parameters(effect) if (full := f"effects.{name}.{part}") not in held]
            places[name] = tuple(range(len(names), len(names) + len(own)))
            names += own
    study = Study.of(model, found.study.runs, found.study.noise, names, max(len(names), 1))
    train, values, start = study.numbered("train"), study.values(), found.optimum.start
    seen = Sight(study, tuple(train), values, start, linearised(study, values, start, train))
    probes = {f"effects.{name}.{part}": value for name in places for part, value in library[name].probe.items()}
    probes = {name: probe for name, probe in probes.items() if name not in held}
    seen = seen.probed(probes) if probes else seen
    free_start = np.asarray(study.batch.free_start)
    G = np.zeros((len(names), len(names)))
    for k in train:
        J = starts_removed(seen.found, k, len(names), free_start)[1]
        if not np.isfinite(J).all():
            raise FitError(f"The sensitivities of run `{study.runs[k].name}` cannot be computed")
        G += J.T @ J
    return Bed(model, tuple(names), tyre, places, G, np.asarray(1 / study.noise.channels), left_out)


def most_confusable(given: Bed) -> tuple[str, str]:
    """The two effects that the given runs tell apart least, each at the strength that they just reveal."""
    effects = [name for name in given.places if np.isfinite(given.detectable(name)).all()]
    sizes = np.zeros(len(given.names))
    for name in effects:
        sizes[list(given.places[name])] = given.detectable(name)
    found = []
    for i, one in enumerate(effects):
        for other in effects[i + 1 :]:
            places = (given.places[one], given.places[other])
            pair = Pair(*places, tuple(range(given.tyre)), sizes, -sizes, sizes)
            found.append((float(min(both_gaps(given.G, pair))), one, other))
    if not found:
        raise FitError("There are no two effects that these runs show")
    _, one, other = min(found)
    return one, other
