"""A line with a fake of the operations behind the HTTP API."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import cast

import anyio
from starlette.applications import Starlette

from lecombus.api import EventReaders, create_app
from lecombus.config import RosterChanges
from lecombus.drive_state.store import DriveState, LineState, Reading, Store
from lecombus.drives import OperatingState, StopAction, Text, Verb, family
from lecombus.drives.faults.reasons import Weight
from lecombus.drives.measured import AnswerRow
from lecombus.errors import LecombusError, OperationError
from lecombus.event_stream import EventStream
from lecombus.metrics import Metrics
from lecombus.operations.address_reads import Heard, HeardKind
from lecombus.operations.awaited_requests import IS_GONE, refuse_for_gone_client
from lecombus.operations.facade import Operations
from lecombus.operations.findings import MemoryEntry, StandstillFinding, WhyReport
from lecombus.operations.identities import IdentityReport
from lecombus.operations.lease_operations import Leases
from lecombus.operations.operation_reports import (
    GroupFacts,
    GroupReport,
    RestoreRights,
    TimesReport,
    VerbReport,
    WriteReport,
)
from lecombus.operations.wear import CodeWear, WearReport
from lecombus.parameters import Code, Value
from lecombus.saved_state import State
from lecombus.schedule.request import Outcome, Priority
from support.rosters import make_roster
from support.site_host import Plant

ROSTER = make_roster([("feeder", 11, "8200vector"), ("belt", 12, "8200vector")])
FREQUENCY = Code(46)
STATUS = Code(150)


@dataclass
class FakeOperations:
    """Operations that remember what they were asked and answer what the test says."""

    store: Store
    error: LecombusError | Exception | None = None
    report: Callable[[str, Code], WriteReport] = lambda drive, code: WriteReport(
        drive, code, Outcome.DONE
    )
    asked: list[tuple[object, ...]] = field(default_factory=list)
    heard: Heard = field(default_factory=lambda: Heard(HeardKind.SILENCE))
    gate: anyio.Event | None = None
    read_as: tuple[Priority, float] | None = None
    written_as: tuple[Priority | None, bool] | None = None
    is_gone: Callable[[], bool] | None = None
    begun: anyio.Event = field(default_factory=anyio.Event)
    leases: Leases = field(default_factory=lambda: Leases(State(), time.monotonic, time.time))

    @property
    def context(self) -> FakeOperations:
        return self

    def members(self, target: str) -> tuple[str, ...]:
        if target == "conveyors":
            return ("feeder", "belt")
        self.store.drive(target)
        return (target,)

    async def _ask(self, *what: object) -> None:
        self.asked.append(what)
        self.begun.set()
        if self.gate is not None:
            await self.gate.wait()
        if self.error is not None:
            raise self.error

    async def read(
        self,
        drive: str,
        code: Code,
        *,
        priority: Priority = Priority.INTERACTIVE,
        timeout_s: float = 10.0,
    ) -> Reading:
        await self._ask("read", drive, code)
        self.read_as = (priority, timeout_s)
        self.store.value_read(drive, code, Value.parse("50.10"), time.monotonic())
        reading = self.store.reading(drive, code)
        assert reading is not None
        return reading

    async def write(
        self,
        drive: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None,
        verify: bool,
        urgency: Priority | None = None,
        restoring: bool = False,
        unless_stopped_since: str | None = None,
    ) -> WriteReport:
        refuse_for_gone_client(drive)
        self.is_gone = IS_GONE.get()
        self.written_as = (urgency, restoring)
        self.unless_stopped_since = unless_stopped_since
        await self._ask("write", drive, code, value, expires_s, verify)
        return self.report(drive, code)

    async def read_address(
        self, address: int, code: Code, *, addressing: str, family_name: str, patient: bool
    ) -> Heard:
        await self._ask("read_address", address, code, addressing, family_name, patient)
        return self.heard

    async def write_group(
        self,
        group: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None,
        verify: bool | None,
    ) -> GroupReport:
        await self._ask("write_group", group, code, value, expires_s, verify)
        return self._group_report(group, code)

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        await self._ask("stop", action, target)
        return self._group_report(target, Code(135))

    async def verb(
        self,
        drive: str,
        verb: Verb,
        *,
        value: Decimal | None = None,
        unit: str = "",
        expires_s: float | None = None,
        verify: bool = False,
    ) -> VerbReport:
        await self._ask("verb", drive, verb, value, unit, expires_s, verify)
        report = self.report(drive, Code(40))
        return VerbReport(
            drive, verb, report.outcome, report.reason, report.cause, report.kind, report.remedy,
            (OperatingState.ENABLED,), ((Code(40), "1"),),
        )  # fmt: skip

    def restore_rights(self, drive: str) -> RestoreRights:
        self.store.drive(drive)
        return RestoreRights(drive, permitted=True, owned=(Code(1922), Code(1923)))

    async def why(
        self, drive: str, *, fresh: bool = False, priority: Priority = Priority.INTERACTIVE
    ) -> WhyReport:
        await self._ask("why", drive, fresh, priority)
        text = Text("the controller is inhibited", "der Regler ist gesperrt")
        finding = StandstillFinding(
            "inhibited", Weight.REASON, text, Text("", ""), "C0150 reads H0380", 0.5
        )
        entry = MemoryEntry(Code(161), 50, family("8200vector").fault(50), 1.5, stale=False)
        output = self.store.reading(drive, FREQUENCY)
        return WhyReport(self.store.drive(drive), text, (finding,), (), output, (entry,), True)

    def is_command(self, drive: str, code: Code) -> bool:
        return family("8200vector").is_command(code)

    def groups(self) -> Sequence[GroupFacts]:
        return (
            GroupFacts("conveyors", ("feeder", "belt"), None),
            GroupFacts("all", ("feeder",), 0),
        )

    def _group_report(self, target: str, code: Code) -> GroupReport:
        members = tuple(self.report(drive, code) for drive in ("feeder", "belt"))
        good = (Outcome.DONE, Outcome.VERIFIED)
        outcome = next((one.outcome for one in members if one.outcome not in good), Outcome.DONE)
        return GroupReport(target, "one-by-one", outcome, members)

    def identity(self, drive: str) -> IdentityReport:
        return IdentityReport(drive, {"C1810": "NEW"}, {"C1810": "OLD"}, {}, "", "swapped")

    def wear(self, drive: str) -> WearReport:
        code = CodeWear("C0012", "acceleration time", 7, 2, 0.0)
        return WearReport(drive, 30, 600.0, (code,))

    async def readdress(self, drive: str, address: int) -> WriteReport:
        return WriteReport(drive, Code(9), Outcome.VERIFIED, f"at {address}")

    def forget_times(self, drive: str) -> TimesReport:
        return TimesReport(drive, (AnswerRow(Code(150), False, 0.02, 0.25, True),))

    def accept(self, drive: str, shown: Mapping[str, str]) -> IdentityReport:
        return IdentityReport(drive, shown, shown, {}, "2026-11-22T00:00:00.000Z", "")


async def no_reload() -> RosterChanges:
    """What a daemon without a roster file says."""
    raise OperationError("there is no roster file", kind="no-roster")


@dataclass
class Line:
    """Everything a test of the API holds."""

    store: Store
    ops: FakeOperations
    app: Starlette
    events: EventStream
    readers: EventReaders
    now_s: float = 0.0
    ready: tuple[bool, str] = (True, "31 of 31 drives tried")
    healthy: tuple[bool, str] = (True, "")
    reload: Callable[[], Awaitable[RosterChanges]] = no_reload


def make_line() -> Line:
    """Return a line of two drives, one of which has values."""
    store = Store(time.monotonic, time.time)
    for address, name in ((11, "feeder"), (12, "belt")):
        store.add_drive(name, address, family("8200vector"))
        store.drive_state(name, DriveState.ONLINE)
        store.expect(name, FREQUENCY, 3600.0)
    store.line_state(LineState.OPEN)
    store.value_read("feeder", FREQUENCY, Value.parse("35.40"), time.monotonic())
    ops = FakeOperations(store)
    ops.leases.set_roster(ROSTER.drives)
    metrics = Metrics("hall-3", store, version="1", clock=time.monotonic)
    metrics.counters.add_drive("feeder")
    events = EventStream("run")
    readers = EventReaders(events, lambda: (), time.monotonic)
    line = Line(store, ops, Starlette(), events, readers)
    line.app = create_app(
        cast(Operations, ops),
        store,
        metrics,
        plan_facts=lambda: {
            "roster": {},
            "measured": {},
            "answers": {},
            "state": "open",
            "away": [],
        },
        line_name="hall-3",
        ready=lambda: line.ready,
        healthy=lambda: line.healthy,
        reload=lambda: line.reload(),
        readers=readers,
        clock=lambda: line.now_s,
    )
    return line


def app_of(plant: Plant) -> Starlette:
    """Return the HTTP application of a whole line on the virtual clock."""
    site = plant.site
    return create_app(
        site.operations, site.store, site.metrics,
        plan_facts=lambda: site.supervision.watch.plan_facts(site.roster), line_name="t",
        ready=lambda: (True, ""), healthy=lambda: (True, ""), reload=no_reload,
        readers=EventReaders(site.events, tuple, anyio.current_time), clock=anyio.current_time,
    )  # fmt: skip
