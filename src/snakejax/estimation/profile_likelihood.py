"""Confidence interval of one parameter from its profile likelihood (Venzon and Moolgavkar 1988)."""

import numpy as np

from .fit_record import Fit
from .fit_workspace import problem_of
from .linearisation import domains_of
from .problem import Solution
from .uncertainty import spread


def profile(fit: Fit, name: str, quantile: float = 1.959964) -> tuple[float | None, float | None]:
    """Interval of one parameter: the values at which chi^2 / spread^2, all others refitted, rises by quantile^2.

    The default `quantile` gives the 95 % interval (Venzon and Moolgavkar 1988). Each end is bracketed by steps that
    grow by a factor 1.6 and then bisected to 1 % of a standard error, in at most 12 refits each. An end is None if
    chi^2 does not rise that far before the bound of the domain.
    """
    problem, best = problem_of(fit)
    train, others = problem.run_indices("train"), [n for n in best.loose if n != name]
    domain = domains_of(problem.model, [name])[0]
    scale, best_cost = spread(best) ** 2, problem.cost(best, train)
    step = float(np.sqrt(best.covariance[best.loose.index(name), best.loose.index(name)])) * spread(best)
    step = min(step * abs(best.values[name]) if domain.multiplicative else step, max(abs(best.values[name]), 1.0))

    def excess(value: float, neighbour: Solution) -> tuple[float, Solution]:
        refitted = problem.fit({**neighbour.values, name: value}, others, train, neighbour.start)
        return (problem.cost(refitted, train) - best_cost) / scale - quantile**2, refitted

    def end(sign: int) -> float | None:
        inside, neighbour, reach = best.values[name], best, quantile * step
        low = np.nextafter(domain.low, np.inf) if domain.positive else domain.low
        for _ in range(12):
            outside = float(np.clip(best.values[name] + sign * reach, low, domain.high))
            rise, refitted = excess(outside, neighbour)
            if rise > 0:
                break
            if outside in (low, domain.high):
                return None
            inside, neighbour, reach = outside, refitted, reach * 1.6
        else:
            return None
        for _ in range(12):
            middle = (inside + outside) / 2
            rise, refitted = excess(middle, neighbour)
            inside, outside, neighbour = (inside, middle, neighbour) if rise > 0 else (middle, outside, refitted)
            if abs(outside - inside) < 0.01 * step:
                break
        return (inside + outside) / 2

    return end(-1), end(+1)
