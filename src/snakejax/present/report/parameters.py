"""The section of the parameters of a page, and the rows of estimates in other sections."""

from collections.abc import Iterator, Mapping, Sequence

from ..as_json.values import Json
from ..as_text.tables import error, number
from ..views import doubt
from .page import Cell, Row, Section, cells, plain_sentences, table


def parameters(result: Json, advice: Sequence[str] = ()) -> Section:
    """The parameters with their intervals, and those that are not determined."""
    tables = []
    # Without a step the final model is the base.
    parts = [("base", result["base"])] + ([("final", result["final"])] if result.get("steps") else [])
    for key, part in parts:
        rows = list(parameter_rows(part["parameters"], f"{key}.parameters"))
        for effect, values in (part.get("effects") or {}).items():
            rows += parameter_rows(values, f"{key}.effects.{effect}", f"{effect}.")
        caption = {"base": "The base model", "final": "The final model"}[key] if len(parts) > 1 else "Parameters"
        tables.append(table(caption + doubt(part["converged"]), PARAMETER_COLUMNS, rows))
    if result.get("combinations"):
        rows = list(parameter_rows(result["combinations"], "combinations"))
        heads = ("combination", "#value", "#+-", "unit", "95% interval", "")
        caption = f"Combinations that the runs determine{doubt(result['base']['converged'])}"
        tables.append(table(caption, heads, rows))
    return Section("parameters", "Parameters", plain_sentences(*advice), (), tuple(tables))


PARAMETER_COLUMNS = ("parameter", "#value", "#+-", "unit", "95% interval", "")


def parameter_rows(parts: Mapping[str, Json], key: str, prefix: str = "") -> Iterator[Row]:
    for name, part in parts.items():
        low, high = part.get("interval") or (None, None)
        sd = part["sd"]
        interval = "" if low is None and high is None else f"{_end(low, sd, '-inf')} to {_end(high, sd, 'inf')}"
        note = "fixed" if part.get("held") else "" if part["determined"] else "cannot be determined"
        note = "at its bound" if part.get("at_bound") else note
        value = Cell(number(part["value"], sd), f"{key}.{name}.value")
        yield Row(cells(prefix + name, value, Cell(error(sd), f"{key}.{name}.sd"), part["unit"], interval, note))


def _end(value: float | None, sd: float | None, open_: str) -> str:
    return open_ if value is None else number(value, sd)
