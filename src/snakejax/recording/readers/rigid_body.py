"""A rigid body from labelled markers: weighted Kabsch over all frames at once, some markers missing or swapped.

A frame fits when its markers, put where the template says, are off by no more than frames usually are. One that does
not is tried with two labels swapped, three labels turned round, or one marker left out, and is lost where none fits.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.rotations import nearest_rotations

from .rotations import from_matrix

AT_ONCE = 50_000
"""Frames that are fitted at once, to limit the memory."""
# Weight of "the board's z points up" beside the markers: next to nothing, yet enough for two markers to fix a heading.
UPRIGHT_WEIGHT = 1e-6
LEAST_SPREAD = 0.005
"""Markers [m] nearer to each other do not show a heading."""
WORST_OVER_BEST = 10.0
LEAST_LIMIT = 0.001
"""A frame is bad above so many times the residual of the best tenth of the frames, and above this residual [m]."""
FEWEST_TO_TRUST = 3
MOST_TO_TURN = 9
"""Markers that a corrected frame must keep, and up to which rotations of three labels are tried; their number grows as
m^3."""


class Placed(NamedTuple):
    """`position` [m] (n, 3) of the template's origin and `rotation` (n, 4), NaN where lost, `residual` [m] (n,), the
    root mean square distance of the markers used to their places, and the numbers of frames that were mended.
    """

    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    residual: Float[np.ndarray, " n"]
    swapped: int
    left_out: int
    lost: int


def kabsch(
    template: Float[np.ndarray, "m 3"],
    points: Float[np.ndarray, "n m 3"],
    up: Float[np.ndarray, "3"],
    weights: Float[np.ndarray, " m"] | None = None,
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """The rotations R and translations t that minimise sum_j w_j |R a_j + t - p_j|^2, and the root mean square left.

    Markers that are NaN weigh nothing. Where fewer than two markers apart from each other, seen from above, are left,
    all is NaN. R is the rotation nearest to H = sum_j w_j (a_j - a)(p_j - p)^T.
    """
    present = np.asarray(np.isfinite(points).all(axis=2))
    w = present * (np.ones(len(template)) if weights is None else weights)
    total = np.maximum(w.sum(axis=1), 1e-300)
    known = np.where(present[..., None], points, 0.0)
    a = w @ template / total[:, None]
    p = np.einsum("nm,nmi->ni", w, known) / total[:, None]
    A = template - a[:, None]
    P = known - p[:, None]
    spread = np.einsum("nm,nmi->n", w, A[..., :2] ** 2) / total
    H = np.einsum("nm,nmi,nmj->nij", w, A, P, optimize=True)
    scale = UPRIGHT_WEIGHT * np.einsum("nm,nmi->n", w, A**2)
    H += scale[:, None, None] * np.outer([0.0, 0.0, 1.0], up)
    R = nearest_rotations(H)
    t = p - np.einsum("nij,nj->ni", R, a)
    off = np.einsum("nij,nmj->nmi", R, A) - P
    residual = np.sqrt(np.einsum("nm,nmi->n", w, off**2) / total)
    loose = (present.sum(axis=1) < 2) | (spread < LEAST_SPREAD**2)
    R[loose], t[loose], residual[loose] = np.nan, np.nan, np.nan
    return R, t, residual


def placed(
    template: Float[np.ndarray, "m 3"],
    points: Float[np.ndarray, "n m 3"],
    up: Float[np.ndarray, "3"],
    weights: Float[np.ndarray, " m"] | None = None,
) -> Placed:
    """The pose of the template in every frame; frames that do not fit are corrected, or count as lost."""
    parts = [kabsch(template, points[i : i + AT_ONCE], up, weights) for i in range(0, len(points), AT_ONCE)]
    R, t, residual = (np.concatenate(part) for part in zip(*parts, strict=True))
    limit = limit_of(residual)
    with np.errstate(invalid="ignore"):
        bad = np.flatnonzero(residual > limit)
    swapped = left_out = 0
    for change, keeps in _changes(len(template)):
        if not bad.size:
            break
        better = _best(template, points[bad], up, weights, change)
        mended = better[2] <= limit
        rows = bad[mended]
        R[rows], t[rows], residual[rows] = (part[mended] for part in better)
        swapped, left_out = swapped + keeps * int(mended.sum()), left_out + (not keeps) * int(mended.sum())
        bad = bad[~mended]
    R[bad], t[bad], residual[bad] = np.nan, np.nan, np.nan
    rotation = np.concatenate([from_matrix(R[i : i + AT_ONCE]) for i in range(0, len(R), AT_ONCE)])
    return Placed(t, rotation, residual, swapped, left_out, int(np.isnan(residual).sum()))


def limit_of(residual: Float[np.ndarray, " n"]) -> float:
    """Above what a frame does not fit: ten times what the best tenth of them has, but not below a millimetre.

    The best tenth, as labels may be swapped in most frames; of the residual of three markers it is half the median.
    """
    finite = residual[np.isfinite(residual)]
    return max(WORST_OVER_BEST * float(np.quantile(finite, 0.1)), LEAST_LIMIT) if finite.size else np.inf


def _changes(m: int) -> Iterator[tuple[list[list[int]], bool]]:
    """Families of ways to read the labels, likelier ones first, and whether they keep all markers (-1: left out)."""
    same = list(range(m))

    def moved(places: Sequence[int], to: Sequence[int]) -> list[int]:
        order = same.copy()
        for place, source in zip(places, to, strict=True):
            order[place] = source
        return order

    yield [moved((i, j), (j, i)) for i, j in itertools.combinations(same, 2)], True
    yield [moved((i,), (-1,)) for i in same], False
    if 2 < m <= MOST_TO_TURN:
        turns = [(p, q) for p in itertools.combinations(same, 3) for q in (p[1:] + p[:1], p[2:] + p[:2])]
        yield [moved(places, to) for places, to in turns], True


def _best(
    template: np.ndarray,
    points: np.ndarray,
    up: np.ndarray,
    weights: np.ndarray | None,
    changes: list[list[int]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best of `changes` in each frame, infinitely bad where too few markers are left to trust it."""
    n = len(points)
    best = (np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan), np.full(n, np.inf))
    padded = np.concatenate([points, np.full((n, 1, 3), np.nan)], axis=1)
    for order in changes:
        tried = padded[:, order]
        for start in range(0, n, AT_ONCE):
            part = slice(start, start + AT_ONCE)
            alternative = kabsch(template, tried[part], up, weights)
            enough = np.isfinite(tried[part]).all(axis=2).sum(axis=1) >= FEWEST_TO_TRUST
            with np.errstate(invalid="ignore"):
                better = enough & (alternative[2] < best[2][part])
            for old, new in zip(best, alternative, strict=True):
                old[part][better] = new[better]
    return best
