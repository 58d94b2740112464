"""`lecombus quick-stop`: a stop, by its own name."""

from __future__ import annotations

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.verbs import stop

__all__ = ["command"]


@click.command("quick-stop")
@click.argument("target")
@daemon_options
def command(target: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Stop TARGET, a drive or a group, along its ramp by quick stop, before everything else.

    The same as `lecombus stop TARGET --action quick-stop`: it is sent before all other
    requests, and also where writes are refused. It is read back. It is not a safety function.
    """
    return stop(target, "quick-stop", socket=socket, url=url, as_json=as_json)
