"""The report of a tuned gait or of a designed run, from its JSON alone."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .._json import Json
from .._palette import BASE, HELDOUT, TRAIN, Look
from .._text import number
from ._chart import EQUAL, Chart, Trace, axes, line, points
from ._page import Cell, Page, Row, Section, cells, plain_sentences, render, table

SIDES = {"before": ("best known", BASE), "after": ("tuned", Look(HELDOUT, "solid"))}
ENOUGH = 0.95


def tune_page(result: Json) -> str:
    """The report of `snakejax tune`: path, joints within their limits, what it achieves, what a design would tell."""
    told = f"{result['case']}: {_achieved(result)}"
    mass, inertia = (result.get("payload", {}).get(key, 0.0) for key in ("mass_kg", "inertia_kgm2"))
    load = f", carrying {mass:g} kg and {inertia:g} kg m^2" if mass or inertia else ""
    facts = (f"{result['asked']} in {result['duration_s']:g} s from rest, at {result['start']}{load}.",)
    sections = [_gait(result), *([_design(result)] if "separate" in result or "information" in result else [])]
    if result.get("spread"):
        sections.append(_spread(result))
    sections.append(_numbers(result))
    return render(Page(f"{result['case']} - snakejax", told, facts, (), (), tuple(sections), result))


def _achieved(result: Json) -> str:
    if "separate" in result:
        part = result["separate"]
        return (
            f"{' or '.join(part['effects'])}: the designed run tells them apart in {100 * part['after']:.0f}%, the"
            f" given runs in {100 * part['before']:.0f}%."
        )
    if "information" in result:
        return "the run that says most about the tyre."
    unit = {"distance": " m", "turn": " rad"}.get(result["asked"], "")
    before = result["before"]
    known = before and before["objective"]
    was = "" if known is None else f", where the best known gait has {_said(known, unit)}"
    met = "" if result.get("met", True) else " No gait was found that gets there."
    return f"{_said(result['objective'], unit)}{was}.{met}"


def _said(objective: Any, unit: str = "") -> str:
    if isinstance(objective, Mapping):
        return ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in objective.items())
    return f"{objective:.4g}{unit}"


def _sides(result: Json) -> Iterator[tuple[str, str, Look, Json]]:
    for key, (label, look) in SIDES.items():
        if result[key] is not None:
            yield key, label, look, result[key]["path"]


def _gait(result: Json) -> Section:
    traces = [line(path["x"], path["y"], label, look) for _, label, look, path in _sides(result)]
    charts = [Chart("path", "The path, x against y.", tuple(traces), axes("x [m]", "y [m]", **EQUAL), 380)]
    for joint, words in (("phi", "steering"), ("psi", "rotor")):
        drawn = [line(path["t"], path[joint], label, look) for _, label, look, path in _sides(result)]
        layout = axes("time [s]", f"{words}, {joint} [rad]")
        if joint in result["limits"]:
            most = result["limits"][joint]
            ends = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"dash": "dot", "width": 1.5}}
            layout["shapes"] = [{**ends, "y0": sign * most, "y1": sign * most} for sign in (-1, 1)]
        charts.append(Chart(joint, f"The {words} angle over time.", tuple(drawn), layout, 260))
    text = "The board at rest at the start, under the gait; dotted lines are the limits of the joints."
    return Section("gait", "The gait", (text,), tuple(charts))


def _numbers(result: Json) -> Section:
    rows = [
        Row(cells(joint, *(Cell(f"{value:.5f}", f"gait.{joint}.{k}.{c}") for c, value in enumerate(term))))
        for joint, terms in result["gait"].items()
        for k, term in enumerate(terms)
    ]
    heads = ("joint", "#amplitude [rad]", "#frequency [rad/s]", "#phase [rad]")
    limits = [
        Row(
            cells(name, Cell(number(value), f"limits.{name}"), Cell(number(result["reached"][name]), f"reached.{name}"))
        )
        for name, value in result["limits"].items()
    ]
    tables = (
        table("A sum of sines, as case.toml takes it", heads, rows),
        table("Limits, and what command and joint reach", ("", "#limit", "#reached"), limits),
    )
    sentence = "gait.toml beside this page holds the gait as two lines for a run in case.toml."
    return Section("numbers", "Numbers", (sentence,), (), tables)


def _spread(result: Json) -> Section:
    """What draws from the fit achieve."""
    spread = result["spread"]
    names = list(spread[0]) if isinstance(spread[0], Mapping) else ["objective"]
    charts = []
    for name in names:
        values = [one[name] if isinstance(one, Mapping) else one for one in spread]
        marks = points(np.arange(len(values)), values, "draw from the fit", Look(TRAIN, "solid"))
        after = result["objective"]
        at = after[name] if isinstance(after, Mapping) else after
        tuned = line([0, len(values) - 1], [at, at], "the fit itself", Look(HELDOUT, "dash"))
        layout = axes("draw", name.replace("_", " "))
        charts.append(Chart(f"spread-{name}", f"{name} over draws from the fit.", (marks, tuned), layout, 260))
    text = "The fit is uncertain: this is what boards drawn from it achieve with the gait."
    return Section("spread", "Over draws from the fit", (text,), tuple(charts))


def _design(result: Json) -> Section:
    """What a designed run would tell."""
    if "information" in result:
        part = result["information"]
        rows = [
            Row(
                cells(
                    name,
                    Cell(number(part["sd_before"][name]), f"information.sd_before.{name}"),
                    Cell(number(part["sd_after"][name]), f"information.sd_after.{name}"),
                )
            )
            for name in part["sd_before"]
        ]
        heads = ("parameter", "#standard error now", "#with the designed run")
        return Section("design", "What the run would tell", (), (), (table("Standard errors", heads, rows),))
    part = result["separate"]
    rows = [Row(cells("the given runs", "", Cell(f"{part['before']:.3f}", "separate.before")))]
    rows += [
        Row(cells(a["do"], a["run"], Cell(f"{a['certainty']:.3f}", f"separate.advice.{k}.certainty")))
        for k, a in enumerate(part["advice"])
    ]
    rows.append(Row(cells("the designed run", "", Cell(f"{part['after']:.3f}", "separate.after")), strong=True))
    names = [" ".join(c.text for c in row.cells[:2]).strip() for row in rows]
    values = [part["before"], *(a["certainty"] for a in part["advice"]), part["after"]]
    bars: Trace = {
        "type": "bar",
        "orientation": "h",
        "y": names[::-1],
        "x": [100 * v for v in values][::-1],
        "marker": {"color": TRAIN},
    }
    limit = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "line": {"dash": "dot", "width": 2}}
    layout = axes("right answers [%]", "", xaxis={"range": [50, 100]}, yaxis={"automargin": True})
    layout["shapes"] = [{**limit, "x0": 100 * ENOUGH, "x1": 100 * ENOUGH}]
    chart = Chart("certainty", "The share of right answers.", (bars,), layout, 90 + 26 * len(rows))
    repeats = part.get("repeats")
    sentences = plain_sentences(
        "How often the two effects would be told apart at the strength stated, whatever the fit leaves open.",
        f"Repeats of the designed run for {100 * ENOUGH:g}%: {repeats}." if repeats else None,
    )
    heads = ("what to do", "run", "#right answers")
    return Section("design", "What the run would tell", sentences, (chart,), (table("Certainty", heads, rows),))
