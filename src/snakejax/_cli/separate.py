"""`snakejax tune --objective separate`: which run to do next."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError, instead_of
from ._options import EffectSpec, effect_spec, finite, given
from ._progress import Say
from ._setup import Clock, Outcome
from .fit import fitted

if TYPE_CHECKING:
    from .._effect import Effect

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
    payload: tuple[float, float] | None,
    say: Say,
) -> Outcome:
    """Design the next run of one case."""
    from .._bed import bed, most_confusable, require_strengths
    from .._discriminate import separate, sharpen
    from .._errors import FitError
    from .._files import write_whole
    from .._json import clean
    from .._limits import Limits, reached_by
    from .._presets import Preset
    from .._provenance import heading_json, provenance_json
    from .._ran import Driver
    from .._tuned import (
        separation_json,
        separation_report,
        sharpening_json,
        sharpening_report,
        toml,
    )
    from .tune import carried, gaits_of, payload_json

    effects, strengths = effects_of(options.objective)
    if isinstance(case, Preset) or options.set or options.saved:
        what = "What the next run should be follows from what the given ones leave open"
        raise InputError(what, WHERE, "name a recorded case, without --set and --from")
    require_strengths(effects or ())
    wanted, held, based = candidates(options, effects)
    clock = Clock()
    gaits, length = gaits_of(case)
    seconds = length if seconds is None else seconds
    found, noise = fitted(based, case, say)
    limits = Limits.of(limit, reached_by(gaits, found.model, length) if gaits else None)
    payload, carrying = carried(payload, case)
    say("what the given runs say")
    known = bed(found, wanted, held)
    how = {
        "driver": Driver.of(gaits[0]) if gaits else Driver(),
        "given": [gait for gait in gaits if gait.phi_back is None],
        "start": start,
        "payload": payload,
        "seed": options.seed,
        "rate": frame_rate(case.runs[0]),
        "progress": lambda done, total: say("designing", done, total),
    }
    try:
        if options.objective == "information":
            design: Any = sharpen(known, limits, seconds, **how)
            parts, text = sharpening_json(design, options.objective), sharpening_report(case.name, design, carrying)
        else:
            effects = most_confusable(known) if effects is None else effects
            design = separate(known, effects, limits, seconds, case.runs, strengths=strengths, **how)
            parts = separation_json(design, options.objective)
            text = separation_report(case.name, design, carrying)
    except FitError:
        raise
    except RuntimeError as error:
        raise FitError(str(error)) from None
    result = {
        **heading_json(case.name, found.model, noise, provenance_json(options.seed, given(options), case.sha256)),
        **parts,
        **payload_json(payload),
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


def candidates(
    options: argparse.Namespace, effects: tuple[str, str] | None
) -> "tuple[dict[str, Effect], set[str], argparse.Namespace]":
    """The effects to tell apart, those of their parameters that are held, and the options of the board that is fitted.

    An `--effect` that is one of the pair is a candidate, its values held; any other is on the board.
    **Raises:** `InputError`.
    """
    from .._units import parameters
    from ..effects import LIBRARY
    from ._models import built, effect_class

    if effects is None:
        all_ = {} if options.objective == "information" else {name: kind() for name, kind in LIBRARY.items()}
        return all_, set(), options
    texts = {text: effect_spec(text) for text in options.effect or ()}
    own = {spec.name: spec for spec in texts.values() if spec.name in effects}
    if len({spec.name for spec in texts.values()}) < len(options.effect or ()):
        raise InputError("An effect is given twice", "option --effect", "give each once")
    found, held = {}, set()
    for name in effects:
        if name not in own and name not in LIBRARY:
            known = [*LIBRARY, *(spec.name for spec in texts.values())]
            remedy = f"{instead_of(name, known)}; one of your own is named by --effect FILE.py:Class too"
            raise InputError(f"There is no effect `{name}`", WHERE, remedy)
        spec = own.get(name, EffectSpec(name, None, {}))
        found[name] = built(name, effect_class(spec), spec.values)
        if len(spec.values) == len(parameters(found[name])) > 0:
            raise InputError(f"All parameters of `{name}` are held", "option --effect", "leave one without a value")
        held |= {f"effects.{name}.{part}" for part in spec.values}
    rest = [text for text, spec in texts.items() if spec.name not in effects]
    return found, held, argparse.Namespace(**{**vars(options), "effect": rest})


def frame_rate(run: Any) -> float:
    """Frames a second of a run."""
    return (run.times.shape[0] - 1) / float(run.times[-1] - run.times[0])
