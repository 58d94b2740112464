"""`lecombus run` and `lecombus demo`: the daemon, for a roster or for simulated drives."""

from __future__ import annotations

import gc
from pathlib import Path

import click

from lecombus.cli.arguments import DURATION, roster_option
from lecombus.cli.logs import FORMATS, LEVELS, set_up_logging

__all__ = ["demo_command", "run_command"]


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
def run_command(roster: Path, log_level: str, log_format: str) -> int:
    """Run the line that a roster describes, until SIGTERM or Ctrl-C.

    Logs go to standard error, one event a line; nothing goes to standard output. SIGHUP reads the
    roster again, as `lecombus reload` does.
    """
    set_up_logging(log_level, log_format)
    gc.disable()  # next to nothing that is made at the start is garbage; the daemon enables it
    try:
        from lecombus.daemon import run

        return run(roster, log_format=log_format)
    finally:
        gc.enable()


@click.command("demo")
@click.option(
    "--for", "seconds", type=DURATION, help="End after this time, such as 30s; default: at Ctrl-C."
)
@click.option(
    "--http",
    default=None,
    metavar="HOST:PORT",
    help="Where the API and /metrics are served; default: 127.0.0.1:9740, or another "
    "port where that is in use.",
)
def demo_command(seconds: float | None, http: str | None) -> int:
    """Watch simulated drives of five families, without any hardware.

    Values are live and go through the whole daemon, from the serial line to HTTP. On a terminal
    they stand in a table that is redrawn; in a pipe each round is a few plain lines.
    """
    from lecombus.demo import run_demo

    return run_demo(seconds, http)
