"""How long work goes on: a bar on a terminal, silence in a pipe.

The bar goes to standard error, so that standard output stays what a command was asked for. Lines
worth reading (a line that was lost, a code that was refused) are shown in both, but not in JSON.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import click

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Bar", "progress"]

WIDTH: Final = 30


class Bar:
    """A listener that shows how far the work is.

    Args:
        bar: The bar; None: nothing is shown.
        task: Its one task.
        quiet: Say nothing at all.
    """

    def __init__(self, bar: Progress | None, task: TaskID | None, *, quiet: bool) -> None:
        self._bar = bar
        self._task = task
        self._quiet = quiet

    def advance(self, done: int, total: int) -> None:
        """Move the bar."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, total=total)

    def say(self, text: str) -> None:
        """Say a line above the bar."""
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False)
        else:
            click.echo(text, err=True)


@contextmanager
def progress(title: str, *, quiet: bool = False) -> Iterator[Bar]:
    """Show a bar while the block runs, where somebody looks.

    Args:
        title: What is going on.
        quiet: Say nothing at all, as for JSON.
    """
    if quiet or not sys.stderr.isatty():
        yield Bar(None, None, quiet=quiet)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(WIDTH), MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield Bar(bar, bar.add_task(title, total=None), quiet=False)
