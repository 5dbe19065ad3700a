"""Fit problem: one model and its recorded runs, compiled once for any choice of free parameters and runs."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypedDict, Unpack

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import parameters, with_parameters
from snakejax.dynamics.model import Model
from snakejax.recording.run import Noise, Run
from snakejax.simulation.integrate import Accuracy

from .batch import Batch, batch
from .fit_journal import kept_fit
from .least_squares import LeastSquaresResult, SolverSettings, evaluate, solve
from .levenberg_marquardt import MOST_STEPS
from .linearisation import Linearised, Variables, domains_of, project_out_starts, variables

FIT_ACCURACY = Accuracy(rtol=3e-7, atol=3e-9, max_steps=32768, derivative="forward")
"""Tolerances of the simulations in a fit: their errors are below 1 % of the noise. With larger errors the misfit is not
smooth and a fit stops too early."""

DEPENDENT = 100.0
"""Number of neighbouring samples over which the error of an incomplete model is correlated."""
_SCALE_SPREAD = 0.7
"""Relative standard deviation of the weak prior of a positive parameter without a typical value (a factor of 2)."""
_ROUNDS, _ROUND = 8, 20
"""A fit restarts (damping and scales reset) after `_ROUND` steps and where a parameter meets a bound, at most `_ROUNDS`
times."""


def dependence_of(misfit: float) -> float:
    """The inflation of the noise variance for correlated model error: m (1 + (DEPENDENT - 1) (1 - 1 / m)).

    m is the `misfit`, at least 1. Of the variance m the part 1 is independent noise, the part m - 1 is model error that
    `DEPENDENT` neighbouring samples share.
    """
    misfit = max(1.0, misfit)
    return misfit * (1.0 + (DEPENDENT - 1.0) * (1.0 - 1.0 / misfit))


class Solution(NamedTuple):
    """The optimum of a fit, with all that its statistics need.

    `values` by parameter name; `free`: the estimated parameters; `held`: those of them at a bound of their domain;
    `start` (R, S): start states; `linearised` at the optimum; `covariance` (k, k) of the steps of the interior
    parameters `loose`, in that order, for unit noise (`Variables` defines a step); `misfit`: mean squared normalised
    residual (reduced chi-squared per sample); `rough`: parameters whose column of `linearised` is not the derivative of
    the simulation, None if that was not checked; `threshold`: that of Huber's loss [standard deviations].
    """

    values: dict[str, float]
    free: tuple[str, ...]
    held: tuple[str, ...]
    start: np.ndarray
    linearised: Linearised
    covariance: np.ndarray
    misfit: float
    samples: int
    steps: int
    converged: bool
    rough: tuple[str, ...] | None = None
    threshold: float = np.inf

    @property
    def loose(self) -> tuple[str, ...]:
        """The free parameters inside their domain (interior, not at a bound)."""
        return tuple(name for name in self.free if name not in self.held)


class FitOptions(TypedDict, total=False):
    """Options of `Problem.fit`.

    `until` [s]: later samples are ignored; `threshold`: that of Huber's loss [standard deviations] (default: that of
    the problem); `enough`: the fit stops where a step is expected to lower chi^2 by less (default 0.05); `crawl`: far
    from the noise it stops where a step lowered chi^2 by less than this fraction (default 0); `most`: largest number
    of steps (default 60); `weak_prior`: pull towards typical values, for the first approach from far away (default
    False).
    """

    until: float
    threshold: float
    enough: float
    crawl: float
    most: int
    weak_prior: bool


class Problem(eqx.Module):
    """`model` and `runs`, compiled once for all parameters in `names`, of which at most `width` are free at a time.

    `threshold`: that of Huber's loss in a fit that names none [standard deviations].
    """

    model: Model
    runs: tuple[Run, ...]
    noise: Noise
    names: tuple[str, ...] = eqx.field(static=True)
    width: int = eqx.field(static=True)
    batch: Batch
    accuracy: Accuracy
    threshold: float = eqx.field(static=True, default=np.inf)

    @staticmethod
    def of(
        model: Model,
        runs: Sequence[Run],
        noise: Noise,
        names: Sequence[str],
        width: int,
        accuracy: Accuracy = FIT_ACCURACY,
        threshold: float = np.inf,
    ) -> "Problem":
        """The problem of fitting `names` of `model` to `runs`, batched with the weights of `noise`."""
        return Problem(model, tuple(runs), noise, tuple(names), width, batch(runs, noise), accuracy, threshold)

    def with_tighter_tolerances(self) -> "Problem":
        """This problem with the tolerances of its simulations divided by 30, for derivatives that are not accurate."""
        accuracy = self.accuracy
        finer = dataclasses.replace(
            accuracy, rtol=accuracy.rtol / 30, atol=accuracy.atol / 30, max_steps=4 * accuracy.max_steps
        )
        return dataclasses.replace(self, accuracy=finer)

    def run_indices(self, role: str) -> list[int]:
        """The indices of the runs with `role` ("train" or "heldout")."""
        return [k for k, run in enumerate(self.runs) if run.role == role]

    def values(self) -> dict[str, float]:
        """The values of the parameters `names` in the model."""
        known = parameters(self.model)
        return {name: float(known[name].value) for name in self.names}

    def fitted(self, solution: Solution) -> Model:
        """The model at `solution`."""
        return with_parameters(self.model, solution.values)

    def samples(self, runs: Sequence[int]) -> int:
        """The number of present samples of x, y and heading in `runs`."""
        return int((np.asarray(self.batch.weight)[list(runs)] > 0).sum())

    def cost(self, solution: Solution, runs: Sequence[int]) -> float:
        """What a fit of `runs` minimises, at `solution`: chi^2, or the sum of r^2 where |r| <= t and 2 t |r| - t^2
        elsewhere, with t the `threshold` (Huber 1964)."""
        size = np.abs(np.asarray(solution.linearised.residual)[list(runs)])
        inner = np.minimum(size, self.threshold)
        return float((inner * (2 * size - inner)).sum())

    def at(self, values: Mapping[str, float], free: Sequence[str], start: np.ndarray | None = None) -> Variables:
        """The `Variables` at `values` and `start`. **Raises:** `ValueError` for more than `width` free parameters."""
        if len(free) > self.width:
            raise ValueError(
                f"At most {self.width} parameters can be free here, but {len(free)} are: {', '.join(free)}."
            )
        at = variables(self.model, self.names, free, self.batch, self.width, values)
        return at if start is None else dataclasses.replace(at, start=np.asarray(start, float))

    def evaluate(self, at: Variables, runs: Sequence[int], until: float = np.inf) -> Linearised:
        """Residuals and Jacobian at `at`; the residuals after `until` [s] are zero."""
        return evaluate(self.model, at, self._within(until), list(runs), self.accuracy)

    @kept_fit
    def fit(
        self,
        values: Mapping[str, float],
        free: Sequence[str],
        runs: Sequence[int],
        start: np.ndarray | None = None,
        **options: Unpack[FitOptions],
    ) -> Solution:
        """Minimise chi^2 over `runs` from `values`, with every parameter in its domain (active set of bounds).

        A parameter whose step leads out of its domain is fixed at the bound while the others move, and released when
        chi^2 falls towards the inside. **Arguments:** `start` (R, S): start states; `options`, see `FitOptions`.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._fit(values, list(free), list(runs), start, options)

    def _fit(self, values, free: list[str], runs: list[int], start, options: FitOptions) -> Solution:
        window = self._within(options.get("until", np.inf))
        most = options.get("most", MOST_STEPS)
        settings = SolverSettings(
            options.get("enough", 0.05), options.get("crawl", 0.0), options.get("threshold", self.threshold)
        )
        at = self.at(values, free, start)
        moving = np.asarray(at.directions)
        weak_prior = options.get("weak_prior", False)
        initial = evaluate(self.model, at, window, runs, self.accuracy) if weak_prior else None
        held: list[str] = []
        steps, rounds = 0, 0
        while True:
            rounds += 1
            round_settings = dataclasses.replace(settings, most=min(most - steps, _ROUND))
            prior = None if initial is None else self._prior(at, free, initial, runs)
            known = initial if rounds == 1 else None
            solved = solve(self.model, at, window, runs, self.accuracy, round_settings, prior, known)
            steps += solved.steps
            at = eqx.tree_at(lambda u: u.directions, solved.variables, jnp.asarray(moving))
            ended = evaluate(self.model, at, window, runs, self.accuracy) if held else solved.linearised
            violating = self._violating_bounds(at, ended, free, runs)
            finished = solved.settled or solved.steps < _ROUND
            if (finished and set(violating) == set(held)) or steps >= most or rounds == _ROUNDS:
                break
            held = list(violating)
            values = [violating.get(name, value) for name, value in self._named(at)]
            loose = [k >= len(free) or free[k] not in held for k in range(self.width)]
            directions = jnp.asarray(moving * np.array(loose)[:, None])
            at = eqx.tree_at(lambda u: (u.values, u.directions), at, (jnp.asarray(values), directions))
        solution = self._solution(LeastSquaresResult(at, ended, steps, solved.settled), free, held, runs, window)
        return solution._replace(threshold=float(settings.threshold))

    def _solution(
        self, result: LeastSquaresResult, free: list[str], held: list[str], runs: list[int], window: Batch
    ) -> Solution:
        """`result` with its statistics."""
        at, linearised, steps, converged = result
        loose = [free.index(name) for name in free if name not in held]
        free_start = np.asarray(at.free_start)
        columns = [project_out_starts(linearised, k, self.width, free_start)[1] for k in runs]
        projected = np.concatenate(columns)[:, loose]
        samples = int((np.asarray(window.weight)[runs] > 0).sum())
        residual = np.asarray(linearised.residual)[runs]
        return Solution(
            dict(self._named(at)),
            tuple(free),
            tuple(held),
            np.asarray(at.start),
            linearised,
            covariance_of(projected.T @ projected),
            float((residual**2).sum() / max(samples, 1)),
            samples,
            steps,
            converged,
        )

    def _within(self, until: float) -> Batch:
        times = np.asarray(self.batch.times)
        if until >= times.max():
            return self.batch
        after = times > until
        rank = np.cumsum(after, axis=1)
        times_within = jnp.asarray(np.where(after, until + 1e-6 * rank, times))
        weight = jnp.asarray(np.where(after[..., None], 0.0, np.asarray(self.batch.weight)))
        return eqx.tree_at(lambda b: (b.times, b.weight), self.batch, (times_within, weight))

    def _named(self, at: Variables) -> list[tuple[str, float]]:
        return [(name, float(value)) for name, value in zip(self.names, np.asarray(at.values), strict=True)]

    def _prior(
        self, at: Variables, free: list[str], linearised: Linearised, runs: list[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weak prior (mean, 1 / standard deviation) of the steps from `at`, each (K,).

        Its centre is the typical value, or the initial value of a parameter that is a mere scale. Errors of a poor
        model are correlated, so the weight of the prior grows with the misfit.
        """
        pull, strength = self.typical(dict(self._named(at)), free)
        weight = np.sqrt(DEPENDENT * max(1.0, np.mean(np.minimum(linearised.residual[runs] ** 2, 1e12))))
        return pull, weight * strength

    def typical(self, values: Mapping[str, float], free: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """The steps (K,) from `values` to the typical ones, and 1 / their standard deviation (K,).

        Both are zero where a parameter has no typical value, or is multiplicative and zero.
        """
        pull, strength = np.zeros(self.width), np.zeros(self.width)
        initial = self.values()
        for row, (name, domain) in enumerate(zip(free, domains_of(self.model, free), strict=True)):
            immovable = domain.multiplicative and not values[name] > 0
            if immovable or (domain.typical is None and not domain.multiplicative):
                continue
            mean, spread = (initial[name], _SCALE_SPREAD * initial[name]) if domain.typical is None else domain.typical
            pull[row] = domain.step_to(mean) - domain.step_to(values[name])
            strength[row] = (mean if domain.multiplicative else 1.0) / spread
        return pull, strength

    def penalised_deviance(self, solution: Solution) -> float:
        """-2 log posterior for noise of unknown variance: N / DEPENDENT ln(misfit) + prior; compares local optima."""
        if not np.isfinite(solution.misfit):
            return np.inf
        pull, strength = self.typical(solution.values, solution.free)
        return solution.samples / DEPENDENT * float(np.log(solution.misfit)) + float(((pull * strength) ** 2).sum())

    def _violating_bounds(
        self, at: Variables, linearised: Linearised, free: list[str], runs: list[int]
    ) -> dict[str, float]:
        """Free parameters within one standard error of a bound that the descent direction crosses, with that bound."""
        violating = {}
        values = dict(self._named(at))
        for row, (name, domain) in enumerate(zip(free, domains_of(self.model, free), strict=True)):
            column = linearised.jacobian[runs][..., row]
            size = np.sqrt((column**2).sum())
            tolerance = 1.0 / size if size > 0 else 0.0
            tolerance = tolerance * abs(values[name]) if domain.multiplicative else tolerance
            downhill = float((column * linearised.residual[runs]).sum()) < 0
            if values[name] - domain.low <= tolerance and not downhill:
                violating[name] = domain.low
            elif domain.high - values[name] <= tolerance and downhill:
                violating[name] = domain.high
        return violating


def covariance_of(normal: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive semidefinite matrix, by eigenvectors of the matrix scaled to a unit diagonal.

    The variance is infinite where a diagonal entry is zero; all entries are infinite if one is not finite.
    """
    if not normal.size:
        return normal
    if not np.isfinite(normal).all():
        return np.full_like(normal, np.inf)
    norms = np.sqrt(np.diag(normal))
    scale = np.where(norms > 0, norms, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    floor = np.finfo(float).eps * len(norms) * max(values[-1], 1.0)
    inverted = vectors @ np.diag(1 / np.maximum(values, floor)) @ vectors.T / np.outer(scale, scale)
    inverted[norms == 0, norms == 0] = np.inf
    return inverted
