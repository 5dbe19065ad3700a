"""Journal of finished fits: what is kept is read again bit for bit, and only where nothing has changed."""

import hashlib
import pickle
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.small_case import small

from snakejax.core.parallel import ContextThreads
from snakejax.dynamics.law import Law, LawParameter, law_class
from snakejax.dynamics.model import Model
from snakejax.estimation.fit_journal import FitJournal, keep_fits, kept_fit
from snakejax.estimation.linearisation import Linearised
from snakejax.estimation.problem import Problem, Solution


@kept_fit
def doubled(number: np.ndarray) -> Linearised:
    """Stands for a fit."""
    return Linearised(jnp.asarray(2 * number), np.asfortranarray(np.outer(number, number)))


def fitted(folder: Path, problem: Problem) -> tuple[Solution, FitJournal]:
    """D of the tyre from the train run."""
    with keep_fits(folder) as journal:
        return problem.fit({"tyre.D": 0.8}, ["tyre.D"], [0]), journal


@pytest.fixture(scope="module")
def problem() -> Problem:
    case, noise, fit = small()
    return Problem.of(fit.model, case.runs, noise, ["tyre.D"], 1)


def test_a_kept_fit_is_returned_bit_for_bit(tmp_path, problem) -> None:
    first, computing = fitted(tmp_path, problem)
    again, reading = fitted(tmp_path, problem)
    alone = problem.fit({"tyre.D": 0.8}, ["tyre.D"], [0])
    assert (computing.computed, computing.used) == (1, 0)
    assert (reading.earlier, reading.computed, reading.used) == (1, 0, 1)
    for one in (first, again):
        assert jax.tree.structure(one) == jax.tree.structure(alone)
        for mine, computed in zip(jax.tree.leaves(one), jax.tree.leaves(alone), strict=True):
            assert type(mine) is type(computed)
            assert np.asarray(mine).tobytes() == np.asarray(computed).tobytes()


def test_a_changed_recording_start_or_option_is_computed(tmp_path, problem) -> None:
    fitted(tmp_path, problem)
    run = problem.runs[0]
    last_bit = run.pose.at[7, 0].set(jnp.nextafter(run.pose[7, 0], jnp.inf))
    moved = eqx.tree_at(lambda p: p.runs[0].pose, problem, last_bit)
    assert fitted(tmp_path, moved)[1].used == 0
    with keep_fits(tmp_path) as journal:
        problem.fit({"tyre.D": np.nextafter(0.8, 1)}, ["tyre.D"], [0])
        problem.fit({"tyre.D": 0.8}, ["tyre.D"], [1])
        problem.fit({"tyre.D": 0.8}, ["tyre.D"], [0], most=2)
    assert (journal.used, journal.computed) == (0, 3)


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:-1] + bytes([b[-1] ^ 1])])
def test_a_damaged_file_is_computed_again(tmp_path, damage) -> None:
    number = np.arange(3.0)
    with keep_fits(tmp_path):
        doubled(number)
    (file,) = tmp_path.glob("*.fit")
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    with keep_fits(tmp_path) as journal:
        np.testing.assert_array_equal(doubled(number).residual, 2 * number)
    assert (journal.used, journal.computed) == (0, 1)
    assert file.read_bytes() == whole


def test_a_file_cannot_run_code(tmp_path) -> None:
    number = np.arange(3.0)
    with keep_fits(tmp_path):
        doubled(number)
    (file,) = tmp_path.glob("*.fit")
    content = pickle.dumps(Malicious(str(tmp_path / "made")))
    file.write_bytes(hashlib.sha256(content).digest() + content)
    with keep_fits(tmp_path) as journal:
        np.testing.assert_array_equal(doubled(number).residual, 2 * number)
    assert journal.used == 0 and not (tmp_path / "made").exists()


class Malicious(NamedTuple):
    """Makes a folder where it is unpickled."""

    folder: str

    def __reduce__(self):
        return Path.mkdir, (Path(self.folder),)


def test_laws_of_one_name_are_told_apart(tmp_path, problem) -> None:
    @kept_fit
    def effects(model: Model) -> list[str]:
        return [effect.expression for effect in model.effects.values() if isinstance(effect, Law)]

    def found(expression: str, low: float) -> list[str]:
        law = law_class(expression, (LawParameter("k", "N s/m", 0.0, low),))
        return effects(problem.model.add(law=law()))

    with keep_fits(tmp_path) as journal:
        assert found("X = -k * u", 0.0) == found("X = -k * u", 0.0)
        assert found("X = -k * w", 0.0) != found("X = -k * u", -1.0)
    assert (journal.used, journal.computed) == (1, 3)


def test_threads_keep_their_fits(tmp_path) -> None:
    numbers = [np.arange(float(k)) for k in range(2, 6)]
    with keep_fits(tmp_path) as journal, ContextThreads(2) as pool:
        kept = list(pool.map(doubled, numbers))
    assert journal.computed == 4 == len(list(tmp_path.glob("*.fit")))
    assert all(np.asarray(one.jacobian).flags.f_contiguous and isinstance(one.residual, jax.Array) for one in kept)


def test_what_has_no_digest_is_not_kept(tmp_path) -> None:
    """Two functions may follow each other at one address."""

    @kept_fit
    def called(function) -> float:
        return function(1.0)

    with keep_fits(tmp_path) as journal:
        assert (called(lambda x: x + 1), called(lambda x: x + 2)) == (2.0, 3.0)
    assert journal.used == 0 and not list(tmp_path.iterdir())


def test_outside_nothing_is_kept_and_a_fit_within_a_fit_is_not(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    doubled(np.arange(3.0))

    @kept_fit
    def outer(number: np.ndarray) -> float:
        return float(doubled(number).residual[1])

    with keep_fits(tmp_path / "kept") as journal:
        assert outer(np.arange(3.0)) == 2.0
    assert journal.computed == 1
    assert [path.name for path in tmp_path.iterdir()] == ["kept"] and len(list((tmp_path / "kept").iterdir())) == 1
