"""Reports, opened in a real browser: no network, every control works, what is shown is what is in the JSON."""

import json
import os
import re
import shutil
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Case, Force, Gait, Model, Noise, Pacejka, Run, Sines, fit, param, simulate
from snakejax._json import fit_json, provenance_json
from snakejax._story import explanation_json
from snakejax.report import explanation_page, fit_page

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
NASTY = "<script>alert(1)</script>"
NASTY_RUN = '"><img src=x onerror=alert(2)> %{y} &amp;'
LARGEST = 6e6


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium, the system's own."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        why = f"None of {', '.join(BROWSERS)} is installed."
        (pytest.fail if os.environ.get("SNAKEJAX_NEEDS_BROWSER") else pytest.skip)(why)
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield launched
        launched.close()


class Seen:
    """A page that is open, and all that it complained of or asked for."""

    def __init__(self, browser, path: Path, width: int = 1200) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme="light")
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("dialog", lambda dialog: (self.complaints.append(dialog.message), dialog.dismiss()))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-charts=yes]")
        self.draw()

    def draw(self) -> None:
        """Scroll through, so that every chart is drawn."""
        for chart in self.page.query_selector_all("figure:not([hidden]) .chart"):
            chart.scroll_into_view_if_needed()
            chart.wait_for_selector(".main-svg", state="attached")

    def traces(self, chart: str) -> list[dict]:
        return self.page.evaluate("id => document.getElementById(id).data", f"chart-{chart}")

    @property
    def result(self) -> dict:
        return json.loads(self.page.inner_text("#result") or self.page.text_content("#result"))


def looked_up(result: dict, key: str) -> float | None:
    """The number at `base.misfit.train`, times what stands behind a star."""
    path, _, factor = key.partition("*")
    for part in path.split("."):
        result = result[int(part)] if isinstance(result, list) else result.get(part)
        if result is None:
            return None
    return result * float(factor or 1)


def check(seen: Seen) -> None:
    """What every report must hold."""
    page, result = seen.page, seen.result
    cells = [(c.get_attribute("data-key"), c.text_content()) for c in page.query_selector_all("[data-key]")]
    assert len(cells) > 10
    for key, shown in cells:
        value = looked_up(result, key)
        first = re.match(r"-?[\d.]+(e[+-]?\d+)?", shown)
        if value is None:
            assert shown == "", key
        elif shown.startswith("<"):
            assert value < float(shown.lstrip("< ")), key
        else:
            assert first is not None, (key, shown)
            mantissa, _, exponent = first[0].partition("e")
            last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
            assert abs(float(first[0]) - value) <= 0.51 * last, (key, shown)
    drawn = {trace["name"]: trace["y"] for trace in seen.traces("falling")}
    steps = [result["base"], *result.get("steps", ())]
    for name, role in (("train runs", "train"), ("held-out runs", "heldout")):
        expected = [step["misfit"][role] for step in steps]
        assert drawn.get(name, [None] * len(expected)) == pytest.approx(expected, rel=1e-5)
    # Every switch, off and on again.
    for box in page.query_selector_all(".controls input"):
        kind, value, was = box.get_attribute("name"), box.get_attribute("value"), box.is_checked()
        box.click()
        page.wait_for_timeout(60)
        hidden = page.evaluate(
            "([kind, value]) => [...document.querySelectorAll(`figure`)].filter(f => f.dataset[kind] === value)"
            ".map(f => f.hidden)",
            [kind, value],
        )
        assert hidden and all(h is was for h in hidden), (kind, value)
        box.click()
    if page.query_selector_all('.controls input[name="stage"]'):
        box = page.query_selector('.controls input[name="stage"]')
        was = box.is_checked()
        box.click()
        page.wait_for_timeout(300)
        of = [t for t in seen.traces("tyre") if (t.get("meta") or {}).get("stage") == box.get_attribute("value")]
        assert of and all(t.get("visible", True) is not was for t in of)
        box.click()
    # The board moves, by keyboard too.
    page.focus("#time")
    before = page.text_content("#now")
    page.keyboard.press("End")
    assert page.text_content("#now") != before
    page.focus("#play")
    page.keyboard.press("Enter")
    page.wait_for_timeout(400)
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.keyboard.press("Enter")
    assert 0 < float(page.input_value("#time")) < float(page.get_attribute("#time", "max"))
    for select in ("#movie-run", "#movie-stage"):
        for option in page.query_selector_all(f"{select} option"):
            page.select_option(select, option.get_attribute("value") or option.text_content())
            assert "NaN" not in page.inner_html("#stage")
    # Dark, and narrow.
    ink = (
        "() => getComputedStyle(document.querySelector('#chart-falling .xtick text, #chart-falling .ytick text')).fill"
    )
    page.query_selector("#chart-falling").scroll_into_view_if_needed()
    light = page.evaluate(ink)
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(500)
    assert page.evaluate(ink) != light
    page.set_viewport_size({"width": 360, "height": 700})
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    unlabelled = "[...document.querySelectorAll('button, input, select, .chart')].filter(e => !(e.labels?.length"
    assert page.evaluate(unlabelled + " || e.textContent.trim() || e.getAttribute('aria-label'))).length") == 0
    assert seen.complaints == []
    assert [url for url in seen.asked if not url.startswith(("file:", "data:", "blob:"))] == []


def written(folder: Path, text: str) -> Path:
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    assert path.stat().st_size < LARGEST
    return path


class Pull(Force):
    """A force along the board."""

    sentence = NASTY
    p: jnp.ndarray = param("N", default=0.0)

    def wrench(self, motion):
        return self.p, jnp.zeros_like(self.p), jnp.zeros_like(self.p)


@pytest.fixture(scope="module")
def nasty() -> tuple[Case, Noise, object]:
    """A fit in which every name that comes from a file is a trap."""
    noise = Noise(jnp.asarray(4e-4), jnp.asarray(2.5e-3), source=NASTY)
    gait = Gait(Sines.of([[0.35, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]]))
    times = jnp.arange(400.0) * 0.01
    pose = np.asarray(simulate(Model(Board(**TABLE_II), Pacejka(8.0, 1.3, 9.0, 0.2), "free"), gait, times).pose)
    errors = np.random.default_rng(0).normal(size=(2, 400, 3)) * np.asarray(noise.channels)
    errors[:, 100:120] = np.nan
    runs = tuple(
        Run(name, role, times, jnp.asarray(pose + error), gait)
        for name, role, error in zip((NASTY_RUN, NASTY), ("train", "heldout"), errors, strict=True)
    )
    model = Model(Board(**TABLE_II), Pacejka(8.0, 1.3, 9.0, 0.2), "free", {NASTY: Pull()})
    case = Case(NASTY, NASTY, "free", model.board, runs, noise, {NASTY: "0"})
    return case, noise, fit(model, runs, noise, ["tyre.D"])


def test_names_from_files_are_shown_as_text(nasty, browser, tmp_path) -> None:
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {"effect": [NASTY]}, case.sha256))
    seen = Seen(browser, written(tmp_path, fit_page(case, noise, found, result)))
    assert NASTY in seen.page.inner_text("h1")
    assert seen.page.inner_text("figure[data-run] figcaption") == NASTY_RUN
    assert NASTY in seen.page.text_content("#chart-failing-0")
    assert seen.page.query_selector_all("img") == []
    assert len(seen.page.query_selector_all("body script")) == 5
    check(seen)


@pytest.mark.slow
@pytest.mark.parametrize("study", ["hidden_effect", "own_effect"])
def test_the_story_of_a_bundled_recording(study, request, browser, tmp_path) -> None:
    found = request.getfixturevalue(study)
    found = found[0] if isinstance(found, tuple) else found
    result = explanation_json(found, provenance_json(0, {}, found.case.sha256))
    seen = Seen(browser, written(tmp_path, explanation_page(found, result)))
    page = seen.page
    assert found.case.name in page.inner_text("h1") and found.verdict in page.inner_text("h1")
    headings = [h.text_content() for h in page.query_selector_all("h2")]
    assert headings[0].startswith("Paths") and "What may be missing" in headings
    assert ("The missing force" in headings) == (found.verdict == "unexplained")
    if found.missing is not None:
        shares = {t["variable"]: t["share"] for t in result["unexplained"]["depends_on"]}
        drawn = seen.traces("dependence")[0]
        assert {n: v / 100 for n, v in zip(drawn["y"], drawn["x"], strict=True)} == pytest.approx(shares, rel=1e-5)
    run = result["final"]["runs"][0]
    assert page.query_selector(f'tr[data-run="{run["run"]}"]') is not None
    check(seen)


def test_a_path_is_where_the_board_was(nasty, tmp_path) -> None:
    """The numbers of the chart, without a browser: measured and modelled x against y."""
    case, noise, found = nasty
    result = fit_json(case, noise, found, provenance_json(0, {}, {}))
    text = fit_page(case, noise, found, result)
    charts = json.loads(re.search(r'<script id="charts" type="application/json">(.*?)</script>', text, re.S)[1])
    measured, modelled = charts["chart-path-0"]["data"][:2]
    pose = np.asarray(case.runs[0].pose)
    assert measured["x"][:50] == pytest.approx(pose[:50, 0], rel=1e-4, abs=1e-9)
    assert measured["y"][100:120] == [None] * 20
    assert np.abs(np.array(modelled["x"][:50]) - pose[:50, 0]).max() < 5 * float(noise.position)
