"""What JAX must be told before it is used here; importing the package tells it nothing."""

import os

_OPTIONS = {
    "xla_backend_extra_options": "xla_cpu_small_while_loop_byte_threshold=1000000000",
    "xla_cpu_prefer_vector_width": "512",
}


def prepare_jax() -> None:
    """Double precision, which this package needs; and loops compiled whole, which make it 3 to 5 times faster, for
    vectors as wide as the processor has.

    On a CPU, XLA runs a loop as a list of small kernels, and for the few numbers of a snakeboard calling them costs
    more than the arithmetic. The first option compiles a loop's whole body to one function. XLA reads its options when
    JAX computes for the first time, so call this before; one that XLA_FLAGS names already is left as it is.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    added = [f"--{name}={value}" for name, value in _OPTIONS.items() if name not in flags]
    os.environ["XLA_FLAGS"] = " ".join([flags, *added]).strip()
    import jax

    jax.config.update("jax_enable_x64", True)
