"""The missing force of a model that no known effect explains: its estimate, the variables on which it depends, and the
known effects that stay significant together with it.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from snakejax.core.parallel import in_threads
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.core.tabular import Tabular
from snakejax.dynamics.constraints import LATERAL_SLIP_SWITCH
from snakejax.estimation.linearisation import domains_of
from snakejax.estimation.uncertainty import Estimate

from ..law.search import ProposedLaw, search
from ..law.windows import ForceWindows
from ..selection.candidates import CandidateFit, CandidateSet
from .dependence import FittedFunction, dependence
from .estimate import ForceEstimator, ForceSolution
from .piecewise_force import SPACING


class RunForce(NamedTuple):
    """The missing wrench (K, 3) of one run at times `t` (K,), body frame, with standard deviations.

    A standard deviation is NaN where the structure does not feel that component at all.
    """

    run: str
    t: np.ndarray
    force: np.ndarray
    sd: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class LatentForce(Tabular):
    """The missing force of each run, and the variables on which it depends with their shares, best first.

    A share is the part of the misfit above noise that this variable alone predicts on omitted runs. `misfit`: mean
    square of the residuals of the windows without and with the free force; None where it is the random force of whole
    runs. `shape`: None if no variable predicts the force. `beside`: the known effects that stay significant together
    with the force, including `lateral_skid` if the structure does. `estimates`: parameters of the model to which the
    force is added, by name. `switched`: whether its wheelsets slip separately although the case states the structure
    coupled. `windows`: the data for regressions on the force. `laws`: the formulas that predict it on omitted runs,
    best first.
    """

    runs: tuple[RunForce, ...]
    depends_on: tuple[tuple[str, float], ...]
    shape: FittedFunction | None
    misfit: tuple[float, float] | None
    estimates: dict[str, Estimate]
    switched: bool
    beside: tuple[str, ...] = ()
    windows: ForceWindows | None = None
    laws: tuple[ProposedLaw, ...] = ()

    @property
    def is_random(self) -> bool:
        """Whether it is the random force of whole runs, and not a free force in windows."""
        return self.misfit is None

    @property
    def left(self) -> float:
        """The misfit that the best variable, or the best law, leaves."""
        best = self.depends_on[0][1] if self.depends_on else 0.0
        by_variable = [1 + (self.misfit[0] - 1) * (1 - best)] if self.misfit else []
        return min([*by_variable, *(law.left_out for law in self.laws)], default=np.inf)

    def with_laws(self) -> "LatentForce":
        """This force with the laws that predict it on runs left out, and the shares of their variables."""
        if self.windows is None or len(self.runs) < 2:
            return self
        return self.with_found(search(self.windows))

    def with_found(self, laws: Sequence[ProposedLaw]) -> "LatentForce":
        """This force with `laws`, the best first, and the shares of their variables where these are larger; of equal
        shares those of the best law come first."""
        shares = dict.fromkeys(laws[0].variables if laws else (), 0.0) | dict(self.depends_on)
        for k, law in enumerate(laws):
            # A law of two variables says what they explain together, so it counts for both only where it is the best.
            for variable in law.variables if k == 0 or len(law.variables) == 1 else ():
                shares[variable] = max(shares.get(variable, 0.0), law.share)
        depends_on = tuple(sorted(shares.items(), key=lambda pair: -pair[1]))
        return dataclasses.replace(self, laws=tuple(laws), depends_on=depends_on)

    def with_also(self, laws: Sequence[ProposedLaw]) -> "LatentForce":
        """This force with `laws` among its own: smooth functions are proposed where no formula is good enough."""
        known = {law.expression for law in self.laws}
        return dataclasses.replace(self, laws=(*(law for law in laws if law.expression not in known), *self.laws))

    @property
    def size(self) -> tuple[float, float]:
        """Root mean square of the force along the body [N] and of the yaw moment [N m]."""
        force = np.concatenate([run.force[:, [0, 2]] for run in self.runs])
        push, turn = np.sqrt(np.nanmean(force**2, axis=0))
        return float(push), float(turn)

    def headline(self) -> str:
        """Its size, and what it depends on."""
        push, turn = self.size
        variables = ", ".join(f"{variable} ({share:.0%})" for variable, share in self.depends_on[:3])
        depends = f"depends on {variables}" if self.shape is not None else "no variable predicts it"
        return f"{push:.3g} N along the body, {turn:.3g} N m in yaw (root mean square); {depends}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each variable that it may depend on, with the share that this explains."""
        return {"variable": [name for name, _ in self.depends_on], "share": [share for _, share in self.depends_on]}


def estimate_latent_force(
    candidate_set: CandidateSet, step: CandidateFit, progress: Progress = no_progress
) -> LatentForce:
    """Estimate the force that is missing beside `step.effects`, and find what it depends on.

    The tyre and the effects of `step` stay free, as do the start states of the windows.
    """
    progress(ProgressEvent(Phase.LATENT_FORCE))
    free = candidate_set.free(step.effects)
    # Far from the recordings the fit of whole runs has gone astray: what is typical is the better start.
    near = step.solution.misfit < candidate_set.criteria.linear_misfit
    fresh = (
        {}
        if near
        else {name: value for name, value in candidate_set.problem.values().items() if name in candidate_set.tyre}
    )
    neutral = {name: value for name, value in candidate_set.problem.values().items() if name not in free}
    start = {
        n: candidate_set.off_zero(n, v) if n in free else v for n, v in (step.solution.values | neutral | fresh).items()
    }
    settled = candidate_set.windows.settle(start, free)
    drive = ForceEstimator.of(candidate_set, step.effects, settled.values, free)
    now = drive.settled(settled.start[:, : 6 + drive.model.memories])
    progress(ProgressEvent(Phase.FORCE_REGRESSION))
    depends_on, shape = dependence(drive, now, candidate_set.criteria)
    samples = float((np.asarray(drive.batch.weight) > 0).sum())
    misfit = (settled.cost / samples, float((now.linearised.residual**2).sum()) / samples)
    return LatentForce(
        _forces(drive, now),
        depends_on,
        shape,
        misfit,
        _estimates(drive, now, misfit[1]),
        candidate_set.switched,
        windows=ForceWindows.of(drive, now),
    )


def choose_structure(
    structures: Sequence[tuple[CandidateSet, CandidateFit]],
    last: CandidateSet,
    added: Sequence[str],
    progress: Progress = no_progress,
) -> LatentForce:
    """The latent force under that of the `structures` where a force of one cause leaves least, and beside those of the
    `added` effects that stay significant there; these were added under the structure of `last`.

    How far whole runs of a wrong model come says nothing about its structure, nor about an effect that makes up for a
    part of what is missing; what a force of one cause leaves of the windows does.
    """
    forces = [estimate_latent_force(candidate_set, step, progress) for candidate_set, step in structures]
    progress(ProgressEvent(Phase.LAW_SEARCH))
    forces = [force.with_laws() for force in forces]
    if len(forces) > 1 and _lowers_excess(forces[1], forces[0], structures[1][0].criteria.structure_excess_ratio):
        forces[1] = dataclasses.replace(forces[1], beside=(LATERAL_SLIP_SWITCH,))
    for k, (candidate_set, step) in enumerate(structures):
        if candidate_set is last:
            forces[k] = _with_coexisting_effects(candidate_set, step, forces[k], added, progress)
    best = min(forces, key=lambda force: force.left)
    return best if best.laws else best.with_laws()


def _with_coexisting_effects(
    candidate_set: CandidateSet,
    step: CandidateFit,
    alone: LatentForce,
    added: Sequence[str],
    progress: Progress,
) -> LatentForce:
    """The latent force beside those of the `added` effects that stay significant there, one after the other."""
    criteria, now, rest = candidate_set.criteria, alone, list(added)
    while rest and now.left > 1 + criteria.force_explained_excess:
        text = f"does {' or '.join(rest)} stay significant together with the missing force?"
        progress(ProgressEvent(Phase.COEXISTING_EFFECTS, text))
        known = (*step.effects, *(name for name in now.beside if name != LATERAL_SLIP_SWITCH))
        steps = [CandidateFit((*known, name), step.solution) for name in rest]
        forces = in_threads(partial(estimate_latent_force, candidate_set), steps)
        k = min(range(len(rest)), key=lambda k: forces[k].left)
        # What laws explain counts on both sides.
        best = forces[k].with_laws()
        coexists = _lowers_excess(best, now, criteria.coexisting_excess_ratio)
        if not (coexists and _far_from_neutral(candidate_set, rest[k], best)):
            break
        now = dataclasses.replace(best, beside=(*now.beside, rest.pop(k)))
    return now


def _lowers_excess(then: LatentForce, now: LatentForce, ratio: float) -> bool:
    """Whether a force of one cause leaves less than `ratio` of the excess in `then` that it leaves in `now`."""
    return then.left - 1 < ratio * (now.left - 1)


def _far_from_neutral(candidate_set: CandidateSet, effect: str, force: LatentForce) -> bool:
    """Whether a parameter of `effect`, of which none is multiplicative, is far from neutral beside the force."""
    neutral, most = candidate_set.problem.values(), candidate_set.criteria.coexisting_sd
    estimates = {part: force.estimates[part] for part in candidate_set.candidates[effect]}
    return any(abs(e.value - neutral[part]) > most * (e.sd or np.inf) for part, e in estimates.items())


def _estimates(drive: ForceEstimator, now: ForceSolution, misfit: float) -> dict[str, Estimate]:
    """The free parameters with what the force, whatever it is, leaves open of them."""
    steps = np.sqrt(np.diag(now.posterior.covariance) * max(misfit, 1.0))
    estimates = {}
    for name, value, sd, domain in zip(
        drive.names, now.point.values, steps, domains_of(drive.model, drive.names), strict=True
    ):
        natural = sd * abs(value) if domain.multiplicative else sd
        estimates[name] = Estimate(float(value), float(natural), domain.unit, True)
    return estimates


def _forces(drive: ForceEstimator, now: ForceSolution) -> tuple[RunForce, ...]:
    """The force of each run at its knots."""
    forces = []
    for k, name in enumerate(drive.runs):
        count = int(np.ceil((drive.ended[k] - drive.began[k]) / SPACING)) + 1
        t, force = drive.began[k] + SPACING * np.arange(count), now.posterior.force[k][:count]
        sd = np.where(now.observable, np.sqrt(now.posterior.variance[k][:count]), np.nan)
        forces.append(RunForce(name, t, force, sd))
    return tuple(forces)
