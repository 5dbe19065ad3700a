"""The filter of segments against dense matrices, its optimum against scipy, and strengths that are found again."""

import dataclasses
from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.small_case import small
from oracles.scipy_runs import integrated
from scipy import optimize, stats

from snakejax import Accuracy, Model, Pacejka, simulate
from snakejax.core.parameter import with_parameters
from snakejax.dynamics.conditions import by_condition, differences_of
from snakejax.effects import GroundSlope
from snakejax.estimation.discrepancy import segments as segments_module
from snakejax.estimation.discrepancy.kalman import (
    Discrepancy,
    SegmentData,
    deviance,
    gram_matrices,
    segment_data,
    smooth,
    smoothed,
)
from snakejax.estimation.discrepancy.least_squares import Prior, optimum, quadratic
from snakejax.estimation.discrepancy.open_loop import open_loop
from snakejax.estimation.discrepancy.restricted_likelihood import (
    likelihood_of,
    logarithms_of,
    restricted_likelihood,
)
from snakejax.estimation.discrepancy.segment_dynamics import BODY, FORCE
from snakejax.estimation.discrepancy.segmented_runs import LENGTH, cut_segments
from snakejax.estimation.discrepancy.segments import LinearisedSegments, Segments
from snakejax.estimation.discrepancy.strength import (
    Scales,
    _minimum,
    estimate_discrepancy,
    scales_of,
)

K, N, P = 3, 4, 2
NZ = BODY + FORCE
SIZE = NZ + 3
DISCREPANCY = Discrepancy(np.array([0.1, 0.1, 0.2]), np.array([0.3, 0.3, 0.1]), 0.4, np.array([0.5, 0.4, 0.3]), 0.7)


def made_up(seed: int, lost: bool = True) -> SegmentData:
    """One run of random matrices."""
    rng = np.random.default_rng(seed)
    transition, shift = np.zeros((1, K, NZ, NZ)), np.zeros((1, K, NZ, P + 1))
    transition[:, 1:, :BODY] = 0.4 * rng.normal(size=(1, K - 1, BODY, NZ))
    shift[:, 1:, :BODY] = rng.normal(size=(1, K - 1, BODY, P + 1))
    gap = np.full((1, K, N), LENGTH / N)
    gap[0, 0, 0] = 0.0
    present = np.ones((1, K, N, 3))
    if lost:
        present[0, 1, 2] = 0.0
        present[0, 2, 1, 2] = 0.0
    return SegmentData(
        rng.normal(size=(1, K, N, 3, P + 1)),
        rng.normal(size=(1, K, N, 3, NZ)),
        present,
        transition,
        shift,
        gap,
        rng.normal(size=(1, K, FORCE)),
        np.zeros(1),
    )


class Dense(NamedTuple):
    """All samples of one run at once: columns `Y` (N, P + 1), covariance `V` (N, N) of the first, and the `mean`
    (K, NZ, P + 1) of the states with their variance (K, NZ) and their covariance (K, NZ, N) with the samples."""

    Y: np.ndarray
    V: np.ndarray
    mean: np.ndarray
    cross: np.ndarray
    variance: np.ndarray


def dense_samples(data: SegmentData, of: Discrepancy, start_sd: float = 1.0) -> Dense:
    """The samples of one run whose start state, but for the force, has the standard deviation `start_sd`."""
    a = np.exp(-LENGTH / of.force_time)
    # Sources: start state, force innovations of each segment, wandering noise of each sample; all are independent.
    starts, kicks, samples = NZ, FORCE * (K - 1), 3 * K * N
    total = starts + kicks + samples
    scale = np.concatenate(
        [np.full(BODY, start_sd), of.force, np.tile(of.force * np.sqrt(1 - a**2), K - 1), np.ones(samples)]
    )
    Z, mean = np.zeros((K, NZ, total)), np.zeros((K, NZ, P + 1))
    Z[0, :, :NZ] = np.eye(NZ)
    mean[0, BODY:, 0] = -data.force[0, 0]
    for k in range(1, K):
        F = data.transition[0, k].copy()
        F[BODY:] = 0.0
        F[range(BODY, NZ), range(BODY, NZ)] = a
        Z[k], mean[k] = F @ Z[k - 1], F @ mean[k - 1] + data.shift[0, k]
        mean[k, BODY:, 0] += a * data.force[0, k - 1] - data.force[0, k]
        Z[k, BODY:, NZ + FORCE * (k - 1) : NZ + FORCE * k] += np.eye(FORCE)
    rows, columns, noise, wander, times = [], [], [], [], np.cumsum(data.gap[0].reshape(-1))
    for k in range(K):
        for j in range(N):
            for c in range(3):
                if data.present[0, k, j, c]:
                    h = data.state[0, k, j, c]
                    rows.append(h @ Z[k])
                    columns.append(data.columns[0, k, j, c] - h @ mean[k])
                    noise.append(of.white[c] ** 2)
                    wander.append((times[k * N + j], c))
    H, Y = np.array(rows), np.array(columns)
    V = H * scale**2 @ H.T + np.diag(noise)
    t, channel = np.array([w[0] for w in wander]), np.array([w[1] for w in wander])
    V += np.where(
        channel[:, None] == channel,
        np.exp(-np.abs(t[:, None] - t) / of.wander_time) * (of.wander[channel] ** 2)[:, None],
        0.0,
    )
    return Dense(Y, V, mean, np.array([Z[k] * scale**2 @ H.T for k in range(K)]), (Z * scale) ** 2 @ np.ones(total))


def dense(data: SegmentData, of: Discrepancy) -> tuple[np.ndarray, float, np.ndarray]:
    """Gram matrix, log determinant and smoothed states of one run from the covariance of everything at once."""
    Y, V, mean, cross, _ = dense_samples(data, of)
    inverse = np.linalg.inv(V)
    return Y.T @ inverse @ Y, float(np.linalg.slogdet(V)[1]), mean + cross @ inverse @ Y


@pytest.mark.parametrize("seed", range(3))
def test_the_filter_is_generalised_least_squares(seed: int) -> None:
    data = made_up(seed)
    gram, logs, _ = dense(data, DISCREPANCY)
    found, found_logs = gram_matrices(data, DISCREPANCY)
    assert deviance(data, DISCREPANCY) == pytest.approx(gram[0, 0] + logs, rel=1e-9)
    np.testing.assert_allclose(found[0], gram, rtol=1e-9)
    np.testing.assert_allclose(found_logs[0], logs, rtol=1e-9)


def test_states_are_smoothed_by_all_samples() -> None:
    data, step = made_up(5), np.array([0.3, -0.7])
    states = dense(data, DISCREPANCY)[2] @ np.concatenate([[1.0], -step])
    np.testing.assert_allclose(smooth(data, DISCREPANCY, step)[0], states, rtol=1e-6, atol=1e-8)


def test_smoothed_states_are_as_uncertain_as_all_samples_leave_them() -> None:
    data = made_up(5)
    _, V, _, cross, variance = dense_samples(data, DISCREPANCY)
    known = variance - np.einsum("kin,nm,kim->ki", cross, np.linalg.inv(V), cross)
    assert (known < 0.9 * variance).any()
    found = smoothed(data, DISCREPANCY, np.zeros(P))[1][0]
    np.testing.assert_allclose(found, np.sqrt(known), rtol=1e-6, atol=1e-7)


def test_restarts_part_a_run() -> None:
    """With a restart at every segment the Gram matrix is the sum of those of the segments alone."""
    data = made_up(7, lost=False)
    far = DISCREPANCY._replace(wander=np.full(3, 1e-9))
    whole, _ = gram_matrices(data, far, restart_every=1)

    def alone(k: int) -> np.ndarray:
        part = SegmentData(*(leaf if leaf.ndim == 1 else leaf[:, k : k + 1] for leaf in data))
        return gram_matrices(part, far)[0][0]

    np.testing.assert_allclose(whole[0], sum(alone(k) for k in range(K)), rtol=1e-9)


def test_the_restricted_likelihood_is_that_of_the_samples_with_the_parameters_integrated_out() -> None:
    data, prior = made_up(3), Prior(np.array([0.2, -0.1]), np.array([0.5, 2.0]))
    found = restricted_likelihood(data, DISCREPANCY, np.arange(P), prior)
    gram, logs, _ = dense(data, DISCREPANCY)
    normal = gram[1:, 1:] + np.diag(prior.precision)
    right = gram[1:, 0] + prior.precision * prior.mean
    chi2 = gram[0, 0] + (prior.precision * prior.mean**2).sum() - right @ np.linalg.solve(normal, right)
    assert found == pytest.approx(logs + chi2 + np.linalg.slogdet(normal)[1], rel=1e-8)


def test_the_slope_of_the_restricted_likelihood_of_several_runs_is_that_of_its_differences() -> None:
    runs = [made_up(seed) for seed in (3, 4)]
    data, prior = SegmentData(*map(np.concatenate, zip(*runs, strict=True))), Prior(np.full(P, 0.2), np.full(P, 0.5))
    at = logarithms_of(DISCREPANCY)
    with likelihood_of(data, np.arange(P), prior) as likelihood:
        value, slope = likelihood.value_and_slope(at)
        steps = 1e-5 * np.eye(len(at))
        differences = [(likelihood.value(at + h) - likelihood.value(at - h)) / 2e-5 for h in steps]
    assert value == pytest.approx(restricted_likelihood(data, DISCREPANCY, np.arange(P), prior), rel=1e-12)
    np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-6)


def test_an_open_loop_simulation_errs_by_force_and_noise() -> None:
    data = made_up(2, lost=False)
    far = DISCREPANCY._replace(force=np.full(3, 1e-12))
    noise = np.hypot(far.white, far.wander)
    np.testing.assert_allclose(open_loop(data, far).rms_sd[0], noise, rtol=1e-9)
    assert (open_loop(data, DISCREPANCY).rms_sd[0] > noise).all()


@pytest.mark.parametrize("seed", range(3))
def test_an_open_loop_prediction_is_that_of_dense_matrices(seed: int) -> None:
    """Without any measurement the covariance of the samples is that of start, force, noise and parameters."""
    data, covariance = made_up(seed, lost=False), np.array([[0.3, 0.1], [0.1, 0.2]])
    Y, V, *_ = dense_samples(data, DISCREPANCY, start_sd=0.0)
    found, step = open_loop(data, DISCREPANCY, range(P)), np.array([[0.3, -0.7]])
    np.testing.assert_allclose(found.columns.reshape(-1, 1 + P), Y, rtol=1e-9)
    np.testing.assert_allclose(found.variance.reshape(-1), np.diag(V), rtol=1e-9)
    sd = np.sqrt(np.diag(V + Y[:, 1:] @ covariance @ Y[:, 1:].T))
    within = np.abs(Y[:, 0] - Y[:, 1:] @ step[0]) <= 2.0 * sd
    assert share_inside(*found.predicted(step, covariance)) == pytest.approx(within.mean())
    # A sample that was lost counts neither as inside nor as outside.
    lost = made_up(seed)
    expected = within[lost.present.reshape(-1) > 0].mean()
    left, error = open_loop(lost, DISCREPANCY, range(P)).predicted(step, covariance)
    assert share_inside(left, error) == pytest.approx(expected)


def share_inside(residual: np.ndarray, sd: np.ndarray) -> float:
    seen = np.isfinite(residual[0])
    return float((np.abs(residual[0][seen]) <= 2.0 * sd[0][seen]).mean())


@pytest.mark.parametrize("seed", range(4))
def test_bounds_hold_as_in_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, y = rng.normal(size=(30, 5)), rng.normal(size=30)
    gram = np.column_stack([y, A]).T @ np.column_stack([y, A])
    prior = Prior(rng.normal(size=5), rng.uniform(0.1, 2.0, 5))
    low, high = np.full(5, -0.1), np.full(5, 0.15)
    fixed = np.array([0.0, 0.0, 0.0, 0.0, 0.05])
    found = optimum(gram, [0, 1, 2, 3], prior, fixed, low, high)
    root = np.sqrt(prior.precision[:4])
    stacked = np.vstack([A[:, :4], np.diag(root)])
    right = np.concatenate([y - 0.05 * A[:, 4], root * prior.mean[:4]])
    expected = optimize.lsq_linear(stacked, right, (low[:4], high[:4]), tol=1e-14)
    np.testing.assert_allclose(found.step[:4], expected.x, atol=1e-7)
    assert found.step[4] == 0.05
    assert found.chi2 == pytest.approx(2 * expected.cost, rel=1e-9)
    penalty = (prior.precision[:4] * (found.step[:4] - prior.mean[:4]) ** 2).sum()
    assert quadratic(gram, found.step) + penalty == pytest.approx(found.chi2, rel=1e-9)


NAMES = ("tyre.D", "effects.ground_slope.sx", "board.mass")


@cache
def segments() -> Segments:
    """Segments of two short runs of a board that skids."""
    case, _, _ = small()
    model = Model(case.board, Pacejka(8.0, 1.3, 0.9, 0.2), "free", {"ground_slope": GroundSlope()})
    return Segments(model, case.runs, NAMES)


@pytest.mark.slow
def test_segments_hold_every_sample_once() -> None:
    cut = segments().cut
    for k, run in enumerate(segments().runs):
        of_run = cut.run == k
        present = cut.present[of_run].reshape(-1, 3)[: len(run.times)]
        np.testing.assert_array_equal(present > 0, np.isfinite(np.asarray(run.pose)))
        times = cut.times[of_run][:, :-1].reshape(-1)[: len(run.times)]
        np.testing.assert_allclose(times, np.asarray(run.times))
    assert cut_segments(segments().runs).runs == len(segments().runs)


def simulated_states() -> tuple[np.ndarray, np.ndarray]:
    """True states (S, nz) at the start of each segment, and poses, of a simulation of all runs."""
    cut, run = segments().cut, segments().runs[0]
    model = segments().model.without("segment_force")
    times = np.append(np.asarray(run.times), float(run.times[-1]) + 0.01)
    done = simulate(model, run.gait, jnp.asarray(times), accuracy=Accuracy(rtol=1e-11, atol=1e-12))
    body = np.stack([np.asarray(leaf) for leaf in done.state[0]], axis=1)
    n = cut.pose.shape[1]
    z = np.concatenate([body[: len(run.times) : n]] * cut.runs)
    return np.concatenate([z, np.zeros((len(z), FORCE))], axis=1), np.asarray(done.pose)


@pytest.mark.slow
def test_a_heavier_vehicle_feels_a_force_in_proportion() -> None:
    """Twice the mass, the inertias and the tyre's force: the same motion under the same z."""
    case, _, _ = small()
    board = case.board.with_payload(0.0, 0.0)
    names = ("tyre.D", "board.mass", "board.rotor_inertia", "board.wheelset_inertia", "board.inertia")
    light = np.array([0.9, board.mass, board.rotor_inertia, board.wheelset_inertia, board.inertia], float)
    s = Segments(Model(board, Pacejka(8.0, 1.3, 0.9, 0.2), "free"), case.runs, names)
    z = s.guess()
    z[:, -FORCE:] = (0.3, -0.2, 0.05)
    once, twice = s.linearise(light, z), s.linearise(2 * light, z)
    np.testing.assert_allclose(twice.pose, once.pose, rtol=0, atol=1e-12)
    by_scale = once.pose_p @ np.where(s.multiplicative, 1.0, light)
    np.testing.assert_allclose(by_scale, 0.0, atol=1e-9)
    assert np.abs(once.pose_p[..., 1]).max() > 1e-4
    np.testing.assert_allclose(s.force_ratio(2 * light), 2.0)


@pytest.mark.slow
def test_segments_of_a_labelled_run_have_the_values_of_its_label() -> None:
    """Three fifths of the grip on rubber: as segments of a board that has that grip everywhere."""
    case, _, _ = small()
    runs = [
        dataclasses.replace(run, labels=(("floor", name),))
        for name, run in zip(("rubber", "concrete"), case.runs, strict=True)
    ]

    def at_grip(D: float) -> Model:
        return Model(case.board, Pacejka(8.0, 1.3, D, 0.2), "free")

    differences = differences_of(at_grip(0.9), ["tyre.D"], ["rubber"])
    by_floor = at_grip(0.9).add(by_floor=by_condition("floor", differences)(D_rubber=0.6))
    s = Segments(by_floor, runs, ["effects.by_floor.D_rubber"])
    z, on_rubber = s.guess(), s.cut.run == 0
    pose = s.linearise(np.array([0.6]), z).pose
    for D, chosen in ((0.54, on_rubber), (0.9, ~on_rubber)):
        plain = Segments(at_grip(D), runs, ["tyre.B"]).linearise(np.array([8.0]), z).pose
        # Segments beside one another take equal steps, as short as the tyre of one of them needs.
        np.testing.assert_allclose(pose[chosen], plain[chosen], rtol=0, atol=1e-6)
        assert np.abs(pose - plain)[~chosen].max() > 1e-4


@pytest.mark.slow
def test_rolled_out_segments_are_a_whole_simulation() -> None:
    """From the start of each run alone; what stands at the other segments before does not matter."""
    z, _ = simulated_states()
    first = segments().cut.first
    disturbed = np.where(first[:, None], z, z + 0.1)
    rolled = segments().rolled_out(np.array([0.9, 0.0, 7.0]), disturbed)
    # As below: the start from rest is stiff.
    np.testing.assert_allclose(rolled, z, rtol=0, atol=1e-4)


@pytest.mark.slow
def test_segments_are_pieces_of_the_simulation_and_their_derivatives_its_slopes() -> None:
    s = segments()
    z, pose = simulated_states()
    values = np.array([0.9, 0.0, 7.0])
    at = s.linearise(values, z)
    n = s.cut.pose.shape[1]
    whole = at.pose[s.cut.run == 0].reshape(-1, 3)[: len(pose) - 1]
    np.testing.assert_allclose(whole[n:], pose[n:-1], atol=2e-7)
    # The start from rest is stiff: a hundredth of the noise.
    np.testing.assert_allclose(whole[:n], pose[:n], atol=2.5e-5)
    # The end of a segment is the start of the next.
    np.testing.assert_allclose(at.end[1 : len(pose) // n - 1], z[2 : len(pose) // n, :BODY], atol=1e-6)
    for k, step in enumerate((1e-5, 1e-6, 1e-5)):
        move = np.zeros(3)
        move[k] = step
        up, down = (s.linearise(s.moved(values, sign * move), z) for sign in (1, -1))
        np.testing.assert_allclose((up.pose - down.pose) / (2 * step), at.pose_p[..., k], rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose((up.end - down.end) / (2 * step), at.end_p[..., k], rtol=1e-4, atol=1e-5)
    move = np.zeros(NZ)
    move[-1] = 1e-4  # a yaw moment
    up, down = (s.linearise(values, z + sign * move) for sign in (1, -1))
    np.testing.assert_allclose((up.end - down.end) / 2e-4, at.end_z[..., -1], rtol=1e-4, atol=1e-5)


def end_of_segment(k: int, values: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The end state (6,) of segment `k` by scipy's LSODA."""
    s = segments()
    run = s.runs[s.cut.run[k]]
    model = with_parameters(s.model, dict(zip(NAMES, map(jnp.asarray, values), strict=True)))
    state, span = (tuple(start[:BODY]), model.start((0.0, 0.0, 0.0))[1]), (s.cut.times[k][0], s.cut.times[k][-1])
    done = integrated(model, run.gait, span, state, method="LSODA", rtol=1e-9, atol=1e-11)
    return np.array(done.state[0])[:, -1]


STIFF = np.array([9.0, 0.0, 7.0])


def test_steps_follow_the_values() -> None:
    """Segments made with a soft tyre are integrated with one ten times as stiff."""
    s = segments()
    z = s.guess()
    at = s.linearise(STIFF, z)
    for k in range(1, 6):
        np.testing.assert_allclose(at.end[k], end_of_segment(k, STIFF, z[k]), atol=1e-6)


@pytest.mark.slow
def test_steps_that_are_too_long_show_in_the_growth_of_the_velocities(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segments_module, "STABLE", 20.0)
    s, stiff = segments(), np.array([200.0, 0.0, 7.0])
    z = s.guess()
    at = s.linearise(stiff, z)
    every = np.arange(len(z))
    unstable = s._growth(s._with_steps(stiff, z, every, s._substeps(stiff))) > segments_module.GROWN
    assert unstable.sum() >= 3
    for k in every[unstable][:3]:
        np.testing.assert_allclose(at.end[k], end_of_segment(k, stiff, z[k]), atol=1e-6)


def recorded(truth: Discrepancy) -> tuple[SegmentData, Scales, Prior]:
    """Two runs with noise and a random force of known strengths, the scales of a recording, and weak priors."""
    s = segments()
    z, _ = simulated_states()
    at = s.linearise(np.array([0.9, 0.0, 7.0]), z)
    cut = s.cut._replace(pose=at.pose + drawn(at, s, truth, np.random.default_rng(0)))
    scales = Scales(np.array([6e-4, 6e-4, 2e-3]), np.array([1.0, 1.0, 0.5]))
    return segment_data(cut, at, z), scales, Prior(np.zeros(3), np.full(3, 1e4))


@pytest.mark.slow
def test_noise_and_force_are_found_again() -> None:
    """The truth is within the range of the likelihood ratio of nine strengths, at a level of 0.001."""
    truth = Discrepancy(
        np.array([3e-4, 3e-4, 1e-3]), np.array([5e-4, 5e-4, 1.5e-3]), 0.2, np.array([0.2, 0.1, 0.05]), 0.6
    )
    data, scales, prior = recorded(truth)
    found, least = estimate_discrepancy(data, scales.first_guess(), np.arange(3), prior, scales, 60)
    ratio = restricted_likelihood(data, truth, np.arange(3), prior) - least
    assert 0 < ratio < stats.chi2.isf(0.001, 9)
    # What many samples tell, within a tenth.
    np.testing.assert_allclose(found.white, truth.white, rtol=0.1)
    np.testing.assert_allclose(found.wander, truth.wander, rtol=0.35)


@pytest.mark.slow
def test_noise_that_was_taken_for_a_force_is_found_again() -> None:
    """The wandering noise has become the white one, and the force what wanders."""
    truth = Discrepancy(
        np.array([3e-4, 3e-4, 1e-3]), np.array([5e-4, 5e-4, 1.5e-3]), 0.2, np.array([0.02, 0.01, 0.005]), 0.6
    )
    data, scales, prior = recorded(truth)
    wrong = Discrepancy(1e-3 * scales.noise, np.array([6e-4, 6e-4, 1.2e-3]), 0.03, np.array([0.1, 0.3, 0.05]), 0.15)
    _, stuck = _minimum(data, wrong, np.arange(3), prior, scales, 25)
    found, least = estimate_discrepancy(data, wrong, np.arange(3), prior, scales, 25)
    at_truth = restricted_likelihood(data, truth, np.arange(3), prior)
    assert stuck > at_truth + 20
    assert least < at_truth + 5
    np.testing.assert_allclose(found.white, truth.white, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("times", [10.0, 100.0])
def test_a_weak_force_is_found_from_one_that_is_much_too_strong(times: float) -> None:
    """A few segments tell it, and many samples the noise: one unit for both would leave the force where it began."""
    truth = Discrepancy(
        np.array([3e-4, 3e-4, 1e-3]), np.array([5e-4, 5e-4, 1.5e-3]), 0.2, np.array([1e-3, 1e-3, 5e-4]), 9.0
    )
    data, scales, prior = recorded(truth)
    _, least = estimate_discrepancy(data, truth, np.arange(3), prior, scales, 40)
    stronger = truth._replace(force=times * truth.force)
    _, reached = estimate_discrepancy(data, stronger, np.arange(3), prior, scales, 40)
    assert reached < least + 0.5


def drawn(at: LinearisedSegments, s: Segments, truth: Discrepancy, rng: np.random.Generator) -> np.ndarray:
    """Deviations (S, n, 3) of the samples: of a random force, by the linear model, and of noise."""
    cut, dz = s.cut, np.zeros((len(s.cut.run), NZ))
    a = np.exp(-LENGTH / truth.force_time)
    deviation = np.zeros_like(cut.pose)
    b = np.exp(-0.01 / truth.wander_time)
    for k in range(len(dz)):
        if cut.first[k]:
            force, wander = truth.force * rng.normal(size=3), truth.wander * rng.normal(size=3)
            dz[k] = np.concatenate([np.zeros(BODY), force])
        else:
            force = a * force + np.sqrt(1 - a**2) * truth.force * rng.normal(size=3)
            dz[k] = np.concatenate([at.end_z[k - 1] @ dz[k - 1], force])
        for j in range(cut.pose.shape[1]):
            wander = b * wander + np.sqrt(1 - b**2) * truth.wander * rng.normal(size=3)
            deviation[k, j] = at.pose_z[k, j] @ dz[k] + wander + truth.white * rng.normal(size=3)
    return deviation


@pytest.mark.slow
def test_scales_are_those_of_the_motion() -> None:
    scales = scales_of(segments(), np.array([4e-4, 4e-4, 2.5e-3]))
    z, _ = simulated_states()
    board = segments().model.board
    first = z[segments().cut.run == 0]
    change = np.diff(first[:, 3:6], axis=0) / LENGTH
    expected = np.sqrt((change[:, 2] ** 2).mean()) * float(board.total_inertia)
    assert scales.force[2] == pytest.approx(expected, rel=0.5)
    low, high = scales.bounds()
    assert (low < high).all()
