"""`snakejax new`: a commented case.toml to start from."""

import argparse
from typing import Any

from snakejax.vehicles.registry import VEHICLES

from .options import add_command


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "new",
        run,
        "write a commented case.toml to start from",
        "Write a commented case.toml into a folder, which is created if necessary.",
        "snakejax new my-board",
    )
    command.add_argument("folder", metavar="DIR", help="where to write case.toml")
    command.add_argument(
        "--vehicle", choices=VEHICLES, default="snakeboard", metavar="KIND", help=f"one of {', '.join(VEHICLES)}"
    )
    command.add_argument("--quiet", action="store_true", help="print only errors")


def run(options: argparse.Namespace) -> int:
    """Write the template."""
    from snakejax.recording.case_template import write_template

    path = write_template(options.folder, options.vehicle)
    if not options.quiet:
        print(f"wrote {path}: fill it in, put the recordings beside it, then run `snakejax check {options.folder}`")
    return 0
