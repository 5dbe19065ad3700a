"""An explanation as JSON, and as what a terminal shows of it."""

from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.text import Text

from ._diagnose import LATERAL_SKID, Ranked
from ._explain import Explanation, Stage
from ._fit import Estimate
from ._json import (
    Json,
    clean,
    estimate_json,
    heading_json,
    misfit_json,
    model_kind,
    parameters_json,
    rmse_json,
    runs_json,
    skid_kind,
)
from ._text import add_row, misfit_text, number, plain_table
from ._units import parameters


def explanation_json(found: Explanation, provenance: Json, seconds: Json | None = None) -> Json:
    """The result of `snakejax explain`."""
    base, final = found.base, found.final
    model = base.bench.study.model
    result = {
        **heading_json(found.case.name, model, found.noise, provenance),
        "base": {
            "parameters": parameters_json(_tyre(base)),
            "misfit": misfit_json(base.train, base.heldout),
            "rmse": rmse_json(base.train, base.heldout),
        },
        "runs": runs_json(base.runs),
        "ranking": [ranked_json(r, base) for r in base.ranking],
        "left_out": [{"effect": name, "why": why} for name, why in found.left_out.items()],
        "steps": [step_json(stage) for stage in found.stages[1:]],
        "verdict": found.verdict,
        "effects": list(found.effects),
        "final": {
            "model": model_kind(final.bench.study.model),
            "skid": skid_kind(final.bench.study.model),
            "parameters": parameters_json(_tyre(final)),
            "effects": _effects(final),
            "misfit": misfit_json(final.train, final.heldout),
            "rmse": rmse_json(final.train, final.heldout),
            "runs": runs_json(final.runs),
        },
        "unexplained": None,
        "seconds": seconds,
    }
    if found.verdict == "unexplained":
        left = misfit_json(final.train, final.heldout)
        result["unexplained"] = {"misfit": left, "partial": list(found.partial), "force": None, "depends_on": None}
    return clean(result)


def _tyre(stage: Stage) -> dict[str, Json]:
    return {name: estimate_json(e) for name, e in stage.estimates.items() if not name.startswith("effects.")}


def _effects(stage: Stage) -> Json:
    """{effect: {parameter: estimate}} of all effects in the model."""
    return {
        effect: {
            name.rsplit(".", 1)[-1]: estimate_json(stage.estimates[name])
            for name in stage.bench.candidates.get(effect, ())
        }
        for effect in stage.effects
    }


def step_json(stage: Stage) -> Json:
    """One step of the loop."""
    return {
        stage.change: stage.name,
        "estimate": _effects(stage).get(stage.name, {}),
        "misfit": misfit_json(stage.train, stage.heldout),
        "rmse": rmse_json(stage.train, stage.heldout),
        "ranking": [ranked_json(r, stage) for r in stage.ranking],
    }


def ranked_json(ranked: Ranked, stage: Stage) -> Json:
    """One candidate; its estimate is that of the refit where there is one."""
    score = ranked.score
    return {
        "effect": ranked.effect,
        "p_value": score and score.p_value,
        "statistic": score and score.statistic,
        "predicted_misfit": ranked.predicted_misfit,
        "refit_misfit": ranked.refit_misfit,
        "estimate": {name: estimate_json(e) for name, e in expected(ranked, stage).items()},
        "confusable_with": list(ranked.confusable_with),
        "detectable": {n.rsplit(".", 1)[-1]: v for n, v in score.detectable.items()} if score else {},
    }


def expected(ranked: Ranked, stage: Stage) -> dict[str, Estimate]:
    """The expected values of a candidate's parameters, refitted where it was among the best."""
    if ranked.score is None:
        return {}
    units = {name: p.domain.unit for name, p in parameters(stage.bench.study.model).items()}
    values = ranked.refit.values if ranked.refit is not None else ranked.score.values
    return {
        name.rsplit(".", 1)[-1]: Estimate(values[name], ranked.score.sd[name], units[name], True)
        for name in ranked.score.values
    }


def sentence(effect: str, stage: Stage) -> str:
    """What an effect is, in words."""
    if effect == LATERAL_SKID:
        return "Each wheelset skids on its own."
    return stage.bench.study.model.effects[effect].sentence


def explanation_text(found: Explanation) -> RenderableType:
    """The verdict, what was missing and how sure that is, the error falling, and who else was suspected."""
    table = plain_table("step", "misfit", "held out", "position", "heading", right=("misfit", "held out", "position"))
    for stage in found.stages:
        held = stage.heldout
        add_row(
            table,
            f"{stage.change} {stage.name}".strip(),
            misfit_text(stage.train.misfit),
            misfit_text(held.misfit if held else None),
            f"{number(1000 * stage.train.position_m)} mm",
            f"{number(1000 * stage.train.heading_rad)} mrad",
        )
    lines: list[RenderableType] = [Text(headline(found)), Text(""), table]
    for effect in found.effects or found.partial:
        lines.append(Text(f"{effect}: {sentence(effect, found.final)} {_values(_of(effect, found.final))}"))
    lines += [Text(""), _suspects(found.base)]
    return Group(*lines)


def _of(effect: str, stage: Stage) -> Mapping[str, Estimate]:
    return {n.rsplit(".", 1)[-1]: stage.estimates[n] for n in stage.bench.candidates.get(effect, ())}


def _values(estimates: Mapping[str, Estimate]) -> str:
    parts = [f"{name} = {number(e.value, e.sd)} +- {number(e.sd, e.sd)} {e.unit}" for name, e in estimates.items()]
    return ", ".join(parts)


def headline(found: Explanation) -> str:
    """The verdict in one sentence."""
    base, final = found.base, found.final
    if found.verdict == "adequate":
        return f"{found.case.name}: adequate. The base model leaves only noise (misfit {base.train.misfit:.3f})."
    unseen = "" if final.heldout is None else f", on held-out runs {misfit_text(final.heldout.misfit)}"
    fall = f"the misfit falls from {misfit_text(base.train.misfit)} to {misfit_text(final.train.misfit)}{unseen}"
    if found.verdict == "explained":
        return f"{found.case.name}: explained by {' and '.join(found.effects)}; {fall} (1 is noise)."
    helped = f" {' and '.join(found.partial)} helped: {fall}." if found.partial else ""
    return f"{found.case.name}: unexplained. Nothing known leaves only noise.{helped}"


def _suspects(stage: Stage) -> RenderableType:
    table = plain_table("candidate at the base", "p", "predicted", "refitted", right=("p", "predicted", "refitted"))
    for ranked in stage.ranking[:6]:
        p_value = "" if ranked.score is None else f"{ranked.score.p_value:.1g}"
        add_row(table, ranked.effect, p_value, misfit_text(ranked.predicted_misfit), misfit_text(ranked.refit_misfit))
    return table
