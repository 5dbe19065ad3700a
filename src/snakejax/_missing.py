"""The missing force: what must be added to a model that no known effect repairs, what it depends on, and which known
effects survive beside it.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from ._bench import LATERAL_SKID, NEARLY, WORKERS, Bench, Step
from ._dependence import Shape, dependence
from ._drive import Drive, Settled
from ._estimates import Estimate
from ._free_force import SPACING
from ._least_squares import domains_of

SURVIVES, SWITCHES = 0.5, 0.15
"""A known effect survives beside a force of one cause where that force then leaves less than this share of what it left
above the noise without the effect; a change of structure, which has no value that could be clear of zero, where less
than that."""
CLEARLY = 20.0
"""An effect must be so many standard errors from neutral beside a free force: they hold for a force as smooth as the
process says, and an effect that acts like a part of the force comes ten off."""
LITTLE = 0.05
"""Where a force of one cause leaves no more than this above the noise, nothing else is looked for."""


class RunForce(NamedTuple):
    """The missing wrench (K, 3) of one run at times `t` (K,), body frame, with standard deviations.

    A standard deviation is NaN where the structure does not feel that component at all.
    """

    run: str
    t: np.ndarray
    force: np.ndarray
    sd: np.ndarray


class Missing(NamedTuple):
    """The missing force, run by run, and the variables it depends on with the share each explains, best first.

    A share is that part of the misfit above noise which a dependence on this variable alone predicts on runs left out.
    `misfit` is the mean square of the windows' residuals without and with the free force; `shape` is None where no
    variable predicts anything. `beside`: the known effects that survive beside the force, `lateral_skid` among them
    where the structure does. `estimates` are the parameters of the model beside which it acts, by name; `switched`,
    whether its wheelsets skid freely although the board was said to be coupled.
    """

    runs: tuple[RunForce, ...]
    depends_on: tuple[tuple[str, float], ...]
    shape: Shape | None
    misfit: tuple[float, float]
    estimates: dict[str, Estimate]
    switched: bool
    beside: tuple[str, ...] = ()

    @property
    def left(self) -> float:
        """The misfit that the best variable leaves."""
        best = self.depends_on[0][1] if self.depends_on else 0.0
        return 1 + (self.misfit[0] - 1) * (1 - best)


def missing_force(bench: Bench, step: Step, progress: Callable[[str], None] = lambda _: None) -> Missing:
    """Estimate the force that is missing beside `step.effects`, and find what it depends on.

    The tyre and the effects of `step` stay free, as do the start states of the windows.
    """
    progress("estimating the missing force")
    free = bench.free(step.effects)
    # Far from the recordings the fit of whole runs has gone astray: what is typical is the better start.
    near = step.optimum.misfit < NEARLY
    fresh = {} if near else {name: value for name, value in bench.study.values().items() if name in bench.tyre}
    neutral = {name: value for name, value in bench.study.values().items() if name not in free}
    start = {n: bench.off_zero(n, v) if n in free else v for n, v in (step.optimum.values | neutral | fresh).items()}
    settled = bench.windows.settle(start, free)
    drive = Drive.of(bench, step.effects, settled.values, free)
    now = drive.settled(settled.start[:, : 6 + drive.model.memories])
    progress("what does the missing force depend on?")
    depends_on, shape = dependence(drive, now)
    samples = float((np.asarray(drive.batch.weight) > 0).sum())
    misfit = (settled.cost / samples, float((now.found.residual**2).sum()) / samples)
    return Missing(_forces(drive, now), depends_on, shape, misfit, _estimates(drive, now, misfit[1]), bench.switched)


def believed(
    structures: Sequence[tuple[Bench, Step]],
    last: Bench,
    helpers: Sequence[str],
    progress: Callable[[str], None] = lambda _: None,
) -> Missing:
    """The missing force beside that of the `structures` where a force of one cause leaves least, and beside those of
    the `helpers` that survive there; these were found under the structure of the `last` bench.

    How far whole runs of a wrong model come says nothing about its structure, nor about an effect that makes up for a
    part of what is missing; what a force of one cause leaves of the windows does.
    """
    found = [missing_force(bench, step, progress) for bench, step in structures]
    if len(found) > 1 and _less(found[1], found[0], SWITCHES):
        found[1] = found[1]._replace(beside=(LATERAL_SKID,))
    for k, (bench, step) in enumerate(structures):
        if bench is last:
            found[k] = _with_survivors(bench, step, found[k], helpers, progress)
    return min(found, key=lambda one: one.left)


def _with_survivors(bench, step: Step, alone: Missing, helpers: Sequence[str], progress) -> Missing:
    """The force beside the `helpers` that survive there, one after the other."""
    now, rest = alone, list(helpers)
    while rest and now.left > 1 + LITTLE:
        progress(f"does {' or '.join(rest)} survive beside the missing force?")
        known = (*step.effects, *(name for name in now.beside if name != LATERAL_SKID))
        steps = [Step((*known, name), step.optimum) for name in rest]
        with ThreadPoolExecutor(WORKERS) as pool:
            more = list(pool.map(partial(missing_force, bench), steps))
        best = min(range(len(rest)), key=lambda k: more[k].left)
        if not (_less(more[best], now, SURVIVES) and _clear(bench, rest[best], more[best])):
            break
        now = more[best]._replace(beside=(*now.beside, rest.pop(best)))
    return now


def _less(then: Missing, now: Missing, share: float) -> bool:
    return then.left - 1 < share * (now.left - 1)


def _clear(bench: Bench, effect: str, found: Missing) -> bool:
    """Whether a parameter of `effect`, of which none is multiplicative, is far from neutral beside a free force."""
    known = [(found.estimates[part], bench.study.values()[part]) for part in bench.candidates[effect]]
    return any(abs(e.value - neutral) > CLEARLY * (e.sd or np.inf) for e, neutral in known)


def _estimates(drive: Drive, now: Settled, misfit: float) -> dict[str, Estimate]:
    """The free parameters with what the force, whatever it is, leaves open of them."""
    steps = np.sqrt(np.diag(now.posterior.covariance) * max(misfit, 1.0))
    found = {}
    for name, value, sd, domain in zip(
        drive.names, now.point.values, steps, domains_of(drive.model, drive.names), strict=True
    ):
        natural = sd * abs(value) if domain.multiplicative else sd
        found[name] = Estimate(float(value), float(natural), domain.unit, True)
    return found


def _forces(drive: Drive, now: Settled) -> tuple[RunForce, ...]:
    """The force of each run at its knots."""
    made = []
    for k, name in enumerate(drive.runs):
        count = int(np.ceil((drive.ended[k] - drive.began[k]) / SPACING)) + 1
        t, force = drive.began[k] + SPACING * np.arange(count), now.posterior.force[k][:count]
        sd = np.where(now.felt, np.sqrt(now.posterior.variance[k][:count]), np.nan)
        made.append(RunForce(name, t, force, sd))
    return tuple(made)
