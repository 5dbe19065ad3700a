"""An explanation that was made up, for reports and figures: nothing of it was fitted but the small case's tyre."""

from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from small import small

from snakejax import Model
from snakejax._explain import Explanation
from snakejax._missing import Missing, RunForce
from snakejax._palette import look
from snakejax._played import Played, played_fit, stage_label
from snakejax._provenance import provenance_json
from snakejax._rank import Ranked
from snakejax._results import fit_json
from snakejax._score import Scored
from snakejax._story import ranked_json, unexplained_json
from snakejax._units import parameters
from snakejax.effects import LIBRARY

MISFITS = (("base", "", 4.2e4, 1.3e5), ("added", "ground_slope", 312.0, 417.0), ("added", "rotor_gain", 7.04, 9.5))
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
def story() -> Explanation:
    """Two effects helped, and a force is missing."""
    case, noise, _ = small()
    effects = {name: effect() for name, effect in LIBRARY.items()}
    model = Model(case.board, small()[2].model.tyre, "free", effects)
    names = {e: [n for n in parameters(model) if n.startswith(f"effects.{e}.")] for e in effects}
    bench = SimpleNamespace(study=SimpleNamespace(model=model), candidates=names, left_out={"grip_split": "One slip."})
    ranking = tuple(_ranked(names.get(effect, []), effect, *rest) for effect, *rest in CANDIDATES)
    stages = tuple(
        SimpleNamespace(
            change=change,
            name=name,
            bench=bench,
            ranking=ranking,
            effects=tuple(made[1] for made in MISFITS[1 : k + 1]),
            train=SimpleNamespace(misfit=train),
            heldout=SimpleNamespace(misfit=heldout),
        )
        for k, (change, name, train, heldout) in enumerate(MISFITS)
    )
    found = {"case": case, "noise": noise, "stages": stages, "base": stages[0], "final": stages[-1], "effects": ()}
    found |= {"verdict": "unexplained", "partial": stages[-1].effects, "missing": _missing()}
    return cast(Explanation, SimpleNamespace(**found))


def _ranked(names: list[str], effect: str, p: float | None, predicted, refitted, twins: tuple[str, ...]) -> Ranked:
    values = {name: 6.857e-8 * 10.0 ** (2 * k) for k, name in enumerate(names)}
    sd = {name: 1.4 * value for name, value in values.items()}
    seen = {name: 0.12345 * value for name, value in values.items()}
    none = np.zeros(0)
    score = None if p is None else Scored(effect, values, sd, 10.0, 10.0, p, seen, none, none)
    refit = None if refitted is None else SimpleNamespace(values=values, misfit=refitted)
    return Ranked(effect, score, predicted, cast(Any, refit), twins)


def _missing() -> Missing:
    """A force along the board that grows with the place, one across that is hardly known, and no moment."""
    t = np.linspace(0.0, 3.99, 40)
    force = np.stack([0.006 * t, 0.2 * np.sin(5 * t), 0 * t], axis=1)
    sd = np.stack([0.001 + 0 * t, 0.15 + 0.05 * np.cos(3 * t), np.nan * t], axis=1)
    shares = (("rotor_rate", 0.824), ("gait_phase", 0.565), ("world_position", 0.222))
    shape = cast(Any, SimpleNamespace(variable="rotor_rate"))
    return Missing((RunForce("here", t, force, sd),), shares, shape, (12.0, 1.0), {}, False)


def models() -> list[Played]:
    """The models of its steps, alike but for their looks."""
    base = played_fit(small()[2])
    steps = enumerate(story().stages)
    return [
        base._replace(key=str(k), label=stage_label(s.effects), look=look(s.effects[-1] if k else "")) for k, s in steps
    ]


def result() -> dict[str, Any]:
    """What the command would write of it."""
    case, noise, fitted = small()
    found = story()
    made = fit_json(case, noise, fitted, provenance_json(0, {}, {}))
    rmse = {"train": {"position_m": 0.0123, "heading_rad": 1.0004e-3}, "heldout": None}
    parts = [{"misfit": {"train": s.train.misfit, "heldout": s.heldout.misfit}, "rmse": rmse} for s in found.stages]
    made["base"] = {**made["base"], **parts[0]}
    steps = [{s.change: s.name, **part} for s, part in zip(found.stages[1:], parts[1:], strict=True)]
    final = {"parameters": made["base"]["parameters"], "effects": {}, "runs": made["runs"], **parts[-1]}
    made |= {"ranking": [ranked_json(one, found.base) for one in found.base.ranking], "steps": steps, "final": final}
    made |= {"left_out": [{"effect": "grip_split", "why": "One slip."}], "effects": []}
    return {**made, "verdict": found.verdict, "unexplained": unexplained_json(found)}
