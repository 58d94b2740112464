"""What the commands of the verbs share: asking the daemon, and showing what it says.

A stop that is not confirmed begins with one sentence on standard error: how many drives did not
confirm it, that motors may still turn, and what to use then.
"""

from __future__ import annotations

from collections.abc import Mapping
from urllib.parse import quote

import click

from lecombus.cli.client import connect
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.reports import (
    Document,
    is_done,
    members_of,
    show_members,
    show_verb,
    status_of,
)
from lecombus.readings import Json

__all__ = ["say", "stop"]


def say(
    drive: str,
    verb: str,
    document: Mapping[str, Json],
    *,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> Exit:
    """Have a drive do something and show how it ended."""
    with connect(socket, url) as daemon:
        answer = daemon.post(f"/v1/drives/{quote(drive, safe='')}/verbs/{verb}", document)
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    return show_verb(answer.data)


def stop(target: str, action: str, *, socket: str | None, url: str | None, as_json: bool) -> Exit:
    """Stop a drive or a group and show how it ended, member by member.

    Raises:
        CommandError: No drive was reached, or none is meant.
    """
    try:
        with connect(socket, url) as daemon:
            answer = daemon.post("/v1/stop", {"action": action, "target": target})
    except (CommandError, KeyboardInterrupt):
        if not as_json:
            _alarm(f"no drive has confirmed the {_words(action)}: motors may still turn")
        raise
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    doubtful = _not_confirmed(answer.data, action)
    if doubtful:
        _alarm(doubtful)
    show_members(answer.data, said_once=("remedy",))
    return status_of(answer.data)


def _not_confirmed(report: Document, action: str) -> str:
    """Say how many drives did not confirm a stop; nothing where all did."""
    members = members_of(report)
    count = sum(not is_done(one) for one in members)
    if not count:
        return ""
    motors = "its motor" if count == 1 else "their motors"
    drives = "drive" if len(members) == 1 else "drives"
    return (
        f"{count} of {len(members)} {drives} did not confirm the {_words(action)}: {motors} may "
        "still turn"
    )


def _alarm(text: str) -> None:
    """Print what is wrong with a stop, red on a terminal, before everything else."""
    click.secho(f"{text}, use the emergency stop circuit", fg="red", bold=True, err=True)


def _words(action: str) -> str:
    return action.replace("-", " ")
