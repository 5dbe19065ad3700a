"""Designs against exact probabilities, plain least squares, and fits to made-up recordings."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA
from helpers.studies import study
from scipy import stats

from snakejax.commands.cli import main
from snakejax.commands.cli.design import effects_of
from snakejax.core.errors import InputError
from snakejax.design.discrimination import (
    EffectPair,
    correct_selection_probability,
    information,
    noncentralities,
    repeats_needed,
    scale_for_probability,
)

FREE = np.full(4, np.inf)


def pair_of(sizes, low=-FREE) -> EffectPair:
    """Effects 2 and 3 of four parameters, beside a tyre of two."""
    return EffectPair((2,), (3,), (0, 1), np.array([0.0, 0.0, *sizes]), np.asarray(low), FREE)


def columns(seed: int = 0, likeness: float = 0.9) -> np.ndarray:
    """What four parameters change in 60 samples; the last two much alike."""
    C = np.random.default_rng(seed).normal(size=(60, 4))
    C[:, 3] = likeness * C[:, 2] + (1 - likeness) * C[:, 3]
    return C


def test_the_gap_is_the_rise_of_a_least_squares_fit() -> None:
    C, sizes = columns(), (0.7, 0.4)
    found = noncentralities(C.T @ C, pair_of(sizes))
    for k, (one, other) in enumerate(((2, 3), (3, 2))):
        data = C[:, one] * sizes[one - 2]
        rest = C[:, [0, 1, other]]
        left = data - rest @ np.linalg.lstsq(rest, data)[0]
        assert found[k] == pytest.approx(left @ left, rel=1e-6)


def test_a_gap_is_wide_where_only_the_wrong_sign_could_imitate() -> None:
    C = columns()
    C[:, 3] = -C[:, 3]
    q = np.linalg.qr(C[:, :2])[0]
    left = C[:, 2] - q @ (q.T @ C[:, 2])
    found = noncentralities(C.T @ C, pair_of((0.7, 0.4), np.zeros(4)))
    assert found[0] == pytest.approx(0.49 * left @ left, rel=1e-6)


@pytest.mark.parametrize("sizes", [(0.1, 0.1), (0.3, 0.2), (1.0, 1.0)])
def test_the_certainty_is_the_exact_one_of_two_directions(sizes) -> None:
    """With unit vectors a, b at cosine r and S the length of the truth, the answer is right where the two independent
    normal numbers (1 -+ r) S + n_-+ of variance 2 (1 -+ r) have one sign.
    """
    C = columns()
    q = np.linalg.qr(C[:, :2])[0]
    E = C[:, 2:] - q @ (q.T @ C[:, 2:])
    length = np.linalg.norm(E, axis=0)
    r = float(E[:, 0] @ E[:, 1] / length.prod())
    exact = []
    for S in length * sizes:
        d, s = S * np.sqrt((1 - r) / 2), S * np.sqrt((1 + r) / 2)
        exact.append(stats.norm.cdf(d) * stats.norm.cdf(s) + stats.norm.cdf(-d) * stats.norm.cdf(-s))
    assert correct_selection_probability(C.T @ C, pair_of(sizes)) == pytest.approx(np.mean(exact), abs=0.006)


def test_a_sign_that_is_known_helps() -> None:
    """Two drags whose columns point opposite ways cannot be taken for each other."""
    C = columns()
    C[:, 3] = -C[:, 3]
    G = C.T @ C
    assert (
        correct_selection_probability(G, pair_of((0.15, 0.15), np.zeros(4)))
        > correct_selection_probability(G, pair_of((0.15, 0.15))) + 0.1
    )


def test_strengths_and_repeats_are_where_the_certainty_says() -> None:
    C, D = columns(), columns(1, 0.5)
    G, run, pair = C.T @ C, 0.2 * D.T @ D, pair_of((0.3, 0.3))
    factor = scale_for_probability(G, pair, 0.8)
    assert correct_selection_probability(G, pair._replace(sizes=factor * pair.sizes)) == pytest.approx(0.8, abs=0.01)
    needed = repeats_needed(G, run, pair)
    assert needed and correct_selection_probability(G + needed * run, pair) >= 0.95 > correct_selection_probability(
        G + (needed - 1) * run, pair
    )
    assert repeats_needed(1e4 * G, run, pair) == 0 and repeats_needed(G, 0 * run, pair) is None


def test_the_information_of_a_run_is_what_its_start_does_not_explain() -> None:
    """Against explicit projection, where the start is moved and turned by hand."""
    rng = np.random.default_rng(0)
    base = np.cumsum(rng.normal(size=(40, 3)), axis=0) * 0.01
    steps, weight = np.array([0.1, -0.2]), np.array([10.0, 10.0, 3.0])
    effects = rng.normal(size=(2, 40, 3))
    poses = np.concatenate([base[None], base + steps[:, None, None] * effects])

    def turned(angle):
        c, s = np.cos(angle), np.sin(angle)
        about = base[:, :2] - base[0, :2]
        return np.column_stack([about @ np.array([[c, s], [-s, c]]) + base[0, :2], base[:, 2] + angle])

    along, across = np.zeros_like(base) + np.array([[1, 0, 0]]), np.zeros_like(base) + np.array([[0, 1, 0]])
    starts = [along, across, (turned(1e-6) - turned(-1e-6)) / 2e-6]
    N = np.stack([(part * weight).ravel() for part in starts], axis=1)
    E = np.stack([(part * weight).ravel() for part in effects], axis=1)
    E = E - N @ np.linalg.lstsq(N, E)[0]
    found = information(jnp.asarray(poses), jnp.asarray(steps), jnp.asarray(weight))
    np.testing.assert_allclose(found, E.T @ E, rtol=1e-6)


def test_the_objective_is_read() -> None:
    assert effects_of("separate") == (None, {}) and effects_of("information") == (None, {})
    assert effects_of("separate:a, b") == (("a", "b"), {})
    assert effects_of("separate:a=0.5,b") == (("a", "b"), {"a": 0.5})
    for text in ("separate:a", "separate:a,b,c", "separate:a,", "separate:a=x,b", "information:B"):
        with pytest.raises(InputError):
            effects_of(text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["paper-rotate", "--objective", "separate"], "name a recorded case"),
        ([str(DATA / "level-board"), "--objective", "separate:a"], "does not name two effects"),
    ],
)
def test_what_cannot_be_designed_is_said_in_one_line(options, why, capsys) -> None:
    assert main(["tune", *options]) == 2
    said = capsys.readouterr().err
    assert why in said and said.count("\n") == 1


@pytest.mark.long
def test_the_designed_run_tells_apart_what_the_given_ones_do_not(tmp_path) -> None:
    """The study of `fit/`, on one pair: fits to made-up recordings are right as often as the design says."""
    next_run = study("next_run")
    (proof,) = next_run.main(tmp_path, next_run.PAIRS[:1], trials=60)
    design = proof.design
    assert design.before == pytest.approx(0.7, abs=0.01) and design.after > 0.9
    assert proof.given == pytest.approx(0.7, abs=0.1)
    assert proof.designed == pytest.approx(design.after if proof.runs == 1 else 0.97, abs=0.06)
    assert all(design.tuned.reached[name] <= most * (1 + 1e-9) for name, most in next_run.LIMITS.items())
    assert max(advice.certainty for advice in design.advice) < design.after
    assert (tmp_path / "next_run.png").stat().st_size > 10_000
