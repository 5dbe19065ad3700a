"""Many boards that differ, to be simulated side by side."""

import jax.numpy as jnp
import numpy as np

from snakejax import Model
from snakejax.core.parameter import parameters, with_parameters
from snakejax.simulation.ensemble import stacked


def scattered(model: Model, count: int) -> Model:
    """`count` boards around `model`, all of whose numbers that are not zero differ."""
    rng = np.random.default_rng(0)
    many = stacked([model] * count)
    varied = {n: float(p.value) * rng.uniform(0.8, 1.0, count) for n, p in parameters(model).items()}
    return with_parameters(many, {n: jnp.asarray(v) for n, v in varied.items()})
