"""`lecombus events`: prints what happens on a line, as it happens."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import aclosing, suppress
from datetime import datetime
from typing import TYPE_CHECKING, Final

import click

from lecombus.cli.arguments import DURATION, DaemonOptions, WholeNumber, daemon_options
from lecombus.cli.daemon_access import command_errors, connected
from lecombus.cli.document_rows import Document, cells_of, code_of, quality_of, shown_code, value_of
from lecombus.cli.exits import Exit
from lecombus.cli.screen import on_terminal, printable, table_text
from lecombus.client.connection import text_of
from lecombus.client.errors import ClientError
from lecombus.event_stream import GAP, KINDS

if TYPE_CHECKING:
    from lecombus.client.events import Event

__all__ = ["events_command"]

PATIENCE_S: Final = 60.0


@click.command("events")
@click.option("--drive", "drives", multiple=True, help="Only this drive or group, and the line.")
@click.option(
    "--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Only events of this kind."
)
@click.option("--after", default="", metavar="ID", help="Begin behind this event (--json has ids).")
@click.option("--count", type=WholeNumber(min=1), help="End after so many events.")
@click.option(
    "--wait",
    "patience_s",
    type=DURATION,
    default=PATIENCE_S,
    help="How long the daemon may be away; default: 1min.",
)
@daemon_options
def events_command(
    drives: Sequence[str],
    kinds: Sequence[str],
    after: str,
    count: int | None,
    patience_s: float,
    daemon: DaemonOptions,
) -> int:
    """Print what happens: values that change, states, faults, remarks, what users do, the line.

    --drive and --kind may be given several times. A connection that breaks is opened again, and
    what happened in between follows; where some of it is lost, an event `gap` says how much. Ctrl-C
    ends it. What is known now is shown by `lecombus status`.

    In a pipe: time, kind, drive and what happened in words. With --json: one document a line, with
    `id`, `event` and `data` as docs/api.md describes it.
    """
    import anyio  # no other command that asks needs it

    anyio.run(follow, daemon, (drives, kinds), after, count, patience_s)
    return Exit.DONE


async def follow(
    daemon: DaemonOptions,
    wanted: tuple[Sequence[str], Sequence[str]],
    after: str,
    count: int | None,
    patience_s: float,
) -> None:
    """Print events until there were enough."""
    drives, kinds = wanted
    printed = 0
    async with connected(daemon) as line:
        families: dict[str, str] = {}
        if on_terminal() and not daemon.as_json:
            with suppress(ClientError):  # the events wait for a daemon that is away
                families = {one.name: one.family for one in await line.drives()}
        found = line.events(drives=drives, kinds=kinds, after=after, patience_s=patience_s)
        with command_errors():
            async with aclosing(found) as events:
                async for event in events:
                    click.echo(as_json(event) if daemon.as_json else as_row(event, families))
                    printed += event.kind != GAP
                    if printed == count:
                        return


def as_json(event: Event) -> str:
    """Return an event as one JSON document, its numbers as the daemon wrote them."""
    head = f'"id": {json.dumps(event.id)}, "event": {json.dumps(event.kind)}'
    return f'{{{head}, "data": {text_of(dict(event.data))}}}'


def as_row(event: Event, families: Mapping[str, str]) -> str:
    """Return an event as one line for a person, or as cells in a pipe.

    Args:
        event: The event.
        families: The drives' families, by name: their codes are named as their keypads do.
    """
    data = event.data
    time, text = table_text(data.get("time")), printable(in_words(event, families))
    drive = printable(event.drive)
    if not on_terminal():
        return "\t".join((time, event.kind, drive, text.replace("\t", " ")))
    return f"{local(time):8}  {event.kind:6}  {drive:12}  {text}"


def local(time: str) -> str:
    """Return the hours, minutes and seconds here of a time of the daemon."""
    try:
        return f"{datetime.fromisoformat(time).astimezone():%H:%M:%S}"
    except ValueError:
        return ""


def in_words(event: Event, families: Mapping[str, str]) -> str:
    """Say what happened; a kind that this program does not know is shown as it came."""
    say, data = WORDS.get(event.kind), dict(event.data)
    if say is None:
        return text_of(data)
    if data.get("code"):
        data["code"] = shown_code(families.get(event.drive), code_of(data))
    return say(data)


def value(data: Document) -> str:
    """Say what was read, and what is wrong with it."""
    quality, reason = quality_of(data)
    text = joined(code_of(data), table_text(data.get("name")), value_of(data), data.get("unit"))
    return text if quality == "good" else f"{text} [{': '.join(filter(None, (quality, reason)))}]"


def state(data: Document) -> str:
    """Say how a drive is doing, and what its status words show."""
    if data.get("state") is None:
        return table_text(data.get("reason"))
    shown = ", ".join(str(one).replace("_", " ") for one in data.get("states") or ())
    text = ": ".join(filter(None, (table_text(data.get("state")), table_text(data.get("reason")))))
    return f"{text} ({shown})" if shown else text


def remark(data: Document) -> str:
    """Say a remark, or that it ended."""
    subject, text = cells_of(data, "subject", "text")
    return f"{subject}: {text}" if text else f"{subject}: ended"


def trip(data: Document) -> str:
    """Say a fault, or that it is gone."""
    fault: Document = data.get("fault") or {}
    number = joined(fault.get("keypad"), fault.get("number") and f"({fault['number']})")
    what = ": ".join(filter(None, (joined(fault.get("kind"), number), fault.get("meaning"))))
    return what if data.get("active") else f"{what}: gone"


def write(data: Document) -> str:
    """Say what a user did, how it ended, and who asked."""
    if "count" in data:
        return f"{data['count']} more were not shown"
    by: Document = data.get("by") or {}
    who = by.get("process") or by.get("token") or by.get("client") or by.get("who")
    said = joined(*(data.get(key) for key in ("action", "verb", "code", "value", "written")))
    reason = data.get("reason")
    text = f"{joined(data.get('what'), said)}: {data.get('outcome')}, by {who}"
    return f"{text}: {reason}" if reason else text


def lease(data: Document) -> str:
    """Say what happened to a lease, and to which drives."""
    number = data.get("number") and f"({data['number']})"
    why = data.get("end") or data.get("reason")
    text = joined(data.get("what"), data.get("lease"), number, ", ".join(data.get("drives") or ()))
    return f"{text}: {why}" if why else text


def line(data: Document) -> str:
    """Say how the line is doing, or which row of the journal is the newest."""
    if data.get("journal"):
        return f"the journal ends at row {table_text(data['journal'])}"
    return ": ".join(filter(None, cells_of(data, "state", "reason")))


def gap(data: Document) -> str:
    """Say how many events are missing."""
    missed = data.get("missed")
    count = {None: "some events are", 1: "1 event is"}.get(missed, f"{missed} events are")
    return f"{count} missing: {data.get('reason')}; `lecombus status` shows what is known"


def joined(*words: object) -> str:
    """Return the words that say something."""
    return " ".join(str(word) for word in words if word not in (None, ""))


WORDS: Final = {
    "value": value, "state": state, "remark": remark, "trip": trip, "write": write, "lease": lease,
    "line": line,
    GAP: gap,
}  # fmt: skip
