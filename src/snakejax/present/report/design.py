"""The report of a tuned gait or of a designed run, from its JSON alone."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..as_json.values import Json
from ..as_text.design import amplitude_head, limit_unit
from ..as_text.errors import OBJECTIVE_UNITS, POSE_ERRORS, missed_text, target_pose
from ..as_text.tables import number
from ..style import BASE, HELDOUT, MEASURED, TRAIN, LineStyle
from .chart import EQUAL, Chart, Trace, axes, line, points
from .page import Cell, Page, Row, Section, cells, plain_sentences, render, table

POSE = ("x", "y", "heading")
SIDES = {"before": ("best known", BASE), "after": ("tuned", LineStyle(HELDOUT, "solid"))}
ENOUGH = 0.95
"""Probability of the right answer for which the repeats of a run are counted."""
STROKES, STROKE = 12, 0.05
"""Strokes along a path that show the heading, and their length as a share of the larger side of the picture."""


def tune_page(result: Json) -> str:
    """The report of `snakejax tune`: path, joint angles with limits, result, and the effect of a designed run."""
    headline_text = f"{result['case']}: {_achieved(result)}"
    mass, inertia = (result.get("payload", {}).get(key, 0.0) for key in ("mass_kg", "inertia_kgm2"))
    load = f", carrying {mass:g} kg and {inertia:g} kg m^2" if mass or inertia else ""
    x, y, heading = result["start"]
    start = f"from rest at ({x:g} m, {y:g} m) with heading {heading:g} rad"
    facts = (f"{result['asked']} in {result['duration_s']:g} s, {start}{load}.",)
    sections = [_gait(result), *([_design(result)] if "separate" in result or "information" in result else [])]
    if result.get("spread"):
        sections.append(_spread(result))
    sections.append(_numbers(result))
    return render(Page(f"{result['case']} - snakejax", headline_text, facts, (), (), tuple(sections), result))


def _achieved(result: Json) -> str:
    if "separate" in result:
        part = result["separate"]
        return (
            f"{' or '.join(part['effects'])}: correct selection in {100 * part['after']:.0f}% with the designed run, in"
            f" {100 * part['before']:.0f}% with the given runs."
        )
    if "information" in result:
        return "the run that determines the tyre parameters best."
    unit = OBJECTIVE_UNITS.get(result["asked"], "")
    before = result["before"]
    known = before and before["objective"]
    was = "" if known is None else f", where the best known gait has {_objective_text(known, unit)}"
    if isinstance(known, Mapping):
        was = f"; the best known gait misses it by {missed_text(known)}"
    met = "" if result.get("met", True) else " No gait reaches the target."
    return f"{_objective_text(result['objective'], unit)}{was}.{met}"


def _objective_text(objective: Any, unit: str = "") -> str:
    if isinstance(objective, Mapping):
        return f"the pose is missed by {missed_text(objective)}"
    return f"{objective:.4g}{unit}"


WORDS = {"phi": "steering", "psi": "rotor"}
"""Words for the joints of a snakeboard."""


def _sides(result: Json) -> Iterator[tuple[str, str, LineStyle, Json]]:
    for key, (label, look) in SIDES.items():
        if result[key] is not None:
            yield key, label, look, result[key]["path"]


def _gait(result: Json) -> Section:
    sides = [*_sides(result)]
    traces = [line(path["x"], path["y"], label, look) for _, label, look, path in sides]
    places = np.concatenate([[path["x"], path["y"]] for *_, path in sides], axis=1)
    if (target := target_pose(result["asked"])) is not None:
        traces.append(points([target[0]], [target[1]], "target pose", MEASURED, symbol="star"))
        places = np.column_stack([places, target[:2]])
    length = STROKE * float(np.ptp(places, axis=1).max())
    for _, _, look, path in sides:
        traces.append(_strokes([path[name][:: max(len(path["x"]) // STROKES, 1)] for name in POSE], length, look))
    if target is not None:
        traces.append(_strokes([[part] for part in target], 2 * length, MEASURED))
    charts = [Chart("path", "The path, x against y.", tuple(traces), axes("x [m]", "y [m]", **EQUAL), 380)]
    for joint, unit in result["units"].items():
        words = WORDS.get(joint, "")
        drawn = [line(path["t"], path[joint], label, look) for _, label, look, path in _sides(result)]
        layout = axes("time [s]", f"{words}, {joint} [{unit}]" if words else f"{joint} [{unit}]")
        if joint in result["limits"]:
            most = result["limits"][joint]
            ends = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"dash": "dot", "width": 1.5}}
            layout["shapes"] = [{**ends, "y0": sign * most, "y1": sign * most} for sign in (-1, 1)]
        caption = f"The {words} angle over time." if words else f"The input {joint} over time."
        charts.append(Chart(joint, caption, tuple(drawn), layout, 260))
    text = (
        "The run starts at rest. Short strokes show the heading; dotted lines are the limits of the inputs."
        f" It ends at {'; '.join(_end(label, path) for _, label, _, path in sides)}."
    )
    return Section("gait", "The gait", (text,), tuple(charts))


def _end(label: str, path: Json) -> str:
    """Where a path ends."""
    x, y, heading = (float(path[name][-1]) for name in POSE)
    return f"x = {x:.3f} m, y = {y:.3f} m, heading = {heading:.3f} rad ({label})"


def _strokes(pose: Sequence[Sequence[float]], length: float, look: LineStyle) -> Trace:
    """Strokes of this `length` [m] from the places x, y [m] of `pose` along its heading [rad]."""
    x, y, heading = (np.asarray(part, float) for part in pose)
    ends = [
        np.stack([start, start + length * along, np.full_like(start, np.nan)], axis=1).ravel()
        for start, along in ((x, np.cos(heading)), (y, np.sin(heading)))
    ]
    return line(
        ends[0], ends[1], "heading", LineStyle(look.colour, "solid"), width=1.5, showlegend=False, hoverinfo="skip"
    )


def _numbers(result: Json) -> Section:
    rows = [
        Row(cells(joint, *(Cell(f"{value:.5f}", f"gait.{joint}.{k}.{c}") for c, value in enumerate(term))))
        for joint, terms in result["gait"].items()
        for k, term in enumerate(terms)
    ]
    heads = ("input", f"#{amplitude_head(result['units'])}", "#frequency [rad/s]", "#phase [rad]")
    limits = [
        Row(
            cells(
                name,
                Cell(number(value), f"limits.{name}"),
                Cell(number(result["reached"][name]), f"reached.{name}"),
                limit_unit(name, result["units"]),
            )
        )
        for name, value in result["limits"].items()
    ]
    tables = (
        table("A sum of sines, as case.toml takes it", heads, rows),
        table("Limits, and what command and joint reach", ("", "#limit", "#reached", "unit"), limits),
    )
    description = "The file ending in gait.toml beside this page holds the gait as two lines for a run in case.toml."
    return Section("numbers", "Numbers", (description,), (), tables)


def _spread(result: Json) -> Section:
    """The result of the gait over samples of the fit."""
    spread = result["spread"]
    posed = isinstance(spread[0], Mapping)
    charts = []
    for name, words in POSE_ERRORS.items() if posed else [("objective", "objective")]:
        values = [1e3 * one[name] if isinstance(one, Mapping) else one for one in spread]
        marks = points(np.arange(len(values)), values, "sample of the fit", LineStyle(TRAIN, "solid"))
        after = result["objective"]
        at = 1e3 * after[name] if isinstance(after, Mapping) else after
        tuned = line([0, len(values) - 1], [at, at], "the fit itself", LineStyle(HELDOUT, "dash"))
        layout = axes("sample", words)
        charts.append(Chart(f"spread-{name}", f"The {words} over samples of the fit.", (marks, tuned), layout, 260))
    text = "The fit is uncertain: these are the results of the gait for models sampled from it."
    return Section("spread", "Over samples of the fit", (text,), tuple(charts))


def _design(result: Json) -> Section:
    """The expected effect of a designed run."""
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
        return Section("design", "Expected effect of the run", (), (), (table("Standard errors", heads, rows),))
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
    layout = axes("correct selection [%]", "", xaxis={"range": [50, 100]}, yaxis={"automargin": True})
    layout["shapes"] = [{**limit, "x0": 100 * ENOUGH, "x1": 100 * ENOUGH}]
    chart = Chart("certainty", "The probability of selecting the right effect.", (bars,), layout, 90 + 26 * len(rows))
    repeats = part.get("repeats")
    sentences = plain_sentences(
        "The probability of selecting the right one of the two effects, at the stated strength.",
        f"Repeats of the designed run for {100 * ENOUGH:g}%: {repeats}." if repeats else None,
    )
    heads = ("data", "run", "#correct selection")
    return Section(
        "design",
        "Expected effect of the run",
        sentences,
        (chart,),
        (table("Probability of correct selection", heads, rows),),
    )
