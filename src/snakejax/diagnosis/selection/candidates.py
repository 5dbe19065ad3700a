"""What a diagnosis has at hand: the model with every candidate, compiled once, and the criteria of the selection."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from snakejax.core.parameter import parameters
from snakejax.dynamics.model import Model
from snakejax.dynamics.ports import Delay, Effect
from snakejax.estimation.discrepancy.priors import with_own_inertia
from snakejax.estimation.initial_model import default_free, starting_model
from snakejax.estimation.joint_logs.clocks import free_clocks
from snakejax.estimation.multiple_shooting import LENGTH, Windows, WindowSolution
from snakejax.estimation.problem import Problem, Solution
from snakejax.recording.run import Case, Noise

from .criteria import CRITERIA, SelectionCriteria

WIDTH = 13
"""How many parameters one compiled fit can free: a tyre and several effects."""
ROOM = 9
"""At least so many of them are for effects."""


class BaseFit(NamedTuple):
    """How the base is fitted: the names of the parameters `held`, and the `threshold` of Huber's loss [standard
    deviations]."""

    held: frozenset[str] = frozenset()
    threshold: float = np.inf


EVERYTHING_FREE = BaseFit()


class CandidateSet(eqx.Module):
    """Everything one diagnosis needs at hand: the model with every candidate at its neutral value, compiled once.

    `tyre` are the names the base fit frees; `candidates` maps an effect to its parameter names; `left_out` says why a
    candidate does not apply; `criteria` are those of every decision on it.
    """

    problem: Problem
    windows: Windows
    tyre: tuple[str, ...] = eqx.field(static=True)
    candidates: OrderedDict[str, tuple[str, ...]] = eqx.field(static=True)
    left_out: dict[str, str] = eqx.field(static=True)
    switched: bool = eqx.field(static=True, default=False)
    criteria: SelectionCriteria = eqx.field(static=True, default=CRITERIA)

    @staticmethod
    def of(
        model: Model,
        case: Case,
        noise: Noise,
        library: Mapping[str, Effect],
        switched: bool = False,
        criteria: SelectionCriteria = CRITERIA,
        how: BaseFit = EVERYTHING_FREE,
    ) -> "CandidateSet":
        """`model` with every effect of `library` that can act on it, over the runs of `case`.

        `switched` says that its structure is not the one the case names; `how` its base is fitted.
        """
        # So that one program serves the inertia of the case and any other.
        full, left_out, candidates = with_own_inertia(model), {}, OrderedDict()
        for name, effect in library.items():
            if name in model.effects:
                full_effect = model.effects[name]
            elif why := effect.inapplicable_because(model) or _told_by_logs(effect, case):
                left_out[name] = why
                continue
            else:
                full_effect = effect
                full = full.add(**{name: effect})
            parts = (f"effects.{name}.{part}" for part in parameters(full_effect))
            candidates[name] = tuple(part for part in parts if part not in how.held)
        tyre = tuple(n for n in default_free(model) if not n.startswith("effects.") and n not in how.held)
        names = [*tyre, *(part for parts in candidates.values() for part in parts)]
        # As many as a selection may add, and one that it tries beside them.
        sizes = sorted((len(parts) for parts in candidates.values()), reverse=True)[: criteria.most_effects + 1]
        width = max(WIDTH, len(tyre) + max(ROOM, sum(sizes)))
        problem = Problem.of(full, case.runs, noise, names, width, threshold=how.threshold)
        windows = Windows.of(full, case.having("train"), noise, names, width, LENGTH)
        return CandidateSet(problem, windows, tyre, candidates, left_out, switched, criteria)

    @property
    def train(self) -> list[int]:
        """The numbers of the train runs."""
        return self.problem.run_indices("train")

    def free(self, effects: Sequence[str]) -> list[str]:
        """The parameters free in a model with `effects`."""
        return [*self.tyre, *(part for effect in effects for part in self.candidates[effect])]

    def probes(self) -> dict[str, float]:
        """The parameters whose derivative at the neutral value does not exist, with the value to score them from."""
        probes = {}
        for name, parts in self.candidates.items():
            secant_step = self.problem.model.effects[name].secant_step
            probes |= {
                part: secant_step[part.rsplit(".", 1)[-1]] for part in parts if part.rsplit(".", 1)[-1] in secant_step
            }
        return probes

    def off_zero(self, name: str, value: float) -> float:
        """A parameter without a derivative at zero must start beside it."""
        return self.probes().get(name, value) if value == 0.0 else value


def _told_by_logs(effect: Effect, case: Case) -> str | None:
    if isinstance(effect, Delay) and any("offset" in free_clocks(run) for run in case.runs):
        return "the clocks of the joint logs are estimated, run by run"
    return None


class CandidateFit(NamedTuple):
    """The state of an explanation: which effects are in, the fit with them to whole runs, and the fit to windows that
    it began from, where it did."""

    effects: tuple[str, ...]
    solution: Solution
    windows: WindowSolution | None = None


def structures(case: Case, kind: str, constraint: str | None, start: Model | None = None) -> list[Model]:
    """The models a diagnosis of `case` considers: the base, which is `start` where it is given, and, where it
    constrains the wheels, the one in which each slips by itself."""
    model = starting_model(case, kind, constraint) if start is None else start
    return [model, *(Model(model.board, model.tyre, name, model.effects) for name in model.relaxed())]
