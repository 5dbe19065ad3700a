"""The documentation: the site is built without a broken link, and what its pages say of the code is so."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.folders import ROOT

from snakejax.commands.cli.main import COMMANDS
from snakejax.effects import LIBRARY

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The documentation site, built by its one command, which fails on a broken link."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_the_site_shows_the_error_falling_first(site: Path) -> None:
    text = (site / "index.html").read_text(encoding="utf-8")
    first = re.search(r'<img[^>]* src="([^"]+)"', text)
    assert first is not None and first[1] == "gallery/fall.png"
    assert (site / first[1]).stat().st_size > 10_000


@pytest.mark.slow
def test_the_site_names_every_command_and_effect(site: Path) -> None:
    commands = (site / "commands" / "index.html").read_text(encoding="utf-8")
    assert all(
        f"usage: snakejax {command.__name__.rsplit('.', 1)[-1].replace('importing', 'import')}" in commands
        for command in COMMANDS
    )
    effects = (site / "effects" / "index.html").read_text(encoding="utf-8")
    assert all(f"<code>{name}</code>" in effects for name in LIBRARY)


@pytest.mark.parametrize("name", LIBRARY)
def test_each_effect_has_its_formula_its_sign_and_its_picture(site: Path, name: str) -> None:
    page = (site / "effects" / "index.html").read_text(encoding="utf-8")
    part = page.split(f'<h3 id="{name}">')[1].split("<h3")[0]
    assert "<pre>" in part and re.search(r"[Pp]ositive", re.sub(r"<[^>]*>", " ", part))
    assert re.search(r'<img[^>]* src="([^"]+)"', part)[1] == f"{name}.svg"
    # The lines of the effect: a picture with nothing but axes is shorter.
    assert (site / "effects" / f"{name}.svg").read_text(encoding="utf-8").count("<path") > 20


def test_troubleshooting_quotes_what_the_program_says() -> None:
    source = " ".join(path.read_text(encoding="utf-8") for path in (ROOT / "src" / "snakejax").rglob("*.py"))
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    messages = [
        m for row in re.findall(r"^\| (`.*?) \|", text, flags=re.MULTILINE) for m in re.findall(r"`([^`]+)`", row)
    ]
    assert len(messages) > 50
    parts = [part.strip(" :,") for message in messages for part in message.split("...")]
    assert [part for part in parts if part not in source] == []


def test_the_site_asks_nothing_of_a_network_to_be_read(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|img|link)[^>]+(?:src|href)="https?://', text), page


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "data/README.md"])
def test_links_lead_somewhere(page: str) -> None:
    path = ROOT / page
    links = [link for link in LINK.findall(path.read_text(encoding="utf-8")) if "://" not in link]
    for link in links:
        assert (path.parent / link.split("#")[0]).exists(), f"{page} links to {link}, which is not there."


def test_the_first_picture_of_the_readme_is_drawn_from_data() -> None:
    """It is the error falling, and `fit/gallery.py` draws it."""
    links = LINK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert links[0] == "docs/gallery/fall.png"
    assert "hidden_effect.main(folder)" in (ROOT / "fit" / "gallery.py").read_text(encoding="utf-8")
