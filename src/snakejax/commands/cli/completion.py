"""`snakejax completion`: print a shell script that completes commands and options."""

import argparse
from typing import Any

from .options import add_command

SHELLS = ("bash", "zsh", "fish", "tcsh")


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "completion",
        run,
        "print a shell script that completes commands",
        "Print a script with which the shell completes commands, options and files. For\n"
        "bash, write it to ~/.local/share/bash-completion/completions/snakejax, for fish\n"
        "to ~/.config/fish/completions/snakejax.fish.",
        "snakejax completion bash",
    )
    command.add_argument("shell", choices=SHELLS, help="the shell")


def run(options: argparse.Namespace) -> int:
    """Print the script for `options.program`, the parser of the whole program."""
    import shtab

    print(shtab.complete(options.program, shell=options.shell))
    return 0
