"""`lecombus enable`: let one drive run."""

from __future__ import annotations

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.verbs import say

__all__ = ["command"]


@click.command("enable")
@click.argument("drive")
@daemon_options
def command(drive: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Release quick stop and inhibit of DRIVE. Its motor turns if it has a setpoint.

    It is refused while a fault is active (`lecombus reset-fault`), and where a setting of the
    drive prevents control over the line; the setting is named. The drive's status words must
    show the enable; if they do not, because its enable terminal is open, it is inhibited again.

    In a pipe: drive, verb, outcome, what the drive shows, value read back, reason. With --json: the
    daemon's document, {"drive", "verb", "outcome", "reason", "states", "written"}.
    """
    return say(drive, "enable", {}, socket=socket, url=url, as_json=as_json)
