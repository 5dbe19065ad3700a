"""`snakejax completion`: a script that lets a shell complete commands and options."""

import argparse
from typing import Any

from ._options import add_command

SHELLS = ("bash", "zsh", "tcsh")


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "completion",
        run,
        "print a script that lets a shell complete commands",
        "Print a script for the shell, which then completes commands, options and files. For\n"
        "bash, write it to ~/.local/share/bash-completion/completions/snakejax.",
        "snakejax completion bash",
    )
    command.add_argument("shell", choices=SHELLS, help="which shell")


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from ._main import parser

    print(shtab.complete(parser(), shell=options.shell))
    return 0
