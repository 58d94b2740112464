"""Second answers in a scan: from a second drive at an address, or delivered twice.

The line counts them (`exchange_loop.second_answers`). Where it is certain, it says after whose
answers they came. If far more of them come after the answers of one drive than of the others, two
drives have its address. Otherwise the line may be the cause.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import anyio

from lecombus.cli.own_line import OwnLine

__all__ = ["SECOND_WITHIN_S", "SecondAnswers"]

SECOND_WITHIN_S: Final = 0.5
"""The time in which a line expects late answers."""

LEAST: Final = 3
"""So many are no chance, as where a daemon remarks them; two where a drive answered no more often.
"""

TIMES: Final = 4
"""So many times as often as behind the answers of the others: less may be the line."""

Place = tuple[int, int]
"""An address and a baud rate."""


@dataclass(slots=True)
class SecondAnswers:
    """The second answers of a scan.

    Args:
        most: How many there were at once, within a minute.
        behind: How many of them came behind the answers of one drive.
        answers: How often a drive answered.
    """

    most: int = 0
    behind: dict[Place, int] = field(default_factory=dict)
    answers: Counter[Place] = field(default_factory=Counter)

    def look(self, own: OwnLine, baud: int) -> None:
        """Take what the line has counted by now; it keeps a minute of that."""
        found = own.worker.exchange_loop.second_answers(anyio.current_time())
        self.most = max(self.most, found.total)
        for name, number in found.alone.items():
            place = int(name.rpartition(" ")[2]), baud  # `read_address` says `address 12`
            self.behind[place] = max(self.behind.get(place, 0), number)

    def shared_addresses(self) -> Mapping[Place, str]:
        """Return what is said of each drive that shares its address."""
        known, answers = sum(self.behind.values()), self.answers.total()
        found = {}
        for place, count in self.behind.items():
            own = self.answers[place]
            is_more = count * (answers - own) >= TIMES * (known - count) * own
            if is_more and (count >= LEAST or count == own == LEAST - 1):
                found[place] = (
                    f"two drives at address {place[0]}? {count} second answers came after its "
                    "own: give one of the two another address"
                )
        return found

    def unexplained(self) -> str:
        """Return what is said where it is not clear what they come from; empty: nothing."""
        if self.most < LEAST:
            return ""
        places = ", ".join(str(address) for address, _ in sorted(self.behind))
        behind = f", behind those of address {places}" if places else ""
        return (
            f"{self.most} answers came that nobody asked for{behind}: two drives at one address, "
            "an adapter or device server that delivers twice, or another master"
        )
