"""Score tests: what each candidate effect would change, beside what is left unexplained, without refitting anything."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from ._least_squares import Linearised, basis, domains_of, starts_removed
from ._model import Model

ALPHA = 0.01
"""A candidate is significant where its p-value, corrected for the size of the library, is below this."""
POWER = 0.8
NOTHING = 1e-3
"""A parameter that changes less than this, over its whole domain and in standard deviations, changes nothing."""
ALIKE = 0.99
"""Two candidates are confusable where the cosine of the angle between their projected signatures is above this."""
CLEAR = 9.0
"""So much larger chi^2 of one candidate tells it from another: a likelihood ratio of 90."""


class Reduced(NamedTuple):
    """Residual (N,) and parameter columns (N, P), with what the starts of runs or windows explain projected out.

    `block` (N,) numbers stretches of a second or two: the errors within one may depend on each other. `lost` counts the
    start components that were estimated.
    """

    residual: np.ndarray
    columns: np.ndarray
    block: np.ndarray
    lost: int


class Scored(NamedTuple):
    """One candidate: expected values of its parameters with standard errors, and how sure it is that it acts.

    `reduction` is the fall of chi^2 that the linear model predicts, `statistic` the same in units of the residual
    variance, corrected for correlation; `p_value` is corrected for the number of candidates. `detectable`: the smallest
    values that these data reveal with power 0.8. `signature` (N,) is the direction in residual space, unit length, and
    `span` (N, q) an orthonormal basis of all that its parameters can change.
    """

    effect: str
    values: dict[str, float]
    sd: dict[str, float]
    reduction: float
    statistic: float
    p_value: float
    detectable: dict[str, float]
    signature: np.ndarray
    span: np.ndarray


def reduced(
    found: Linearised, free_start: np.ndarray, runs: Sequence[int], times: np.ndarray, length: float
) -> Reduced:
    """Project the starts of `runs` out of residuals and Jacobian; blocks are `length` [s] long."""
    width = found.jacobian.shape[-1] - free_start.shape[1]
    rows, columns, blocks, count = [], [], [], 0
    for k in runs:
        seen = np.abs(found.jacobian[k][..., width:]).sum(axis=-1).reshape(-1) > 0
        block = np.repeat(np.floor((times[k] - times[k][0]) / length).astype(int), 3)[seen]
        r, J = starts_removed(found, k, width, free_start)
        rows.append(r[seen])
        columns.append(J[seen])
        blocks.append(count + block)
        count = int(blocks[-1].max()) + 1
    felt = (found.jacobian[list(runs)][..., width:] ** 2).sum(axis=(1, 2)) > 0
    lost = int((felt & (free_start[list(runs)] > 0)).sum())
    return Reduced(np.concatenate(rows), np.concatenate(columns), np.concatenate(blocks), lost)


def score(
    model: Model,
    names: Sequence[str],
    rest: Reduced,
    fitted: Sequence[str],
    candidates: Mapping[str, Sequence[str]],
    values: Mapping[str, float],
) -> list[Scored]:
    """Score `candidates` (parameter names of each) beside the `fitted` parameters, best first.

    With r the residual, A the columns of the fitted parameters, E those of a candidate, both with the starts projected
    out, and E_ = E - A A^+ E: the expected change is -E_^+ r, the predicted fall of chi^2 |E_ E_^+ r|^2. Its statistic
    is divided by the variance left after it, where that is above one, and by the variance inflation of the scores
    summed block by block, so that neither another missing effect nor correlated errors make it look surer than it is. A
    parameter that the domain bounds at its present value is tested one-sidedly.
    """
    columns = {name: rest.columns[:, k] for k, name in enumerate(names)}
    A = (
        basis(np.stack([columns[name] for name in fitted], axis=1), 1e-10)
        if fitted
        else np.zeros((rest.residual.size, 0))
    )
    r = rest.residual - A @ (A.T @ rest.residual)
    chi2, dof = float(r @ r), max(rest.residual.size - rest.lost - len(fitted), 1)
    scored = []
    for effect, parts in candidates.items():
        E = np.stack([columns[name] for name in parts], axis=1)
        whole = np.sqrt((E**2).sum(axis=0))
        E = E - A @ (A.T @ E)
        left = np.sqrt((E**2).sum(axis=0))
        usable = (left > 1e-6 * whole) & (whole * np.minimum(_ends(model, parts), 1.0) > NOTHING)
        if not usable.any():
            continue
        scored.append(_one(effect, list(parts), E, r, chi2, dof, usable, model, values, rest.block))
    count = max(len(scored), 1)
    corrected = [s._replace(p_value=float(-np.expm1(count * np.log1p(-min(s.p_value, 1 - 1e-16))))) for s in scored]
    return sorted(corrected, key=lambda s: -s.reduction)


def _ends(model: Model, parts: Sequence[str]) -> np.ndarray:
    """How far the parameters `parts` can be from neutral: the upper ends of their domains, and 1 for a mere number."""
    return np.array([1.0 if d.unit == "-" else d.high for d in domains_of(model, parts)])


def _one(effect, parts, E, r, chi2, dof, usable, model, values, block) -> Scored:
    E = E * usable
    normal = E.T @ E
    normal[~usable, ~usable] = 1.0
    covariance = np.linalg.pinv(normal, hermitian=True)
    change = -(covariance @ (E.T @ r)) * usable
    bounded = False
    for k, domain in enumerate(domains_of(model, parts)):
        at = values[parts[k]]
        bounded = bounded or at <= domain.low or at >= domain.high
        change[k] = np.clip(at + change[k], domain.low, domain.high) - at
    fall = float(chi2 - ((r + E @ change) ** 2).sum())
    variance = max(1.0, (chi2 - fall) / dof)
    inflation = _inflation(E[:, usable], r + E @ change, block, variance)
    statistic = max(fall, 0.0) / variance / inflation
    freedom = int(usable.sum())
    p_value = stats.chi2.sf(statistic, freedom)
    if bounded and freedom == 1:
        p_value = p_value / 2 if fall > 0 else 1.0
    sd = np.sqrt(np.diag(covariance) * variance * inflation)
    needed = stats.norm.isf(ALPHA / 50) + stats.norm.ppf(POWER)
    signature = E @ change if fall > 0 else E[:, int(np.argmax(usable))]
    size = float(np.linalg.norm(signature))
    ends = {n: float(values[n] + c) for n, c in zip(parts, change, strict=True)}
    spread = {n: float(s) if ok else np.inf for n, s, ok in zip(parts, sd, usable, strict=True)}
    # What the data would reveal once the rest is explained: noise of variance one.
    clean = np.sqrt(np.diag(covariance))
    smallest = np.where(usable, needed * clean, np.inf)
    # So far from neutral that the domain ends, or that a relative change is no longer a small one: not to be seen.
    smallest = np.where(smallest > _ends(model, parts), np.inf, smallest)
    detectable = {n: float(size) for n, size in zip(parts, smallest, strict=True)}
    return Scored(
        effect,
        ends,
        spread,
        fall,
        float(statistic),
        float(p_value),
        detectable,
        signature / (size if size > 0 else 1.0),
        basis(E[:, usable], 1e-6),
    )


def _inflation(E: np.ndarray, after: np.ndarray, block: np.ndarray, variance: float) -> float:
    """How much larger the variance of E^T after is, summed over blocks, than independent errors would make it; >= 1."""
    size = np.sqrt((E**2).sum(axis=0))
    unit = E / np.where(size > 0, size, 1.0)
    count = int(block.max()) + 1
    sums = np.stack([np.bincount(block, unit[:, k] * after, count) for k in range(unit.shape[1])], axis=1)
    return max(1.0, float((sums**2).sum(axis=0).max()) / variance)


def confusable(scored: Sequence[Scored]) -> dict[str, list[str]]:
    """For each candidate those that these runs cannot tell from it.

    With s_i the signature of candidate i, S_i its statistic and Q_j the span of candidate j, j would leave
    S_i (1 - |Q_j^T s_i|^2) of what i explains, and the two were found to explain |S_i - S_j| more or less. They are
    confusable at any strength where |Q_j^T s_i| > `ALIKE`, and at that of a significant i where both are below `CLEAR`.
    """
    share = np.array([[min(float(((o.span.T @ s.signature) ** 2).sum()), 1.0) for o in scored] for s in scored])
    size = np.array([s.statistic for s in scored])
    close = np.maximum(size[:, None] * (1 - share), np.abs(size[:, None] - size)) < CLEAR
    sure = np.array([s.p_value < ALPHA for s in scored], bool)
    alike = (share > ALIKE**2) | (sure[:, None] & close)
    alike = alike | alike.T
    return {s.effect: [o.effect for j, o in enumerate(scored) if alike[i, j] and i != j] for i, s in enumerate(scored)}
