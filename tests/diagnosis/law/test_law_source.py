"""A law written as a file is the same effect."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, Model, Pacejka, Sines, Tracked, simulate
from snakejax.core.parameter import parameters
from snakejax.diagnosis.law.source import law_source
from snakejax.dynamics.law import LawParameter, law_class

LAWS = {
    "spring": ("east = k * (x0 - x); north = k * (y0 - y)", {"k": ("N/m", 0.4), "x0": ("m", 0.5), "y0": ("m", 0.8)}),
    "grip": (
        "grip = 1 - a * tanh((rotor_rate / s) ** 2) + b * abs(slip_speed)",
        {"a": ("-", 0.4), "s": ("rad/s", 4.0), "b": ("s/m", 0.3)},
    ),
    "smooth": (
        "X = -u * spline(speed, 0, 0.5, a, b, c, 0.1) + surface(x, -1, 1, time, 0, 1, a, b, c, 0); N = b * sin(x)",
        {n: ("N", 0.1 + 0.2 * k) for k, n in enumerate("abc")},
    ),
    "wheels": (
        "grip = 1 - a * axle * cos(rotor_angle) - b * (wheel_x - wheel_y) - c * turn_rate * rolling_speed * slip_angle",
        {"a": ("-", 0.2), "b": ("1/m", 0.5), "c": ("s^2/(m rad^2)", 0.4)},
    ),
    "resistance": (
        "resistance = (a + b * abs(steering_angle) + c * wheel_x) * tanh(rolling_speed / 0.01)",
        {"a": ("N", 0.1), "b": ("N/rad", 0.2), "c": ("N/m", 0.1)},
    ),
    "lateral": (
        "lateral = (a + b * abs(rolling_speed)) * slip_speed / sqrt(slip_speed ** 2 + e ** 2)",
        {"a": ("N", 0.3), "b": ("N s/m", 0.2), "e": ("m/s", 0.02)},
    ),
    "height": (
        "height = a * sin(3 * wheel_x) + b * wheel_x * wheel_y + c",
        {"a": ("m", 0.003), "b": ("1/m", 0.002), "c": ("m", 0.1)},
    ),
    "mixed": ("X = -a * u * speed; north = b; N = c * sin(heading)", {n: ("N", 0.1) for n in "abc"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_the_file_acts_as_the_law_does(name: str, tmp_path: Path) -> None:
    expression, given = LAWS[name]
    kind = law_class(expression, tuple(LawParameter(part, unit, 0.2) for part, (unit, _) in given.items()))
    values = {part: value for part, (_, value) in given.items()}
    law = kind(**values)
    path = tmp_path / "missing_force.py"
    path.write_text(law_source(law, ("lateral_skid", "yaw_friction")))
    assert "--skid free --with yaw_friction --with THIS_FILE.py:MissingForce" in path.read_text()
    spec = importlib.util.spec_from_file_location("missing_force", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    written = module.MissingForce()
    assert {n: p.domain.unit for n, p in parameters(written).items()} == {n: unit for n, (unit, _) in given.items()}
    base = Model(Board(**TABLE_II, creep_speed=0.01), Pacejka(B=7.0, C=1.4, D=5.0, E=0.0), "free")
    gait = Gait(*(Tracked(Sines.of([[size, 4.0, 0.0]]), kp=100.0, kd=10.0) for size in (0.9, 1.6)))
    poses = [simulate(base.add(law=one), gait, np.arange(100) / 100, (0.1, 0.2, 0.3)).pose for one in (law, written)]
    assert np.allclose(*poses, rtol=0, atol=1e-9)
