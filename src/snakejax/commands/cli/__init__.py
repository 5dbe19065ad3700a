"""The command line: one module a command, each with `add` (its options) and `run` (what it does)."""

from .main import main as main
