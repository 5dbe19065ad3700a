"""A sparse search for the law of a free force: every form of the grammar is fitted on the windows of some runs and
tested on those of the other runs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from snakejax.core.formula import names_in, parsed
from snakejax.core.parallel import in_threads
from snakejax.dynamics.law import LawParameter
from snakejax.estimation.goodness_of_fit import largest_noise_misfit

from .grammar import families
from .regression import (
    FEWEST_CHI2,
    PENALTIES,
    Trial,
    form_at,
    named,
    on_grids,
    pruned,
    refined,
    with_positive_amplitude,
)
from .smooth_forms import smooth_floors, smooth_of_one, smooth_of_two
from .terms import BACK, BODY_ACTION, FRONT, Family
from .units import unit_text
from .windows import ForceWindows

REFINED = 60
"""So many forms have the parameters of their shape refined."""
NEAREST = 20
"""So many others beside a random force, those that are nearest to all runs."""
KEPT = 6
"""The largest number of proposed laws."""
SMOOTH = 3
"""The largest number of smooth functions among them, each of other variables or another action."""
SMOOTH_SHARE = 0.5
"""A smooth function explains nothing and has many parameters. It is proposed where it leaves less than this share of
what the best formula leaves above the noise."""
ALIKE = 1.0
"""Laws whose chi^2 on runs left out differs by less are alike: the likelihoods have a ratio of exp(1 / 2)."""
ONE_AXLE = (FRONT.name, BACK.name)
"""The actions on the grip of one axle."""
WIDER = (2.0, 4.0)
"""Multiples of the width of a form from which a fit to whole runs begins anew."""
GENERAL = {
    **{"x": "world_position", "y": "world_position", "u": "speed", "w": "speed", "theta": "heading"},
    **{"slip_speed": "slip", "slip_angle": "slip", "turn_rate": "steering_rate"},
    **{"wheel_x": "world_position", "wheel_y": "world_position", "rolling_speed": "speed"},
}
"""How results name a variable of the grammar, where they do not name it as the grammar does."""
UNNAMED = ("r",)


class ProposedLaw(NamedTuple):
    """A law that the windows propose: `expression` with `parameters`, its default values those found.

    `left_out`: the misfit that it leaves on runs it was not fitted to; `score`: chi^2 there and what its parameters and
    the choice among all forms cost; `steps` (P,): how the other parameters move with it; `share`: of what is above the
    noise there without a law, the part that it takes away; `forms`: of so many forms it is the best.
    """

    expression: str
    parameters: tuple[LawParameter, ...]
    values: dict[str, float]
    family: Family
    shape: np.ndarray
    left_out: float
    score: float
    steps: np.ndarray
    share: float = 1.0
    forms: int = 1

    @property
    def form(self) -> tuple[frozenset[tuple[tuple[str, str], ...]], int]:
        """Its formulas without the names of their amplitudes, and the number of parameters inside them."""
        return frozenset(term.formulas for term in self.family.terms), len(self.family.shape)

    @property
    def variables(self) -> tuple[str, ...]:
        """The variables on which it depends, as results name them; none for those that have no such name."""
        names = [name for variable in self.family.variables for name in names_in(parsed(variable))]
        return tuple(dict.fromkeys(GENERAL.get(name, name) for name in names if name not in UNNAMED))


NO_LAW = Family("nothing", "", (), ())


def search(
    windows: ForceWindows, beside: Sequence[tuple[Family, np.ndarray]] = (), most: int = KEPT
) -> tuple[ProposedLaw, ...]:
    """The laws that predict runs left out best, the best first and so many at `most`; none where no law predicts them
    better than nothing.

    Of laws that do not differ by `FEWEST_CHI2` from the best, the one with the fewest parameters is first. Where no
    formula leaves only noise there, or in windows `beside` a random force, which hides what a formula leaves, smooth
    functions are tried too, and are among the laws where they predict better; without such a force much better.
    `beside`: forms, with the values of their shape, that are in the regression whatever else is.
    """
    given = [windows.histories(family, named(family, shape[None])) for family, shape in beside]
    nothing = form_at(windows, NO_LAW, np.zeros((1, 0)), given)[0].left_out
    forms = list(families(windows.ranges(), windows.wheel, windows.places()))
    laws = _proposals(windows, _best_trials(windows, forms, given), len(forms), nothing)
    noise = largest_noise_misfit(windows.samples)
    if laws and (windows.beside or min(law.left_out for law in laws) > noise):
        limit = min(law.score - FEWEST_CHI2 * max(1.0, law.left_out) for law in laws)
        smooth = [law for law in _smooth_laws(windows, given, nothing, len(forms)) if law.score < limit]
        laws = sorted([*laws, *(smooth if windows.beside else much_better(smooth, laws))], key=lambda law: law.score)
    return tuple(_simplest_first(laws)[:most])


def smooth_laws(windows: ForceWindows) -> tuple[ProposedLaw, ...]:
    """The smooth functions that predict runs left out best, as `search` proposes them, whatever formulas do."""
    nothing = form_at(windows, NO_LAW, np.zeros((1, 0)), ())[0].left_out
    forms = sum(1 for _ in families(windows.ranges(), windows.wheel))
    return tuple(_smooth_laws(windows, (), nothing, forms))


def with_amplitudes(law: ProposedLaw, amplitudes: np.ndarray, steps: np.ndarray) -> ProposedLaw:
    """`law` with other `amplitudes` (T,) of its terms, and other `steps` of the other parameters."""
    trial = Trial(law.family, law.shape, amplitudes, steps, np.nan, law.left_out)
    return _proposed(trial, 1, law.score)._replace(share=law.share, forms=law.forms)


def much_better(smooth: Sequence[ProposedLaw], laws: Sequence[ProposedLaw]) -> list[ProposedLaw]:
    """Those of the `smooth` functions that leave less than `SMOOTH_SHARE` of the excess of every formula, `laws`."""
    least = min((law.left_out - 1 for law in laws), default=np.inf)
    return [law for law in smooth if law.left_out - 1 < SMOOTH_SHARE * least]


def finer(windows: ForceWindows, law: ProposedLaw) -> tuple[ProposedLaw, ...]:
    """The smooth functions that act as `law` does, on the same variables, through more values; fewest first."""
    same = [
        family
        for family in smooth_of_one(windows.ranges(), windows.wheel)
        if (family.name, family.action, family.variables) == (law.family.name, law.family.action, law.family.variables)
    ]
    more = [family for family in same if len(family.terms) > len(law.family.terms)]
    return tuple(_proposed(trial, windows.samples, trial.left_out) for trial in on_grids(windows, more, ()))


def wider(windows: ForceWindows, law: ProposedLaw) -> tuple[ProposedLaw, ...]:
    """`law` with its width `s` larger, `WIDER`, and amplitudes to match, where it leaves only noise in the windows too;
    none where it has no width."""
    at = [k for k, part in enumerate(law.family.shape) if part.name == "s"]
    others = []
    for times in WIDER if at else ():
        shape = law.shape.copy()
        shape[at] = np.minimum(times * shape[at], law.family.shape[at[0]].high)
        (trial,) = form_at(windows, law.family, shape[None], ())
        left_out = trial.left_out / windows.samples
        others.append(law._replace(values=_values(trial), shape=shape, steps=trial.steps, left_out=left_out))
    return tuple(law for law in others if law.left_out <= largest_noise_misfit(windows.samples))


def _best_trials(windows: ForceWindows, forms: Sequence[Family], given: Sequence[np.ndarray]) -> list[Trial]:
    """The `REFINED` best fits of `forms`, and beside a random force the `NEAREST` others, refined and without needless
    terms."""
    trials = sorted(on_grids(windows, forms, given), key=lambda trial: trial.left_out)
    first = trials[:REFINED]
    if windows.beside:
        first += sorted(trials[REFINED:], key=_expected)[:NEAREST]
    best = in_threads(lambda trial: pruned(windows, refined(windows, trial, given), given), first)
    return [with_positive_amplitude(windows, trial) for trial in best if not _is_of_one_side(trial.family)]


def _expected(trial: Trial) -> float:
    """chi^2 that runs like these leave where they are left out: that of all runs and twice the number of amplitudes
    (Akaike 1974)."""
    return trial.chi2 + 2 * len(trial.family.terms)


def _is_of_one_side(family: Family) -> bool:
    """Whether a force on the body together with a yaw moment is left with one of them: that is a form of its own."""
    return family.action == BODY_ACTION and len({component for t in family.terms for component, _ in t.formulas}) < 2


def _proposals(windows: ForceWindows, trials: Sequence[Trial], forms: int, nothing: float) -> list[ProposedLaw]:
    """The laws of `trials`, the best of so many `forms`, that predict better than `nothing`; the best first. Beside a
    random force also those that are so much nearer to all runs: whole runs judge them later."""
    laws: dict[object, ProposedLaw] = {}
    for trial in trials:
        left_out = min(trial.left_out, _expected(trial)) if windows.beside else trial.left_out
        variance = max(1.0, left_out / windows.samples)
        score = left_out + variance * chance(trial.family, forms)
        if score < nothing:
            excess = max(nothing - windows.samples, 1e-9)
            share = float(np.clip((nothing - left_out) / excess, 0.0, 1.0))
            law = _proposed(trial, windows.samples, score)._replace(share=share, forms=forms)
            # One form may come from several, of which other terms were left out.
            if law.form not in laws or score < laws[law.form].score:
                laws[law.form] = law
    return _of_all_wheels(_without_limits(sorted(laws.values(), key=lambda law: law.score), windows.samples))


def _without_limits(laws: list[ProposedLaw], samples: int) -> list[ProposedLaw]:
    """`laws` without those that do exactly as one of the same action and variables with fewer parameters does: they are
    that law, at a limit of their shape, as |v| is with a corner that is round over nothing."""

    def is_limit(law: ProposedLaw) -> bool:
        return any(
            (one.family.action, one.family.variables) == (law.family.action, law.family.variables)
            and len(one.parameters) < len(law.parameters)
            and abs(one.left_out - law.left_out) * samples < ALIKE
            for one in laws
        )

    return [law for law in laws if not is_limit(law)]


def _of_all_wheels(laws: list[ProposedLaw]) -> list[ProposedLaw]:
    """`laws` without those of the grip of one axle that do as the same form does on all wheels: where both axles slip
    alike, nothing tells them apart."""
    whole = {(law.family.name, law.family.variables): law for law in laws if law.family.action == "grip"}

    def is_alike(law: ProposedLaw) -> bool:
        other = whole.get((law.family.name, law.family.variables))
        return other is not None and abs(law.score - other.score) < ALIKE

    return [law for law in laws if law.family.action not in ONE_AXLE or not is_alike(law)]


def _smooth_laws(
    windows: ForceWindows, given: Sequence[np.ndarray], nothing: float, formulas: int
) -> list[ProposedLaw]:
    """The `SMOOTH` best smooth functions of one variable or of two, beside so many `formulas`, each of other variables
    or another action; those of two hold the variable of one of the best of one."""
    ranges, wheel = windows.ranges(), windows.wheel
    of_one = list(smooth_of_one(ranges, wheel))
    trials = _best_trials(windows, of_one, given)
    leading = list(dict.fromkeys((trial.family.action, trial.family.variables) for trial in trials))[:SMOOTH]
    pairs = [two for action, own in leading for two in smooth_of_two(ranges, wheel, action, own)]
    of_two = [*{(two.action, two.variables): two for two in pairs}.values(), *smooth_floors(ranges)]
    trials += on_grids(windows, of_two, given)
    best_of: dict[tuple[str, tuple[str, ...]], ProposedLaw] = {}
    for law in _proposals(windows, trials, formulas + len(of_one) + len(of_two), nothing):
        best_of.setdefault((law.family.action, law.family.variables), law)
    return list(best_of.values())[:SMOOTH]


def _simplest_first(ordered: list[ProposedLaw]) -> list[ProposedLaw]:
    """`ordered` by score, but for the one in front: that with the fewest parameters of all that do as well."""
    as_good = [law for law in ordered if law.score - ordered[0].score < FEWEST_CHI2]
    simplest = min(as_good, key=lambda law: len(law.parameters), default=None)
    return ordered if simplest is None else [simplest, *(law for law in ordered if law is not simplest)]


def chance(family: Family, forms: int) -> float:
    """What the best of so many `forms` gains in chi^2 on runs left out by chance, with the terms of `family`.

    chi^2 of T amplitudes exceeds its quantile at 1 - 1 / N in one of N trials, and an amplitude that fits chance costs
    1 on runs left out.
    """
    return float(stats.chi2.isf(1.0 / choices(family, forms), len(family.terms)) - len(family.terms))


def choices(family: Family, forms: int) -> int:
    """Among how many trials one of `family` is the best, of so many `forms`: each start of the shape is one, or each
    penalty."""
    return forms * (len(family.starts) if family.curvature is None else len(PENALTIES))


def _values(trial: Trial) -> dict[str, float]:
    """The amplitudes of a trial and the parameters of its shape, by name."""
    amplitudes, shape = (map(float, part) for part in (trial.amplitudes, trial.shape))
    values = dict(zip((term.amplitude for term in trial.family.terms), amplitudes, strict=True))
    return values | dict(zip((part.name for part in trial.family.shape), shape, strict=True))


def _proposed(trial: Trial, samples: int, score: float) -> ProposedLaw:
    """The law of `trial`, with its amplitudes neutral at zero."""
    family, values = trial.family, _values(trial)
    parameters = [LawParameter(term.amplitude, unit_text(term.unit)) for term in family.terms]
    expression = family.expression()
    if family.name == "spring" and abs(values["k"]) > 0:
        k = values["k"]
        values = {"k": k, "x0": values["a"] / k, "y0": values["b"] / k}
        expression = "east = k * (x0 - x); north = k * (y0 - y)"
        parameters = [parameters[0], *(LawParameter(n, "m", values[n]) for n in ("x0", "y0"))]
    for part, value in zip(family.shape, trial.shape, strict=True):
        parameters.append(LawParameter(part.name, unit_text(part.unit), float(value), part.low, part.high))
    return ProposedLaw(
        expression, tuple(parameters), values, family, trial.shape, trial.left_out / samples, score, trial.steps
    )
