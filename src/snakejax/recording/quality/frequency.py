"""Frequencies of the joints in another unit: the board then swings 2 pi times as fast as they say, or as slowly.

The yaw rate follows the rotor and the steering at their frequencies (see `conventions`), and the push along the board
at combinations of these (see `push`). So each joint is tried at its frequencies as they are given, at 2 pi times and at
1 / 2 pi of them, whatever the measures of the board, its axes and its signs.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.periodogram import fundamental_frequency
from snakejax.dynamics.inputs import Gait, as_gait
from snakejax.dynamics.signals import AbstractSignal, Sines, Tracked
from snakejax.vehicles.snakeboard.board import Board

from ..run import Run
from .conventions import evidence_in
from .finding import Finding
from .joint_motion import JointMotion, angles, joint_motion
from .push import RunMotion, pushes, together

TURN = 2 * np.pi
BELIEVED = 0.25
"""Other frequencies are reported if the product of the shares of yaw rate and push that they leave is less than this
part of that of the given ones: if each share is about halved."""
HARDLY = 0.5
"""If frequencies leave more than this share of the yaw rate, they are not those of the board."""
Pace = tuple[float, float]
"""Factors on the frequencies of phi and of psi."""


class _Tried(NamedTuple):
    """A pace, and the shares that it leaves of the `yaw` rate and of the `push`; of `each` run's, the square."""

    pace: Pace
    yaw: float
    push: float
    each: Float[np.ndarray, " R"]


def frequencies(runs: Sequence[Run], board: Board) -> list[Finding]:
    """Frequencies of `runs` with which no board moves as this does, though with 2 pi times as large ones one would, or
    with as much smaller ones.
    """
    besides = [
        (run, motion, RunMotion.of(run))
        for run in runs
        if _periodic(run) and (motion := joint_motion(run, 0.0)) is not None
    ]
    moving = [any(_tones(getattr(run.gait, name)).size for run, *_ in besides) for name in ("phi", "psi")]
    paces = itertools.product(*((1.0, TURN, 1 / TURN) if moves else (1.0,) for moves in moving))
    tried = [_tried(besides, board, pace) for pace in paces] if besides else []
    if not tried or (given := tried[0]) is None:
        return []
    best = min((one for one in tried if one is not None), key=lambda one: one.yaw * one.push)
    if best.yaw > HARDLY or not best.yaw * best.push < BELIEVED * given.yaw * given.push:
        return []
    return [_finding(*besides[int(np.argmax(given.each - best.each))][:2], best.pace)]


def _finding(run: Run, motion: JointMotion, pace: Pace) -> Finding:
    joints = [name for name, factor in zip(("phi", "psi"), pace, strict=True) if factor != 1]
    given = {name: " and ".join(f"{w:.2g}" for w in _tones(getattr(run.gait, name))) for name in joints}
    if len(set(given.values())) == 1:
        at = f"{' and '.join(joints)} {'are' if len(joints) > 1 else 'is'} at {given[joints[0]]}"
    else:
        at = ", ".join(f"{name} is at {frequency}" for name, frequency in given.items())
    swing, slow = f"{fundamental_frequency(motion.times, motion.r):#.2g}".rstrip("."), max(pace) > 1
    question = "are these Hz?" if slow else "are these 2 pi times too high?"
    what = f"the board swings at {swing} rad/s in {run.name}, {at}: {question}"
    remedy = f"{'multiply' if slow else 'divide'} the frequencies of {' and '.join(joints)} by 2 pi: they are in rad/s"
    return Finding("frequency_unit", what, remedy, 0.0, 0.0, size=TURN, severity="refused")


def _tried(besides: Sequence[tuple[Run, JointMotion, RunMotion | None]], board: Board, pace: Pace) -> _Tried | None:
    evidence, paced = [], []
    for run, motion, watched in besides:
        gait = _at_pace(as_gait(run.gait), pace)
        phi, psi = (angles(signal, motion.fine) for signal in (gait.phi, gait.psi))
        evidence.append(evidence_in(motion._replace(phi=phi, psi=psi)))
        paced += [] if watched is None else [watched._replace(gait=gait)]
    push = together(pushes(paced, board))
    square = sum(one.square for one in evidence)
    if push is None or not square > 0:
        return None
    left = np.array([one.left for one in evidence])
    unpushed = float(push.left(*map(np.asarray, push.best()))) / push.square
    return _Tried(pace, float(left.sum(axis=0).min() / square), max(unpushed, 1e-6), left.min(axis=1))


def _at_pace(gait: Gait, pace: Pace) -> Gait:
    phi, psi = pace
    back = None if gait.phi_back is None else _faster(gait.phi_back, phi)
    return Gait(_faster(gait.phi, phi), _faster(gait.psi, psi), back)


def _faster(signal: AbstractSignal, factor: float) -> AbstractSignal:
    if isinstance(signal, Tracked):
        return dataclasses.replace(signal, command=_faster(signal.command, factor))
    assert isinstance(signal, Sines)
    return dataclasses.replace(signal, frequency=factor * signal.frequency)


def _periodic(run: Run) -> bool:
    """Whether the gait of `run` is one of sines, and not of logs."""
    gait = as_gait(run.gait)
    joints = (gait.phi, gait.psi, gait.phi_back)
    return all(isinstance(_command(joint), Sines) for joint in joints if joint is not None)


def _command(signal: AbstractSignal) -> AbstractSignal:
    return signal.command if isinstance(signal, Tracked) else signal


def _tones(signal: AbstractSignal) -> Float[np.ndarray, " k"]:
    """The frequencies at which `signal` moves."""
    sines = _command(signal)
    assert isinstance(sines, Sines)
    frequency = np.asarray(sines.frequency)
    return frequency[(np.asarray(sines.amplitude) != 0) & (frequency != 0)]
