"""Ten lines of different shape, and of which promises the worst case comes within a minute."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lecombus.config import Roster, parse_roster
from support.rosters import Wanted, roster_text

__all__ = ["CASES", "Case"]

EXCHANGE = ("failed exchange", "stop", "stop, loaded")
CLIENTS = ("control", "control, loaded", "interactive", "interactive, loaded")

STATUS = "cyclic: [{code: C0150, every: %s}]"
EXTENDED = "cyclic: [{code: C0039/1, every: 1s}, {code: C0039/2, every: 700ms}]"
"""Codes with subcodes are asked for in extended addressing only."""
FAMILIES = ("820x", "821x", "8200vector", "93xx", "smvector")


@dataclass(frozen=True)
class Case:
    """One line.

    Args:
        name: What is special about it.
        line: Keys of the line.
        drives: Each drive, and more keys of it.
        tight: The promises whose worst case comes in a minute: measured is close to them.
    """

    name: str
    line: str
    drives: tuple[tuple[Wanted, str], ...]
    tight: frozenset[str]

    def text(self, port: str = "sim:") -> str:
        """Give the roster's text."""
        line = f"adapter_latency: 1ms, {self.line}"
        own = {drive[0]: keys for drive, keys in self.drives}
        drives = [drive for drive, _ in self.drives]
        return roster_text(drives, port=port, baud=None, line=line, own=own)

    def roster(self, port: str = "sim:") -> Roster:
        """Give the roster."""
        return parse_roster(self.text(port), f"{self.name}.yaml")


def _drives(
    families: Sequence[str], rest: str = "", watchdog: str = "", first: int = 1
) -> tuple[tuple[Wanted, str], ...]:
    addresses = [address for address in range(first, 100) if address % 10][: len(families)]
    guard = f"watchdog: {{time: {watchdog}, action: quick-stop, configure: true}}, "
    return tuple(
        ((f"d{address}", address, kind), f"{guard if watchdog else ''}{rest}")
        for address, kind in zip(addresses, families, strict=True)
    )


def _in_turn(count: int) -> list[str]:
    return [FAMILIES[number % len(FAMILIES)] for number in range(count)]


NEAR = ", ".join(
    f"{{code: C{code:04}, every: {900 + 2 * at}ms}}"
    for at, code in enumerate((150, 50, 11, 12, 13, 37, 38, 39, 46, 9))
)

CROWDED = (
    Case(
        "20 drives at 9600 baud",
        "baud: 9600, turnaround: 2ms",
        _drives(["93xx"] * 20, "cyclic: []", "1500ms"),
        frozenset(),
    ),
    Case(
        "16 drives at 4800 baud",
        "baud: 4800, turnaround: 2ms",
        _drives(["93xx"] * 16, STATUS % "5s", "2s"),
        frozenset(),
    ),
)
"""Lines on which control takes all that the feeds leave, if it can."""

CASES = (
    Case(
        "one drive",
        "baud: 19200, turnaround: 2ms",
        _drives(["8200vector"], STATUS % "500ms"),
        frozenset({*EXCHANGE, *CLIENTS, "background"}),
    ),
    Case(
        "two at 1200 baud",
        "baud: 1200, turnaround: 0ms",
        _drives(["smvector"] * 2, STATUS % "2s"),
        frozenset({*EXCHANGE, *CLIENTS, "cyclic", "background"}),
    ),
    Case(
        "all families",
        "baud: 19200, turnaround: 2ms",
        _drives(_in_turn(31), STATUS % "2s", "4s"),
        frozenset({*EXCHANGE, "cyclic", "feed distance"}),
    ),
    Case(
        "feeds alone",
        "baud: 9600, turnaround: 2ms",
        _drives(["93xx"] * 12, "cyclic: []", "2s"),
        frozenset({*EXCHANGE, "feed distance"}),
    ),
    Case(
        "full of reads",
        "baud: 9600, turnaround: 2ms",
        _drives(["8200vector"] * 8, STATUS % "400ms"),
        frozenset({*EXCHANGE, *CLIENTS, "cyclic"}),
    ),
    Case(
        "many codes of one drive",
        "baud: 9600, turnaround: 0ms",
        _drives(["8200vector"], f"cyclic: [{NEAR}]"),
        frozenset({*EXCHANGE, *CLIENTS}),
    ),
    Case(
        "extended addressing",
        "baud: 4800, turnaround: 2ms",
        _drives(["93xx"] * 4, EXTENDED),
        frozenset({*EXCHANGE, *CLIENTS, "cyclic"}),
    ),
    Case(
        "820X",
        "baud: 9600, turnaround: 2ms",
        _drives(["820x"] * 8, STATUS % "1s", "3s"),
        frozenset({*EXCHANGE, "cyclic", "feed distance"}),
    ),
    Case(
        "shortest watchdogs",
        "baud: 19200, turnaround: 2ms",
        _drives(["smvector"] * 8, "cyclic: []", "540ms"),
        frozenset({"failed exchange", "stop", "feed distance"}),
    ),
    Case(
        "one short watchdog",
        "baud: 9600, turnaround: 0ms",
        (
            *_drives(["smvector"], "cyclic: []", "400ms"),
            *_drives(["8200vector"] * 9, STATUS % "3s", "8s", first=11),
        ),
        frozenset({*EXCHANGE, "cyclic", "background"}),
    ),
)
