"""Writes to the drives of a group.

A group's write goes out as one multicast when its members are exactly the roster's drives of one
decade or all of them (`config` decides that once, `check` shows it), the roster says that no other
drive hears it (`multicast: yes`) or it is a stop, every member wants the same telegram, and the
watchdogs leave room for it; otherwise one telegram after another. A multicast has no answer, so
its members are read back.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal

from lecombus.drive_state.control_word import unknown_until_ended
from lecombus.drives import WriteClass
from lecombus.drives.stops import asks_to_stop, stops_every_drive
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LineError,
    OperationError,
    QueueFullError,
    ScheduleError,
)
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Ending, client_check, refuse_for_gone_client
from lecombus.operations.context import OperationContext
from lecombus.operations.operation_reports import (
    REMEDIES,
    GroupFacts,
    GroupReport,
    Proof,
    WriteReport,
    group_report,
    stopped_first,
)
from lecombus.operations.wear import wears
from lecombus.operations.writes import Writes
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, ignore_end
from lecombus.schedule.fan_out import least_order

__all__ = ["GroupWrites"]


class GroupWrites:
    """Writes codes of all drives of a group."""

    def __init__(self, context: OperationContext, writes: Writes) -> None:
        self._context = context
        self._writes = writes
        self._maker = context.requests.maker

    def groups(self) -> Sequence[GroupFacts]:
        """Return the groups of the roster and how each is addressed."""
        return [
            GroupFacts(name, tuple(entry.members), entry.multicast_address, entry.multicast)
            for name, entry in self._context.groups.items()
        ]

    async def write_group(
        self,
        group: str,
        code: Code,
        value: Decimal | int | str,
        *,
        expires_s: float | None = None,
        verify: bool | None = None,
    ) -> GroupReport:
        """Write a code of every member of a group.

        Every member is checked before anything is sent to one of them.

        Args:
            group: The group's name.
            code: What to write; the roster must allow it for every member.
            value: As for `write`.
            expires_s: Not begun after this long, seconds.
            verify: Read back every member; None: yes for a multicast, which is not acknowledged.

        Raises:
            OperationError: No such group, or one member may not be written.
            LineError: There is no line; nothing was sent.
            QueueFullError: Too many requests wait; nothing was sent to any member.
        """
        expires_at_s = None if expires_s is None else self._context.clock() + expires_s
        members = self._context.group(group).members
        before = {name: self._before_write(name, code) for name in members}
        await self._context.shown_stops.see(group, code, value)
        stations, wires = self._permitted_all(group, code, value)
        pairs = zip(stations, wires, strict=True)
        if not all(asks_to_stop(one.family, code, wire) for one, wire in pairs):
            refuse_for_gone_client(group)
        there: Sequence[WriteReport | None] = [None] * len(stations)
        if stored := any(wears(one.family, code) for one in stations):
            there = await self._already_there(
                stations, code, wires, verify=bool(verify), within_s=expires_s
            )
        there = self._unless_stopped(stations, code, wires, there, before)
        if len(known := [one for one in there if one is not None]) == len(stations):
            return group_report(group, "one-by-one", known)
        if stored:  # they may have changed during the read
            stations, wires = self._permitted_all(group, code, value)
        to = self._shared(group, stations, code, wires, there)
        if to is None:
            read_back = bool(verify)
            waits = self._submit_each(stations, code, wires, there, expires_at_s, verify=read_back)
            each = [
                self._writes.report(one.name, code, wait, *await wait.wait())
                if isinstance(wait, Ending)
                else wait
                for one, wait in zip(stations, waits, strict=True)
            ]
            each = await self._context.diagnosis.explain_all(each, stations, wires)
            return group_report(group, "one-by-one", each)
        reports = await self._write_shared(to, stations, code, wires[0], expires_at_s, verify)
        return group_report(group, "multicast", reports)

    def _before_write(self, name: str, code: Code) -> tuple[str, Callable[[], bool]]:
        """Give what says later whether a member was stopped since: by a stop, by a plain write."""
        marks = self._context.stop_marks
        return marks.mark(name), marks.before_write(self._context.requests.station(name), code)

    def _unless_stopped(
        self,
        stations: Sequence[Station],
        code: Code,
        wires: Sequence[Value],
        there: Sequence[WriteReport | None],
        before: Mapping[str, tuple[str, Callable[[], bool]]],
    ) -> list[WriteReport | None]:
        """End the write for members that were stopped since it was asked for.

        One that stops is sent behind a plain write that did: it may be the stronger of them.
        """
        marks, requests = self._context.stop_marks, self._context.requests
        reports = list(there)
        for index, (one, wire) in enumerate(zip(stations, wires, strict=True)):
            mark, was_stopped = before[one.name]
            stopped = marks.is_outdated(one.name, mark) or requests.stopped_since_asked(one.name)
            if stopped or (was_stopped() and not asks_to_stop(one.family, code, wire)):
                reports[index] = stopped_first(one.name, code)
        return reports

    def _shared(
        self,
        group: str,
        stations: tuple[Station, ...],
        code: Code,
        wires: Sequence[Value],
        there: Sequence[WriteReport | None],
    ) -> Station | None:
        """Give whom one telegram for all is sent to, None where each is written to.

        One telegram would reach those that were stopped, too. And it feeds no watchdog: where these
        never leave room for it, single writes, which feed their drives, still fit.
        """
        address = self._address(group, stations, code, wires)
        form = self._maker.shared_form(stations, code)
        stopped = any(one is not None and one.outcome is Outcome.SUPERSEDED for one in there)
        if address is None or form is None or stopped or len({wire.raw for wire in wires}) != 1:
            return None
        to = Station(group, address, stations[0].family, (form,))
        request = self._maker.multicast(
            to, stations, code, wires[0], Priority.INTERACTIVE, settle=ignore_end
        )
        return None if self._context.requests.worker.schedule.never(request) else to

    def _address(
        self, group: str, stations: Sequence[Station], code: Code, wires: Sequence[Value]
    ) -> int | None:
        """Give the address of one telegram for all, None where each is written to.

        A drive that the roster does not name receives it too: only a stop cannot start it.
        """
        entry = self._context.group(group)
        stop = all(
            stops_every_drive(one.family, code, wire)
            for one, wire in zip(stations, wires, strict=True)
        )
        return entry.multicast_address if stop else entry.write_address

    def _permitted_all(
        self, group: str, code: Code, value: Decimal | int | str
    ) -> tuple[tuple[Station, ...], list[Value]]:
        """Give a group's members, and for each the wire's value that may be written to it now."""
        members = self._context.group(group).members
        stations = tuple(self._context.requests.station(name) for name in members)
        return stations, [
            self._context.permissions.permitted(one.name, one, code, value) for one in stations
        ]

    async def _already_there(
        self,
        stations: Sequence[Station],
        code: Code,
        wires: Sequence[Value],
        *,
        verify: bool,
        within_s: float | None,
    ) -> list[WriteReport | None]:
        """Read a stored parameter of every member; see that the others may be written."""
        there = await asyncio.gather(
            *(
                self._writes.already_there(one, code, wire, verify=verify, within_s=within_s)
                for one, wire in zip(stations, wires, strict=True)
            )
        )
        for one, known in zip(stations, there, strict=True):
            if known is None:
                self._context.wear.check(one.name, code)
        return there

    async def _write_shared(
        self,
        to: Station,
        stations: tuple[Station, ...],
        code: Code,
        wire: Value,
        expires_at_s: float | None,
        verify: bool | None,
    ) -> Sequence[WriteReport]:
        """Write a code of all members by one telegram, and read it back from each."""
        for one in stations:
            self._context.wear.check(one.name, code)
        for one in stations:
            self._context.wear.take(one.name, code)
            self._context.stop_marks.note_write(one, code, wire)
        otherwise = {
            one.name for one in stations
            if asks_to_stop(one.family, code, wire) and self._context.stands_otherwise(one, code)
        }  # fmt: skip
        endings = {one.name: Ending() for one in stations}

        async def prove(one: Station) -> WriteReport:
            proof = self._again if one.name in otherwise else self._proof
            report = await proof(one, code, wire)
            endings[one.name].settle(report.outcome, report.reason)
            return report

        try:
            outcome, reason, kind = await self._multicast(
                to, stations, code, wire, expires_at_s, endings
            )
            if outcome is Outcome.DONE and verify is not False:
                proofs = await asyncio.gather(*map(prove, stations))
                return await self._context.diagnosis.explain_all(
                    proofs, stations, [wire] * len(stations)
                )
        finally:
            for ending in endings.values():  # that it was sent does not show that it was heard
                ending.settle(Outcome.UNKNOWN, "")
        shown = Outcome.UNKNOWN if outcome is Outcome.DONE else outcome
        remedy = REMEDIES.get(kind, "")
        return [
            WriteReport(one.name, code, shown, reason, kind=kind, remedy=remedy) for one in stations
        ]

    def _submit_each(
        self,
        stations: Sequence[Station],
        code: Code,
        wires: Sequence[Value],
        there: Sequence[WriteReport | None],
        expires_at_s: float | None,
        *,
        verify: bool,
    ) -> list[Ending | WriteReport]:
        """Submit a write for every member that does not hold the value already.

        When the queue becomes full, the remaining members are refused; the writes submitted before
        go on to their outcomes.
        """
        waits: dict[int, Ending | WriteReport] = {}
        for index in self._order(stations, code, wires, proven=verify):
            one, wire, known = stations[index], wires[index], there[index]
            if known is not None:
                waits[index] = known
                continue
            try:
                self._context.wear.take(one.name, code)
                self._context.stop_marks.note_write(one, code, wire)
                waits[index] = self._writes.submit_write(
                    one, code, wire, expires_at_s, verify=verify
                )
            except QueueFullError as exc:
                if not waits:
                    raise
                waits[index] = WriteReport(
                    one.name, code, Outcome.REFUSED, str(exc), kind="queue-full"
                )
        return [waits[index] for index in range(len(stations))]

    def _order(
        self, stations: Sequence[Station], code: Code, wires: Sequence[Value], *, proven: bool
    ) -> list[int]:
        """Give the order in which members are written to.

        The roster's order, or with read-back the order in which all are proven soonest. Members
        that may not answer come last: after a missing acknowledgement no write follows for a while.
        """
        order = list(range(len(stations)))
        if proven:
            part_of = self._maker.part_of_write
            order = least_order(
                [part_of(one, code, wire) for one, wire in zip(stations, wires, strict=True)]
            )
        return sorted(order, key=lambda index: self._context.silence_of(stations[index]))

    async def _multicast(
        self,
        group: Station,
        stations: tuple[Station, ...],
        code: Code,
        wire: Value,
        expires_at_s: float | None,
        endings: Mapping[str, Ending],
    ) -> tuple[Outcome, str, str]:
        """Send a group's write as one telegram; give outcome, reason and kind.

        `endings` are those of its members, by name: an enable that it ended waits for them.
        """
        infos = [one.family.info(code) for one in stations]
        motion = any(info is not None and info.motion for info in infos)
        ending = Ending()
        words = [self._context.control_word(one.name) for one in stations]
        repeats = all(word.repeats(code, wire) for word in words)
        request = self._maker.multicast(
            group, stations, code, wire, Priority.CONTROL if motion else Priority.INTERACTIVE,
            settle=unknown_until_ended(words, code, ending.settle),
            expires_at_s=expires_at_s,
        )  # fmt: skip
        ending.request = request
        request.is_gone = client_check(stations[0], code, wire)
        request.lease_ended = self._context.permissions.lease_check(
            stations, code, [wire] * len(stations)
        )
        request.repeats = repeats
        self._context.requests.submit(request)
        for one in stations:
            if asks_to_stop(one.family, code, wire):
                self._context.lasting(one.name).stop_write_done = endings[one.name].is_done
        outcome, reason = await ending.wait()
        kind = "" if outcome is Outcome.DONE else ending.failure(outcome, reason)
        return outcome, reason, kind

    async def _again(self, station: Station, code: Code, wire: Value) -> WriteReport:
        """Write a stop once more to a member whose reading would not show that it heard it."""
        try:
            ending = self._writes.submit_write(station, code, wire, None, verify=True, goes_on=True)
        except (LineError, QueueFullError) as exc:
            kind = "queue-full" if isinstance(exc, QueueFullError) else "line-lost"
            return WriteReport(station.name, code, Outcome.UNKNOWN, str(exc), kind=kind)
        return self._writes.report(station.name, code, ending, *await ending.wait())

    async def _proof(self, station: Station, code: Code, wire: Value) -> WriteReport:
        """Read a member back after a multicast."""
        try:
            found, doubt = await self._context.requests.read_back(
                station, code, wire, Priority.INTERACTIVE
            )
        except (ExchangeError, LineError, OperationError, ScheduleError) as exc:
            text = f"it went out as a multicast and could not be read back: {exc}"
            lost = isinstance(exc, CutReplyError | LineError)
            kind = "line-lost" if lost else "no-answer"
            return WriteReport(station.name, code, Outcome.UNKNOWN, text, kind=kind)
        if found.means_same(wire):
            if doubt:
                text = f"it went out as a multicast; {doubt}"
                return WriteReport(station.name, code, Outcome.UNKNOWN, text, kind="no-answer")
            reading = self._context.last_reading(station.name, code)
            proof = Proof(code, found.raw, "value")
            return WriteReport(station.name, code, Outcome.VERIFIED, reading=reading, proof=proof)
        # An edge or a step may have happened and still read as before.
        plain = station.family.write_class(code, wire) is WriteClass.PLAIN
        outcome = Outcome.REFUSED if plain else Outcome.UNKNOWN
        text = f"it went out as a multicast, but {station.family.spoken(code)} reads {found.raw}"
        return WriteReport(station.name, code, outcome, text, kind="not-in-effect")
