"""The section of the effects that were tried: what each promised, what its refit left, and why it was not taken."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..as_json.values import Json
from ..as_text.columns import DETECTS, EXPECTED, FALL, ORDER, P_AND_SD, PREDICTED, REFIT, WINDOWS
from ..as_text.errors import times_noise, times_noise_text
from ..as_text.tables import NOT_CONVERGED, error, number
from ..style import BASE, TRAIN
from ..views import doubt
from .chart import Chart, Trace, axes, plain, points, text
from .page import Cell, Row, Section, cells, plain_sentences, root, table

Words = Callable[[str], str]
"""The description of an effect."""
SIGNIFICANT = 0.01
MARGIN = 0.05
"""The margin of an axis, as a share of its length."""
AROUND_NOISE = 0.5, 2.0
"""The smallest range of an error axis, so that scatter about 1 does not look large."""


class Refusal(NamedTuple):
    """What decides why a refitted candidate was not taken: the `least` misfit of all refits, and whether the command
    `adds` any."""

    least: float | None
    adds: bool


def candidates(result: Json, words: Words, near: Sequence[bool]) -> Section:
    """The candidates beside each step, best first; `near`: of which steps predictions are of whole runs."""
    steps, tables = [("base", "", result), *_later(result)], []
    for k, (name, key, step) in enumerate(steps):
        change, _, effect = steps[k + 1][0].partition(" ") if k + 1 < len(steps) else ("", "", "")
        taken = effect if change == "added" else None
        columns = ("candidate", "", "#p", f"#{FALL}", f"#{PREDICTED if near[k] else WINDOWS}", f"#{REFIT}")
        heads = (*columns, "", f"#{EXPECTED}", "#+-", f"#{DETECTS}")
        least = min((one["refit_misfit"] for one in step["ranking"] if one["refit_misfit"] is not None), default=None)
        why = Refusal(least, "steps" in result)
        rows = [row for r, one in enumerate(step["ranking"]) for row in _rows(one, f"{key}ranking.{r}", taken, why)]
        if rows:
            tables.append(table(f"Candidates added to {name}", heads, rows))
    best = [one["effect"] for one in result["ranking"][:1]]
    sentences = plain_sentences(
        "Each effect is added to the model of a step and tested. p is corrected for the number of candidates. The fall"
        " of chi^2 is that of the linear model of the test. An error of windows is that of short windows, each with a"
        " start of its own; it cannot be compared with that of a refit, which is of whole runs. The expected value does"
        " not depend on the other candidates; a refit may give another. Detects: the smallest value that these runs"
        f" would show if the model were otherwise right. {ORDER} {P_AND_SD}",
        _without(result["ranking"], near[0]),
        *(f"The best candidate is {name}: {words(name)}" for name in best),
        *_twins(result["ranking"]),
    )
    if result["left_out"]:
        left = [Row(cells(part["effect"], part["why"])) for part in result["left_out"]]
        tables.append(table("Excluded", ("effect", "why"), left))
    charts = (*_expected(result["ranking"], near[0]), *_refitted(result))
    return Section("ranking", "Effects tried and refused", sentences, charts, tuple(tables))


def _without(ranking: Sequence[Json], near: bool) -> str | None:
    """The error of the base itself where its candidates are compared."""
    known = [one["misfit_without"] for one in ranking if one["misfit_without"] is not None]
    if not known:
        return None
    what = "whole runs by the linear model" if near else "short windows"
    return f"Without any candidate the error of {what} is {times_noise_text(known[0])} times the noise."


def _later(result: Json) -> Iterator[tuple[str, str, Json]]:
    for k, step in enumerate(result.get("steps", ())):
        yield next(f"{word} {step[word]}" for word in ("added", "dropped") if word in step), f"steps.{k}.", step


def _rows(one: Json, key: str, taken: str | None, why: Refusal) -> Iterator[Row]:
    """A row for each parameter of a candidate."""
    p, fall = one["p_value"], one["statistic"]
    first = [
        _outcome(one, taken, why),
        Cell("" if p is None else f"{p:.1g}" if p > 0 else "< 1e-300", f"{key}.p_value"),
        Cell("" if fall is None else f"{fall:.3g}", f"{key}.statistic"),
        root(one["predicted_misfit"], f"{key}.predicted_misfit"),
        "failed" if one["refit_failed"] else root(one["refit_misfit"], f"{key}.refit_misfit", doubt(one["converged"])),
    ]
    for place, (name, estimate) in enumerate(list(one["estimate"].items()) or [("", None)]):
        value = ("", "", "")
        if estimate is not None:
            smallest, unit = one["detectable"].get(name), estimate["unit"].removeprefix("-")
            value = (
                Cell(number(estimate["value"], estimate["sd"]), f"{key}.estimate.{name}.value"),
                Cell(f"{error(estimate['sd'])} {unit}".rstrip(), f"{key}.estimate.{name}.sd"),
                Cell("" if smallest is None else f"{smallest:.2g}", f"{key}.detectable.{name}"),
            )
        head = (one["effect"], *first) if place == 0 else ("",) * 6
        yield Row(cells(*head, name, *value), strong=place == 0 and one["effect"] == taken)


def _outcome(one: Json, taken: str | None, why: Refusal) -> str:
    if one["effect"] == taken:
        return "taken"
    if one["p_value"] is not None and one["p_value"] >= SIGNIFICANT:
        return "not significant"
    if one["refit_failed"]:
        return "refit failed"
    if one["refit_misfit"] is None:
        return "not refitted: others lower the error more"
    if not why.adds:
        return "refitted"
    if why.least is not None and one["refit_misfit"] > why.least:
        return "refused: another candidate leaves a smaller error"
    return "refused: more than noise remains"


def _twins(ranked: Sequence[Json]) -> Iterator[str]:
    """The pairs of effects that these runs cannot distinguish, each once."""
    named: set[frozenset[str]] = set()
    for one in sorted(ranked, key=lambda one: -len(one["confusable_with"])):
        pairs = {other: frozenset((one["effect"], other)) for other in one["confusable_with"]}
        others = [other for other, pair in pairs.items() if pair not in named]
        named.update(pairs.values())
        if others:
            *first, last = others
            listed = f"{', '.join(first)}{' or ' if first else ''}{last}"
            yield f"These runs cannot distinguish {one['effect']} from {listed}."


def _expected(ranking: Sequence[Json], near: bool) -> Iterator[Chart]:
    """The error that each candidate would leave by the linear model: of short windows, or of whole runs."""
    shown = [r for r in ranking if r["predicted_misfit"] is not None][::-1]
    if not shown:
        return
    trace = _marks("expected", "circle-open", [r["effect"] for r in shown], [r["predicted_misfit"] for r in shown])
    title, what = (PREDICTED, "whole runs") if near else (WINDOWS, "short windows")
    without = times_noise(shown[0]["misfit_without"])
    label = f"The error of {what} that each candidate would leave, and that of the base, in multiples of the noise."
    layout = _layout(title, [trace], () if without is None else (without,))
    yield Chart("expected", label, (trace,), layout, 110 + 20 * len(shown))


def _refitted(result: Json) -> Iterator[Chart]:
    """The error of whole runs that each refitted candidate leaves, with that of the base."""
    shown = [r for r in result["ranking"] if r["refit_misfit"] is not None][::-1]
    if not shown:
        return
    good, bad = ([r for r in shown if (r["converged"] is False) is short] for short in (False, True))
    traces = [
        _marks(title, symbol, [r["effect"] for r in some], [r["refit_misfit"] for r in some])
        for title, symbol, some in (("refitted", "circle", good), (f"refit {NOT_CONVERGED}", "x", bad))
        if some
    ]
    base = times_noise(result["base"]["misfit"]["train"])
    layout = _layout(REFIT, traces, () if base is None else (base,))
    layout["yaxis"]["categoryarray"] = [text(r["effect"]) for r in shown]
    label = "The error of whole runs that each refitted candidate leaves, and that of the base."
    yield Chart("suspects", label, tuple(traces), layout, 150 + 20 * len(shown))


def _marks(title: str, symbol: str, names: Sequence[str], misfits: Sequence[float | None]) -> Trace:
    trace: Trace = points([], [], title, BASE, symbol=symbol)
    trace |= {
        "x": [times_noise(misfit) for misfit in misfits],
        "y": [text(name) for name in names],
        "hovertemplate": "%{y}: %{x:.3g}<extra>" + title + "</extra>",
    }
    trace["marker"] |= {"color": TRAIN, "size": 10, "line": {"width": 2, "color": TRAIN}}
    return trace


def _layout(title: str, traces: Sequence[Trace], lines: Sequence[float]) -> dict:
    """A logarithmic axis of errors, with an upright line at the error of the base where it is given."""
    every = [v for trace in traces for v in trace["x"] if v] + list(lines)
    ends = [np.log10(min(AROUND_NOISE[0], *every)), np.log10(max(AROUND_NOISE[1], *every))]
    room = MARGIN * (ends[1] - ends[0])
    xaxis = {"type": "log", "range": plain([ends[0] - room, ends[1] + room])}
    layout = axes(title, "", xaxis=xaxis, yaxis={"automargin": True, "dtick": 1}, showlegend=len(traces) > 1)
    upright = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "line": {"dash": "dot", "width": 2}}
    layout["shapes"] = [{**upright, "x0": x, "x1": x, "name": "base"} for x in lines]
    layout["annotations"] = [
        {
            "x": float(np.log10(x)),
            "y": 1,
            "yref": "paper",
            "yanchor": "top",
            "xanchor": "right",
            "text": "base ",
            "showarrow": False,
        }
        for x in lines
    ]
    return layout
