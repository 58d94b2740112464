"""`lecombus accept`: another drive in the place of the one that was there."""

from __future__ import annotations

from urllib.parse import quote

import click

from lecombus.cli.arguments import CODE, daemon_options
from lecombus.cli.client import Daemon, connect
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.reports import Document
from lecombus.cli.screen import on_terminal, show_rows, table_text
from lecombus.protocol import Code

__all__ = ["command"]


class _SeenType(click.ParamType[tuple[str, str]]):
    name = "seen"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        if isinstance(value, tuple):
            return value
        code, equals, text = str(value).partition("=")
        if not equals or not text:
            self.fail(f"`{value}` is no CODE=VALUE, such as C1810=33S2102I_10000", param, ctx)
        found = CODE.convert(code, param, ctx)
        assert isinstance(found, Code)
        return str(found), text


@click.command("accept")
@click.argument("drive")
@click.option(
    "--seen", type=_SeenType(), multiple=True, metavar="CODE=VALUE",
    help="What differs, as you have seen it; instead of being asked. Once for each code.",
)  # fmt: skip
@daemon_options
def command(
    drive: str,
    seen: tuple[tuple[str, str], ...],
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Accept the device that answers at DRIVE's address as DRIVE, after a replacement.

    Shows the old and the new identity, and asks. Until then only stops are sent to it. In a
    pipe, or with --json, there is no question: repeat every value that differs with --seen.
    """
    with connect(socket, url) as daemon:
        path = f"/v1/drives/{quote(drive, safe='')}"
        known: Document = daemon.get(f"{path}/identity").data
        found, accepted = dict(known.get("found") or {}), dict(known.get("accepted") or {})
        differing = {code: text for code, text in found.items() if accepted.get(code) != text}
        if not seen and not as_json:
            rows = [
                (code, accepted.get(code, ""), found.get(code, ""))
                for code in dict.fromkeys((*accepted, *found))
            ]
            show_rows(("code", "was", "is"), rows, title=drive)
        if not differing and found:
            if not known.get("problem"):
                _ask_again(daemon, drive, found)
            if as_json:
                click.echo(daemon.get(f"{path}/identity").text)
            else:
                click.echo(table_text(known.get("problem")) or f"{drive} is the drive it was")
            return Exit.FAILED if known.get("problem") else Exit.DONE
        _make_sure(drive, differing, dict(seen), may_ask=on_terminal() and not as_json)
        answer = daemon.post(f"{path}/accept", {"identity": found})
    if as_json:
        click.echo(answer.text)
    else:
        click.echo(f"{drive} is accepted; it is audited now, then it may be written to")
    return Exit.DONE


def _ask_again(daemon: Daemon, drive: str, found: dict[str, str]) -> None:
    """Ask the drive itself before it is called the one it was: its audit may be long ago."""
    path = f"/v1/drives/{quote(drive, safe='')}"
    for code in found:
        daemon.get(f"{path}/codes/{code}", fresh="true")
    known = dict(daemon.get(f"{path}/identity").data.get("found") or {})
    state: Document = daemon.get(path).data
    if known != found or state.get("state") != "online":
        what = f"{drive} is {table_text(state.get('state'))}: {table_text(state.get('reason'))}"
        raise CommandError(Exit.FAILED, Problem(what, "repeat this when it is online"))


def _make_sure(
    drive: str, differing: dict[str, str], seen: dict[str, str], *, may_ask: bool
) -> None:
    """See that whoever accepts has seen what is accepted."""
    if not differing:
        return  # nothing was read of it: the daemon says why
    if seen:
        wrong = [code for code in {**differing, **seen} if differing.get(code) != seen.get(code)]
        if wrong:
            right = " ".join(f"--seen {code}={text}" for code, text in differing.items())
            what = f"what was seen of {', '.join(sorted(wrong))} is not what differs"
            raise CommandError(Exit.USAGE, Problem(what, f"look again: it is {right}"))
        return
    if not may_ask:
        right = " ".join(f"--seen {code}={text}" for code, text in differing.items())
        what = f"{drive} is not accepted without being looked at"
        raise CommandError(Exit.USAGE, Problem(what, f"if this is right: {right}"))
    if not click.confirm(f"Is this the drive that {drive} shall be from now on?"):
        raise CommandError(Exit.FAILED, Problem("nothing was accepted"))
