"""A drive that answers at once, for backups and restores without line, daemon and time.

It has codes with texts, does what its test says on the way (loses the line, is enabled by somebody
else, refuses), and counts every write.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from lecombus.backups import NotUsable, ReadAttempt, WriteAttempt
from lecombus.drives import Family, family
from lecombus.parameters import Code, Value

__all__ = ["Ear", "FakeDrive"]

INHIBITED, ENABLED = {150: "H0080", 40: "0"}, {150: "H0000", 40: "1"}


@dataclass
class Ear:
    """A listener that remembers."""

    said: list[str] = field(default_factory=list)
    advanced: list[tuple[int, int]] = field(default_factory=list)

    def advance(self, done: int, total: int) -> None:
        self.advanced.append((done, total))

    def say(self, text: str) -> None:
        self.said.append(text)


@dataclass
class FakeDrive:
    """A drive behind `DriveAccess`.

    Args:
        kind: Its family's name.
        texts: What its codes read, as on the wire.
    """

    kind: str
    texts: dict[int, str]
    writes: list[tuple[str, str]] = field(default_factory=list)
    away: str = ""
    back_after: int = 1
    clock_s: float = 0.0
    before_write: Callable[[FakeDrive, Code], None] = lambda drive, code: None
    after_write: Callable[[FakeDrive, Code], None] = lambda drive, code: None
    before_read: Callable[[FakeDrive, Code], None] = lambda drive, code: None
    refuses: Callable[[FakeDrive, Code, Value], str] = lambda drive, code, value: ""
    pauses: int = 0
    stopped: bool = False
    is_offline: bool = False

    def __post_init__(self) -> None:
        self.texts.update({**INHIBITED, **{k: v for k, v in self.texts.items() if k in (40, 150)}})

    @property
    def family(self) -> Family:
        return family(self.kind)

    def lose(self, back_after: int = 1) -> None:
        """Go away; be back after so many looks."""
        self.away, self.back_after = "the line is lost", back_after

    def is_away(self) -> bool:
        return bool(self.away)

    def enable_it(self) -> None:
        self.texts.update(ENABLED)

    async def read(self, code: Code) -> ReadAttempt:
        self.before_read(self, code)
        if self.is_away():
            return ReadAttempt(code, None, "line-lost", self.away)
        raw = self.texts.get(code.number) if code.subcode == 0 else None
        if raw is None:
            return ReadAttempt(code, None, "no-such-code", f"there is no {code}")
        return ReadAttempt(code, Value.parse(raw))

    async def read_many(self, codes: Sequence[Code], heard: Callable[[ReadAttempt], None]) -> None:
        for code in codes:
            heard(await self.read(code))

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        self.before_write(self, code)
        if self.stopped:
            return WriteAttempt(False, "superseded", "ended by a stop of the drive")
        if self.is_away():
            return WriteAttempt(False, "line-lost", self.away)
        why = self.refuses(self, code, value)
        if why:
            return WriteAttempt(False, "nak", why)
        self.writes.append((str(code), value.raw))
        self.texts[code.number] = value.raw
        self.after_write(self, code)
        if self.is_away():
            return WriteAttempt(False, "unknown", "the answer was lost")
        return WriteAttempt(True)

    async def inhibit(self) -> WriteAttempt:
        self.writes.append(("inhibit", ""))
        self.texts.update(INHIBITED)
        return WriteAttempt(True)

    async def enable(self) -> WriteAttempt:
        self.writes.append(("enable", ""))
        self.enable_it()
        return WriteAttempt(True)

    async def why_not_usable(self) -> NotUsable | None:
        if self.away:
            self.back_after -= 1
            if self.back_after < 0:
                self.away = ""
        return NotUsable(self.away, self.is_offline) if self.away else None

    async def pause(self, for_s: float) -> None:
        self.pauses += 1
        self.clock_s += for_s

    def now_s(self) -> float:
        return self.clock_s
