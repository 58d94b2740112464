"""The bar on standard error that shows how far long work has come.

It is shown on a terminal only. Standard output stays the command's result. Lines for the user, such
as a lost line or a refused code, are shown in a pipe too, except with JSON.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Bar", "progress"]


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
