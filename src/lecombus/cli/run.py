"""`lecombus run`: the daemon."""

from __future__ import annotations

import gc
from pathlib import Path

import click

from lecombus.cli.arguments import roster_option
from lecombus.cli.logs import FORMATS, LEVELS, set_up_logging

__all__ = ["command"]


@click.command("run")
@roster_option
@click.option(
    "--log-level",
    type=click.Choice(LEVELS, case_sensitive=False),
    envvar="LECOMBUS_LOG_LEVEL",
    default="info",
    show_default=True,
    help="debug shows every telegram, decoded.",
)
@click.option(
    "--log-format",
    type=click.Choice(FORMATS),
    envvar="LECOMBUS_LOG_FORMAT",
    default="logfmt",
    show_default=True,
)
def command(roster: Path, log_level: str, log_format: str) -> int:
    """Run the line that a roster describes, until SIGTERM or Ctrl-C.

    Logs go to standard error, one event a line; nothing goes to standard output. SIGHUP reads the
    roster again, or says what is wrong with it and keeps the old one.
    """
    set_up_logging(log_level, log_format)
    gc.disable()  # next to nothing that is made at the start is garbage; the daemon enables it
    try:
        from lecombus.daemon import run

        return run(roster, log_format=log_format)
    finally:
        gc.enable()
