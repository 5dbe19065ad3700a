"""Reports, opened in a real browser: no network, every control works, what is shown is what is in the JSON."""

import dataclasses
import json
import re

import numpy as np
import pytest
from helpers.browser import Seen, check, numbers, written
from helpers.made_up_explanation import models, result, story
from helpers.small_case import NASTY, NASTY_RUN, small

from snakejax import Case, Fit, Noise
from snakejax.diagnosis.explanation import run_bands
from snakejax.estimation.goodness_of_fit import BAND
from snakejax.present.as_json.fit import fit_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.as_text.tables import error, number
from snakejax.present.report import explanation_page, fit_page, sweep_page, tune_page
from snakejax.present.views import view_of_fit


@pytest.fixture(scope="module")
def nasty() -> tuple[Case, Noise, Fit]:
    """A fit in which every name that comes from a file is a trap."""
    return small(NASTY, (NASTY_RUN, NASTY), NASTY)


@pytest.mark.slow
def test_names_from_files_are_shown_as_text(nasty, browser, tmp_path) -> None:
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {"effect": [NASTY]}, case.sha256))
    seen = Seen(browser, written(tmp_path, fit_page(case, noise, found, result, view_of_fit(found))))
    assert NASTY in seen.page.inner_text("h1")
    assert seen.page.inner_text("figure[data-run] figcaption") == NASTY_RUN
    assert NASTY in seen.page.text_content("#chart-failing-0")
    assert seen.page.query_selector_all("img") == []
    assert len(seen.page.query_selector_all("body script")) == 5
    check(seen)


@pytest.mark.slow
def test_a_path_is_where_the_board_was(nasty, tmp_path) -> None:
    """The numbers of the chart, without a browser: measured and modelled x against y."""
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {}, {}))
    text = fit_page(case, noise, found, result, view_of_fit(found))
    charts = json.loads(re.search(r'<script id="charts" type="application/json">(.*?)</script>', text, re.S)[1])
    measured, modelled = charts["chart-path-0"]["data"][:2]
    pose = np.asarray(case.runs[0].pose)
    assert measured["x"][:50] == pytest.approx(pose[:50, 0], rel=1e-4, abs=1e-9)
    assert measured["y"][100:120] == [None] * 20
    assert np.abs(np.array(modelled["x"][:50]) - pose[:50, 0]).max() < 5 * float(noise.position)


@pytest.mark.slow
def test_the_story_of_what_nothing_known_explains(browser, tmp_path) -> None:
    told = result() | {"quality": {"as_recorded": False, "findings": [], "masked": {}}}
    seen = Seen(browser, written(tmp_path, explanation_page(story(), told, models())))
    page = seen.page
    assert page.inner_text("#recordings p") == "No defects were found."
    text = page.inner_text("#ranking")
    assert "These runs cannot distinguish quadratic_drag from longitudinal_slip or body_drag." in text
    assert text.count("These runs cannot distinguish") == 1
    assert [t["name"] for t in seen.traces("tyre") if t["mode"] == "lines" and "fill" not in t] == [
        "base model",
        "+ ground_slope",
        "+ ground_slope + rotor_gain",
    ]
    shown = {c.get_attribute("data-key"): c.text_content() for c in page.query_selector_all("[data-key]")}
    assert shown["base.misfit.train^0.5"] == "205" and shown["base.rmse.train.heading_rad*1000"] == "1.00"
    # Each component that is felt has an axis, and nothing is written beyond the edge of its chart.
    force = page.evaluate("document.getElementById('chart-force-0').data.map(t => t.yaxis)")
    assert force == ["y", "y", "y2", "y2"]
    beyond = (
        "() => [...document.querySelectorAll('.chart')].flatMap(c => { const box = c.getBoundingClientRect();"
        "return [...c.querySelectorAll('text')].filter(t => t.textContent.trim()).filter(t => {"
        "const r = t.getBoundingClientRect(); return r.width && (r.left < box.left - 1 || r.right > box.right + 1); })"
        ".map(t => `${c.id}: ${t.textContent}`); })"
    )
    assert page.evaluate(beyond) == []
    check(seen)
    seen.draw()
    assert page.evaluate(beyond) == []


def test_nothing_is_said_of_the_variables_of_a_random_force() -> None:
    """None were tested for it, unlike for a force in which none was found."""
    force = story().missing
    assert force is not None
    unknown = dataclasses.replace(force, depends_on=())
    found = result()
    found["unexplained"] = found["unexplained"] | {"depends_on": []}

    def page(of) -> str:
        return explanation_page(dataclasses.replace(story(), missing=of), found, models())

    assert "No variable of these runs predicts it." in page(unknown)
    random = page(dataclasses.replace(unknown, misfit=None, shape=None))
    assert "No variable of these runs predicts it." not in random and "It is a random force" in random


@pytest.mark.slow
@pytest.mark.parametrize(("phone", "buttons"), [(True, False), (False, True)])
def test_the_buttons_of_a_chart_do_not_lie_on_a_phone(browser, tmp_path, phone, buttons) -> None:
    """Where there is no mouse they would always be there, over the data; in print they never are."""
    file = written(tmp_path, explanation_page(story(), result(), models()))
    context = browser.new_context(viewport={"width": 390, "height": 800}, has_touch=phone, is_mobile=phone)
    page = context.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("html[data-charts=yes]")
    chart = page.query_selector("#chart-falling")
    chart.scroll_into_view_if_needed()
    chart.wait_for_selector(".main-svg", state="attached")
    seen = "() => [...document.querySelectorAll('#chart-falling .modebar')].some(e => e.getBoundingClientRect().width)"
    assert page.evaluate(seen) is buttons
    page.emulate_media(media="print")
    assert page.evaluate(seen) is False
    context.close()


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (14.863, 0.387, "14.86 0.39"),
        (6.298, 101.2, "6 101"),
        (-0.3, 32.0, "0 32"),
        (6.857e-8, 9.928e-8, "6.9e-08 9.9e-08"),
        (-1.434e-7, 8.841e-8, "-1.43e-07 8.8e-08"),
        (0.0, 1e-12, "0 1.0e-12"),
        (0.0, 0.5, "0.00 0.50"),
        (13.44311360854382, 1.2e-133, "13.4431136 1.2e-133"),
        (7969.17785960231572, 2.6e-36, "7969.17786 2.6e-36"),
        (1.25e-7, 1e-20, "1.25e-07 1.0e-20"),
        (5.0, float("nan"), "5 "),
    ],
)
def test_a_number_has_the_digits_that_its_error_bears(value, sd, shown) -> None:
    assert f"{number(value, sd)} {error(sd)}" == shown


HEAD = {"schema": 1, "case": NASTY, "model": "pacejka", "skid": "coupled", "provenance": provenance_json(0, {}, {})}


@pytest.mark.slow
def test_a_sweep_along_one_parameter(browser, tmp_path) -> None:
    D = [0.5 * k for k in range(1, 13)]
    k_s = [None, *(3.0 + 2 * d for d in D[1:])]
    ends = {"x_m": [0.01 * d for d in D], "y_m": [0.0] * 12, "heading_rad": [None, *D[1:]]}
    fitted = {"polynomial": [0.0, 0.0, 0.0, 2.0, 3.0], "r_squared": 1.0, "fitted_range": [1.0, 6.0]}
    result = {
        **HEAD,
        "axes": ["D"],
        "units": {"D": "N"},
        "D": D,
        "k_s": k_s,
        "mismatch": [0.01] * 12,
        **fitted,
        "end": ends,
    }
    seen = Seen(browser, written(tmp_path, sweep_page(result)))
    numbers(seen)
    curve, marks = seen.traces("k_s")
    assert marks["x"] == D and marks["y"][0] is None
    assert marks["y"][1:] == pytest.approx(k_s[1:])
    assert curve["y"] == pytest.approx([3.0 + 2 * x for x in curve["x"]], rel=1e-4)
    assert len(seen.page.query_selector_all("tbody tr")) == 12


@pytest.mark.slow
def test_a_sweep_over_two_parameters(browser, tmp_path) -> None:
    values = [[1.0, 2.0, 3.0], [4.0, None, 6.0]]
    ends = {key: values for key in ("x_m", "y_m", "heading_rad")}
    axes = {
        "axes": ["load", "camber"],
        "units": {"load": "N", "camber": "rad"},
        "load": [1.0, 2.0],
        "camber": [0.0, 0.1, 0.2],
    }
    nothing = {"polynomial": None, "r_squared": None, "fitted_range": None}
    result = {**HEAD, **axes, "k_s": values, "mismatch": values, **nothing, "end": ends}
    seen = Seen(browser, written(tmp_path, sweep_page(result)))
    numbers(seen)
    (k_s,) = seen.traces("map-0")
    assert (k_s["x"], k_s["y"], k_s["z"]) == ([0.0, 0.1, 0.2], [1.0, 2.0], values)


@pytest.mark.slow
def test_a_tuned_gait(browser, tmp_path) -> None:
    t = [0.1 * k for k in range(20)]
    path = {"t": t, "x": t, "y": t, "heading": t, "phi": t, "psi": t}
    side = {"gait": None, "objective": 0.5, "effort_n2m2s": 1.0, "path": path}
    gait = {"phi": [[0.3, 4.0, 0.1]], "psi": [[1.0, 4.0, 0.0], [0.1, 8.0, 0.2]]}
    limits = {"phi": 0.9, "psi_rate": 6.5}
    result = {**HEAD, "asked": "distance", "duration_s": 8.0, "start": [0.0, 0.0, 0.0], "objective": 1.25, "met": True}
    result |= {"units": {"phi": "rad", "psi": "rad"}}
    result |= {"gait": gait, "limits": limits, "reached": {"phi": 0.31, "psi_rate": 4.8}}
    result |= {"before": side, "after": {**side, "objective": 1.25}, "spread": [1.2, 1.3, 1.1]}
    seen = Seen(browser, written(tmp_path, tune_page(result)))
    numbers(seen)
    assert "1.25 m, where the best known gait has 0.5 m" in seen.page.inner_text("h1")
    assert seen.traces("spread-objective")[0]["y"] == [1.2, 1.3, 1.1]
    assert [trace["name"] for trace in seen.traces("psi")] == ["best known", "tuned"]
    strokes = [trace for trace in seen.traces("path") if trace["name"] == "heading"]
    assert len(strokes) == 2 and strokes[0]["x"][3:5] == pytest.approx([0.1, 0.1 + 0.05 * 1.9 * np.cos(0.1)], 1e-5)
    assert re.search(r"psi_rate\s+\S+\s+\S+\s+rad/s\b", seen.page.inner_text("body"))


@pytest.mark.slow
def test_a_band_is_drawn_over_what_was_measured() -> None:
    """The run that was measured less its prediction, and 1.96 standard deviations to both sides, in mm and mrad."""
    run, unseen = story().case.runs[:2]
    sd = np.tile([0.002, 0.003, 0.001], (len(run.times), 1))
    residual = sd * np.random.default_rng(1).normal(size=sd.shape)
    residual[50:60] = np.nan
    (band,) = run_bands([run, unseen], [residual, np.full_like(sd, np.nan)], [sd, sd])
    seen = np.isfinite(residual)
    assert band.inside == (np.abs(residual[seen] / sd[seen]) <= BAND).mean()
    text = explanation_page(dataclasses.replace(story(), bands=(band,)), result(), models())
    charts = json.loads(re.search(r'<script id="charts" type="application/json">(.*?)</script>', text, re.S)[1])
    areas, lines = charts["chart-band-0"]["data"][::2], charts["chart-band-0"]["data"][1::2]
    for channel, (area, line) in enumerate(zip(areas, lines, strict=True)):
        end = 1e3 * BAND * sd[0, channel]
        assert (min(area["y"]), max(area["y"])) == pytest.approx((-end, end), rel=1e-5)
        assert line["y"][:50] == pytest.approx(list(1e3 * residual[:50, channel]), rel=1e-5)
        assert line["y"][50:60] == [None] * 10
    assert f"{100 * band.inside:.1f}% inside" in text
