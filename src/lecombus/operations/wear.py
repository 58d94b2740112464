"""Wear: writes that a drive's memory takes a limited number of, counted and limited.

82XX drives store a parameter at every write, SMVectors too; a 93XX wears when it saves. Memory of
this kind takes some hundred thousand writes. So a stored parameter is written only when it reads
otherwise (`writes`), and no oftener than the roster allows: a token bucket for each drive
and code. Setpoints and control words are not stored and not limited.

Every write that may have reached the memory counts, also one whose answer was lost and those of the
supervisor. Codes that nothing describes are counted where the family stores what is written; they
are not limited, because it is not known what they are.
Source: EDB2102EN 6.1.1 (82XX store every write), 6.1.3 (93XX store by C0003); CMVLC401A 4.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

from lecombus.drive_state.drive_runtime import Drive, LineDrives
from lecombus.drive_state.readings import seconds
from lecombus.drives import Family, Storage, WriteClass
from lecombus.durations import format_duration
from lecombus.errors import CodeValueError, OperationError
from lecombus.line_events import ExchangeEvent
from lecombus.parameters import Code, Json
from lecombus.saved_state import State

__all__ = ["CodeWear", "Wear", "WearReport", "wears"]


@dataclass(frozen=True, slots=True)
class CodeWear:
    """How often one code was written.

    Args:
        code: The code, as text.
        name: What the family calls it; empty where nothing describes it.
        writes: Writes that may have reached the memory, since the first start.
        to_this_device: Those since the present device was accepted in place of another.
        wait_s: How long until it may be written again, seconds; 0: now.
    """

    code: str
    name: str
    writes: int
    to_this_device: int
    wait_s: float

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "code": self.code,
            "name": self.name,
            "writes": self.writes,
            "to_this_device": self.to_this_device,
            "wait_s": seconds(self.wait_s),
        }


@dataclass(frozen=True, slots=True)
class WearReport:
    """How often a drive's memory was written.

    Args:
        drive: Its name.
        burst: Writes of one code that may follow each other.
        every_s: Seconds until one more may follow; 0: no limit.
        codes: What was written, the most first.
    """

    drive: str
    burst: int
    every_s: float
    codes: tuple[CodeWear, ...]

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "burst": self.burst,
            "every_s": seconds(self.every_s),
            "codes": [one.as_json() for one in self.codes],
        }


class Wear:
    """Counts and limits what wears the drives' memories.

    Args:
        state: Where counts are kept.
        drives: The drives.
        clock: Monotonic time, seconds.
    """

    def __init__(self, state: State, drives: LineDrives, clock: Callable[[], float]) -> None:
        self._state = state
        self._drives = drives
        self._clock = clock

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Count a write that may have reached the memory of its drives."""
        if event.is_write:
            for drive in event.drives:
                if counts(drive.family, event.code):
                    self._state.count(drive.name, str(event.code))

    def check(self, drive: str, code: Code) -> None:
        """Refuse a write that would come too soon.

        Raises:
            OperationError: `too-many-writes`, with when it may again.
        """
        wait_s = self._wait_s(drive, code)
        if wait_s <= 0.0:
            return
        found = self._drives.get(drive)
        limit, named = found.entry.stored_writes, found.family.spoken(code)
        raise OperationError(
            f"{named} of {drive} is stored in the drive at every write, and was written "
            f"{'once' if limit.burst == 1 else f'{limit.burst} times'} in a short time",
            kind="too-many-writes",
            drive=drive,
            code=str(code),
            remedy=f"it may be written again in {_rounded(wait_s)}, then once in "
            f"{format_duration(limit.every_s)}; a value that changes often belongs into a "
            "setpoint; `stored_writes` in the roster sets the limit",
            retry_after_s=wait_s,
        )

    def take(self, drive: str, code: Code) -> None:
        """Count a write against the limit.

        Raises:
            OperationError: `too-many-writes`.
        """
        self.check(drive, code)
        found = self._drives.get(drive)
        if not wears(found.family, code):
            return
        now, full_at_s = self._clock(), found.lasting.full_at_s
        start_s = max(now, full_at_s.get(code, now))
        full_at_s[code] = start_s + found.entry.stored_writes.every_s

    def report(self, drive: str) -> WearReport:
        """Return how often a drive's memory was written.

        Raises:
            OperationError: `no-such-drive`.
        """
        found = self._drives.get(drive)
        family, limit = found.family, found.entry.stored_writes
        facts = self._state.drive(drive)
        codes = []
        for text, count in sorted(facts.writes.items(), key=lambda item: (-item[1], item[0])):
            code = _code_of(text)
            info = None if code is None else family.info(code)
            codes.append(
                CodeWear(
                    text,
                    info.name if info else "",
                    count,
                    count - facts.writes_before.get(text, 0),
                    0.0 if code is None else self._wait_s(drive, code),
                )
            )
        return WearReport(drive, limit.burst, limit.every_s, tuple(codes))

    def figures(self, names: Iterable[str]) -> Mapping[str, Mapping[str, int]]:
        """Return the counts for the metrics, by drive and described code; the rest as `other`.

        Args:
            names: The drives, in the order in which they shall stand.
        """
        return {name: dict(self._figures_of(self._drives.get(name))) for name in names}

    def _figures_of(self, drive: Drive) -> Iterator[tuple[str, int]]:
        family, other = drive.family, 0
        for text, count in self._state.drive(drive.name).writes.items():
            code = _code_of(text)
            if code is not None and family.info(code) is not None:
                yield text, count
            else:
                other += count
        yield "other", other

    def _wait_s(self, drive: str, code: Code) -> float:
        """How long until the bucket holds a whole write again, seconds.

        The bucket is kept as the moment at which it will be full.
        """
        found = self._drives.get(drive)
        limit = found.entry.stored_writes
        full_at_s = found.lasting.full_at_s.get(code, 0.0)
        return max(0.0, full_at_s - (limit.burst - 1) * limit.every_s - self._clock())


def wears(family: Family, code: Code) -> bool:
    """Whether every write of a code goes into the drive's memory, as far as is described."""
    info = family.info(code)
    if info is None:
        return False
    if info.write_class is WriteClass.SAVE:
        return True
    return info.storage is Storage.STORED and family.saved_by is None


def counts(family: Family, code: Code) -> bool:
    """Whether a write of a code is counted: it wears, or may do so for all that is known."""
    if family.info(code) is not None:
        return wears(family, code)
    return bool(family.codes) and family.saved_by is None


@lru_cache(maxsize=4096)
def _code_of(text: str) -> Code | None:
    try:
        return Code.parse(text)
    except CodeValueError:
        return None


def _rounded(wait_s: float) -> str:
    """Write a time as a person would: a second more or less does not matter, too early does."""
    return format_duration(float(int(wait_s) + 1))
