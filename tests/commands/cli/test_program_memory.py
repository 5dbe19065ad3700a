"""The compiled programs of one CASE do not stay in memory while the next is computed."""

import argparse
from typing import Any

import jax
import numpy as np
import pytest
from helpers.folders import DATA

from snakejax.commands.cli import explain, main, pipeline
from snakejax.commands.cli.pipeline import Outcome
from snakejax.core.progress import Progress

CASES = [str(DATA / name) for name in ("level-board", "spring-board", "tilted-floor")]
PROGRAMS = 20


def live_programs() -> int:
    return len(jax.devices()[0].client.live_executables())


@pytest.mark.slow
def test_explain_drops_the_programs_of_cases_that_are_done(monkeypatch) -> None:
    doubled = jax.jit(lambda values: values + values)
    at_start: list[int] = []

    def work(options: argparse.Namespace, case: Any, say: Progress) -> Outcome:
        at_start.append(live_programs())
        for k in range(PROGRAMS):
            doubled(np.ones(1 + k + PROGRAMS * len(at_start)))
        assert live_programs() >= at_start[-1] + PROGRAMS
        return Outcome({}, "")

    monkeypatch.setattr(explain, "work", work)
    monkeypatch.setattr(pipeline, "CASES_KEPT", 1)
    assert main(["explain", *CASES, "--quiet"]) == 0
    assert len(at_start) == 3
    assert max(at_start[1:]) < at_start[0] + PROGRAMS
