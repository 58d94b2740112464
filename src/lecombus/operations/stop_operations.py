"""The stop of a drive, a group or all.

A stop is different from everything else: it is sent to drives that are offline too (their answer
may be lost, not their hearing), it needs no permission, and a multicast that says it to all is
followed by reading back every member and, where that does not show the stop, by a stop to the
member alone. Stops that wait to be said are shared: whoever asks again waits for the same one.

What must not live here: HTTP, telegrams, waiting lists, and how a stop is proven (`line.stop_job`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from lecombus.drives import StopAction, knows_stop, needs_control_word, stop_value
from lecombus.drives.stops import usable_word
from lecombus.errors import OperationError, meant
from lecombus.line.station import Station
from lecombus.line.stop_job import STOP_PATIENCE_S, StopJob
from lecombus.operations.control_words import ControlWords
from lecombus.operations.drive_operations import Operations
from lecombus.operations.endings import kind_of
from lecombus.operations.multicasts import said_by, shared_form
from lecombus.operations.reports import GroupReport, Proof, WriteReport, group_report
from lecombus.operations.request_maker import ignore_end
from lecombus.operations.requests import Ending, Requests
from lecombus.operations.wear import Wear
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import DriveState
from lecombus.schedule import Outcome, Priority, Request
from lecombus.store import Store

__all__ = ["STOP_REMEDY", "StopOperations"]

ABSENT_PATIENCE_S = 1.5
"""How long a drive that was offline already is told to stop while it does not answer, seconds."""

SHOWN = {StopAction.INHIBIT: "inhibited", StopAction.QUICK_STOP: "quick stop"}
"""What a reading that proves a stop shows."""

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


class StopOperations(Operations):
    """Adds to the operations on one drive the stop of it, or of several."""

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
        shared = self._shared_stop(target, stations, able, action)
        if shared is not None:
            self._submit_shared(target, action, shared)
        # Whoever answers is stopped first: one that is silent holds the line at every attempt.
        endings = {
            one.name: self._say_stop(one, action, said=shared is not None)
            for one in sorted(able, key=self.silence_of)
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
        return self._store.state(station.name)

    def silence_of(self, station: Station) -> int:
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
        if outcome is Outcome.VERIFIED and job.proof is not None and job.proof_code is not None:
            shows = "command held" if job.proof_code == code else SHOWN[job.action]
            return replace(report, proof=Proof(job.proof_code, job.proof.raw, shows))
        return report if good else replace(report, remedy=STOP_REMEDY)

    def _targets(self, target: str) -> tuple[str, ...]:
        if target in self._entries:
            return (target,)
        if target in self._groups:
            return tuple(self._groups[target].members)
        raise OperationError(
            f"there is no drive and no group {target!r}",
            kind="no-such-drive",
            drive=target,
            remedy=meant(target, (*self._entries, *self._groups), "they"),
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
        self._requests.note_stop(station.name)
        ending = Ending()
        waiting = self._stops.get((station.name, action))
        same = waiting is not None and station_of(waiting.request) is station
        if waiting is not None and same and self._requests.worker.schedule.join(waiting.request):
            ending.request = waiting.request
            waiting.endings.append(ending)
            return ending
        self._submit_stop(station, action, ending, said=said)
        if action is StopAction.INHIBIT:
            # A quick stop asked for meanwhile must not lift the inhibit.
            self._words.inhibiting(station.name)
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
        entry = self._entries.get(name)
        ending.request = request = self._requests.maker.stop(
            station, action, word=lambda: self._words.word(name),
            inhibited=lambda: self._words.inhibited(name),
            last_word=lambda: self._words.last(name), said=said, settle=settle,
            silent=bool(self.silence_of(station)),
            may_inhibit=entry is None or entry.stop_fallback == "inhibit",
            duplicates=self._requests.worker.talk.duplicates,
            patience_s=ABSENT_PATIENCE_S if absent else STOP_PATIENCE_S,
        )  # fmt: skip
        self._requests.worker.submit(request)
        self._stops[name, action] = _OpenStop(request, endings)


def station_of(request: Request) -> Station:
    """The drive a stop goes to: after a reload its name may be another's."""
    job = request.work
    assert isinstance(job, StopJob)
    return job.station
