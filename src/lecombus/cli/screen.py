"""What goes to standard output: tables for people, tabs for pipes, JSON for programs.

On a terminal a list of rows becomes a table with headings (rich is imported only then). In a pipe
the same rows are lines of tab-separated cells without headings, so that cut and awk can use them.
A report of several tables says which is which in a pipe, too.
With `--json` exactly one JSON document is printed, with decimals as the daemon wrote them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Self

import click

__all__ = [
    "Styled",
    "age",
    "counted",
    "harmless",
    "mark",
    "on_terminal",
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
        click.echo("\t".join(harmless(" ".join(cell.split())) for cell in row))


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


def harmless(text: str) -> str:
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
        table.add_row(*(Text(harmless(cell), style=mark(cell)) for cell in row))
    Console(file=sys.stdout).print(table)
