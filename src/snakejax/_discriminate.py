"""Which run to do next: the gait that best tells two effects apart, or says most about the tyre."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import stats

from ._apart import (
    SURE,
    UNSURE,
    Pair,
    both_gaps,
    certainty,
    information,
    loss,
    repeats,
    strength,
    without_tyre,
)
from ._effect import Effect
from ._errors import InputError, instead_of
from ._fit import Fit, FitError
from ._gait import Gait
from ._least_squares import domains_of, starts_removed
from ._limits import Limits, told
from ._model import Model
from ._objective import Objective, Ran
from ._ran import Driver
from ._recording import Run
from ._score import ALPHA, POWER
from ._shapes import scaled
from ._sight import Sight
from ._study import Study
from ._tune import Tuned, accurate, tune
from ._units import Scalar, parameters, with_parameters
from ._windows import linearised

RATE = 20.0
"""Samples a second at which a design looks; their weight stands for all frames."""
TYRE_STEP = 0.02
"""The step of a tyre parameter by which its column is taken."""
DETECTED = float(stats.norm.isf(ALPHA / 50) + stats.norm.ppf(POWER))
"""The strength that the given runs just reveal is so many standard errors."""
PAYLOAD = 0.15
"""The payload of the advice, as a share of the board's mass; it sits on the rotor, half as far out as the wheelsets."""
STARTS, MOST = 4, 25


class Bed(NamedTuple):
    """What a design starts from: the fitted `model` with all candidates at neutral, the K parameters `names`, of which
    the first `tyre` were fitted, the given information `G` (K, K) and that of each given run, and the noise.

    `places` maps an effect to the places of its parameters in `names`.
    """

    model: Model
    names: tuple[str, ...]
    tyre: int
    places: dict[str, tuple[int, ...]]
    G: Float[np.ndarray, "K K"]
    each: dict[str, Float[np.ndarray, "K K"]]
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
        where = "option --objective"
        for name in (first, second):
            if name in self.left_out:
                raise InputError(f"`{name}` cannot act here: {self.left_out[name].rstrip('.')}", where, "take another")
            if name not in self.places:
                raise InputError(f"There is no effect `{name}`", where, instead_of(name, self.places))
            if not np.isfinite(self.detectable(name)).all():
                raise InputError(f"The given runs do not show `{name}` at all", where, "take another")
        if first == second:
            raise InputError(f"`{first}` is to be told from itself", where, "name two effects")
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
            there = value * np.exp(sizes[k]) if domain.multiplicative else value + sizes[k]
            found.append(sizes[k] if domain.low <= there <= domain.high else -sizes[k])
        return np.array(found)

    def boards(self, pair: Pair | None, model: Model | None = None) -> list[Model]:
        """The board as fitted, and with each parameter in use moved by its step."""
        base = self.model if model is None else model
        known, made = parameters(base), [base]
        for k, step in zip(self.used(pair), self.steps(pair), strict=True):
            value, domain = float(known[self.names[k]].value), known[self.names[k]].domain
            there = value * np.exp(step) if domain.multiplicative else value + step
            made.append(with_parameters(base, {self.names[k]: there}))
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


class _Design(Objective):
    """The information of a run beside that of the given ones."""

    G: Float[Array, "K K"]
    steps: Float[Array, " K"]
    weight: Float[Array, " 3"]
    pair: Pair | None

    def times(self, seconds: float) -> Float[np.ndarray, " n"]:
        return np.linspace(0.0, seconds, int(np.ceil(seconds * RATE)) + 1)

    def cost(self, ran: Ran) -> Scalar:
        raise NotImplementedError("A design compares the runs of several boards.")

    def together(self, runs: Ran) -> tuple[Scalar, Float[Array, " 0"]]:
        G = self.G + information(runs.pose, self.steps, self.weight)
        if self.pair is None:
            return -jnp.linalg.slogdet(G)[1], jnp.zeros(0)
        return loss(G, self.pair), jnp.zeros(0)

    def result(self, ran: Ran) -> None:
        return None


class Advice(NamedTuple):
    """One thing to do, and how sure the answer would then be."""

    do: str
    run: str
    certainty: float


class Separation(NamedTuple):
    """The run that tells two effects apart.

    `effects`, and the `strengths` (by parameter) at which they are told apart; `before` and `after`, the probability of
    the right answer from the given runs and with one designed run more; `sure_from`, the strengths from which on the
    given runs, and those with the designed one, are right in 95 %; `repeats`, how many designed runs make it 95 % at
    `strengths`; `gaps`, by how much chi^2 then tells them apart, with either effect acting; `advice`, what else one
    could do.
    """

    tuned: Tuned
    effects: tuple[str, str]
    strengths: dict[str, float]
    before: float
    after: float
    sure_from: tuple[dict[str, float], dict[str, float]]
    repeats: int | None
    gaps: tuple[float, float]
    advice: list[Advice]


class Sharpening(NamedTuple):
    """The run that says most about the tyre: standard errors of the steps of its parameters (relative, where they are
    positive), from the given runs, and with it.
    """

    tuned: Tuned
    before: dict[str, float]
    after: dict[str, float]


def bed(found: Fit, library: Mapping[str, Effect]) -> Bed:
    """What the train runs of a fit say about its tyre and about every effect of `library` that can act."""
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
            own = [f"effects.{name}.{part}" for part in parameters(effect)]
            places[name] = tuple(range(len(names), len(names) + len(own)))
            names += own
    study = Study.of(model, found.study.runs, found.study.noise, names, max(len(names), 1))
    train, values, start = study.numbered("train"), study.values(), found.optimum.start
    seen = Sight(study, tuple(train), values, start, linearised(study, values, start, train))
    probes = {f"effects.{name}.{part}": value for name in places for part, value in library[name].probe.items()}
    seen = seen.probed(probes) if probes else seen
    free_start = np.asarray(study.batch.free_start)
    each = {}
    for k in train:
        J = starts_removed(seen.found, k, len(names), free_start)[1]
        if not np.isfinite(J).all():
            raise FitError(f"The sensitivities of run `{study.runs[k].name}` cannot be computed")
        each[study.runs[k].name] = J.T @ J
    return Bed(
        model,
        tuple(names),
        tyre,
        places,
        np.sum([*each.values()], axis=0),
        each,
        np.asarray(1 / study.noise.channels),
        left_out,
    )


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


def separate(
    given: Bed,
    effects: tuple[str, str],
    limits: Limits,
    seconds: float,
    runs: Sequence[Run],
    /,
    *,
    strengths: Mapping[str, float] | None = None,
    rate: float = 100.0,
    **how: Any,
) -> Separation:
    """The run within `limits`, of `seconds` [s], that best tells two `effects` apart beside the given ones.

    It makes the least rise of chi^2 large with which either effect, at its strength, is taken for the other, when the
    tyre, the start pose and the strength of the other are fitted too.

    **Arguments:** `given`: from `bed`. `runs`: the given runs, for the advice. `strengths`: by effect (default those at
    which the given runs are right in 70 % of the cases). `rate`: frames a second of the designed run. `how`: as `tune`
    takes it.
    """
    pair = given.pair(*effects, strengths)
    G, local = given.restricted(pair)
    tuned, judged = _designed(given, pair, G, local, limits, seconds, rate, how)
    assert local is not None
    mine = judged(tuned.after.gait, given.boards(pair))

    def at(factor: float) -> dict[str, float]:
        return {given.names[k]: float(factor * pair.sizes[k]) for k in (*pair.first, *pair.second)}

    return Separation(
        tuned,
        effects,
        at(1.0),
        certainty(G, local),
        certainty(G + mine, local),
        (at(strength(G, local, SURE)), at(strength(G + mine, local, SURE))),
        repeats(G, mine, local),
        tuple(float(g) for g in both_gaps(G + mine, local)),  # type: ignore[arg-type]
        sorted(_advised(given, pair, G, local, runs, seconds, judged, how), key=lambda a: -a.certainty),
    )


def sharpen(given: Bed, limits: Limits, seconds: float, /, *, rate: float = 100.0, **how: Any) -> Sharpening:
    """The run within `limits` that says most about the tyre: the largest determinant of its information."""
    if not given.tyre:
        raise FitError("The fit frees nothing that a run could tell more about")
    G, _ = given.restricted(None)
    tuned, judged = _designed(given, None, G, None, limits, seconds, rate, how)

    def errors(G: np.ndarray) -> dict[str, float]:
        sd = np.sqrt(np.diag(np.linalg.pinv(G, hermitian=True)))
        return {name: float(s) for name, s in zip(given.names, sd, strict=False)}

    return Sharpening(tuned, errors(G), errors(G + judged(tuned.after.gait, given.boards(None))))


def _designed(given: Bed, pair: Pair | None, G, local, limits: Limits, seconds: float, rate: float, how):
    """The gait, and a function that says how much a gait tells on given boards."""
    steps = given.steps(pair)
    # Fewer samples are looked at than are recorded: each stands for several.
    weight = given.weight * np.sqrt(rate / RATE)
    design = _Design(jnp.asarray(G), jnp.asarray(steps), jnp.asarray(weight), local)
    boards = given.boards(pair)
    how = {"starts": STARTS, "most": MOST, **how}
    tuned = tune([boards[0], *boards], design, limits, seconds, **how)

    def judged(gait: Gait, boards: Sequence[Model], start: Sequence[float] | None = None) -> np.ndarray:
        start = how.get("start", (0.0, 0.0, 0.0)) if start is None else start
        poses = jnp.stack([accurate(board, gait, seconds, start).pose for board in boards])
        each = np.linspace(0, poses.shape[1] - 1, len(design.times(seconds))).round().astype(int)
        return np.asarray(information(poses[:, each], design.steps, design.weight))

    return tuned, judged


def _advised(given: Bed, pair: Pair, G, local: Pair, runs: Sequence[Run], seconds: float, judged, how) -> list[Advice]:
    """What one could do without a new gait, the best run of each kind."""
    boards, loaded = given.boards(pair), given.boards(pair, _loaded(given.model))
    driver, start = how.get("driver") or Driver(), np.asarray(how.get("start", (0.0, 0.0, 0.0)), float)
    train = [run for run in runs if run.role == "train" and not run.moving and run.gait.phi_back is None]
    tell: dict[str, Callable[[Run], np.ndarray]] = {
        "repeat a run": lambda run: judged(run.gait, boards),
        "reverse the rotor": lambda run: judged(_reversed(run.gait, driver), boards),
        "turn the board by 90 degrees": lambda run: judged(run.gait, boards, start + np.array([0, 0, np.pi / 2])),
        "turn the board by 180 degrees": lambda run: judged(run.gait, boards, start + np.array([0, 0, np.pi])),
        f"add a payload of {PAYLOAD * float(given.model.board.mass):.2g} kg": lambda run: judged(run.gait, loaded),
    }
    found = []
    for do, more in tell.items():
        each = [Advice(do, run.name, certainty(G + more(run), local)) for run in _unlike(train)]
        found += sorted(each, key=lambda a: -a.certainty)[:1]
    return found


def _unlike(runs: Sequence[Run]) -> list[Run]:
    """One run of each gait."""
    found: dict[str, Run] = {}
    for run in runs:
        found.setdefault(eqx.tree_pformat(run.gait, short_arrays=False), run)
    return list(found.values())


def _reversed(gait: Gait, driver: Driver) -> Gait:
    return driver.driven(Gait(told(gait.phi), scaled(told(gait.psi), -1.0)))


def _loaded(model: Model) -> Model:
    board = model.board
    mass = PAYLOAD * board.mass
    return eqx.tree_at(lambda m: m.board, model, board.loaded(mass, mass * (board.half_length / 2) ** 2))
