"""How long the first run of a command takes, when nothing is compiled yet, and which programs it compiles.

    python benchmarks/cold.py [REPEATS]

runs each of `COMMANDS` in a process of its own, from an empty cache of compiled programs and then from the one it has
filled, and prints the seconds of both with the imports, the load of the machine, and the programs that took `LONG` or
more to compile.
"""

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = (
    ("fit", "data/level-board", "--quiet"),
    ("explain", "data/tilted-floor", "--quiet"),
    ("sweep", "paper-rotate", "--vary", "D=0.5:10:20", "--quiet"),
)
LONG = 0.2
"""Shortest compilation [s] that is listed."""
LOGGERS = ("jax._src.dispatch", "jax._src.interpreters.pxla")
"""Where JAX logs what it compiles."""
COMPILED = re.compile(r"Finished XLA compilation of (.*?) in ([\d.e-]+) sec")
CHILD = "child"
"""First argument of the process that runs a command."""


def child(words: list[str]) -> None:
    """Run a command, and print each program that is compiled with its seconds."""
    import logging

    import jax

    class Listed(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if compiled := COMPILED.match(record.getMessage()):
                print("compiled", compiled[2], compiled[1], flush=True)

    jax.config.update("jax_log_compiles", True)
    for name in LOGGERS:
        logger = logging.getLogger(name)
        logger.handlers, logger.propagate = [Listed()], False
    from snakejax.commands.cli import main

    sys.exit(main(words))


def run(words: tuple[str, ...], cache: str) -> tuple[float, list[tuple[float, str]]]:
    """The seconds of a command with its imports, and the compilations in it with theirs."""
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache, "XDG_CACHE_HOME": cache}
    begun = time.perf_counter()
    command = [sys.executable, __file__, CHILD, *words]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    seconds = time.perf_counter() - begun
    lines = [line.split(" ", 2) for line in done.stdout.splitlines() if line.startswith("compiled ")]
    return seconds, [(float(taken), name) for _, taken, name in lines]


def main(repeats: int) -> None:
    """Print a table of the commands, and their programs."""
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; medians of {repeats}", flush=True)
    for words in COMMANDS:
        cold, warm, programs = [], [], []
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as cache:
                seconds, programs = run(words, cache)
                cold.append(seconds)
                warm.append(run(words, cache)[0])
        compiling = sum(seconds for seconds, _ in programs)
        print(f"\nsnakejax {' '.join(words)}")
        print(f"  cold {statistics.median(cold):.1f} s, warm {statistics.median(warm):.1f} s")
        print(f"  {len(programs)} programs, {compiling:.1f} s of compiling (last repeat)")
        for seconds, name in sorted(programs, reverse=True):
            if seconds >= LONG:
                print(f"  {seconds:6.1f} s  {name}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == [CHILD]:
        child(sys.argv[2:])
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
