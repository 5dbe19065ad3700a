"""Reports, opened in a real browser: no network, every control works, what is shown is what is in the JSON."""

import json
import re

import numpy as np
import pytest
from browsing import Seen, check, written
from small import NASTY, NASTY_RUN, small

from snakejax import Case, Fit, Noise
from snakejax._json import fit_json, provenance_json
from snakejax._played import played_fit
from snakejax.report import fit_page


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
