"""Where and when a model fails: misfits over stretches of time, and the worst moments."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.dynamics.observation import CHANNELS

from .replays import ResidualSeries


class IntervalMisfit(NamedTuple):
    """The misfit, mean e^2 over `samples`, of one channel of one run from `begin` to `end` [s]; 1 is noise."""

    run: str
    channel: str
    begin: float
    end: float
    misfit: float
    samples: int


class LargestResidual(NamedTuple):
    """A sample far from the model: measured minus modelled in standard deviations and in m or rad."""

    run: str
    time: float
    channel: str
    deviations: float
    size: float


def interval_misfits(track: ResidualSeries, length: float = 1.0) -> tuple[IntervalMisfit, ...]:
    """The misfit of each channel over equal stretches of about `length` [s]; those without a sample are left out."""
    edges = _edges(track.times, length)
    bins = np.clip(np.searchsorted(edges, track.times, side="right") - 1, 0, edges.size - 2)
    misfits = []
    for c, channel in enumerate(CHANNELS):
        present = np.isfinite(track.residual[:, c])
        count = np.bincount(bins[present], minlength=edges.size - 1)
        total = np.bincount(bins[present], track.residual[present, c] ** 2, edges.size - 1)
        misfits += [
            IntervalMisfit(
                track.run, channel, float(edges[b]), float(edges[b + 1]), float(total[b] / count[b]), int(count[b])
            )
            for b in np.flatnonzero(count)
        ]
    return tuple(misfits)


def _edges(times: np.ndarray, length: float) -> np.ndarray:
    number = max(round(float(times[-1] - times[0]) / length), 1)
    return np.linspace(times[0], times[-1], number + 1)


def largest_residuals(
    series: Sequence[ResidualSeries], count: int = 8, length: float = 1.0
) -> tuple[LargestResidual, ...]:
    """The `count` samples furthest from the model, in standard deviations, no two of a channel within `length` [s]."""
    largest: list[LargestResidual] = []
    for moment in sorted(_peaks(series, length), key=lambda m: -abs(m.deviations)):
        near = (
            m.run == moment.run and m.channel == moment.channel and abs(m.time - moment.time) < length for m in largest
        )
        if len(largest) < count and not any(near):
            largest.append(moment)
    return tuple(largest)


def _peaks(series: Sequence[ResidualSeries], length: float) -> Iterator[LargestResidual]:
    """The furthest sample of each half `length` of each channel."""
    for track in series:
        bins = np.floor((track.times - track.times[0]) / (length / 2))
        for c, channel in enumerate(CHANNELS):
            size = np.nan_to_num(np.abs(track.residual[:, c]), nan=-1.0)
            for b in np.unique(bins[size >= 0]):
                k = int(np.argmax(np.where(bins == b, size, -1.0)))
                e = float(track.residual[k, c])
                yield LargestResidual(track.run, float(track.times[k]), channel, e, e * float(track.sd[c]))
