"""The table of what was asked for and what was found."""

import statistics
from collections.abc import Callable
from typing import Any

from judge import wilson

Row = dict[str, Any]


def line(what: str, good: int, of: int, goal: str, met: bool | None) -> str:
    """One criterion: count, share with Wilson's interval, goal and whether it is met."""
    if not of:
        return f"  {what:<66} no board"
    low, high = wilson(good, of)
    verdict = "" if met is None else "met" if met else "NOT met"
    return f"  {what:<66} {good:3d} of {of:3d}  {good / of:5.0%} ({low:4.0%} to {high:4.0%})  {goal:<14} {verdict}"


def share(what: str, flags: list[bool], goal: str, met: Callable[[float], bool] | None = None) -> str:
    """The same of a list of facts; `met` is asked about the share."""
    good = sum(flags)
    return line(what, good, len(flags), goal, met(good / len(flags)) if met and flags else None)


def strong_part(rows: list[Row]) -> list[str]:
    """What is asked of boards with a strong effect."""
    inside = [flag for row in rows for flag in row["holds"].values()]
    ratios = sorted(row["ratio"] for row in rows if row["ratio"] is not None)
    lines = [
        share("strong effect first", [row["strong_first"] for row in rows], ">= 57 of 60", lambda s: s >= 0.95),
        share("strong effect listed first, the surest first", [row["strong_listed_first"] for row in rows], ""),
        share("strong effect called sure", [row["strong"] in row["sure"] for row in rows], ""),
        share("strong effect on top of the base ranking", [row["top_ranked"] == row["strong"] for row in rows], ""),
        share("its 95 % interval holds the truth", inside, "90 to 98 %", lambda s: 0.9 <= s <= 0.98),
        share("an absent effect called sure", [bool(r["false_sure"]) for r in rows], "<= 3 of 60", lambda s: s <= 0.05),
        share("held-out error at most 1.2 times the true model's", [r <= 1.2 for r in ratios], "all", lambda s: s == 1),
    ]
    known = sorted(row["known_ratio"] for row in rows if row["known_ratio"] is not None)
    if known:
        lines.append(share("the same without the law that no library holds", [r <= 1.2 for r in known], ""))
    informed = sorted(row["informed_ratio"] for row in rows if row["informed_ratio"] is not None)
    if informed:
        what = "the same where its constants and law are estimated too"
        lines.append(share(what, [r <= 1.2 for r in informed], ""))
    several = ("held-out ratio", ratios), ("without that law", known), ("constants and law estimated", informed)
    for name, each in several:
        if each:
            lines.append(f"  {name}: median {statistics.median(each):.2f}, largest {each[-1]:.2f}")
    return lines


def moderate_part(rows: list[Row]) -> list[str]:
    """What is asked of boards with many moderate effects."""
    found = [name in row.get("detected", ()) for row in rows for name in row.get("detectable", ())]
    absent = [name in row["absent"] for row in rows for name in row["named"]]
    return [
        share("of the effects above their detectable size, named", found, ">= 80 %", lambda s: s >= 0.8),
        share("of the effects named (sure or likely), absent", absent, "<= 5 %", lambda s: s <= 0.05),
        share("boards with an absent effect called sure", [bool(r["false_sure"]) for r in rows], ""),
        share("boards called explained", [r["verdict"] == "explained" for r in rows], ""),
    ]


def plain_part(rows: list[Row]) -> list[str]:
    """What is asked of the others: nothing that is not there, and a strong effect first where there is one."""
    strong = [row["strong_first"] for row in rows if row["strong"]]
    lines = [
        share(
            "boards with an absent effect called sure", [bool(r["false_sure"]) for r in rows], "none", lambda s: s == 0
        )
    ]
    if strong:
        lines.append(share("strong effect first", strong, "all", lambda s: s == 1))
    odd = [row for row in rows if "odd_named" in row]
    if odd:
        lines.append(share("the odd run named", [row["odd_named"] for row in odd], ">= 95 %", lambda s: s >= 0.95))
        lines.append(share("another run called odd", [bool(row["others_odd"]) for row in odd], ""))
    return lines


def null_part(rows: list[Row]) -> list[str]:
    """What is asked of boards without a strong effect."""
    return [
        share("nothing called sure", [not r["sure"] for r in rows], ">= 19 of 20", lambda s: s >= 0.95),
        share("boards with an absent effect called sure", [bool(r["false_sure"]) for r in rows], ""),
    ]


PARTS = {"real_like": strong_part, "real_like_null": null_part, "moderate": moderate_part}


def text(rows: list[Row], failed: list[str], missing: int, group: str) -> str:
    """The whole table: criteria of each kind, then one line a board."""
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    lines = [f"Set {group}: {len(rows)} boards judged, {len(failed)} without a result, {missing} not yet run", ""]
    for kind in kinds:
        some = [row for row in rows if row["kind"] == kind]
        lines += [f"{kind}, {len(some)} boards", *PARTS.get(kind, plain_part)(some), ""]
    if failed:
        lines += ["Without a result:", *(f"  {one}" for one in failed), ""]
    lines.append(
        "Board by board: strong effect; verdict; claimed (* sure, ! absent); held-out ratio, the same without the"
        " strange law; seconds"
    )
    for row in rows:
        claimed = (
            f"{name}{'*' if name in row['sure'] else ''}{'!' if name in row['false_sure'] + row['absent'] else ''}"
            for name in row["claimed"]
        )
        helpers = f" ({', '.join(row['helpers'])})" if row["helpers"] else ""
        ratio = ", ".join("-" if one is None else f"{one:.2f}" for one in (row["ratio"], row["known_ratio"]))
        lines.append(
            f"  {row['case']}: {row['strong'] or '-'}; {row['verdict']}; {', '.join(claimed) or 'nothing'}{helpers}; "
            f"{ratio}; {row['seconds']:.0f} s"
        )
    return "\n".join(lines) + "\n"
