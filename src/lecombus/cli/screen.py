"""What a command prints: tables for people, tabs for pipes, JSON for programs.

On a terminal a list of rows becomes a table with headings (rich is imported only then). In a pipe
the same rows are lines of tab-separated cells without headings, so that cut and awk can use them.
A report of several tables says which is which in a pipe, too.
With `--json` exactly one JSON document is printed, with decimals as the daemon wrote them.

On standard error a bar shows how far long work has come, on a terminal only. Lines for the user,
such as a lost line or a refused code, are shown in a pipe too, except with JSON.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

import click

from lecombus.cli.exits import CommandError, Exit

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = [
    "Bar",
    "Styled",
    "age",
    "can_ask",
    "counted",
    "forget_terminal",
    "make_sure",
    "mark",
    "on_terminal",
    "printable",
    "progress",
    "show_rows",
    "show_table",
    "table_text",
]

_STYLES: Mapping[str, str] = {
    "good": "green", "online": "green", "open": "green", "done": "green", "verified": "green",
    "stale": "yellow", "degraded": "yellow", "starting": "yellow", "unknown": "yellow",
    "bad": "red", "offline": "red", "lost": "red", "closed": "red", "refused": "red",
    "expired": "red", "superseded": "yellow",
}  # fmt: skip


def on_terminal() -> bool:
    """Return whether standard output is a terminal."""
    return sys.stdout.isatty()


def can_ask() -> bool:
    """Return whether a person is in front of this command, to be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def forget_terminal() -> None:
    """Let what is printed go nowhere if its terminal is gone; a file or a pipe still gets it."""
    for descriptor in (1, 2):
        try:
            termios.tcgetattr(descriptor)
        except termios.error as exc:
            if exc.args[0] != errno.EIO:  # it is not a terminal
                continue
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, descriptor)
            os.close(nowhere)


def make_sure(question: str, *, as_json: bool) -> None:
    """Ask before something is written.

    Raises:
        CommandError: The user cannot be asked, or the answer was no.
    """
    if as_json or not can_ask():
        raise CommandError(
            Exit.USAGE,
            "there is no terminal to ask at; nothing was written",
            "repeat it with --yes",
        )
    if not click.confirm(question):
        raise CommandError(Exit.FAILED, "nothing was written")


def show_rows(headings: Sequence[str], rows: Iterable[Sequence[str]], *, title: str = "") -> None:
    """Print rows: a table on a terminal, tab-separated lines in a pipe.

    Args:
        headings: One for each column.
        rows: As many cells as headings in each.
        title: Stands above the table, on a terminal only.
    """
    if on_terminal():
        if title:
            click.echo(title)
        _show_table(headings, rows)
        return
    for row in rows:
        click.echo("\t".join(printable(" ".join(cell.split())) for cell in row))


def show_table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, title: str) -> None:
    """Print one of several tables: with title and headings, also in a pipe, where several follow.

    Args:
        headings: One for each column.
        rows: As many cells as headings in each.
        title: Stands above the table.
    """
    click.echo()
    if on_terminal():
        show_rows(headings, rows, title=title)
        return
    click.echo(title)
    show_rows(headings, (headings, *rows))


def table_text(value: object) -> str:
    """Return a JSON value as a cell; nothing is an empty cell."""
    if value is None:
        return ""
    return str(value)


def printable(text: str) -> str:
    """Return a text whose control characters are shown, not sent to the terminal."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one == "\n" else ascii(one)[1:-1] for one in text)


class Styled(str):
    """A cell that is shown in the given style, on a terminal only.

    Args:
        text: The cell.
        style: Such as `red`; empty for none.
    """

    __slots__ = ("style",)
    style: str

    def __new__(cls, text: str, style: str) -> Self:
        """Make it: a string cannot be changed after that."""
        cell = super().__new__(cls, text)
        cell.style = style
        return cell


def mark(word: str) -> str:
    """Return the style of a state, quality or outcome, or its own; empty where it has none."""
    if isinstance(word, Styled):
        return word.style
    return _STYLES.get(word, "")


def counted(number: int, noun: str) -> str:
    """Return `1 code` or `5 codes`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def age(seconds: object) -> str:
    """Return an age in words, such as `0.4 s`, `3 min`, `2 h`, `5 d`.

    Args:
        seconds: A number of seconds as it stands in a document, or None.
    """
    if seconds is None:
        return ""
    number = float(str(seconds))
    for factor, unit in ((86400, "d"), (3600, "h"), (60, "min")):
        if number >= 2 * factor:
            return f"{number / factor:.0f} {unit}"
    return f"{number:.1f} s"


def _show_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(cell), style=mark(cell)) for cell in row))
    Console(file=sys.stdout).print(table)


class Bar:
    """A listener that shows how far the work is.

    Args:
        bar: The bar; None: it is not shown.
        task: Its one task.
        quiet: Do not print lines either.
    """

    def __init__(self, bar: Progress | None, task: TaskID | None, *, quiet: bool) -> None:
        self._bar = bar
        self._task = task
        self._quiet = quiet

    def advance(self, done: int, total: int, title: str | None = None) -> None:
        """Move the bar; `title`: change the text beside it."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, total=total, description=title)

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
        else:
            click.echo(text, err=True)


@contextmanager
def progress(title: str, *, quiet: bool = False, counts: bool = True) -> Iterator[Bar]:
    """Show a bar on a terminal while the block runs.

    Args:
        title: What the work is.
        quiet: Print nothing at all, as for JSON.
        counts: Show `3/20` behind the bar; otherwise the title stands there.
    """
    if quiet or not sys.stderr.isatty():
        yield Bar(None, None, quiet=quiet)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(30), MofNCompleteColumn()) if counts else (BarColumn(24), text)
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield Bar(bar, bar.add_task(title, total=None), quiet=False)
