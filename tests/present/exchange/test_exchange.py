"""Results for other programs: tables, ArviZ, CommonRoad's parameter file, and C that a compiler takes."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.small_case import small

import snakejax as sj
from snakejax.dynamics.constants import GRAVITY
from snakejax.dynamics.signals import Joint
from snakejax.effects import LIBRARY
from snakejax.present import exchange

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed.")


@pytest.mark.slow
def test_runs_are_tables() -> None:
    case, _, _ = small()
    data = exchange.runs_dataset(case)
    assert dict(data.sizes) == {"run": 2, "sample": 400} and list(data.role.values) == ["train", "heldout"]
    np.testing.assert_array_equal(data.x_m.sel(run="here"), case.runs[0].pose[:, 0])
    assert data.heading_rad.attrs["units"] == "rad" and bool(data.x_m.sel(run="here").isnull()[100:120].all())
    first = case.runs[0]
    short = sj.Run("short", "train", first.times[:50], first.pose[:50], first.gait)
    table = exchange.runs_dataframe([first, short])
    assert list(table.columns) == ["run", "role", "time_s", "x_m", "y_m", "heading_rad"]
    assert (table["run"] == "short").sum() == 50 and len(table) == 450


@pytest.mark.slow
def test_residuals_are_measured_less_modelled() -> None:
    case, noise, fit = small()
    data = exchange.residuals_dataset(fit)
    np.testing.assert_allclose(data.x_m - data.x_m_modelled, data.x_m_residual, atol=1e-9)
    seen = data.sel(run=["here"])
    squares = [float((seen[f"{name}_residual_sd"] ** 2).sum()) for name in ("x_m", "y_m", "heading_rad")]
    assert sum(squares) / (3 * 380) == pytest.approx(fit.train_score.misfit, rel=1e-6)
    table = exchange.residuals_dataframe(fit)
    assert len(table) == 800 and {"x_m_modelled", "heading_rad_residual_sd"} <= set(table.columns)
    np.testing.assert_allclose(table["y_m_residual"], table["y_m_residual_sd"] * float(noise.position))
    assert case.name == "small"


def test_the_table_of_a_result_is_a_dataset_too() -> None:
    _, _, fit = small()
    data = fit.to_xarray()
    assert list(data.parameter.values) == ["tyre.D"] and float(data.value[0]) == fit.estimates["tyre.D"].value


@pytest.mark.slow
def test_samples_of_a_fit_are_inference_data() -> None:
    pytest.importorskip("arviz", reason="ArviZ is not installed.")
    _, _, fit = small()
    found = exchange.inference_data(fit, samples=30, seed=1)
    drawn = found.posterior["tyre.D"]
    estimate = fit.estimates["tyre.D"]
    assert drawn.shape == (1, 30) and drawn.attrs["units"] == "N"
    assert float(drawn.mean()) == pytest.approx(estimate.value, abs=estimate.sd)
    assert 0.4 * estimate.sd < float(drawn.std()) < 2 * estimate.sd


def test_without_arviz_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str):
        raise ImportError(name)

    monkeypatch.setattr("snakejax.present.exchange.inference.import_module", missing)
    with pytest.raises(sj.InputError, match=r'pip install "snakejax\[arviz\]"'):
        exchange.inference_data(small()[2])


def test_commonroad_parameters_give_the_tyre_back() -> None:
    board = sj.Board(**sj.TABLE_II)
    model = sj.Model(board, sj.Pacejka(8.0, 1.3, 0.9, 0.2), "free").add(com_offset=LIBRARY["com_offset"](0.02))
    found = yaml.safe_load(exchange.commonroad_yaml(model))
    load, tire = found["m"] * GRAVITY / 2, found["tire"]
    C, D, E = tire["p_cy1"], tire["p_dy1"] * load, tire["p_ey1"]
    np.testing.assert_allclose((-tire["p_ky1"] * load / (C * D), C, D, E), (8.0, 1.3, 0.9, 0.2))
    assert (found["a"], found["b"]) == (pytest.approx(0.23), pytest.approx(0.27))
    assert found["I_z"] == pytest.approx(7.0 * 0.25**2)
    assert found["snakejax"]["structure"] == "free" and found["snakejax"]["effects"]["com_offset"] == {"a": 0.02}
    assert found["snakejax"]["vehicle"]["creep_speed"] == 1e-3
    ideal = yaml.safe_load(exchange.commonroad_yaml(sj.Model(board, sj.Rayleigh(9.0), "coupled")))
    assert "tire" not in ideal and ideal["snakejax"]["tyre"] == {"k_s": 9.0} and ideal["snakejax"]["effects"] == {}


class _Held(sj.dynamics.signals.AbstractSignal):
    joint: Joint

    def at(self, t):
        return self.joint


def compiled(text: str, folder: Path):
    """The function of a C file, by gcc with every warning an error."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed.")
    source, library = folder / "rates.c", folder / "rates.so"
    source.write_text(text, encoding="utf-8")
    command = [gcc, "-std=c99", "-Wall", "-Werror", "-Wno-unused", "-O1", "-ffp-contract=off", "-shared", "-fPIC"]
    done = subprocess.run([*command, "-o", library, source, "-lm"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library)).snakejax_rates


def called(function, t: float, *arrays: np.ndarray, size: int) -> np.ndarray:
    result = np.full(size, np.nan)
    pointers = [np.ascontiguousarray(a).ctypes.data_as(ctypes.c_void_p) for a in (*arrays, result)]
    function(ctypes.c_double(t), *pointers)
    return np.ctypeslib.as_array(ctypes.cast(pointers[-1], ctypes.POINTER(ctypes.c_double)), (size,)).copy()


def _models() -> dict[str, sj.Model]:
    board = sj.Board(**sj.TABLE_II, creep_speed=0.01)
    pacejka = sj.Pacejka(8.0, 1.3, 0.9, 0.2)
    several = {
        name: LIBRARY[name](**values)
        for name, values in {
            "ground_slope": {"sx": 0.003, "sy": -0.002},
            "rolling_resistance": {"f": 0.1},
            "quadratic_drag": {"c": 0.3},
            "tyre_relaxation": {"sigma": 0.02},
            "grip_split": {"s": 0.1},
            "com_offset": {"a": 0.02},
        }.items()
    }
    return {
        "pacejka coupled": sj.Model(board, pacejka, "coupled"),
        "pacejka free": sj.Model(board, pacejka, "free"),
        "effects": sj.Model(board, pacejka, "free", several),
        "rayleigh": sj.Model(board, sj.Rayleigh(9.0), "coupled"),
        "ideal": sj.Model(board, pacejka, "ideal"),
    }


@pytest.mark.parametrize("name", ["pacejka coupled", "pacejka free", "effects", "rayleigh", "ideal"])
def test_the_c_function_has_the_rates_of_the_model(name: str, tmp_path: Path) -> None:
    model = _models()[name]
    function = compiled(exchange.c_function(model), tmp_path)
    zero = jnp.zeros(())
    leaves, tree = jax.tree.flatten(model.start((zero, zero, zero)))
    rng = np.random.default_rng(3)
    for _ in range(20):
        state, joints = rng.normal(size=len(leaves)), rng.normal(size=6)
        gait = sj.Gait(*(_Held(Joint(*map(jnp.asarray, joints[k : k + 3]))) for k in (0, 3)))
        parts = jax.tree.unflatten(tree, [jnp.asarray(part) for part in state])
        expected = np.array([float(rate) for rate in jax.tree.leaves(model.rates(zero, parts, gait))])
        got = called(function, 0.0, state, joints, size=len(leaves))
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


def test_a_gait_can_be_part_of_the_c_function(tmp_path: Path) -> None:
    example = sj.preset("paper-forward")
    model = example.model.add(steering_lag=LIBRARY["steering_lag"](0.05))
    with pytest.raises(sj.InputError, match="`steering_lag` changes the command"):
        exchange.c_function(model)
    function = compiled(exchange.c_function(model, example.gait), tmp_path)
    zero = jnp.zeros(())
    leaves, tree = jax.tree.flatten(model.start((zero, zero, zero)))
    for t in (0.0, 0.7, 3.1):
        state = np.linspace(0.1, 0.4, len(leaves))
        parts = jax.tree.unflatten(tree, [jnp.asarray(part) for part in state])
        expected = [float(rate) for rate in jax.tree.leaves(model.rates(jnp.asarray(t), parts, example.gait))]
        np.testing.assert_allclose(
            called(function, t, state, size=len(leaves)), np.array(expected), rtol=1e-12, atol=1e-12
        )


def test_what_cannot_be_written_in_c_is_one_line() -> None:
    with pytest.raises(sj.InputError, match="`2x` is no name in C"):
        exchange.c_function(sj.preset("paper-forward").model, name="2x")
    case = small()[0]
    times = case.runs[0].times
    logged = sj.Gait(*(sj.Logged.of(times, jnp.sin(times)) for _ in range(2)))
    with pytest.raises(sj.InputError, match="cannot be written in C"):
        exchange.c_function(sj.preset("paper-forward").model, logged)


def test_each_effect_that_acts_at_one_instant_can_be_written() -> None:
    board = sj.Board(**sj.TABLE_II)
    for name, kind in LIBRARY.items():
        model = sj.Model(board, sj.Pacejka(8.0, 1.3, 0.9, 0.2), "free")
        model = model.add(**{name: kind(**kind.secant_step)})
        if not isinstance(model.effects[name], sj.InputModifier):
            assert "void snakejax_rates(" in exchange.c_function(model)
