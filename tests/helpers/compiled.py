"""One folder of compiled programs for all processes of a test run. Import it before jax, which reads its variables.

Two processes run the tests, and the tests of the commands start more: each finds there what another has compiled. The
folder goes when the run ends. Who sets `JAX_COMPILATION_CACHE_DIR` keeps the programs for the next run.
"""

import os
import tempfile

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _folder = tempfile.TemporaryDirectory(prefix="snakejax-tests-", ignore_cleanup_errors=True)
    """Kept until this process, the first of the run, ends: the others inherit the variable."""
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _folder.name

os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
os.environ.setdefault("EQX_ON_ERROR", "nan")
"""As in the commands: a program that calls back to Python to raise an error is not kept."""
