"""What the demo shows: a table on a terminal, plain lines in a pipe.

Only the store is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from lecombus.config import Roster
from lecombus.drive_state.readings import Quality, Reading
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live
    from rich.table import Table

__all__ = ["View"]

SHOWN = {"frequency": Code(50), "status word": Code(150)}


class View:
    """Shows a runtime again and again.

    Args:
        out: Where to.
        roster: What is shown.
        socket: The API's Unix socket, named in the headline.
    """

    def __init__(self, out: TextIO, roster: Roster, socket: Path) -> None:
        self._out = out
        self._headline = headline(roster, socket)
        self._live: Live | None = None
        self._said = ""
        if out.isatty():
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(file=out), auto_refresh=False)
            self._live.start()
        else:
            print(self._headline, file=out, flush=True)

    def show(self, runtime: LineRuntime) -> None:
        """Show what is known now."""
        rows = [row(runtime, info.name) for info in runtime.store.drives()]
        counts = f"{runtime.worker.exchanges} exchanges, {runtime.store.line().state.value}"
        if self._live is not None:
            self._live.update(screen(f"{self._headline}\n{counts}", rows, self._said), refresh=True)
            return
        for cells in rows:
            print("  ".join(f"{cell:<12}" for cell in cells).rstrip(), file=self._out)
        print(f"-- {counts}", file=self._out, flush=True)

    def say(self, text: str) -> None:
        """Show something that went wrong."""
        self._said = text
        if self._live is None:
            print(text, file=self._out, flush=True)

    def leave(self) -> None:
        """Give the terminal back, with the last table on it."""
        if self._live is not None:
            self._live.stop()

    def say_goodbye(self) -> None:
        """Say what was done at the end."""
        print("all drives inhibited, port closed, good-bye", file=self._out, flush=True)


def headline(roster: Roster, socket: Path) -> str:
    """Say where the running demo can be reached."""
    http = roster.api.http
    return (
        f"lecombus demo: {len(roster.drives)} simulated drives at {roster.line.baud} baud; "
        f"Ctrl-C ends it\nmetrics: http://{http}/metrics   values: http://{http}/v1/drives\n"
        f"commands: lecombus status --socket {socket}"
    )


def row(runtime: LineRuntime, name: str) -> list[str]:
    """The cells of one drive."""
    info = runtime.store.drive(name)
    family = runtime.store.family(name)
    readings = [runtime.store.reading(name, code) for code in SHOWN.values()]
    frequency, word = readings
    return [
        name,
        family.name,
        info.state.value,
        cell(frequency),
        cell(word),
        ", ".join(named_bits(runtime, name, word)),
    ]


def cell(reading: Reading | None) -> str:
    """One value with its unit; what is not good is not shown as if it were."""
    if reading is None or reading.value is None:
        return "-"
    text = f"{reading.value.raw} {reading.unit or ''}".strip()
    return text if reading.quality is Quality.GOOD else f"({text}, {reading.quality.value})"


def named_bits(runtime: LineRuntime, name: str, word: Reading | None) -> list[str]:
    """The bits of the status word that are set and have a name."""
    if word is None or word.value is None or not isinstance(word.value.number, int):
        return []
    bits = runtime.store.family(name).status_bits(word.code, word.value.number)
    return [bit.replace("_", " ") for bit, is_set in bits.items() if is_set]


def screen(title: str, rows: list[list[str]], said: str) -> Group:
    """Draw everything; the empty last line is where the terminal writes the `^C` of a Ctrl-C.

    Behind the end of the table it would begin a new line, and the table would be drawn one line
    lower than where it stands.
    """
    from rich.console import Group
    from rich.text import Text

    return Group(table(title, rows, said), Text())


def table(title: str, rows: list[list[str]], said: str) -> Table:
    """Draw the rows for a terminal."""
    from rich.table import Table

    # Without lines, so that five drives fit 80 columns and 24 lines.
    drawn = Table(title=title, caption=said or None, title_justify="left", box=None, pad_edge=False)
    for head in ("drive", "family", "state", *SHOWN, "bits set"):
        drawn.add_column(head)
    for cells in rows:
        drawn.add_row(*cells)
    return drawn
