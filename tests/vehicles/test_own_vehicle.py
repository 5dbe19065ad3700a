"""The tutorial "Your own vehicle in 60 lines", as it stands."""

import re

import numpy as np
import pytest
from helpers.folders import ROOT

from snakejax.core.errors import InputError
from snakejax.recording.case import load_case
from snakejax.recording.case_template import write_template
from snakejax.recording.case_vehicle import fields_of
from snakejax.vehicles.registry import VEHICLES, example_values, vehicle_class


@pytest.mark.slow
def test_the_tutorial_runs() -> None:
    text = (ROOT / "docs" / "your-own-vehicle.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    made: dict = {}
    exec(code, made)  # The page's own code.
    assert len([line for line in code.split("\n") if line.strip()]) <= 60
    assert 0.01 < made["gap"] < 20
    # Without slip a steered rear wheel turns it about a point of the front axle's line: v_front = u.
    motion = np.asarray(made["rolling"].pose)
    assert motion[-1, 0] > 1.0 and np.ptp(motion[:, 2]) > 0.1
    assert np.abs(np.asarray(made["slow"].pose) - np.asarray(made["skidding"].pose)).max() > 0.01


def filled_in(text: str, kind: str) -> str:
    """The template as a user fills it in: with the values of the example, and the same motion of all inputs."""
    fields = fields_of(vehicle_class(kind))
    values = {key: example_values(kind)[field.name] for key, field in fields.items() if f'\n{key} = "?"' in text}
    values |= {given.name: "[[0.3, 2.0, 0.0]]" for given in vehicle_class(kind).inputs}
    for key, value in values.items():
        text = re.sub(rf'^{key} = "\?"', f"{key} = {value}", text, flags=re.MULTILINE)
    return text


def test_every_vehicle_has_a_template_that_loads(tmp_path) -> None:
    rows = "".join(f"{t:.2f},{0.1 * t:.4f},0.0,0.0\n" for t in np.arange(0.0, 1.0, 0.02))
    for kind in VEHICLES[1:]:
        path = write_template(tmp_path / kind, kind)
        assert "#  [" not in path.read_text(encoding="utf-8"), f"a constant of {kind} has no meaning"
        for name in ("train-1.csv", "heldout-1.csv"):
            (path.parent / name).write_text(f"time_s,x_m,y_m,heading_rad\n{rows}", encoding="utf-8")
        with pytest.raises(InputError, match=r'are still "\?"'):
            load_case(path.parent)
        path.write_text(filled_in(path.read_text(encoding="utf-8"), kind), encoding="utf-8")
        case = load_case(path.parent)
        assert isinstance(case.board, vehicle_class(kind))
        assert set(case.runs[0].gait.names) == {given.name for given in case.board.inputs}
