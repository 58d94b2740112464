"""Status words read sooner than in their own turn, where what is known of a drive calls for it.

Three things call for it:

* A command to stop or to run went out. What the status words said before it counts no longer, so
  that the drive's motion is not known until they are read: the word that proves the stop and the
  first status word are read in the interactive class.
* A drive answers again after a silence in which its watchdog may have acted. What was read before
  does not count then either; the speed is read too. The first answer of all calls for nothing: all
  that is read cyclically has its first turn then.
* A drive's speed fell to 0 and no command was given. A terminal may have set its quick stop, which
  only the slow second status word (C0068) shows: that is read in the background class, and no more
  often than every `ZERO_GAP_S`.

Of each class one read is in the schedule at a time, for any number of drives: a read that a user
waits for has at most one of these in front of it, and what `plan` promises holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from lecombus.drive_state.drive_runtime import Drive
from lecombus.drive_state.motion import shown_after_lapse
from lecombus.drive_state.store import Store
from lecombus.drives import OperatingState
from lecombus.drives.stops import shown_after
from lecombus.drives.verbs import status_shows_quick_stop
from lecombus.errors import LecombusError
from lecombus.line_events import ExchangeEvent, LineRequests
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Settle

__all__ = ["ZERO_GAP_S", "CommandEffects"]

ZERO_GAP_S: Final = 5.0
"""A motor that stops and starts all the time costs no more than one read in this, seconds."""

OUTPUT: Final = Code(50)
SPEED_CODES: Final = (OUTPUT, Code(150))
AT_ZERO: Final = frozenset((OperatingState.ZERO_SPEED, OperatingState.OUTPUT_FREQUENCY_0))

Ask = Callable[[Drive, Code, Settle], None]
"""Reads a code of a drive; raises a `LecombusError` where that cannot be asked."""


class _OneByOne:
    """Reads that are asked for one after the other, each drive's code once.

    Args:
        ask: Reads a code.
        is_wanted: Whether a code need still be read.
    """

    def __init__(self, ask: Ask, is_wanted: Callable[[Drive, Code], bool]) -> None:
        self._ask = ask
        self._is_wanted = is_wanted
        self._waiting: dict[tuple[Drive, Code], None] = {}
        self._is_asking = False

    def want(self, drive: Drive, code: Code) -> None:
        """Have a code read."""
        self._waiting[drive, code] = None
        self._go_on()

    def _go_on(self) -> None:
        while self._waiting and not self._is_asking:
            drive, code = next(iter(self._waiting))
            del self._waiting[drive, code]
            self._is_asking = True
            try:
                if self._is_wanted(drive, code):
                    self._ask(drive, code, self._ended)
                    return
            except LecombusError:
                pass  # the line or the drive is gone; the code's own turn comes later
            self._is_asking = False

    def _ended(self, outcome: Outcome, reason: str) -> None:
        self._is_asking = False
        self._go_on()


class CommandEffects:
    """Has status words read after a command, and when a motor stops without one.

    Args:
        store: What is known.
        line: Reads codes.
        clock: Monotonic time, seconds.
    """

    def __init__(self, store: Store, line: LineRequests, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._soon = _OneByOne(
            line.read_soon,
            lambda drive, code: (
                store.is_outdated(drive.name, code) or store.is_from_before_lapse(drive.name, code)
            ),
        )
        self._at_zero = _OneByOne(line.read_later, lambda drive, code: True)

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Take an exchange."""
        if event.lapsed and event.drives[0].speed.raw:
            self.lapsed(event.drives[0])
        if event.is_write:
            for drive in event.drives:
                self.written(drive, event.code)
        elif event.read is not None and event.code in SPEED_CODES:
            drive = event.drives[0]
            is_new = drive.speed.raw.get(event.code) != event.read.raw
            if is_new:
                self.seen(drive, event.code, event.read)

    def written(self, drive: Drive, code: Code) -> None:
        """A code was written: read what shows the effect, if it stops drives or lets them run."""
        codes = shown_after(drive.family, code)
        if codes:
            drive.speed.turns = None  # what its speed does now was asked for
        for one in codes:
            self._soon.want(drive, one)

    def lapsed(self, drive: Drive) -> None:
        """A drive was silent for its watchdog's time: read what shows whether that has acted."""
        codes = shown_after_lapse(drive.family, quick_stops=drive.watchdog_quick_stops)
        for one in codes:
            self._soon.want(drive, one)

    def seen(self, drive: Drive, code: Code, value: Value) -> None:
        """Take a new value: of the speed, or of a status word that shows that it is 0."""
        drive.speed.raw[code] = value.raw
        number, family = value.number, drive.family
        if isinstance(number, str | bytes):
            return
        turns, word = number != 0, family.words.get(code)
        if word is not None:
            if not isinstance(number, int) or not word.possible_states & AT_ZERO:
                return
            turns = AT_ZERO.isdisjoint(word.shown_states(number))
        if drive.speed.turns and not turns and status_shows_quick_stop(family):
            self._look(drive, list(family.words)[-1])
        drive.speed.turns = turns

    def _look(self, drive: Drive, word: Code) -> None:
        now_s = self._clock()
        if now_s - drive.speed.looked_s >= ZERO_GAP_S:
            drive.speed.looked_s = now_s
            self._at_zero.want(drive, word)
