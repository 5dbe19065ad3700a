"""The missing force: what must be added to a model that no known effect repairs, and what it depends on."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ._bench import NEARLY, Bench, Step
from ._dependence import Shape, dependence
from ._drive import Drive, Settled
from ._free_force import SPACING


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
    variable predicts anything. `values` are the parameters of the model beside which the force acts, by name;
    `switched`, whether its wheelsets skid freely although the board was said to be coupled.
    """

    runs: tuple[RunForce, ...]
    depends_on: tuple[tuple[str, float], ...]
    shape: Shape | None
    misfit: tuple[float, float]
    values: dict[str, float]
    switched: bool

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
    settled = bench.windows.settle({**step.optimum.values, **fresh}, free)
    drive = Drive.of(bench, step.effects, settled.values, free)
    now = drive.settled(settled.start[:, : 6 + drive.model.memories])
    progress("what does the missing force depend on?")
    depends_on, shape = dependence(drive, now)
    samples = float((np.asarray(drive.batch.weight) > 0).sum())
    misfit = (settled.cost / samples, float((now.found.residual**2).sum()) / samples)
    values = {name: float(value) for name, value in zip(drive.names, now.point.values, strict=True)}
    return Missing(_forces(drive, now), depends_on, shape, misfit, values, bench.switched)


def believed(structures: Sequence[tuple[Bench, Step]], progress: Callable[[str], None] = lambda _: None) -> Missing:
    """The missing force beside that of the `structures` where a force of one cause leaves least.

    How far whole runs of a wrong model come says nothing about its structure; what the windows leave does.
    """
    return min((missing_force(bench, step, progress) for bench, step in structures), key=lambda found: found.left)


def _forces(drive: Drive, now: Settled) -> tuple[RunForce, ...]:
    """The force of each run at its knots."""
    made = []
    for k, name in enumerate(drive.runs):
        count = int(np.ceil((drive.ended[k] - drive.began[k]) / SPACING)) + 1
        t, force = drive.began[k] + SPACING * np.arange(count), now.posterior.force[k][:count]
        sd = np.where(now.felt, np.sqrt(now.posterior.variance[k][:count]), np.nan)
        made.append(RunForce(name, t, force, sd))
    return tuple(made)
