"""`snakejax tune --objective separate`: which run to do next."""

import argparse
from pathlib import Path
from typing import Any

from .._errors import InputError, instead_of
from ._options import finite, given
from ._setup import Clock, Outcome, Say
from .fit import fitted

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
    from .._bed import bed, most_confusable
    from .._discriminate import separate, sharpen
    from .._errors import FitError
    from .._files import write_whole
    from .._json import clean
    from .._limits import Limits, reached_by
    from .._presets import Preset
    from .._provenance import heading_json, provenance_json
    from .._ran import Driver
    from .._tuned import (
        design_json,
        separation_json,
        separation_report,
        sharpening_json,
        sharpening_report,
        toml,
    )
    from ..effects import LIBRARY
    from .tune import gaits_of

    effects, strengths = effects_of(options.objective)
    if isinstance(case, Preset) or options.set or options.saved:
        what = "What the next run should be follows from what the given ones leave open"
        raise InputError(what, WHERE, "name a recorded case, without --set and --from")
    for name in effects or ():
        if name not in LIBRARY:
            raise InputError(f"There is no effect `{name}`", WHERE, instead_of(name, LIBRARY))
    clock = Clock()
    gaits, length = gaits_of(case)
    seconds = length if seconds is None else seconds
    found, noise = fitted(options, case, say)
    limits = Limits.of(limit, reached_by(gaits, found.model, length) if gaits else None)
    wanted = LIBRARY if effects is None else {name: LIBRARY[name] for name in effects}
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
        **design_json(design.tuned, options.objective),
        **parts,
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        from .. import plot
        from ..report import tune_page

        say("drawing")
        write_whole(folder / "gait.toml", toml(design.tuned, case.name, options.objective))
        write_whole(folder / "tune.html", tune_page(clean(result)))
        plot.save(plot.designed(result), folder, "tune")

    return Outcome(clean(result), text, write)


def frame_rate(run: Any) -> float:
    """Frames a second of a run."""
    return (run.times.shape[0] - 1) / float(run.times[-1] - run.times[0])
