"""Kept programs: traced once for all processes, again where anything differs, and right where files are damaged."""

from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import Pacejka
from snakejax.dynamics.law import LawParameter, law_class
from snakejax.estimation.kept_program import SUFFIX, KeptProgram


class Curve(NamedTuple):
    """A result of two arrays."""

    value: np.ndarray
    slope: np.ndarray


TRACED: list[int] = []
"""The power in each program that was traced."""


def curve(stiffness, power: int, x) -> Curve:
    """k x^n and its derivative by x; counts how often it is traced."""
    TRACED.append(power)
    value, slope = jax.jvp(lambda x: stiffness * x**power, (x,), (jnp.ones_like(x),))
    return Curve(value, slope)


@pytest.fixture
def folder(tmp_path) -> Iterator[Path]:
    """A folder of compiled programs with nothing in it."""
    before = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    TRACED.clear()
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


def in_another_process(stiffness: float, power: int, x: np.ndarray) -> Curve:
    """The result of a program that remembers nothing."""
    jax.clear_caches()
    return KeptProgram(curve, Curve)(jnp.asarray(stiffness), power, x)


X = np.linspace(0.0, 2.0, 5)


def test_another_process_does_not_trace_again(folder) -> None:
    first = in_another_process(3.0, 2, X)
    assert TRACED == [2]
    second = in_another_process(5.0, 2, X + 1)
    assert TRACED == [2]
    assert len(list(folder.glob(f"*{SUFFIX}"))) == 1
    np.testing.assert_allclose(first.value, 3 * X**2)
    np.testing.assert_allclose(first.slope, 6 * X)
    np.testing.assert_allclose(second.value, 5 * (X + 1) ** 2)
    np.testing.assert_allclose(second.slope, 10 * (X + 1))


def test_another_structure_shape_or_type_is_another_program(folder) -> None:
    in_another_process(3.0, 2, X)
    cubic = in_another_process(3.0, 3, X)
    shorter = in_another_process(3.0, 2, X[:3])
    single = in_another_process(3.0, 2, X.astype(np.float32))
    assert TRACED == [2, 3, 2, 2]
    assert len(list(folder.glob(f"*{SUFFIX}"))) == 4
    np.testing.assert_allclose(cubic.slope, 9 * X**2)
    assert shorter.value.shape == (3,)
    np.testing.assert_allclose(single.value, 3 * X**2, rtol=1e-6)


def test_equal_numbers_of_other_types_are_other_programs(folder) -> None:
    program = KeptProgram(lambda power, x: x / x.dtype.type(2) if power is True else x**power)
    np.testing.assert_allclose(program(True, X), X / 2)
    np.testing.assert_allclose(program(1, X), X)


def test_laws_of_one_class_name_are_other_programs(folder) -> None:
    stiff = law_class("X = -k * x", (LawParameter("k", "N/m"),))(k=2.0)
    damped = law_class("X = -k * u", (LawParameter("k", "N s/m"),))(k=2.0)

    def expression(law, x):
        return x * len(law.expression) + (1 if "u" in law.expression else 0)

    results = [KeptProgram(expression)(law, X) for law in (stiff, damped)]
    np.testing.assert_allclose(results[1] - results[0], 1.0)


class Hinge(Pacejka):
    """A tyre of a user, whose code may call anything."""


def test_programs_of_classes_of_a_user_are_traced_by_each_process(folder) -> None:
    def force(tyre, x):
        TRACED.append(0)
        return tyre.force(x, x)

    tyres = [kind(6.0, 1.4, 5.0, 0.2) for kind in (Pacejka, Hinge)]
    for tyre, files in zip(tyres, (1, 1), strict=True):
        results = [KeptProgram(force)(tyre, X) for _ in range(2)]
        np.testing.assert_allclose(results[0], results[1])
        assert len(list(folder.glob(f"*{SUFFIX}"))) == files
    assert len(TRACED) == 3


def test_what_has_no_digest_is_compiled_and_not_kept(folder) -> None:
    program = KeptProgram(lambda function, x: function(x))
    np.testing.assert_allclose(program(jnp.sin, X), np.sin(X))
    np.testing.assert_allclose(program(jnp.cos, X), np.cos(X))
    assert not list(folder.glob(f"*{SUFFIX}"))


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:-1] + bytes([b[-1] ^ 1])])
def test_a_damaged_file_is_traced_again(folder, damage) -> None:
    in_another_process(3.0, 1, X)
    (file,) = folder.glob(f"*{SUFFIX}")
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    np.testing.assert_allclose(in_another_process(3.0, 1, X).value, 3 * X)
    assert TRACED == [1, 1]
    in_another_process(3.0, 1, X)
    assert TRACED == [1, 1]


def test_threads_that_need_one_program_trace_it_once(folder) -> None:
    program, results = KeptProgram(curve, Curve), []
    threads = [Thread(target=lambda: results.append(program(jnp.asarray(3.0), 1, X).value)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert TRACED == [1]
    np.testing.assert_allclose(results, np.tile(3 * X, (4, 1)))


def test_an_error_is_raised_each_time_and_nothing_is_kept(folder) -> None:
    program = KeptProgram(lambda x: jnp.dot(x, jnp.zeros(4)))
    for _ in range(2):
        with pytest.raises(TypeError):
            program(X)
    assert not list(folder.glob(f"*{SUFFIX}"))


@pytest.mark.parametrize("name", [None, ""])
def test_without_a_folder_it_is_compiled_all_the_same(folder, monkeypatch, name: str | None) -> None:
    monkeypatch.chdir(folder)
    jax.config.update("jax_compilation_cache_dir", name)
    program = KeptProgram(curve, Curve)
    np.testing.assert_allclose(program(jnp.asarray(3.0), 1, X).value, 3 * X)
    np.testing.assert_allclose(program(jnp.asarray(4.0), 1, X).value, 4 * X)
    assert TRACED == [1]
    assert not list(folder.iterdir())
