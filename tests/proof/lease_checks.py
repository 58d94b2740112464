"""What a lease promises, held against the wire, the drives and what the controllers were answered.

Who holds what is reckoned here once more, from the answers that the controllers got and from the
clock: nothing is asked of the daemon's own leases. Then:

* A write goes out only with the token of the lease that is held for its drive when it is handed to
  the port; without a token only where none is needed or held. While the drive is latched, no
  control word goes out but those of an enable, and a setpoint only while the line has it stopped.
* No latched drive starts or takes another setpoint while it is let run, as the drive itself shows.
* After a lapse its stop begins within the wait that the plan promises for stops; stops of other
  drives add their line time, and a daemon that does not run the time for which it does not.
* It is carried out once: further stops only if the last was not proven or the drive was away.
  A drive under a lease, or whose policy is not a stop, is not stopped by the daemon.
* `silence`: no telegram but those of stops that clients ask for, until a lease is held and the
  watchdog's time has passed since the last one. By then the watchdog has acted.
* A drive that needs a lease and has none does not go on running.
* Each latched drive has a remark, and no other; with `hold` it says that the drive runs on.
* No lease ends before its time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Final

from lecombus.capacity.exchange_costs import watched_s
from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction
from lecombus.fieldbus.lecom.exchanges.jobs import WriteJob
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.line_runtime import LineRuntime
from lecombus.schedule import Outcome, Priority, Request
from proof.lines import RandomLine
from proof.stops import Stops
from proof.telegrams import Telegram
from proof.watchdogs import Watchdogs

__all__ = ["ASKED_WITH", "ENABLING", "Held", "LeaseChecks"]

ASKED_WITH: Final[ContextVar[str | None]] = ContextVar("ASKED_WITH", default=None)
"""The token with which a client asks, empty: without; None: the daemon asks by itself."""
ENABLING: Final[ContextVar[bool]] = ContextVar("ENABLING", default=False)
"""Whether what a client asks for is the verb `enable`."""

SETPOINTS = {"smvector": {(140, 0), (1061, 0)}, "93xx": {(141, 0)}}
CONTROL = {(40, 0), (135, 0)}
EPSILON_S = 1e-6
FOLLOWS_S = 3.0
"""So long after a telegram a drive may still be doing what it was told: modules pass it on late."""
SHOWN_S = 1.0
"""A remark follows what happened within this."""
LOOK_AGAIN_S = 1.0
"""What a drive does is seen within this, so that it is known behind which telegram it did it."""
SETTLES_S = 6.0
"""A drive that came back is looked at, and its words are waited for, for less than this."""


@dataclass
class Held:
    """A lease as its controller knows it.

    Args:
        name: Its name.
        token: Its token.
        drives: What it holds.
        time_s: How long it lasts without a renewal, seconds.
        end_s: When it lapses, as the last answer says.
        counter: The counter of the last renewal.
    """

    name: str
    token: str
    drives: tuple[str, ...]
    time_s: float
    end_s: float
    counter: int = 1


@dataclass
class _Lapse:
    """The stop that is due for one drive."""

    at_s: float
    stops_s: float  # line time of all stops by then
    excused: bool = False


@dataclass
class _Drive:
    """Who controls one drive, as reckoned here."""

    name: str
    policy: str
    required: bool
    latched: bool
    held: Held | None = None
    changed_s: float = -math.inf
    lapsed: bool = False
    lapses: int = 0
    ran_out: int = 0  # lapses in which it was not given up
    stops_open: int = 0  # of the last lapse
    proven: bool = False
    of_several: bool = False  # the stop is of several drives: not over when this one is proven
    away: bool = True
    away_s: float = -math.inf
    silent_from_s: float | None = None
    last_s: float = -math.inf  # the last telegram that it could hear
    was_silent: bool = False
    fired: int = 0  # how often its watchdog had acted at the last telegram
    moved_s: float = -math.inf  # the last telegram that was allowed to move it
    moves: tuple[bool, float] | None = None


@dataclass
class _Asked:
    token: str | None
    enabling: bool
    text: str | None = None
    code: tuple[int, int] = (0, 0)


@dataclass
class Counts:
    """What a line has shown of leases, so that a run that shows nothing is seen."""

    taken: int = 0
    renewed: int = 0
    taken_over: int = 0
    released: int = 0
    lapsed: int = 0
    stopped: int = 0
    silenced: int = 0
    held_on: int = 0
    enabled: int = 0
    refused: int = 0
    withdrawn: int = 0
    set_while_latched: int = 0
    latest: float = field(default=0.0)


class LeaseChecks:
    """Watches the leases of one line.

    Args:
        line: The line.
        sim: Its drives.
        site: What runs it.
        stops: Knows within what a stop begins.
        watchdogs: Judges none while several drives are stopped.
        left: Told of drives that are left to their watchdogs, from now on or later.
        clock: Line time.
        say: Told what did not hold.
    """

    def __init__(
        self,
        line: RandomLine,
        sim: SimLine,
        site: LineRuntime,
        stops: Stops,
        watchdogs: Watchdogs,
        left: Callable[[str], None],
        clock: Callable[[], float],
        say: Callable[[str], None],
    ) -> None:
        self._line = line
        self._sim = sim
        self._site = site
        self._stops = stops
        self._watchdogs = watchdogs
        self._left = left
        self._clock = clock
        self._say = say
        self._clean = line.kind != "faulty"
        self.begun: set[str] = set()
        self._drives = {
            one.name: _Drive(one.name, one.lease.on_lapse, one.lease.required, one.lease.required)
            for one in line.roster.drives
        }
        for one in self._drives.values():
            if one.required and one.policy == "silence":
                left(one.name)  # it may be silenced from the start on
        self._watched_s = {one.name: watched_s(one) or 0.0 for one in line.roster.drives}
        self._families = {one.name: one.family for one in line.roster.drives}
        self._names = {one.address: one.name for one in line.roster.drives}
        self._held: dict[str, Held] = {}
        self._asked: dict[Request, _Asked] = {}
        self._due: dict[str, _Lapse] = {}
        self._stops_s = 0.0
        self._apart_s = 2.0 * max(self._watched_s.values(), default=0.0)
        self.counts = Counts()
        self._over = False
        self._looked_s = -math.inf

    # -- what the controllers were answered --------------------------------------------------

    def holder(self, drive: str) -> Held | None:
        """Give the lease that is held for a drive."""
        self.advance(self._clock())
        return self._drives[drive].held

    def taken(self, held: Held, former: Held | None) -> None:
        """A lease was granted, or taken over from a former one."""
        self.advance(self._clock())
        for name in held.drives:
            other = self._drives[name].held
            if other is not None and other is not former:
                self._say(f"{name} was given to {held.name}, and {other.name} holds it")
            self._drives[name].held = held
            self._end_silence(self._drives[name], self._clock())
        if former is not None:
            self._held.pop(former.token, None)
            self.counts.taken_over += 1
        self._held[held.token] = held
        self.counts.taken += 1

    def renewed(self, held: Held) -> None:
        """A lease was renewed: its end has been moved."""
        if self._held.get(held.token) is not held:
            self._say(f"lease {held.name} was renewed, and it had ended")
        self.counts.renewed += 1

    def lost(self, held: Held) -> None:
        """A renewal or a write with the token of a lease was refused, because it had ended."""
        self.advance(self._clock())
        self.counts.refused += 1
        if self._held.get(held.token) is held and not self._line.pauses:
            left_s = held.end_s - self._clock()
            if left_s > EPSILON_S:
                self._say(f"lease {held.name} had ended {left_s:.3f} s before its time")

    def released(self, held: Held) -> None:
        """A lease was given up."""
        self.counts.released += 1
        self._end(held, self._clock(), lapsed=False)

    def enabled(self, drive: str, token: str) -> None:
        """A drive was enabled, proven, with a token."""
        now_s, one = self._clock(), self._drives[drive]
        self.advance(now_s)
        if one.held is not None and one.held.token == token and one.latched:
            one.latched, one.lapsed, one.changed_s = False, False, now_s
            self.counts.enabled += 1

    def lost_power(self, drive: str) -> None:
        """A drive was switched off: it begins as its manual says."""
        self._drives[drive].moves = None

    # -- who holds what ----------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """End what has lapsed by now."""
        if self._over:
            return
        for held in [one for one in self._held.values() if one.end_s <= now_s]:
            self._end(held, held.end_s, lapsed=True)

    def _end(self, held: Held, at_s: float, *, lapsed: bool) -> None:
        self._held.pop(held.token, None)
        self.counts.lapsed += lapsed
        for name in held.drives:
            one = self._drives[name]
            if one.held is not held:
                continue
            self._end_silence(one, at_s)
            one.held = None
            if lapsed or one.required:
                one.latched, one.lapsed, one.changed_s, one.proven = True, True, at_s, False
                one.lapses, one.stops_open = one.lapses + 1, 0
                one.of_several = len(held.drives) > 1
                one.ran_out += lapsed
                self._carry_out(one, at_s, lapsed=lapsed)

    def _carry_out(self, one: _Drive, at_s: float, *, lapsed: bool) -> None:
        if one.policy in set(StopAction):
            self._due.setdefault(one.name, _Lapse(at_s, self._stops_s))
            self._excuse(at_s)
        elif one.policy == "silence":
            self._left(one.name)
            if lapsed and one.silent_from_s is None:
                one.silent_from_s = at_s
                self.counts.silenced += 1
        else:
            self.counts.held_on += 1

    def _excuse(self, at_s: float) -> None:
        """Stops of several drives that lapse together take more than watchdogs need outlast."""
        self._watchdogs.excuse(at_s + self._apart_s)

    # -- requests ----------------------------------------------------------------------------

    def asked(self, request: Request) -> Callable[[Outcome], None] | None:
        """Something is asked of the line: remember by whom, and with which token."""
        asked = _Asked(ASKED_WITH.get(), ENABLING.get())
        job = request.work
        if isinstance(job, WriteJob):
            asked.text, asked.code = job.value.raw, (job.code.number, job.code.subcode)
        self._asked[request] = asked
        one = self._drives.get(request.drive)
        stop = request.priority is Priority.STOP and one is not None and asked.token is None
        if stop and one is not None:
            self._own_stop(one)
        lapses = one.lapses if one is not None else 0

        def ended(outcome: Outcome) -> None:
            self._asked.pop(request, None)
            if outcome is Outcome.REFUSED and asked.text is not None:
                self.counts.withdrawn += 1
            if stop and one is not None and outcome is not Outcome.VERIFIED:
                self._left(one.name)  # its own watchdog may be left to stop it
            if stop and one is not None and one.lapses == lapses:
                one.stops_open -= 1
                self.begun.discard(one.name)
                one.proven = outcome is Outcome.VERIFIED
                self.counts.stopped += one.proven
                self._excuse(self._clock())
                if one.proven and not one.of_several:  # it may have been away behind its proof
                    one.away = False

        return ended

    def _own_stop(self, one: _Drive) -> None:
        """The daemon stops a drive by itself."""
        self.advance(self._clock())
        one.stops_open += 1
        if self._over:
            return
        if not one.latched:
            self._say(f"{one.name} was stopped by the daemon, and it is not latched")
        elif one.policy not in set(StopAction):
            self._say(f"{one.name} was stopped by the daemon, and its policy is {one.policy}")
        elif one.proven and not one.away:
            self._say(f"{one.name} was stopped again for the same lapse")
        elif one.stops_open > 1 and not one.away:
            self._say(f"{one.name} was stopped twice for one lapse")
        if one.proven:
            one.of_several = False  # this is a further stop, of this drive alone

    # -- the wire ----------------------------------------------------------------------------

    def said(self, telegram: Telegram, request: Request | None) -> None:
        """A telegram is handed to the port for a request."""
        now_s = telegram.said_s
        self.advance(now_s)
        self._note_away(now_s)
        asked = self._asked.get(request) if request is not None else None
        stop = request is not None and request.priority is Priority.STOP
        for one in self._reached(telegram):
            self._judge_silence(one, now_s, stop_of_client=stop and asked is not None
                                and asked.token is not None, group=telegram.group)  # fmt: skip
            if telegram.text is not None and not stop:
                self._judge_write(one, telegram, asked)

    def _reached(self, telegram: Telegram) -> list[_Drive]:
        if not telegram.group:
            name = self._names.get(telegram.address)
            return [] if name is None else [self._drives[name]]
        decade = telegram.address // 10
        return [
            self._drives[name] for address, name in self._names.items()
            if decade == 0 or address // 10 == decade
        ]  # fmt: skip

    def _note_away(self, now_s: float) -> None:
        """Note which latched drives do not answer, as is shown: they may be stopped again."""
        silent, store = self._site.schedule.silent, self._site.store
        for one in self._drives.values():
            if one.latched and store.state(one.name) is not DriveState.ONLINE:
                one.away, one.away_s = True, now_s
        for name, lapse in self._due.items():
            if name in silent or store.state(name) is not DriveState.ONLINE:
                lapse.excused = True

    def _judge_silence(
        self, one: _Drive, now_s: float, *, stop_of_client: bool, group: bool
    ) -> None:
        if one.policy == "silence":
            self._end_silence(one, now_s)
            self._judge_watchdog(one)
        from_s, last_s, one.last_s = one.silent_from_s, one.last_s, now_s
        if from_s is None or stop_of_client or group or self._is_unknown(from_s, now_s):
            return
        if one.held is None:
            self._say(f"{one.name} was spoken to, and is to be silent since {from_s - 1000:.3f} s")
        else:
            text = f"{one.name} was spoken to {now_s - last_s:.3f} s after the last"
            needed_s = self._watched_s[one.name]
            self._say(f"{text} telegram, and its watchdog needs {needed_s:g} s")
        one.silent_from_s = None

    def _end_silence(self, one: _Drive, at_s: float) -> None:
        """A silence is over while a lease is held, and its watchdog's time has passed."""
        if one.silent_from_s is None or one.held is None:
            return
        if at_s - one.last_s >= self._watched_s[one.name] - EPSILON_S:
            one.silent_from_s, one.was_silent = None, True

    def _judge_watchdog(self, one: _Drive) -> None:
        """The first telegram after a silence: see that the drive's own watchdog has acted."""
        self._sim.advance(self._clock())
        model, was_silent = self._sim[one.name].model, one.was_silent
        fired, one.fired, one.was_silent = one.fired, model.watchdog_fired, False
        if not was_silent or self._line.kind not in ("quiet", "loaded"):  # it heard everything
            return
        if self._watched_s[one.name] and model.watchdog_setting()[1] and one.fired == fired:
            self._say(f"the silence of {one.name} is over, and its watchdog has not acted")

    def _is_unknown(self, end_s: float, now_s: float) -> bool:
        """Whether the daemon could not yet know of an end: it is of now, or it did not run."""
        passed_s = now_s - end_s
        return passed_s - self._stops.paused_s(end_s, now_s) <= EPSILON_S

    def _judge_write(self, one: _Drive, telegram: Telegram, asked: _Asked | None) -> None:
        code, text = telegram.code, telegram.text
        what = f"{text} was written to C{code[0]:04d} of {one.name}"
        moving = code in CONTROL or code in SETPOINTS.get(self._families[one.name], {(46, 0)})
        if asked is None or asked.token is None:
            if moving:
                self._say(f"{what}, and nobody asked for it")
            return
        if asked.text is not None and (asked.code, asked.text) != (code, text):
            self._say(f"{what} for a request of {asked.text} to C{asked.code[0]:04d}")
        if (code, text) == ((40, 0), "0"):
            return
        if self._is_unknown(one.changed_s, telegram.said_s):
            one.moved_s = telegram.said_s  # it may have been allowed
            return
        why = self._why_not(one, asked, moving=moving, command=code in CONTROL)
        if why:
            self._say(f"{what}: {why}")
        elif one.latched and moving and not asked.enabling:
            self.counts.set_while_latched += 1  # it is not an excuse for a drive that moves
        else:
            one.moved_s = telegram.said_s

    def _why_not(self, one: _Drive, asked: _Asked, *, moving: bool, command: bool) -> str:
        held = one.held
        if not asked.token:
            if held is not None:
                return f"without a token, and {held.name} holds it"
            if one.required or one.latched:
                return "without a token, and it needs one"
            return ""
        if held is None or held.token != asked.token:
            return "with a token that counts no more"
        if one.latched and moving and not asked.enabling:
            if command:
                return "while it is latched"
            self._sim.advance(self._clock())
            model = self._sim[one.name].model
            if not (model.inhibited() or model.stop_wanted()):
                return "while it is latched, and the line has not stopped it"
        return ""

    def ended(self, report: ExchangeReport) -> None:
        """An exchange ended: judge stops, and look at the drives that it reached."""
        self.advance(self._clock())
        result = report.result
        names = [report.drive, *report.members]
        if report.priority is Priority.STOP:
            for name in names:
                lapse = self._due.get(name)
                if lapse is not None and result.ended_s >= lapse.at_s:
                    del self._due[name]
                    self._judge_lapse(name, lapse, result.started_s)
            self.begun.update(name for name in names if self._has_own_stop(name))
            self._stops_s += result.ended_s + report.quarantined_s - result.started_s
        for name in names:
            if name in self._drives:
                self._look_at(self._drives[name])
        if self._clock() - self._looked_s >= LOOK_AGAIN_S:
            self._look_at_all()  # the clients that call `look` may have ended

    def _has_own_stop(self, name: str) -> bool:
        return name in self._drives and self._drives[name].stops_open > 0

    def _judge_lapse(self, name: str, lapse: _Lapse, began_s: float) -> None:
        waited_s = began_s - lapse.at_s
        more_s = self._stops_s - lapse.stops_s + self._stops.paused_s(lapse.at_s, began_s)
        promised_s = self._stops.promised_s(waited_s - more_s)
        if not lapse.excused:
            self.counts.latest = max(self.counts.latest, (waited_s - more_s) / promised_s)
            if waited_s > promised_s + more_s:
                text = f"the lapse of {name} waited {waited_s:.3f} s"
                self._say(f"{text}, promised {promised_s + more_s:.3f} s")

    # -- the drives --------------------------------------------------------------------------

    def _look_at(self, one: _Drive) -> None:
        """See that a latched drive neither started nor took another setpoint."""
        model = self._sim[one.name].model
        free = not (model.pulses_off() or model.stop_wanted())
        before, one.moves = one.moves, (free, model.setpoint())
        allowed = self._clock() - one.moved_s < FOLLOWS_S
        if before is None or not one.latched or allowed or one.moves == before:
            return
        if free and not before[0]:
            self._say(f"{one.name} was let run while it is latched")
        elif free and one.moves[1] != before[1]:
            self._say(f"{one.name} took another setpoint while it is latched")

    def _look_at_all(self) -> None:
        """See it of every drive; one that hears nothing still carries out what it was told."""
        self._looked_s = self._clock()
        self._sim.advance(self._looked_s)
        for one in self._drives.values():
            self._look_at(one)

    def look(self) -> None:
        """Compare what is shown, and look for what was forgotten."""
        now_s = self._clock()
        self.advance(now_s)
        self._note_away(now_s)
        self._look_at_all()
        for one in self._drives.values():
            self._judge_remark(one, now_s)
            self._judge_running(one, now_s)
        for name, lapse in list(self._due.items()):
            waited_s = now_s - lapse.at_s
            more_s = self._stops_s - lapse.stops_s + self._stops.paused_s(lapse.at_s, now_s)
            if lapse.excused:
                continue
            if waited_s > self._stops.promised_s(waited_s - more_s) + more_s:
                del self._due[name]
                self._say(f"the lapse of {name} was forgotten: nothing for {waited_s:.3f} s")

    def _judge_remark(self, one: _Drive, now_s: float) -> None:
        if now_s - one.changed_s - self._stops.paused_s(one.changed_s, now_s) < SHOWN_S:
            return
        text = self._site.store.drive(one.name).remarks.get("lease")
        if (text is not None) is not one.latched:
            self._say(f"the remark of {one.name} is {text!r}, and latched is {one.latched}")
        elif one.lapsed and one.policy == "hold" and text is not None and "runs on" not in text:
            self._say(f"{one.name} runs on without a controller, and the remark is {text!r}")

    def _judge_running(self, one: _Drive, now_s: float) -> None:
        """A drive that needs a lease, has none and answers is stopped sooner or later."""
        stopping = one.policy in set(StopAction) and one.required and one.held is None
        if not (stopping and self._clean and one.latched):
            return
        since_s = max(one.away_s, one.changed_s, 1000.0)
        patience_s = SETTLES_S + 3.0 * self._stops.promised_s(0.0) + self._apart_s
        if now_s - since_s < patience_s or one.stops_open:
            return
        model = self._sim[one.name].model
        if not (model.pulses_off() or model.stop_wanted()):
            self._say(f"{one.name} runs without a lease since {since_s - 1000:.1f} s")

    def end(self) -> None:
        """Judge no more."""
        self.look()
        self._over = True
        figures = self._site.supervision.leases.figures()
        lapses = {} if figures is None else figures.lapses
        for one in self._drives.values():
            counted = lapses.get(one.name, 0)
            if counted != one.ran_out and self._clock() - one.changed_s > SHOWN_S:
                self._say(f"{one.name}: {counted} lapses are counted, and {one.ran_out} were")

    def drives_of(self, names: Sequence[str]) -> tuple[str, ...]:
        """Give the drives that a lease must name to take these over, all holders' drives too."""
        found = dict.fromkeys(names)
        for name in names:
            held = self._drives[name].held
            found |= dict.fromkeys(held.drives if held is not None else ())
        return tuple(found)
