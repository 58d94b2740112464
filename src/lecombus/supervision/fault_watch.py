"""Which fault each drive has now: shown by its status words, named by its fault memory.

A fault is active only when a status word shows it; what stands in the fault memory may be years
old. So the words decide whether there is one, and when one rises the memory is read soon, for
its number: a user need not wait for the memory's own slow turn. The number is taken only
if it agrees with what the words say (the kind; where the memory holds LECOM numbers, C0068's tens
digit). A value that is not a whole number is none: nothing says how it would be read.

Strategy: no task and no timer. `seen` is called with every value read, costs two look-ups when
nothing changed, and asks for the few reads that a change calls for; their values come back the
same way. A word that shows a fault holds it until that word itself shows it gone: when another
word shows that first, the one left over is read again soon. Source: EDB2102EN 8.2 (C0068,
C0150, C0161..C0168); CMVLC401A table 9, 9.1.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.readings import ActiveFault
from lecombus.drive_state.store import Store
from lecombus.drives import Family
from lecombus.drives.faults.fault_tables import NO_FAULT, FaultKind, FaultTable, fits_digit
from lecombus.errors import LecombusError
from lecombus.line_events import ExchangeEvent, LineRequests
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Settle, ignore_end

__all__ = ["FAULT_REMARK", "FaultWatch"]

logger = logging.getLogger(__name__)

FAULT_REMARK = "fault"
FAULT_DIGIT = "fault_digit"
OPERATING_STATUS = Code(68)

TRIES = 3
"""How often the memory is asked for the number of one fault besides its own slow turn."""

SELDOM = 64
"""After that, whether a fault is over, or which it is, is asked with each 64th reading of a
status word."""

RANK = {None: 0, FaultKind.WARNING: 1, FaultKind.MESSAGE: 2, FaultKind.TRIP: 3}


class FaultWatch:
    """Keeps in the store which fault each drive has.

    Args:
        store: The store.
        line: Reads codes soon.
        wall: The time of day, Unix seconds.
    """

    def __init__(self, store: Store, line: LineRequests, wall: Callable[[], float]) -> None:
        self._store = store
        self._line = line
        self._wall = wall

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Take an exchange: only values that were read say something."""
        if event.read is None:
            return
        fault = event.drives[0].fault
        if fault.kind is not None or fault.raw.get(event.code) != event.read.raw:
            self.seen(event.drives[0], event.code, event.read)

    def seen(self, drive: Drive, code: Code, value: Value) -> None:
        """Take a value that was read."""
        fault = drive.fault
        family = fault.family
        if family is None:
            family = fault.family = drive.family
        if code not in family.words:
            if fault.kind is not None:
                self._memory(drive, family, code, value)
            return
        if fault.raw.get(code) == value.raw:
            if fault.kind is not None:
                self._still(drive, family, code)
            return
        if value.word is not None:
            fault.raw[code] = value.raw
            self._word(drive, family, code, value.word)

    # -- what the words say -----------------------------------------------------------------------

    def _word(self, drive: Drive, family: Family, code: Code, number: int) -> None:
        fault = drive.fault
        fault.shows[code] = family.shown_fault(code, number)
        digit = family.status_fields(code, number).get(FAULT_DIGIT)
        before = fault.digit
        if digit is not None:
            fault.digit = digit.number
        kind = max(fault.shows.values(), key=RANK.__getitem__)
        if kind is not fault.kind:
            if fault.kind is not None:
                self._goes(drive, family)
            if kind is not None:
                self._rises(drive, family, kind, shown_by=code)
        elif kind is not None and fault.digit != before:
            self._doubt(drive, family, before)
        if fault.kind is FaultKind.TRIP and fault.shows[code] is None:
            self._look_again(drive, family)

    def _still(self, drive: Drive, family: Family, code: Code) -> None:
        """A word reads as before while a fault is shown."""
        fault = drive.fault
        if fault.number is None:
            self._ask_memory(drive, family)
        if fault.kind is FaultKind.TRIP and fault.shows[code] is None:
            self._look_again(drive, family)

    def _rises(self, drive: Drive, family: Family, kind: FaultKind, *, shown_by: Code) -> None:
        """A fault is there that was not, or is another kind of fault now."""
        fault = drive.fault
        fault.kind = kind
        fault.since_s = self._wall()
        fault.tries = fault.looks = 0
        if shown_by != OPERATING_STATUS:
            fault.digit = 0  # what was read before the rise says nothing of this fault
        self._show(drive, family)
        self._ask_memory(drive, family)
        missing = shown_by != OPERATING_STATUS and OPERATING_STATUS in family.words
        if kind is FaultKind.TRIP and missing:
            self._try_to_ask(drive, OPERATING_STATUS, ignore_end)

    def _goes(self, drive: Drive, family: Family) -> None:
        fault = drive.fault
        if not fault.logged:
            self._log(drive, family)
        logger.info(
            "drive=%s event=%s-gone number=%s", drive.name, fault.kind, number_text(fault.number)
        )
        fault.kind = fault.number = fault.candidate = None
        fault.logged = False
        self._show(drive, family)

    def _look_again(self, drive: Drive, family: Family) -> None:
        """One word shows no fault, others did when they were last read: read these again.

        A few times, and seldom after that: a drive whose words contradict each other must not take
        the line always, and the last of these may be read by nothing else.
        """
        fault = drive.fault
        fault.looks += 1
        if fault.looks > TRIES and fault.looks % SELDOM:
            return
        for code, shown in fault.shows.items():
            if shown is FaultKind.TRIP:
                self._try_to_ask(drive, code, ignore_end)

    # -- what the memory says -------------------------------------------------------------------

    def _memory(self, drive: Drive, family: Family, code: Code, value: Value) -> None:
        """Take the newest entry of the memory, read while a fault is shown."""
        fault = drive.fault
        table = family.fault_table
        if table is None or code != table.memories[0]:
            return
        fault.candidate = value.whole
        self._name(drive, family, table)

    def _doubt(self, drive: Drive, family: Family, before: int) -> None:
        """The tens digit is another one than before: it may be another fault by now."""
        fault = drive.fault
        table = family.fault_table
        if table is None or not (table.lecom_numbers or before):
            return  # of numbers that are not LECOM's, the first digit of a fault says nothing
        candidate = fault.candidate if table.lecom_numbers else None
        if candidate is not None and fits_digit(candidate, fault.digit):
            self._name(drive, family, table)
            return
        fault.number = fault.candidate = None
        fault.tries = 0
        self._show(drive, family)
        self._ask_memory(drive, family)

    def _name(self, drive: Drive, family: Family, table: FaultTable) -> None:
        """Take the number in the memory, if it can be the fault that the words show."""
        fault = drive.fault
        number = fault.candidate
        if number is not None and not agrees(table, number, fault.kind, fault.digit):
            number = None
        if number != fault.number:
            fault.number = number
            self._show(drive, family)
            if number is not None:
                self._log(drive, family)

    def _ask_memory(self, drive: Drive, family: Family) -> None:
        """Ask for the number a few times; then it is logged without one, and asked for seldom."""
        fault = drive.fault
        table = family.fault_table
        if table is None or fault.asking:
            return
        fault.tries += 1
        if fault.tries > TRIES:
            if not fault.logged:
                self._log(drive, family)
            if fault.tries % SELDOM:
                return

        def end(outcome: Outcome, reason: str) -> None:
            fault.asking = False

        fault.asking = True
        fault.asking = self._try_to_ask(drive, table.memories[0], end) and fault.asking

    def _try_to_ask(self, drive: Drive, code: Code, settle: Settle) -> bool:
        """Ask for a read; where that cannot be, the code's own turn comes later."""
        try:
            self._line.read_soon(drive, code, settle)
        except LecombusError:
            return False
        return True

    # -- store and log ---------------------------------------------------------------------------

    def _show(self, drive: Drive, family: Family) -> None:
        fault = drive.fault
        active = None
        if fault.kind is not None:
            known = None
            if fault.number is not None:
                known = family.fault(fault.number)
            words = [code for code, shown in fault.shows.items() if shown is fault.kind]
            shown_by = ", ".join(f"{code} reads {fault.raw[code]}" for code in words)
            active = ActiveFault(fault.kind, fault.number, known, fault.since_s, shown_by)
        self._store.set_fault(drive.name, active)
        self._store.note(drive.name, FAULT_REMARK, None if active is None else str(active))

    def _log(self, drive: Drive, family: Family) -> None:
        fault = drive.fault
        known = None
        if fault.number is not None:
            known = family.fault(fault.number)
        fault.logged = True
        logger.warning(
            "drive=%s event=%s number=%s keypad=%s meaning=%s",
            drive.name, fault.kind, number_text(fault.number),
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
