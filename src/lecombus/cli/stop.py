"""`lecombus stop`: the emergency class."""

from __future__ import annotations

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.verbs import stop

__all__ = ["command"]


@click.command("stop")
@click.argument("target", required=False)
@click.option("--all", "everything", is_flag=True, help="All drives; the same as no TARGET.")
@click.option(
    "--action",
    type=click.Choice(["quick-stop", "inhibit"]),
    default="quick-stop",
    show_default=True,
    help="quick-stop: down its ramp; inhibit: no torque at once, the motor coasts.",
)
@daemon_options
def command(
    target: str | None,
    everything: bool,
    action: str,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Stop TARGET, a drive or a group, before everything else that waits.

    Without TARGET all drives of the line are stopped: there is no question, because a stop may
    be urgent. It is read back from every drive. It is not a safety function.

    Exit status 0 only if every drive is known to have taken the stop. If not, the first line, on
    standard error, says how many drives did not confirm it, that motors may still turn, and to use
    the emergency stop circuit. In a pipe: one line a drive with drive, code, outcome, value read
    back, reason. With --json: the daemon's document, as for group.
    """
    if target and everything:
        raise CommandError(
            Exit.USAGE, Problem("a target and --all are both given", "leave one of them out")
        )
    return stop(target or "all", action, socket=socket, url=url, as_json=as_json)
