"""The windows of a free force, reduced to what regressions on histories of force and grip need."""

import ast
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.formula import evaluated, parsed
from snakejax.dynamics.law import OF_EACH_WHEEL, PLACE_OF_WHEEL, WHEEL_VARIABLES

from ..latent_force.estimate import ForceEstimator, ForceSolution
from ..latent_force.force_sensitivity import MotionSamples
from ..latent_force.piecewise_force import SPACING
from .knots import KnotFit, KnotMeans, hats_at
from .terms import PLACE, Family, Range

NOT_ALONE = ("axle", "rolling_speed")
"""Variables of a wheel of which no form is a function: one has two values, the other is nearly the speed of the
body."""
FINEST = 0.02
"""Samples nearer to each other [s] are left out: the knots of the force are five times as far apart."""

NEAR = 1e-4
"""Places so far [m] to both sides of a wheel give the slope on which it stands."""


def variables_of(
    track: MotionSamples, arranged: Callable[[np.ndarray], np.ndarray]
) -> tuple[dict[str, np.ndarray], tuple[str, ...], dict[str, np.ndarray]]:
    """What a law needs of a motion, each of the wheels ahead of the middle and of those behind it.

    The variables (2, W, n), among them accelerations of joints, and the names of those of a wheel; the wrenches (2, 3,
    W, n) of what acts at a wheel. `arranged` puts the samples of one into windows (W, n).
    """
    own = {name: getattr(track, name) for name in ("time", "x", "y", "heading", "theta", "u", "w", "r")}
    own |= {"speed": np.hypot(track.u, track.w), **track.inputs, **track.accelerations}
    variables = {name: np.stack([arranged(np.asarray(values))] * 2) for name, values in own.items()}
    if np.allclose(own["theta"], own["heading"], rtol=0, atol=1e-6):
        variables.pop("theta")
    for name in WHEEL_VARIABLES:
        variables[name] = np.stack([arranged(np.asarray(side)) for side in track.wheels[name]])
    at_wheels = {
        name: np.array([[arranged(np.asarray(part)) for part in side] for side in sides])
        for name, sides in track.at_wheels.items()
    }
    return variables, WHEEL_VARIABLES, at_wheels


class Fitted(NamedTuple):
    """Forms of law at G values of their shape: amplitudes (G, T), parameter steps (G, P), chi^2 (G,) of all runs and,
    summed, of each run under the fit to the others."""

    amplitudes: np.ndarray
    steps: np.ndarray
    chi2: np.ndarray
    left_out: np.ndarray


Calls = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
"""Functions evaluated at one shape, by their text, for the wheels ahead and behind."""


class ForceWindows(NamedTuple):
    """W windows at n samples with K knots.

    `variables` (2, W, n) for the wheels ahead of the middle and behind it, the names of those of a `wheel`, and the
    wrenches (2, 3, W, n) of what acts `at_wheels`, see `MotionSamples`; `onto_knots`: the knots of a history (G, W, n);
    per window the normal equations `matrix` (W, P + 5K, P + 5K), `right` of parameters, force knots and grip knots;
    `square` (R,); `owner` (W,): the run; `prior_mean` and `precision` (P,) of the parameters; `theta` (W, n). `beside`:
    the parameters beside a law are those of all runs, and only the law is fitted anew where a run is left out.
    """

    variables: dict[str, np.ndarray]
    wheel: tuple[str, ...]
    at_wheels: dict[str, np.ndarray]
    onto_knots: KnotFit | KnotMeans
    matrix: np.ndarray
    right: np.ndarray
    square: np.ndarray
    owner: np.ndarray
    prior_mean: np.ndarray
    precision: np.ndarray
    theta: np.ndarray
    samples: int
    beside: bool = False

    @staticmethod
    def of(estimator: ForceEstimator, solution: ForceSolution) -> "ForceWindows":
        """The windows of `estimator` at `solution`."""
        track, K = solution.linearised.track, estimator.knots
        spacing = float(np.median(np.diff(track.time[0])))
        pick = slice(None, None, max(1, int(FINEST / spacing + 1e-6)))
        every_hat, matrix, right, square = [], [], [], np.zeros(len(estimator.runs))
        for k, window in enumerate(solution.windows):
            first = estimator.began[estimator.owner[k]] + SPACING * estimator.first[k]
            every_hat.append(hats_at(track.time[k][pick], first, K))
            H = np.concatenate([window.parameters, window.force, window.grip], axis=1)
            matrix.append(H.T @ H)
            right.append(H.T @ window.data)
            square[estimator.owner[k]] += float(window.data @ window.data)
        of_motion = variables_of(track, lambda values: values[:, pick])
        prior_mean, precision = estimator.typical(solution.point.values)
        count = int((np.asarray(estimator.batch.weight) > 0).sum() - np.asarray(estimator.batch.free_start).sum())
        whole = (
            KnotFit.of(np.array(every_hat)),
            np.array(matrix),
            np.array(right),
            square,
            np.asarray(estimator.owner),
        )
        return ForceWindows(*of_motion, *whole, prior_mean, precision, track.theta[:, pick], count)

    def keeping(self, columns: np.ndarray) -> "ForceWindows":
        """With only the parameters numbered `columns`."""
        P = len(self.prior_mean)
        kept = np.concatenate([columns, np.arange(P, self.matrix.shape[-1])]).astype(int)
        return self._replace(
            matrix=self.matrix[:, kept][:, :, kept],
            right=self.right[:, kept],
            prior_mean=self.prior_mean[columns],
            precision=self.precision[columns],
        )

    def ranges(self) -> dict[str, Range]:
        """What was seen of each variable that varies, and of the angle and the rate of each joint in the world."""
        own = {name: values for name, values in self.variables.items() if name not in NOT_ALONE}
        frame = "theta" if "theta" in own else "heading"
        of_joints = [name for name in own if name.endswith(("_angle", "_rate")) and name not in self.wheel]
        in_world = {name: frame if name.endswith("_angle") else "r" for name in of_joints}
        histories_of = own | {f"({name} + {of})": own[name] + self.variables[of] for name, of in in_world.items()}
        ends = {name: Range(*np.percentile(values, [2, 98])) for name, values in histories_of.items()}
        return {name: interval for name, interval in ends.items() if interval.high - interval.low > 1e-6}

    def places(self) -> np.ndarray:
        """Where (M, 2) the vehicle was at each sample."""
        return np.stack([self.variables[name][0].ravel() for name in PLACE], axis=1)

    def histories(self, family: Family, shape: Mapping[str, np.ndarray], calls: Calls | None = None) -> np.ndarray:
        """The knots (G, T, W, 5K) of each term at G values of the `shape`: force knot by knot, then grip. `calls`:
        functions that other forms have evaluated at this shape."""
        T = len(family.terms)
        if family.together:
            # Each term is the function with one of its amplitudes 1 and the others 0.
            alone = {term.amplitude: row[:, None, None] for term, row in zip(family.terms, np.eye(T), strict=True)}
            return self._acting(family.together, alone, T)[None]
        G = max((len(values) for values in shape.values()), default=1)
        wide = {name: np.asarray(values)[:, None, None] for name, values in shape.items()}
        each = [self._acting(term.formulas, wide, G, calls) for term in family.terms]
        return np.stack(each, axis=1) if each else np.zeros((G, 0, len(self.theta), 5 * self.onto_knots.knots))

    def _acting(
        self,
        formulas: Sequence[tuple[str, str]],
        wide: dict[str, np.ndarray],
        count: int,
        calls: Calls | None = None,
    ) -> np.ndarray:
        """The knots (G, W, 5K) of what `formulas` set, by component, with `count` = G values of those in `wide`."""
        (W, n), K = self.theta.shape, self.onto_knots.knots
        c, s = np.cos(self.theta), np.sin(self.theta)
        knots, wrench, on_wheels = np.zeros((count, W, 5 * K)), {}, [0.0, 0.0, 0.0]
        for component, formula in formulas:
            tree = parsed(formula or "1")
            for side in (0, 1) if component in OF_EACH_WHEEL else (0,):
                known = {name: values[side] for name, values in self.variables.items()} | wide
                if component in ("lateral", "resistance", "height"):
                    on_side = self._at_wheels(component, tree, known, side)
                    on_wheels = [total + one for total, one in zip(on_wheels, on_side, strict=True)]
                    continue
                value = evaluated(tree, known, np, None if calls is None else calls[side])
                value = np.broadcast_to(value, (count, W, n))
                if component == "grip":
                    knots[:, :, 3 * K + side :: 2] = self.onto_knots(value)
                else:
                    wrench[component] = value
        east, north = wrench.get("east", 0.0), wrench.get("north", 0.0)
        along = (east * c + north * s, north * c - east * s, 0.0) if {"east", "north"} & set(wrench) else (0.0,) * 3
        for k, name in enumerate(("X", "Y", "N")):
            total = along[k] + wrench.get(name, 0.0) + on_wheels[k]
            if isinstance(total, np.ndarray):
                knots[:, :, k : 3 * K : 3] = self.onto_knots(np.broadcast_to(total, (count, W, n)))
        return knots

    def _at_wheels(
        self, component: str, tree: ast.expr, known: Mapping[str, np.ndarray], side: int
    ) -> list[np.ndarray]:
        """The wrench of a formula for a force against the slip or the rolling of the wheels of one `side`, or for the
        height of the floor under them."""
        if component != "height":
            return [-evaluated(tree, known, np) * part for part in self.at_wheels[component][side]]
        steep_x, steep_y = (_slope(tree, known, name) for name in PLACE_OF_WHEEL)
        falls = zip(*(self.at_wheels[name][side] for name in ("fall_x", "fall_y")), strict=True)
        return [-steep_x * fall_x - steep_y * fall_y for fall_x, fall_y in falls]

    def normal(self, histories: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The normal equations (R, G, P + T, P + T) and (R, G, P + T) of parameters and amplitudes, run by run."""
        P, (G, T, W, _), R = len(self.prior_mean), histories.shape, len(self.square)
        # A form acts on few of the knots.
        used = P + np.flatnonzero(histories.any(axis=(0, 1, 2)))
        rows = np.concatenate([np.arange(P), used])
        h = histories[..., used - P].transpose(2, 3, 0, 1).reshape(W, len(used), G * T)
        crossed = (self.matrix[:, rows][:, :, used] @ h).reshape(W, len(rows), G, T)
        h = h.reshape(W, len(used), G, T)
        of_run = (self.owner == np.arange(R)[:, None]).astype(float)

        def by_run(parts: np.ndarray) -> np.ndarray:
            return (of_run @ parts.reshape(W, -1)).reshape(R, *parts.shape[1:])

        full, onto_full = np.zeros((R, G, P + T, P + T)), np.zeros((R, G, P + T))
        full[..., :P, :P] = by_run(self.matrix[:, :P, :P])[:, None]
        mixed = by_run(crossed[:, :P])
        full[..., :P, P:], full[..., P:, :P] = mixed.transpose(0, 2, 1, 3), mixed.transpose(0, 2, 3, 1)
        full[..., P:, P:] = by_run(np.einsum("wjgt,wjgs->wgts", h, crossed[:, P:], optimize=True))
        onto_full[..., :P] = by_run(self.right[:, :P])[:, None]
        onto_full[..., P:] = by_run(np.einsum("wj,wjgt->wgt", self.right[:, used], h, optimize=True))
        return full, onto_full

    def fitted(self, histories: np.ndarray, penalty: np.ndarray | None = None) -> Fitted:
        """The regressions on G sets of `histories`; `penalty` (G, T, T): a quadratic form of the amplitudes that is
        added to chi^2, in multiples of what an amplitude of 1 alone adds to it, their mean."""
        P = len(self.prior_mean)
        matrix, right = self.normal(histories)
        total, slope = matrix.sum(axis=0), right.sum(axis=0)
        if penalty is not None:
            penalty = np.einsum("gii->g", total[:, P:, P:])[:, None, None] / penalty.shape[1] * penalty
        c = self._solved(total, slope, total, penalty)
        chi2 = self.square.sum() + _quadratic(total, slope, c)
        d = self._solved(total - matrix, slope - right, total, penalty)
        if self.beside:
            rest = slope[:, :P] - (total[:, :P, P:] @ d[..., P:, None])[..., 0]
            d[..., :P] = self._solved(total[:, :P, :P], rest, total[:, :P, :P])
        left = self.square.sum() + _quadratic(matrix, right, d).sum(axis=0)
        return Fitted(c[:, P:], c[:, :P], chi2, left)

    def _solved(
        self, matrix: np.ndarray, right: np.ndarray, total: np.ndarray, penalty: np.ndarray | None = None
    ) -> np.ndarray:
        """Parameter steps and amplitudes (..., G, P + T), with a light ridge and a `penalty` (G, T, T) on those."""
        P, size = len(self.prior_mean), right.shape[-1]
        ridge = 1e-6 * np.diagonal(total, axis1=-2, axis2=-1) + 1e-12
        ridge[:, :P] = self.precision
        full = right.copy()
        full[..., :P] += self.precision * self.prior_mean
        A = matrix + ridge[:, :, None] * np.eye(size)
        if penalty is not None:
            A[..., P:, P:] += penalty
        # What moves nothing but by rounding, and has no prior, stays where it is.
        diagonal = np.diagonal(A, axis1=-2, axis2=-1)
        moves = diagonal > 0
        scale = moves / np.sqrt(np.where(moves, diagonal, 1.0))
        scaled = A * scale[..., :, None] * scale[..., None, :] + 1e-12 * np.eye(size)
        return np.linalg.solve(scaled, (full * scale)[..., None])[..., 0] * scale


def _slope(tree: ast.expr, known: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """The derivative of a formula by the variable `name`, from its values `NEAR` to both sides."""
    above, below = (evaluated(tree, {**known, name: known[name] + step}, np) for step in (NEAR, -NEAR))
    return (above - below) / (2 * NEAR)


def _quadratic(matrix: np.ndarray, slope: np.ndarray, at: np.ndarray) -> np.ndarray:
    """z^T matrix z - 2 slope^T z `at` z (..., n)."""
    return (at * ((matrix @ at[..., None])[..., 0] - 2 * slope)).sum(axis=-1)
