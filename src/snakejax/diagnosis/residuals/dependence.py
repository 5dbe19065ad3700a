"""What does a residual depend on? The share that goes with each variable, and what chance explains."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from snakejax.core.autocorrelation import memory
from snakejax.dynamics.observation import CHANNELS

from .replays import ResidualSeries

RATES = ("forward_rate", "sideways_rate", "heading_rate")
KNOTS = 6
HARMONICS = 3
SPAN = 0.25
"""The rate of a residual is taken over this time [s]: short against a gait, long against a frame."""
LEVEL = 0.05
"""Level of the test of all pairs of a variable and a channel together."""
CIRCULAR = ("gait_phase", "heading")
"""Variables that are angles: what depends on them has no beginning and no end."""


class VarianceShare(NamedTuple):
    """The share of a channel's residual variance that goes with a variable; see `residual_dependence`.

    `channel` is one of CHANNELS or RATES. `p_value` is that of this pair alone, `p_family` that of the best among all
    pairs that were looked at.
    """

    variable: str
    channel: str
    share: float
    p_value: float
    p_family: float


def residual_dependence(
    series: Sequence[ResidualSeries], *, flips: int = 999, seed: int = 0
) -> tuple[VarianceShare, ...]:
    """The share of each channel's residual that is a function of each variable alone, the largest first.

    Both the residual e and its rate (see `rate`) are looked at, each run and channel at its own root mean square, so
    that all runs count alike. With Q an orthonormal basis of curves over the variable (straight lines between `KNOTS`
    quantiles; `HARMONICS` sines and cosines of an angle), without what is constant in each run, and blocks b,

        z_b = Q_b^T e_b        R^2 = |sum_b z_b|^2 / |e|^2        share = (R^2 - R0^2) / (1 - R0^2)

    where R0^2 = sum_b |z_b|^2 / |e|^2 is what chance explains: the mean of R^2 over all signs of the blocks. Flipping
    signs at random gives the p-value (the wild bootstrap of Wu 1986, by blocks): it keeps how residuals hang together
    within a block, and blocks are as long as they do. The family's p-value is that of the largest standardised cube
    root of R^2 over all pairs, under the same flips in a channel. A variable that stands still is left out.
    """
    if not series:
        return ()
    random = np.random.default_rng(seed)
    rates = [track._replace(residual=rate(track)) for track in series]
    named = [*_flipped(series, CHANNELS, flips, random), *_flipped(rates, RATES, flips, random)]
    if not named:
        return ()
    pairs, observed, chance, null = zip(*named, strict=True)
    return _ranked(pairs, np.array(observed), np.array(chance), np.array(null))


def significant_shares(shares: Sequence[VarianceShare]) -> tuple[VarianceShare, ...]:
    """The shares that are not chance, at `LEVEL` for all of them together, in their order."""
    return tuple(share for share in shares if share.p_family <= LEVEL)


def general_name(variable: str) -> str:
    """The variable of a missing force that `variable` of a residual is a part of: x and y are the place in the world,
    and each wheelset has a slip of its own."""
    if variable in ("x", "y"):
        return "world_position"
    return "slip" if variable.startswith("slip_") else variable


def rate(track: ResidualSeries) -> Float[np.ndarray, "n 3"]:
    """The rate of change of the residual over `SPAN` [standard deviations / s], NaN where an end of it is missing.

    It forgets what accumulated before, and is turned into the frame of the modelled board: forward, sideways, heading.
    """
    step = float(track.times[-1] - track.times[0]) / (track.times.size - 1)
    half = max(round(SPAN / 2 / step), 1)
    velocity = np.full_like(track.residual, np.nan)
    velocity[half:-half] = (track.residual[2 * half :] - track.residual[: -2 * half]) / (2 * half * step)
    cosine, sine = np.cos(track.variables["heading"]), np.sin(track.variables["heading"])
    east, north, turn = velocity.T
    return np.stack([cosine * east + sine * north, cosine * north - sine * east, turn], axis=1)


def _flipped(
    series: Sequence[ResidualSeries], channels: Sequence[str], flips: int, random: np.random.Generator
) -> Iterator[tuple]:
    """For each variable and channel: their names, R^2, R0^2, and R^2 under each of the flips (flips,)."""
    for c, channel in enumerate(channels):
        block = blocks(series, c)
        signs = random.choice([-1.0, 1.0], (flips, int(block.max()) + 1))
        residual = np.concatenate([_alike(track.residual[:, c]) for track in series])
        present = np.isfinite(residual)
        centre = _centring(series, present)
        e = centre(residual[present])
        square = float(e @ e)
        for variable in series[0].variables:
            values = np.concatenate([track.variables[variable] for track in series])[present]
            if square == 0.0 or np.ptp(values) == 0.0:
                continue
            Q = _orthonormal(centre(curves(values, variable in CIRCULAR)))
            z = _sums(Q * e[:, None], block[present], signs.shape[1])
            chance, observed = float((z**2).sum()), float((z.sum(axis=0) ** 2).sum())
            if chance > 0.0:
                null = ((signs @ z) ** 2).sum(axis=1) / square
                yield (variable, channel), observed / square, chance / square, null


def _alike(residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    present = np.isfinite(residual)
    size = float(residual[present].std()) if present.any() else 0.0
    return residual / size if size > 0.0 else residual


def _ranked(pairs, observed, chance, null) -> tuple[VarianceShare, ...]:
    tamed, tamed_observed = np.cbrt(null), np.cbrt(observed)
    mean, sd = tamed.mean(axis=1), np.maximum(tamed.std(axis=1), 1e-12)
    largest = ((tamed - mean[:, None]) / sd[:, None]).max(axis=0)
    share = np.clip((observed - chance) / np.maximum(1 - chance, 1e-12), 0.0, 1.0)
    alone = (1 + (null >= observed[:, None]).sum(axis=1)) / (1 + null.shape[1])
    family = (1 + (largest >= ((tamed_observed - mean) / sd)[:, None]).sum(axis=1)) / (1 + null.shape[1])
    shares = [
        VarianceShare(variable, channel, float(share[k]), float(alone[k]), float(family[k]))
        for k, (variable, channel) in enumerate(pairs)
    ]
    return tuple(sorted(shares, key=lambda s: -s.share))


def curves(values: Float[np.ndarray, " n"], circular: bool) -> Float[np.ndarray, "n k"]:
    """Columns that span the curves over `values`: harmonics of an angle, else hats on quantiles."""
    if circular:
        turns = np.arange(1, HARMONICS + 1) * values[:, None]
        return np.concatenate([np.cos(turns), np.sin(turns)], axis=1)
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, KNOTS)))
    return np.stack([np.interp(values, knots, hat) for hat in np.eye(knots.size)], axis=1)


def _centring(series: Sequence[ResidualSeries], present: Bool[np.ndarray, " n"]) -> Callable[[np.ndarray], np.ndarray]:
    """A function that takes the mean of each run out of the columns of what is present."""
    run = np.repeat(np.arange(len(series)), [track.times.size for track in series])[present]
    count = np.maximum(np.bincount(run, minlength=len(series)), 1)

    def centre(columns: np.ndarray) -> np.ndarray:
        table = columns.reshape(run.size, -1)
        means = _sums(table, run, len(series)) / count[:, None]
        return (table - means[run]).reshape(columns.shape)

    return centre


def _sums(table: Float[np.ndarray, "n k"], group: Int[np.ndarray, " n"], groups: int) -> Float[np.ndarray, "groups k"]:
    """The sums of the rows of each group."""
    return np.stack([np.bincount(group, column, groups) for column in table.T], axis=1)


def _orthonormal(columns: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n r"]:
    sizes, vectors = np.linalg.eigh(columns.T @ columns)
    firm = sizes > 1e-8 * columns.shape[0]
    return columns @ (vectors[:, firm] / np.sqrt(sizes[firm]))


def blocks(series: Sequence[ResidualSeries], channel: int, shortest: float = 0.1) -> Int[np.ndarray, " n"]:
    """The number of the block of each sample of all runs.

    In each run a block lasts four times as long as the residual of `channel` takes to forget itself (correlation below
    0.1), so a whole period where it swings; at least `shortest` [s], at most half of the run.
    """
    numbers, first = [], 0
    for track in series:
        span = float(track.times[-1] - track.times[0])
        forgotten = memory(track.residual[None, :, channel]) * span / (track.times.size - 1)
        within = max(int(span / max(min(4 * forgotten, span / 2), shortest)), 1)
        own = np.minimum((track.times - track.times[0]) / span * within, within - 0.5).astype(int)
        numbers.append(first + own)
        first += within
    return np.concatenate(numbers)
