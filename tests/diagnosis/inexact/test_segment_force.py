"""The windows of a free force on segments, against the derivatives of simulations with a law in the model."""

from collections import OrderedDict
from functools import cache
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from helpers.small_case import small

from snakejax import Model, Pacejka
from snakejax.diagnosis.inexact import segment_force
from snakejax.diagnosis.inexact.candidate_model import CandidateModel
from snakejax.diagnosis.inexact.left_out import LeftOut
from snakejax.diagnosis.inexact.search import Linear, Point, Search
from snakejax.diagnosis.inexact.segment_force import force_windows, motions_of
from snakejax.diagnosis.law.terms import Family, Term
from snakejax.dynamics.law import LawParameter, law_class
from snakejax.estimation.discrepancy.kalman import Discrepancy, gram_matrices, segment_data
from snakejax.estimation.discrepancy.open_loop import open_loop
from snakejax.estimation.discrepancy.segment_dynamics import BODY, FORCE
from snakejax.estimation.discrepancy.segments import Segments
from snakejax.estimation.fit_journal import keep_fits

NAMES = (
    "tyre.D",
    "effects.push.a",
    "effects.north.a",
    "effects.grip.a",
    "effects.rolling.a",
    "effects.height.a",
    "effects.lateral.a",
)
DISCREPANCY = Discrepancy(np.array([3e-4, 3e-4, 1e-3]), np.array([5e-4, 5e-4, 1.5e-3]), 0.2, np.full(3, 0.05), 0.6)
LAWS = {
    **{"push": "X = a; N = 0.3 * a", "north": "north = a", "grip": "grip = 1 - a", "rolling": "resistance = a"},
    "height": "height = a * wheel_x * wheel_y",
    "lateral": "lateral = a",
}


@cache
def problem() -> tuple[Search, Linear]:
    """Two short runs linearised by the grip of the tyre and by three laws that change slowly, if at all."""
    case, _, _ = small()
    laws = {name: law_class(text, (LawParameter("a", "N"),))() for name, text in LAWS.items()}
    model = Model(case.board, Pacejka(8.0, 1.3, 0.9, 0.2), "free", OrderedDict(laws))
    segments = Segments(model, case.runs, NAMES)
    values, z = np.array([0.9, *np.zeros(6)]), segments.guess()
    z[:, -FORCE:] = np.random.default_rng(0).normal(size=(len(z), FORCE)) * 0.01
    data = segment_data(segments.cut, segments.linearise(values, z), z)
    priors = CandidateModel(model, NAMES, values, np.ones(7), OrderedDict(), {}, tuple(range(7)), (0,), ())
    search = Search(segments, priors, SimpleNamespace())  # type: ignore[arg-type]
    gram, _ = gram_matrices(data, DISCREPANCY)
    return search, Linear(Point(values, z, DISCREPANCY, ()), data, gram, search.subsets(values, gram.sum(axis=0)))


def term(*components: tuple[str, str]) -> Family:
    return Family("made", "", (), (Term("a", {}, components),))


FAMILIES = {
    "push": (term(("X", "1"), ("N", "0.3")), 1e-6),
    "grip": (term(("grip", "-1")), 1e-6),
    # The wheels turn with the steering, which is known at the middle of a segment here.
    "rolling": (term(("resistance", "1")), 0.02),
    "lateral": (term(("lateral", "1")), 0.02),
    "height": (term(("height", "wheel_x * wheel_y")), 0.02),
    # It turns with the board, which is known at the middle of a segment here.
    "north": (term(("north", "1")), 0.02),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_the_column_of_a_law_is_the_derivative_of_a_simulation_with_it(name: str) -> None:
    search, linear = problem()
    windows = force_windows(search, linear)
    family, tolerance = FAMILIES[name]
    matrix, right = windows.normal(windows.histories(family, {}))
    k, P = NAMES.index(f"effects.{name}.a"), len(NAMES)
    size = np.sqrt(np.diagonal(linear.gram, axis1=1, axis2=2))
    for run in range(2):
        exact = linear.gram[run, 1:, 1 + k] / size[run, 1:] / size[run, 1 + k]
        found = matrix[run, 0, :P, P] / size[run, 1:] / size[run, 1 + k]
        np.testing.assert_allclose(found, exact, atol=tolerance)
        assert matrix[run, 0, P, P] == pytest.approx(linear.gram[run, 1 + k, 1 + k], rel=2 * tolerance)
        onto = right[run, 0, P] / size[run, 0] / size[run, 1 + k]
        assert onto == pytest.approx(linear.gram[run, 0, 1 + k] / size[run, 0] / size[run, 1 + k], abs=tolerance)
    np.testing.assert_allclose(windows.square, linear.gram[:, 0, 0], rtol=1e-9)


@pytest.mark.slow
def test_long_runs_are_cut_into_windows_with_free_starts(monkeypatch: Any) -> None:
    """Windows of five segments say less of the parameters than the run of sixteen where no force wanders on from one to
    the next, and hold each sample once."""
    search, linear = problem()
    still = linear.point._replace(discrepancy=DISCREPANCY.without_force(np.full(3, 1e-6)))
    linear = linear._replace(point=still)
    whole = force_windows(search, linear)
    monkeypatch.setattr(segment_force, "LONGEST", 5)
    cut = force_windows(search, linear)
    assert np.bincount(cut.owner).tolist() == [4, 4] and cut.samples == whole.samples
    assert cut.onto_knots(np.ones((1, *cut.theta.shape))).sum() == len(search.segments.cut.run)
    P, owner = len(NAMES), cut.owner
    for run in range(2):
        less = whole.matrix[run, :P, :P] - cut.matrix[owner == run, :P, :P].sum(axis=0)
        assert np.linalg.eigvalsh(less).min() > -1e-4 * np.abs(whole.matrix[run, :P, :P]).max()


def test_the_motion_of_the_samples_is_that_of_the_start_states() -> None:
    search, linear = problem()
    segments, z = search.segments, linear.point.z.copy()
    z[:, :BODY] += np.random.default_rng(1).normal(size=(len(z), BODY)) * 0.01
    track = motions_of(segments, linear.point.values, z)
    for k, name in enumerate(("x", "y", "heading", "u", "w", "r")):
        np.testing.assert_allclose(getattr(track, name)[:, 0], z[:, k], atol=1e-12)
    np.testing.assert_allclose(track.time, segments.cut.times[:, :-1], atol=1e-12)
    assert track.inputs["rotor_angle"].shape == track.x.shape


def test_a_kept_refit_is_linearised_where_it_ended(tmp_path, monkeypatch) -> None:
    """Bit for bit as it was, though only its point is kept."""
    monkeypatch.setattr("snakejax.diagnosis.inexact.search.REFIT_ROUNDS", 1)
    monkeypatch.setattr("snakejax.diagnosis.inexact.search.FINE", 0)  # the discrepancy stays
    search, linear = problem()
    search = search._replace(scales=())  # type: ignore[arg-type]
    with keep_fits(tmp_path):
        first = search.refit(linear.point, ())
    with keep_fits(tmp_path) as journal:
        again = search.refit(linear.point, ())
    assert (journal.earlier, journal.used, journal.computed) == (1, 1, 0)
    assert not np.array_equal(first.point.values, linear.point.values)
    for before, after in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        assert np.asarray(before).tobytes() == np.asarray(after).tobytes()


def test_a_run_left_out_is_simulated_with_parameters_of_the_other() -> None:
    """Its error is that of whole runs after the step which the other run alone gives."""
    _, linear = problem()
    errors = LeftOut(linear, linear.gram, linear.gram[:, None], np.zeros((2, 1)), np.ones((2, 1)), 1).mean_square(())
    noise = np.hypot(DISCREPANCY.white, DISCREPANCY.wander)
    for run in range(2):
        alone = linear.subsets._replace(gram=linear.gram[1 - run]).with_effects(()).step
        residual, _ = open_loop(linear.data.at_step(alone), DISCREPANCY).predicted()
        assert errors[run] == pytest.approx(np.nanmean((residual[run] / noise) ** 2), rel=1e-9)
