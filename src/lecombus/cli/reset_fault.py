"""`lecombus reset-fault`: acknowledge a drive's fault."""

from __future__ import annotations

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.verbs import say

__all__ = ["command"]


@click.command("reset-fault")
@click.argument("drive")
@daemon_options
def command(drive: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Reset the active fault of DRIVE, by its family's own way. It never starts the motor.

    The drive is inhibited first and stays so: `lecombus enable` lets it run again. Without a
    fault nothing is sent. An 820X and its module restart, which takes about ten seconds: its
    watchdog is set again before it is called online.

    In a pipe and with --json: as for enable.
    """
    return say(drive, "reset-fault", {}, socket=socket, url=url, as_json=as_json)
