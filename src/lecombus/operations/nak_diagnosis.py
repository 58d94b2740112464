"""Why a drive refused: the likely cause, after one bounded look at the drive's error codes.

A NAK says nothing but no. The causes that the manuals give are data (`drives.faults.causes`);
here stands what is asked to choose between them. What the description says (read only, out of
range) costs nothing and is not asked about. Otherwise the drive is asked once: C0068 first,
because its communication error is gone with the next good telegram, then C1962 where there is
one, then the one value that would prove a cause (C0001, P420).

A look is never allowed to hurt. It runs in the cyclic class (in the lowest it would get no turn on
a line that its cyclic reads fill), is given up after a second, is not made while a stop waits, nor
twice at a time on one line, and all looks together take a tenth of the line at most; the same
refusal within ten seconds is answered from memory. Without a look the causes are named by family
and code alone.

A NAK need not change C1962, so its number may be left from an earlier access. It proves nothing
where it is the number that an access to another code is known to have left (seen at the last look,
or "no such code" to a read), or where it says "no such code" of a code that the description knows.
What is asked does not depend on that. "No such code" is no cause at all of a code that the drive
has answered. Source: EDB2102EN 7, 8.2, 8.3.6; CMVLC401A 10.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from lecombus.drive_state.readings import Quality
from lecombus.drive_state.store import Store
from lecombus.drives.faults.causes import (
    Cause,
    FailedExchange,
    Happened,
    Support,
    likely_causes,
    rules_for,
)
from lecombus.errors import (
    ChecksumReportedError,
    ExchangeError,
    LecombusError,
    NakError,
    RefusedError,
    UnknownCodeError,
)
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority

__all__ = ["NakDiagnosis"]

LOOK_S: Final = 1.0
"""A look ends after this, seconds, with what it has found."""

LINE_SHARE: Final = 0.1
"""Of the line's time, what looks may take at most."""

QUESTIONS: Final = 4
"""The most that one look asks."""

CREDIT_S: Final = 4.0
"""So far ahead of that share a few looks in a row may be: two drives that refuse one after the
other are both asked."""

REMEMBERED_S: Final = 10.0
REMEMBERED: Final = 64

OPERATING_STATUS: Final = Code(68)
EXTENDED_FAULT: Final = Code(1962)
DAMAGED: Final = "the telegrams were damaged on the line"
"""What a NAK may mean too, where the drive does not say why (EDB2102EN 8.3.3; CMVLC401A 6.1)."""
COMMUNICATION_ERROR: Final = "communication_error"
NO_SUCH_CODE: Final = frozenset({4, 5})
"""Numbers of C1962: no such subcode, no such code."""

NAMED: Final = 2
"""So many causes are named where several are as likely."""

HAPPENED: Final = {"nak": Happened.REFUSED, "not-in-effect": Happened.IGNORED}
"""Kinds of write reports that have a cause in the drive."""

Key = tuple[str, Code, str, Happened]


class NakDiagnosis:
    """Finds out why drives refuse.

    Args:
        requests: Sends requests.
        store: What is known.
        clock: Monotonic time, seconds.
    """

    def __init__(self, requests: Requests, store: Store, clock: Callable[[], float]) -> None:
        self._requests = requests
        self._store = store
        self._clock = clock
        self._looking = False
        self._paid_at_s = 0.0
        self._remembered: dict[Key, tuple[float, list[Cause]]] = {}
        self._left: dict[str, tuple[Code, frozenset[int]]] = {}
        """By drive: which access is known to have left C1962 as it is, and what it may read."""

    async def explain(
        self, report: WriteReport, station: Station, value: Value, *, look: bool = True
    ) -> WriteReport:
        """Put cause and remedy into the report of a write that the drive did not do.

        Args:
            report: How the write ended; returned as it is where the drive is not to blame.
            station: The drive.
            value: What was written.
            look: Ask the drive, where that helps and may be.
        """
        happened = HAPPENED.get(report.kind)
        if happened is None or report.code is None or report.outcome is Outcome.EXPIRED:
            return report
        known = self._known(station, report.code, happened, value)
        causes = await self._causes(station, known, look=look)
        refused = happened is Happened.REFUSED
        if not causes:
            cause = f"the drive does not take it now, or {DAMAGED}"
            return replace(report, cause=cause) if refused else report
        cause, remedy = in_words(causes, known)
        if refused and causes[0].support is Support.USUAL:
            cause += f"; or {DAMAGED}"
        return replace(report, cause=cause, remedy=remedy)

    async def explain_all(
        self, reports: Sequence[WriteReport], stations: Sequence[Station], values: Sequence[Value]
    ) -> list[WriteReport]:
        """Explain a group's reports; one of its drives is asked, for all have the same reason."""
        explained: list[WriteReport] = []
        look = True
        for report, station, value in zip(reports, stations, values, strict=True):
            explained.append(await self.explain(report, station, value, look=look))
            look = look and report.kind not in HAPPENED
        return explained

    def explain_read(self, error: ExchangeError, station: Station, code: Code) -> None:
        """Put cause and remedy into the error of a read that the drive refused; asks nothing."""
        if not isinstance(error, RefusedError):
            return
        happened = Happened.UNKNOWN
        if isinstance(error, ChecksumReportedError):
            happened = Happened.DAMAGED
        elif isinstance(error, NakError):
            happened = Happened.DENIED
        elif not isinstance(error, UnknownCodeError):
            return
        if happened is Happened.UNKNOWN:
            self._left[station.name] = (code, NO_SUCH_CODE)
        known = self._known(station, code, happened, None)
        causes = likely_causes(station.family.name, known)
        if causes:
            error.cause, error.remedy = in_words(causes, known)

    # -- choosing -------------------------------------------------------------------------------

    def _known(
        self, station: Station, code: Code, happened: Happened, value: Value | None
    ) -> FailedExchange:
        info = station.family.info(code)
        known = FailedExchange(happened, code, info, value, spoken=station.family.spoken)
        answered = self._answered(station, code)
        return replace(known, values=self._fresh_values(station, known), answered=answered)

    def _answered(self, station: Station, code: Code) -> bool:
        try:
            reading = self._store.reading(station.name, code)
        except LecombusError:  # it has left the roster
            return False
        return reading is not None and reading.value is not None

    def _fresh_values(self, station: Station, known: FailedExchange) -> dict[Code, Value]:
        """Give the values that rules ask for, as far as they were read just now."""
        values: dict[Code, Value] = {}
        for code in conditions(station, known):
            try:
                reading = self._store.reading(station.name, code)
            except LecombusError:  # it has left the roster
                break
            if reading is not None and reading.quality is Quality.GOOD and reading.value:
                values[code] = reading.value
        return values

    async def _causes(self, station: Station, known: FailedExchange, *, look: bool) -> list[Cause]:
        causes = likely_causes(station.family.name, known)
        if causes and causes[0].support >= Support.DESCRIBED:
            return causes
        raw = "" if known.value is None else known.value.raw
        key = (station.name, known.code, raw, known.happened)
        now_s = self._clock()
        at_s, remembered = self._remembered.get(key, (0.0, causes))
        if key in self._remembered and now_s - at_s <= REMEMBERED_S:
            return remembered
        if not look or not self._may_look(now_s):
            return causes
        causes = await self._look(station, known)
        if len(self._remembered) >= REMEMBERED:
            del self._remembered[next(iter(self._remembered))]
        self._remembered[key] = (self._clock(), causes)
        return causes

    # -- looking --------------------------------------------------------------------------------

    def _may_look(self, now_s: float) -> bool:
        return (
            not self._looking
            and now_s >= self._paid_at_s - CREDIT_S
            and not self._stop_waits(now_s)
        )

    def _stop_waits(self, now_s: float) -> bool:
        return self._requests.worker.schedule.stats(now_s).depth.get(Priority.STOP, 0) > 0

    async def _look(self, station: Station, known: FailedExchange) -> list[Cause]:
        """Ask the drive what it says of the exchange; a failed read leaves what is known."""
        self._looking = True
        started_s = self._clock()
        took_s = 0.0
        asked: list[Code] = []
        try:
            while (code := self._question(station, known, asked)) is not None:
                now_s = self._clock()
                within_s = started_s + LOOK_S - now_s
                if within_s <= 0.0 or self._stop_waits(now_s):
                    break
                asked.append(code)
                took_s += self._requests.maker.cost_of_read_s(station, code)
                value = await self._read(station, code, within_s)
                if value is not None:
                    known = self._learnt(station, known, code, value)
        finally:
            self._looking = False
            self._paid_at_s = max(self._paid_at_s, started_s) + took_s / LINE_SHARE
        return likely_causes(
            station.family.name, replace(known, left_over=self._may_be_left(station, known))
        )

    def _may_be_left(self, station: Station, known: FailedExchange) -> bool:
        """Return whether C1962 may be left from an earlier access; note what this one left."""
        number = known.extended
        if number is None:
            return False
        code, numbers = self._left.get(station.name, (known.code, frozenset[int]()))
        if code != known.code and number in numbers:
            return True
        self._left[station.name] = (known.code, frozenset({number}))
        return number in NO_SUCH_CODE and known.info is not None

    def _question(self, station: Station, known: FailedExchange, asked: list[Code]) -> Code | None:
        """What is asked next; None: nothing that would help.

        The next good telegram clears the error in C0068, so that comes first.
        """
        if known.happened is Happened.REFUSED:
            if OPERATING_STATUS in station.family.words and OPERATING_STATUS not in asked:
                return OPERATING_STATUS
            if station.family.info(EXTENDED_FAULT) is not None and EXTENDED_FAULT not in asked:
                return EXTENDED_FAULT
        causes = likely_causes(station.family.name, replace(known, answered=False))
        if len(asked) >= QUESTIONS or (causes and causes[0].support is Support.PROVEN):
            return None
        for cause in causes or ():
            condition = cause.rule.condition
            if condition is not None and condition.code not in (*asked, *known.values):
                return condition.code
        return None

    async def _read(self, station: Station, code: Code, within_s: float) -> Value | None:
        try:
            return await self._requests.read(
                station, code, Priority.CYCLIC, timeout_s=within_s, retries=0
            )
        except LecombusError:
            return None

    def _learnt(
        self, station: Station, known: FailedExchange, code: Code, value: Value
    ) -> FailedExchange:
        number = value.quantity
        if number is None:
            return known
        if code == OPERATING_STATUS:
            field = station.family.status_fields(code, int(number)).get(COMMUNICATION_ERROR)
            return replace(known, communication=None if field is None else field.number)
        if code == EXTENDED_FAULT:
            return replace(known, extended=int(number))
        return replace(known, values={**known.values, code: value})


def conditions(station: Station, known: FailedExchange) -> list[Code]:
    """Name the codes whose value would prove or rule out a cause of this exchange."""
    rules = rules_for(station.family.name, known)
    return list(dict.fromkeys(one.condition.code for one in rules if one.condition is not None))


def in_words(causes: list[Cause], known: FailedExchange) -> tuple[str, str]:
    """Write causes and remedies as one sentence each."""
    named = causes[:NAMED]
    texts = [
        f"{one.rule.cause} ({one.shown_by})" if one.shown_by else str(one.rule.cause)
        for one in named
    ]
    cause = "; or ".join(texts)
    if causes[0].support <= Support.SAID:
        cause = f"probably {cause}"
    remedy = "; or ".join(str(one.rule.remedy) for one in named)
    allowed = known.info.allowed if known.info is not None else ""
    if allowed and causes[0].rule.name == "out-of-range":
        remedy = f"write what is allowed: {allowed}"
    return cause, remedy
