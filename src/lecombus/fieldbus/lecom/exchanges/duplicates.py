"""Answers without a request (second answers), and the drive from which each was requested last.

An answer carries no address. Where answers are delivered twice, or two drives have one address, the
second answer comes when another drive may have been asked for the same, and passes for its own.
`late_replies` keeps answers that are missing; a second answer is not missing. It is only known that
such answers come, and how long ago another drive was asked for an answer that looks the same.
`read_back_proof` derives from both how many answers a verification needs.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from lecombus.fieldbus.loop_interface import SecondAnswerCount

__all__ = ["COPY_S", "Duplicates"]

COPY_S: Final = 3.0
"""A second answer may come so long after the first, seconds."""

DOUBTED_S: Final = 60.0
"""For this long after a second answer, a single answer does not verify anything, seconds."""

LATELY_S: Final = 0.3
"""Two drives at one address answer within this time of each other, seconds."""


class Duplicates:
    """Keeps from which drive each answer was requested, and the answers without a request.

    Answers are distinguished by their code field (`protocol.exchange.Ask.field`).
    """

    def __init__(self) -> None:
        self._last: dict[bytes, tuple[str, float]] = {}
        self._other: dict[bytes, float] = {}  # when it was asked last of another than `_last`
        self._lately: deque[tuple[float, bytes, str]] = deque()
        self._second: deque[tuple[float, str | None]] = deque(maxlen=1000)

    def asked(self, field: bytes, drive: str, at_s: float) -> None:
        """Note that a drive is asked for an answer that looks like this."""
        last = self._last.get(field)
        if last is not None and last[0] != drive:
            self._other[field] = last[1]
        self._last[field] = (drive, at_s)
        self._lately.append((at_s, field, drive))
        while self._lately[0][0] < at_s - LATELY_S:
            self._lately.popleft()

    def other_s(self, field: bytes, drive: str) -> float:
        """Return when another drive was last asked for such an answer; minus infinity: never."""
        last = self._last.get(field)
        if last is not None and last[0] != drive:
            return last[1]
        return self._other.get(field, float("-inf"))

    def may_be_anothers(self, field: bytes, drive: str, asked_s: float) -> bool:
        """Whether an answer that a drive was asked for may be the second one of another drive."""
        return self.doubtful(asked_s) and asked_s - self.other_s(field, drive) < COPY_S

    def came(self, field: bytes, at_s: float) -> None:
        """Record an answer without an open request."""
        whose = {name for asked_s, one, name in self._lately
                 if one == field and asked_s >= at_s - LATELY_S}  # fmt: skip
        self._second.append((at_s, whose.pop() if len(whose) == 1 else None))

    def doubtful(self, now_s: float) -> bool:
        """Whether a single answer may be another drive's: a second answer came lately."""
        return bool(self._second) and now_s - self._second[-1][0] < DOUBTED_S

    def found(self, now_s: float) -> SecondAnswerCount:
        """Count the second answers of the last minute."""
        while self._second and now_s - self._second[0][0] >= DOUBTED_S:
            self._second.popleft()
        alone: dict[str, int] = {}
        for _, name in self._second:
            if name is not None:
                alone[name] = alone.get(name, 0) + 1
        return len(self._second), alone
