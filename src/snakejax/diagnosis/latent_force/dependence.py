"""On what does the missing force depend? Regressions in the residuals of the windows, tested on runs left out.

A hypothesis such as "a yaw moment that depends on the rotor rate" is a family of histories f of the free force, so it
is a linear regression in the same residuals, and is tested on the runs it was not fitted to.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.periodogram import fundamental_frequency

from ..selection.criteria import CRITERIA, SelectionCriteria
from .estimate import ForceEstimator, ForceSolution
from .force_sensitivity import MotionSamples
from .piecewise_force import SPACING


class FittedFunction(NamedTuple):
    """How the missing action depends on `variable`: at the values `at` (m,) or (m, 2) it is `value` (m, c).

    `carrier` says what the value is: "X", "Y", "N" a component of the wrench; "world" a force along the world's axes;
    "grip" a relative change of the lateral forces; "drag" [N s/m] against (u, w); "yaw_drag" [N m s] against r.
    """

    variable: str
    feature: str
    carrier: str
    at: np.ndarray
    value: np.ndarray


class Design(NamedTuple):
    """One family of histories: `variable` through `feature`, acting on `carrier`; `columns` of the regression."""

    variable: str
    feature: str
    carrier: str
    terms: Callable[[np.ndarray], np.ndarray]
    columns: slice


class _Feature(NamedTuple):
    """A variable as a regression sees it: `values` (..., W, n), and its terms (T, W, n) from values like it.

    For the two wheelsets, `sides` are their own values where these differ.
    """

    name: str
    values: np.ndarray
    terms: Callable[[np.ndarray], np.ndarray]
    sides: tuple[np.ndarray, np.ndarray] | None = None


Terms = Callable[[np.ndarray], np.ndarray]


def _polynomial(values: np.ndarray, degree: int) -> Terms:
    """Legendre polynomials over the range of `values`, held constant beyond it."""
    low, high = np.percentile(values, [0.5, 99.5])
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-9)

    def terms(values: np.ndarray) -> np.ndarray:
        z = np.clip((values - middle) / half, -1.0, 1.0)
        return np.moveaxis(np.polynomial.legendre.legvander(z, degree), -1, 0)

    return terms


def _harmonics(most: int) -> Terms:
    """1, cos, sin and so on up to `most` times the angle."""

    def terms(values: np.ndarray) -> np.ndarray:
        turns = [part(k * values) for k in range(1, most + 1) for part in (np.cos, np.sin)]
        return np.stack([np.ones_like(values), *turns])

    return terms


def _plane(places: np.ndarray, degree: int) -> Terms:
    """Linear or quadratic in both coordinates of the place, seen from the middle of all places."""
    centre = places.reshape(2, -1).mean(axis=1)
    size = max(float(np.abs(places.reshape(2, -1) - centre[:, None]).max()), 1e-9)

    def terms(values: np.ndarray) -> np.ndarray:
        x, y = ((values[k] - centre[k]) / size for k in range(2))
        return np.stack([np.ones_like(x), x, y, x**2, x * y, y**2][: 3 if degree == 1 else 6])

    return terms


def _phase(drive: ForceEstimator, motion: MotionSamples) -> np.ndarray:
    """The phase [rad] of the fundamental of each run's steering, or of its rotor where the steering rests.

    It is that of a sine: zero where the joint passes the middle on its way up.
    """
    phase = np.zeros_like(motion.time)
    for k in range(len(drive.runs)):
        in_run = drive.owner == k
        t = motion.time[in_run].ravel()
        named = {name: values for name, values in motion.inputs.items() if not name.endswith("_rate")}
        joints = [values[in_run].ravel() for values in named.values()] or [np.zeros(t.size)]
        angle = next((joint for joint in joints if np.std(joint) > 1e-6), joints[-1])
        angle = angle - angle.mean()
        # Windows may overlap and leave gaps.
        order = np.argsort(t)
        even = np.linspace(t.min(), t.max(), t.size)
        w = fundamental_frequency(even, np.interp(even, t[order], angle[order]))
        start = np.angle(np.exp(-1j * w * t) @ angle)
        phase[in_run] = np.mod(w * motion.time[in_run] + start + np.pi / 2, 2 * np.pi)
    return phase


def _features(drive: ForceEstimator, track: MotionSamples) -> dict[str, list[_Feature]]:
    """Each variable, as a few features: stiff ones, which go far beyond what was seen, and flexible ones."""

    def plain(name: str, values: np.ndarray, sides=None) -> list[_Feature]:
        over = values if sides is None else np.stack(sides)
        return [_Feature(name, values, _polynomial(over, degree), sides) for degree in (2, 5)]

    def turning(name: str, angles: np.ndarray) -> list[_Feature]:
        return [_Feature(name, angles, _harmonics(most)) for most in (1, 2)]

    place = np.stack([track.x, track.y])
    slip, angle = track.wheels["slip_speed"], track.wheels["slip_angle"]
    return {
        "world_position": [_Feature("place", place, _plane(place, degree)) for degree in (1, 2)],
        "heading": turning("heading", track.heading),
        "speed": plain("speed", np.hypot(track.u, track.w)),
        "slip": plain("slip_speed", (slip[0] + slip[1]) / 2, slip)
        + plain("slip_angle", (angle[0] + angle[1]) / 2, angle),
        **{name: plain(name, values) for name, values in track.inputs.items()},
        "time": plain("time", track.time),
        "gait_phase": turning("gait_phase", _phase(drive, track)),
    }


PERIODIC = ("heading", "gait_phase")
WORLD = ("world_position", "heading", "time")
"""The variables on which a force along the axes of the world may depend."""


def _histories(feature: _Feature, variable: str, track: MotionSamples) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By carrier: histories of the wrench (T, W, n, 3) and of the grip of both sides (T, W, n, 2)."""
    g = feature.terms(feature.values)
    none, zero = np.zeros((*g.shape, 2)), np.zeros_like(g)
    along = {
        "X": [(g, zero, zero)],
        "Y": [(zero, g, zero)],
        "N": [(zero, zero, g)],
        "drag": [(-g * track.u, -g * track.w, zero)],
        "yaw_drag": [(zero, zero, -g * track.r)],
    }
    if variable in WORLD:
        c, s = np.cos(track.theta), np.sin(track.theta)
        along["world"] = [(g * c, -g * s, zero), (g * s, g * c, zero)]
    histories = {
        name: (np.concatenate([np.stack(part, axis=-1) for part in parts]), np.concatenate([none] * len(parts)))
        for name, parts in along.items()
    }
    sides = feature.sides or (feature.values, feature.values)
    grip = np.stack([feature.terms(side) for side in sides], axis=-1)
    histories["grip"] = (np.zeros((*g.shape, 3)), grip)
    return histories


class _Gram(NamedTuple):
    """Normal equations of one run in the parameters and all designs; `square` is that of the data."""

    matrix: np.ndarray
    right: np.ndarray
    square: float


def _regressions(
    drive: ForceEstimator, now: ForceSolution
) -> tuple[list[Design], list[_Gram], dict[str, list[_Feature]]]:
    """All designs, and the normal equations of each run."""
    track, P = now.linearised.track, len(drive.names)
    features, designs, force, grip = _features(drive, track), [], [], []
    count = P
    for variable, forms in features.items():
        for feature in forms:
            for carrier, (wrench, change) in _histories(feature, variable, track).items():
                designs.append(
                    Design(variable, feature.name, carrier, feature.terms, slice(count, count + len(wrench)))
                )
                count += len(wrench)
                force.append(wrench)
                grip.append(change)
    wrench, change = np.concatenate(force), np.concatenate(grip)
    K, grams = drive.knots, [_Gram(np.zeros((count, count)), np.zeros(count), 0.0) for _ in drive.runs]
    for k, window in enumerate(now.windows):
        run = drive.owner[k]
        first = drive.began[run] + SPACING * drive.first[k]
        hats = np.maximum(1 - np.abs((track.time[k][:, None] - first) / SPACING - np.arange(K)), 0.0)
        # Least squares onto the knots; one that no sample touches stays at zero.
        onto = np.linalg.solve(hats.T @ hats + 1e-6 * np.eye(K), hats.T)
        f, g = (
            np.tensordot(onto, histories[:, k], (1, 1)).transpose(0, 2, 1).reshape(-1, len(histories))
            for histories in (wrench, change)
        )
        H = np.concatenate([window.parameters, window.force @ f + window.grip @ g], axis=1)
        matrix, right, square = grams[run]
        grams[run] = _Gram(matrix + H.T @ H, right + H.T @ window.data, square + float(window.data @ window.data))
    return designs, grams, features


class _Scored(NamedTuple):
    """A design with the fall of chi^2 on runs left out, and the strength of the ridge that predicts best."""

    design: Design
    fall: float
    ridge: float


RIDGES = (1e-6, 1e-4, 1e-2, 1e-1)
"""Ridge penalties that cross validation chooses from, relative to the scale of the coefficients."""


class _CrossValidation:
    """Regressions fitted to all runs but one, and tested on that one."""

    def __init__(self, grams: Sequence[_Gram], typical: tuple[np.ndarray, np.ndarray]):
        self.grams, self.typical, self.P = grams, typical, len(typical[0])
        self.matrix = np.sum([gram.matrix for gram in grams], axis=0)
        self.right = np.sum([gram.right for gram in grams], axis=0)
        self.others = [(self.matrix - gram.matrix, self.right - gram.right) for gram in grams]
        self.without = [self.left(k, slice(0, 0), 0.0) for k in range(len(grams))]

    def solved(self, matrix: np.ndarray, right: np.ndarray, columns: slice, ridge: float) -> np.ndarray:
        """Coefficients of the parameters and of the design in `columns`."""
        pick = np.r_[0 : self.P, columns]
        pull, precision = self.typical
        extra = np.concatenate([precision, ridge * np.diag(self.matrix)[columns]])
        A = matrix[np.ix_(pick, pick)] + np.diag(extra)
        b = right[pick] + np.concatenate([precision * pull, np.zeros(len(pick) - self.P)])
        size = np.sqrt(np.diag(A))
        safe = np.where(size > 0, size, 1.0)
        return np.linalg.lstsq(A / np.outer(safe, safe), b / safe, rcond=1e-12)[0] / safe

    def left(self, k: int, columns: slice, ridge: float) -> float:
        """chi^2 of run `k` under a regression fitted to the others."""
        gram, pick = self.grams[k], np.r_[0 : self.P, columns]
        c = self.solved(*self.others[k], columns, ridge)
        return gram.square - 2 * float(gram.right[pick] @ c) + float(c @ gram.matrix[np.ix_(pick, pick)] @ c)

    def scored(self, design: Design) -> _Scored:
        """The fall of chi^2 on runs left out, at the best ridge."""
        runs = range(len(self.grams))
        falls = [sum(self.without[k] - self.left(k, design.columns, ridge) for k in runs) for ridge in RIDGES]
        best = int(np.argmax(falls))
        return _Scored(design, float(falls[best]), RIDGES[best])

    def fitted(self, scored: _Scored) -> np.ndarray:
        """The coefficients of a design in a regression on all runs."""
        return self.solved(self.matrix, self.right, scored.design.columns, scored.ridge)[self.P :]


def dependence(
    drive: ForceEstimator, now: ForceSolution, criteria: SelectionCriteria = CRITERIA
) -> tuple[tuple[tuple[str, float], ...], FittedFunction | None]:
    """The share of the misfit above noise that each variable explains on runs left out, and how the best one acts."""
    designs, grams, features = _regressions(drive, now)
    validation = _CrossValidation(grams, drive.typical(now.point.values))
    dof = float((np.asarray(drive.batch.weight) > 0).sum() - np.asarray(drive.batch.free_start).sum())
    excess = max(sum(validation.without) - dof, 0.0) + criteria.force_excess_sd * np.sqrt(2 * dof)
    scored = sorted((validation.scored(design) for design in designs), key=lambda s: -s.fall)
    best: dict[str, _Scored] = {}
    for one in scored:
        best.setdefault(one.design.variable, one)
    shares = tuple((name, float(np.clip(one.fall / excess, 0.0, 1.0))) for name, one in best.items())
    if shares[0][1] < criteria.least_force_share:
        return shares, None
    won = best[shares[0][0]]
    feature = next(f for f in features[won.design.variable] if f.terms is won.design.terms)
    return shares, _shape(won.design, feature, validation.fitted(won))


def _shape(design: Design, feature: _Feature, coefficients: np.ndarray) -> FittedFunction:
    """The action over the range of its variable."""
    if design.variable == "world_position":
        ranges = [np.linspace(np.percentile(part, 2), np.percentile(part, 98), 6) for part in feature.values]
        at = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, 2)
        terms = feature.terms(at.T)
    else:
        low, high = np.percentile(feature.values if feature.sides is None else np.stack(feature.sides), [2, 98])
        low, high = (-np.pi, np.pi) if design.variable in PERIODIC else (low, high)
        at = np.linspace(low, high, 25)
        terms = feature.terms(at)
    return FittedFunction(
        design.variable, design.feature, design.carrier, at, terms.T @ coefficients.reshape(-1, len(terms)).T
    )
