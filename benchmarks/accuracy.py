"""How often the diagnosis is right on synthetic boards: with each effect at five strengths, and without any.

    python benchmarks/accuracy.py PART [RESULTS]         PART: null, ranking, loop, strong, pairs, strangers,
                                                         unusual, natural, further, arena, workshop,
                                                         mixed, exhaustive, table

Each part writes its results line by line into RESULTS (default benchmarks/accuracy.jsonl), and continues there after
a stop. `table` prints the summary, which is kept in benchmarks/accuracy.txt.

null        400 boards without an effect, the whole loop.
ranking     every effect at 5 strengths under both structures, 20 noise samples each. The sensitivities are those of the
            mean recording and serve all noise samples; each sample is scored on its own.
loop        the whole loop on a hundred of these boards, 20 of each strength.
strong      the whole loop on every effect at a size that occurs in practice, under both structures.
pairs       the whole loop on 24 pairs of effects at such sizes, every fourth time with a wrong structure as well, in
            runs like those of a motion capture: five train runs and two held-out runs of 12 s each.
strangers   the same with an effect that is in no library.
unusual     the same with one of a form that was unknown to those who wrote the search for laws.
natural     the same with one that may act on a board in a laboratory, unknown to them too.
further     the same with twelve more of that kind.
arena       the same with ten more, written after forms of law had been added for those.
workshop    the same with eight more, written after that.
mixed       the same with such an effect and a known one together; the report must name the known one with the force.
exhaustive  twenty of the hundred with all candidates refitted, as the reference.

Strengths are multiples of the smallest value that the runs reveal with power 0.8, as the diagnosis of the board without
the effect states it.
"""

import functools
import json
import math
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from snakejax import prepare_jax

prepare_jax()

import arena_laws  # noqa: E402
import boards  # noqa: E402
import equinox as eqx  # noqa: E402
import further_laws  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import natural_laws  # noqa: E402
import numpy as np  # noqa: E402
import unusual_laws  # noqa: E402
import workshop_laws  # noqa: E402

from snakejax import Case, Explanation  # noqa: E402
from snakejax.core.parameter import parameters  # noqa: E402
from snakejax.diagnosis import explain  # noqa: E402
from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet  # noqa: E402
from snakejax.diagnosis.selection.criteria import CRITERIA  # noqa: E402
from snakejax.diagnosis.selection.refit import refit  # noqa: E402
from snakejax.diagnosis.selection.score_test import ScoreTest, confusable, tested  # noqa: E402
from snakejax.diagnosis.selection.screening import screen_candidates, window_sensitivities  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.estimation.initial_model import starting_model  # noqa: E402
from snakejax.estimation.sensitivity import Sensitivities  # noqa: E402

CANDIDATES = {name: kind() for name, kind in LIBRARY.items()}
STRENGTHS = (0.5, 0.75, 1.0, 1.5, 2.5)
SIZES = {
    "longitudinal_slip": 0.5,
    "rolling_resistance": 0.2,
    "body_drag": 0.5,
    "quadratic_drag": 5.0,
    "yaw_damping": 0.03,
    "yaw_friction": 0.01,
    "yaw_bias": 0.01,
    "ground_slope": 0.003,
    "steering_offset": 0.02,
    "steering_crab": 0.02,
    "steering_lag": 0.04,
    "rotor_lag": 0.04,
    "steering_gain": 0.05,
    "rotor_gain": 0.05,
    "steering_backlash": 0.03,
    "grip_split": 0.2,
    "com_offset": 0.015,
    "tyre_relaxation": 0.04,
    "tyre_offset": 0.01,
    "stribeck_grip": 0.3,
    "grip_gradient": 0.2,
    "marker_offset": 0.01,
    "heading_offset": 0.02,
    "clock_offset": 0.05,
}
"""Values of the first parameter of each effect, in its unit."""
DRAWS, BOARDS, YARDSTICK = 20, 400, 20


class Results:
    """What was found, a line each, and kept at once."""

    def __init__(self, path: Path):
        self.path = path
        self.lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def of(self, part: str) -> list[dict[str, Any]]:
        return [line for line in self.lines if line["part"] == part]

    def once(self, part: str, key: str, work: Callable[[], dict[str, Any]]) -> None:
        """Do `work` unless its result is there."""
        if any(line["key"] == key for line in self.of(part)):
            return
        line = {"part": part, "key": key, **work()}
        self.lines.append(line)
        with self.path.open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line), flush=True)


def effects_of(constraint: str) -> list[str]:
    """The effects that can act under a structure and that one number describes."""
    model = boards.make(0, constraint).model
    return [
        n
        for n, e in CANDIDATES.items()
        if not e.inapplicable_because(model) and not (n == "grip_split" and constraint == "coupled")
    ]


def cells() -> Iterator[tuple[int, str, str, float]]:
    """(board, structure, effect, strength) of the whole ranking study."""
    for constraint in boards.STRUCTURES:
        for k, name in enumerate(effects_of(constraint)):
            for strength in STRENGTHS:
                yield 1000 + k, constraint, name, strength


def settled(case: Case, made: boards.Made) -> tuple[CandidateSet, CandidateFit]:
    """The bench of a recording without noise, and its base fit, which the true tyre is near."""
    bench = CandidateSet.of(starting_model(case), case, boards.NOISE, CANDIDATES)
    known = {name: float(parameters(made.model)[name].value) for name in bench.tyre}
    return bench, CandidateFit((), refit(bench, (), {**bench.problem.values(), **known}))


def seen(bench: CandidateSet, step: CandidateFit) -> Sensitivities:
    """Every candidate beside the base."""
    return window_sensitivities(bench, step.solution.values, step.solution.start, windows=False)


def scored(
    bench: CandidateSet, step: CandidateFit, view: Sensitivities, seed: list[int] | None = None
) -> list[ScoreTest]:
    """The candidates beside the base, under the noise of `seed`."""
    if seed is not None:
        present = np.asarray(bench.problem.batch.weight) > 0
        noise = present * np.random.default_rng(seed).normal(size=present.shape)
        batch = view.problem.batch
        sd = np.where(present, 1 / np.where(present, np.asarray(batch.weight), 1.0), 0.0)
        problem = eqx.tree_at(lambda s: s.batch.pose, view.problem, batch.pose + noise * sd)
        linearised = view.linearised._replace(residual=view.linearised.residual + noise)
        view = view._replace(problem=problem, linearised=linearised)
    fitted = [name for name in bench.tyre if name not in step.solution.held]
    return tested(view, fitted, bench.candidates, bench.probes()).scores


def size_of(bench: CandidateSet, step: CandidateFit, name: str) -> float:
    """The smallest value of an effect's first parameter that the runs reveal."""
    here = next((s for s in scored(bench, step, seen(bench, step)) if s.effect == name), None)
    if here is None:
        return np.inf
    return here.detectable[bench.candidates[name][0]]


def with_effect(name: str, value: float) -> Any:
    """The effect with its first parameter at `value`."""
    first = next(iter(parameters(CANDIDATES[name])))
    return eqx.tree_at(lambda e: getattr(e, first), CANDIDATES[name], jnp.asarray(value))


def null(results: Results) -> None:
    for seed in range(BOARDS):
        constraint = boards.STRUCTURES[seed % 2]

        def work(seed=seed, constraint=constraint) -> dict[str, Any]:
            case = boards.case(boards.make(seed, constraint), seed)
            begin = time.perf_counter()
            found = explain(case, boards.NOISE, CANDIDATES)
            return {
                "skid": constraint,
                "verdict": found.verdict,
                "effects": found.effects,
                "p": min(r.p_value for r in found.base.ranking if r.p_value is not None),
                "train": found.final.train.misfit,
                "heldout": found.final.heldout.misfit if found.final.heldout else None,
                "seconds": time.perf_counter() - begin,
            }

        results.once("null", str(seed), work)


def ranking(results: Results) -> None:
    for board, constraint, name, strength in cells():

        def work(board=board, constraint=constraint, name=name, strength=strength) -> dict[str, Any]:
            made = boards.make(board, constraint)
            value = strength * size_of(*settled(boards.case(made), made), name)
            if not np.isfinite(value):
                return {"skid": constraint, "effect": name, "strength": strength, "value": None}
            bench, step = settled(boards.case(made, **{name: with_effect(name, value)}), made)
            view = seen(bench, step)
            right = wrong = silent = 0
            for seed in range(DRAWS):
                ranked = scored(bench, step, view, [board, seed])
                first, alike = ranked[0], confusable(ranked)
                if first.p_value >= CRITERIA.significance_level:
                    silent += 1
                elif first.effect == name or name in alike[first.effect]:
                    right += 1
                else:
                    wrong += 1
            counts = {"right": right, "wrong": wrong, "silent": silent}
            return {"skid": constraint, "effect": name, "strength": strength, "value": value, **counts}

        results.once("ranking", f"{constraint} {name} {strength}", work)


def hundred() -> Iterator[tuple[int, str, str, float]]:
    """(board, structure, effect, strength): twenty effects at each strength, the structures in turn."""
    for k, strength in enumerate(STRENGTHS):
        for place in range(20):
            constraint = boards.STRUCTURES[(k + place) % 2]
            names = effects_of(constraint)
            yield 2000 + 20 * k + place, constraint, names[(place + 4 * k) % len(names)], strength


def recorded(board: int, constraint: str, name: str, strength: float) -> tuple[Case, float]:
    """The recording of one of the hundred, and the value of its effect: where none is detectable, one of `SIZES`."""
    made = boards.make(board, constraint)
    size = size_of(*settled(boards.case(made), made), name)
    value = strength * (size if np.isfinite(size) else SIZES[name])
    return boards.case(made, board, **{name: with_effect(name, value)}), value


def answered(case: Case) -> tuple[Explanation, dict[str, Any]]:
    """What the whole loop makes of a recording, and what is kept of it."""
    begin = time.perf_counter()
    found = explain(case, boards.NOISE, CANDIDATES)
    return found, {
        "verdict": found.verdict,
        "effects": found.effects,
        "estimate": {n: [e.value, e.sd] for n, e in found.final.estimates.items()},
        "misfit": [found.base.train.misfit, found.final.train.misfit],
        "heldout": [stage.heldout.misfit if stage.heldout else None for stage in (found.base, found.final)],
        "seconds": time.perf_counter() - begin,
    }


def explained(case: Case, constraint: str, name: str, value: float) -> dict[str, Any]:
    """What the whole loop makes of a recording with one effect."""
    found, kept = answered(case)
    mine = next((r for r in found.base.ranking if r.effect == name), None)
    alike = {r.effect: r.confusable_with for r in found.base.ranking}
    right = len(found.effects) == 1 and (name in found.effects or name in alike[found.effects[0]])
    predicted, refitted = mine and mine.predicted_misfit, mine and mine.refit_misfit
    truth = {"skid": constraint, "effect": name, "value": value}
    return {**truth, **kept, "right": right, "predicted": predicted, "refitted": refitted}


def strong(results: Results) -> None:
    for constraint in boards.STRUCTURES:
        for k, name in enumerate(effects_of(constraint)):

            def work(k=k, constraint=constraint, name=name) -> dict[str, Any]:
                effect = with_effect(name, SIZES[name])
                return explained(
                    boards.case(boards.make(3000 + k, constraint), 3000 + k, **{name: effect}),
                    constraint,
                    name,
                    SIZES[name],
                )

            results.once("strong", f"{constraint} {name}", work)


def loop(results: Results) -> None:
    for board, constraint, name, strength in hundred():

        def work(board=board, constraint=constraint, name=name, strength=strength) -> dict[str, Any]:
            case, value = recorded(board, constraint, name, strength)
            return {"strength": strength, **explained(case, constraint, name, value)}

        results.once("loop", f"{constraint} {name} {strength}", work)


def couples() -> Iterator[tuple[int, str, str, dict[str, float]]]:
    """(board, structure, structure as declared, value by effect) of each pair."""
    for k in range(24):
        rng = np.random.default_rng([k, 77])
        constraint = boards.STRUCTURES[k % 2]
        names = [n for n in effects_of(constraint) if n != "grip_split"]
        one, other = rng.choice(len(names), 2, replace=False)
        sizes = {names[j]: SIZES[names[j]] * rng.uniform(0.6, 1.5) for j in (one, other)}
        yield 4000 + k, constraint, "coupled" if k % 4 == 0 else constraint, sizes


def all_found(found: Explanation, wanted: tuple[str, ...]) -> bool:
    """Whether a recording is explained by the effects that were `wanted`, or others that it cannot tell from them."""
    alike = {r.effect: r.confusable_with for r in found.final.ranking or found.base.ranking}
    same = [any(f == w or w in alike.get(f, ()) for f in found.effects) for w in wanted]
    return len(found.effects) == len(wanted) and all(same) and found.verdict == "explained"


def pairs(results: Results) -> None:
    for board, constraint, declared, sizes in couples():

        def work(board=board, constraint=constraint, declared=declared, sizes=sizes) -> dict[str, Any]:
            made = boards.make_long(board, constraint)
            effects = {name: with_effect(name, value) for name, value in sizes.items()}
            switched = ("lateral_skid",) if declared != constraint else ()
            tyre = {name: float(value.value) for name, value in parameters(made.model.tyre).items()}
            truth = {"skid": constraint, "declared": declared, "values": sizes, "tyre": tyre}
            found, kept = answered(boards.case(made, board, declared, **effects))
            return {**truth, **kept, "right": all_found(found, (*switched, *sizes))}

        results.once("pairs", str(board), work)


def lacking(found: Explanation) -> tuple[tuple[str, float], ...]:
    """The first two variables on which the missing force depends, with their shares; its law may have been found."""
    force = found.missing or found.law
    return force.depends_on[:2] if force else ()


def stranger(number: int, constraint: str, name: str, effect: Any, variable: str) -> dict[str, Any]:
    """The whole loop on the board of a `number` with an effect that no library holds."""
    found, kept = answered(boards.case(boards.make_long(number, constraint), number, **{name: effect}))
    depends, laws = lacking(found), [law.expression for law in found.named_laws.values()]
    named = found.verdict == "unexplained" or bool(laws)
    right = named and bool(depends) and depends[0][0] == variable
    truth = {"skid": constraint, "effect": name, "variable": variable}
    return {**truth, **kept, "depends_on": depends, "laws": laws, "right": right}


def strangers(results: Results) -> None:
    for k, (name, (effect, variable)) in enumerate({**boards.STRANGERS, **boards.MORE_STRANGERS}.items()):
        for constraint in boards.STRUCTURES:
            work = functools.partial(stranger, 5000 + k, constraint, name, effect, variable)
            results.once("strangers", f"{constraint} {name}", work)


def unusual(results: Results) -> None:
    _other_strangers(results, "unusual", 9000, unusual_laws.UNUSUAL)


def natural(results: Results) -> None:
    _other_strangers(results, "natural", 9100, natural_laws.NATURAL)


def further(results: Results) -> None:
    _other_strangers(results, "further", 9200, further_laws.FURTHER)


def arena(results: Results) -> None:
    _other_strangers(results, "arena", 9400, arena_laws.ARENA)


def workshop(results: Results) -> None:
    _other_strangers(results, "workshop", 9400, workshop_laws.WORKSHOP)


def _other_strangers(results: Results, part: str, first: int, effects: dict[str, tuple[Any, str]]) -> None:
    """One board for each of the `effects`, numbered from `first` on, in turns of each structure."""
    for k, (name, (effect, variable)) in enumerate(effects.items()):
        constraint = boards.STRUCTURES[k % 2]
        work = functools.partial(stranger, first + k, constraint, name, effect, variable)
        results.once(part, f"{constraint} {name}", work)


MIXED = {
    "spring": "rolling_resistance",
    "compass": "steering_lag",
    "warming": "steering_offset",
    "steering_drag": "ground_slope",
    "rotor_shake": "longitudinal_slip",
    "cable": "tyre_relaxation",
    "patch": "yaw_friction",
    "carpet": "heading_offset",
}
"""A known effect beside each of some strangers."""


def mixed(results: Results) -> None:
    for k, (name, other) in enumerate(MIXED.items()):

        def work(k=k, name=name, other=other) -> dict[str, Any]:
            effect, variable = boards.STRANGERS[name]
            constraint = boards.STRUCTURES[k % 2]
            made = boards.make_long(7000 + k, constraint)
            both = {name: effect, other: with_effect(other, SIZES[other])}
            found, kept = answered(boards.case(made, 7000 + k, **both))
            depends = lacking(found)
            named = tuple(effect for effect in found.effects if effect not in found.named_laws) == (other,)
            right = named and bool(depends) and depends[0][0] == variable
            truth = {
                "skid": constraint,
                "effect": name,
                "variable": variable,
                "known": other,
                "value": SIZES[other],
            }
            return {**truth, **kept, "depends_on": depends, "right": right}

        results.once("mixed", name, work)


def exhaustive(results: Results) -> None:
    for board, constraint, name, strength in list(hundred())[-YARDSTICK:]:

        def work(board=board, constraint=constraint, name=name, strength=strength) -> dict[str, Any]:
            case, _ = recorded(board, constraint, name, strength)
            bench = CandidateSet.of(starting_model(case), case, boards.NOISE, CANDIDATES)
            step = CandidateFit((), refit(bench, (), bench.problem.values(), near=False))
            begin = time.perf_counter()
            ranked = screen_candidates(bench, step)
            ours = time.perf_counter() - begin
            begin = time.perf_counter()
            misfits = {}
            for candidate, parts in bench.candidates.items():
                again = refit(bench, (candidate,), step.solution.values)
                misfits[candidate] = again.misfit * again.samples + 2 * len(parts)
            theirs = time.perf_counter() - begin
            return {
                "effect": name,
                "first": ranked[0].score.effect,
                "exhaustive": min(misfits, key=lambda n: misfits[n]),
                "seconds": [ours, theirs],
            }

        results.once("exhaustive", f"{constraint} {name} {strength}", work)


def table(results: Results) -> None:
    """Print what was found."""
    for part, wanted in (("null", BOARDS), ("ranking", len([*cells()])), ("loop", 100), ("exhaustive", YARDSTICK)):
        if len(results.of(part)) < wanted:
            print(f"Not complete: {len(results.of(part))} of {wanted} of `{part}`")
    if lines := results.of("null"):
        called = [line for line in lines if line["verdict"] != "adequate"]
        print(f"\nBoards without an effect: {len(called)} of {len(lines)} called anything but adequate")
        for line in called:
            print(f"  board {line['key']} ({line['skid']}): {line['verdict']} {', '.join(line['effects'])}")
        ps = np.array([line["p"] for line in lines])
        shares = ", ".join(f"{level:g}: {100 * (ps < level).mean():.1f} %" for level in (0.01, 0.05, 0.2, 0.5))
        print(f"  share of boards whose smallest family-wise p-value is below {shares}")
        print(_median(lines))
    if lines := results.of("ranking"):
        _ranking_table([line for line in lines if line["value"] is not None])
        blind = sorted({f"{line['effect']} ({line['skid']})" for line in lines if line["value"] is None})
        if blind:
            print(f"  Not to be seen on its board at any size: {', '.join(blind)}")
        print()
    if lines := results.of("loop"):
        _loop_table(lines)
    if lines := results.of("strong"):
        _strong_table(lines)
    if lines := results.of("pairs"):
        _pairs_table(lines)
    if lines := results.of("strangers"):
        _strangers_table("Effects that no library holds", lines)
    if lines := results.of("unusual"):
        _strangers_table("Effects of unusual forms", lines)
    if lines := results.of("natural"):
        _strangers_table("Effects that may act in a laboratory", lines)
    if lines := results.of("further"):
        _strangers_table("More effects that may act in a laboratory", lines)
    if lines := results.of("arena"):
        _strangers_table("Ten more, written after forms had been added for those", lines)
    if lines := results.of("workshop"):
        _strangers_table("Eight more, written after that", lines)
    if lines := results.of("mixed"):
        _mixed_table(lines)
    if lines := results.of("exhaustive"):
        print(f"Against refitting every candidate (AIC), {len(lines)} of the hundred")
        for what, name in (("first", "score"), ("exhaustive", "refits")):
            print(f"  {name}: first is the true effect on {sum(line[what] == line['effect'] for line in lines)}")
        ratio = statistics.median(line["seconds"][1] / line["seconds"][0] for line in lines)
        medians = [statistics.median(line["seconds"][k] for line in lines) for k in range(2)]
        print(f"  {medians[0]:.2f} s against {medians[1]:.2f} s, ratio {ratio:.0f} (median)")


def _ranking_table(lines: list[dict[str, Any]]) -> None:
    print("Ranking: share of 20 draws with the true effect first and significant / another / none, by strength in")
    print("multiples of the smallest detectable value (power 0.8)")
    print(f"  {'effect':20} {'':8}" + "".join(f"{strength:>14g}" for strength in STRENGTHS))
    rows: dict[tuple[str, str], dict[float, dict[str, Any]]] = {}
    for line in lines:
        rows.setdefault((line["effect"], line["skid"]), {})[line["strength"]] = line

    def cell(mine: list[dict[str, Any]]) -> str:
        total = sum(line[k] for line in mine for k in ("right", "wrong", "silent"))
        parts = (sum(line[k] for line in mine) / total for k in ("right", "wrong", "silent"))
        return "/".join(f"{100 * part:.0f}" for part in parts) if total else "-"

    for (effect, constraint), mine in sorted(rows.items()):
        print(
            f"  {effect:20} {constraint:8}" + "".join(f"{cell([mine[s]] if s in mine else []):>14}" for s in STRENGTHS)
        )
    whole = [cell([line for line in lines if line["strength"] == s]) for s in STRENGTHS]
    print(f"  {'all':29}" + "".join(f"{text:>14}" for text in whole))


def _strong_table(lines: list[dict[str, Any]]) -> None:
    print(
        f"Every effect at a size one would meet, the whole loop: {sum(line['right'] for line in lines)} of {len(lines)}"
    )
    print(f"  {'effect':20} {'':8} {'value':>8} {'found':>20} {'misfit':>20} {'held out':>20}")
    for line in lines:
        estimate = next((e for n, e in line["estimate"].items() if n.split(".")[1] == line["effect"]), None)
        found = "-" if estimate is None else f"{estimate[0]:.4g} +- {estimate[1] or math.nan:.1g}"
        fall, unseen = _falls(line)
        wrong = "" if line["right"] else f"  {_called(line)}"
        print(f"  {line['effect']:20} {line['skid']:8} {line['value']:8g} {found:>20} {fall:>20} {unseen:>20}{wrong}")
    print(_median(lines))


def _called(line: dict[str, Any]) -> str:
    return f"{line['verdict']} {', '.join(line['effects'])}"


def _falls(line: dict[str, Any]) -> list[str]:
    """How train and held-out misfits fell."""
    return [" -> ".join(f"{misfit:.4g}" for misfit in line[key]) for key in ("misfit", "heldout")]


def _median(lines: list[dict[str, Any]]) -> str:
    return f"  median {statistics.median(line['seconds'] for line in lines):.1f} s a board\n"


def _pairs_table(lines: list[dict[str, Any]]) -> None:
    print(f"Pairs of effects, 12 s runs, the whole loop: {sum(line['right'] for line in lines)} of {len(lines)}")
    for line in lines:
        switched = "lateral_skid, " if line["declared"] != line["skid"] else ""
        parts = ", ".join(f"{name} {value:.3g}" for name, value in line["values"].items())
        away = []
        truth = line["values"] | {f"tyre.{name}": value for name, value in line["tyre"].items()}
        for name, value in truth.items():
            mine = [e for n, e in line["estimate"].items() if n == name or n.startswith(f"effects.{name}.")]
            if mine and mine[0][1]:
                away.append(f"{(mine[0][0] - value) / mine[0][1]:+.1f}")
        wrong = "" if line["right"] else f"  {_called(line)}"
        falls = ", ".join(_falls(line))
        print(f"  {line['skid']:8}{switched}{parts}: {falls}, standard errors away {' '.join(away)}{wrong}")
    print(_median(lines))


def _strangers_table(what: str, lines: list[dict[str, Any]]) -> None:
    print(f"{what}, the whole loop: {sum(line['right'] for line in lines)} of {len(lines)}")
    for line in lines:
        depends = ", ".join(f"{name} {share:.2f}" for name, share in line["depends_on"] or ())
        wrong = "" if line["right"] else f"  ({line['variable']})"
        said = ", ".join([_called(line), *_falls(line), f"depends on {depends}"])
        print(f"  {line['effect']:15}{line['skid']:8} {said}{wrong}")
    print(_median(lines))


def _mixed_table(lines: list[dict[str, Any]]) -> None:
    right = sum(line["right"] for line in lines)
    print(f"One of them and a known effect together, the whole loop: {right} of {len(lines)}")
    for line in lines:
        depends = ", ".join(f"{name} {share:.2f}" for name, share in line["depends_on"] or ())
        wrong = "" if line["right"] else f"  ({line['known']}, {line['variable']})"
        found = line["estimate"]
        values = [found[n] for e in line["effects"] for n in found if n.startswith(f"effects.{e}.")]
        sizes = " ".join(f"{value:.4g} +- {sd:.1g}" for value, sd in values)
        said = ", ".join([_called(line), sizes, f"depends on {depends}"])
        print(f"  {line['effect']:14}{line['skid']:8} {line['known']} {line['value']:g}: {said}{wrong}")
    print(_median(lines))


def _loop_table(lines: list[dict[str, Any]]) -> None:
    print(f"The whole loop on {len(lines)} of these boards: right / called adequate / wrong, by strength")
    for strength in STRENGTHS:
        mine = [line for line in lines if line["strength"] == strength]
        right = sum(line["right"] for line in mine)
        silent = sum(line["verdict"] == "adequate" for line in mine)
        print(f"  {strength:4g}: {right} / {silent} / {len(mine) - right - silent} of {len(mine)}")
    for line in lines:
        if line["verdict"] != "adequate" and not line["right"]:
            print(
                f"  {line['effect']} ({line['skid']}, {line['strength']:g}): {_called(line)}, misfit {line['misfit']}"
            )
    both = [line for line in lines if line["refitted"] is not None and line["predicted"] is not None]
    if both:
        away = [line["predicted"] - line["refitted"] for line in both]
        print(
            f"  predicted less refitted misfit of the true effect, {len(both)} boards: median {np.median(away):+.4f},"
        )
        print(f"  90 % between {np.quantile(away, 0.05):+.4f} and {np.quantile(away, 0.95):+.4f}")
    print(_median(lines))


PARTS = {
    part.__name__: part
    for part in (
        null,
        ranking,
        loop,
        strong,
        pairs,
        strangers,
        unusual,
        natural,
        further,
        arena,
        workshop,
        mixed,
        exhaustive,
        table,
    )
}

if __name__ == "__main__":
    where = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).with_name("accuracy.jsonl")
    PARTS[sys.argv[1]](Results(where))
