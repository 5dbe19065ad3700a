"""Every picture of the README and of the gallery, drawn from the recordings in `data/`.

    python fit/gallery.py [FOLDER]

writes into FOLDER (default `docs/gallery`): figures, a film, and how a report looks in a browser, for which it needs
Chromium and the extra `test`. About five minutes.
"""

import shutil
import sys
import tempfile
from pathlib import Path

import hidden_effect
import own_effect

import snakejax as sj
from snakejax.core.files import write_whole
from snakejax.present import plot
from snakejax.present.as_json.explanation import explanation_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.as_json.values import clean
from snakejax.present.report import explanation_page
from snakejax.present.views import views_of_steps

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "gallery"
FILMED = "train-rotate-1"


def main(folder: Path = FOLDER) -> None:
    """Draw everything."""
    found = hidden_effect.main(folder)
    models = views_of_steps(found)
    ends = [models[0], models[-1]]
    plot.save(plot.paths(ends), folder, "paths")
    plot.save(plot.tyre(ends), folder, "tyre")
    plot.save(plot.residuals(models[0]), folder, "residuals")
    plot.save(plot.ranking(found.base), folder, "ranking")
    plot.save(plot.confusability(found.base), folder, "confusability")
    plot.animate(models[-1], found.case.board, folder / "moving.gif", FILMED)
    report(found, models, folder / "report.png")

    own_effect.main(folder)

    example = sj.preset("paper-rotate")
    swept = sj.nearest_rayleigh(
        example.model, example.gait, example.times, sj.grid({"tyre.D": [0.5 + 0.25 * k for k in range(39)]})
    )
    dim = next(iter(swept.k_s.dims))
    figure = plot.sweep(swept, sj.polynomial(swept[dim].values, swept.k_s.values), "paper-rotate")
    assert figure is not None
    plot.save(figure, folder, "sweep")


def report(found: sj.Explanation, models, file: Path) -> None:
    """A picture of the report of an explanation, as headless Chromium shows its beginning."""
    from playwright.sync_api import sync_playwright

    result = clean(explanation_json(found, provenance_json(0, {}, found.case.sha256)))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_file = write_whole(Path(folder) / "report.html", explanation_page(found, result, models))
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1000, "height": 1500})
        page.goto(page_file.as_uri())
        page.wait_for_selector("html[data-charts=yes]")
        for chart in page.query_selector_all(".chart")[:8]:
            chart.scroll_into_view_if_needed()
            chart.wait_for_selector(".main-svg", state="attached")
        page.evaluate("scrollTo(0, 0)")
        page.screenshot(path=file)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
