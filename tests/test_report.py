"""Reports, opened in a real browser: no network, every control works, what is shown is what is in the JSON."""

import json
import re

import numpy as np
import pytest
from browsing import Seen, check, numbers, written
from small import NASTY, NASTY_RUN, small

from snakejax import Case, Fit, Noise
from snakejax._played import played_fit
from snakejax._provenance import provenance_json
from snakejax._results import fit_json
from snakejax.report import fit_page, sweep_page, tune_page


@pytest.fixture(scope="module")
def nasty() -> tuple[Case, Noise, Fit]:
    """A fit in which every name that comes from a file is a trap."""
    return small(NASTY, (NASTY_RUN, NASTY), NASTY)


def test_names_from_files_are_shown_as_text(nasty, browser, tmp_path) -> None:
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {"effect": [NASTY]}, case.sha256))
    seen = Seen(browser, written(tmp_path, fit_page(case, noise, found, result, played_fit(found))))
    assert NASTY in seen.page.inner_text("h1")
    assert seen.page.inner_text("figure[data-run] figcaption") == NASTY_RUN
    assert NASTY in seen.page.text_content("#chart-failing-0")
    assert seen.page.query_selector_all("img") == []
    assert len(seen.page.query_selector_all("body script")) == 5
    check(seen)


def test_a_path_is_where_the_board_was(nasty, tmp_path) -> None:
    """The numbers of the chart, without a browser: measured and modelled x against y."""
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {}, {}))
    text = fit_page(case, noise, found, result, played_fit(found))
    charts = json.loads(re.search(r'<script id="charts" type="application/json">(.*?)</script>', text, re.S)[1])
    measured, modelled = charts["chart-path-0"]["data"][:2]
    pose = np.asarray(case.runs[0].pose)
    assert measured["x"][:50] == pytest.approx(pose[:50, 0], rel=1e-4, abs=1e-9)
    assert measured["y"][100:120] == [None] * 20
    assert np.abs(np.array(modelled["x"][:50]) - pose[:50, 0]).max() < 5 * float(noise.position)


HEAD = {"schema": 1, "case": NASTY, "model": "pacejka", "skid": "coupled", "provenance": provenance_json(0, {}, {})}


def test_a_sweep_along_one_parameter(browser, tmp_path) -> None:
    D = [0.5 * k for k in range(1, 13)]
    k_s = [None, *(3.0 + 2 * d for d in D[1:])]
    ends = {"x_m": [0.01 * d for d in D], "y_m": [0.0] * 12, "heading_rad": [None, *D[1:]]}
    fitted = {"polynomial": [0.0, 0.0, 0.0, 2.0, 3.0], "r_squared": 1.0, "fitted_range": [1.0, 6.0]}
    result = {**HEAD, "axes": ["D"], "D": D, "k_s": k_s, "mismatch": [0.01] * 12, **fitted, "end": ends}
    seen = Seen(browser, written(tmp_path, sweep_page(result)))
    numbers(seen)
    curve, marks = seen.traces("k_s")
    assert marks["x"] == D and marks["y"][0] is None
    assert marks["y"][1:] == pytest.approx(k_s[1:])
    assert curve["y"] == pytest.approx([3.0 + 2 * x for x in curve["x"]], rel=1e-4)
    assert len(seen.page.query_selector_all("tbody tr")) == 12


def test_a_sweep_over_two_parameters(browser, tmp_path) -> None:
    values = [[1.0, 2.0, 3.0], [4.0, None, 6.0]]
    ends = {key: values for key in ("x_m", "y_m", "heading_rad")}
    axes = {"axes": ["load", "camber"], "load": [1.0, 2.0], "camber": [0.0, 0.1, 0.2]}
    nothing = {"polynomial": None, "r_squared": None, "fitted_range": None}
    result = {**HEAD, **axes, "k_s": values, "mismatch": values, **nothing, "end": ends}
    seen = Seen(browser, written(tmp_path, sweep_page(result)))
    numbers(seen)
    (k_s,) = seen.traces("map-0")
    assert (k_s["x"], k_s["y"], k_s["z"]) == ([0.0, 0.1, 0.2], [1.0, 2.0], values)


def test_a_tuned_gait(browser, tmp_path) -> None:
    t = [0.1 * k for k in range(20)]
    path = {"t": t, "x": t, "y": t, "heading": t, "phi": t, "psi": t}
    side = {"gait": None, "objective": 0.5, "effort_n2m2s": 1.0, "path": path}
    gait = {"phi": [[0.3, 4.0, 0.1]], "psi": [[1.0, 4.0, 0.0], [0.1, 8.0, 0.2]]}
    limits = {"phi": 0.9, "psi_rate": 6.5}
    result = {**HEAD, "asked": "distance", "duration_s": 8.0, "start": [0.0, 0.0, 0.0], "objective": 1.25, "met": True}
    result |= {"gait": gait, "limits": limits, "reached": {"phi": 0.31, "psi_rate": 4.8}}
    result |= {"before": side, "after": {**side, "objective": 1.25}, "spread": [1.2, 1.3, 1.1]}
    seen = Seen(browser, written(tmp_path, tune_page(result)))
    numbers(seen)
    assert "1.25 m, where the best known gait has 0.5 m" in seen.page.inner_text("h1")
    assert seen.traces("spread-objective")[0]["y"] == [1.2, 1.3, 1.1]
    assert [trace["name"] for trace in seen.traces("psi")] == ["best known", "tuned"]
