"""Where and when a model fails: misfits over stretches of time, and the worst moments."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ._recording import CHANNELS
from ._scenes import Track


class Stretch(NamedTuple):
    """The misfit, mean e^2 over `samples`, of one channel of one run from `begin` to `end` [s]; 1 is noise."""

    run: str
    channel: str
    begin: float
    end: float
    misfit: float
    samples: int


class Moment(NamedTuple):
    """A sample far from the model: measured minus modelled in standard deviations and in m or rad."""

    run: str
    time: float
    channel: str
    deviations: float
    size: float


def stretches(track: Track, length: float = 1.0) -> tuple[Stretch, ...]:
    """The misfit of each channel over equal stretches of about `length` [s]; those without a sample are left out."""
    edges = _edges(track.times, length)
    bins = np.clip(np.searchsorted(edges, track.times, side="right") - 1, 0, edges.size - 2)
    found = []
    for c, channel in enumerate(CHANNELS):
        seen = np.isfinite(track.residual[:, c])
        count = np.bincount(bins[seen], minlength=edges.size - 1)
        total = np.bincount(bins[seen], track.residual[seen, c] ** 2, edges.size - 1)
        found += [
            Stretch(track.run, channel, float(edges[b]), float(edges[b + 1]), float(total[b] / count[b]), int(count[b]))
            for b in np.flatnonzero(count)
        ]
    return tuple(found)


def _edges(times: np.ndarray, length: float) -> np.ndarray:
    number = max(round(float(times[-1] - times[0]) / length), 1)
    return np.linspace(times[0], times[-1], number + 1)


def worst(seen: Sequence[Track], count: int = 8, length: float = 1.0) -> tuple[Moment, ...]:
    """The `count` samples furthest from the model, in standard deviations, no two of a channel within `length` [s]."""
    found: list[Moment] = []
    for moment in sorted(_peaks(seen, length), key=lambda m: -abs(m.deviations)):
        near = (
            m.run == moment.run and m.channel == moment.channel and abs(m.time - moment.time) < length for m in found
        )
        if len(found) < count and not any(near):
            found.append(moment)
    return tuple(found)


def _peaks(seen: Sequence[Track], length: float) -> Iterator[Moment]:
    """The furthest sample of each half `length` of each channel."""
    for track in seen:
        bins = np.floor((track.times - track.times[0]) / (length / 2))
        for c, channel in enumerate(CHANNELS):
            size = np.nan_to_num(np.abs(track.residual[:, c]), nan=-1.0)
            for b in np.unique(bins[size >= 0]):
                k = int(np.argmax(np.where(bins == b, size, -1.0)))
                e = float(track.residual[k, c])
                yield Moment(track.run, float(track.times[k]), channel, e, e * float(track.sd[c]))
