"""A fitted model in its recorded runs, as plain data: what comparisons and pictures of it are made from."""

import dataclasses

import numpy as np
from jaxtyping import Float

from snakejax.core.tabular import counted, listed
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import Accuracy

from .problem import FIT_ACCURACY, Problem, Solution
from .uncertainty import spread


def _none() -> Float[np.ndarray, "0 0"]:
    return np.zeros((0, 0))


@dataclasses.dataclass(frozen=True, eq=False)
class FittedModel:
    """`model` with its fitted values in R `recordings`: those of the fit, or those of its validation.

    `starts` (R, S): fitted start states, poses (x, y [m], heading [rad]) or poses and velocities. `residuals`: for each
    recording (n, 3), measured minus modelled x, y and heading in standard deviations of `noise`, NaN where frames were
    lost. `covariance` (k, k): of the parameters `loose` for unit noise; of their logarithms for multiplicative ones.
    `spread`: factor on standard errors for a misfit above noise. `accuracy`: that of the simulations. `threshold`: that
    of Huber's loss in the fit [standard deviations].
    """

    model: Model
    recordings: tuple[Run, ...]
    noise: Noise
    starts: Float[np.ndarray, "R S"]
    residuals: tuple[Float[np.ndarray, "n 3"], ...]
    loose: tuple[str, ...] = ()
    covariance: Float[np.ndarray, "k k"] = dataclasses.field(default_factory=_none)
    spread: float = 1.0
    accuracy: Accuracy = FIT_ACCURACY
    threshold: float = np.inf

    def __repr__(self) -> str:
        return f"FittedModel: {self.name}; {self.runs_text}"

    @property
    def name(self) -> str:
        """The tyre law, the structure and the effects: `Pacejka, free, with ground_slope`."""
        effects = f", with {listed(list(self.model.effects))}" if self.model.effects else ""
        return f"{type(self.model.tyre).__name__}, {self.model.structure}{effects}"

    @property
    def runs_text(self) -> str:
        """`5 train and 2 held-out runs`."""
        train, heldout = len(self.numbered("train")), len(self.numbered("heldout"))
        return f"{train} train and {counted(heldout, 'held-out run')}" if heldout else counted(train, "train run")

    def numbered(self, role: str) -> list[int]:
        """The numbers of the recordings with `role` ("train" or "heldout")."""
        return [k for k, run in enumerate(self.recordings) if run.role == role]


def fitted_model(model: Model, problem: Problem, solution: Solution, heldout: Solution | None) -> FittedModel:
    """The plain data of `solution`: `model` at its values; the held-out runs as `heldout` has them, NaN without it."""
    starts = np.array(solution.start)
    residuals = []
    for k, run in enumerate(problem.runs):
        run_solution = heldout if run.role == "heldout" else solution
        n = run.times.shape[0]
        if run_solution is None:
            residuals.append(np.full((n, 3), np.nan))
            continue
        starts[k] = run_solution.start[k]
        weight = np.asarray(problem.batch.weight)[k, :n]
        residuals.append(np.where(weight > 0, np.asarray(run_solution.linearised.residual)[k, :n], np.nan))
    return FittedModel(
        model,
        problem.runs,
        problem.noise,
        starts,
        tuple(residuals),
        solution.loose,
        solution.covariance,
        spread(solution),
        problem.accuracy,
        solution.threshold,
    )
