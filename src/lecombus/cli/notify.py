"""`lecombus notify test`: shows whether messages arrive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lecombus.cli.arguments import json_option, roster_option
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import show_rows

if TYPE_CHECKING:
    from lecombus.roster import NotifyEntry, Roster

__all__ = ["notify_command", "notify_of"]


@click.group("notify")
def notify_command() -> None:
    """Try the messages that `lecombus bridge notify` sends.

    They go by command or mail, as the roster's `notify:` says: docs/notify.md.
    """


@notify_command.command("test")
@roster_option
@json_option
def test_command(roster: Path, as_json: bool) -> int:
    """Send one test message over each channel, and say whether it was sent.

    It needs no daemon, and sends as this user: the bridge may run as another, who must be able to
    read the password file. A mail that the server took can still be lost behind it.

    In a pipe: channel, result, reason. Exit status 1: a message was not sent.
    """
    import anyio  # other commands start faster without

    from lecombus.bridges.notify.bridge import send_test

    found = anyio.run(send_test, *notify_of(roster))
    if as_json:
        channels = [{"channel": name, "sent": why is None, "reason": why} for name, why in found]
        click.echo(json.dumps({"channels": channels}, ensure_ascii=False))
    else:
        rows = [(name, "sent" if why is None else "not sent", why or "") for name, why in found]
        show_rows(("channel", "result", "why"), rows)
    return Exit.DONE if all(why is None for _, why in found) else Exit.FAILED


def notify_of(path: Path) -> tuple[Roster, NotifyEntry]:
    """Return a roster and what it says of messages.

    Raises:
        CommandError: It says nothing of them.
    """
    from lecombus.config import load_roster

    roster = load_roster(path)
    if roster.notify is None:
        remedy = "write it, such as `notify: {command: [/usr/local/bin/page]}`"
        raise CommandError(Exit.USAGE, f"{path} has no key `notify`", remedy)
    return roster, roster.notify
