"""A chart as Plotly's JavaScript draws it: traces and a layout, plain data with every number rounded."""

import html
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..style import LineStyle

Trace = dict[str, Any]
POINTS = 400
"""A line has at most about so many points."""
DIGITS = 6
"""Significant digits of the numbers in a chart: more than a screen can show."""


class Chart(NamedTuple):
    """One chart: `traces` and `layout` of Plotly, its height in pixels, and the run and the step it is about, if one.

    `label` says in words what it shows, for those who do not see it; `caption` stands above it, in place of the run.
    """

    name: str
    label: str
    traces: tuple[Trace, ...]
    layout: dict[str, Any]
    height: int = 320
    run: str | None = None
    step: str | None = None
    caption: str | None = None


def text(name: str) -> str:
    """A name from a file as Plotly is to show it, which otherwise takes some tags for markup."""
    return html.escape(name, quote=False).replace("%{", "% {")


def plain(values: Any) -> list[Any]:
    """Numbers for JSON: rounded to `DIGITS`, what is not finite as None."""
    return [float(f"{v:.{DIGITS}g}") if math.isfinite(v) else None for v in np.asarray(values, float).ravel()]


def thinned(size: int, points: int = POINTS) -> slice:
    """Every so many of `size` samples that about `points` are left."""
    return slice(None, None, max(size // points, 1))


def line(x: Any, y: Any, name: str, look: LineStyle, *, width: float = 2.0, **more: Any) -> Trace:
    """A line; `run` and `step` among `more` say what it is switched by."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": plain(x),
        "y": plain(y),
        "name": text(name),
        "line": {"color": look.colour, "dash": look.dash, "width": width},
        **_switched(more),
    }


def points(x: Any, y: Any, name: str, look: LineStyle, *, symbol: str = "circle", **more: Any) -> Trace:
    """Markers; `error_x` and `error_y` among `more` are standard errors."""
    for axis in ("error_x", "error_y"):
        if axis in more:
            more[axis] = {"type": "data", "array": plain(1.96 * np.asarray(more[axis])), "thickness": 1, "width": 0}
    return {
        "type": "scatter",
        "mode": "markers",
        "x": plain(x),
        "y": plain(y),
        "name": text(name),
        "marker": {"color": look.colour, "symbol": symbol, "size": 7},
        **_switched(more),
    }


def band(x: Any, low: Any, high: Any, name: str, look: LineStyle, **more: Any) -> Trace:
    """The area between two lines."""
    x, low, high = (np.asarray(part, float) for part in (x, low, high))
    fine = np.isfinite(low) & np.isfinite(high)
    x, low, high = x[fine], low[fine], high[fine]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": plain(np.concatenate([x, x[::-1]])),
        "y": plain(np.concatenate([high, low[::-1]])),
        "name": text(name),
        "fill": "toself",
        "fillcolor": faint(look.colour),
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
        **_switched(more),
    }


def faint(colour: str) -> str:
    """A colour, seen through."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.22)"


def bars(x: Sequence[str], y: Sequence[float | None], name: str, colour: str, **more: Any) -> Trace:
    """Upright bars with their values on top, over labels that are safe to show as `text` makes them."""
    return {
        "type": "bar",
        "x": list(x),
        "y": y,
        "name": text(name),
        "marker": {"color": colour},
        **_switched(more),
    }


def _switched(more: dict[str, Any]) -> dict[str, Any]:
    meta = {key: more.pop(key) for key in ("run", "step") if more.get(key) is not None}
    return {**more, **({"meta": meta} if meta else {})}


def axes(x: str, y: str, **more: Any) -> dict[str, Any]:
    """A layout with titled axes; `more` goes into it, keys of `xaxis` and `yaxis` into those."""
    layout: dict[str, Any] = {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}
    for key, value in more.items():
        layout[key] = {**layout[key], **value} if key in layout else value
    return layout


def axis_name(place: int) -> str:
    """What a trace calls the vertical axis at `place`, counted from the top, of a `stacked` layout."""
    return f"y{place + 1}" if place else "y"


def stacked(x: str, names: Sequence[str]) -> dict[str, Any]:
    """A layout of one axis above another, each with a scale of its own, over one horizontal axis."""
    count = len(names)
    layout: dict[str, Any] = {"xaxis": {"title": {"text": x}, "anchor": axis_name(count - 1)}, "showlegend": False}
    for place, name in enumerate(names):
        low = (count - 1 - place) / count
        ends = [low + (0.03 if place < count - 1 else 0.0), low + 1 / count]
        layout[f"yaxis{place + 1}" if place else "yaxis"] = {"title": {"text": name}, "domain": ends, "nticks": 4}
    return layout


EQUAL = {"yaxis": {"scaleanchor": "x", "scaleratio": 1}}
"""A metre along x is as long as one along y."""
