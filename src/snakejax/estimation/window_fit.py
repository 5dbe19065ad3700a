"""Robust fits of many short windows: no window that a model misses altogether rules the others.

With c_w the mean squared residual of window w [noise variances], n_w its samples and s^2 a scale,

    minimise  sum_w n_w s^2 ln(1 + c_w / s^2) + sum of ((p - prior mean) / prior sd)^2 phi

over the parameters p and the start state of each window. The loss is Cauchy's (Holland and Welsch 1977): a window of
c_w >> s^2, in which the model spins or the vehicle was touched, has the weight 1 / (1 + c_w / s^2). What a vehicle does
not repeat is correlated over a window, so that a window counts as one pose: phi = median(c_w) n_w / 3 is the variance
of its samples.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.parameter import Domain

from .discrepancy.least_squares import scaled_inverse
from .fit_journal import kept_fit
from .linearisation import domains_of
from .many_runs import FIRST_DAMPING, LEAST_DAMPING
from .problem import Problem

EFFICIENT = (2.385 / 0.6745) ** 2
"""s^2 over the median of c_w: 2.385 standard deviations, with which Cauchy's estimate has 95% of the efficiency of
least squares where errors are normal; the median of |error| is 0.6745 of them (Holland and Welsch 1977)."""
POSE = 3
"""The independent numbers of a window: its pose."""
LONGEST = 1.0
"""Longest step of a parameter in its coordinate: a factor of e, or one unit."""
MOST = 40
"""Steps of a fit, at most."""
LITTLE = 1e-3
"""A fit stops where a step lowers what it minimises by less than this share."""
REJECTED = 8
"""Steps in a row that do not lower it, after which it stops."""
START_SD = np.array([0.05, 0.05, 0.1, 0.3, 0.3, 1.0])
"""How far a start state is from the recorded one [m, m, rad, m/s, m/s, rad/s]: it keeps regular what a window does not
show, such as a sideways velocity that decays at once."""
UNSEEN = 1e-9
"""A combination of scaled start components below this singular value has no influence."""
LARGEST = 1e8
"""A window further off than this [noise variances] is as far off: its simulation failed, or left the room."""
NO_SECANTS: Mapping[str, float] = MappingProxyType({})
"""No parameter without a derivative."""


class WindowPrior(NamedTuple):
    """By parameter name the `mean` and the standard deviation `sd` of the coordinate that a fit moves, and the lowest
    and the highest value, `limits`, of those that have others than their domain."""

    mean: Mapping[str, float]
    sd: Mapping[str, float]
    limits: Mapping[str, tuple[float, float]]

    def domains(self, problem: Problem, names: Sequence[str]) -> dict[str, Domain]:
        """The domains of the parameters `names` within their limits."""
        domains = dict(zip(names, domains_of(problem.model, names), strict=True))
        return {
            name: domain._replace(**dict(zip(("low", "high"), self.limits[name], strict=True)))
            if name in self.limits
            else domain
            for name, domain in domains.items()
        }


class WindowPoint(NamedTuple):
    """Where a fit of windows stands: parameter `values` by name, start states `start` (R, S) of all runs, and whether
    it has converged."""

    values: dict[str, float]
    start: np.ndarray
    converged: bool = False


class WindowColumns(NamedTuple):
    """W windows linearised: `residual` (W, m) in noise standard deviations, its derivatives `by_values` (W, m, K) by
    the coordinates of K parameters and `by_start` (W, m, S) by the free start states; `samples` (W,)."""

    residual: Float[np.ndarray, "W m"]
    by_values: Float[np.ndarray, "W m K"]
    by_start: Float[np.ndarray, "W m S"]
    samples: Float[np.ndarray, " W"]

    @property
    def mean_square(self) -> Float[np.ndarray, " W"]:
        """c_w (W,)."""
        square = np.where(np.isfinite(self.residual), self.residual, np.sqrt(LARGEST)) ** 2
        return np.minimum(square.sum(axis=1) / self.samples, LARGEST)

    @property
    def without_starts(self) -> tuple[Float[np.ndarray, "W m"], Float[np.ndarray, "W m K"]]:
        """Residual and columns orthogonal to the start state of their window (Golub and Pereyra 1973)."""
        size = np.sqrt((self.by_start**2).sum(axis=1, keepdims=True))
        basis, values, _ = np.linalg.svd(self.by_start / np.where(size > 0, size, 1.0), full_matrices=False)
        basis = basis * (values > UNSEEN)[:, None, :]

        def projected(columns):
            return columns - basis @ (basis.transpose(0, 2, 1) @ columns)

        return projected(self.residual[..., None])[..., 0], projected(self.by_values)


def scale_of(mean_square: Float[np.ndarray, " W"]) -> float:
    """s^2 of windows of these mean squares."""
    return EFFICIENT * max(float(np.median(mean_square)), 1e-12)


def weights_of(mean_square: Float[np.ndarray, " W"], scale: float) -> Float[np.ndarray, " W"]:
    """The weight (W,) of each window under the scale s^2."""
    return 1.0 / (1.0 + mean_square / scale)


def variance_of(columns: WindowColumns) -> float:
    """phi, the variance of a sample of a window that counts as one pose."""
    return max(float(np.median(columns.mean_square)), 1e-12) * float(np.median(columns.samples)) / POSE


def linearised_windows(
    problem: Problem,
    point: WindowPoint,
    names: Sequence[str],
    windows: Sequence[int],
    until: float = np.inf,
    secants: Mapping[str, float] = NO_SECANTS,
) -> WindowColumns:
    """The `windows` (numbers of runs) linearised by the parameters `names`, `problem.width` of them at a time.

    Of the parameters in `secants` the derivative is a difference quotient over that step, central where the domain has
    room on both sides: at a jump of a held command the derivative by a delay is that of one side.
    """
    columns = _derivatives(problem, point, names, windows, until)
    for k, name in enumerate(names):
        if name in secants:
            columns.by_values[..., k] = _quotient(problem, point, name, secants[name], columns, windows, until)
    return columns


def _quotient(problem: Problem, point: WindowPoint, name: str, step: float, columns: WindowColumns, windows, until):
    """The difference quotient (W, m) of the residuals by one parameter; zero where a simulation failed."""
    domain, value = domains_of(problem.model, [name])[0], point.values[name]

    def residual(at: float) -> np.ndarray:
        return _derivatives(problem, point._replace(values={**point.values, name: at}), [], windows, until).residual

    above = residual(value + step)
    low = value - step if value - step > domain.low else value
    below = columns.residual if low == value else residual(low)
    with np.errstate(invalid="ignore"):
        quotient = (above - below) / (value + step - low)
    return np.where(np.all(np.isfinite(quotient), axis=1)[:, None], quotient, 0.0)


def _derivatives(
    problem: Problem, point: WindowPoint, names: Sequence[str], windows: Sequence[int], until: float
) -> WindowColumns:
    """The `windows` linearised by derivatives alone."""
    parts, residual, starts = [], None, None
    for k in range(0, max(len(names), 1), problem.width):
        some = list(names[k : k + problem.width])
        # All directions are in use, so that one compiled program serves any number of parameters.
        some += [name for name in problem.names if name not in some][: problem.width - len(some)]
        linearised = problem.evaluate(problem.at(point.values, some, point.start), windows, until)
        jacobian = np.asarray(linearised.jacobian)[list(windows)].reshape(
            len(windows), -1, linearised.jacobian.shape[-1]
        )
        residual = np.asarray(linearised.residual)[list(windows)].reshape(len(windows), -1)
        starts = jacobian[..., problem.width :] * np.asarray(problem.batch.free_start)[list(windows)][:, None, :]
        parts.append(jacobian[..., : min(problem.width, len(names) - k)])
    assert residual is not None and starts is not None
    weight = np.asarray(problem.batch.weight)[list(windows)] > 0
    early = np.asarray(problem.batch.times)[list(windows)] <= until
    samples = np.maximum((weight & early[..., None]).sum(axis=(1, 2)), 1).astype(float)
    finite = np.all(np.isfinite(residual), axis=1) & np.all(np.isfinite(starts), axis=(1, 2))
    by_values = np.concatenate(parts, axis=-1)
    finite &= np.all(np.isfinite(by_values), axis=(1, 2))
    # A window whose simulation failed says nothing of the parameters; its residual stays infinite.
    by_values[~finite], starts[~finite] = 0.0, 0.0
    residual = np.where(finite[:, None], residual, np.inf)
    return WindowColumns(residual, by_values, starts, samples)


@kept_fit
def fit_windows_robustly(
    problem: Problem,
    point: WindowPoint,
    free: Sequence[str],
    windows: Sequence[int],
    prior: WindowPrior,
    *,
    until: float = np.inf,
    secants: Mapping[str, float] = NO_SECANTS,
) -> WindowPoint:
    """The `free` parameters and the start states of the `windows` fitted from `point`, by damped Gauss-Newton steps.

    The weights are those of the last step; the start states are eliminated window by window (Golub and
    Pereyra 1973).
    """
    domains = prior.domains(problem, free)
    now = linearised_windows(problem, point, free, windows, until, secants)
    damping, rejected, converged = FIRST_DAMPING, 0, False
    for _ in range(MOST):
        scale, phi = scale_of(now.mean_square), variance_of(now)
        step, moves = _step(now, point, domains, prior, scale, phi, damping)
        start = point.start.copy()
        start[list(windows)] += moves
        moved = {name: d.moved_inside(point.values[name], step[k]) for k, (name, d) in enumerate(domains.items())}
        trial = WindowPoint({**point.values, **moved}, start)
        then = linearised_windows(problem, trial, free, windows, until, secants)
        before = _cost(now, point, domains, prior, scale, phi)
        after = _cost(then, trial, domains, prior, scale, phi)
        if not after < before:
            damping, rejected = damping * 10, rejected + 1
            if rejected >= REJECTED:
                converged = True
                break
            continue
        point, now, rejected = trial, then, 0
        damping = max(damping / 10, LEAST_DAMPING)
        if before - after < LITTLE * before:
            converged = True
            break
    return point._replace(converged=converged)


def _pulls(point: WindowPoint, domains, prior: WindowPrior, phi: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean (K,) and precision (K,) of the prior of a step from `point`."""
    mean = [prior.mean[name] - domain.step_to(point.values[name]) for name, domain in domains.items()]
    return np.array(mean), phi / np.array([prior.sd[name] for name in domains]) ** 2


def _cost(columns: WindowColumns, point: WindowPoint, domains, prior: WindowPrior, scale: float, phi: float) -> float:
    mean, precision = _pulls(point, domains, prior, phi)
    loss = columns.samples * scale * np.log1p(columns.mean_square / scale)
    return float(loss.sum() + (precision * mean**2).sum())


def _step(now: WindowColumns, point: WindowPoint, domains, prior, scale: float, phi: float, damping: float):
    """A damped step (K,) of the parameters, inside their domains, and (W, S) of the starts."""
    weight = np.sqrt(weights_of(now.mean_square, scale))[:, None]
    residual = np.where(np.isfinite(now.residual), now.residual, 0.0) * weight
    J, S = now.by_values * weight[..., None], now.by_start * weight[..., None]
    depth = S.shape[2]
    # Rows below hold the start near the recorded one, and damp it.
    size2 = (S**2).sum(axis=1)
    below = np.sqrt(damping * size2 + phi / START_SD[:depth] ** 2)
    basis, triangle = np.linalg.qr(np.concatenate([S, below[..., None] * np.eye(depth)], axis=1))
    upper = basis[:, : residual.shape[1]].transpose(0, 2, 1)
    inside, rest = upper @ J, (upper @ residual[..., None])[..., 0]
    normal = np.einsum("wmk,wml->kl", J, J) - np.einsum("wsk,wsl->kl", inside, inside)
    slope = np.einsum("wmk,wm->k", J, residual) - np.einsum("wsk,ws->k", inside, rest)
    mean, precision = _pulls(point, domains, prior, phi)
    loose = np.ones(len(domains), bool)
    while True:
        step = np.zeros(len(domains))
        A = normal[np.ix_(loose, loose)]
        A = A + np.diag(damping * np.maximum(np.diag(A), 0.0) + precision[loose])
        step[loose] = scaled_inverse(A) @ (precision * mean - slope)[loose]
        step = np.clip(step, -LONGEST, LONGEST)
        leaving = np.array(
            [
                (point.values[name] <= d.low and step[k] < 0) or (point.values[name] >= d.high and step[k] > 0)
                for k, (name, d) in enumerate(domains.items())
            ],
            bool,
        )
        if not leaving.any():
            break
        loose &= ~leaving
    return step, -np.linalg.solve(triangle, (rest + inside @ step)[..., None])[..., 0]
