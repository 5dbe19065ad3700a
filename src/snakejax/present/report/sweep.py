"""The report of a sweep, from its JSON alone."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snakejax.simulation.rayleigh_match import FOLLOWS

from ..as_json.values import Json
from ..as_text.tables import number, with_unit
from ..style import BASE, HELDOUT, MEASURED, TRAIN, LineStyle
from .chart import Chart, Trace, axes, line, plain, points
from .page import Cell, Page, Row, Section, cells, plain_sentences, render, table

POWERS = ("^4", "^3", "^2", "", None)
SHOWN = 200
"""Rows of the table at most; the JSON has all."""


def sweep_page(result: Json) -> str:
    """The report of a sweep: k_s and the mismatch along one or two axes, otherwise a table of end poses."""
    names = result["axes"]
    followed = "mismatch" in result
    values = {name: np.asarray(result[name], float) for name in names if name in result}
    headline_text = f"{result['case']}: {_counted(result)} along {' and '.join(names)}"
    headline_text += ", and the Rayleigh board nearest to each." if followed else "."
    sections = [Section("sweep", "The sweep", _sentences(result), tuple(_charts(result, values)))]
    sections.append(_table(result, values))
    facts = (f"Model {result['model']}, skid {result['skid']}.",)
    return render(Page(f"{result['case']} - snakejax", headline_text, facts, (), (), tuple(sections), result))


def _counted(result: Json) -> str:
    count = np.asarray(result["end"]["x_m"], object).size
    return f"{count} board{'s' if count != 1 else ''}"


def _sentences(result: Json) -> tuple[str, ...]:
    if "mismatch" not in result:
        return ("For a Rayleigh or ideal board no k_s is fitted; these are the end poses.",)
    polynomial, name = result["polynomial"], result["axes"][0]
    fitted = None
    if polynomial is not None:
        terms = " ".join(
            f"{c:+.4g}{'' if p is None else f' {name}{p}'}" for c, p in zip(polynomial, POWERS, strict=True)
        )
        low, high = result["fitted_range"]
        squared = "" if result["r_squared"] is None else f", R² = {result['r_squared']:.5f}"
        fitted = f"k_s = {terms} for {name} from {low:.4g} to {high:.4g}{squared}."
    return plain_sentences(
        "k_s is that of the Rayleigh board whose path is nearest; the mismatch is the root mean square distance of the"
        f" two paths over the path's length. Above {100 * FOLLOWS:g}% no k_s is given.",
        fitted,
    )


def _title(result: Json, name: str) -> str:
    """A parameter with its unit, `D [N]`; a table of boards has an axis that is no parameter."""
    return with_unit(name, result["units"].get(name, ""))


def _charts(result: Json, values: dict[str, np.ndarray]) -> list[Chart]:
    names = result["axes"]
    titles = [_title(result, name) for name in names]
    if len(values) != len(names) or len(names) > 2:
        return []
    if len(names) == 2:
        parts: Any = result["end"]
        if "mismatch" in result:
            parts = {"k_s [N s/m]": result["k_s"], "mismatch [%]": _percent(result["mismatch"])}
        return [
            _map(k, label, part, [values[name] for name in names], titles)
            for k, (label, part) in enumerate(parts.items())
        ]
    x = values[names[0]]
    if "mismatch" not in result:
        shown = [
            line(x, _numbers(part), label, LineStyle(colour, dash))
            for (label, part), colour, dash in zip(
                result["end"].items(), (TRAIN, HELDOUT, BASE.colour), ("solid", "dash", "dot"), strict=True
            )
        ]
        return [Chart("ends", "The end pose of each board.", tuple(shown), axes(titles[0], "m, rad"))]
    reach = {"range": _reach(x)}
    traces: list[Trace] = []
    if result["polynomial"] is not None:
        low, high = result["fitted_range"]
        fine = np.linspace(low, high, 200)
        curve = np.polyval(result["polynomial"], fine)
        traces.append(line(fine, curve, "polynomial of order 4", LineStyle(HELDOUT, "solid")))
    traces.append(points(x, _numbers(result["k_s"]), "nearest Rayleigh board", MEASURED))
    above = Chart("k_s", f"k_s against {names[0]}.", tuple(traces), axes(titles[0], "k_s [N s/m]", xaxis=reach), 360)
    mismatch = line(x, _percent(result["mismatch"]), "mismatch", LineStyle(TRAIN, "solid"))
    limit = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 100 * FOLLOWS, "y1": 100 * FOLLOWS}
    layout = axes(titles[0], "mismatch [% of the path]", xaxis=reach, yaxis={"rangemode": "tozero"})
    layout["shapes"] = [{**limit, "line": {"dash": "dot", "width": 2}}]
    return [above, Chart("mismatch", f"The mismatch against {names[0]}.", (mismatch,), layout, 240)]


def _reach(x: np.ndarray) -> list[float]:
    """The range of an axis on which both charts show every board at the same place."""
    margin = 0.03 * float(np.ptp(x)) or 1.0
    return [float(x.min()) - margin, float(x.max()) + margin]


def _numbers(part: Any) -> np.ndarray:
    return np.array(part, float)


def _percent(part: Any) -> np.ndarray:
    return 100 * _numbers(part)


def _map(k: int, label: str, part: Any, values: Sequence[np.ndarray], titles: Sequence[str]) -> Chart:
    trace: Trace = {
        "type": "heatmap",
        "x": plain(values[1]),
        "y": plain(values[0]),
        "z": [plain(row) for row in _numbers(part)],
        "colorscale": "Cividis",
        "colorbar": {"title": {"text": label}, "thickness": 12},
    }
    return Chart(f"map-{k}", f"{label} over both.", (trace,), axes(titles[1], titles[0]), 380)


def _table(result: Json, values: dict[str, np.ndarray]) -> Section:
    names = [name for name in values if values[name].ndim == 1]
    ends = result["end"]
    shape = np.asarray(ends["x_m"], object).shape
    followed = "mismatch" in result
    heads = [*(f"#{_title(result, name)}" for name in names), *(("#k_s [N s/m]", "#mismatch [%]") if followed else ())]
    heads += ["#end x [m]", "#end y [m]", "#end heading [rad]"]
    rows = []
    for place in list(np.ndindex(shape))[:SHOWN]:
        at = ".".join(str(k) for k in place)
        line_ = [Cell(f"{values[n][place[min(k, len(place) - 1)]]:.6g}") for k, n in enumerate(names)]
        if followed:
            line_ += [_cell(result["k_s"], place, f"k_s.{at}"), _cell(result["mismatch"], place, f"mismatch.{at}", 100)]
        line_ += [_cell(ends[key], place, f"end.{key}.{at}") for key in ends]
        rows.append(Row(cells(*line_)))
    count = int(np.prod(shape))
    more = (f"The first {SHOWN} of {count}; the JSON has all.",) if count > SHOWN else ()
    return Section("boards", "Every board", more, (), (table("Boards", heads, rows),))


def _cell(part: Any, place: tuple[int, ...], key: str, factor: float = 1.0) -> Cell:
    for k in place:
        part = part[k]
    star = "" if factor == 1.0 else f"*{factor:g}"
    return Cell("" if part is None else number(factor * part), key + star)
