"""Why a drive does not turn: everything known of it, put in the order of importance.

Strategy: nothing is concluded that is not known. What the line and the drive's own state say
comes first (a drive that is silent says nothing more), then the fault it shows, then what its
words and values say by the reasons of the data files (`drives.faults.reasons`), then what lecombus
itself knows (locks, a watchdog fed too late), then the fault memories. An enable that was refused
or taken back is remembered, with its cause, until one succeeds, also when the daemon restarts. A
value that is not fresh is used and called stale; one that is not known proves nothing. With `fresh`
the few codes that matter are read first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

from lecombus.drive_state.motion import Doing, overtaken_commands
from lecombus.drive_state.readings import (
    NO_SUCH_CODE,
    WRITE_LOCKS,
    WRITTEN_SINCE,
    DriveInfo,
    DriveState,
    Quality,
    Reading,
    rfc3339,
)
from lecombus.drive_state.store import Store
from lecombus.drives import Family, StopAction, Verb
from lecombus.drives.faults.fault_tables import NO_FAULT
from lecombus.drives.faults.reasons import Weight, asked_codes, holding
from lecombus.drives.verb_facts import Known
from lecombus.drives.verbs import is_enabled, status_shows_quick_stop
from lecombus.drives.words import OperatingState, join_states
from lecombus.errors import LecombusError, LineError, OperationError, UnknownCodeError
from lecombus.operations.awaited_requests import Requests
from lecombus.operations.findings import (
    MemoryEntry,
    StandstillFinding,
    WhyReport,
    answer_of,
    enable_finding,
    fault_finding,
    finding_of,
    lapse_finding,
    latch_finding,
    line_finding,
    lock_finding,
    silence_finding,
    silenced_finding,
    state_finding,
)
from lecombus.operations.operation_reports import VerbReport
from lecombus.parameters import Code
from lecombus.roster import DriveEntry
from lecombus.saved_state import LastEnable, State
from lecombus.schedule import Outcome, Priority

__all__ = ["StandstillDiagnosis"]

FRESH_S: Final = 8.0
"""Reading what matters is given up after this; what was read by then is used."""

TAKEN_BACK_REMEDY: Final = (
    "put that in order, then enable it again (lecombus enable); until then it stays stopped, so "
    "that it does not start by itself"
)

OUTPUT: Final = Code(50)
CONTROL_WORD: Final = Code(135)

SLOW_S: Final = 0.2
"""A code that takes the drive longer is not read for this: the module's own take 500 ms."""


class StandstillDiagnosis:
    """Answers why drives do not turn.

    Args:
        requests: Sends requests.
        store: What is known.
        state: What is kept: the last enable of each drive, where it failed.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        state: State,
        clock: Callable[[], float],
    ) -> None:
        self._requests = requests
        self._store = store
        self._state = state
        self._clock = clock
        self._drives = requests.drives

    def set_roster(self, entries: Sequence[DriveEntry]) -> None:
        """Forget the enables of drives that have another address or family now."""
        for entry in entries:
            last = self._state.drive(entry.name).last_enable
            if last and (last.address, last.family) != (entry.address, entry.family):
                self._forget(entry.name)

    def enable_ended(self, report: VerbReport, *, taken_back: bool) -> None:
        """Remember an enable that failed until one succeeds.

        One that a stop ended, or whose client left before anything was sent, says nothing.
        """
        if report.outcome.is_good:
            drive = self._drives.find(report.drive)
            if drive is not None:
                self._forget(drive.name)
                drive.enable.lapses_then = self._lapses(drive.name)
        elif report.outcome is not Outcome.SUPERSEDED and report.kind != "client-gone":
            self._remember(report, taken_back=taken_back, by_drive=True)

    def enable_refused(self, drive: str, error: OperationError) -> None:
        """Remember an enable that was refused before anything was sent."""
        report = VerbReport(
            drive, Verb.ENABLE, Outcome.REFUSED, str(error), kind=error.kind, remedy=error.remedy
        )
        self._remember(report, taken_back=False, by_drive=False)

    def stopped(self, drive: str) -> None:
        """Note that a drive is stopped on purpose: a failed enable is not what keeps it still."""
        facts = self._state.drive(drive)
        if facts.last_enable is not None and not facts.last_enable.stopped_since:
            facts.last_enable = replace(facts.last_enable, stopped_since=True)
            self._state.touch()

    def _remember(self, report: VerbReport, *, taken_back: bool, by_drive: bool) -> None:
        drive = self._drives.find(report.drive)
        if drive is None:
            return  # it has left the roster
        remedy = TAKEN_BACK_REMEDY if taken_back else report.remedy
        entry = drive.entry
        self._state.drive(drive.name).last_enable = LastEnable(
            rfc3339(self._store.time_of_day()), entry.address, entry.family, report.outcome.value,
            taken_back, _plain(report.reason), _plain(report.cause), _plain(remedy), by_drive,
        )  # fmt: skip
        self._state.touch()

    def _forget(self, drive: str) -> None:
        facts = self._state.drive(drive)
        if facts.last_enable is not None:
            facts.last_enable = None
            self._state.touch()

    async def why(
        self, drive: str, *, fresh: bool = False, priority: Priority = Priority.INTERACTIVE
    ) -> WhyReport:
        """Say why a drive does not turn.

        Args:
            drive: The drive's name.
            fresh: Read the few codes that matter first.
            priority: The class in which they are read.

        Raises:
            OperationError: No such drive.
        """
        self._requests.station(drive)  # before anything is read: there is no such drive
        if fresh:
            await self._read_now(drive, priority)
        return self.report(drive)

    def report(self, drive: str) -> WhyReport:
        """Say it from what is known, without sending anything."""
        info = self._store.drive(drive)
        family = self._family(drive)
        values = self._values(drive, self._codes(family))
        states = shown_states(family, values)
        last_enable = self._last_enable(drive, values)
        findings = self._own(info)
        if last_enable is not None:
            findings.append(enable_finding(last_enable))
        absent = self._absent(drive, family)
        known = {code: one.value for code, one in values.items() if one.value is not None}
        findings += [
            finding_of(reason, family, values)
            for reason in holding(family.name, frozenset(states), known, absent)
        ]
        findings += self._more(info)
        findings = [self._with_permission(drive, one) for one in findings]
        order = {weight: place for place, weight in enumerate(Weight)}
        findings.sort(key=lambda one: order[one.weight])  # stable: keeps the order of importance
        history, is_known = self._history(drive, family)
        output = self._store.reading(drive, OUTPUT) if family.words else None
        return WhyReport(
            info,
            answer_of(findings, output, states),
            tuple(findings),
            states,
            output,
            history,
            is_known,
            last_enable,
        )

    def _last_enable(self, drive: str, values: Mapping[Code, Reading]) -> LastEnable | None:
        """Give the last enable if it failed, unless the drive shows now that it is enabled."""
        last = self._state.drive(drive).last_enable
        if last is None:
            return None
        family = self._store.family(drive)
        good = {
            code: one.value
            for code, one in values.items()
            if one.value is not None and one.quality is Quality.GOOD
        }
        if family.verbs and is_enabled(Known(drive, family, good)):
            self._forget(drive)
            return None
        return last

    # -- what is asked -----------------------------------------------------------------------------

    def _family(self, drive: str) -> Family:
        """Give the family as the drive's signal configuration makes it, where that is known."""
        family = self._store.family(drive)
        if family.configured_by is None:
            return family
        reading = self._store.reading(drive, family.configured_by)
        number = None if reading is None or reading.value is None else reading.value.quantity
        return family.configured(None if number is None else int(number))

    def _codes(self, family: Family) -> tuple[Code, ...]:
        return tuple(dict.fromkeys((*family.words, *asked_codes(family.name))))

    async def _read_now(self, drive: str, priority: Priority) -> None:
        """Read what matters; what cannot be read stays as it was known."""
        until_s = self._clock() + FRESH_S
        family = self._store.family(drive)
        table = family.fault_table
        memories = table.memories if table is not None else ()
        quick = [
            code
            for code in (*self._codes(family), OUTPUT, *memories)
            if family.info(code) is not None
            and family.longest_answer_time_s(code, write=False) < SLOW_S
        ]
        for code in quick:
            left_s = until_s - self._clock()
            if left_s <= 0.0:
                return
            try:
                station = self._requests.station(drive)
                await self._requests.read(station, code, priority, timeout_s=left_s, retries=1)
            except UnknownCodeError:
                continue  # an older drive may lack it
            except LineError:
                return
            except LecombusError:
                if self._store.state(drive) is DriveState.OFFLINE:
                    return

    def _values(self, drive: str, codes: tuple[Code, ...]) -> dict[Code, Reading]:
        """Give what is known of codes, fresh or not.

        What was written since, or could not be read though the drive answers, is not known; nor is
        an old command that a fresh status word has overtaken.
        """
        silent = self._store.state(drive) is DriveState.OFFLINE
        family = self._store.family(drive)
        overtaken = overtaken_commands(family, lambda code: self._store.reading(drive, code))
        found = {}
        for code in codes:
            reading = self._store.reading(drive, code)
            if reading is None or reading.value is None or reading.reason == WRITTEN_SINCE:
                continue
            if code in overtaken:
                continue
            if silent or reading.quality is not Quality.BAD:
                found[code] = reading
        return found

    def _absent(self, drive: str, family: Family) -> frozenset[Code]:
        """Name the codes that the drive said it does not have."""
        readings = {code: self._store.reading(drive, code) for code in self._codes(family)}
        return frozenset(
            code
            for code, one in readings.items()
            if one is not None and one.quality is Quality.BAD and one.reason == NO_SUCH_CODE
        )

    # -- what is found -----------------------------------------------------------------------------

    def _own(self, info: DriveInfo) -> list[StandstillFinding]:
        """What the line, the drive's own state and its fault say."""
        line = self._store.line()
        if self._is_silenced(info.name):
            found = [line_finding(line), silenced_finding(info), fault_finding(info)]
            return [one for one in found if one is not None]
        found = [line_finding(line) or silence_finding(info, line)]
        found += [None if found[0] else state_finding(info), fault_finding(info)]
        return [one for one in found if one is not None]

    def _more(self, info: DriveInfo) -> list[StandstillFinding]:
        """What lecombus knows besides: what locks it, and a watchdog that was fed too late."""
        found = [lock_finding(info.remarks[lock]) for lock in WRITE_LOCKS if lock in info.remarks]
        if info.remarks.get("lease", "").startswith("latched"):
            found.append(latch_finding(info.remarks["lease"]))
        lapses = self._lapses(info.name)
        if lapses and not self._is_silenced(info.name):
            since = lapses > self._drives.get(info.name).enable.lapses_then
            unseen = since and self._may_quick_stop_unseen(info.name)
            found.append(lapse_finding(lapses, unseen=unseen))
        return found

    def _may_quick_stop_unseen(self, drive: str) -> bool:
        """Whether its watchdog may have set a quick stop that no status word of it shows."""
        found, family = self._drives.get(drive), self._store.family(drive)
        if family.watchdog is None or status_shows_quick_stop(family):
            return False
        setting = found.audit.watchdog
        action = None if setting is None else family.watchdog.action_of(setting.action)
        if action not in (None, StopAction.QUICK_STOP):
            return False
        return self._store.motion(drive).doing is not Doing.RUNNING

    def _with_permission(self, drive: str, finding: StandstillFinding) -> StandstillFinding:
        """Say also what the roster must open first for the verb that a finding advises."""
        family = self._store.family(drive)
        if finding.verb is None or family.verbs is None:
            return finding
        codes = family.verbs.not_writable(finding.verb, self._drives.get(drive).entry.writable)
        return (
            finding.with_codes_opened([family.spoken(one) for one in codes]) if codes else finding
        )

    def _is_silenced(self, drive: str) -> bool:
        """Whether nothing is sent to it on purpose, so that its watchdog acts."""
        return bool(self._drives.get(drive).health.silenced)

    def _lapses(self, drive: str) -> int:
        feed = self._requests.worker.schedule.stats(self._clock()).feeds.get(drive)
        return feed.lapses if feed is not None else 0

    def _history(self, drive: str, family: Family) -> tuple[tuple[MemoryEntry, ...], bool]:
        table = family.fault_table
        entries: list[MemoryEntry] = []
        known = False
        for code in table.memories if table is not None else ():
            reading = self._store.reading(drive, code)
            if reading is None or reading.value is None:
                continue
            number = reading.value.quantity
            if number is None:
                continue
            known = True
            if int(number) != NO_FAULT:
                stale = reading.quality is not Quality.GOOD
                entries.append(
                    MemoryEntry(code, int(number), family.fault(int(number)), reading.age_s, stale)
                )
        return tuple(entries), known


def _plain(text: str) -> str:
    """Return a text as the state file takes it: without control characters."""
    return "".join(one if one.isprintable() else " " for one in text)


def shown_states(family: Family, values: Mapping[Code, Reading]) -> tuple[OperatingState, ...]:
    """Name what a drive's words show, the word read last first."""
    words = []
    for code, word in family.words.items():
        reading = values.get(code)
        if reading is None or reading.value is None or reading.value.word is None:
            continue
        words.append((reading.age_s or 0.0, word.shown_states(reading.value.word)))
    words.sort(key=lambda one: one[0])
    return join_states(states for _, states in words)
