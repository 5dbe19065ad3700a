"""How the verdicts depend on the selection criteria: each criterion is halved and doubled, all else as it is.

    python benchmarks/criteria.py [RESULTS.jsonl]

The boards are made up (`boards.py`, 6 s runs, three to train on): without an effect, with one effect at the
detectable size, with one strong effect, with two effects, and with a force that no library holds; under both
structures each. What is told is the verdict, the effects and, where it is unexplained, the variable named first. The
table has, for each criterion, the boards of which something else is told than with the criteria as they are, and
whether it became right or wrong. A board whose explanation never reads a criterion is told the same whatever its
value, and is not explained again. Results are kept: run the command again to compute the rest, or to print the table.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from snakejax import prepare_jax

prepare_jax()

import boards  # noqa: E402
from accuracy import CANDIDATES, SIZES, Results, recorded, with_effect  # noqa: E402

from snakejax import Case  # noqa: E402
from snakejax.diagnosis import explain  # noqa: E402
from snakejax.diagnosis.selection.criteria import CRITERIA, SelectionCriteria  # noqa: E402

VARIED = (
    "significance_level",
    "wald_per_parameter",
    "confusable_cosine",
    "distinct_chi2",
    "linear_misfit",
    "far_misfit",
    "explained_windows_misfit",
    "least_excess_share",
    "further_excess_ratio",
    "candidate_excess_ratio",
    "smallest_excess",
    "random_force_chi2",
    "largest_random_force",
    "least_inside",
    "coexisting_excess_ratio",
    "least_force_share",
    "force_excess_sd",
)
"""The criteria that decide what is told; the others set the width and the accuracy of the search."""
FACTORS = (0.5, 2.0)


class Watched(SelectionCriteria):
    """Criteria that keep the names of those that are read, in `READ`."""

    def __getattribute__(self, name: str) -> Any:
        if name in SelectionCriteria._fields:
            READ.add(name)
        return super().__getattribute__(name)


READ: set[str] = set()
"""The criteria that were read since it was last emptied."""


class Truth(NamedTuple):
    """What is hidden in a board: effects of the library, or the variable of a force that it lacks."""

    case: Case
    effects: tuple[str, ...]
    variable: str | None = None


def made_up() -> Iterator[tuple[str, Callable[[], Truth]]]:
    """Name and maker of each board."""
    for k, structure in enumerate(boards.STRUCTURES):
        made = boards.make(6000 + k, structure)

        def one(name: str, strength: float, seed: int, structure=structure) -> Truth:
            return Truth(recorded(seed, structure, name, strength)[0], (name,))

        def case(effects: dict[str, Any], hidden: tuple[str, ...], variable=None, made=made, seed=6000 + k) -> Truth:
            return Truth(boards.case(made, seed, **effects), hidden, variable)

        weak, strong = (("yaw_damping", "steering_lag"), ("rotor_gain", "rolling_resistance"))[k]
        pair = (("steering_offset", "yaw_friction"), ("rotor_lag", "body_drag"))[k]
        stranger = ("spring", "compass")[k]
        both = {name: with_effect(name, SIZES[name]) for name in pair}
        force, variable = boards.STRANGERS[stranger]
        yield f"{structure}, no effect", lambda case=case: case({}, ())
        yield f"{structure}, weak {weak}", lambda one=one, n=weak, k=k: one(n, 1.0, 6010 + k)
        yield f"{structure}, strong {strong}", lambda one=one, n=strong, k=k: one(n, 10.0, 6020 + k)
        yield f"{structure}, {' and '.join(pair)}", lambda case=case, e=both, p=pair: case(e, p)
        yield f"{structure}, {stranger}", lambda case=case, e={stranger: force}, v=variable: case(e, (), v)


def changed(name: str, factor: float) -> float:
    """The criterion times `factor`; a cosine by its distance to 1, a misfit by its excess over 1."""
    value = getattr(CRITERIA, name)
    if name == "confusable_cosine":
        return 1 - (1 - value) * factor
    if name.endswith("misfit"):
        return 1 + (value - 1) * factor
    return value * factor


def told(truth: Truth, **criteria: float) -> dict[str, Any]:
    """What `explain` tells of a board, and whether it is right."""
    READ.clear()
    explanation = explain(truth.case, boards.NOISE, CANDIDATES, criteria=Watched(*CRITERIA._replace(**criteria)))
    missing = explanation.missing or explanation.law
    variable = missing.depends_on[0][0] if missing and missing.depends_on else None
    alike = {r.effect: r.confusable_with for r in explanation.final.ranking or explanation.base.ranking}
    found = all(any(e == f or e in alike.get(f, ()) for f in explanation.effects) for e in truth.effects)
    known = [effect for effect in explanation.effects if effect not in explanation.named_laws]
    verdict = "unexplained" if truth.variable else "explained" if truth.effects else "adequate"
    as_it_is = explanation.verdict == verdict or bool(truth.variable and explanation.named_laws)
    right = as_it_is and found and len(known) == len(truth.effects)
    return {
        "verdict": explanation.verdict,
        "effects": list(explanation.effects),
        "variable": variable,
        "right": right and variable == truth.variable,
        "read": sorted(READ),
    }


def table(results: Results) -> None:
    """Print what changed."""
    usual = {line["board"]: line for line in results.of("usual")}
    print(f"{len(usual)} boards, {sum(line['right'] for line in usual.values())} right with the criteria as they are")
    print(f"{'criterion':<26} {'from':>8} {'to':>8} {'told otherwise':>15} {'now wrong':>10} {'now right':>10}")
    for name in VARIED:
        for factor in FACTORS:
            lines = [r for r in results.of("varied") if r["criterion"] == name and r["factor"] == factor]
            lines += [line for line in usual.values() if name not in line["read"]]
            other = [r for r in lines if said(r) != said(usual[r["board"]])]
            wrong = sum(usual[r["board"]]["right"] and not r["right"] for r in lines)
            right = sum(r["right"] and not usual[r["board"]]["right"] for r in lines)
            values = f"{getattr(CRITERIA, name):8.4g} {changed(name, factor):8.4g}"
            print(f"{name:<26} {values} {f'{len(other)} of {len(lines)}':>15} {wrong:>10} {right:>10}")
            for line in other:
                print(f"    {line['board']}: {said(usual[line['board']])} -> {said(line)}")


def said(line: dict[str, Any]) -> str:
    """Verdict, effects and variable in words."""
    return " ".join([line["verdict"], *sorted(line["effects"]), *filter(None, [line["variable"]])])


def main(path: str = "benchmarks/criteria.jsonl") -> None:
    """Compute what is not there yet, and print the table."""
    results = Results(Path(path))
    makers = dict(made_up())
    made: dict[str, Truth] = {}

    def explained(board: str, **criteria: float) -> dict[str, Any]:
        made[board] = made.get(board) or makers[board]()
        return {"board": board, **told(made[board], **criteria)}

    for board in makers:
        results.once("usual", board, lambda board=board: explained(board))
    read = {line["board"]: line["read"] for line in results.of("usual")}
    for name in VARIED:
        for factor in FACTORS:
            for board in makers:
                if name not in read[board]:
                    continue
                how = {"criterion": name, "factor": factor, name: changed(name, factor)}
                work = lambda b=board, h=how, n=name: {**explained(b, **{n: h[n]}), **h}  # noqa: E731
                results.once("varied", f"{name} {factor:g} {board}", work)
    table(results)


if __name__ == "__main__":
    main(*sys.argv[1:])
