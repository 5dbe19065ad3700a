"""Figures against pictures that were looked at, and films as a player sees them.

To renew the pictures after a change that is wanted, run SNAKEJAX_NEW_PICTURES=1 python -m pytest with this file, and
look at them.
"""

import dataclasses
import os
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from helpers.made_up_explanation import models, story
from helpers.small_case import small
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.testing.compare import compare_images
from PIL import Image

from snakejax import InputError, Model, Pacejka, Run, Sines, polynomial
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.dynamics.axle_tyres import FrontRear
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.vehicle import WHEEL
from snakejax.estimation.replay import fitted_starts, replay
from snakejax.present import plot
from snakejax.present.plot.paths import titled
from snakejax.present.report.page import STROKES
from snakejax.present.style import BASE, COLOURS, DASHES, MATPLOTLIB, MEASURED, step_style
from snakejax.present.views import ModelView, view_of_fit, view_of_model
from snakejax.vehicles.car import Car

PICTURES = Path(__file__).parent / "pictures"
TOLERANCE = 6.0
"""Root mean square of the difference in grey levels: another rendering of letters is below, another curve above."""


@pytest.fixture(scope="module")
def model() -> ModelView:
    return view_of_fit(small()[2])


def swept() -> xarray.Dataset:
    """A sweep as `nearest_rayleigh` gives it."""
    D = np.linspace(0.5, 10.0, 12)
    values = {"k_s": ("D", 3 + 2 * D - 0.05 * D**2), "mismatch": ("D", 0.01 + 0.002 * D)}
    found = xarray.Dataset(values, {"D": D})
    found.D.attrs["units"] = "N"
    return found


FIGURES = {
    "paths": lambda m: plot.paths([m]),
    "residuals": lambda m: plot.residuals(m),
    "tyre": lambda m: plot.tyre([m]),
    "vehicle": lambda m: plot.vehicle(m, small()[0].board, time=2.0),
    "sweep": lambda m: plot.sweep(swept(), polynomial(swept().D.values, swept().k_s.values), "made"),
    "ranking": lambda m: plot.ranking(story().base),
    "confusability": lambda m: plot.confusability(story().base),
    "waterfall": lambda m: plot.waterfall(story()),
    "fall": lambda m: plot.fall(story(), models()),
    "missing": lambda m: plot.missing(story()),
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_as_it_was_looked_at(name, model, tmp_path) -> None:
    figure = FIGURES[name](model)
    for axis in figure.axes:
        labelled = axis.get_xlabel() or axis.get_ylabel() or not axis.axison
        assert labelled or axis.get_shared_x_axes().get_siblings(axis), f"An axis of {name} has no unit."
    figure.set_dpi(60)
    drawn, kept = tmp_path / f"{name}.png", PICTURES / f"{name}.png"
    figure.savefig(drawn, dpi=60)
    if os.environ.get("SNAKEJAX_NEW_PICTURES"):
        PICTURES.mkdir(exist_ok=True)
        shutil.copy(drawn, kept)
    assert compare_images(str(kept), str(drawn), tol=TOLERANCE) is None


def test_the_lines_of_the_ranking_are_named_and_at_their_places() -> None:
    base = story().base
    base = dataclasses.replace(base, criteria=base.criteria._replace(significance_level=1e-3))
    figure = plot.ranking(base)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()][-2:] == ["base", "significance level 0.001"]
    assert figure.axes[2].lines[0].get_xdata()[0] == pytest.approx(3.0)


def test_each_channel_of_the_residuals_is_named_beside_its_axis(model) -> None:
    axes = plot.residuals(model).axes
    assert [axis.get_ylabel() for axis in axes[:3]] == ["x / noise", "y / noise", "heading / noise"]
    assert {axis.get_xlabel() for axis in axes[-3:]} == {"time [s]"}


def test_only_candidates_that_are_mistaken_for_others_are_in_the_figure_of_them() -> None:
    base = story().base
    axis = plot.confusability(base).axes[0]
    shown = {label.get_text() for label in axis.get_yticklabels()}
    paired = {name for one in base.ranking for name in (one.effect, *one.confusable_with) if one.confusable_with}
    assert shown == paired and len(shown) < len(base.ranking)
    alone = tuple(dataclasses.replace(one, confusable_with=()) for one in base.ranking)
    axis = plot.confusability(dataclasses.replace(base, ranking=alone)).axes[0]
    assert [text.get_text() for text in axis.texts] == ["all are distinguished"] and not axis.patches


def exchanged(model: ModelView) -> ModelView:
    """With x and y of its paths exchanged."""
    return model._replace(scenes=tuple(s._replace(pose=s.pose[:, [1, 0, 2]]) for s in model.scenes))


def told(**parts) -> Explanation:
    """The story, with other parts."""
    return dataclasses.replace(story(), **parts)


def backwards(step: SelectionStep) -> SelectionStep:
    """With its ranking reversed."""
    return dataclasses.replace(step, ranking=step.ranking[::-1])


def reversed_force(found: LatentForce) -> LatentForce:
    return dataclasses.replace(found, runs=tuple(run._replace(force=-run.force) for run in found.runs))


OTHERS = {
    "paths": lambda m: plot.paths([exchanged(m)]),
    "ranking": lambda m: plot.ranking(backwards(story().base)),
    "confusability": lambda m: plot.confusability(backwards(story().base)),
    "waterfall": lambda m: plot.waterfall(told(steps=story().steps[::-1])),
    "fall": lambda m: plot.fall(story(), [exchanged(one) for one in models()]),
    "missing": lambda m: plot.missing(told(missing=reversed_force(story().missing))),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_curve_is_seen_to_be_another(name, model, tmp_path) -> None:
    """The comparison can fail: the same figure of something else is told from the one that was kept."""
    OTHERS[name](model).savefig(tmp_path / "other.png", dpi=60)
    assert compare_images(str(PICTURES / f"{name}.png"), str(tmp_path / "other.png"), tol=TOLERANCE) is not None


def test_a_random_force_is_drawn_without_the_variables_that_nobody_knows() -> None:
    force = story().missing
    assert force is not None
    axes = plot.missing(told(missing=dataclasses.replace(force, depends_on=()))).axes
    assert len(axes) == 3 * len(force.runs) == len(plot.missing(story()).axes) - 1


def test_figures_are_written_as_raster_and_as_vector_and_the_same_each_time(model, tmp_path) -> None:
    first = [path.read_bytes() for path in plot.save(plot.paths([model]), tmp_path / "a", "paths")]
    again = plot.save(plot.paths([model]), tmp_path / "b", "paths")
    assert [path.suffix for path in again] == [".png", ".svg"]
    assert first == [path.read_bytes() for path in again]
    assert ElementTree.parse(again[1]).getroot().tag.endswith("svg")


def test_every_step_has_a_look_that_no_other_has() -> None:
    looks = [step_style(step) for step in range(1, len(COLOURS) * len(DASHES) + 1)]
    assert len(set(looks)) == len(looks)
    assert not {BASE.colour, MEASURED.colour} & {one.colour for one in looks}
    assert step_style(0) == BASE


def test_the_base_and_the_first_steps_differ_without_colour() -> None:
    assert len({step_style(step).dash for step in range(len(DASHES) + 1)}) == len(DASHES) + 1
    assert {step_style(step).dash for step in range(len(DASHES) + 1)} == set(MATPLOTLIB) == set(STROKES)


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False])
def test_the_base_and_the_last_step_differ_in_the_figure_of_the_fall(given: bool) -> None:
    """Whether the models are given or replayed by the figure itself."""
    found = dataclasses.replace(story(), steps=story().steps[:2])
    axis = plot.fall(found, models(found) if given else ()).axes[0]
    lines = {line.get_label(): line for line in axis.lines}
    base, last = lines["base model"], lines["+ ground_slope"]
    assert base.get_linestyle() != last.get_linestyle()
    assert base.get_color() != last.get_color()


def test_a_gif_plays_the_run_as_fast_as_it_was(model, tmp_path) -> None:
    short = model._replace(scenes=(_cut(model.scenes[0], 60),))
    told: list[tuple[int, int]] = []
    film = plot.animate(
        short,
        small()[0].board,
        tmp_path / "a" / "run.gif",
        progress=lambda event: told.append((event.done, event.total)),
    )
    with Image.open(film) as picture:
        frames = [picture.seek(k) or (picture.info["duration"], picture.copy()) for k in range(picture.n_frames)]
    assert len(frames) == 12 and told[-1] == (12, 12)
    assert sum(duration for duration, _ in frames) / 1000 == pytest.approx(0.6, rel=0.05)
    assert np.asarray(frames[0][1].convert("L")).shape == np.asarray(frames[-1][1].convert("L")).shape
    moved = np.abs(np.asarray(frames[0][1].convert("L"), int) - np.asarray(frames[-1][1].convert("L"), int))
    assert (moved > 50).sum() > 20
    assert [path.name for path in film.parent.iterdir()] == ["run.gif"]


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed.")
def test_an_mp4_plays(model, tmp_path) -> None:
    short = model._replace(scenes=(_cut(model.scenes[0], 60),))
    film = plot.animate(short, small()[0].board, tmp_path / "run.mp4")
    said = subprocess.run(["ffmpeg", "-i", str(film), "-f", "null", "-"], capture_output=True, text=True).stderr
    assert "Video: h264" in said and "Duration: 00:00:00.6" in said


def test_a_film_that_cannot_be_made_is_refused_in_one_line(model, tmp_path, monkeypatch) -> None:
    board = small()[0].board
    with pytest.raises(InputError, match=r"cannot be written as `avi`.*take gif or mp4"):
        plot.animate(model, board, tmp_path / "run.avi")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InputError, match=r"needs ffmpeg.*install ffmpeg, or write a GIF"):
        plot.animate(model, board, tmp_path / "run.mp4")
    with pytest.raises(ValueError, match="There is no run `nowhere`: take one of here, there"):
        plot.vehicle(model, board, "nowhere")
    assert list(tmp_path.iterdir()) == []


def _cut(scene, samples: int):
    """The first `samples` of a scene."""
    track = scene.track._replace(times=scene.track.times[:samples])
    parts = ("measured", "pose", "wheels", "slip_speed")
    joints = {name: angle[:samples] for name, angle in scene.joints.items()}
    return scene._replace(track=track, joints=joints, **{part: getattr(scene, part)[:samples] for part in parts})


@pytest.mark.slow
def test_a_simulated_run_is_a_scene_too() -> None:
    """The same poses as `replay` gives, and residuals in metres and radians."""
    case, _, found = small()
    starts = fitted_starts(found)
    played = view_of_model(found.model, case.runs, starts)
    for scene, run, pose in zip(played.scenes, case.runs, replay(found.model, case.runs, starts), strict=True):
        assert np.allclose(scene.pose, pose, rtol=0, atol=1e-9)
        assert np.allclose(scene.track.residual, np.asarray(run.pose) - pose, rtol=0, atol=1e-9, equal_nan=True)
    assert played.traction is None
    assert [axis.get_title() for axis in plot.paths([played]).axes] == ["here", "there (held out)"]


@pytest.mark.parametrize("name", ["a$b", "$x$", "100 $ and 2 $"])
def test_a_dollar_in_the_name_of_a_run_is_drawn_as_it_is(name, tmp_path) -> None:
    figure = Figure()
    figure.suptitle(titled(name, "heldout"))
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(tmp_path / "title.svg")
    words = [text for text in ElementTree.parse(tmp_path / "title.svg").getroot().itertext() if text.strip()]
    assert f"{name} (held out)" in words


@pytest.mark.slow
def test_a_car_is_drawn_with_its_wheels_where_the_model_has_them() -> None:
    """Two front wheels at R(heading) (front, +-0.6 length), turned by heading and steering angle."""
    car = Car(mass=1.6, inertia=0.008, front=0.08, rear=0.09)
    tyre = Pacejka(4.0, 1.3, 3.0, 0.0)
    inputs = Inputs({"steer": Sines.of([[0.3, 0.0, np.pi / 2]]), "drive": Sines.of([[2.0, 0.0, np.pi / 2]])})
    times = jnp.arange(0.0, 1.0, 0.02)
    run = Run("arc", "train", times, jnp.full((len(times), 3), jnp.nan), inputs)
    view = view_of_model(Model(car, FrontRear(tyre, tyre), "free"), [run], np.array([[0.5, -0.2, 0.7]]))
    (scene,) = view.scenes
    figure = plot.vehicle(view, car, time=0.98)
    x, y, heading = scene.pose[-1]
    angle, length = heading + 0.3, float(car.length)
    drawn = [np.array(line.get_data()) for line in figure.axes[0].lines]
    for side in (-1, 1):
        middle = np.array([x, y]) + 0.08 * np.array([np.cos(heading), np.sin(heading)])
        middle += side * 0.6 * length * np.array([-np.sin(angle), np.cos(angle)])
        along = WHEEL * length * np.array([np.cos(angle), np.sin(angle)])
        wheel = np.stack([middle - along, middle + along], axis=1)
        assert any(line.shape == (2, 2) and np.allclose(line, wheel, atol=1e-9) for line in drawn)
    assert len(plot.snapshots(view, car, count=4).axes[0].lines) == len(drawn) + 3 * (len(car.outline()) + 2 * (2 + 1))


def test_results_of_a_gait_have_units() -> None:
    t = [0.1 * k for k in range(20)]
    path = dict.fromkeys(("t", "x", "y", "heading", "phi", "psi"), t)
    result = {"case": "small", "asked": "distance", "objective": 1.25, "limits": {"phi": 0.9, "psi": 1.6}}
    result |= {"units": {"phi": "rad", "psi": "rad"}}
    sides = {"before": {"path": path, "objective": 0.5}, "after": {"path": path, "objective": 1.25}}
    figure = plot.tuned({**result, **sides, "spread": [1.2, 1.3]})
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [part.get_text() for part in legend.get_texts()] == ["best known: 0.5 m", "tuned: 1.25 m"]
    assert figure.axes[-1].get_ylabel() == "distance [m]"
