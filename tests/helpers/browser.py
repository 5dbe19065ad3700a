"""A report opened in headless Chromium, and what every report must hold."""

import json
import math
import re
from pathlib import Path

import pytest

LARGEST = 6e6
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""What the system's own Chromium may be called."""
SCALE_IS_CLEAR = """() => [...document.querySelectorAll("#scene > g > g")].every(board =>
  board.getBoundingClientRect().bottom <= document.querySelector("#scene text").getBoundingClientRect().top + 1)"""


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


def until(holds, page) -> None:
    """Wait until something `holds`: a page asks for no `eval`, which Playwright's own waiting would need."""
    for _ in range(100):
        if holds():
            return
        page.wait_for_timeout(100)
    assert holds()


def looked_up(result: dict, key: str) -> float | None:
    """The number at `base.misfit.train`, to the power behind a caret, times what stands behind a star."""
    path, _, factor = key.partition("*")
    path, _, power = path.partition("^")
    for part in path.split("."):
        result = result[int(part)] if isinstance(result, list) else result.get(part)
        if result is None:
            return None
    return result ** float(power or 1) * float(factor or 1)


def numbers(seen: Seen) -> None:
    """Every number in a table is that of the JSON, rounded; nothing is complained of or asked of a network."""
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
    assert seen.complaints == []
    assert [url for url in seen.asked if not url.startswith(("file:", "data:", "blob:"))] == []


def check(seen: Seen) -> None:
    """What every report of recorded runs must hold."""
    page, result = seen.page, seen.result
    drawn = {trace["name"]: trace["y"] for trace in seen.traces("falling")}
    steps = [result["base"], *result.get("steps", ())]
    for name, role in (("train runs", "train"), ("held-out runs", "heldout")):
        misfits = [step["misfit"][role] for step in steps]
        # The bars are errors in multiples of the noise: roots of mean squares.
        expected = [None if misfit is None else math.sqrt(misfit) for misfit in misfits]
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
    for select in ("#movie-run", "#movie-step"):
        for option in page.query_selector_all(f"{select} option"):
            page.select_option(select, option.get_attribute("value") or option.text_content())
            assert "NaN" not in page.inner_html("#scene")
            assert page.evaluate(SCALE_IS_CLEAR)
    # Dark, and narrow.
    ink = (
        "() => getComputedStyle(document.querySelector('#chart-falling .xtick text, #chart-falling .ytick text')).fill"
    )
    page.query_selector("#chart-falling").scroll_into_view_if_needed()
    light = page.evaluate(ink)
    page.emulate_media(color_scheme="dark")
    until(lambda: page.evaluate(ink) != light, page)
    page.set_viewport_size({"width": 360, "height": 700})
    until(lambda: page.evaluate("document.documentElement.scrollWidth <= innerWidth"), page)
    page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    unlabelled = "[...document.querySelectorAll('button, input, select, .chart')].filter(e => !(e.labels?.length"
    assert page.evaluate(unlabelled + " || e.textContent.trim() || e.getAttribute('aria-label'))).length") == 0
    numbers(seen)


def written(folder: Path, text: str) -> Path:
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    assert path.stat().st_size < LARGEST
    return path
