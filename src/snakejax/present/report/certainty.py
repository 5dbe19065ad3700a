"""The section that says how sure each effect is, and lists every candidate of every step."""

from collections.abc import Iterable

from ..as_json.values import Json
from .page import Cell, Row, Section, cells, table
from .parameters import PARAMETER_COLUMNS, parameter_rows


def certainty(result: Json, sentences: Iterable[str]) -> Section:
    """How sure each effect is, what it explains, what vehicle and cameras leave, and the candidates of every step."""
    final, steps = result["final"], ["base", *(step.get("added") or step.get("dropped") for step in result["steps"])]
    sure = [
        Row(
            cells(
                effect,
                word.replace("_", " "),
                Cell(_percent(final["share"].get(effect)), f"final.share.{effect}*100"),
            )
        )
        for effect, word in final["confidence"].items()
    ]
    tables = [table("Effects", ("effect", "how sure", "#share of the squared error [%]"), sure)]
    if final["constants"]:
        rows = list(parameter_rows(final["constants"], "final.constants"))
        tables.append(table("Constants of the vehicle", PARAMETER_COLUMNS, rows))
    tried = [
        Row(
            cells(
                steps[one["step"]],
                one["effect"],
                Cell("" if one["p_value"] is None else f"{one['p_value']:.1g}", f"candidates.{k}.p_value"),
                Cell(_percent(one["share"]), f"candidates.{k}.share*100"),
                one["why"],
            ),
            strong=one["taken"],
        )
        for k, one in enumerate(result["candidates"])
    ]
    if tried:
        heads = ("beside", "candidate", "#p", "#share, left out [%]", "why")
        tables.append(table("Every candidate", heads, tried))
    return Section("certainty", "How sure this is", tuple(sentences), (), tuple(tables))


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"
