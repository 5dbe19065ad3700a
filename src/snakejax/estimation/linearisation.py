"""Linearisation of whole runs: the variables of a fit, residuals of many runs, and their Jacobian."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from snakejax.core.parameter import Domain, parameters, require_in_domain, with_parameters
from snakejax.dynamics.active_effects import active_effects
from snakejax.dynamics.model import Model
from snakejax.simulation.integrate import Accuracy, simulate

from .batch import Batch
from .whitening import whitened

REACH = 3.0
"""Largest step of a scaled parameter: exp(3), a factor of 20, for a multiplicative parameter."""
LANES = 8
"""Double precision numbers in one vector register (512 bits); 8 derivative directions cost as much as fewer."""

LARGEST_DERIVATIVE = 1e100
"""By the start state, at 1 m: squared and summed it is still far from the largest number there is, 2e308."""


class Variables(eqx.Module):
    """Decision variables: parameter values and start states, and the directions in which they may move.

    `values` (P,) are the values of the parameters `names`. Row k of `directions` (K, P) moves them by a step z_k:
    additively, or by the factor exp(z_k) if the parameter is multiplicative. A row of zeros is an unused direction, so
    one compiled program serves every choice of free parameters among `names`. `start` (R, S) are the start states of
    the runs; `free_start` (R, S) is 1 for each component that is estimated, else 0.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[Array, " P"]
    directions: Float[Array, "K P"]
    start: Float[Array, "R S"]
    free_start: Float[Array, "R S"]


class Linearised(NamedTuple):
    """Whitened `residual` (R, n, 3), measured minus modelled over the noise, and its `jacobian` (R, n, 3, K + S) by the
    K parameter steps and the S components of the start state."""

    residual: Float[Array, "R n 3"]
    jacobian: Float[Array, "R n 3 K+S"]


def variables(
    model: Model,
    names: Sequence[str],
    free: Sequence[str],
    runs: Batch,
    width: int,
    values: Mapping[str, float] = MappingProxyType({}),
) -> Variables:
    """`Variables` at the values of `model`, with the parameters `free` among `names` in `width` directions.

    `values` take the place of those of the model. An empty name in `free` leaves its direction unused.
    **Raises:** `ValueError` for an unknown name or a number outside its domain.
    """
    known = parameters(model)
    require_in_domain(values, known)
    directions = np.zeros((width, len(names)))
    for row, name in enumerate(free):
        if name:
            directions[row, list(names).index(name)] = 1.0
    at = np.array([float(values.get(name, known[name].value)) for name in names])
    return Variables(tuple(names), at, directions, runs.start, runs.free_start)  # type: ignore[arg-type]


def retract(domains: list[Domain], at: Variables, steps: Float[Array, " K"]) -> Float[Array, " P"]:
    """The parameter values (P,) after `steps` (K,); a step across a bound of the domain is reflected back inside.

    For a parameter with a natural scale the step z saturates as REACH tanh(z / REACH), so one large step cannot lead
    to values at which a simulation becomes very slow. A fit reaches values further away by restarting.
    """
    low, high = (np.array([getattr(domain, end) for domain in domains]) for end in ("low", "high"))
    multiplicative = np.array([domain.multiplicative for domain in domains])
    scaled = np.array([domain.multiplicative or domain.typical is not None for domain in domains])
    shift = jnp.einsum("k,kp->p", steps, at.directions)
    shift = jnp.where(scaled, REACH * jnp.tanh(shift / REACH), shift)
    values = jnp.where(multiplicative, at.values * jnp.exp(shift), at.values + shift)
    above, below = values > high, values < low
    values = jnp.where(above, _reflected(values, high, multiplicative), values)
    values = jnp.where(below, _reflected(values, low, multiplicative), values)
    # A very large step is still outside after one reflection: it is clipped.
    inside = (values >= low) & (values <= high)
    return jnp.where(inside, values, jnp.clip(values, low, high))


def _reflected(
    values: Float[Array, " P"], bounds: Float[np.ndarray, " P"], multiplicative: Bool[np.ndarray, " P"]
) -> Float[Array, " P"]:
    """The values as far on the other side of their bounds, in the logarithm where that is what a fit moves: no
    reflection makes a positive value negative. Where there is no bound, the result means nothing."""
    bounds = np.where(np.isfinite(bounds), bounds, 1.0)
    return jnp.where(multiplicative, bounds**2 / jnp.where(multiplicative, values, 1.0), 2 * bounds - values)


def domains_of(model: Model, names: Sequence[str]) -> list[Domain]:
    """The domains of the parameters `names`."""
    known = parameters(model)
    return [known[name].domain for name in names]


def narrowed(at: Variables) -> Variables:
    """`at` without trailing unused directions; the number of derivatives stays a multiple of `LANES`."""
    width, depth = at.directions.shape[0], at.start.shape[1]
    used_rows = np.flatnonzero(np.asarray(at.directions).any(axis=1))
    needed = 0 if not used_rows.size else int(used_rows[-1]) + 1
    kept = min(width, -(-max(needed + depth, 1) // LANES) * LANES - depth)
    return eqx.tree_at(lambda u: u.directions, at, at.directions[:kept])


def widened(linearised: Linearised, missing: int, kept: int) -> Linearised:
    """`linearised` with `missing` columns of zeros behind the `kept` directions."""
    return linearised._replace(jacobian=np.insert(linearised.jacobian, [kept] * missing, 0.0, axis=-1))


def _run_residual(model, names, values, start, batch: Batch, accuracy: Accuracy):
    """Residual (n, 3) of one run; `batch` without its leading axis."""
    at_values = with_parameters(model, {name: values[k] for k, name in enumerate(names)})
    in_run = at_values.in_run(batch.payload, batch.codes)
    how = {"accuracy": accuracy, "throw": False, "resting": batch.resting}
    pose = simulate(in_run, batch.gait, batch.times, start, **how).pose
    return whitened(jnp.where(batch.weight > 0, (batch.pose - pose) * batch.weight, 0.0), batch.whitening)


def _with_active_effects(model: Model, at: Variables, values: Float[Array, " P"]) -> Model:
    """`model`, with the effects active that are not neutral at `values` or that move."""
    named = with_parameters(model, {name: values[k] for k, name in enumerate(at.names)})
    moving = {name: jnp.any(at.directions[:, k] != 0) for k, name in enumerate(at.names)}
    return model.with_active(active_effects(named, moving))


def derivatives(function: Callable, size: int, has_aux: bool = False) -> tuple:
    """`function` at zeros (size,), and its derivatives by them in a last axis; with `has_aux` also the second of its
    two results as it is. All are taken together, in a multiple of `LANES`."""
    zero = jnp.zeros(size)
    along = jax.vmap(
        lambda d: jax.jvp(function, (zero,), (d,), has_aux=has_aux), out_axes=(None, -1, *[None] * has_aux)
    )
    value, slopes, *aux = along(jnp.eye(-(-size // LANES) * LANES, size))
    return value, jax.tree.map(lambda part: part[..., :size], slopes), *aux


def linearise(model, at: Variables, batch: Batch, order, count, steps, start_steps, accuracy) -> Linearised:
    """Residuals and Jacobian at `at` moved by `steps` (K,) and `start_steps` (R, S), for the runs `order[:count]`.

    A run that depends on its start by more than `LARGEST_DERIVATIVE` runs away: its residuals are infinite, as those of
    a run that cannot be simulated, so that no fit stops there.
    """
    width, depth = at.directions.shape[0], at.start.shape[1]
    R, n = batch.times.shape
    domains = domains_of(model, at.names)
    model = _with_active_effects(model, at, retract(domains, at, steps))

    def add_run(run: Int[Array, ""], linearised: Linearised) -> Linearised:
        k = order[run]
        arguments = jax.tree.map(lambda leaf: leaf[k], (batch, at.start, at.free_start, start_steps))
        data, start, free, shift = arguments

        def residual(z):
            values = retract(domains, at, steps + z[:width])
            return _run_residual(model, at.names, values, start + free * (shift + z[width:]), data, accuracy)

        r, J = derivatives(residual, width + depth)
        r = jnp.where((jnp.abs(J[..., width:]) > LARGEST_DERIVATIVE).any(), jnp.inf, r)
        return Linearised(linearised.residual.at[k].set(r), linearised.jacobian.at[k].set(J))

    empty = Linearised(jnp.zeros((R, n, 3)), jnp.zeros((R, n, 3, width + depth)))
    return jax.lax.fori_loop(0, count, add_run, empty)


def first(runs: Sequence[int], batch: Batch) -> tuple[Int[np.ndarray, " R"], Int[np.ndarray, ""]]:
    """`runs` as arguments of `linearise`: their indices padded to the number of runs of `batch`, and their count."""
    order = np.zeros(batch.start.shape[0], np.int64)
    order[: len(runs)] = runs
    return order, np.asarray(len(runs))


def project_out_starts(
    linearised: Linearised, run: int, width: int, free_start: np.ndarray, others: np.ndarray | None = None
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N K"]]:
    """Residual and parameter columns of one run, and `others` (N, c) behind them, orthogonal to its free start state.

    Variable projection (Golub and Pereyra 1973): with the orthonormal basis Q of the columns of the free start
    components, r - Q Q^T r and J - Q Q^T J. A start component without influence, such as the memory of an effect at its
    neutral value, is left out of Q.
    """
    r = np.asarray(linearised.residual[run]).reshape(-1)
    J = np.asarray(linearised.jacobian[run]).reshape(r.size, -1)
    observable = (free_start[run] > 0) & ((J[:, width:] ** 2).sum(axis=0) > 0)
    basis, _ = np.linalg.qr(J[:, width:][:, observable])
    columns = J[:, :width] if others is None else np.concatenate([J[:, :width], others], axis=1)
    return r - basis @ (basis.T @ r), columns - basis @ (basis.T @ columns)


def orthonormal_basis(columns: Float[np.ndarray, "N K"], smallest: float) -> Float[np.ndarray, "N k"]:
    """Orthonormal basis of the span of the normalised `columns`; singular values below `smallest` times the largest are
    dropped."""
    size = np.sqrt((columns**2).sum(axis=0))
    u, s, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return u[:, s > smallest * max(s.max(initial=0.0), 1e-300)]
