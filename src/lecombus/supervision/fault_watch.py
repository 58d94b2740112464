"""Which fault each drive has now: shown by its status words, named by its fault memory.

A fault is active only when a status word says so; what stands in the fault memory may be years
old. So the words decide whether there is one, and when one rises the memory is read at once, for
its number: whoever looks shall not wait for the memory's own slow turn. The number is taken only
if it agrees with what the words say (the kind; where the memory holds LECOM numbers, C0068's tens
digit). A value that is no whole number is none: nothing says how it would be read.

Strategy: no task and no timer. `seen` is called with every value read, costs two look-ups when
nothing changed, and asks for the few reads that a change calls for; their values come back the
same way. A word that shows a fault holds it until that word itself shows it gone: when another
word shows that first, the one left over is read again at once. Source: EDB2102EN 8.2 (C0068,
C0150, C0161..C0168); CMVLC401A table 9, 9.1.

What must not live here: what a number means (`drives.faults`), who shows it (store, faces).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field

from lecombus.drives import Family
from lecombus.drives.faults import NO_FAULT, FaultKind, FaultTable, fits_digit
from lecombus.errors import LecombusError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import ActiveFault
from lecombus.schedule import Outcome, Settle
from lecombus.store import Store

__all__ = ["FAULT_REMARK", "FaultWatch"]

logger = logging.getLogger(__name__)

FAULT_REMARK = "fault"
FAULT_DIGIT = "fault_digit"
OPERATING_STATUS = Code(68)

TRIES = 3
"""How often the memory is asked for the number of one fault besides its own slow turn."""

RANK = {None: 0, FaultKind.WARNING: 1, FaultKind.MESSAGE: 2, FaultKind.TRIP: 3}

Ask = Callable[[str, Code, Settle], None]
"""Reads a code of a drive now; raises a `LecombusError` where that cannot be asked."""


@dataclass(slots=True)
class _Watched:
    """One drive.

    Args:
        family: Its description.
        raw: The status words as last read.
        shows: What each status word last showed.
        kind: The worst of these.
        since_s: When that rose, Unix seconds.
        number: The fault's number, once the memory gave one that agrees.
        digit: The tens digit last read while a fault was shown.
        candidate: What the memory last held while a fault was shown.
        tries: How often the memory was asked.
        looks: How often words that contradict each other were read again.
        asking: A read of the memory is under way.
        logged: This fault stands in the log already.
    """

    family: Family
    raw: dict[Code, str] = field(default_factory=dict)
    shows: dict[Code, FaultKind | None] = field(default_factory=dict)
    kind: FaultKind | None = None
    since_s: float = 0.0
    number: int | None = None
    digit: int = 0
    candidate: int | None = None
    tries: int = 0
    looks: int = 0
    asking: bool = False
    logged: bool = False


class FaultWatch:
    """Tells the store which fault each drive has.

    Args:
        store: Told.
        ask: Reads a code now.
        wall: The time of day, Unix seconds.
    """

    def __init__(self, store: Store, ask: Ask, wall: Callable[[], float]) -> None:
        self._store = store
        self._ask = ask
        self._wall = wall
        self._drives: dict[str, _Watched] = {}

    def forget(self, drive: str) -> None:
        """The drive has left the roster; what comes back by its name may be another device."""
        self._drives.pop(drive, None)

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read."""
        watched = self._drives.get(drive)
        if watched is None:
            watched = self._drives[drive] = _Watched(self._store.family(drive))
        if code not in watched.family.words:
            if watched.kind is not None:
                self._memory(drive, watched, code, value)
            return
        if watched.raw.get(code) == value.raw:
            if watched.kind is not None:
                self._still(drive, watched, code)
            return
        number = value.number
        if isinstance(number, int):
            watched.raw[code] = value.raw
            self._word(drive, watched, code, number)

    # -- what the words say -----------------------------------------------------------------------

    def _word(self, drive: str, watched: _Watched, code: Code, number: int) -> None:
        family = watched.family
        watched.shows[code] = family.shown_fault(code, number)
        digit = family.status_fields(code, number).get(FAULT_DIGIT)
        before = watched.digit
        if digit is not None:
            watched.digit = digit.number
        kind = max(watched.shows.values(), key=RANK.__getitem__)
        if kind is not watched.kind:
            if watched.kind is not None:
                self._goes(drive, watched)
            if kind is not None:
                self._rises(drive, watched, kind, shown_by=code)
        elif kind is not None and watched.digit != before:
            self._doubt(drive, watched, before)
        if watched.kind is FaultKind.TRIP and watched.shows[code] is None:
            self._look_again(drive, watched)

    def _still(self, drive: str, watched: _Watched, code: Code) -> None:
        """A word reads as before while a fault is shown."""
        if watched.number is None:
            self._ask_memory(drive, watched)
        if watched.kind is FaultKind.TRIP and watched.shows[code] is None:
            self._look_again(drive, watched)

    def _rises(self, drive: str, watched: _Watched, kind: FaultKind, *, shown_by: Code) -> None:
        """A fault is there that was not, or is another kind of fault now."""
        watched.kind = kind
        watched.since_s = self._wall()
        watched.tries = watched.looks = 0
        if shown_by != OPERATING_STATUS:
            watched.digit = 0  # what was read before the rise says nothing of this fault
        self._tell(drive, watched)
        self._ask_memory(drive, watched)
        missing = shown_by != OPERATING_STATUS and OPERATING_STATUS in watched.family.words
        if kind is FaultKind.TRIP and missing:
            self._try_to_ask(drive, OPERATING_STATUS, ignore_end)

    def _goes(self, drive: str, watched: _Watched) -> None:
        if not watched.logged:
            self._log(drive, watched)
        logger.info(
            "drive=%s event=%s-gone number=%s", drive, watched.kind, number_text(watched.number)
        )
        watched.kind = watched.number = watched.candidate = None
        watched.logged = False
        self._tell(drive, watched)

    def _look_again(self, drive: str, watched: _Watched) -> None:
        """One word shows no fault, others did when they were last read: read these again.

        A few times only: a drive whose words contradict each other costs no line for ever.
        """
        if watched.looks >= TRIES:
            return
        watched.looks += 1
        for code, shown in watched.shows.items():
            if shown is FaultKind.TRIP:
                self._try_to_ask(drive, code, ignore_end)

    # -- what the memory says -------------------------------------------------------------------

    def _memory(self, drive: str, watched: _Watched, code: Code, value: Value) -> None:
        """Take the newest entry of the memory, read while a fault is shown."""
        table = watched.family.fault_table
        if table is None or code != table.memories[0]:
            return
        number = value.number
        is_number = not isinstance(number, (str, bytes)) and number == int(number)
        watched.candidate = int(number) if is_number else None
        self._name(drive, table, watched)

    def _doubt(self, drive: str, watched: _Watched, before: int) -> None:
        """The tens digit is another one than before: it may be another fault by now."""
        table = watched.family.fault_table
        if table is None or not (table.lecom_numbers or before):
            return  # of numbers of its own, the first digit of a fault says nothing
        candidate = watched.candidate if table.lecom_numbers else None
        if candidate is not None and fits_digit(candidate, watched.digit):
            self._name(drive, table, watched)
            return
        watched.number = watched.candidate = None
        watched.tries = 0
        self._tell(drive, watched)
        self._ask_memory(drive, watched)

    def _name(self, drive: str, table: FaultTable, watched: _Watched) -> None:
        """Take the number in the memory, if it can be the fault that the words show."""
        number = watched.candidate
        if number is not None and not agrees(table, number, watched.kind, watched.digit):
            number = None
        if number != watched.number:
            watched.number = number
            self._tell(drive, watched)
            if number is not None:
                self._log(drive, watched)

    def _ask_memory(self, drive: str, watched: _Watched) -> None:
        """Ask for the number a few times; then the fault has none, and the log says so."""
        table = watched.family.fault_table
        if table is None or watched.asking:
            return
        if watched.tries >= TRIES:
            if not watched.logged:
                self._log(drive, watched)
            return
        watched.tries += 1

        def end(outcome: Outcome, reason: str) -> None:
            watched.asking = False

        watched.asking = True
        watched.asking = self._try_to_ask(drive, table.memories[0], end) and watched.asking

    def _try_to_ask(self, drive: str, code: Code, settle: Settle) -> bool:
        """Ask for a read; where that cannot be, the code's own turn comes later."""
        try:
            self._ask(drive, code, settle)
        except LecombusError:
            return False
        return True

    # -- telling ---------------------------------------------------------------------------------

    def _tell(self, drive: str, watched: _Watched) -> None:
        active = None
        if watched.kind is not None:
            known = None
            if watched.number is not None:
                known = watched.family.fault(watched.number)
            words = [code for code, shown in watched.shows.items() if shown is watched.kind]
            shown_by = ", ".join(f"{code} reads {watched.raw[code]}" for code in words)
            active = ActiveFault(watched.kind, watched.number, known, watched.since_s, shown_by)
        self._store.set_fault(drive, active)
        self._store.note(drive, FAULT_REMARK, None if active is None else str(active))

    def _log(self, drive: str, watched: _Watched) -> None:
        known = None
        if watched.number is not None:
            known = watched.family.fault(watched.number)
        watched.logged = True
        logger.warning(
            "drive=%s event=%s number=%s keypad=%s meaning=%s",
            drive, watched.kind, number_text(watched.number),
            known.keypad if known is not None else "",
            known.meaning if known is not None else "not known",
        )  # fmt: skip


def agrees(table: FaultTable, number: int, kind: FaultKind | None, digit: int) -> bool:
    """Say whether a number in the memory can be the fault that the status words show.

    A memory that holds an old trip does not name today's warning, and an old warning no trip.
    """
    if number == NO_FAULT or kind is None:
        return False
    known = table.fault(number)
    if known is not None and (known.kind is FaultKind.TRIP) != (kind is FaultKind.TRIP):
        return False
    return kind is not FaultKind.TRIP or table.fits(number, digit)


def number_text(number: int | None) -> str:
    """Write a fault's number for the log."""
    return "unknown" if number is None else str(number)


def ignore_end(outcome: Outcome, reason: str) -> None:
    """The end of a read nobody waits for: its value comes to `FaultWatch.seen`."""
