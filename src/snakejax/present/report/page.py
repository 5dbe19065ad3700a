"""A page: sections of sentences, tables and charts, written as one HTML file that needs nothing else."""

import base64
import functools
import gzip
import importlib.resources
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ..as_json.values import Json, clean
from ..as_text.errors import times_noise_text
from ..style import LineStyle
from .chart import Chart

STROKES = {
    "solid": "none",
    "dash": "7 3",
    "dot": "2 2",
    "dashdot": "7 2 2 2",
    "longdash": "11 3",
    "longdashdot": "11 3 2 3",
}
"""The dash of a line as SVG has it."""


class Cell(NamedTuple):
    """A cell: its text, and the place of its number in the JSON, as in `base.misfit.train`."""

    text: str
    key: str | None = None


class Row(NamedTuple):
    """Cells, and the run that switches them on and off."""

    cells: tuple[Cell, ...]
    run: str | None = None
    strong: bool = False


class Table(NamedTuple):
    """A table: `caption`, the heads of its columns, which of them hold numbers, and its rows."""

    caption: str
    heads: tuple[str, ...]
    numbers: tuple[bool, ...]
    rows: tuple[Row, ...]


class Section(NamedTuple):
    """A part of the page under a heading; `wide` charts stand alone in a row. `player`: the moving board is here."""

    name: str
    heading: str
    sentences: tuple[str, ...] = ()
    charts: tuple[Chart, ...] = ()
    tables: tuple[Table, ...] = ()
    wide: bool = True
    player: bool = False


class Model(NamedTuple):
    """A model that can be switched on and off."""

    key: str
    label: str
    look: LineStyle
    shown: bool


class Page(NamedTuple):
    """A whole page. `warnings`, the `lead`, pairs of a heading and a sentence, and `facts` stand under the headline;
    `result` is the JSON that the command wrote; `movie` is what the player shows, None without one."""

    title: str
    headline: str
    facts: tuple[str, ...]
    runs: tuple[tuple[str, str], ...]
    models: tuple[Model, ...]
    sections: tuple[Section, ...]
    result: Json
    movie: Mapping[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    lead: tuple[tuple[str, str], ...] = ()


def render(page: Page) -> str:
    """The page as HTML, with Plotly's JavaScript in it, packed: 2 MB that open from disk, without a network."""
    charts = {
        f"chart-{chart.name}": {"data": chart.traces, "layout": chart.layout}
        for section in page.sections
        for chart in section.charts
    }
    return _template().render(
        page=page,
        strokes=STROKES,
        plotly=_plotly(),
        style=_asset("page.css"),
        script=_asset("page.js"),
        charts=for_script(charts),
        movie=for_script(page.movie),
        result=for_script(page.result),
    )


def for_script(value: Any) -> str:
    """JSON that can stand in a <script>: nothing in it ends the element or begins a comment."""
    written = json.dumps(clean(value), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return written.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def plain_sentences(*sentences: str | None) -> tuple[str, ...]:
    """The `sentences` that are not empty."""
    return tuple(description for description in sentences if description)


def cells(*parts: "str | Cell") -> tuple[Cell, ...]:
    """Cells of strings and cells."""
    return tuple(part if isinstance(part, Cell) else Cell(part) for part in parts)


def table(caption: str, heads: Sequence[str], rows: Sequence[Row]) -> Table:
    """A table whose columns hold numbers where the heads begin with `#`, which is not shown."""
    return Table(caption, tuple(h.lstrip("#") for h in heads), tuple(h.startswith("#") for h in heads), tuple(rows))


def root(misfit: float | None, key: str, note: str = "") -> Cell:
    """An error in multiples of the noise and a `note`; the key ends in the power of the misfit that it is."""
    return Cell(times_noise_text(misfit) + note, f"{key}^0.5")


@functools.cache
def _plotly() -> str:
    """Plotly's JavaScript, gzip in base64: the browser unpacks it in a tenth of a second."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode()


@functools.cache
def _template():
    import jinja2

    # Every name that comes from a file is escaped.
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(_asset("page.html"))


def _asset(name: str) -> str:
    return (importlib.resources.files(__package__) / "assets" / name).read_text(encoding="utf-8")
