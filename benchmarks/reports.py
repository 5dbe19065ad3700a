"""How large reports are, and how many seconds a browser takes until they can be used.

    python benchmarks/reports.py REPORT.html ...

opens each five times in headless Chromium and prints its size, and the medians of the seconds until its text and
switches respond, and until its charts are drawn. It also checks each report against the requirements of
`tests/helpers/browser.py`. Needs the extra `test` and Chromium.
"""

import statistics
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from helpers.browser import BROWSERS, Seen, check  # noqa: E402

REPEATS = 5


def _seconds(page, mark: str) -> float:
    """Seconds from the start of the page until it bears a mark."""
    page.wait_for_selector(f"html[data-{mark}=yes]", state="attached")
    return page.evaluate(f"performance.getEntriesByName('{mark}')[0].startTime") / 1000


def main(paths: list[Path]) -> None:
    """Print a line a report."""
    import shutil

    with sync_playwright() as playwright:
        found = next(filter(None, map(shutil.which, BROWSERS)))
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        for path in paths:
            times = []
            for _ in range(REPEATS):
                page = browser.new_page()
                page.goto(path.absolute().as_uri(), wait_until="commit")
                times.append([_seconds(page, mark) for mark in ("ready", "charts")])
                page.close()
            ready, charts = (statistics.median(column) for column in zip(*times, strict=True))
            check(Seen(browser, path.absolute()))
            size = path.stat().st_size / 1e6
            print(f"{path}: {size:.1f} MB, usable after {ready:.2f} s, charts after {charts:.2f} s, all checks hold")
        browser.close()


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
