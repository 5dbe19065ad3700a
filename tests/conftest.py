"""What every test takes for granted: double precision, and no silent change of type or of rank."""

from pathlib import Path

import jax
import pytest

from snakejax import prepare_jax

prepare_jax()
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of the large recordings, which lies beside the repository and does not travel with it."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    if not folder.is_dir():
        pytest.skip("The large recordings are not here: they belong in ../shared/recordings.")
    return folder


@pytest.fixture(scope="session")
def realdata() -> Path:
    """The folder of real motion-capture exports, which lies beside the repository and does not travel with it."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "realdata"
    if not folder.is_dir():
        pytest.skip("The real exports are not here: they belong in ../shared/realdata.")
    return folder
