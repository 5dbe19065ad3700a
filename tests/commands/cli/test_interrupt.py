"""Ctrl-C, whatever the program is doing."""

import contextlib
import importlib
import os
import re
import signal
import subprocess
import sys
import time

import pytest
from helpers.folders import DATA

from snakejax.commands.cli import main
from snakejax.commands.cli.interrupt import AGAIN, PersistentInterrupt

# A job in the background of a script ignores Ctrl-C, and so would what it starts.
_INTERRUPTIBLE = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from snakejax.commands.cli import main
print("started", file=sys.stderr, flush=True)
sys.exit(main())
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process.")
@pytest.mark.parametrize("wait", [0.3, 3.0, pytest.param(8.0, marks=pytest.mark.slow)])
def test_an_interrupt_is_one_line_and_status_130(wait) -> None:
    """Ctrl-C while it imports, compiles or computes; the command would go on for a minute."""
    command = [sys.executable, "-c", _INTERRUPTIBLE, "explain", DATA / "spring-board", "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "started\n"
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (130, ""), err
    assert re.fullmatch(r"snakejax: error: Interrupted[^\n]*\n", err), err


@pytest.mark.slow
def test_an_interrupt_that_a_callback_swallows_is_raised_again() -> None:
    """Python forgets what a callback of a library raises."""
    heard = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), PersistentInterrupt():
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            time.sleep(10 * AGAIN)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        time.sleep(1.5 * AGAIN)  # and no more after that
    finally:
        signal.signal(signal.SIGINT, heard)


def test_an_interrupt_behind_another_error_is_known(capsys) -> None:
    """A compiled module of numpy prints an interrupt during its import and raises an ImportError without a cause."""
    heard, hooks = signal.getsignal(signal.SIGINT), (sys.excepthook, sys.unraisablehook)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupt = PersistentInterrupt()
    try:
        with pytest.raises(ImportError), interrupt:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt as error:
                sys.excepthook(KeyboardInterrupt, error, None)
            raise ImportError("Encountered an error while initializing the extension.") from None
    finally:
        signal.signal(signal.SIGINT, heard)
    assert interrupt.requested
    assert capsys.readouterr().err == ""
    assert (sys.excepthook, sys.unraisablehook) == hooks
    assert not PersistentInterrupt().requested


def test_the_command_reports_an_interrupt_that_became_another_error(monkeypatch, capsys) -> None:
    """The line and the status are those of Ctrl-C, not of a bug."""

    def broken(_: object) -> int:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise ImportError("Encountered an error while initializing the extension.")

    heard = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr("snakejax.commands.cli.check.run", broken)
    try:
        assert main(["check", str(DATA / "level-board")]) == 130
    finally:
        signal.signal(signal.SIGINT, heard)
    assert capsys.readouterr().err.startswith("snakejax: error: Interrupted")


def test_an_interrupt_waits_for_the_end_of_an_import(tmp_path, monkeypatch) -> None:
    """A compiled module that is interrupted during its import can crash the process."""
    (tmp_path / "interrupts_itself.py").write_text(
        "import signal\nsignal.raise_signal(signal.SIGINT)\ncomplete = True\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    heard = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), PersistentInterrupt():
            module = importlib.import_module("interrupts_itself")
            time.sleep(10 * AGAIN)
    finally:
        signal.signal(signal.SIGINT, heard)
    assert module.complete
