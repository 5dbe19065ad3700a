"""`snakejax tune --objective separate`: which run to do next."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._options import finite, given
from ._setup import Clock, Outcome, Say
from .fit import fitted

if TYPE_CHECKING:
    from .._discriminate import Separation, Sharpening

WHERE = "option --objective"


def effects_of(text: str) -> tuple[tuple[str, str] | None, dict[str, float]]:
    """The two effects of `separate:A,B` and the strengths of `separate:A=0.1,B=0.2`; None for `separate` alone.

    **Raises:** `InputError`.
    """
    kind, _, rest = text.partition(":")
    if kind == "information" or not rest:
        if text not in ("separate", "information"):
            raise InputError(f"There is no objective `{text}`", WHERE, "write separate:EFFECT,EFFECT or information")
        return None, {}
    parts = [part.partition("=") for part in rest.split(",")]
    if len(parts) != 2 or not all(name.strip() for name, _, _ in parts):
        raise InputError(f"`{text}` does not name two effects", WHERE, "write separate:body_drag,longitudinal_slip")
    strengths = {name.strip(): finite(value, WHERE, f"`{text}`") for name, sign, value in parts if sign}
    return (parts[0][0].strip(), parts[1][0].strip()), strengths


def work(
    options: argparse.Namespace,
    case: Any,
    seconds: float | None,
    limit: dict[str, float],
    start: tuple[float, float, float],
    say: Say,
) -> Outcome:
    """Design the next run of one case."""
    from .._discriminate import bed, most_confusable, separate, sharpen
    from .._fit import FitError
    from .._json import clean, heading_json, provenance_json, write_whole
    from .._limits import Limits, reached_by
    from .._presets import Preset
    from .._ran import Driver
    from ..effects import LIBRARY
    from .tune import gaits_of, toml

    effects, strengths = effects_of(options.objective)
    if isinstance(case, Preset) or options.set or options.saved:
        what = "What the next run should be follows from what the given ones leave open"
        raise InputError(what, WHERE, "name a recorded case, without --set and --from")
    clock = Clock()
    gaits, length = gaits_of(case)
    seconds = length if seconds is None else seconds
    found, noise = fitted(options, case, say)
    limits = Limits.of(limit, reached_by(gaits, found.model, length) if gaits else None)
    wanted = LIBRARY if effects is None else {name: LIBRARY[name] for name in effects if name in LIBRARY}
    say("what the given runs say")
    known = bed(found, {} if options.objective == "information" else {name: kind() for name, kind in wanted.items()})
    how = {
        "driver": Driver.of(gaits[0]) if gaits else Driver(),
        "given": [gait for gait in gaits if gait.phi_back is None],
        "start": start,
        "seed": options.seed,
        "rate": frame_rate(case.runs[0]),
        "progress": lambda done, total: say("designing", done, total),
    }
    try:
        if options.objective == "information":
            design: Any = sharpen(known, limits, seconds, **how)
            parts, text = sharpening_json(design), sharpening_report(case.name, design)
        else:
            effects = most_confusable(known) if effects is None else effects
            design = separate(known, effects, limits, seconds, case.runs, strengths=strengths, **how)
            parts, text = separation_json(design), separation_report(case.name, design)
    except FitError:
        raise
    except RuntimeError as error:
        raise FitError(str(error)) from None
    result = {
        **heading_json(case.name, found.model, noise, provenance_json(options.seed, given(options), case.sha256)),
        **tuned_parts(design.tuned, options.objective),
        **parts,
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot, plot_tune

        say("drawing")
        write_whole(folder / "gait.toml", toml(design.tuned, case.name, options.objective))
        plot.save(plot_tune.designed(result), folder, "tune")

    return Outcome(clean(result), text, write)


def frame_rate(run: Any) -> float:
    """Frames a second of a run."""
    return (run.times.shape[0] - 1) / float(run.times[-1] - run.times[0])


def tuned_parts(tuned: Any, asked: str) -> dict[str, Any]:
    """The gait of a design as JSON."""
    from .tune import tuned_json

    found = tuned_json(tuned, asked, "fit")
    return {name: part for name, part in found.items() if name not in ("met", "spread", "over")}


def separation_json(found: "Separation") -> dict[str, Any]:
    """A run that tells two effects apart, as JSON."""
    return {
        "objective": found.after,
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


def sharpening_json(found: "Sharpening") -> dict[str, Any]:
    """A run that says most about the tyre, as JSON; the objective is the geometric mean of how sds shrink."""
    import numpy as np

    shrunk = [found.after[name] / found.before[name] for name in found.before]
    return {
        "objective": float(np.exp(np.mean(np.log(shrunk)))),
        "information": {"sd_before": found.before, "sd_after": found.after},
    }


def separation_report(name: str, found: "Separation") -> Any:
    """What is said of a run that tells two effects apart."""
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, indented, plain_table

    one, other = found.effects
    strong = ", ".join(f"{n.removeprefix('effects.')} = {v:.3g}" for n, v in found.strengths.items())
    table = plain_table("to do", "right answers", right=("right answers",))
    add_row(table, "nothing: the given runs alone", f"{100 * found.before:.1f} %")
    for a in found.advice:
        add_row(table, f"{a.do}, as in {a.run}", f"{100 * a.certainty:.1f} %")
    add_row(table, f"the designed run, {found.tuned.seconds:g} s", f"{100 * found.after:.1f} %", style="bold")
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


def sharpening_report(name: str, found: "Sharpening") -> Any:
    """What is said of a run that tells more about the tyre."""
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, indented, named, plain_table

    table = plain_table("parameter", "+- before", "+- with the run", right=("+- before", "+- with the run"))
    for parameter, sd in found.before.items():
        add_row(table, named(parameter), f"{sd:.2g}", f"{found.after[parameter]:.2g}")
    head = "standard errors of ln B, ln C, ln D and E, given runs and with the designed one"
    return Group(Text(name, style="bold"), Text(head), Text(), indented(table), *_gait_lines(found.tuned))


def _gait_lines(tuned: Any) -> list[Any]:
    from rich.text import Text

    from .tune import gait_table, limits_line

    return [Text(), gait_table(tuned), Text(limits_line(tuned))]
