"""How the verdicts depend on the selection criteria: each criterion is halved and doubled, all else as it is.

    python benchmarks/criteria.py [RESULTS.jsonl]

The boards are made up (`boards.py`, 6 s runs, three to train on): without an effect, with one effect at the
detectable size, with one strong effect, with two effects, and with a force that no library holds; under both
structures each. What is told is the verdict, the effects and, where it is unexplained, the variable named first. The
table has, for each criterion, the boards of which something else is told than with the criteria as they are, and
whether it became right or wrong. A board is explained again with another value only where some comparison of its
explanation would end otherwise by it, or where the value entered a computation: else it is told the same (`Threshold`).
Results are kept: run the command again to compute the rest, or to print the table.
"""

import operator
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from snakejax import prepare_jax

prepare_jax()

import boards  # noqa: E402
import numpy as np  # noqa: E402
from accuracy import CANDIDATES, SIZES, Results, recorded, with_effect  # noqa: E402

from snakejax import Case  # noqa: E402
from snakejax.diagnosis import explain  # noqa: E402
from snakejax.diagnosis.selection.criteria import CRITERIA  # noqa: E402

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


class Threshold:
    """A criterion with its other values: it notes in `DECISIVE` each by which a comparison would end otherwise.

    Sums, products and powers of it are computed for all values. Where one becomes a plain number, what follows is not
    known, and all its other values count as decisive.
    """

    __array_ufunc__ = None
    __hash__ = object.__hash__

    def __init__(self, value: Any, others: Mapping[str, Any]):
        self.value, self.others = value, others

    def _with(self, operation: Callable[[Any, Any], Any], other: Any, swapped: bool = False) -> "Threshold":
        keys = {*self.others, *(other.others if isinstance(other, Threshold) else ())}

        def at(key: str | None) -> Any:
            pair = [one.others.get(key, one.value) if isinstance(one, Threshold) else one for one in (self, other)]
            return operation(*(reversed(pair) if swapped else pair))

        return Threshold(at(None), {key: at(key) for key in keys})

    def _compared(self, operation: Callable[[Any, Any], Any], other: Any) -> Any:
        found = self._with(operation, other)
        DECISIVE.update(key for key, value in found.others.items() if np.any(value != found.value))
        return found.value

    def _escaped(self) -> Any:
        DECISIVE.update(self.others)
        return self.value

    def __float__(self) -> float:
        return float(self._escaped())

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.asarray(self._escaped(), dtype)


def _arithmetic(operation: Callable[[Any, Any], Any], swapped: bool) -> Callable[[Threshold, Any], Threshold]:
    return lambda self, other: self._with(operation, other, swapped)


def _comparison(operation: Callable[[Any, Any], Any]) -> Callable[[Threshold, Any], Any]:
    return lambda self, other: self._compared(operation, other)


for _name in ("add", "sub", "mul", "truediv", "pow"):
    setattr(Threshold, f"__{_name}__", _arithmetic(getattr(operator, _name), False))
    setattr(Threshold, f"__r{_name}__", _arithmetic(getattr(operator, _name), True))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Threshold, f"__{_name}__", _comparison(getattr(operator, _name)))

DECISIVE: set[str] = set()
"""Criterion and factor, as `key` writes them, that change a comparison since it was last emptied."""


def key(name: str, factor: float) -> str:
    """A criterion and a factor in one word."""
    return f"{name} {factor:g}"


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


def threshold(name: str) -> Any:
    """The criterion with its other values."""
    return Threshold(getattr(CRITERIA, name), {key(name, factor): changed(name, factor) for factor in FACTORS})


def told(truth: Truth, **criteria: float) -> dict[str, Any]:
    """What `explain` tells of a board, and whether it is right."""
    DECISIVE.clear()
    watched = CRITERIA._replace(**({name: threshold(name) for name in VARIED} | criteria))
    explanation = explain(truth.case, boards.NOISE, CANDIDATES, criteria=watched)
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
        "decisive": sorted(DECISIVE),
    }


def table(results: Results) -> None:
    """Print what changed."""
    usual = {line["board"]: line for line in results.of("usual")}
    print(f"{len(usual)} boards, {sum(line['right'] for line in usual.values())} right with the criteria as they are")
    print(f"{'criterion':<26} {'from':>8} {'to':>8} {'told otherwise':>15} {'now wrong':>10} {'now right':>10}")
    for name in VARIED:
        for factor in FACTORS:
            lines = [r for r in results.of("varied") if r["criterion"] == name and r["factor"] == factor]
            lines += [line for line in usual.values() if key(name, factor) not in line["decisive"]]
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
    decisive = {line["board"]: line["decisive"] for line in results.of("usual")}
    for name in VARIED:
        for factor in FACTORS:
            for board in makers:
                if key(name, factor) not in decisive[board]:
                    continue
                how = {"criterion": name, "factor": factor, name: changed(name, factor)}
                work = lambda b=board, h=how, n=name: {**explained(b, **{n: h[n]}), **h}  # noqa: E731
                results.once("varied", f"{key(name, factor)} {board}", work)
    table(results)


if __name__ == "__main__":
    main(*sys.argv[1:])
