"""What every test takes for granted: double precision, and no silent change of type or of rank."""

import os
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

import helpers.compiled  # noqa: F401  (first: jax and equinox read its variables when they are imported)
import jax
import pytest
from helpers.browser import BROWSERS
from helpers.folders import beside
from helpers.studies import study

from snakejax import prepare_jax
from snakejax.estimation.kept_program import drop_programs

prepare_jax()
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


LONGEST = ("test_notebooks", "test_commands", "test_tuning", "test_fitting", "test_limiting_cases")
"""The files that take longest, a minute and more each."""

MORE_MEMORY = 2 << 30
"""Bytes by which a test process grows before it drops its compiled programs."""
_memory = pytest.StashKey[int]()
"""Memory [bytes] of the test process when it last dropped them: what the allocator keeps does not come back."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with long tests first, and the longest at once: the last file of a parallel run is then a short one.

    A study of minutes is slow too, so that `-m "not slow"` leaves out both.
    """
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.slow)
    long = {item.path for item in items if item.get_closest_marker("slow")}
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (item.path not in long, place.get(item.path.stem, len(place))))


@pytest.fixture(scope="module", autouse=True)
def _programs_that_others_left(pytestconfig: pytest.Config) -> Iterator[None]:
    """Drop all compiled programs each time the process has grown by `MORE_MEMORY`: few files of tests need those of the
    one before."""
    yield
    if _resident() > pytestconfig.stash.setdefault(_memory, 0) + MORE_MEMORY:
        drop_programs()
        pytestconfig.stash[_memory] = _resident()


def _resident() -> int:
    """Memory [bytes] of this process; 0 where the system does not say."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * resource.getpagesize() if statm.is_file() else 0


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of the large recordings."""
    return beside("recordings")


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium, the system's own."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        why = f"None of {', '.join(BROWSERS)} is installed."
        (pytest.fail if os.environ.get("SNAKEJAX_NEEDS_BROWSER") else pytest.skip)(why)
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture(scope="session")
def study_folder(tmp_path_factory) -> Path:
    """Where the studies write."""
    return tmp_path_factory.mktemp("studies")


@pytest.fixture(scope="session")
def hidden_effect(study_folder):
    """What `fit/hidden_effect.py` finds, run as a user runs it."""
    return study("hidden_effect").main(study_folder)


@pytest.fixture(scope="session")
def own_effect(study_folder):
    """What `fit/own_effect.py` finds, before and after the effect of one's own is there."""
    return study("own_effect").main(study_folder)


@pytest.fixture(scope="session")
def realdata() -> Path:
    """The folder of real motion-capture exports."""
    return beside("realdata")
