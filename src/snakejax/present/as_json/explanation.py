"""An explanation and a diagnosis as JSON, and the candidates as CSV."""

import csv
import io
from collections.abc import Mapping

from snakejax.diagnosis.explanation import Explanation, PoseError, Remainder, TriedCandidate
from snakejax.diagnosis.latent_force.missing_force import RunForce
from snakejax.diagnosis.residuals.horizon import horizon_errors
from snakejax.diagnosis.selection.steps import CandidateScore, SelectionStep
from snakejax.estimation.uncertainty import Estimate
from snakejax.recording.run import Case, Noise

from .provenance import constraint_kind, heading_json, model_kind, vehicle_json
from .values import (
    EXPRESSION,
    Json,
    all_parameters_json,
    clean,
    effects_json,
    estimate_json,
    misfit_json,
    parameters_json,
    rmse_json,
    runs_json,
)


def diagnosis_json(
    case: Case, noise: Noise, base: SelectionStep, provenance: Json, seconds: Json | None = None
) -> Json:
    """The result of `snakejax diagnose`: the base model and its candidates."""
    return clean(
        {
            **heading_json(case.name, base.model, noise, provenance),
            "base": {
                "parameters": parameters_json(_tyre(base)),
                "effects": _effects(base),
                "misfit": misfit_json(base.train, base.heldout),
                "rmse": rmse_json(base.train, base.heldout),
                "converged": base.converged,
            },
            "runs": runs_json(base.runs),
            "ranking": [ranked_json(row) for row in base.ranking],
            "left_out": [{"effect": name, "why": why} for name, why in base.left_out.items()],
            "seconds": seconds,
        }
    )


def explanation_json(explanation: Explanation, provenance: Json, seconds: Json | None = None) -> Json:
    """The result of `snakejax explain`."""
    final = explanation.final
    result = {
        **diagnosis_json(explanation.case, explanation.noise, explanation.base, provenance),
        "steps": [step_json(step) for step in explanation.steps[1:]],
        "verdict": explanation.verdict,
        "effects": list(explanation.effects),
        "final": {
            **fitted_json(final),
            "misfit": misfit_json(final.train, final.heldout),
            "rmse": rmse_json(final.train, final.heldout),
            "runs": runs_json(final.runs),
            "converged": final.converged,
            "after": after_json(final),
            "confidence": explanation.confidence,
            "share": explanation.share,
            "explained_share": explanation.explained_share,
            "floor": _error_json(explanation.floor),
            "remainder": _remainder_json(explanation.remainder),
            "constants": _named(explanation.constants),
            "constants_share": explanation.constants_share,
        },
        "candidates": [row._asdict() for row in explanation.candidates],
        "bands": [{"run": b.run, "role": b.role, "inside": b.inside} for b in explanation.bands],
        "odd_runs": [odd._asdict() for odd in explanation.odd_runs],
        "unexplained": unexplained_json(explanation)
        if explanation.verdict == "unexplained" or explanation.law
        else None,
        "seconds": seconds,
    }
    return clean(result)


def _error_json(error: PoseError | None) -> Json | None:
    return None if error is None else error._asdict()


def _remainder_json(rest: Remainder | None) -> Json | None:
    """The error above the floor, the share of each variable in it, and laws among which these runs cannot choose."""
    if rest is None:
        return None
    depends_on = [{"variable": variable, "share": share} for variable, share in rest.depends_on]
    errors = {"position_m": rest.position_m, "heading_rad": rest.heading_rad}
    return errors | {"depends_on": depends_on, "laws": list(rest.laws)}


def unexplained_json(explanation: Explanation) -> Json:
    """What no known effect explains: the remaining misfit, partial effects, the missing force with its dependence, and
    effects significant beside it."""
    missing = explanation.missing or explanation.law
    return {
        "misfit": misfit_json(explanation.final.train, explanation.final.heldout),
        "partial": list(explanation.partial),
        "beside": {effect: _named(estimates) for effect, estimates in coexisting_effects(explanation).items()},
        "force": None if missing is None else [_force_json(run) for run in missing.runs],
        "depends_on": None
        if missing is None
        else [{"variable": variable, "share": share} for variable, share in missing.depends_on],
    }


def coexisting_effects(explanation: Explanation) -> dict[str, dict[str, Estimate]]:
    """{effect: {parameter: estimate}} of the effects that remain significant beside the missing force."""
    if explanation.missing is None:
        return {}
    known = explanation.missing.estimates
    parts = {effect: f"effects.{effect}." for effect in explanation.missing.beside}
    return {e: {n.removeprefix(p): known[n] for n in known if n.startswith(p)} for e, p in parts.items()}


def _named(estimates: Mapping[str, Estimate]) -> Json:
    return {name: estimate_json(estimate) for name, estimate in estimates.items()}


def _force_json(run: RunForce) -> Json:
    columns = {name: run.force[:, k].tolist() for k, name in enumerate("XYN")}
    sd = {f"sd_{name}": run.sd[:, k].tolist() for k, name in enumerate("XYN")}
    return {"run": run.run, "t": run.t.tolist(), **columns, **sd}


def _tyre(step: SelectionStep) -> dict[str, Json]:
    parts = all_parameters_json(step.model, step.estimates)
    return {name: part for name, part in parts.items() if name.startswith("tyre.")}


def _effects(step: SelectionStep) -> Json:
    """{effect: {parameter: estimate or fixed value}} of all effects in the model."""
    parts = effects_json(all_parameters_json(step.model, step.estimates), step.model)
    return {effect: parts.get(effect, {}) for effect in step.effects}


def fitted_json(step: SelectionStep) -> Json:
    """The model of a step with its values."""
    return {
        "model": model_kind(step.model),
        "skid": constraint_kind(step.model),
        "vehicle": vehicle_json(step.model),
        "parameters": parameters_json(_tyre(step)),
        "effects": _effects(step),
    }


def step_json(step: SelectionStep) -> Json:
    """One step of the loop."""
    fitted = fitted_json(step)
    return {
        step.change: step.name,
        "estimate": {n: part for n, part in fitted["effects"].get(step.name, {}).items() if n != EXPRESSION},
        "misfit": misfit_json(step.train, step.heldout),
        "rmse": rmse_json(step.train, step.heldout),
        "converged": step.converged,
        "after": after_json(step),
        "ranking": [ranked_json(row) for row in step.ranking],
        "fitted": fitted,
    }


def candidates_csv(explanation: Explanation) -> str:
    """The table of all candidates as CSV, a row for each candidate beside each step."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(TriedCandidate._fields)
    for row in explanation.candidates:
        writer.writerow([*row[:-1], " ".join(row.instead_of)])
    return file.getvalue()


def after_json(step: SelectionStep) -> Json:
    """{role: {seconds: error}}: how far a simulation is off so long after a known pose."""
    return {
        role: {
            f"{error.seconds:g}": {"position_m": error.position_m, "heading_rad": error.heading_rad}
            for error in horizon_errors(step.fitted, role)
        }
        for role in ("train", "heldout")
    }


def ranked_json(row: CandidateScore) -> Json:
    """One candidate; `estimate` is the value expected at the base, `refit_estimate` that of its refit."""
    return {
        "effect": row.effect,
        "p_value": row.p_value,
        "statistic": row.statistic,
        "predicted_misfit": row.predicted_misfit,
        "misfit_without": row.misfit_without,
        "refit_misfit": row.refit_misfit,
        "converged": row.converged,
        "estimate": _named(row.estimate),
        "refit_estimate": None if row.refit_estimate is None else _named(row.refit_estimate),
        "refit_failed": row.failed,
        "confusable_with": list(row.confusable_with),
        "detectable": row.detectable,
    }
