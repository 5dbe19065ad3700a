"""Configuration of JAX; importing the package changes none of its settings."""

import os

import jax
import jax.core
import scipy.linalg  # its own copy of the library, which XLA calls  # noqa: F401
from threadpoolctl import threadpool_limits


def require_x64() -> None:
    """Check the precision. **Raises:** `RuntimeError` unless JAX computes in double precision."""
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise RuntimeError(
            "snakejax computes in double precision: call `snakejax.prepare_jax()` first, or without its other options "
            '`jax.config.update("jax_enable_x64", True)`.'
        )


_OPTIONS = {
    "xla_backend_extra_options": "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_cpu_prefer_vector_width": "512",
    "xla_backend_optimization_level": "1",
}


def prepare_jax() -> None:
    """Set double precision, which this package needs, and what makes it 3 to 5 times faster on a CPU.

    XLA runs a loop as a list of small kernels; for the few numbers of one vehicle the calls cost more than the
    arithmetic. The first option compiles the body of a loop to one function, the second allows 512-bit vectors. The
    third leaves out optimizations of LLVM that take a fifth of the time to compile and gain 3% of the time to run. XLA
    reads its options at the first computation, so call this before. Options already in XLA_FLAGS are not changed.

    The linear algebra of numpy and scipy then runs in the thread that calls it, unless OPENBLAS_NUM_THREADS says how
    many it shall use: its matrices are small here, and two fits at once would wait for each other's threads.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    added = [f"--{name}={value}" for name, value in _OPTIONS.items() if name not in flags]
    os.environ["XLA_FLAGS"] = " ".join([flags, *added]).strip()
    jax.config.update("jax_enable_x64", True)
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        threadpool_limits(1, user_api="blas")
