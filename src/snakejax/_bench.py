"""What a diagnosis has at hand: the model with every candidate, compiled once, and how near is near."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx

from ._effect import Clock, Effect
from ._log_clocks import free_clocks
from ._model import Model
from ._recording import Case, Noise
from ._skid import Coupled
from ._starting import default_free, starting_model
from ._study import Optimum, Study
from ._units import parameters
from ._windows import LENGTH, Windows

LATERAL_SKID = "lateral_skid"
WIDTH = 13
"""How many parameters one compiled fit can free: a tyre and several effects."""
NEARLY = 4.0
"""Below this misfit the errors of whole runs are small enough for a linear score, which is sharper than windows."""
HOPELESS = 50.0
"""Above this misfit a model is far from the truth, and polishing its parameters would only make them absurd."""
CLOSE = 2.0
"""Windows that leave less than this misfit have found values from which whole runs can be fitted at once."""
WORKERS = 2


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
            elif why := effect.refusal(model) or _told_by_logs(effect, case):
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

    def off_zero(self, name: str, value: float) -> float:
        """A parameter without a derivative at zero must start beside it."""
        return self.probes().get(name, value) if value == 0.0 else value


def _told_by_logs(effect: Effect, case: Case) -> str | None:
    if isinstance(effect, Clock) and any("offset" in free_clocks(run) for run in case.runs):
        return "the clocks of the joint logs are estimated, run by run"
    return None


class Step(NamedTuple):
    """The state of an explanation: which effects are in, and the fit with them."""

    effects: tuple[str, ...]
    optimum: Optimum


def structures(case: Case, kind: str, skid: str | None) -> list[Model]:
    """The models a diagnosis of `case` considers: the base, and `free` where the base is `coupled`."""
    model = starting_model(case, kind, skid)
    if isinstance(model.skid, Coupled):
        return [model, Model(model.board, model.tyre, "free", model.effects)]
    return [model]
