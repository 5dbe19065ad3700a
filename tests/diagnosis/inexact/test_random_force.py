"""The history of the random force against a force that acts in made-up runs."""

import dataclasses
from collections import OrderedDict
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.small_case import small

from snakejax import Model, Pacejka, simulate
from snakejax.diagnosis.inexact.candidate_model import CandidateModel
from snakejax.diagnosis.inexact.random_force import random_force
from snakejax.diagnosis.inexact.search import Point, Search
from snakejax.dynamics.law import LawParameter, law_class
from snakejax.estimation.discrepancy.kalman import Discrepancy
from snakejax.estimation.discrepancy.segments import Segments

NOISE = np.array([3e-4, 3e-4, 1e-3])


@pytest.mark.slow
def test_a_steady_force_is_found_where_and_as_large_as_it_acts() -> None:
    """0.2 N along the board and 0.04 N m; near the ends of a run less is known."""
    case, _, _ = small()
    push = law_class("X = a; N = 0.2 * a", (LawParameter("a", "N"),))
    tyre, rng = Pacejka(8.0, 1.3, 0.9, 0.2), np.random.default_rng(0)
    model = Model(case.board, tyre, "free", OrderedDict(push=push()))
    true = Model(case.board, tyre, "free", OrderedDict(push=push(a=0.2)))
    runs = []
    for run in case.runs:
        pose = np.asarray(simulate(true, run.gait, run.times, (0.1, 0.2, 0.3)).pose)
        runs.append(dataclasses.replace(run, pose=pose + NOISE * rng.normal(size=pose.shape)))
    names, values = ("tyre.D", "effects.push.a"), np.array([0.9, 0.0])
    segments = Segments(model, runs, names)
    priors = CandidateModel(model, names, values, np.ones(2), OrderedDict(), {}, (0, 1), (0,), ())
    search = Search(segments, priors, SimpleNamespace())  # type: ignore[arg-type]
    strength = Discrepancy(NOISE, 0.01 * NOISE, 0.2, np.array([0.2, 0.05, 0.04]), 2.0)
    force = random_force(search, Point(values, segments.guess(), strength, ()), switched=False)
    assert force.is_random
    forces = force.runs
    assert [one.run for one in forces] == [run.name for run in runs]
    off = []
    for one, run in zip(forces, runs, strict=True):
        assert one.t[0] == pytest.approx(float(run.times[0]) + 0.125, abs=0.01)
        inner = (one.t > 1.0) & (one.t < one.t[-1] - 1.0)
        off.append((one.force[inner] - [0.2, 0.0, 0.04]) / one.sd[inner])
        assert (one.sd[inner] < [0.06, 0.04, 0.016]).all()
    assert np.abs(np.concatenate(off)).max() < 4.0
    assert np.sqrt((np.concatenate(off) ** 2).mean()) < 1.5
