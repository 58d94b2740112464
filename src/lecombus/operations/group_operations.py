"""Operations on several drives: a group's write, and the stop.

A group goes out as one multicast when its members are exactly the roster's drives of one decade
or all of them (`config` decides that once, `check` shows it) and every member wants the same
telegram; otherwise one telegram after another. A multicast has no answer, so its members are
read back.

A stop is different from everything else: it is sent to drives that are offline too (their answer
may be lost, not their hearing), it needs no permission, and a multicast that says it to all is
followed by reading back every member and, where that does not show the stop, by a stop to the
member alone.

What must not live here: HTTP, telegrams, waiting lists.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

from lecombus.config import GroupEntry
from lecombus.drives import (
    StopAction,
    WriteClass,
    knows_stop,
    needs_control_word,
    stop_value,
)
from lecombus.drives.stops import usable_word
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LecombusError,
    LineError,
    OperationError,
    QueueFullError,
    ScheduleError,
)
from lecombus.line.jobs import MulticastJob
from lecombus.line.station import Station, Step
from lecombus.line.stop_job import STOP_PATIENCE_S, StopJob
from lecombus.operations.control_words import ControlWords
from lecombus.operations.drive_operations import REMEDIES, Operations, kind_of
from lecombus.operations.reports import GroupInfo, GroupReport, WriteReport, group_report
from lecombus.operations.request_maker import ignore_end
from lecombus.operations.requests import Ending, Requests
from lecombus.operations.wear import Wear, wears
from lecombus.protocol.addressing import Code, Form
from lecombus.protocol.values import Value
from lecombus.readings import DriveState
from lecombus.schedule import Outcome, Priority, Request
from lecombus.store import Store

__all__ = ["GroupOperations"]

logger = logging.getLogger(__name__)

ABSENT_PATIENCE_S = 1.5
"""How long a drive that was offline already is told to stop while it does not answer, seconds."""


STOP_REMEDY = (
    "the motor may turn: use the emergency stop circuit, or take the controller enable or the "
    "mains from the drive at its terminals; then look for the cause and stop it again, so that "
    "it is known to be stopped"
)
"""A stop that is not proven leaves a person with one thing to do, and it is not to ask again."""


@dataclass(slots=True)
class _OpenStop:
    """The last stop of one kind of one drive, and everyone who waits for its end."""

    request: Request
    endings: list[Ending]


class GroupOperations(Operations):
    """Adds to the operations on one drive those on several."""

    def __init__(
        self,
        requests: Requests,
        store: Store,
        words: ControlWords,
        wear: Wear,
        clock: Callable[[], float],
        disturbances: Callable[[], int] = lambda: 0,
    ) -> None:
        super().__init__(requests, store, words, wear, clock, disturbances)
        self._stops: dict[tuple[str, StopAction], _OpenStop] = {}
        self._shared: dict[tuple[str, StopAction], Request] = {}

    def groups(self) -> Sequence[GroupInfo]:
        """The groups of the roster and how each is spoken to."""
        return [
            GroupInfo(name, tuple(entry.members), entry.multicast_address)
            for name, entry in self._groups.items()
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
            verify: Read back every member; None: yes for a multicast, which nobody acknowledges.

        Raises:
            OperationError: No such group, or one member may not be written.
            LineError: There is no line; nothing was sent.
            QueueFullError: Too many requests wait; nothing was sent to any member.
        """
        expires_at_s = None if expires_s is None else self._clock() + expires_s
        stations, wires = self._permitted_all(group, code, value)
        there: Sequence[WriteReport | None] = [None] * len(stations)
        if any(wears(one.family, code) for one in stations):
            there = await self._already_there(
                stations, code, wires, verify=bool(verify), within_s=expires_s
            )
            known = [one for one in there if one is not None]
            if len(known) == len(stations):
                return group_report(group, "one-by-one", known)
            stations, wires = self._permitted_all(group, code, value)  # what became of them
        address, form = self._group(group).multicast_address, shared_form(stations, code)
        if address is None or form is None or len({wire.raw for wire in wires}) != 1:
            waits = self._submit_each(
                stations, code, wires, there, expires_at_s, verify=bool(verify)
            )
            each = [
                self.report(one.name, code, wait, *await wait.wait())
                if isinstance(wait, Ending)
                else wait
                for one, wait in zip(stations, waits, strict=True)
            ]
            each = await self._refusals.explain_all(each, stations, wires)
            return group_report(group, "one-by-one", each)
        to = Station(group, address, stations[0].family, (form,))
        reports = await self._write_shared(to, stations, code, wires[0], expires_at_s, verify)
        return group_report(group, "multicast", reports)

    def _permitted_all(
        self, group: str, code: Code, value: Decimal | int | str
    ) -> tuple[tuple[Station, ...], list[Value]]:
        """Give a group's members, and for each the wire's value that may be written to it now."""
        members = self._group(group).members
        stations = tuple(self._requests.station(name) for name in members)
        return stations, [self.permitted(one.name, one, code, value) for one in stations]

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
                self.already_there(one, code, wire, verify=verify, within_s=within_s)
                for one, wire in zip(stations, wires, strict=True)
            )
        )
        for one, known in zip(stations, there, strict=True):
            if known is None:
                self._wear.check(one.name, code)
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
            self._wear.check(one.name, code)
        for one in stations:
            self._wear.take(one.name, code)
            self.note_stop(one, code, wire)
        outcome, reason, kind = await self._multicast(to, stations, code, wire, expires_at_s)
        if outcome is Outcome.DONE and verify is not False:
            proofs = await asyncio.gather(*(self._proof(one, code, wire) for one in stations))
            return await self._refusals.explain_all(proofs, stations, [wire] * len(stations))
        told = Outcome.UNKNOWN if outcome is Outcome.DONE else outcome
        remedy = REMEDIES.get(kind, "")
        return [
            WriteReport(one.name, code, told, reason, kind=kind, remedy=remedy) for one in stations
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
        """Put a write for every member into the line that does not hold the value already.

        Where the queue is full half way, the members left over are told so: the others' writes
        are in the line already and will have their outcome.
        """
        waits: list[Ending | WriteReport] = []
        for one, wire, known in zip(stations, wires, there, strict=True):
            if known is not None:
                waits.append(known)
                continue
            try:
                self._wear.take(one.name, code)
                self.note_stop(one, code, wire)
                waits.append(self.submit_write(one, code, wire, expires_at_s, verify=verify))
            except QueueFullError as exc:
                if not waits:
                    raise
                waits.append(
                    WriteReport(one.name, code, Outcome.REFUSED, str(exc), kind="queue-full")
                )
        return waits

    async def _multicast(
        self,
        group: Station,
        stations: tuple[Station, ...],
        code: Code,
        wire: Value,
        expires_at_s: float | None,
    ) -> tuple[Outcome, str, str]:
        """Send a group's write as one telegram; give outcome, reason and kind."""
        infos = [one.family.info(code) for one in stations]
        motion = any(info is not None and info.motion for info in infos)
        ending = Ending()
        request = self._requests.maker.multicast(
            group, stations, code, wire, Priority.CONTROL if motion else Priority.INTERACTIVE,
            settle=self._words.guard([one.name for one in stations], code, ending.settle),
            expires_at_s=expires_at_s,
        )  # fmt: skip
        request.motion = motion
        ending.request = request
        try:
            self._requests.worker.submit(request)
        except LecombusError as exc:
            request.end(Outcome.REFUSED, str(exc))
            raise
        outcome, reason = await ending.wait()
        kind = "" if outcome is Outcome.DONE else kind_of(ending, outcome, reason)
        return outcome, reason, kind

    async def _proof(self, station: Station, code: Code, wire: Value) -> WriteReport:
        """Read a member back after a multicast."""
        try:
            found = await self._requests.read(station, code, Priority.INTERACTIVE)
        except (ExchangeError, LineError, OperationError, ScheduleError) as exc:
            text = f"it went out as a multicast and could not be read back: {exc}"
            lost = isinstance(exc, CutReplyError | LineError)
            kind = "line-lost" if lost else "no-answer"
            return WriteReport(station.name, code, Outcome.UNKNOWN, text, kind=kind)
        if found.means_same(wire):
            reading = self._store.reading(station.name, code)
            return WriteReport(station.name, code, Outcome.VERIFIED, reading=reading)
        # An edge or a step may have happened and still read as before.
        plain = station.family.write_class(code, wire) is WriteClass.PLAIN
        outcome = Outcome.REFUSED if plain else Outcome.UNKNOWN
        text = f"it went out as a multicast, but {code} reads {found.raw}"
        return WriteReport(station.name, code, outcome, text, kind="not-in-effect")

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        """Stop a drive, a group or all, ahead of everything else.

        Args:
            action: Quick stop or inhibit.
            target: A drive's or a group's name; `all` is a group.

        Raises:
            OperationError: No such target, or no drive of it knows this stop.
            LineError: There is no line; nothing was sent.
        """
        stations = tuple(self._requests.station(name) for name in self._targets(target))
        able = tuple(one for one in stations if knows_stop(one.family, action))
        if not able:
            raise OperationError(
                f"no {action} is known for {target}",
                kind="no-stop",
                drive=target,
                remedy="write the code that stops this device, or name its family in the roster",
            )
        logger.warning("event=stop action=%s target=%s", action, target)
        shared = self._shared_stop(target, stations, able, action)
        if shared is not None:
            self._submit_shared(target, action, shared)
        # Whoever answers is stopped first: one that is silent holds the line at every attempt.
        endings = {
            one.name: self._say_stop(one, action, said=shared is not None)
            for one in sorted(able, key=self._silence_of)
        }
        reports = [await self._stop_report(one, endings[one.name]) for one in able]
        reports += [
            WriteReport(
                one.name, None, Outcome.REFUSED,
                f"no {action} is known for family {one.family.name}: nothing was sent to it",
                kind="no-stop",
            )
            for one in stations if one not in able
        ]  # fmt: skip
        return group_report(target, "multicast" if shared else "one-by-one", reports)

    def _state_of(self, station: Station) -> DriveState:
        return self._store.drive(station.name).state

    def _silence_of(self, station: Station) -> int:
        """Tell how little is to be expected of a drive: 0 where it answers."""
        state = self._state_of(station)
        return 2 if state is DriveState.OFFLINE else int(state is not DriveState.ONLINE)

    async def _stop_report(self, station: Station, ending: Ending) -> WriteReport:
        """Wait for a stop; it is told by the code that was written, which may be an inhibit's."""
        outcome, reason = await ending.wait()
        job = ending.request.work if ending.request is not None else None
        assert isinstance(job, StopJob)
        code = station.family.stops[job.action].code
        good = outcome in (Outcome.DONE, Outcome.VERIFIED)
        try:
            report = self.report(station.name, code, ending, outcome, reason)
        except OperationError:
            # A reload took the drive out of the roster meanwhile: the stop was sent all the same.
            kind = "" if good else kind_of(ending, outcome, reason)
            report = WriteReport(station.name, code, outcome, reason, kind=kind)
        return report if good else replace(report, remedy=STOP_REMEDY)

    def _group(self, group: str) -> GroupEntry:
        entry = self._groups.get(group)
        if entry is None:
            raise OperationError(
                f"there is no group {group!r}",
                kind="no-such-group",
                remedy="the groups are: " + ", ".join(self._groups),
            )
        return entry

    def _targets(self, target: str) -> tuple[str, ...]:
        if target in self._entries:
            return (target,)
        if target in self._groups:
            return tuple(self._groups[target].members)
        raise OperationError(
            f"there is no drive and no group {target!r}",
            kind="no-such-drive",
            drive=target,
            remedy="they are: " + ", ".join((*self._entries, *self._groups)),
        )

    def _shared_stop(
        self,
        target: str,
        stations: tuple[Station, ...],
        able: tuple[Station, ...],
        action: StopAction,
    ) -> Request | None:
        """The one telegram that stops all of them, if there is one."""
        group = self._groups.get(target)
        if group is None or group.multicast_address is None or len(able) != len(stations):
            return None
        telegrams: dict[tuple[Code, str], tuple[Code, Value]] = {}
        for one in able:
            word = usable_word(self._words.get(one.name))
            if needs_control_word(one.family, action) and (
                word is None or self._is_being_inhibited(one.name)
            ):
                return None
            code, value = stop_value(one.family, action, word)
            telegrams[code, value.raw] = (code, value)
        if len(telegrams) != 1:
            return None
        code, value = next(iter(telegrams.values()))
        form = shared_form(able, code)
        if form is None:
            return None
        return self._requests.maker.multicast(
            Station(target, group.multicast_address, able[0].family, (form,)),
            able, code, value, Priority.STOP, settle=ignore_end,
            stops=tuple(one.name for one in able),
        )  # fmt: skip

    def _is_being_inhibited(self, name: str) -> bool:
        """Whether a stop is about to change the control word that was read last."""
        for action in StopAction:
            waiting = self._stops.get((name, action))
            job = waiting.request.work if waiting is not None else None
            if isinstance(job, StopJob) and job.action is StopAction.INHIBIT:
                return True
        return False

    def _submit_shared(self, target: str, action: StopAction, shared: Request) -> None:
        """Send a telegram that stops all, unless the same one waits already."""
        waiting = self._shared.get((target, action))
        same = waiting is not None and said_by(waiting) == said_by(shared)
        if waiting is not None and same and self._requests.worker.schedule.join(waiting):
            return
        self._requests.worker.submit(shared)
        self._shared[target, action] = shared

    def _say_stop(self, station: Station, action: StopAction, *, said: bool) -> Ending:
        """Send a stop to one drive; one like it that waits to be said stands for this one too."""
        self._stops_said[station.name] += 1
        ending = Ending()
        waiting = self._stops.get((station.name, action))
        same = waiting is not None and station_of(waiting.request) is station
        if waiting is not None and same and self._requests.worker.schedule.join(waiting.request):
            ending.request = waiting.request
            waiting.endings.append(ending)
            return ending
        self._submit_stop(station, action, ending, said=said)
        if action is StopAction.INHIBIT:
            # A quick stop asked for meanwhile must read the word, not lift the inhibit.
            self._words.disturbed(station.name, station.family.stops[action].code)
        return ending

    def _submit_stop(
        self, station: Station, action: StopAction, ending: Ending, *, said: bool
    ) -> None:
        name, endings = station.name, [ending]

        def settle(outcome: Outcome, reason: str) -> None:
            current = self._stops.get((name, action))
            if current is not None and current.endings is endings:
                del self._stops[name, action]
            for one in endings:
                one.settle(outcome, reason)

        absent = self._state_of(station) is DriveState.OFFLINE
        ending.request = request = self._requests.maker.stop(
            station, action, word=lambda: self._words.get(name), said=said, settle=settle,
            patience_s=ABSENT_PATIENCE_S if absent else STOP_PATIENCE_S,
        )  # fmt: skip
        self._requests.worker.submit(request)
        self._stops[name, action] = _OpenStop(request, endings)


def shared_form(stations: Sequence[Station], code: Code) -> Form | None:
    """The form in which one telegram says a code to all: the first that every member knows.

    A drive whose code bank is set is spoken to in extended addressing only: a multicast in the
    other would write another code of it.
    """
    known = (form for form in stations[0].forms if code.knows(form))
    return next((form for form in known if all(form in one.forms for one in stations)), None)


def station_of(request: Request) -> Station:
    """The drive a stop goes to: after a reload its name may be another's."""
    job = request.work
    assert isinstance(job, StopJob)
    return job.station


def said_by(request: Request) -> Step:
    """The telegram of a multicast."""
    job = request.work
    assert isinstance(job, MulticastJob)
    return job.step
