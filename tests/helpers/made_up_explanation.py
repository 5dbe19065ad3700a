"""An explanation that was made up, for reports and figures: nothing of it was fitted but the small case's tyre."""

import dataclasses
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from helpers.small_case import small
from snakejax import Model
from snakejax.core.parameter import parameters
from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.latent_force.missing_force import LatentForce, RunForce
from snakejax.diagnosis.selection.steps import SWITCH_DESCRIPTION, CandidateScore, SelectionStep
from snakejax.dynamics.ports import Delay, Sensor
from snakejax.effects import LIBRARY
from snakejax.estimation.goodness_of_fit import Score
from snakejax.estimation.uncertainty import Estimate
from snakejax.present.as_json.explanation import explanation_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.style import step_style
from snakejax.present.views import ModelView, doubt, step_label, view_of_fit

STEPS = (
    ("base", "", Score(4.2e4, 0.0123, 1.0004e-3, 1200), Score(1.3e5, 0.0217, 2.11e-3, 1200)),
    ("added", "ground_slope", Score(312.0, 0.00106, 8.6e-4, 1200), Score(417.0, 0.00123, 1.02e-3, 1200)),
    ("added", "rotor_gain", Score(7.04, 1.6e-4, 1.3e-4, 1200), Score(9.5, 1.9e-4, 1.1e-4, 1200)),
)
CANDIDATES = (
    ("lateral_skid", None, None, 312.0, ()),
    ("ground_slope", 1e-310, 5.4, 340.0, ()),
    ("quadratic_drag", 3e-40, 9.4, 2.1e4, ("longitudinal_slip", "body_drag")),
    ("body_drag", 2e-9, 9.8, None, ("quadratic_drag",)),
    ("longitudinal_slip", 0.004, 9.7, None, ("quadratic_drag",)),
    ("steering_lag", 0.3, 10.4, None, ()),
    ("rotor_lag", 1.0, 10.5, None, ()),
)
"""Effect, p, predicted and refitted misfit, and what it cannot be told from."""


@cache
def story(stopped: tuple[str, ...] = (), verdict: str = "unexplained") -> Explanation:
    """Two effects helped, and a force is missing.

    The fits of the steps in `stopped` ("base" or the effect added), and the refits of the candidates there, were given
    up on their way. With another `verdict` the same is told of a story that ends well.
    """
    case, noise, found = small()
    names = {effect: parts for effect, parts in _names().items() if effect in [c[0] for c in CANDIDATES] + _added()}
    ranking = tuple(_ranked(stopped, names.get(effect, ()), effect, *rest) for effect, *rest in CANDIDATES)
    estimates = found.estimates | {n: Estimate(1e-3, 2e-5, "rad", True) for parts in names.values() for n in parts}
    left_out, steps = {"grip_split": "One slip."}, []
    for k, (change, name, train, heldout) in enumerate(STEPS):
        added = tuple(_added()[:k])
        model = _model().without(*(effect for effect in LIBRARY if effect not in added))
        steps.append(
            SelectionStep(
                change=change,
                name=name,
                effects=added,
                fitted=dataclasses.replace(found.fitted, model=model),
                train=train,
                heldout=heldout,
                runs=(*found.runs, *found.heldout),
                estimates={n: e for n, e in estimates.items() if n.split(".")[1] in ("D", *added)},
                converged=(name or change) not in stopped,
                ranking=ranking,
                left_out=left_out,
            )
        )
    lacks = verdict == "unexplained"
    ends = ((), tuple(_added()), _missing()) if lacks else (tuple(_added()), (), None)
    effects, partial, missing = ends
    return Explanation(case, noise, tuple(steps), verdict, effects, partial, left_out, missing)


def _added() -> list[str]:
    return [name for _, name, _, _ in STEPS[1:]]


def _names() -> dict[str, tuple[str, ...]]:
    model = _model()
    return {e: tuple(n for n in parameters(model) if n.startswith(f"effects.{e}.")) for e in model.effects}


@cache
def _model() -> Model:
    case, _, fitted = small()
    return Model(case.board, fitted.model.tyre, "free", {name: effect() for name, effect in LIBRARY.items()})


def _ranked(
    stopped: tuple[str, ...], names: tuple[str, ...], effect: str, p: float | None, predicted, refitted, twins
) -> CandidateScore:
    """With values of several sizes, each known to 140 %."""
    values = {name.rsplit(".", 1)[-1]: 6.857e-8 * 10.0 ** (2 * k) for k, name in enumerate(names)}
    known, acting = parameters(_model()), _model().effects.get(effect)
    expected = {
        short: Estimate(value, 1.4 * value, known[name].domain.unit, True)
        for name, (short, value) in zip(names, values.items(), strict=True)
    }
    return CandidateScore(
        effect,
        SWITCH_DESCRIPTION if acting is None else acting.description,
        p,
        None if p is None else 10.0,
        predicted,
        refitted,
        {} if p is None else expected,
        None,
        {} if p is None else {name: 0.12345 * value for name, value in values.items()},
        twins,
        converged=None if refitted is None else effect not in stopped,
        of_measurement=isinstance(acting, Sensor | Delay),
    )


def _missing() -> LatentForce:
    """A force along the board that grows with the place, one across that is hardly known, and no moment."""
    t = np.linspace(0.0, 3.99, 40)
    force = np.stack([0.006 * t, 0.2 * np.sin(5 * t), 0 * t], axis=1)
    sd = np.stack([0.001 + 0 * t, 0.15 + 0.05 * np.cos(3 * t), np.nan * t], axis=1)
    shares = (("rotor_rate", 0.824), ("gait_phase", 0.565), ("world_position", 0.222))
    shape = cast(Any, SimpleNamespace(variable="rotor_rate"))
    return LatentForce((RunForce("here", t, force, sd),), shares, shape, (12.0, 1.0), {}, False)


def models(found: Explanation | None = None) -> list[ModelView]:
    """The models of its steps, alike but for their looks."""
    base = view_of_fit(small()[2])
    labels = [step_label(s.effects) + doubt(s.converged) for s in (found or story()).steps]
    return [base._replace(key=str(k), label=label, look=step_style(k)) for k, label in enumerate(labels)]


def result(found: Explanation | None = None) -> dict[str, Any]:
    """What the command would write of it."""
    return explanation_json(found or story(), provenance_json(0, {}, {}))
