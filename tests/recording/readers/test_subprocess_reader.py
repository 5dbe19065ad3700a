"""The process that reads with a library of another language."""

import subprocess
import sys

HEAVY = {"jax", "equinox", "diffrax", "scipy", "matplotlib"}


def test_the_process_loads_no_more_than_it_needs() -> None:
    """Each file is read in a process of its own: what that process imports is waited for at every file."""
    code = f"from snakejax.recording.readers import subprocess_reader; import sys; print({HEAVY} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
