"""Tuned gaits and designed runs as JSON, as lines of `case.toml`, and as text for a terminal."""

import math
from typing import Any

import jax
import numpy as np
from rich.console import Group
from rich.text import Text

from ._discriminate import Separation, Sharpening
from ._limits import told
from ._text import add_row, indented, named, plain_table
from ._tune import Journey, Tuned, sines


def tuned_json(found: Tuned, asked: str, over: str) -> dict[str, Any]:
    """A tuned gait as JSON."""
    return {
        "gait": found.terms(),
        "objective": found.after.result,
        "start": list(found.start),
        "limits": {name: value for name, value in found.limits.named().items() if math.isfinite(value)},
        "asked": asked,
        "duration_s": found.seconds,
        "met": found.met,
        "reached": found.reached,
        "over": over,
        "before": found.before and journey_json(found.before),
        "after": journey_json(found.after),
        "spread": found.spread,
        "simulations": {"all": found.simulations, "with_derivative": found.slopes},
    }


def journey_json(journey: Journey) -> dict[str, Any]:
    """A gait, what it achieves, and its path with the angles of the joints, 25 times a second."""
    times = np.asarray(journey.run.times)[::4]
    pose = np.asarray(journey.run.pose)[::4]
    joints = {n: np.asarray(jax.vmap(getattr(journey.gait, n).at)(times).angle) for n in ("phi", "psi")}
    try:
        gait = {name: sines(told(getattr(journey.gait, name))) for name in ("phi", "psi")}
    except ValueError:
        gait = None
    path = {"t": times, "x": pose[:, 0], "y": pose[:, 1], "heading": pose[:, 2], **joints}
    return {
        "gait": gait,
        "objective": journey.result,
        "effort_n2m2s": float(journey.run.effort),
        "path": {name: np.round(values, 7).tolist() for name, values in path.items()},
    }


def toml(found: Tuned, name: str, asked: str) -> str:
    """The gait as two lines of a run in `case.toml`."""
    terms = found.terms()
    head = f"# {name}, {asked}: a gait tuned for {found.seconds:g} s from rest"
    return "\n".join([head, *(f"{joint} = {terms[joint]}" for joint in terms)]) + "\n"


def report(name: str, asked: str, found: Tuned, over: str, carrying: str = "") -> Any:
    """What is said of a tuned gait."""
    lines: list[Any] = [Text(name, style="bold"), Text(f"{asked} in {found.seconds:g} s, {_tuned_for(over)}{carrying}")]
    table = plain_table("gait", *(keys := list(_results(asked, found.after.result))), right=tuple(keys))
    if found.before is not None:
        add_row(table, "best known, within the limits", *_results(asked, found.before.result).values())
    add_row(table, "tuned", *_results(asked, found.after.result).values())
    lines += [Text(), indented(table)]
    if found.spread:
        lines.append(Text(f"over draws from the fit: {_spread(asked, found.spread)}"))
    lines += [gait_table(found), Text(limits_line(found))]
    if not found.met:
        lines.append(Text("! No gait was found that gets there: allow more time or wider limits.", style="yellow"))
    lines.append(Text(f"{found.simulations} simulations, {found.slopes} of them with their derivative"))
    return Group(*lines)


def gait_table(found: Tuned) -> Any:
    """The terms of a gait."""
    gait = plain_table("joint", "amplitude\n[rad]", "frequency\n[rad/s]", "phase\n[rad]")
    for joint, terms in found.terms().items():
        for term in terms:
            add_row(gait, joint, *(f"{number:.5f}" for number in term))
    return indented(gait)


def _tuned_for(over: str) -> str:
    return "tuned for the board as it is" if over == "fit" else f"tuned for the {over} of draws from the fit"


UNITS = {"distance": ("distance [m]", 1.0), "turn": ("turn [rad]", 1.0)}


def _results(asked: str, result: Any) -> dict[str, str]:
    if isinstance(result, dict):
        return {key.replace("_", " "): f"{value:.4g}" for key, value in result.items()}
    return {UNITS.get(asked, ("cost", 1.0))[0]: f"{result:.4f}"}


def _spread(asked: str, spread: list[Any]) -> str:

    if isinstance(spread[0], dict):
        return ", ".join(f"{key.replace('_', ' ')} up to {max(one[key] for one in spread):.3g}" for key in spread[0])
    return f"mean {np.mean(spread):.4f}, from {min(spread):.4f} to {max(spread):.4f}"


def limits_line(found: Tuned) -> str:
    """How near a gait comes to its limits."""
    parts = [
        f"{name} {found.reached[name]:.4g} of {most:.4g}"
        for name, most in found.limits.named().items()
        if math.isfinite(most)
    ]
    return "at most, command and joint: " + ", ".join(parts)


def design_json(tuned: Tuned, asked: str, known: float | None, reached: float) -> dict[str, Any]:
    """The gait of a design as JSON: its objective is `reached`, that of the best known gait `known`."""
    found = tuned_json(tuned, asked, "fit")
    found |= {"objective": reached, "after": {**found["after"], "objective": reached}}
    found |= {"before": found["before"] and {**found["before"], "objective": known}}
    return {name: part for name, part in found.items() if name not in ("met", "spread", "over")}


def separation_json(found: Separation, asked: str) -> dict[str, Any]:
    """A run that tells two effects apart, as JSON."""
    return {
        **design_json(found.tuned, asked, found.known, found.after),
        "separate": {
            "effects": list(found.effects),
            "strengths": found.strengths,
            "before": found.before,
            "after": found.after,
            "sure_from": {"given": found.sure_from[0], "with_this_run": found.sure_from[1]},
            "repeats": found.repeats,
            "chi2": list(found.gaps),
            "advice": [{"do": a.do, "run": a.run, "certainty": a.certainty} for a in found.advice],
        },
    }


def sharpening_json(found: Sharpening, asked: str) -> dict[str, Any]:
    """A run that says most about the tyre, as JSON; the objective is the geometric mean of how sds shrink."""
    known = found.known and found.shrunk(found.known)
    return {
        **design_json(found.tuned, asked, known, found.shrunk(found.after)),
        "information": {"sd_before": found.before, "sd_after": found.after},
    }


def separation_report(name: str, found: Separation, carrying: str = "") -> Any:
    """What is said of a run that tells two effects apart."""
    one, other = found.effects
    strong = ", ".join(f"{n.removeprefix('effects.')} = {v:.3g}" for n, v in found.strengths.items())
    table = plain_table("to do", "right answers", right=("right answers",))
    add_row(table, "nothing: the given runs alone", f"{100 * found.before:.1f} %")
    for a in found.advice:
        add_row(table, f"{a.do}, as in {a.run}", f"{100 * a.certainty:.1f} %")
    add_row(table, f"the designed run, {found.tuned.seconds:g} s{carrying}", f"{100 * found.after:.1f} %", style="bold")
    if found.repeats == 0:
        need = "The given runs are enough at this strength."
    elif found.repeats is None:
        need = "Not even many repeats of it make the answer sure at this strength."
    else:
        need = f"{found.repeats} such run{'s' if found.repeats > 1 else ''} make 95 %."
    before, after = (next(iter(part.items())) for part in found.sure_from)
    shown = before[0].removeprefix("effects.")
    return Group(
        Text(f"{name}: {one} or {other}?", style="bold"),
        Text(f"at {strong}"),
        Text(),
        indented(table),
        Text(need),
        Text(f"{shown} is told apart in 95 % from {before[1]:.3g} on, with the designed run from {after[1]:.3g} on."),
        *_gait_lines(found.tuned),
    )


def sharpening_report(name: str, found: Sharpening, carrying: str = "") -> Any:
    """What is said of a run that tells more about the tyre."""
    table = plain_table("parameter", "+- before", "+- with the run", right=("+- before", "+- with the run"))
    for parameter, sd in found.before.items():
        add_row(table, named(parameter), f"{sd:.2g}", f"{found.after[parameter]:.2g}")
    head = f"the run of {found.tuned.seconds:g} s that says most about the tyre{carrying}"
    error = "standard errors, those of positive parameters relative"
    return Group(Text(name, style="bold"), Text(head), Text(error), Text(), indented(table), *_gait_lines(found.tuned))


def _gait_lines(tuned: Tuned) -> list[Any]:

    return [Text(), gait_table(tuned), Text(limits_line(tuned))]
