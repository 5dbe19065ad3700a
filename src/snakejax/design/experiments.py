"""Experiment design: the run that best distinguishes two effects, or determines the tyre most precisely.

Discrimination design after Atkinson and Fedorov (1975); precision design maximises the determinant of the information
(D-optimality).
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Unpack, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snakejax.core.errors import FitError
from snakejax.core.parameter import Scalar
from snakejax.core.tabular import Tabular, listed
from snakejax.dynamics.inputs import Gait, as_gait
from snakejax.dynamics.model import Model
from snakejax.recording.run import Run

from .discrimination import (
    SURE,
    EffectPair,
    correct_selection_probability,
    criterion,
    information,
    noncentralities,
    repeats_needed,
    scale_for_probability,
)
from .fisher_information import PriorInformation
from .gait_families import scaled
from .limits import Limits, limits_of
from .objectives import Objective, Rollout
from .rollouts import Controller
from .tuning import TuningOptions, TuningResult, accurate, tune

RATE = 20.0
"""Samples per second of the simulated runs of a design; their weights are scaled to the frame rate of the cameras."""
PAYLOAD = 0.15
"""Payload of the advice as a fraction of the mass of the board, halfway between its centre and the wheelsets."""
STARTS, MOST = 4, 25
"""Number of starts, and of iterations of each: fewer than in `tune`, because every parameter step is simulated."""


class _Design(Objective):
    """The criterion of a design: information of a run added to that of the given runs, `G` (K, K)."""

    G: Float[Array, "K K"]
    steps: Float[Array, " K"]
    weight: Float[Array, " 3"]
    pair: EffectPair | None

    def times(self, seconds: float) -> Float[np.ndarray, " n"]:
        return np.linspace(0.0, seconds, int(np.ceil(seconds * RATE)) + 1)

    def cost(self, rollout: Rollout) -> Scalar:
        raise NotImplementedError("A design compares the runs of several boards.")

    def together(self, runs: Rollout) -> tuple[Scalar, Float[Array, " 0"]]:
        G = self.G + information(runs.pose, self.steps, self.weight)
        if self.pair is None:
            return -jnp.linalg.slogdet(G)[1], jnp.zeros(0)
        return criterion(G, self.pair), jnp.zeros(0)

    def result(self, rollout: Rollout) -> None:
        return None


class Advice(NamedTuple):
    """One alternative experiment `do`, the `run` it is based on, and the probability of correct selection with it."""

    do: str
    run: str
    certainty: float


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DiscriminationDesign(Tabular):
    """The run that distinguishes two effects.

    `strengths`: values by parameter at which the `effects` are to be distinguished; `before`, `known`, `after`:
    probability of correct selection from the given runs, with one more run of the best known gait, and with one more
    designed run; `sure_from`: strengths at which that probability is 95 %, for the given runs and with the designed
    one; `repeats`: designed runs needed for 95 % at `strengths`, None if more than `MOST_REPEATS`; `gaps`: both
    noncentralities with the designed run; `advice`: alternative experiments.
    """

    tuned: TuningResult
    effects: tuple[str, str]
    strengths: dict[str, float]
    before: float
    known: float | None
    after: float
    sure_from: tuple[dict[str, float], dict[str, float]]
    repeats: int | None
    gaps: tuple[float, float]
    advice: list[Advice]

    def headline(self) -> str:
        """The probability of the right answer before and after the designed run."""
        fall = f"{self.before:.2f} -> {self.after:.2f} by a run of {self.tuned.seconds:g} s"
        return f"{listed(self.effects, 'or')}; probability of the right answer {fall}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each experiment, the designed run first, with the probability of the right answer."""
        rows = [Advice("the designed run", "", self.after), *self.advice]
        return {
            "do": [row.do for row in rows],
            "run": [row.run for row in rows],
            "probability": [row.certainty for row in rows],
        }


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PrecisionDesign(Tabular):
    """The run that determines the tyre most precisely.

    Standard errors of the steps of its parameters (relative for multiplicative ones): `before`, from the given runs;
    `known`, with the best known gait; `after`, with the designed run.
    """

    tuned: TuningResult
    before: dict[str, float]
    known: dict[str, float] | None
    after: dict[str, float]

    def shrunk(self, after: Mapping[str, float]) -> float:
        """The geometric mean of the ratios of standard errors `after` / `before`."""
        return float(np.exp(np.mean([np.log(after[name] / sd) for name, sd in self.before.items()])))

    def headline(self) -> str:
        """How far the standard errors fall by the designed run."""
        fall = self.shrunk(self.after)
        return f"standard errors times {fall:.2f} (geometric mean) by a run of {self.tuned.seconds:g} s"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each parameter, with its standard error from the given runs and with one more."""
        known = self.known or {}
        return {
            "parameter": list(self.before),
            "sd_before": list(self.before.values()),
            "sd_best_known_gait": [known.get(name) for name in self.before],
            "sd_after": [self.after[name] for name in self.before],
        }


class DesignOptions(TuningOptions, total=False):
    """Options of a design: those of `tune`, and of the designed run `rate` [frames per second] (default 100), and its
    `payload`, extra mass [kg] and yaw inertia [kg m^2] (default none).
    """

    rate: float
    payload: Sequence[float]


def design_discrimination(
    given: PriorInformation,
    effects: tuple[str, str],
    limits: Limits,
    seconds: float,
    runs: Sequence[Run],
    /,
    *,
    strengths: Mapping[str, float] | None = None,
    **options: Unpack[DesignOptions],
) -> DiscriminationDesign:
    """Design the run of `seconds` [s] within `limits` that, added to the given runs, best distinguishes two `effects`.

    It maximises the noncentrality: the rise of chi^2 if one effect acts and the other is fitted, together with tyre and
    start pose (Atkinson and Fedorov 1975).

    **Arguments:** `given`: from `prior_information`. `runs`: the given runs, for the advice. `strengths`: by effect
    (default: those at which the given runs select correctly with probability 70 %). `options`: see `DesignOptions`.
    **Raises:** as `PriorInformation.pair` and `tune`.
    """
    pair = given.pair(*effects, strengths)
    G, restricted_pair = given.restricted(pair)
    assert restricted_pair is not None
    boards = given.boards(pair, given.model.with_payload(options.get("payload", (0.0, 0.0))))
    run = _designed(boards, _criterion(given, pair, options.get("rate", 100.0)), limits, seconds, options)
    tuned = run.tuned
    designed = run.information(tuned.after.gait, boards)
    known = tuned.before and correct_selection_probability(
        G + run.information(tuned.before.gait, boards), restricted_pair
    )
    advice = _advised(given, pair, run, runs, options.get("driver") or Controller())

    def strengths_at(factor: float) -> dict[str, float]:
        return {given.names[k]: float(factor * pair.sizes[k]) for k in (*pair.first, *pair.second)}

    return DiscriminationDesign(
        tuned,
        effects,
        strengths_at(1.0),
        correct_selection_probability(G, restricted_pair),
        known,
        correct_selection_probability(G + designed, restricted_pair),
        (
            strengths_at(scale_for_probability(G, restricted_pair, SURE)),
            strengths_at(scale_for_probability(G + designed, restricted_pair, SURE)),
        ),
        repeats_needed(G, designed, restricted_pair),
        tuple(float(g) for g in noncentralities(G + designed, restricted_pair)),  # type: ignore[arg-type]
        sorted(advice, key=lambda a: -a.certainty),
    )


def design_precision(
    given: PriorInformation,
    limits: Limits,
    seconds: float,
    /,
    **options: Unpack[DesignOptions],
) -> PrecisionDesign:
    """Design the run within `limits` that maximises the determinant of the information on the tyre (D-optimality).

    **Arguments:** as `design_discrimination`. **Raises:** `FitError` if the fit frees no parameter; as `tune`.
    """
    if not given.tyre:
        raise FitError("The fit frees no parameter that a further run could determine more precisely")
    G, _ = given.restricted(None)
    boards = given.boards(None, given.model.with_payload(options.get("payload", (0.0, 0.0))))
    run = _designed(boards, _criterion(given, None, options.get("rate", 100.0)), limits, seconds, options)
    tuned = run.tuned

    def errors(G: np.ndarray) -> dict[str, float]:
        sd = np.sqrt(np.diag(np.linalg.pinv(G, hermitian=True)))
        return {name: float(s) for name, s in zip(given.names, sd, strict=False)}

    known = tuned.before and errors(G + run.information(tuned.before.gait, boards))
    return PrecisionDesign(tuned, errors(G), known, errors(G + run.information(tuned.after.gait, boards)))


class _DesignedRun(NamedTuple):
    """A designed gait, and what the information of other runs of its duration is computed from."""

    tuned: TuningResult
    design: _Design
    start: Sequence[float]

    def information(
        self, gait: Gait, boards: Sequence[Model], start: Sequence[float] | None = None
    ) -> Float[np.ndarray, "K K"]:
        """The information of a run of `gait` on `boards`: the models of `PriorInformation.boards`."""
        seconds, start = self.tuned.seconds, self.start if start is None else start
        poses = jnp.stack([accurate(board, gait, seconds, start).pose for board in boards])
        frames = np.linspace(0, poses.shape[1] - 1, len(self.design.times(seconds))).round().astype(int)
        return np.asarray(information(poses[:, frames], self.design.steps, self.design.weight))


def _criterion(given: PriorInformation, pair: EffectPair | None, rate: float) -> _Design:
    """The criterion of a run with `rate` frames per second, to distinguish `pair` or to determine the tyre."""
    G, restricted_pair = given.restricted(pair)
    # The design uses fewer samples than are recorded: each stands for rate / RATE of them.
    weight = given.weight * np.sqrt(rate / RATE)
    return _Design(jnp.asarray(G), jnp.asarray(given.steps(pair)), jnp.asarray(weight), restricted_pair)


def _designed(
    boards: Sequence[Model], design: _Design, limits: Limits, seconds: float, options: DesignOptions
) -> _DesignedRun:
    """The designed gait; `boards`: the nominal one first, of those between which the design takes differences."""
    tuning = {name: value for name, value in options.items() if name in TuningOptions.__annotations__}
    how = cast(TuningOptions, {"starts": STARTS, "most": MOST, **tuning})
    tuned = tune([boards[0], *boards], design, limits, seconds, **how)
    return _DesignedRun(tuned, design, options.get("start", (0.0, 0.0, 0.0)))


def _advised(
    given: PriorInformation, pair: EffectPair, designed: _DesignedRun, runs: Sequence[Run], driver: Controller
) -> list[Advice]:
    """Alternative experiments without a new gait: for each kind the run of highest probability."""
    G, restricted_pair = given.restricted(pair)
    assert restricted_pair is not None
    board = given.model.board
    extra = PAYLOAD * float(board.mass) * np.array([1.0, (float(board.length) / 2) ** 2])
    start = np.asarray(designed.start, float)
    train = [run for run in runs if run.role == "train" and not run.moving and as_gait(run.gait).phi_back is None]

    def boards(run: Run, gained: Any = 0.0) -> list[Model]:
        return given.boards(pair, given.model.with_payload(np.asarray(run.payload) + gained))

    def turned(run: Run, angle: float) -> np.ndarray:
        return designed.information(run.gait, boards(run), start + np.array([0, 0, angle]))

    alternatives: dict[str, Callable[[Run], np.ndarray]] = {
        "repeat a run": lambda run: designed.information(run.gait, boards(run)),
        "reverse the rotor": lambda run: designed.information(_reversed(run.gait, driver), boards(run)),
        "turn the board by 90 degrees": lambda run: turned(run, np.pi / 2),
        "turn the board by 180 degrees": lambda run: turned(run, np.pi),
        f"add a payload of {extra[0]:.2g} kg": lambda run: designed.information(run.gait, boards(run, extra)),
    }
    advice = []
    for do, gained in alternatives.items():
        advice_by_run = [
            Advice(do, run.name, correct_selection_probability(G + gained(run), restricted_pair))
            for run in _unlike(train)
        ]
        advice += sorted(advice_by_run, key=lambda a: -a.certainty)[:1]
    return advice


def _unlike(runs: Sequence[Run]) -> list[Run]:
    """One run for each pair of gait and payload."""
    distinct: dict[str, Run] = {}
    for run in runs:
        distinct.setdefault(eqx.tree_pformat((run.gait, run.payload), short_arrays=False), run)
    return list(distinct.values())


def _reversed(gait: Gait, driver: Controller) -> Gait:
    return driver.driven(Gait(limits_of(gait.phi), scaled(limits_of(gait.psi), -1.0)))
