"""The interval of a parameter from its profile."""

import numpy as np

from ._estimates import spread
from ._fit import Fit
from ._least_squares import domains_of
from ._study import Optimum


def profile(found: Fit, name: str, quantile: float = 1.959964) -> tuple[float | None, float | None]:
    """The 95% interval of one parameter from its profile: where the best fit of all others is worse by quantile^2.

    An end is None where the misfit does not rise that far before the bound of the domain.
    """
    study, best = found.study, found.optimum
    train, others = study.numbered("train"), [n for n in best.loose if n != name]
    domain = domains_of(study.model, [name])[0]
    scale, best_cost = spread(best) ** 2, best.misfit * best.samples
    step = float(np.sqrt(best.covariance[best.loose.index(name), best.loose.index(name)])) * spread(best)
    step = min(step * abs(best.values[name]) if domain.multiplicative else step, max(abs(best.values[name]), 1.0))

    def excess(value: float, near: Optimum) -> tuple[float, Optimum]:
        moved = study.fit({**near.values, name: value}, others, train, near.start)
        return (moved.misfit * moved.samples - best_cost) / scale - quantile**2, moved

    def end(sign: int) -> float | None:
        inside, near, reach = best.values[name], best, quantile * step
        low = np.nextafter(domain.low, np.inf) if domain.positive else domain.low
        for _ in range(12):
            outside = float(np.clip(best.values[name] + sign * reach, low, domain.high))
            above, moved = excess(outside, near)
            if above > 0:
                break
            if outside in (low, domain.high):
                return None
            inside, near, reach = outside, moved, reach * 1.6
        else:
            return None
        for _ in range(12):
            middle = (inside + outside) / 2
            above, moved = excess(middle, near)
            inside, outside, near = (inside, middle, near) if above > 0 else (middle, outside, moved)
            if abs(outside - inside) < 0.01 * step:
                break
        return (inside + outside) / 2

    return end(-1), end(+1)
