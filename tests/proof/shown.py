"""What the daemon shows of drives and motors, held against the drives themselves.

* Who has not answered for long is shown as offline, and no value of it as good. When the port is
  opened again, each drive is `starting` until it was asked: what was said before counts no more.
* A value that is shown as good is the one that the drive gave last, and no older than is allowed.
* A drive that lost its supply and is online again has its watchdog set as the roster says, or a
  remark that it could not be.
* No telegram lets a motor run, or lifts an inhibit, unless somebody asked for an enable.
* A stop that is called verified has stopped its drive; where all answer, every stop is verified,
  and elsewhere none is given up at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import cycle

from lecombus.capacity.load import load_on
from lecombus.config import line_timing
from lecombus.drive_state.readings import DriveState, Quality
from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.fieldbus.lecom.simulator.drive import SimDrive
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.fieldbus.lecom.simulator.model import INHIBIT
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.fieldbus.requests import StepKind
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority
from lecombus.supervision.watchdogs import REMARK
from proof.lines import RandomLine
from proof.losses import TolerantLine
from proof.telegrams import Telegram
from support.lecom_loop import lecom_loop

__all__ = ["Shown"]

SILENT = 6
"""Telegrams in a row that drew nothing, and one says that a drive is away."""
LOOKED_AT = 8
"""Values looked at each time: all in turn."""
LEAST_TRIED_S = 1.5
"""A stop without proof is sent again for at least this long. Source: docs/troubleshooting.md."""
TRIED_S = 5.0
"""For so long a stop of a drive that is online is tried. Source: docs/troubleshooting.md."""
ROUNDING_S = 1e-6
PERIODS, STRETCH_MOST, GRACE_S = 2.0, 4.0, 1.0
"""A cyclic value is good for two periods, as the roster's plan stretches them, and this. Source:
docs/operations.md."""


class Shown:
    """Compares what is shown of one line with what is.

    Args:
        line: The line.
        sim: Its drives.
        site: What shows them.
        clock: Line time.
        say: Told what did not hold.
    """

    def __init__(
        self,
        line: RandomLine,
        sim: SimLine,
        site: LineRuntime,
        clock: Callable[[], float],
        say: Callable[[str], None],
    ) -> None:
        self._sim = sim
        self._site = site
        self._clock = clock
        self._say = say
        self._clean = line.kind != "faulty"
        self._loses_many = isinstance(line, TolerantLine) and (
            line.losses > min(1, line.roster.line.tolerate) or line.is_idle
        )
        self._names = {drive.address: drive.name for drive in line.roster.drives}
        self._silent = dict.fromkeys(self._names.values(), 0)
        self._line_since_s = site.store.line().since_s
        self._guards = {
            drive.name: round(drive.watchdog.time_s * 1000)
            for drive in line.roster.drives
            if drive.watchdog is not None and drive.watchdog.configure
        }
        self._values = [
            (drive.name, entry.code, entry.every_s)
            for drive in line.roster.drives
            for entry in drive.cyclic
        ]
        self._turn = cycle(self._values)
        load = load_on(line.roster.drives, line_timing(line.roster.line))
        self._periods = PERIODS * min(load.stretch, STRETCH_MOST)
        self._failed: set[tuple[str, Code]] = set()
        self._given: dict[tuple[str, Code], tuple[str, float]] = {}
        self._free: dict[str, tuple[bool, bool]] = {}
        self._enabling: dict[str, int] = {}
        self._states: dict[str, DriveState] = {}
        self._powerless: set[str] = set()  # lost their supply and are not known to be back
        self._left: set[str] = set()
        self._enabled_s: dict[str, float] = {}
        self._enable_asked_s: dict[str, float] = {}
        self._proven: dict[str, bool] = {}
        self._proven_s: dict[str, float] = {}
        self._proven_before_s: dict[str, float] = {}  # when the last stop was asked for
        self._leased = line.leased

    # -- what the clients tell ---------------------------------------------------------------

    def left(self, drive: str) -> None:
        """A drive goes away: stops of it may be in vain from now on."""
        self._left.add(drive)

    def lost_power(self, drive: str) -> None:
        """A drive has been without its supply: what its module had is gone."""
        self._free.pop(drive, None)
        if self._site.store.state(drive) is DriveState.OFFLINE:
            self._powerless.add(drive)

    def enable_asked(self, drive: str) -> None:
        """Somebody wants a drive to run."""
        self._enabling[drive] = self._enabling.get(drive, 0) + 1
        self._enable_asked_s[drive] = self._clock()

    def enable_ended(self, drive: str) -> None:
        """That has its outcome."""
        self._sim.advance(self._clock())
        self._look_at_motor(self._sim[drive])
        self._enabling[drive] -= 1
        self._enabled_s[drive] = self._clock()

    def stop_asked(self, drive: str) -> None:
        """Somebody wants a drive to stop: one of all drives may have been proven there already."""
        if self._proven.get(drive):
            self._proven_before_s[drive] = self._proven_s[drive]

    def stop_ended(self, drive: str, outcome: str, asked_s: float) -> None:
        """The stop that was asked for at a time has its outcome."""
        now_s = self._clock()
        self._sim.advance(now_s)
        tried_s = now_s - asked_s
        two = lecom_loop(self._site.worker).second_answers(now_s).may_be_two(drive)
        if outcome == Outcome.UNKNOWN and tried_s < LEAST_TRIED_S and not two:
            self._say(f"the stop of {drive} was given up after {tried_s:.1f} s")
        model = self._sim[drive].model
        standing = model.pulses_off() or model.stop_wanted()
        proven = self._proven.get(drive)
        proven = proven or self._proven_before_s.get(drive, -math.inf) >= asked_s
        if self._leased:  # the multicast of a lapse may come behind the proof of another stop
            proven = proven or self._proven_s.get(drive, -math.inf) >= asked_s
        if outcome == Outcome.VERIFIED and not proven:
            self._say(f"the stop of {drive} is called verified, and was not read back")
        if outcome == Outcome.VERIFIED and not standing and not self._is_enabled(drive):
            self._say(f"the stop of {drive} is called verified, and it is not stopped")
        # Of a drive that was silent a proof takes several answers: with many lost, too long.
        tried = self._loses_many and outcome == Outcome.UNKNOWN and tried_s >= TRIED_S
        # An enable that is asked for while the stop is being proven takes it back.
        is_taken_back = self._enable_asked_s.get(drive, -math.inf) >= asked_s
        answers = self._clean and drive not in self._left and not is_taken_back
        if answers and outcome != Outcome.VERIFIED and not tried:
            self._say(f"the stop of {drive} ended as {outcome}, and it answers")

    # -- what passes -------------------------------------------------------------------------

    def judge(self, one: Telegram) -> None:
        """Take a telegram into account, and look at the drives that it reached."""
        name = self._names.get(one.address)
        if name is None:
            for drive in self._sim.drives:
                self._look_at_motor(drive)
            self._proven.clear()
            return
        if one.stop:
            self._proven[name] = one.text is None and one.answered
            if self._proven[name]:
                self._proven_s[name] = self._clock()
        self._silent[name] = 0 if one.heard else self._silent[name] + 1
        if one.text is not None:
            self._look_at_motor(self._sim[name])

    def ended(self, report: ExchangeReport) -> None:
        """Keep what a drive gave, as the wire has judged it."""
        if report.step.kind is not StepKind.READ:
            return
        key, answer = (report.drive, report.step.code), report.result.answer
        if isinstance(answer, ValueAnswer):
            self._given[key] = answer.value.raw, report.result.ended_s
            self._failed.discard(key)
        elif report.priority is Priority.CYCLIC:
            self._failed.add(key)

    def _look_at_motor(self, drive: SimDrive) -> None:
        model = drive.model
        free = not (model.pulses_off() or model.stop_wanted()), not model.control & INHIBIT
        before = self._free.get(drive.name)
        self._free[drive.name] = free
        if before is None or self._is_enabled(drive.name):
            return
        if free[0] and not before[0]:
            self._say(f"{drive.name} was let run, and nobody has enabled it")
        elif free[1] and not before[1]:
            self._say(f"the inhibit of {drive.name} was lifted, and nobody has enabled it")

    def _is_enabled(self, name: str) -> bool:
        """Whether somebody wants it to run, or did so when it was last written to."""
        passed_s = self._clock() - self._enabled_s.get(name, -math.inf)
        return bool(self._enabling.get(name)) or passed_s < LEAST_TRIED_S

    # -- now and then ------------------------------------------------------------------------

    def begin(self) -> None:
        """Count from here."""
        for drive in self._sim.drives:
            self._look_at_motor(drive)

    def look(self) -> None:
        """Compare what is shown now."""
        store = self._site.store
        self._sim.advance(self._clock())
        for drive in self._sim.drives:
            self._look_at_motor(drive)
        since_s = store.line().since_s
        if since_s != self._line_since_s:
            self._line_since_s = since_s
            self._silent = dict.fromkeys(self._silent, 0)
        for name, silent in list(self._silent.items()):
            state = store.state(name)
            if state is DriveState.STARTING and self._states.get(name) is not state:
                silent = self._silent[name] = 0  # it is asked from the beginning
            self._states[name] = state
            if silent > SILENT and state is not DriveState.OFFLINE:
                self._say(f"{name} is shown as {state}, and {silent} telegrams drew nothing")
            if name in self._powerless and state is DriveState.ONLINE:
                self._powerless.discard(name)
                self._judge_guard(name)
        for _ in range(min(LOOKED_AT, len(self._values))):
            self._judge_value(*next(self._turn))

    def _judge_guard(self, name: str) -> None:
        wanted_ms = self._guards.get(name)
        if wanted_ms is None or REMARK in self._site.store.drive(name).remarks:
            return  # a module's own codes may take longer than others' watchdogs leave
        time_s, action = self._sim[name].model.watchdog_setting()
        if not action or round(time_s * 1000) != wanted_ms:
            text = f"{name} is online after a power failure, and its watchdog is"
            self._say(f"{text} {time_s:g} s, action {action}: {wanted_ms} ms is right")

    def _judge_value(self, name: str, code: Code, every_s: float) -> None:
        reading = self._site.store.reading(name, code)
        if reading is None or reading.quality is not Quality.GOOD:
            return
        given = self._given.get((name, code))
        if given is None:
            return  # it was read before anybody looked
        text, at_s = given
        age_s = self._clock() - at_s
        if self._site.store.state(name) is DriveState.OFFLINE:
            self._say(f"{code} of {name} is shown as good, and the drive is offline")
        elif (name, code) in self._failed:
            self._say(f"{code} of {name} is shown as good, and the last attempt failed")
        elif reading.value is None or reading.value.raw != text:
            self._say(f"{code} of {name} is shown as {reading.value}, and the drive gave {text}")
        elif age_s > self._periods * every_s + GRACE_S + ROUNDING_S:
            self._say(f"{code} of {name} is shown as good, and it is {age_s:.1f} s old")
