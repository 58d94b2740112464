"""The stop of a drive, a group or all.

A stop differs from other requests: it is sent to offline drives too (a drive that does not answer
may still receive), and it needs no permission. After a multicast stop every member is read back; a
member that does not show the stop is stopped by a separate telegram. So is one that showed it
before and was not stopped by the line: its reading would not show that it heard the multicast. A
second stop of a drive that is asked for while the first waits shares the first one's telegram and
outcome. Members that may run go first, behind a multicast in the order in which their watchdogs
must be fed; telegrams to those that showed the stop before let feeds of other drives go ahead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction, knows_stop, needs_control_word, stop_value
from lecombus.drives.stops import STOP_PATIENCE_S, usable_word
from lecombus.errors import OperationError
from lecombus.fieldbus.requests import JobStep, MulticastWork, Station, StopWork
from lecombus.operations.awaited_requests import Ending
from lecombus.operations.context import OperationContext
from lecombus.operations.operation_reports import GroupReport, Proof, WriteReport, group_report
from lecombus.operations.writes import Writes
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Request

__all__ = ["STOP_REMEDY", "Stops"]

ABSENT_PATIENCE_S = 1.5
"""How long a stop of a drive that was offline is repeated without an answer, seconds."""

SHOWN = {StopAction.INHIBIT: "inhibited", StopAction.QUICK_STOP: "quick stop"}
"""What a reading that proves a stop shows."""

STOP_REMEDY = (
    "the motor may turn: use the emergency stop circuit, or take the controller enable or the "
    "mains from the drive at its terminals; then look for the cause and stop it again, so that "
    "it is known to be stopped"
)
"""What a person has to do when a stop is not proven; asking again is not enough."""


@dataclass(slots=True)
class _OpenStop:
    """The last stop of one kind of one drive, and all that wait for its end."""

    request: Request
    endings: list[Ending]


class Stops:
    """Stops drives, groups or all drives of one line."""

    def __init__(self, context: OperationContext, writes: Writes) -> None:
        self._context = context
        self._writes = writes
        self._stops: dict[tuple[str, StopAction], _OpenStop] = {}
        self._shared: dict[tuple[str, StopAction], Request] = {}

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        """Stop a drive, a group or all, ahead of everything else.

        Args:
            action: Quick stop or inhibit.
            target: A drive's or a group's name; `all` is a group.

        Raises:
            OperationError: No such target, or no drive of it knows this stop.
            LineError: There is no line; nothing was sent.
        """
        stations = tuple(
            self._context.requests.station(name) for name in self._context.members(target)
        )
        able = tuple(one for one in stations if knows_stop(one.family, action))
        if not able:
            raise OperationError(
                f"no {action} is known for {target}",
                kind="no-stop",
                drive=target,
                remedy="write the code that stops this device, or name its family in the roster",
            )
        shared = self._shared_stop(target, stations, able, action)
        if shared is not None:
            self._submit_shared(target, action, shared)
        otherwise = {
            one.name
            for one in able
            if self._context.stands_otherwise(one, one.family.stops[action].code)
        }
        order = self._in_order(able, otherwise, by_watchdog=shared is not None)
        endings = {
            one.name: self._say_stop(
                one,
                action,
                said=shared is not None and one.name not in otherwise,
                repeats=shared is not None and one.name in otherwise,
            )
            for one in order
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

    def _in_order(
        self, able: Iterable[Station], otherwise: Collection[str], *, by_watchdog: bool
    ) -> list[Station]:
        """Put first the drives that may run, and of these those that answer.

        Each attempt at a silent one waits for its time-out. Behind a multicast the one goes first
        whose watchdog can wait least: nothing but its proof feeds it meanwhile.
        """
        feed_by_s = self._context.requests.worker.schedule.feed_by_s

        def place(one: Station) -> tuple[bool, int, float]:
            by_s = feed_by_s(one.name) if by_watchdog else 0.0
            return one.name in otherwise, self._context.silence_of(one), by_s

        return sorted(able, key=place)

    async def _stop_report(self, station: Station, ending: Ending) -> WriteReport:
        """Wait for a stop and report it by the code written, which may be that of an inhibit."""
        outcome, reason = await ending.wait()
        job = ending.request.work if ending.request is not None else None
        assert isinstance(job, StopWork)
        code = station.family.stops[job.action].code
        report = self._writes.report(station.name, code, ending, outcome, reason)
        if outcome is Outcome.VERIFIED and job.proof is not None and job.proof_code is not None:
            shows = "command held" if job.proof_code == code else SHOWN[job.action]
            return replace(report, proof=Proof(job.proof_code, job.proof.raw, shows))
        return report if outcome.is_good else replace(report, remedy=STOP_REMEDY)

    def _shared_stop(
        self,
        target: str,
        stations: tuple[Station, ...],
        able: tuple[Station, ...],
        action: StopAction,
    ) -> Request | None:
        """Return the one telegram that stops all of them, None where there is none."""
        group = self._context.groups.get(target)
        if group is None or group.multicast_address is None or len(able) != len(stations):
            return None
        telegrams: dict[tuple[Code, str], tuple[Code, Value]] = {}
        for one in able:
            word = usable_word(self._context.control_word(one.name).get())
            if needs_control_word(one.family, action) and (
                word is None or self._is_being_inhibited(one.name)
            ):
                return None
            code, value = stop_value(one.family, action, word)
            telegrams[code, value.raw] = (code, value)
        if len(telegrams) != 1:
            return None
        code, value = next(iter(telegrams.values()))
        form = self._context.requests.maker.shared_form(able, code)
        if form is None:
            return None
        names = tuple(one.name for one in able)

        def settle(outcome: Outcome, _: str) -> None:
            if outcome is Outcome.REFUSED:  # it was not sent
                for name in names:
                    self._begin_unsaid(name, action)

        shared = self._context.requests.maker.multicast(
            Station(target, group.multicast_address, able[0].family, (form,)),
            able, code, value, Priority.STOP, settle=settle, stops=names,
        )  # fmt: skip
        if any(needs_control_word(one.family, action) for one in able):
            shared.is_outdated = lambda: self._is_outdated(able, action, value)
        return shared

    def _is_outdated(self, able: tuple[Station, ...], action: StopAction, value: Value) -> bool:
        """Whether a telegram for all would now write another word to one of them.

        Since it was made one may have been read as inhibited: the telegram would lift that.
        """
        for one in able:
            word = usable_word(self._context.control_word(one.name).get())
            if word is None or stop_value(one.family, action, word)[1].raw != value.raw:
                return True
        return False

    def _begin_unsaid(self, name: str, action: StopAction) -> None:
        """Have the stop of a drive begin with its own telegram."""
        waiting = self._stops.get((name, action))
        if waiting is None or waiting.request.attempts:
            return
        assert isinstance(waiting.request.work, StopWork)
        waiting.request.work.begin_unsaid()
        self._context.requests.worker.schedule.yield_no_more(waiting.request)

    def _is_being_inhibited(self, name: str) -> bool:
        """Whether a stop is about to change the control word that was read last."""
        for action in StopAction:
            waiting = self._stops.get((name, action))
            job = waiting.request.work if waiting is not None else None
            if isinstance(job, StopWork) and job.action is StopAction.INHIBIT:
                return True
        return False

    def _submit_shared(self, target: str, action: StopAction, shared: Request) -> None:
        """Send a telegram that stops all, unless the same one waits already."""
        waiting = self._shared.get((target, action))
        same = waiting is not None and telegram_of(waiting) == telegram_of(shared)
        if waiting is not None and same and self._context.requests.worker.schedule.join(waiting):
            return
        self._context.requests.worker.submit(shared)
        self._shared[target, action] = shared

    def _say_stop(
        self, station: Station, action: StopAction, *, said: bool, repeats: bool
    ) -> Ending:
        """Submit a stop of one drive, or join one of the same kind that waits."""
        self._context.stop_marks.note_stop(station.name)
        ending = Ending()
        waiting = self._stops.get((station.name, action))
        same = waiting is not None and station_of(waiting.request) is station
        if (
            waiting is not None
            and same
            and self._context.requests.worker.schedule.join(waiting.request, yields=repeats)
        ):
            ending.request = waiting.request
            waiting.endings.append(ending)
            return ending
        self._submit_stop(station, action, ending, said=said, repeats=repeats)
        if action is StopAction.INHIBIT:
            # A quick stop that comes before this inhibit is sent must not lift it.
            self._context.control_word(station.name).inhibiting()
        return ending

    def _submit_stop(
        self, station: Station, action: StopAction, ending: Ending, *, said: bool, repeats: bool
    ) -> None:
        name, endings = station.name, [ending]

        def settle(outcome: Outcome, reason: str) -> None:
            current = self._stops.get((name, action))
            if current is not None and current.endings is endings:
                del self._stops[name, action]
            for one in endings:
                one.settle(outcome, reason)

        absent = self._context.store.state(name) is DriveState.OFFLINE
        entry = self._context.entries.get(name)
        ending.request = request = self._context.requests.maker.stop(
            station, action, word=lambda: self._context.control_word(name).word(),
            inhibited=lambda: self._context.control_word(name).inhibited(),
            last_word=lambda: self._context.control_word(name).last(), said=said, settle=settle,
            repeats=repeats, silent=bool(self._context.silence_of(station)),
            offline=absent,
            may_inhibit=entry is None or entry.stop_fallback == "inhibit",
            patience_s=ABSENT_PATIENCE_S if absent else STOP_PATIENCE_S,
        )  # fmt: skip
        self._context.requests.worker.submit(request)
        self._stops[name, action] = _OpenStop(request, endings)


def station_of(request: Request) -> Station:
    """The station of a stop: after a reload the name may be that of another drive."""
    job = request.work
    assert isinstance(job, StopWork)
    return job.station


def telegram_of(request: Request) -> JobStep:
    """The telegram of a multicast."""
    job = request.work
    assert isinstance(job, MulticastWork)
    return job.step
