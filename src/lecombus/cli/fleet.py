"""`lecombus fleet`: many lines on one broker, and what needs attention first.

What is known stands in `fleet.lines`; here it is asked for and printed. Nothing is printed as fine
that is not known to be so now: with the broker away every line is `unknown`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from lecombus.cli.arguments import json_option
from lecombus.cli.bridge_commands import extra
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.fleet_broker import (
    CONNECT_WITHIN_S,
    BrokerOptions,
    broker_of,
    broker_options,
    read_once,
)
from lecombus.cli.fleet_screen import FleetScreen, rows_of, show_once
from lecombus.cli.fleet_stop import stop_command
from lecombus.cli.screen import on_terminal

if TYPE_CHECKING:
    from lecombus.fleet.lines import FleetLines, LineView

__all__ = ["fleet_command"]

LOOK_EVERY_S: Final = 1.0


@click.group("fleet", invoke_without_command=True)
@broker_options
@click.option("--once", is_flag=True, help="Show what is known now, and end.")
@click.option(
    "--expect", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Names of lines that must be there, one a line of the file.",
)  # fmt: skip
@json_option
@click.pass_context
def fleet_command(
    ctx: click.Context,
    given: Mapping[str, Any],
    once: bool,
    expect: Path | None,
    as_json: bool,
) -> int:
    """Follow all lines of a broker: which line or drive needs attention, the worst first.

    The lines need the MQTT bridge (`lecombus bridge mqtt`). A line is `ok` only while its bridge
    says so; what is old, lost or not known is never shown as fine. `lecombus fleet stop` stops
    lines.

    On a terminal it follows until Ctrl-C. In a pipe: line, what needs attention (or `ok`), drives,
    why, for how long, drives by state, age of the last news; while it follows, a line's rows when
    they change, with the time before them. With --json: one document with --once; else one a line,
    `kind` `broker` or `line`, whenever something changes. docs/fleet.md describes them.

    Exit status with --once: 0 all lines are ok; 1 something needs attention, or there is no line; 3
    the broker cannot be reached; 4 it does not permit it.
    """
    if ctx.invoked_subcommand is not None:
        ctx.obj = {**given, "as_json": as_json}
        return Exit.DONE
    broker = broker_of(given)
    expected = frozenset() if expect is None else names_in(expect)
    following = extra("lecombus.fleet.following", "mqtt", "aiomqtt", "paho")
    from lecombus.fleet.lines import FleetLines

    lines = FleetLines(broker.prefixes, expected)
    if not once:
        import anyio

        anyio.run(follow, broker, lines, as_json)
        return Exit.DONE
    read_once(broker, lines)
    views = lines.views(following.now_s())
    if as_json:
        click.echo(json.dumps(document_of(broker, lines, views), ensure_ascii=False))
    else:
        show_once(broker.where, lines, views)
    return Exit.DONE if views and all(one.status == "ok" for one in views) else Exit.FAILED


fleet_command.add_command(stop_command)


def names_in(file: Path) -> frozenset[str]:
    """Return the names of lines in a file, one a line; what follows a `#` is left out.

    Raises:
        CommandError: It is not text.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as exc:
        remedy = "name a file with a line's name in each line"
        raise CommandError(Exit.USAGE, f"{file} is not text in UTF-8", remedy) from exc
    rows = (row.partition("#")[0].strip() for row in text.splitlines())
    return frozenset(filter(None, rows))


async def follow(broker: BrokerOptions, lines: FleetLines, as_json: bool) -> None:
    """Show the lines until cancelled."""
    import anyio

    from lecombus.fleet.following import FleetFollower, now_s

    follower = FleetFollower(broker.entry, lines)
    on_screen = on_terminal() and not as_json
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(follower.run)
        with anyio.move_on_after(CONNECT_WITHIN_S):
            await follower.settled.wait()
        if on_screen:
            with FleetScreen(broker.where) as screen:
                while True:
                    screen.show(lines, lines.views(now_s()))
                    await anyio.sleep(LOOK_EVERY_S)
        changes = Changes(broker, as_json=as_json)
        while True:
            changes.show(lines, lines.views(now_s()))
            await anyio.sleep(LOOK_EVERY_S)


class Changes:
    """Prints what changed since the last time.

    Args:
        broker: The broker.
        as_json: Print JSON.
    """

    def __init__(self, broker: BrokerOptions, *, as_json: bool) -> None:
        self._broker = broker
        self._as_json = as_json
        self._marks: dict[str, object] = {}
        self._why: str | None = None

    def show(self, lines: FleetLines, views: Sequence[LineView]) -> None:
        """Print the lines that changed."""
        out = []
        if lines.why_away != self._why:
            self._why = lines.why_away
            out.append(self._broker_said(lines))
        gone = set(self._marks)
        for view in views:
            gone.discard(view.root)
            mark = mark_of(view)
            if self._marks.get(view.root) != mark:
                self._marks[view.root] = mark
                out += self._line_said(view)
        for root in gone:
            del self._marks[root]
            name = root.rpartition("/")[2]
            said = {"kind": "line", "time": time_now(), "line": name, "topics": root,
                    "status": "removed"}  # fmt: skip
            out.append(json.dumps(said) if self._as_json else f"{time_now()}\t{name}\tremoved")
        if out:
            click.echo("\n".join(out))

    def _broker_said(self, lines: FleetLines) -> str:
        if self._as_json:
            said = {"kind": "broker", "time": time_now(), "broker": self._broker.where,
                    "connected": not lines.why_away, "reason": lines.why_away or None}  # fmt: skip
            return json.dumps(said, ensure_ascii=False)
        how = f"away\t\t{lines.why_away}" if lines.why_away else "connected"
        return f"{time_now()}\tbroker {self._broker.where}\t{how}"

    def _line_said(self, view: LineView) -> list[str]:
        if self._as_json:
            said = {"kind": "line", "time": time_now(), **view.document()}
            return [json.dumps(said, ensure_ascii=False)]
        return ["\t".join((time_now(), *row)) for row in rows_of(view)]


def mark_of(view: LineView) -> object:
    """Return what makes a line worth printing again; how long something lasts does not."""
    needs = tuple((one.kind, one.drive, one.text) for one in view.needs)
    return view.status, needs, view.more, tuple(sorted(view.drives.items())), view.host


def document_of(
    broker: BrokerOptions, lines: FleetLines, views: Sequence[LineView]
) -> dict[str, Any]:
    """Return all lines as one document."""
    from lecombus.fleet.lines import total

    ok = sum(one.status == "ok" for one in views)
    return {
        "broker": broker.where, "topics": list(broker.prefixes), "time": time_now(),
        "connected": not lines.why_away, "reason": lines.why_away or None,
        "counts": {"lines": len(views), "ok": ok, "attention": len(views) - ok},
        "drives": total(views, lambda one: one.drives), "ignored": lines.ignored,
        "left_out": lines.left_out, "lines": [one.document() for one in views],
    }  # fmt: skip


def time_now() -> str:
    """Return the time as the daemon writes it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
