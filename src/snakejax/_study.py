"""A study: one model and its recorded runs, held ready so that any choice of free parameters and runs can be fitted."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._batch import Batch, batch
from ._least_squares import Linearised, Unknowns, domains_of, evaluate, solve, starts_removed, unknowns
from ._model import Model
from ._recording import Noise, Run
from ._simulate import Accuracy
from ._units import parameters, with_parameters

FIT_ACCURACY = Accuracy(rtol=3e-7, atol=3e-9, max_steps=32768, derivative="forward")
"""Accuracy of a fit. Its errors are below a hundredth of the noise: larger ones are rough and stop a fit too soon."""

DEPENDENT = 100.0
"""How many neighbouring samples share one error of a wrong model."""
_SCALE_SPREAD = 0.7
_ROUNDS, _ROUND = 8, 20
"""A fit starts afresh from where it is after so many steps, and where a parameter meets a bound."""


def dependence_of(misfit: float) -> float:
    """The variance of errors that leave `misfit`, times how many neighbours share one; noise is independent."""
    misfit = max(1.0, misfit)
    return misfit * (1.0 + (DEPENDENT - 1.0) * (1.0 - 1.0 / misfit))


class Optimum(NamedTuple):
    """Where a fit ended, and all that its statistics need.

    `values` by parameter name; `free`, those that were estimated; `held`, those of them that ended on a bound of their
    domain; `start` (R, S); `linearised` at the optimum; `covariance` of the steps of the parameters in `free` that are
    not held, in that order, for unit noise (see `Unknowns` for what a step is); `misfit`, the mean squared residual.
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

    @property
    def loose(self) -> tuple[str, ...]:
        """The free parameters that did not end on a bound."""
        return tuple(name for name in self.free if name not in self.held)


class Study(eqx.Module):
    """`model` and `runs`, compiled once for all parameters in `names`, `width` of which may be free at a time."""

    model: Model
    runs: tuple[Run, ...]
    noise: Noise
    names: tuple[str, ...] = eqx.field(static=True)
    width: int = eqx.field(static=True)
    batch: Batch
    accuracy: Accuracy

    @staticmethod
    def of(
        model: Model,
        runs: Sequence[Run],
        noise: Noise,
        names: Sequence[str],
        width: int,
        accuracy: Accuracy = FIT_ACCURACY,
    ) -> "Study":
        """Put `runs` side by side under `model`."""
        return Study(model, tuple(runs), noise, tuple(names), width, batch(runs, noise), accuracy)

    def sharper(self) -> "Study":
        """This study with simulations of a 30th of the error, where derivatives at the present one are not sound."""
        now = self.accuracy
        finer = dataclasses.replace(now, rtol=now.rtol / 30, atol=now.atol / 30, max_steps=4 * now.max_steps)
        return dataclasses.replace(self, accuracy=finer)

    def numbered(self, role: str) -> list[int]:
        """The numbers of the runs of `role`."""
        return [k for k, run in enumerate(self.runs) if run.role == role]

    def values(self) -> dict[str, float]:
        """The values of the movable parameters as the model has them."""
        known = parameters(self.model)
        return {name: float(known[name].value) for name in self.names}

    def fitted(self, optimum: Optimum) -> Model:
        """The model at `optimum`."""
        return with_parameters(self.model, optimum.values)

    def samples(self, runs: Sequence[int]) -> int:
        """How many numbers the runs hold: present samples of x, y and heading."""
        return int((np.asarray(self.batch.weight)[list(runs)] > 0).sum())

    def at(self, values: Mapping[str, float], free: Sequence[str], start: np.ndarray | None = None) -> Unknowns:
        """The unknowns at `values`."""
        if len(free) > self.width:
            raise ValueError(
                f"At most {self.width} parameters can be free here, but {len(free)} are: {', '.join(free)}."
            )
        base = unknowns(with_parameters(self.model, values), self.names, free, self.batch, self.width)
        return base if start is None else eqx.tree_at(lambda u: u.start, base, jnp.asarray(start))

    def evaluate(self, at: Unknowns, runs: Sequence[int], until: float = np.inf) -> Linearised:
        """Residuals and Jacobian at `at`; the residuals after `until` [s] are zero."""
        return evaluate(self.model, at, self._within(until), list(runs), self.accuracy)

    def fit(
        self,
        values: Mapping[str, float],
        free: Sequence[str],
        runs: Sequence[int],
        start: np.ndarray | None = None,
        *,
        until: float = np.inf,
        threshold: float = np.inf,
        enough: float = 0.05,
        crawl: float = 0.0,
        weak_prior: bool = False,
        most: int = 60,
    ) -> Optimum:
        """Least squares over `runs` from `values`, each parameter kept in its domain.

        A parameter that wants to leave its domain is held on the bound while the others move, and let go where the
        misfit would fall inside. `until` [s] leaves out what comes later; `threshold` is that of Huber's loss; the fit
        ends where a step promises to lower chi^2 by less than `enough`, or far from the noise has lowered it by less
        than the share `crawl`, or after `most` steps; `weak_prior` pulls towards what is typical, for a first approach.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._fit(values, list(free), list(runs), start, until, threshold, enough, crawl, weak_prior, most)

    def _fit(self, values, free, runs, start, until, threshold, enough, crawl, weak_prior, most) -> Optimum:
        span = self._within(until)
        at = self.at(values, free, start)
        moving = np.asarray(at.directions)
        found = evaluate(self.model, at, span, runs, self.accuracy) if weak_prior else None
        held: list[str] = []
        steps, settled = 0, False
        for _ in range(_ROUNDS):
            solved = solve(
                self.model,
                at,
                span,
                runs,
                prior=None if found is None else self._prior(at, free, found, runs),
                enough=enough,
                crawl=crawl,
                threshold=threshold,
                most=min(most - steps, _ROUND),
                accuracy=self.accuracy,
            )
            steps, settled = steps + solved.steps, solved.settled
            at = eqx.tree_at(lambda u: u.directions, solved.unknowns, jnp.asarray(moving))
            ended = evaluate(self.model, at, span, runs, self.accuracy) if held else solved.linearised
            snapped = self._pressing(at, ended, free, runs)
            done = settled or solved.steps < _ROUND
            if (done and set(snapped) == set(held)) or steps >= most:
                break
            held = list(snapped)
            values = [snapped.get(name, value) for name, value in self._named(at)]
            loose = [k >= len(free) or free[k] not in held for k in range(self.width)]
            directions = jnp.asarray(moving * np.array(loose)[:, None])
            at = eqx.tree_at(lambda u: (u.values, u.directions), at, (jnp.asarray(values), directions))
        return self._optimum(at, ended, free, held, runs, span, steps, settled)

    def _optimum(self, at, found, free, held, runs, span, steps, converged) -> Optimum:
        loose = [free.index(name) for name in free if name not in held]
        free_start = np.asarray(at.free_start)
        whitened = np.concatenate([starts_removed(found, k, self.width, free_start)[1] for k in runs])[:, loose]
        samples = int((np.asarray(span.weight)[runs] > 0).sum())
        values = {name: float(value) for name, value in zip(self.names, np.asarray(at.values), strict=True)}
        residual = np.asarray(found.residual)[runs]
        return Optimum(
            values,
            tuple(free),
            tuple(held),
            np.asarray(at.start),
            found,
            inverse(whitened.T @ whitened),
            float((residual**2).sum() / max(samples, 1)),
            samples,
            steps,
            converged,
        )

    def _within(self, until: float) -> Batch:
        times = np.asarray(self.batch.times)
        if until >= times.max():
            return self.batch
        late = times > until
        rank = np.cumsum(late, axis=1)
        cut = jnp.asarray(np.where(late, until + 1e-6 * rank, times))
        weight = jnp.asarray(np.where(late[..., None], 0.0, np.asarray(self.batch.weight)))
        return eqx.tree_at(lambda b: (b.times, b.weight), self.batch, (cut, weight))

    def _named(self, at: Unknowns) -> list[tuple[str, float]]:
        return [(name, float(value)) for name, value in zip(self.names, np.asarray(at.values), strict=True)]

    def _prior(
        self, at: Unknowns, free: list[str], found: Linearised, runs: list[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(mean, 1 / spread) of the steps from `at` to what is typical, or for a mere scale to where the model began.

        A model that is far off has errors that depend on each other, so the prior counts the more the larger they are.
        """
        pull, strength = self.typical(dict(self._named(at)), free)
        weight = np.sqrt(DEPENDENT * max(1.0, np.mean(np.minimum(found.residual[runs] ** 2, 1e12))))
        return pull, weight * strength

    def typical(self, values: Mapping[str, float], free: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """The steps (K,) from `values` to what is typical, and one over their spread, zero where nothing is."""
        pull, strength = np.zeros(self.width), np.zeros(self.width)
        began = self.values()
        for row, (name, domain) in enumerate(zip(free, domains_of(self.model, free), strict=True)):
            if domain.typical is None and not domain.multiplicative:
                continue
            mean, spread = (began[name], _SCALE_SPREAD * began[name]) if domain.typical is None else domain.typical
            pull[row] = domain.step_to(mean) - domain.step_to(values[name])
            strength[row] = (mean if domain.multiplicative else 1.0) / spread
        return pull, strength

    def plausibility(self, optimum: Optimum) -> float:
        """-2 log posterior for noise of unknown size, by which optima of different starts are compared."""
        if not np.isfinite(optimum.misfit):
            return np.inf
        pull, strength = self.typical(optimum.values, optimum.free)
        return optimum.samples / DEPENDENT * float(np.log(optimum.misfit)) + float(((pull * strength) ** 2).sum())

    def _pressing(self, at: Unknowns, found: Linearised, free: list[str], runs: list[int]) -> dict[str, float]:
        """The free parameters that stand at a bound of their domain and would go further, with that bound."""
        pressing = {}
        values = dict(self._named(at))
        for row, (name, domain) in enumerate(zip(free, domains_of(self.model, free), strict=True)):
            column = found.jacobian[runs][..., row]
            size = np.sqrt((column**2).sum())
            reach = 1.0 / size if size > 0 else 0.0
            reach = reach * abs(values[name]) if domain.multiplicative else reach
            downhill = float((column * found.residual[runs]).sum()) < 0
            if values[name] - domain.low <= reach and not downhill:
                pressing[name] = domain.low
            elif domain.high - values[name] <= reach and downhill:
                pressing[name] = domain.high
        return pressing


def inverse(normal: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric positive matrix, by its scaled eigenvectors; infinite variance where it is singular."""
    if not normal.size:
        return normal
    if not np.isfinite(normal).all():
        return np.full_like(normal, np.inf)
    size = np.sqrt(np.diag(normal))
    safe = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(normal / np.outer(safe, safe))
    floor = np.finfo(float).eps * len(size) * max(values[-1], 1.0)
    inverted = vectors @ np.diag(1 / np.maximum(values, floor)) @ vectors.T / np.outer(safe, safe)
    inverted[size == 0, size == 0] = np.inf
    return inverted
