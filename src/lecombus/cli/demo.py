"""`lecombus demo`: simulated drives of five families with a live view."""

from __future__ import annotations

import click

from lecombus.cli.arguments import DURATION

__all__ = ["command"]


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
def command(seconds: float | None, http: str | None) -> int:
    """Watch simulated drives of five families, without any hardware.

    Values are live and go through the whole daemon, from the serial line to HTTP. On a terminal
    they stand in a table that is redrawn; in a pipe each round is a few plain lines.
    """
    from lecombus.demo import run_demo

    return run_demo(seconds, http)
