"""What `snakejax explain` said of one made-up board, against what the board hides.

Sure is what `final.confidence` calls sure or, where a result has no confidence, every effect in `effects`. A claim is
true if the board holds that effect, whatever its size. What works like a wrong constant is not there: a rotor_gain
called sure where the rotor's inertia alone is off is a false claim, while a claim that names the mass, an inertia or a
length is true where that constant is off by more than 0.2 %. Idle boards cannot tell clock_offset from both lags
together: each stands for the other. A law found (`law_1`) is true where the board holds something strange or odd.
"""

import math
from typing import Any

from truth import DETECTABLE

LAGS = {"steering_lag", "rotor_lag"}
CONSTANTS = {"mass": ("m",), "inertia": ("I", "Jr"), "length": ("L",)}
INERTIA_SD = {"rotor_gain.g": 0.07}
"""What works like a constant is known as well as that: the rotor's inertia within 7 %, as snakejax takes it where a
case states no better."""
Z95 = 1.959964


def claims(found: dict[str, Any]) -> dict[str, str]:
    """How sure the program is of each effect it names, the first first: that with the largest share, or as listed."""
    final = found.get("final") or {}
    confidence, share = final.get("confidence") or {}, final.get("share") or {}
    names = dict.fromkeys([*found["effects"], *confidence])
    ordered = sorted(names, key=lambda name: -(share.get(name) or 0.0)) if share else list(names)
    return {name: confidence.get(name, "sure") for name in ordered}


def is_true(claim: str, key: dict[str, Any]) -> bool:
    """Whether the board holds what is claimed."""
    there = set(key["effects"])
    if claim in there or (claim in LAGS and "clock_offset" in there) or (claim == "clock_offset" and there >= LAGS):
        return True
    if claim.startswith("law_"):
        return bool(key["strange"] or key["odd"])
    return any(word in claim and abs(key["off"][name]) > 0.002 for word, names in CONSTANTS.items() for name in names)


def is_same(claim: str, effect: str | None) -> bool:
    """Whether the claim is this effect or one that an idle board cannot tell from it."""
    return claim == effect or (claim in LAGS and effect == "clock_offset")


def score(found: dict[str, Any], key: dict[str, Any], truth: dict[str, Any] | None) -> dict[str, Any]:
    """One row: what was claimed and how much of it is so. `truth` is what `truth.refit` says, or None."""
    claimed, final = claims(found), found.get("final") or {}
    sure = [name for name, how in claimed.items() if how == "sure"]
    named = [name for name, how in claimed.items() if how in ("sure", "likely")]
    ranking = found.get("ranking") or []
    top = ranking[0]["effect"] if ranking else None
    row = {
        "case": key["case"],
        "kind": key["kind"],
        "strong": key["strong"],
        "verdict": found["verdict"],
        "claimed": claimed,
        "sure": sure,
        "false_sure": [name for name in sure if not is_true(name, key)],
        "absent": [name for name in named if not is_true(name, key)],
        "named": named,
        "first": next(iter(claimed), top),
        "top_ranked": top,
        "holds": holds(final, key),
        "ratio": ratio(final, key, truth and truth["heldout"]),
        "known_ratio": ratio(final, key, truth and truth.get("known")),
        "informed_ratio": ratio(final, key, truth and truth.get("informed")),
        "helpers": [name for name in final.get("effects") or {} if name not in claimed],
        "seconds": found["seconds"]["total"],
    }
    if key["odd"]:
        row["odd_named"] = bool({odd["run"] for odd in found.get("odd_runs") or ()} & set(key["odd"]))
        row["others_odd"] = sorted({odd["run"] for odd in found.get("odd_runs") or ()} - set(key["odd"]))
    row["strong_first"] = is_same(row["first"], key["strong"]) if key["strong"] else None
    listed = next(iter([*found["effects"], *(final.get("confidence") or {})]), top)
    row["strong_listed_first"] = is_same(listed, key["strong"]) if key["strong"] else None
    if truth:
        row["detectable"] = [name for name in key["effects"] if clear(name, key, truth) >= DETECTABLE]
        row["detected"] = [name for name in row["detectable"] if name in named or twin_named(name, named)]
    return row


def twin_named(effect: str, named: list[str]) -> bool:
    """Whether what an idle board cannot tell from `effect` is named."""
    return set(named) >= LAGS if effect == "clock_offset" else effect in LAGS and "clock_offset" in named


def clear(effect: str, key: dict[str, Any], truth: dict[str, Any]) -> float:
    """How many standard errors an effect has, by the true model with all that is hidden free."""

    def error(name: str) -> float:
        return math.hypot(truth["sd"][name], INERTIA_SD.get(name, 0.0))

    values = key["effects"][effect]
    return max((abs(v) / error(f"{effect}.{p}") for p, v in values.items() if v), default=math.inf)


def holds(final: dict[str, Any], key: dict[str, Any]) -> dict[str, bool]:
    """For each parameter of the strong effect that is estimated, claimed or not, whether its interval holds it.

    The interval is `interval` where the result has one, else value +- 1.96 sd.
    """
    estimates = (final.get("effects") or {}).get(key["strong"]) or {}
    found = {}
    for name, true in key["effects"].get(key["strong"], {}).items():
        if name in estimates:
            one = estimates[name]
            half = Z95 * (one["sd"] or 0.0)
            low, high = one.get("interval") or (one["value"] - half, one["value"] + half)
            found[name] = low <= true <= high
    return found


def ratio(final: dict[str, Any], key: dict[str, Any], reached: dict[str, Any] | None) -> float | None:
    """Held-out error of the final model over that `reached` by another: both channels over the noise, root mean
    square."""
    if not reached or not (final.get("rmse") or {}).get("heldout"):
        return None
    position, heading = (math.hypot(*two) for two in zip(key["noise"]["white"], key["noise"]["wander"], strict=True))
    mine, best = (
        math.hypot(one["position_m"] / position, one["heading_rad"] / heading)
        for one in (final["rmse"]["heldout"], reached)
    )
    return mine / best


def wilson(good: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    if not of:
        return math.nan, math.nan
    share, z2 = good / of, Z95**2
    centre, half = share + z2 / (2 * of), Z95 * math.sqrt(share * (1 - share) / of + z2 / (4 * of * of))
    low, high = (centre - half) / (1 + z2 / of), (centre + half) / (1 + z2 / of)
    return max(low, 0.0), min(high, 1.0)  # rounding may lead across
