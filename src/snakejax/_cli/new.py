"""`snakejax new`: a commented case.toml to start from."""

import argparse
from typing import Any

from ._options import add_command


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "new",
        run,
        "write a commented case.toml to start from",
        "Write a commented case.toml into a folder, which is made where it is not there.",
        "snakejax new my-board",
    )
    command.add_argument("folder", metavar="DIR", help="where to write case.toml")
    command.add_argument("--quiet", action="store_true", help="print nothing but complaints")


def run(options: argparse.Namespace) -> int:
    """Write the template."""
    from .._template import write_template

    path = write_template(options.folder)
    if not options.quiet:
        print(f"wrote {path}: fill it in, put the recordings beside it, then run `snakejax check {options.folder}`")
    return 0
