"""What is computed of one CASE does not stay in memory while the next is computed."""

import argparse
import shutil
import subprocess
import sys
import textwrap
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


@pytest.mark.skipif(
    sys.platform != "linux", reason="reads /proc, and only the C library of GNU/Linux keeps freed memory"
)
def test_memory_that_is_freed_goes_back_to_the_system() -> None:
    script = """
        import jax
        import numpy as np
        from snakejax.commands.cli import pipeline

        def resident():
            pages = int(open("/proc/self/statm").read().split()[1])
            return pages * 4096 / 2**20

        parts = [np.ones(8000) for _ in range(4000)]
        last = np.ones(8000)  # Nothing below it is returned by itself.
        del parts
        before = resident()
        pipeline._drop_programs()
        print(before - resident())
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
    assert float(done.stdout) > 150


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.long
def test_the_memory_of_a_batch_is_flat(tmp_path) -> None:
    cases = [str(shutil.copytree(DATA / "level-board", tmp_path / f"board-{k:02d}")) for k in range(12)]
    script = """
        import sys, threading, time
        from pathlib import Path
        from snakejax.commands.cli import explain, main

        peaks, work = [], explain.work

        def watch():
            while True:
                if peaks:
                    pages = int(Path("/proc/self/statm").read_text().split()[1])
                    peaks[-1] = max(peaks[-1], pages * 4096 / 2**20)
                time.sleep(0.02)

        def watched(*given):
            peaks.append(0.0)
            return work(*given)

        threading.Thread(target=watch, daemon=True).start()
        explain.work = watched
        assert main(["explain", *sys.argv[1:], "--quiet"]) == 0
        print(*peaks)
    """
    command = [sys.executable, "-c", textwrap.dedent(script), *cases]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    peaks = [float(peak) for peak in done.stdout.split()]
    assert len(peaks) == 12
    assert max(peaks[3:]) < peaks[2] + 200
