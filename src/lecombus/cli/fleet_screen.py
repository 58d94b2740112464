"""Lines of a fleet as rows: what needs attention, worst first, and a table that is kept up to date.

The table fits the terminal: what has no room is counted below it, so that the worst is always seen.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Final, Self

import click

from lecombus.cli.screen import Styled, age, counted, on_terminal, printable, show_rows

if TYPE_CHECKING:
    from rich.console import RenderableType

    from lecombus.bridges.mqtt.summary import Attention
    from lecombus.fleet.lines import FleetLines, LineView

__all__ = ["FleetScreen", "headline", "rows_of", "show_once"]

HEADINGS: Final = ("line", "needs attention", "drive", "why", "for", "drives", "news")

STATES: Final = ("online", "degraded", "starting", "offline", "unknown")
"""The order in which drives are counted; others come behind them."""

DRIVES_NAMED: Final = 3

RED: Final = frozenset(
    ("unknown", "missing", "name-clash", "bridge-offline", "no-news", "daemon-away", "line-lost",
     "line-closed", "trip", "watchdog-missed", "drive-offline", "no-controller")
)  # fmt: skip

NARROW: Final = 90
"""Below this width the last columns are left out."""


def rows_of(view: LineView) -> list[tuple[str, ...]]:
    """Return a line's rows: one for each kind of need, or one that says `ok`."""
    name, drives, news = view.name, drives_text(view.drives), ""
    if view.age_s is not None:
        news = age(view.age_s)
    if not view.needs:
        return [(name, Styled("ok", ""), "", "", "", drives, news)]
    kinds: dict[str, list[Attention]] = {}
    for one in view.needs:
        kinds.setdefault(one.kind, []).append(one)
    rows: list[tuple[str, ...]] = []
    for kind, needs in kinds.items():
        names = [printable(one.drive) for one in needs if one.drive]
        more = len(names) - DRIVES_NAMED
        drive = ", ".join(names[:DRIVES_NAMED]) + (f" and {more} more" if more > 0 else "")
        for_s = max((one.for_s for one in needs if one.for_s is not None), default=None)
        style = "red" if kind in RED else "yellow"
        rows.append(
            (name, Styled(printable(kind.replace("-", " ")), style), drive,
             printable(" ".join(needs[0].text.split())), age(for_s), drives, news)
        )  # fmt: skip
    if view.more:
        rows.append((name, Styled("and more", "yellow"), "", counted(view.more, "further need"), "",
                     drives, news))  # fmt: skip
    return rows


def drives_text(drives: Mapping[str, int]) -> str:
    """Return `4 online, 1 offline`."""
    order = {**dict.fromkeys(STATES), **drives}
    return ", ".join(f"{count} {printable(word)}" for word, count in order.items() if count)


def headline(where: str, lines: FleetLines, views: Sequence[LineView]) -> tuple[str, str]:
    """Return the one sentence that matters, and its style."""
    if lines.why_away:
        away = f"the broker {where} is away ({lines.why_away})"
        return f"{away}: nothing is known of {counted(len(views), 'line')}", "bold red"
    if not views:
        return f"{where} shows no line under {', '.join(lines.prefixes)}", "bold red"
    bad = sum(one.status != "ok" for one in views)
    if bad:
        verb = "needs" if bad == 1 else "need"
        return f"{bad} of {counted(len(views), 'line')} {verb} attention", "bold red"
    return (f"all {len(views)} lines are ok" if len(views) > 1 else "the one line is ok"), ""


def notes(lines: FleetLines, views: Sequence[LineView]) -> list[str]:
    """Return what else stands to be said."""
    from lecombus.fleet.lines import total

    drives = total(views, lambda one: one.drives)
    said = [f"{counted(sum(drives.values()), 'drive')}: {drives_text(drives)}"] if drives else []
    if lines.left_out:
        said.append(f"more than {len(lines)} lines: the others are not followed")
    return said


def show_once(where: str, lines: FleetLines, views: Sequence[LineView]) -> None:
    """Print all lines."""
    text, style = headline(where, lines, views)
    if on_terminal():
        click.secho(text, bold=bool(style), fg="red" if style else None)
        for note in notes(lines, views):
            click.echo(note)
    elif not views:
        click.echo(text, err=True)
    show_rows(HEADINGS, [row for view in views for row in rows_of(view)])


class FleetScreen:
    """The table on a terminal, kept up to date.

    Args:
        where: The broker.
    """

    def __init__(self, where: str) -> None:
        from rich.console import Console
        from rich.live import Live

        self._where = where
        self._console = Console(file=sys.stdout)
        self._live = Live(console=self._console, auto_refresh=False)

    def __enter__(self) -> Self:
        """Begin."""
        self._live.start()
        return self

    def __exit__(self, *exc: object) -> None:
        """Give the terminal back, with the last table on it."""
        self._live.stop()

    def show(self, lines: FleetLines, views: Sequence[LineView]) -> None:
        """Show what is known now."""
        size = shutil.get_terminal_size()
        self._live.update(self._drawn(lines, views, size.columns, size.lines), refresh=True)

    def _drawn(
        self, lines: FleetLines, views: Sequence[LineView], width: int, height: int
    ) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        text, style = headline(self._where, lines, views)
        # The time stands there because the table stays on the terminal after the end.
        text = f"{datetime.now():%H:%M:%S}  {text}"
        said = [Text(text, style=style), *(Text(note) for note in notes(lines, views))]
        room = max(1, height - len(said) - 4)
        rows: list[tuple[str, ...]] = []
        shown = 0
        for view in views:
            found = rows_of(view)
            if rows and len(rows) + len(found) > room:
                break
            rows += found[:room]
            shown += 1
        below = [Text(left_out(views[shown:]))] if shown < len(views) else []
        return Group(*said, table(rows, width), *below, Text())


def left_out(views: Sequence[LineView]) -> str:
    """Return how many lines have no room, and whether they need attention."""
    bad = sum(one.status != "ok" for one in views)
    ok = len(views) - bad
    verb = "needs" if bad == 1 else "need"
    said = [f"{counted(bad, 'more line')} that {verb} attention"] if bad else []
    return ", ".join([*said, *([f"{counted(ok, 'more line')} ok"] if ok else [])])


def table(rows: Sequence[tuple[str, ...]], width: int) -> RenderableType:
    """Return rows as a table of one terminal line each."""
    from rich.table import Table
    from rich.text import Text

    drawn = Table(box=None, pad_edge=False, width=min(width, 200))
    count = len(HEADINGS) if width >= NARROW else 5
    for at, heading in enumerate(HEADINGS[:count]):
        drawn.add_column(
            heading, no_wrap=True, overflow="ellipsis", ratio=1 if heading == "why" else None,
            min_width=4 if at > 1 else 8,
        )  # fmt: skip
    for row in rows:
        cells = [Text(printable(one), style=getattr(one, "style", "")) for one in row[:count]]
        drawn.add_row(*cells)
    return drawn
