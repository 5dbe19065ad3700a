"""From what a file holds to the planar motion of one object in it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.errors import InputError, instead_of

from .capture import X_AXIS_DIRECTIONS, Body, Capture, FileAnnotations
from .cells import shown
from .rigid_body import LEAST_SPREAD, Placed, placed
from .rotations import AXES, heading_of, unwrapped, upright

FEWEST_SAMPLES = 10
"""Samples below which no object counts as tracked."""
FARTHEST = 1e9
"""A pose beyond [m, rad] is a damaged number."""
WORST_TEMPLATE = 0.2
"""Usual residual of the markers, as a share of their spread, above which the template is wrong."""


class PoseTrack(NamedTuple):
    """The planar motion of one object: frame `rate` [Hz], `times` [s] (n,) of every frame from 0 at the first, and
    `pose` (n, 3) of x [m], y [m] and the unwrapped heading [rad], NaN where the frame was lost. `notes` say what in its
    file was decided by its data.
    """

    rate: float
    times: Float[np.ndarray, " n"]
    pose: Float[np.ndarray, "n 3"]
    notes: Sequence[str] = ()


def body_of(capture: Capture, object: str, hints: FileAnnotations) -> Body:
    """The body called `object`, or the one whose markers it names, fitted to where `hints` says that they sit.

    **Raises:** `InputError` where there is none, or there are several.
    """
    if object in capture.doubled:
        times = 1 + sum(name == object for name in capture.doubled)
        what = f'The object "{shown(object)}" is there {times} times'
        raise InputError(what, capture.where, "rename or remove all but one")
    if object in capture.bodies:
        return capture.bodies[object]
    if [*capture.bodies] == [""]:
        return capture.bodies[""]  # A table of one body without a name: call it as you like.
    if hints.markers:
        return fitted(capture, object, hints)[0]
    prefixes = subjects(capture)
    if object in prefixes or ("" in prefixes and not capture.bodies):
        what = f'The file holds markers of "{shown(object)}", but not their places on the board'
        remedy = "give markers = {name = [x, y, z], ...} in m from the board's middle, or use `snakejax import`"
        raise InputError(what, capture.where, remedy)
    raise InputError(
        f'There is no object "{shown(object)}" in the file',
        capture.where,
        listed(object, [name for name in (*capture.bodies, *prefixes) if name]),
    )


def fitted(capture: Capture, object: str, hints: FileAnnotations) -> tuple[Body, Placed]:
    """The body whose markers sit where `hints.markers` says, by name with or without that of `object` before it.

    **Raises:** `InputError` where a marker is not there, there are too few, or they do not keep the template's shape.
    """
    assert hints.markers is not None
    names = []
    for name in hints.markers:
        marker = next((full for full in (f"{object}:{name}", name) if full in capture.markers), None)
        if marker is None or marker in capture.doubled:
            what = (
                f'There is no marker "{shown(name)}"' if marker is None else f'The marker "{shown(name)}" appears twice'
            )
            remedy = listed(name, [*capture.markers]) if marker is None else "rename or remove all but one"
            raise InputError(f"{what} in the file", capture.where, remedy)
        names.append(marker)
    template = np.array([hints.markers[name] for name in hints.markers], float)
    spread = float(np.sqrt(((template - template.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if len(template) < 2 or spread < LEAST_SPREAD:
        raise InputError(
            "At least two markers at different places are needed", capture.where, "give more under markers"
        )
    turn = upright(up_by(capture, hints))
    points = np.stack([capture.markers[name] for name in names], axis=1)
    place = placed(template, points @ turn.T, AXES["z"])
    usual = float(np.nanmedian(place.residual)) if np.isfinite(place.residual).any() else 0.0
    if usual > WORST_TEMPLATE * spread:
        what = f"The markers are usually {1e3 * usual:.0f} mm off where the template has them"
        raise InputError(what, capture.where, "measure where they sit on the board, in m, and check their names")
    # The fit is made where z is up; a body keeps the axes of its file.
    back = turn.T
    rotation = np.concatenate([place.rotation[:, :3] @ back.T, place.rotation[:, 3:]], axis=1)
    return Body(capture.times, place.position @ back.T, rotation, capture.where), place


def subjects(capture: Capture) -> dict[str, list[str]]:
    """The markers of each subject: `board:front` belongs to `board`; one without a colon belongs to ``."""
    markers: dict[str, list[str]] = {}
    for name in capture.markers:
        markers.setdefault(name.rpartition(":")[0], []).append(name)
    return markers


def listed(word: str, known: Sequence[str], most: int = 12) -> str:
    """The remedy for an unknown name, which lists a few of those that are there."""
    names = [shown(name) for name in known]
    return instead_of(word, names if len(names) <= most else [*names[:most], "..."])


def pose_track(capture: Capture, object: str, hints: FileAnnotations = FileAnnotations()) -> PoseTrack:  # noqa: B008
    """The planar motion of `object`. **Raises:** `InputError`."""
    track = planar(body_of(capture, object, hints), up_by(capture, hints), capture.rate, object)
    notes = [*capture.assumed]
    if object in capture.angles:
        notes.append(f"RX, RY, RZ are {capture.angles[object].description}")
    if hints.up is None and capture.up_said:
        notes.append(f"up is {capture.up}: {capture.up_said}")
    return track._replace(pose=track.pose - np.array([0.0, 0.0, X_AXIS_DIRECTIONS[hints.x_axis]]), notes=notes)


def up_by(capture: Capture, hints: FileAnnotations) -> str | Sequence[float]:
    """What points up, by a user or by the file. **Raises:** `InputError` where neither tells."""
    if hints.up is not None:
        return hints.up
    if capture.up_open:
        what = f"Neither the {capture.format} nor the motion of its markers shows which way is up"
        raise InputError(what, capture.where, 'say it: up = "y" or up = "z" in case.toml, option --up')
    return capture.up


def planar(body: Body, up: str | Sequence[float], rate: float | None, name: str) -> PoseTrack:
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
    return PoseTrack(rate, times, pose)
