"""Which run to do next: the gait that best tells two effects apart, or says most about the tyre."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._apart import (
    SURE,
    Pair,
    both_gaps,
    certainty,
    information,
    loss,
    repeats,
    strength,
)
from ._bed import Bed
from ._errors import FitError
from ._gait import Gait
from ._limits import Limits, told
from ._model import Model
from ._objective import Objective, Ran
from ._ran import Driver
from ._recording import Run
from ._shapes import scaled
from ._tune import Tuned, accurate, tune
from ._units import Scalar

RATE = 20.0
"""Samples a second at which a design looks; their weight stands for all frames."""
PAYLOAD = 0.15
"""The payload of the advice, as a share of the board's mass; it sits on the rotor, half as far out as the wheelsets."""
STARTS, MOST = 4, 25


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
    the right answer from the given runs and with one designed run more, and `known`, with one run more of the best gait
    that is known; `sure_from`, the strengths from which on the
    given runs, and those with the designed one, are right in 95 %; `repeats`, how many designed runs make it 95 % at
    `strengths`; `gaps`, by how much chi^2 then tells them apart, with either effect acting; `advice`, what else one
    could do.
    """

    tuned: Tuned
    effects: tuple[str, str]
    strengths: dict[str, float]
    before: float
    known: float | None
    after: float
    sure_from: tuple[dict[str, float], dict[str, float]]
    repeats: int | None
    gaps: tuple[float, float]
    advice: list[Advice]


class Sharpening(NamedTuple):
    """The run that says most about the tyre: standard errors of the steps of its parameters (relative, where they are
    positive), from the given runs, with it, and `known`, with the best gait that is known instead.
    """

    tuned: Tuned
    before: dict[str, float]
    known: dict[str, float] | None
    after: dict[str, float]

    def shrunk(self, after: Mapping[str, float]) -> float:
        """The geometric mean of what is left of the standard errors where they become `after`."""
        return float(np.exp(np.mean([np.log(after[name] / sd) for name, sd in self.before.items()])))


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
    payload: Sequence[float] = (0.0, 0.0),
    **how: Any,
) -> Separation:
    """The run within `limits`, of `seconds` [s], that best tells two `effects` apart beside the given ones.

    It makes the least rise of chi^2 large with which either effect, at its strength, is taken for the other, when the
    tyre, the start pose and the strength of the other are fitted too.

    **Arguments:** `given`: from `bed`. `runs`: the given runs, for the advice. `strengths`: by effect (default those at
    which the given runs are right in 70 % of the cases). `rate`: frames a second of the designed run. `payload`: the
    extra mass [kg] and yaw inertia [kg m^2] that it carries. `how`: as `tune` takes it.
    """
    pair = given.pair(*effects, strengths)
    G, local = given.restricted(pair)
    carrying = given.model.carrying(payload)
    tuned, judged = _designed(given, carrying, pair, G, local, limits, seconds, rate, how)
    assert local is not None
    boards = given.boards(pair, carrying)
    mine = judged(tuned.after.gait, boards)
    known = tuned.before and certainty(G + judged(tuned.before.gait, boards), local)

    def at(factor: float) -> dict[str, float]:
        return {given.names[k]: float(factor * pair.sizes[k]) for k in (*pair.first, *pair.second)}

    return Separation(
        tuned,
        effects,
        at(1.0),
        certainty(G, local),
        known,
        certainty(G + mine, local),
        (at(strength(G, local, SURE)), at(strength(G + mine, local, SURE))),
        repeats(G, mine, local),
        tuple(float(g) for g in both_gaps(G + mine, local)),  # type: ignore[arg-type]
        sorted(_advised(given, pair, G, local, runs, seconds, judged, how), key=lambda a: -a.certainty),
    )


def sharpen(
    given: Bed,
    limits: Limits,
    seconds: float,
    /,
    *,
    rate: float = 100.0,
    payload: Sequence[float] = (0.0, 0.0),
    **how: Any,
) -> Sharpening:
    """The run within `limits` that says most about the tyre: the largest determinant of its information.

    Arguments as `separate` takes them.
    """
    if not given.tyre:
        raise FitError("The fit frees nothing that a run could tell more about")
    G, _ = given.restricted(None)
    carrying = given.model.carrying(payload)
    tuned, judged = _designed(given, carrying, None, G, None, limits, seconds, rate, how)

    def errors(G: np.ndarray) -> dict[str, float]:
        sd = np.sqrt(np.diag(np.linalg.pinv(G, hermitian=True)))
        return {name: float(s) for name, s in zip(given.names, sd, strict=False)}

    boards = given.boards(None, carrying)
    known = tuned.before and errors(G + judged(tuned.before.gait, boards))
    return Sharpening(tuned, errors(G), known, errors(G + judged(tuned.after.gait, boards)))


def _designed(given: Bed, model: Model, pair: Pair | None, G, local, limits: Limits, seconds: float, rate: float, how):
    """The gait for `model`, and a function that says how much a gait tells on given boards."""
    steps = given.steps(pair)
    # Fewer samples are looked at than are recorded: each stands for several.
    weight = given.weight * np.sqrt(rate / RATE)
    design = _Design(jnp.asarray(G), jnp.asarray(steps), jnp.asarray(weight), local)
    boards = given.boards(pair, model)
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
    board = given.model.board
    extra = PAYLOAD * float(board.mass) * np.array([1.0, (float(board.half_length) / 2) ** 2])
    driver, start = how.get("driver") or Driver(), np.asarray(how.get("start", (0.0, 0.0, 0.0)), float)
    train = [run for run in runs if run.role == "train" and not run.moving and run.gait.phi_back is None]

    def boards(run: Run, more: Any = 0.0) -> list[Model]:
        return given.boards(pair, given.model.carrying(np.asarray(run.payload) + more))

    tell: dict[str, Callable[[Run], np.ndarray]] = {
        "repeat a run": lambda run: judged(run.gait, boards(run)),
        "reverse the rotor": lambda run: judged(_reversed(run.gait, driver), boards(run)),
        "turn the board by 90 degrees": lambda run: judged(run.gait, boards(run), start + np.array([0, 0, np.pi / 2])),
        "turn the board by 180 degrees": lambda run: judged(run.gait, boards(run), start + np.array([0, 0, np.pi])),
        f"add a payload of {extra[0]:.2g} kg": lambda run: judged(run.gait, boards(run, extra)),
    }
    found = []
    for do, more in tell.items():
        each = [Advice(do, run.name, certainty(G + more(run), local)) for run in _unlike(train)]
        found += sorted(each, key=lambda a: -a.certainty)[:1]
    return found


def _unlike(runs: Sequence[Run]) -> list[Run]:
    """One run of each gait and payload."""
    found: dict[str, Run] = {}
    for run in runs:
        found.setdefault(eqx.tree_pformat((run.gait, run.payload), short_arrays=False), run)
    return list(found.values())


def _reversed(gait: Gait, driver: Driver) -> Gait:
    return driver.driven(Gait(told(gait.phi), scaled(told(gait.psi), -1.0)))
