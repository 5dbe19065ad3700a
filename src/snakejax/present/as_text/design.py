"""Tuned gaits and designed runs as text."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Group
from rich.text import Text

from snakejax.design.experiments import DiscriminationDesign, PrecisionDesign
from snakejax.design.limits import QUANTITIES
from snakejax.design.tuning import TuningResult

from .errors import POSE_ERRORS, milli_text, missed_text
from .tables import add_row, indented, named, plain_table

RIGHT_ANSWER = "probability of the right answer"
"""The column of `correct_selection_probability`."""


def report(name: str, objective: str, tuned: TuningResult, over: str, with_payload: str = "") -> Any:
    """The report of a tuned gait."""
    lines: list[Any] = [
        Text(name, style="bold"),
        Text(f"{objective} in {tuned.seconds:g} s, {_tuned_for(over)}{with_payload}"),
    ]
    table = plain_table("gait", *(keys := list(_results(objective, tuned.after.result))), right=tuple(keys))
    if tuned.before is not None:
        add_row(table, "best known gait, within the limits", *_results(objective, tuned.before.result).values())
    add_row(table, "tuned", *_results(objective, tuned.after.result).values())
    lines += [Text(), indented(table)]
    if tuned.spread:
        lines.append(Text(f"over samples of the fit: {_spread(tuned.spread)}"))
    lines += [gait_table(tuned), Text(limits_line(tuned))]
    if not tuned.met:
        lines.append(Text("! No gait reaches the target: allow more time or wider limits.", style="yellow"))
    lines.append(Text(f"{tuned.simulations} simulations, {tuned.slopes} of them with their derivative"))
    return Group(*lines)


def gait_table(tuned: TuningResult) -> Any:
    """The terms of the tuned gait."""
    gait = plain_table("input", amplitude_head(tuned.units, "\n"), "frequency\n[rad/s]", "phase\n[rad]")
    for name, terms in tuned.terms().items():
        for term in terms:
            add_row(gait, name, *(f"{number:.5f}" for number in term))
    return indented(gait)


def _tuned_for(over: str) -> str:
    return "tuned for the model itself" if over == "fit" else f"tuned for the {over} over samples of the fit"


PER_TIME = {
    "rad": ("rad", "rad/s", "rad/s^2"),
    "m/s": ("m/s", "m/s^2", "m/s^3"),
    "N m": ("N m", "N m/s", "N m/s^2"),
    "-": ("-", "1/s", "1/s^2"),
}
"""By the unit of an input, those of the limits of its value, rate and acceleration."""
UNITS = {"distance": ("distance [m]", 1.0), "turn": ("turn [rad]", 1.0)}


def _results(objective: str, result: Any) -> dict[str, str]:
    if isinstance(result, dict):
        return {POSE_ERRORS[key]: milli_text(value) for key, value in result.items()}
    return {UNITS.get(objective, ("cost", 1.0))[0]: f"{result:.4f}"}


def _spread(spread: list[Any]) -> str:
    if isinstance(spread[0], dict):
        return f"missed by up to {missed_text({key: max(result[key] for result in spread) for key in POSE_ERRORS})}"
    return f"mean {np.mean(spread):.4f}, from {min(spread):.4f} to {max(spread):.4f}"


def amplitude_head(units: Mapping[str, str], between: str = " ") -> str:
    """The head of a column of amplitudes, with the unit of the inputs where all have the same; `between` the two."""
    each = set(units.values())
    return f"amplitude{between}[{each.pop()}]" if len(each) == 1 else "amplitude"


def limit_unit(name: str, units: Mapping[str, str]) -> str:
    """The unit of a limit such as `phi_rate`, from the units of the inputs."""
    known = {
        f"{one}{behind}": unit
        for one, base in units.items()
        for behind, unit in zip(QUANTITIES, PER_TIME[base], strict=True)
    }
    return known[name]


def limits_line(tuned: TuningResult) -> str:
    """The largest angles and rates of a gait, and their limits."""
    parts = [
        f"{name} {tuned.reached[name]:.4g} of {most:.4g} {limit_unit(name, tuned.units)}"
        for name, most in tuned.limits.named().items()
        if math.isfinite(most)
    ]
    return "largest of command and joint: " + ", ".join(parts)


def discrimination_report(name: str, design: DiscriminationDesign, with_payload: str = "") -> Any:
    """The report of a run designed to distinguish two effects."""
    one, other = design.effects
    strong = ", ".join(f"{n.removeprefix('effects.')} = {v:.3g}" for n, v in design.strengths.items())
    table = plain_table("data", RIGHT_ANSWER, right=(RIGHT_ANSWER,))
    add_row(table, "the given runs alone", f"{100 * design.before:.1f} %")
    for a in design.advice:
        add_row(table, f"{a.do}, as in {a.run}", f"{100 * a.certainty:.1f} %")
    add_row(
        table,
        f"the designed run, {design.tuned.seconds:g} s{with_payload}",
        f"{100 * design.after:.1f} %",
        style="bold",
    )
    if design.repeats == 0:
        need = "The given runs are enough at this strength."
    elif design.repeats is None:
        need = "No number of repeats reaches 95 % at this strength."
    else:
        need = f"{design.repeats} such run{'s reach' if design.repeats > 1 else ' reaches'} 95 %."
    before, after = (next(iter(part.items())) for part in design.sure_from)
    shown = before[0].removeprefix("effects.")
    return Group(
        Text(f"{name}: {one} or {other}?", style="bold"),
        Text(f"The probabilities hold for {strong}."),
        Text(),
        indented(table),
        Text(need),
        Text(
            f"The right effect is selected in 95 % of the cases if {shown} is at least {before[1]:.3g} with the given"
            f" runs, or at least {after[1]:.3g} with the designed run."
        ),
        *_gait_lines(design.tuned),
    )


def precision_report(name: str, design: PrecisionDesign, with_payload: str = "") -> Any:
    """The report of a run designed to determine the tyre parameters."""
    table = plain_table("parameter", "+- before", "+- with the run", right=("+- before", "+- with the run"))
    for parameter, sd in design.before.items():
        add_row(table, named(parameter), f"{sd:.2g}", f"{design.after[parameter]:.2g}")
    head = f"the run of {design.tuned.seconds:g} s that determines the tyre parameters best{with_payload}"
    error = "standard errors; relative ones for positive parameters"
    return Group(Text(name, style="bold"), Text(head), Text(error), Text(), indented(table), *_gait_lines(design.tuned))


def _gait_lines(tuned: TuningResult) -> list[Any]:
    return [Text(), gait_table(tuned), Text(limits_line(tuned))]
