"""What the commands of the verbs share: asking the daemon, and showing what it says."""

from __future__ import annotations

from collections.abc import Mapping
from urllib.parse import quote

import click

from lecombus.cli.client import connect
from lecombus.cli.exits import Exit
from lecombus.cli.reports import show_group, show_verb, status_of
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
    """Stop a drive or a group and show how it ended, member by member."""
    with connect(socket, url) as daemon:
        answer = daemon.post("/v1/stop", {"action": action, "target": target})
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    return show_group(answer.data)
