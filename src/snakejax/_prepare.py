"""What JAX must be told before it is used here; importing the package tells it nothing."""

import os

_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"


def prepare_jax() -> None:
    """Double precision, which this package needs, and loops compiled whole, which make it 3 to 5 times faster.

    On a CPU, XLA runs a loop as a list of small kernels, and for the few numbers of a snakeboard calling them costs
    more than the arithmetic. The option compiles a loop's whole body to one function. XLA reads its options when JAX
    computes for the first time, so call this before; an XLA_FLAGS with extra options of its own is left as it is.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_WHOLE_LOOPS}".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
