"""`lecombus inhibit`: a stop, by its own name."""

from __future__ import annotations

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.verbs import stop

__all__ = ["command"]


@click.command("inhibit")
@click.argument("target")
@daemon_options
def command(target: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Inhibit TARGET, a drive or a group, before everything else: no torque, the motor coasts.

    The same as `lecombus stop TARGET --action inhibit`: it is sent before all other requests,
    and also where writes are refused. It is read back. It is not a safety function.
    """
    return stop(target, "inhibit", socket=socket, url=url, as_json=as_json)
