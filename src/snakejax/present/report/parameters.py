"""The section of the parameters of a page, and the rows of estimates in other sections."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.core.parameter import Domain
from snakejax.core.parameter import parameters as parameters_of
from snakejax.dynamics.model import Model
from snakejax.dynamics.tyres import Pacejka, Rayleigh
from snakejax.estimation.fitted_model import FittedModel
from snakejax.estimation.initial_model import starting_tyre

from ..as_json.values import EXPRESSION, Json
from ..as_text.tables import bounds_text, clipped, error, named, number
from ..views import doubt
from .chart import Chart, plain, text
from .page import Cell, Row, Section, cells, plain_sentences, table


class Origin(NamedTuple):
    """The bounds of a parameter, and the value from which a fit starts unless another is given."""

    domain: Domain
    start: float | None


def parameters(result: Json, fitted: Sequence[FittedModel], advice: Sequence[str] = ()) -> Section:
    """The parameters with their intervals, default starts and bounds, and how their errors are correlated.

    `fitted`: the base model, or the base and the final model.
    """
    tables = []
    # Without a step the final model is the base.
    parts = [("base", result["base"])] + ([("final", result["final"])] if result.get("steps") else [])
    for (key, part), one in zip(parts, (fitted[0], fitted[-1]), strict=False):
        known = origins(one.model)
        rows = list(parameter_rows(part["parameters"], f"{key}.parameters", known=known))
        for effect, values in (part.get("effects") or {}).items():
            numbers = {name: value for name, value in values.items() if name != EXPRESSION}
            rows += parameter_rows(numbers, f"{key}.effects.{effect}", f"{effect}.", known)
        caption = {"base": "The base model", "final": "The final model"}[key] if len(parts) > 1 else "Parameters"
        tables.append(table(caption + doubt(part["converged"]), (*PARAMETER_COLUMNS, "#default start", "bounds"), rows))
    if result.get("combinations"):
        rows = list(parameter_rows(result["combinations"], "combinations"))
        heads = ("combination", *PARAMETER_COLUMNS[1:])
        caption = f"Combinations that the runs determine{doubt(result['base']['converged'])}"
        tables.append(table(caption, heads, rows))
    charts = [chart for chart in [correlation(fitted[-1])] if chart is not None]
    chart_note = (
        "The chart shows how the errors of the parameters of the last model are correlated." if charts else None
    )
    return Section("parameters", "Parameters", plain_sentences(*advice, chart_note), tuple(charts), tuple(tables))


PARAMETER_COLUMNS = ("parameter", "#value", "#+-", "unit", "95% interval", "")


def origins(model: Model) -> dict[str, Origin]:
    """Bounds and default starts of the parameters of the tyre and of the effects, by the names in tables."""
    kind = "pacejka" if isinstance(model.tyre, Pacejka) else "rayleigh" if isinstance(model.tyre, Rayleigh) else "ideal"
    tyre = {f"tyre.{n}": float(p.value) for n, p in parameters_of(starting_tyre(kind, model.board)).items()}
    starts = tyre | {
        f"effects.{name}.{field.name}": float(field.default)
        for name, effect in model.effects.items()
        for field in dataclasses.fields(effect)
        if "domain" in field.metadata and isinstance(field.default, int | float)
    }
    return {
        named(name): Origin(part.domain, starts.get(name))
        for name, part in parameters_of(model).items()
        if name.startswith(("tyre.", "effects."))
    }


def parameter_rows(
    parts: Mapping[str, Json], key: str, prefix: str = "", known: Mapping[str, Origin] | None = None
) -> Iterator[Row]:
    """A row for each estimate; with `known`, the interval ends at the bounds, which stand beside it with the start."""
    for name, part in parts.items():
        sd, origin = part["sd"], (known or {}).get(prefix + name)
        low, high = clipped(part.get("interval") or (None, None), origin and origin.domain)
        interval = "" if not part.get("interval") else f"{_end(low, sd, '-inf')} to {_end(high, sd, 'inf')}"
        note = "fixed" if part.get("held") else "" if part["determined"] else "cannot be determined"
        note = "at its bound" if part.get("at_bound") else note
        value = Cell(number(part["value"], sd), f"{key}.{name}.value")
        more = ()
        if known is not None:
            more = ("", "") if origin is None else (number(origin.start), bounds_text(origin.domain))
        sd_cell = Cell(error(sd), f"{key}.{name}.sd")
        yield Row(cells(prefix + name, value, sd_cell, part["unit"], interval, note, *more))


def _end(value: float | None, sd: float | None, open_: str) -> str:
    return open_ if value is None else number(value, sd)


def correlation(fitted: FittedModel) -> Chart | None:
    """The correlation matrix of the estimated parameters; None for fewer than two."""
    covariance, names = fitted.covariance, [text(named(name)) for name in fitted.loose]
    if len(names) < 2 or not (np.isfinite(covariance).all() and (np.diag(covariance) > 0).all()):
        return None
    sd = np.sqrt(np.diag(covariance))
    z = [plain(np.round(row, 3)) for row in covariance / np.outer(sd, sd)]
    trace = {
        "type": "heatmap",
        "x": names,
        "y": names,
        "z": z,
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#2b7bba"], [0.5, "#f4f5f7"], [1, "#d55e00"]],
        "texttemplate": "%{z:.2f}",
        "textfont": {"color": "#1b1f24"},
        "hovertemplate": "%{y}, %{x}: %{z:.3f}<extra></extra>",
        "colorbar": {"title": {"text": "correlation"}, "thickness": 12},
    }
    layout = {"xaxis": {"automargin": True}, "yaxis": {"automargin": True, "autorange": "reversed"}}
    label = "The correlation of the errors of the parameters."
    return Chart("correlation", label, (trace,), layout, 120 + 34 * len(names))
