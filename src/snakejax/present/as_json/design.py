"""Tuned gaits and designed runs as JSON, and as lines of `case.toml`."""

import math
from typing import Any

import numpy as np

from snakejax.design.experiments import DiscriminationDesign, PrecisionDesign
from snakejax.design.limits import limits_of
from snakejax.design.tuning import GaitResult, TuningResult, sines
from snakejax.dynamics.signals import angles_at


def tuned_json(tuned: TuningResult, objective: str, over: str) -> dict[str, Any]:
    """A tuned gait as JSON."""
    return {
        "gait": tuned.terms(),
        "objective": tuned.after.result,
        "start": list(tuned.start),
        "units": dict(tuned.units),
        "limits": {name: value for name, value in tuned.limits.named().items() if math.isfinite(value)},
        "asked": objective,
        "duration_s": tuned.seconds,
        "met": tuned.met,
        "reached": tuned.reached,
        "over": over,
        "before": tuned.before and journey_json(tuned.before),
        "after": journey_json(tuned.after),
        "spread": tuned.spread,
        "simulations": {"all": tuned.simulations, "with_derivative": tuned.slopes},
    }


def journey_json(journey: GaitResult) -> dict[str, Any]:
    """A gait, its result, and its path with the joint angles at 25 Hz."""
    times = np.asarray(journey.run.times)[::4]
    pose = np.asarray(journey.run.pose)[::4]
    signals = {name: journey.gait.signal(name) for name in journey.gait.names}
    joints = {name: np.asarray(angles_at(signal, times)) for name, signal in signals.items()}
    try:
        gait = {name: sines(limits_of(signal)) for name, signal in signals.items()}
    except ValueError:
        gait = None
    path = {"t": times, "x": pose[:, 0], "y": pose[:, 1], "heading": pose[:, 2], **joints}
    return {
        "gait": gait,
        "objective": journey.result,
        "effort_n2m2s": float(journey.run.effort),
        "path": {name: np.round(values, 7).tolist() for name, values in path.items()},
    }


def toml(tuned: TuningResult, name: str, objective: str) -> str:
    """The gait as two lines of a run in `case.toml`."""
    terms = tuned.terms()
    head = f"# {name}, {objective}: a gait tuned for {tuned.seconds:g} s from rest"
    return "\n".join([head, *(f"{joint} = {terms[joint]}" for joint in terms)]) + "\n"


def design_json(tuned: TuningResult, objective: str, known: float | None, reached: float) -> dict[str, Any]:
    """The gait of a design as JSON; its objective is `reached`, that of the best known gait `known`."""
    result = tuned_json(tuned, objective, "fit")
    result |= {"objective": reached, "after": {**result["after"], "objective": reached}}
    result |= {"before": result["before"] and {**result["before"], "objective": known}}
    return {name: part for name, part in result.items() if name not in ("met", "spread", "over")}


def discrimination_json(design: DiscriminationDesign, objective: str) -> dict[str, Any]:
    """A run designed to distinguish two effects, as JSON."""
    return {
        **design_json(design.tuned, objective, design.known, design.after),
        "separate": {
            "effects": list(design.effects),
            "strengths": design.strengths,
            "before": design.before,
            "after": design.after,
            "sure_from": {"given": design.sure_from[0], "with_this_run": design.sure_from[1]},
            "repeats": design.repeats,
            "chi2": list(design.gaps),
            "advice": [{"do": a.do, "run": a.run, "certainty": a.certainty} for a in design.advice],
        },
    }


def precision_json(design: PrecisionDesign, objective: str) -> dict[str, Any]:
    """A run designed to determine the tyre parameters, as JSON.

    The objective is the geometric mean of the ratios of the standard errors before and after.
    """
    known = design.known and design.shrunk(design.known)
    return {
        **design_json(design.tuned, objective, known, design.shrunk(design.after)),
        "information": {"sd_before": design.before, "sd_after": design.after},
    }
