"""An explanation as JSON, and as what a terminal shows of it."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from ._approach import arrived
from ._bench import LATERAL_SKID, NEARLY
from ._effect import Clock, Sensor
from ._estimates import Estimate
from ._explain import Explanation
from ._json import Json, clean, estimate_json, misfit_json, parameters_json, rmse_json, runs_json
from ._missing import RunForce
from ._provenance import heading_json, model_kind, skid_kind
from ._rank import Ranked
from ._recording import Case, Noise
from ._score import ALPHA
from ._stage import Stage
from ._text import add_row, misfit_text, number, plain_table
from ._units import parameters

CLOSE = 0.9
"""A variable that predicts so large a share of what the best one does may as well be the cause."""


def diagnosis_json(case: Case, noise: Noise, base: Stage, provenance: Json, seconds: Json | None = None) -> Json:
    """The result of `snakejax diagnose`: what an explanation says of the base."""
    return clean(
        {
            **heading_json(case.name, base.bench.study.model, noise, provenance),
            "base": {
                "parameters": parameters_json(_tyre(base)),
                "misfit": misfit_json(base.train, base.heldout),
                "rmse": rmse_json(base.train, base.heldout),
            },
            "runs": runs_json(base.runs),
            "ranking": [ranked_json(r, base) for r in base.ranking],
            "left_out": [{"effect": name, "why": why} for name, why in base.left_out.items()],
            "seconds": seconds,
        }
    )


def explanation_json(found: Explanation, provenance: Json, seconds: Json | None = None) -> Json:
    """The result of `snakejax explain`."""
    final = found.final
    result = {
        **diagnosis_json(found.case, found.noise, found.base, provenance),
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
            "converged": arrived(final.bench.study, final.step.optimum, final.bench.train),
        },
        "unexplained": unexplained_json(found) if found.verdict == "unexplained" else None,
        "seconds": seconds,
    }
    return clean(result)


def unexplained_json(found: Explanation) -> Json:
    """What is left, which effects helped, the missing force with what it depends on, and what survives beside it."""
    missing = found.missing
    return {
        "misfit": misfit_json(found.final.train, found.final.heldout),
        "partial": list(found.partial),
        "beside": {effect: _named(estimates) for effect, estimates in beside(found).items()},
        "force": None if missing is None else [_force_json(run) for run in missing.runs],
        "depends_on": None
        if missing is None
        else [{"variable": variable, "share": share} for variable, share in missing.depends_on],
    }


def beside(found: Explanation) -> dict[str, dict[str, Estimate]]:
    """{effect: {parameter: estimate}} of what survives beside the missing force, as the free force leaves it open."""
    if found.missing is None:
        return {}
    known = found.missing.estimates
    parts = {effect: f"effects.{effect}." for effect in found.missing.beside}
    return {e: {n.removeprefix(p): known[n] for n in known if n.startswith(p)} for e, p in parts.items()}


def _named(estimates: Mapping[str, Estimate]) -> Json:
    return {name: estimate_json(estimate) for name, estimate in estimates.items()}


def _force_json(run: RunForce) -> Json:
    columns = {name: run.force[:, k].tolist() for k, name in enumerate("XYN")}
    sd = {f"sd_{name}": run.sd[:, k].tolist() for k, name in enumerate("XYN")}
    return {"run": run.run, "t": run.t.tolist(), **columns, **sd}


def _tyre(stage: Stage) -> dict[str, Json]:
    return _named({name: e for name, e in stage.estimates.items() if not name.startswith("effects.")})


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
    for effect in found.partial if found.verdict == "unexplained" else found.effects:
        lines.append(Text(f"{effect}: {sentence(effect, found.final)} {_values(_of(effect, found.final))}"))
    lines += [Text(line) for line in _twins(found.base, found.effects)]
    last = found.final
    if found.verdict != "unexplained" and not arrived(last.bench.study, last.step.optimum, last.bench.train):
        lines.append(Text("! The last fit did not converge: its values are less sure than their errors say."))
    if found.missing is not None:
        lines += [Text(""), _dependence(found)]
    lines += [Text(""), _suspects(found.base)]
    return Group(*lines)


def _dependence(found: Explanation) -> RenderableType:
    """How large the missing force is, and what it depends on."""
    missing = found.missing
    assert missing is not None
    force = np.concatenate([run.force[:, [0, 2]] for run in missing.runs])
    push, turn = np.sqrt(np.nanmean(force**2, axis=0))
    table = plain_table("the missing force depends on", "share", right=("share",))
    for variable, share in missing.depends_on[:4]:
        add_row(table, variable, f"{100 * share:.0f} %")
    size = f"The missing force is {number(push)} N along the board and {number(turn)} N m in yaw (root mean square)."
    if missing.switched:
        size += (
            " It is counted beside wheelsets that skid freely, where one cause leaves less than beside coupled ones."
        )
    survivors = [
        Text(f"Beside it survives {effect}: {sentence(effect, found.final)} {_values(estimates)}")
        for effect, estimates in beside(found).items()
    ]
    if missing.shape is None:
        return Group(*survivors, Text(size), Text("It depends on nothing that these runs could tell."))
    (first, best), *others = missing.depends_on
    close = [variable for variable, share in others if share > CLOSE * best]
    if close:
        size += f" These runs can hardly tell {first} from {' or '.join(close)}; runs with another gait may."
    advice = "With --out DIR, DIR/missing_force.py is an effect of this form to start one of your own from."
    return Group(*survivors, Text(size), table, Text(advice))


def diagnosis_text(case: Case, base: Stage) -> RenderableType:
    """The base misfit and the candidates, the confusable ones named."""
    held = "" if base.heldout is None else f", on held-out runs {misfit_text(base.heldout.misfit)}"
    head = f"{case.name}: the base leaves a misfit of {misfit_text(base.train.misfit)}{held} (1 is noise)."
    lines: list[RenderableType] = [Text(head), Text(""), _suspects(base, len(base.ranking), detectable=True)]
    sure = [r.effect for r in base.ranking if r.score is not None and r.score.p_value < ALPHA]
    if not sure:
        lines.append(Text(f"No candidate is significant at {ALPHA:g}, corrected for their number."))
    lines += [Text(line) for line in (*_twins(base, sure), *_left_out(base))]
    return Group(*lines)


def _twins(stage: Stage, effects: Sequence[str]) -> Iterator[str]:
    """Which of `effects` these runs cannot tell from others, and where a fault of the measurement is among those."""
    told: set[frozenset[str]] = set()
    known = stage.bench.study.model.effects
    for ranked in stage.ranking:
        group = frozenset((ranked.effect, *ranked.confusable_with))
        if ranked.effect not in effects or len(group) < 2 or group in told:
            continue
        told.add(group)
        text = f"These runs cannot tell {ranked.effect} from {_list(ranked.confusable_with, 'or')}."
        faults = sorted(name for name in group if isinstance(known.get(name), Sensor | Clock))
        if faults and len(faults) < len(group):
            text += f" ({', '.join(faults)}: a fault of the measurement, not of the board.)"
        yield text


def _left_out(stage: Stage) -> Iterator[str]:
    for name, why in stage.left_out.items():
        yield f"Left out: {name}: {why.rstrip('.')}."


def _of(effect: str, stage: Stage) -> Mapping[str, Estimate]:
    return {n.rsplit(".", 1)[-1]: stage.estimates[n] for n in stage.bench.candidates.get(effect, ())}


def _values(estimates: Mapping[str, Estimate]) -> str:
    parts = [f"{name} = {number(e.value, e.sd)} +- {number(e.sd, e.sd)}{_unit(e)}" for name, e in estimates.items()]
    return ", ".join(parts)


def _unit(estimate: Estimate) -> str:
    return "" if estimate.unit == "-" else f" {estimate.unit}"


def _list(names: Sequence[str], word: str = "and") -> str:
    *others, last = names
    return f"{', '.join(others)} {word} {last}" if others else last


def headline(found: Explanation) -> str:
    """The verdict in one sentence."""
    base, final = found.base, found.final
    if found.verdict == "adequate":
        return f"{found.case.name}: adequate. The base model leaves only noise (misfit {base.train.misfit:.3f})."
    unseen = "" if final.heldout is None else f", on held-out runs {misfit_text(final.heldout.misfit)}"
    fall = f"the misfit falls from {misfit_text(base.train.misfit)} to {misfit_text(final.train.misfit)}{unseen}"
    if found.verdict == "explained":
        return f"{found.case.name}: explained by {_list(found.effects)}; {fall} (1 is noise)."
    lacking = "Nothing known leaves only noise."
    if found.effects:
        lacking = f"Beside {_list(found.effects)} acts a force that nothing known explains."
    helped = f" {_list(found.final.effects)} helped: {fall}." if found.final.effects else ""
    return f"{found.case.name}: unexplained. {lacking}{helped}"


def _suspects(stage: Stage, most: int = 6, detectable: bool = False) -> RenderableType:
    """The first `most` candidates; `detectable` adds the smallest values that these runs would reveal.

    Near the noise the linear model predicts the misfit of whole runs, else what is left of short windows.
    """
    titles = ("p", "predicts" if stage.train.misfit < NEARLY else "on windows", "refit")
    table = plain_table("candidate", *titles, "expected", *["reveals"] * detectable, right=(*titles, "reveals"))
    for ranked in stage.ranking[:most]:
        p_value = "" if ranked.score is None else f"{ranked.score.p_value:.1g}" if ranked.score.p_value else "< 1e-300"
        first = p_value, misfit_text(ranked.predicted_misfit), misfit_text(ranked.refit_misfit)
        smallest = {} if ranked.score is None else ranked.score.detectable
        rows = expected(ranked, stage) or {"": None}
        for place, (name, estimate) in enumerate(rows.items()):
            words = "" if estimate is None else f"{estimate.value:.2g} +- {estimate.sd:.1g}{_unit(estimate)}"
            reveals = [f"{smallest[f'effects.{ranked.effect}.{name}']:.2g}" if name else ""] * detectable
            label = f"{ranked.effect}.{name}".rstrip(".")
            add_row(table, label, *(first if place == 0 else ("",) * 3), words, *reveals)
    return table
