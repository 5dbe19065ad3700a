"""From what a file holds to the planar motion of one object in it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._errors import InputError, instead_of
from ._capture import Body, Capture, Hints
from ._text import shown
from ._turn import heading_of, unwrapped, upright

FEWEST_SAMPLES = 10
FARTHEST = 1e9


class Track(NamedTuple):
    """The planar motion of one object: frame `rate` [Hz], `times` [s] (n,) of every frame from 0 at the first, and
    `pose` (n, 3) of x [m], y [m] and the unwrapped heading [rad], NaN where the frame was lost.
    """

    rate: float
    times: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]


def body_of(capture: Capture, object: str, hints: Hints) -> Body:
    """The body called `object`, or the one whose markers it names, fitted to where `hints` says that they sit.

    **Raises:** `InputError` where there is none, or there are several.
    """
    if object in capture.doubled:
        times = 1 + sum(name == object for name in capture.doubled)
        what = f'The object "{shown(object)}" is there {times} times'
        raise InputError(what, capture.where, "rename or remove all but one")
    if object in capture.bodies:
        return capture.bodies[object]
    there = [*capture.bodies, *subjects(capture)]
    raise InputError(f'There is no object "{shown(object)}" in the file', capture.where, listed(object, there))


def subjects(capture: Capture) -> dict[str, list[str]]:
    """The markers of each subject: `board:front` belongs to `board`; one without a colon belongs to ``."""
    found: dict[str, list[str]] = {}
    for name in capture.markers:
        found.setdefault(name.rpartition(":")[0], []).append(name)
    return found


def listed(word: str, there: Sequence[str], most: int = 12) -> str:
    """The remedy for an unknown name, which lists a few of those that are there."""
    names = [shown(name) for name in there]
    return instead_of(word, names if len(names) <= most else [*names[:most], "..."])


def track_of(capture: Capture, object: str, hints: Hints = Hints()) -> Track:  # noqa: B008
    """The planar motion of `object`. **Raises:** `InputError`."""
    return planar(body_of(capture, object, hints), hints.up or capture.up, capture.rate, object)


def planar(body: Body, up: str | Sequence[float], rate: float | None, name: str) -> Track:
    """The motion of `body` seen from above, times counted from its first row; `rate` as in `Capture`.

    **Raises:** `InputError` where too few samples are present, time does not increase, or a position is absurd.
    """
    turn = upright(up)
    pose = np.full((len(body.times), 3), np.nan)
    if body.heading is not None:
        pose[:, :2], pose[:, 2] = body.position[:, :2], body.heading
    else:
        pose[:, :2] = (body.position @ turn.T)[:, :2]
        pose[:, 2] = heading_of(body.rotation, turn)
    pose[np.isnan(pose).any(axis=1)] = np.nan
    present = int(np.isfinite(pose[:, 0]).sum())
    if present < FEWEST_SAMPLES:
        what = f'Only {present} samples of "{shown(name)}" are present, but at least {FEWEST_SAMPLES} are needed'
        raise InputError(what, body.where, "check that the object was tracked, or leave this run out")
    if np.nanmax(np.abs(pose)) > FARTHEST:
        what = f'"{shown(name)}" is {np.nanmax(np.abs(pose)):.2g} m away'
        raise InputError(what, body.where, "check the file: such a distance is a damaged number")
    pose[:, 2] = unwrapped(pose[:, 2])
    steps = np.diff(body.times)
    if (backwards := np.flatnonzero(~(steps > 0))).size:
        row = int(backwards[0])
        what = f'Time of "{shown(name)}" goes from {body.times[row]:.9g} s to {body.times[row + 1]:.9g} s'
        remedy = f"sort the rows by time and keep one for each (row {row + 2} of its data)"
        raise InputError(f"{what}: it runs backwards or stands still", body.where, remedy)
    times = body.times - body.times[0]
    rate = rate or 1.0 / float(np.median(steps))
    if not (math.isfinite(rate) and math.isfinite(times[-1])):
        raise InputError(f'The clock of "{shown(name)}" has no finite span', body.where, "check its time stamps")
    return Track(rate, times, pose)
