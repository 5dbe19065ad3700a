"""What a reader is told first: how large the error is, in mm, mrad and multiples of the noise, and of which fit."""

import dataclasses
import json
import re

import numpy as np
import pytest
from helpers.made_up_explanation import models, result, story
from helpers.small_case import small
from rich.console import Console
from rich.table import Table

from snakejax import Fit, Noise
from snakejax.commands.cli.simulate import _report as simulated
from snakejax.diagnosis.explanation import PoseError, Remainder
from snakejax.diagnosis.latent_force.missing_force import RunForce
from snakejax.diagnosis.residuals.comparison import ModelScore, compare
from snakejax.estimation import fit
from snakejax.estimation.fit_workspace import problem_of
from snakejax.estimation.fitting import fit_result
from snakejax.estimation.goodness_of_fit import Score
from snakejax.estimation.initialisation import has_converged
from snakejax.estimation.replay import fitted_starts, replay
from snakejax.estimation.uncertainty import Estimate
from snakejax.present import plot
from snakejax.present.as_json.comparison import comparison_json
from snakejax.present.as_json.fit import fit_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.as_text.certainty import confidence_sentences, floor_sentences
from snakejax.present.as_text.columns import (
    DETECTS,
    ERROR,
    EXPECTED,
    FALL,
    HEADING,
    POSITION,
    REFIT,
    WINDOWS,
    narrow,
    of_heldout,
)
from snakejax.present.as_text.comparison import compare_report
from snakejax.present.as_text.errors import error_text, milli_text, pose_error_text, times_noise, times_noise_text
from snakejax.present.as_text.explanation import diagnosis_text, explanation_text
from snakejax.present.as_text.first_lines import first_lines
from snakejax.present.as_text.fit import fit_report
from snakejax.present.as_text.missing import components_text, determined
from snakejax.present.as_text.tables import value_text
from snakejax.present.report import diagnosis_page, explanation_page, fit_page, tune_page
from snakejax.present.views import view_of_fit


def shown(renderable) -> str:
    """What a terminal of 80 columns shows, its lines joined."""
    console = Console(width=80, color_system=None)
    with console.capture() as capture:
        console.print(renderable)
    lines = capture.get().splitlines()
    assert max(map(len, lines)) <= 80
    return "\n".join(lines)


def joined(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def words(page: str) -> str:
    """What a reader sees of a page: no scripts, no tags; labels of charts and of axes are read apart."""
    page = re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.S)
    return joined(re.sub(r"<[^>]*>", " ", page))


def charts(page: str) -> dict:
    return json.loads(re.search(r'<script id="charts" type="application/json">(.*?)</script>', page, re.S)[1])


def axis_titles(page: str) -> set[str]:
    """The titles of all axes and colour bars of a page."""
    found = {part["title"]["text"] for c in charts(page).values() for k, part in c["layout"].items() if "axis" in k}
    return found | {t["colorbar"]["title"]["text"] for c in charts(page).values() for t in c["data"] if "colorbar" in t}


@pytest.fixture(scope="module")
def tenfold() -> tuple[Noise, Fit]:
    """The small case, its noise said to be a tenth of what it is: the fit is off by ten times the noise."""
    case, noise, found = small()
    tenth = Noise(noise.position / 10, noise.heading / 10, "given")
    return tenth, fit(found.model, case.runs, tenth, ["tyre.D"])


def off(found: Fit, noise: Noise) -> tuple[float, float, float]:
    """The error of the train run, counted anew: position [m], heading [rad], and all channels over their noise."""
    case = small()[0]
    (run,) = (run for run in case.runs if run.role == "train")
    pose = replay(found.model, case.runs, fitted_starts(found))[0]
    left = np.asarray(run.pose) - pose
    left = left[np.isfinite(left).all(axis=1)]
    position = np.sqrt(np.mean(left[:, 0] ** 2 + left[:, 1] ** 2))
    whole = np.sqrt(np.mean((left / np.asarray(noise.channels)) ** 2))
    return float(position), float(np.sqrt(np.mean(left[:, 2] ** 2))), float(whole)


@pytest.mark.slow
def test_an_error_of_ten_times_the_noise_is_called_so(tenfold) -> None:
    """Terminal and report tell root mean squares, as counted from the poses themselves."""
    noise, found = tenfold
    position, heading, whole = off(found, noise)
    assert whole == pytest.approx(10, rel=0.1)
    told = f"{1e3 * position:.3f} mm and {1e3 * heading:.2f} mrad ({whole:.2f} times the noise)"
    case = small()[0]
    assert f"train: root mean square error {told}" in joined(shown(fit_report(case, noise, found)))
    made = fit_json(case, noise, found, provenance_json(0, {}, {}))
    page = fit_page(case, noise, found, made, view_of_fit(found))
    assert told in words(page)
    assert made["base"]["misfit"]["train"] == pytest.approx(whole**2, rel=1e-6), "The JSON keeps the mean square."
    (bar,) = [bar for bar in charts(page)["chart-falling"]["data"] if bar["name"] == "train runs"]
    assert bar["y"] == [pytest.approx(whole, rel=1e-6)] and bar["text"] == [f"{whole:.2f}"]
    every = np.concatenate([t["z"][0] for t in charts(page)["chart-failing-0"]["data"]]).astype(float)
    assert 10 ** np.nanmean(every) == pytest.approx(10, rel=0.15)
    for variable in ("gait_phase", "slip", "speed"):
        assert np.mean(charts(page)[f"chart-against-{variable}"]["data"][0]["y"]) == pytest.approx(10, rel=0.15)
    sides = (ModelScore("pacejka", found.train_score, found.heldout_score),)
    (row,) = [
        line for line in shown(compare_report(compare(found), sides)).splitlines() if line.startswith("  pacejka")
    ]
    assert row.split()[1] == f"{whole:.2f}"


@pytest.mark.slow
def test_no_output_calls_a_mean_square_an_error() -> None:
    """205 is the root of the 42 000 of the story that was made up, 17.7 that of 312, 2.65 that of 7.04."""
    base = "12.3 mm and 1.00 mrad (205 times the noise)"
    final = "0.160 mm and 0.130 mrad (2.65 times the noise)"
    page = explanation_page(story(), result(), models())
    for text in (joined(shown(explanation_text(story()))), words(page)):
        assert base in text and final in text and "17.7" in text
        assert "misfit" not in text.lower() and "4.2e4" not in text
    text = joined(shown(diagnosis_text(story().case, story().base)))
    assert base in text and "misfit" not in text.lower()
    assert re.search(r"ground_slope\S* 1e-310 2\.32 18\.4 ", text), "Roots of 5.4 and of 340."
    assert not {title for title in axis_titles(page) if "misfit" in title or "squared" in title}
    assert "misfit" not in " ".join(re.findall(r'aria-label="[^"]*"', page))


def test_every_column_of_the_candidates_is_explained_below_them() -> None:
    found = story()
    text = joined(shown(diagnosis_text(found.case, found.base)))
    heads, _, legend = text.partition("p: probability of such an improvement by chance")
    for column in ("/ noise", "expected", "detects"):
        assert column in heads and f"{column}: " in legend
    legend = joined(shown(explanation_text(found))).partition("p: probability")[2]
    assert "expected: " in legend and "detects: " not in legend
    assert "Detects: the smallest value that these runs would show" in words(
        explanation_page(found, result(), models())
    )


HEADS = ("cause", "error", "validation", "how sure")


@pytest.mark.parametrize("verdict", ["explained", "unexplained"])
def test_terminal_and_page_begin_with_cause_error_validation_and_certainty(verdict) -> None:
    """In this order, before any table and any chart."""
    found = story(verdict=verdict)
    terminal = joined(shown(explanation_text(found)))
    page = words(explanation_page(found, result(found), models()))
    page = page[: page.index("Paths, measured and modelled")]
    for text in (terminal[: terminal.index("step [mm]")], page):
        places = [text.index(head) for head in HEADS if head != "how sure" or verdict == "unexplained"]
        assert places == sorted(places), text
        error = "from 12.3 mm and 1.00 mrad (205 times the noise) to 0.160 mm and 0.130 mrad (2.65 times the noise)"
        assert error in text and "not used in the fit: from 21.7 mm" in text
        assert "rotor_gain: The rotor turns further than commanded, or less far. g = 1.000 +- 0.020 mrad" in text
        assert ("small: explained by ground_slope and rotor_gain" in text) is (verdict == "explained")
        assert ("No known effect brings the error down to the noise." in text) is (verdict == "unexplained")


@pytest.mark.parametrize(
    ("misfit", "floor", "heldout", "unseen"),
    [
        (1.02, None, True, True),  # only noise is left
        (1.3, None, True, False),
        (7.04, PoseError(1e-4, 1e-4, "cameras and a random force"), True, True),
        (1.02, None, False, False),
    ],
)
def test_it_is_said_where_only_the_held_out_runs_are_unexplained(misfit, floor, heldout, unseen) -> None:
    *before, last = story().steps
    last = dataclasses.replace(last, train=last.train._replace(misfit=misfit))
    last = last if heldout else dataclasses.replace(last, heldout=None)
    lines = dict(first_lines(dataclasses.replace(story(), steps=(*before, last), floor=floor)))
    begins = "The train runs are explained, the held-out runs are not" if unseen else "No known effect brings the error"
    assert lines["cause"].startswith(begins)
    assert ("the held-out runs show an effect, or conditions" in lines["how sure"]) is unseen


@pytest.mark.parametrize(("misfit", "verdict", "said"), [(7.0, "explained", True), (1.0, "explained", False)])
def test_it_is_said_where_held_out_runs_go_beyond_what_the_train_runs_determine(misfit, verdict, said) -> None:
    *before, last = story(verdict=verdict).steps
    assert last.heldout is not None
    last = dataclasses.replace(last, heldout=last.heldout._replace(misfit=misfit))
    lines = dict(first_lines(dataclasses.replace(story(verdict=verdict), steps=(*before, last))))
    assert ("They go beyond the train runs" in lines["validation"]) is said


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(3.00006e-3, 1.7e-7, "rad", True), "3.000 mrad (+- less than 0.001)"),
        (Estimate(-0.0123, 0.0045, "m", True), "-12.3 +- 4.5 mm"),
        (Estimate(0.150234, 0.00021, "N/m", True), "0.1502 +- 0.00021 N/m"),
        (Estimate(12345.6, 0.2, "N", True), "12346 N (+- less than 10)"),
        (Estimate(0.37, 0.05, "-", True), "0.370 +- 0.050"),
        (Estimate(1.2, None, "rad", False, True), "1.2 rad"),
        (Estimate(0.0, 0.5, "N", True), "0.00 +- 0.50 N"),
    ],
)
def test_a_value_in_the_first_lines_has_at_most_four_digits(estimate, text) -> None:
    assert value_text(estimate) == text


def test_a_component_that_the_data_do_not_show_is_not_determined() -> None:
    """Its estimate is that of the prior: zero, with an error that is the prior's too."""
    t, one = np.linspace(0.0, 4.0, 40), np.ones(40)
    force = np.stack([0.2 * np.sin(t), 0.05 * one, 2.8e-8 * np.cos(t)], axis=1)
    sd = np.stack([0.01 * one, 0.01 * one, 6e-6 * one], axis=1)
    runs = (RunForce("here", t, force, sd),)
    assert determined(runs) == (True, True, False)
    missing = dataclasses.replace(story().missing, runs=runs)
    assert components_text(missing) == "0.13 N along the board, 0.05 N across it, in yaw not determined"
    found = dataclasses.replace(story(), missing=missing)
    page = explanation_page(found, result(found), models())
    assert "in yaw not determined" in words(page) and "in yaw not determined" in joined(shown(explanation_text(found)))
    assert {trace["yaxis"] for trace in charts(page)["chart-force-0"]["data"]} == {"y", "y2"}
    felt_nowhere = (RunForce("here", t, force, np.full_like(sd, np.nan)),)
    assert determined(felt_nowhere) == (False, False, False)


def test_what_remains_says_with_what_it_goes() -> None:
    """Above the floor, in mm and mrad; no variable where none is significant."""
    floor = PoseError(1e-3, 2e-3, "cameras and a random force")
    depends = (("rotor_rate", 0.31), ("world_position", 0.02))
    rest = Remainder(3.2e-3, 4.5e-3, depends)
    found = dataclasses.replace(story(verdict="explained"), floor=floor, remainder=rest)
    text = joined(shown(explanation_text(found)))
    assert "The error of the model is 3.20 mm and 4.50 mrad above that" in text
    assert "residuals in train runs depends on rotor_rate (31%) and world_position (2%)" in text
    assert "one of these laws" not in text
    undecided = dataclasses.replace(found, remainder=rest._replace(laws=("east = b * x", "east = b * y")))
    laws = "one of these laws may be missing: east = b * x; or east = b * y."
    assert laws in joined(shown(explanation_text(undecided)))
    alone = dataclasses.replace(found, remainder=rest._replace(depends_on=()))
    assert "depend on no variable (5%)" in joined(shown(explanation_text(alone)))


def test_a_constant_at_the_limit_of_what_is_known_of_it_has_no_error_and_is_named() -> None:
    constants = {
        "mass": Estimate(7.0, 0.05, "kg", True),
        "inertia": Estimate(0.01319, None, "kg m^2", False, True),
    }
    floor = PoseError(4e-4, 2.5e-3, "cameras")
    told = dataclasses.replace(story(), floor=floor, constants=constants)
    text = " ".join(floor_sentences(told))
    alone = " ".join(floor_sentences(dataclasses.replace(told, constants_share=0.6)))
    assert "They take away 60% of the squared error." in alone and "take away" not in text
    assert "mass = 7.000 +- 0.050 kg, inertia = 0.01319 kg m^2." in text
    assert "At the limit of this uncertainty: inertia." in text


@pytest.mark.parametrize(("of_windows", "words"), [(True, "each left out in turn"), (False, "held-out runs")])
def test_windows_are_judged_by_left_out_recordings_wherever_they_were_cut(of_windows: bool, words: str) -> None:
    """What is sure by recordings left out does not leave only noise; a window may stand in a file of its own."""
    parts = {"confidence": {"ground_slope": "sure"}, "share": {"ground_slope": 0.9}, "of_windows": of_windows}
    text = " ".join(confidence_sentences(dataclasses.replace(story(), **parts), "ground_slope"))
    assert words in text
    assert ("only noise is left" in text) is not of_windows


def test_arrows_of_a_force_have_a_scale() -> None:
    """A bar as long as an arrow of the force that is written beside it."""
    shares = (("world_position", 0.9),)
    found = dataclasses.replace(story(), missing=dataclasses.replace(story().missing, depends_on=shares))
    shafts, _, bar = charts(explanation_page(found, result(found), models()))["chart-shape"]["data"]
    told = float(re.fullmatch(r" ([\d.]+) N", bar["text"][1])[1])
    run = found.missing.runs[0]
    strongest = int(np.argmax(np.hypot(run.force[:, 0], run.force[:, 1])))
    (x0, x1), (y0, y1) = shafts["x"][3 * strongest : 3 * strongest + 2], shafts["y"][3 * strongest : 3 * strongest + 2]
    drawn, force = np.hypot(x1 - x0, y1 - y0), np.hypot(*run.force[strongest, :2])
    assert (bar["x"][1] - bar["x"][0]) / told == pytest.approx(drawn / force, rel=1e-3)


def test_one_quantity_has_one_name() -> None:
    """The columns of the terminal are those of the page; windows and whole runs share no axis."""
    found = story()
    page = explanation_page(found, result(found), models())
    heads = {*re.findall(r'<th scope="col"[^>]*>(.*?)</th>', page)}
    names = {POSITION, HEADING, ERROR, of_heldout(ERROR), FALL, WINDOWS, REFIT, EXPECTED, DETECTS}
    assert names <= heads, names - heads
    terminal = explanation_text(found), diagnosis_text(found.case, found.base)
    told = [str(column.header) for table in map(tables_in, terminal) for t in table for column in t.columns]
    assert {narrow(name) for name in names - {FALL}} <= {*told}
    drawn = charts(page)
    assert drawn["chart-expected"]["layout"]["xaxis"]["title"]["text"] == WINDOWS
    assert drawn["chart-suspects"]["layout"]["xaxis"]["title"]["text"] == REFIT
    assert drawn["chart-suspects"]["layout"]["shapes"][0]["x0"] == pytest.approx(np.sqrt(4.2e4)), "the base"


def tables_in(part) -> list[Table]:
    if isinstance(part, Table):
        return [part]
    return [table for one in getattr(part, "renderables", ()) for table in tables_in(one)]


def test_residuals_are_shown_before_and_after_in_millimetres() -> None:
    found = story()
    drawn = charts(explanation_page(found, result(found), models()))
    for step in ("0", "2"):
        chart = drawn[f"chart-residual-0-{step}"]
        titles = [chart["layout"][axis]["title"]["text"] for axis in ("yaxis", "yaxis2", "yaxis3")]
        assert titles == ["x<br>[mm]", "y<br>[mm]", "heading<br>[mrad]"]
        scene = models()[int(step)].scenes[0]
        left = 1e3 * (scene.measured - scene.pose)
        for c in (0, 1):
            expected = left[:: max(len(left) // 400, 1), c]
            shown_values = np.array([np.nan if v is None else v for v in chart["data"][c]["y"]])
            assert np.allclose(shown_values, expected, atol=1e-4, equal_nan=True)


def test_an_interval_ends_at_the_bounds_which_stand_beside_it() -> None:
    case, noise, found = small()
    loose = dataclasses.replace(found, estimates={**found.estimates, "tyre.D": Estimate(2.0, 9.0, "N", False)})
    made = fit_json(case, noise, loose, provenance_json(0, {}, {}))
    page = fit_page(case, noise, loose, made, view_of_fit(found))
    row = re.search(r"<tr>(<td[^>]*>D</td>.*?)</tr>", page)[1]
    cells = re.findall(r"<td[^>]*>(.*?)</td>", row)
    start = 0.2 * float(case.board.mass) * 9.81 / 2
    assert (
        cells[4].startswith("0.0 to ")
        and cells[-1] == "at least 0"
        and float(cells[-2]) == pytest.approx(start, rel=1e-3)
    )
    assert "0.0 to " in joined(shown(fit_report(case, noise, loose))) and "-15" not in shown(
        fit_report(case, noise, loose)
    )


def heights(axis) -> list[float]:
    return [bar.get_height() for bar in axis.patches]


def test_pictures_show_the_root() -> None:
    """The bars of the falling error, and the marks of the candidates, in multiples of the noise."""
    for figure in (plot.fall(story(), models()), plot.waterfall(story())):
        axis = figure.axes[-1]
        assert axis.get_ylabel() == "error, multiples of the noise"
        assert sorted(heights(axis)) == pytest.approx(sorted(np.sqrt([4.2e4, 1.3e5, 312.0, 417.0, 7.04, 9.5])))
        assert {"205", "17.7", "2.65"} <= {text.get_text() for text in axis.texts}
    windows, axis, _ = plot.ranking(story().base).axes
    assert (windows.get_xlabel(), axis.get_xlabel()) == (WINDOWS, REFIT)
    refitted = np.asarray(axis.collections[0].get_offsets().compressed()).reshape(-1, 2)[:, 0]
    assert sorted(refitted) == pytest.approx(sorted(np.sqrt([312.0, 340.0, 2.1e4])))


@pytest.mark.parametrize(
    ("misfit", "text"),
    [(130_524.7, "361"), (0.9989, "0.999"), (1.0, "1.00"), (1e8, "10000"), (1e14, "1.0e7"), (None, ""), (0.0, "0.00")],
)
def test_multiples_of_the_noise_have_three_digits(misfit, text) -> None:
    assert times_noise_text(misfit) == text
    assert misfit is None or times_noise(misfit) ** 2 == pytest.approx(misfit)


@pytest.mark.parametrize(
    ("metres", "text"),
    [
        (0.24958, "250"),
        (5.6664e-4, "0.567"),
        (-0.0123, "-12.3"),
        (1.2344, "1234"),
        (9.19e-10, "< 0.002"),
        (4.21e-5, "0.042"),
    ],
)
def test_millimetres_have_three_digits_and_none_below_a_micrometre(metres, text) -> None:
    assert milli_text(metres) == text


def test_what_is_not_finite_is_said() -> None:
    assert error_text(Score(np.inf, np.nan, 0.1, 3)) == "not finite mm and 100 mrad (not finite times the noise)"


def test_a_title_is_not_precise_to_nanometres() -> None:
    """A pose that a tuned gait reaches to within rounding."""
    assert pose_error_text(9.19e-10, 1.99e-10) == "less than 0.002 mm and 0.002 mrad"
    t = [0.1 * k for k in range(20)]
    path = {"t": t, "x": t, "y": t, "heading": t, "phi": t, "psi": t}
    missed = {"position_error_m": 9.19e-10, "heading_error_rad": 1.99e-10}
    far = {"position_error_m": 0.5601, "heading_error_rad": 0.98}
    side = {"gait": None, "objective": missed, "effort_n2m2s": 1.0, "path": path}
    tuned = {"schema": 1, "case": "small", "model": "pacejka", "skid": "free", "provenance": provenance_json(0, {}, {})}
    tuned |= {"asked": "reach:0.5,0.3,1", "duration_s": 8.0, "start": [0.0, 0.0, 0.0], "objective": missed, "met": True}
    tuned |= {"gait": {"phi": [[0.3, 4.0, 0.1]], "psi": [[1.0, 4.0, 0.0]]}, "limits": {"phi": 0.9, "psi": 1.6}}
    tuned |= {"units": {"phi": "rad", "psi": "rad"}}
    tuned |= {
        "reached": {"phi": 0.31, "psi": 1.0},
        "before": {**side, "objective": far},
        "after": side,
        "spread": [missed, far],
    }
    page = tune_page(tuned)
    headline = re.search("<h1>(.*?)</h1>", page)[1]
    assert headline == (
        "small: the pose is missed by less than 0.002 mm and 0.002 mrad; the best known gait misses it by 560"
        " mm and 980 mrad."
    )
    assert {"position error [mm]", "heading error [mrad]"} <= axis_titles(page)
    assert charts(page)["chart-spread-position_error_m"]["data"][0]["y"][1] == pytest.approx(560.1)
    legend = [text.get_text() for text in plot.tuned(tuned).axes[0].get_legend().get_texts()]
    assert legend == [
        "best known: off by 560 mm and 980 mrad",
        "tuned: off by less than 0.002 mm and 0.002 mrad",
        "target",
    ]
    *_, target, _, _, stroke = charts(page)["chart-path"]["data"]
    assert (target["name"], target["x"], target["y"]) == ("target pose", [0.5], [0.3])
    start, end = ([stroke["x"][k], stroke["y"][k]] for k in range(2))
    assert start == [0.5, 0.3] and np.arctan2(end[1] - 0.3, end[0] - 0.5) == pytest.approx(1.0, abs=1e-4)


STOPPED = ("base", "rotor_gain", "quadratic_drag", "lateral_skid")
"""Two fits of the story, and two refits of candidates, that were given up on their way."""
LINE = "The fits of base and added rotor_gain did not converge: their errors and values are less certain than"


@pytest.mark.parametrize("verdict", ["explained", "unexplained"])
def test_a_fit_that_did_not_converge_is_said_to_have_not(verdict) -> None:
    """In the terminal beside the verdict, at its step and behind its values, whatever the verdict."""
    found = story(STOPPED, verdict)
    assert [step.converged for step in found.steps] == [False, True, False]
    text = shown(explanation_text(found))
    rows = {line.split("  ")[0].strip(): line for line in text.splitlines()}
    assert "did not converge" in rows["base"] and "did not converge" in rows["added rotor_gain"]
    assert rows["added ground_slope"].rstrip().endswith("20.4")
    text = joined(text)
    assert "or less far. g = 1.000 +- 0.020 mrad (its fit did not converge)" in text
    assert f"! {LINE}" in text and text.index(LINE) < text.index("step [mm]")
    assert re.search(r"quadratic_drag\S* 3e-40 3\.07 145\* ", text) and "*: this refit did not converge" in text
    good = joined(shown(explanation_text(story(verdict=verdict))))
    assert "converge" not in good and "145*" not in good


def test_a_diagnosis_says_that_its_base_did_not_converge() -> None:
    text = joined(shown(diagnosis_text(story().case, story(STOPPED).base)))
    assert "! The fit of base did not converge:" in text and " 145* " in text
    assert "converge" not in joined(shown(diagnosis_text(story().case, story().base)))


def captions(page: str) -> list[str]:
    return re.findall("<caption>(.*?)</caption>", page)


@pytest.mark.parametrize("verdict", ["explained", "unexplained"])
def test_the_report_says_it_beside_the_verdict_and_at_every_table_and_chart(verdict) -> None:
    found = story(STOPPED, verdict)
    page = explanation_page(found, result(found), models(found))
    assert re.search(rf"</h1>\s*<p class=\"warning\">{LINE}", page)
    bad = "(did not converge)"
    assert {
        f"The errors of each run with the final model {bad}",
        f"The base model {bad}",
        f"The final model {bad}",
    } <= {*captions(page)}
    text = words(page)
    assert f"base {bad} 12.3 1.00" in text and f"added rotor_gain {bad} 0.160 0.130" in text
    assert "added ground_slope 1.06" in text and f"145 {bad}" in text
    drawn = charts(page)
    assert [name.replace("<br>", " ") for name in drawn["chart-falling"]["data"][0]["x"]] == [
        f"base {bad}",
        "1. added ground_slope",
        f"2. added rotor_gain {bad}",
    ]
    # Each chart in which a curve of such a fit is drawn names it so, and no other.
    for chart in ("path-0", "autocorrelation", "tyre"):
        names = {t["name"] for t in drawn[f"chart-{chart}"]["data"] if (t.get("meta") or {}).get("step")}
        assert all((bad in name) == ("rotor_gain" in name or "base" in name) for name in names), chart
    suspects = {t["name"]: t["x"] for t in drawn["chart-suspects"]["data"]}
    assert suspects["refit did not converge"] == pytest.approx(np.sqrt([2.1e4, 312.0]))
    assert suspects["refitted"] == pytest.approx([np.sqrt(340.0)])
    assert "converge" not in words(explanation_page(story(verdict=verdict), result(story(verdict=verdict)), models()))


def test_the_page_of_a_diagnosis_says_it(monkeypatch) -> None:
    found = story(STOPPED)
    monkeypatch.setattr("snakejax.present.report.view_of_step", lambda step: models(found)[0])
    made = {**result(found)}
    for key in ("steps", "final", "verdict", "effects", "unexplained"):
        del made[key]
    page = diagnosis_page(found.case, found.noise, found.base, made)
    assert '<p class="warning">The fit of base did not converge:' in page
    assert "Parameters (did not converge)" in captions(page) and "145 (did not converge)" in words(page)


def test_json_says_which_fits_converged() -> None:
    made = result(story(STOPPED))
    assert made["base"]["converged"] is False and made["final"]["converged"] is False
    assert [step["converged"] for step in made["steps"]] == [True, False]
    refits = {one["effect"]: one["converged"] for one in made["ranking"]}
    assert (refits["lateral_skid"], refits["ground_slope"], refits["quadratic_drag"]) == (False, True, False)
    assert refits["body_drag"] is None, "It was not refitted."
    assert result()["base"]["converged"] is True and result()["final"]["converged"] is True


def test_a_fit_that_stands_still_counts_as_converged() -> None:
    """One that ran out of steps where none would gain anything is not warned of."""
    problem, solution = problem_of(small()[2])
    train, stopped = problem.run_indices("train"), solution._replace(converged=False)
    assert has_converged(problem, stopped, train)
    # A place on its way, with a step of ten standard errors of D still to go.
    there, to_go = stopped.linearised, 10 * float(np.sqrt(stopped.covariance[0, 0]))
    on_the_way = there._replace(residual=there.residual + to_go * there.jacobian[..., 0])
    assert not has_converged(problem, stopped._replace(linearised=on_the_way), train)


def test_fit_and_compare_say_it_everywhere() -> None:
    """The small case with a fit that ran out of steps: terminal, report and JSON."""
    case, noise, found = small()
    problem, solution = problem_of(found)
    stopped = fit_result(problem, solution._replace(converged=False))
    sides = (
        ModelScore("pacejka", found.train_score, None, None, False),
        ModelScore("ideal", found.train_score, None, None, True),
    )
    text = shown(fit_report(case, noise, stopped)) + shown(compare_report(compare(stopped), sides))
    assert "! The fit did not converge" in joined(text)
    rows = [line for line in text.splitlines() if line.startswith(("  pacejka", "  ideal"))]
    assert [row.rstrip().endswith("did not converge") for row in rows] == [True, False]
    made = fit_json(case, noise, stopped, provenance_json(0, {}, {}))
    assert made["base"]["converged"] is False and made["converged"] is False
    made["comparison"] = comparison_json(compare(stopped), sides)
    assert [side["converged"] for side in made["comparison"]["models"]] == [False, True]
    page = fit_page(case, noise, stopped, made, view_of_fit(stopped))
    assert '<p class="warning">The fit of the model did not converge:' in page
    assert {"The errors of each run (did not converge)", "Parameters (did not converge)"} <= {*captions(page)}
    assert "base (did not converge)" in words(page) and "pacejka (did not converge)" in words(page)
    assert {t["name"] for t in charts(page)["chart-against-slip"]["data"]} >= {"model with pull (did not converge)"}
    fine = fit_json(case, noise, found, provenance_json(0, {}, {}))
    assert "converge" not in words(fit_page(case, noise, found, fine, view_of_fit(found)))
    assert "converge" not in shown(fit_report(case, noise, found)) and fine["base"]["converged"] is True


def test_simulate_says_it_of_the_fit_that_it_plays() -> None:
    part = {"parameters": {"B": {"value": 8.0, "unit": "1/rad"}}, "effects": {}}
    for converged in (False, True, None):
        told = {"model": "pacejka", "skid": "free", "base": {**part, "converged": converged}, "runs": []}
        assert ("did not converge" in joined(shown(simulated("small", told)))) is (converged is False)


def test_pictures_say_it() -> None:
    found = story(STOPPED)
    ticks = [label.get_text() for label in plot.waterfall(found).axes[0].get_xticklabels()]
    assert ["did not converge" in tick for tick in ticks] == [True, False, True]
    legend = [text.get_text() for text in plot.fall(found, models(found)).axes[0].get_legend().get_texts()]
    assert ["did not converge" in label for label in legend] == [False, True, True]
    figure = plot.ranking(found.base)
    assert "refit did not converge" in [text.get_text() for text in figure.legends[0].get_texts()]
    marks = figure.axes[1].collections
    places = [np.asarray(mark.get_offsets().compressed()).reshape(-1, 2)[:, 0] for mark in marks]
    assert [*map(sorted, places)] == [[pytest.approx(np.sqrt(340.0))], pytest.approx(np.sqrt([312.0, 2.1e4]))]
    assert len(plot.ranking(story().base).axes[1].collections) == 1


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.69, "away 69% of"),
        (0.0003, "away 0.03% of"),
        (0.0, "away less than 0.01% of"),
        (-0.11, "rises by 11% with it"),
    ],
)
def test_a_step_says_what_it_does_to_the_error(share: float, words: str) -> None:
    effect = story().final.effects[-1]
    found = dataclasses.replace(story(verdict="explained"), confidence={effect: "sure"}, share={effect: share})
    assert words in " ".join(confidence_sentences(found, effect))
