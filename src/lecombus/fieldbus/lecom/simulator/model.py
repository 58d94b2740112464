"""What every simulated drive has in common: control state, motor, watchdog, faults, power.

Strategy: a family subclasses `Model` and says which codes exist, what its control and status
words mean and how long it thinks. Physical state is computed from time: `advance` moves the motor
and lets the watchdog expire exactly at its deadline, however late it is called. The control word is
the only place of inhibit (bit 9) and quick stop (bit 3): C0040, C0135 and the watchdog change it.
No manual says whether a read of C0135 shows all that, or only what was written to it last: the
simulated drives do the one or the other (`word_as_written`). Nor whether bit 3 = 0 lifts a quick
stop that the watchdog set where it was 0 before: of the latter some do not (`only_changes`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from typing import ClassVar, Final

from .motor import Motor
from .parameters import CommError, ExtendedError, Kept, Parameters, Refusal, Spec
from .troubles import Kind, Troubles
from .wire import decimal_text

__all__ = ["INHIBIT", "JOG_BITS", "QSP", "REVERSE", "Model", "Restart", "tens_digit", "word_text"]

JOG_BITS: Final = 0x0003
REVERSE: Final = 0x0004
QSP: Final = 0x0008
INHIBIT: Final = 0x0200
TRIP_RESET: Final = 0x0800
DC_BRAKE: Final = 0x4000
"""Bits of C0135 that every family shares. Source: EDB2102EN 8.2; CMVLC401A table 9."""

_AT_ONCE: Final = 1e9


class Restart(Exception):  # noqa: N818 - a valid way for a drive to fall silent
    """The drive restarts instead of answering. Source: EDB2102EN 6.4."""


def word_text(word: int) -> str:
    """Write a 16-bit word as VH text."""
    return f"H{word & 0xFFFF:04X}"


def word_of(flags: Mapping[int, bool]) -> int:
    """Make a word of its bits, by their numbers."""
    word = 0
    for bit, on in flags.items():
        if on:
            word |= 1 << bit
    return word


def tens_digit(number: int) -> int:
    """What C0068 shows of a fault number in bits 0..3: OH, 50, gives 5. Source: EDB2102EN 8.2."""
    return number // 10 % 10


class Model:
    """A drive without its line.

    Args:
        specs: The codes of the family.

    Attributes:
        start_code: The code that is 1 for an inhibit after power-on, else it is a quick stop; None:
            neither.
        watchdog_codes: The codes of the watchdog's time, in ms, and of its action, 0 for none.
        comm_error: What C0068 bits 4..7 say: the last telegram's fault; a good telegram other than
            a read of C0068 clears it.
        troubles: What is wrong with it, and what it remembers.
        terminal_enable: Whether its terminal for controller enable (28) has a HIGH level.
        watchdog_fired: How often the watchdog has expired.
        deaf_until_s: Before this time the drive hears nothing (start-up, shortened response).
        word_as_written: C0135 reads what was last written to it; else it also shows an inhibit by
            C0040 = 0, and what the watchdog did.
        only_changes: Of such a drive, only a change of bit 3 from 1 to 0 lifts a quick stop.
        digit_of: Which number C0068 of an SMVector shows the tens digit of (see `SMVector`).
    """

    family: ClassVar[str]
    standard_only: ClassVar[bool] = False
    set_count: ClassVar[int] = 1
    banked: ClassVar[bool] = True
    address_code: ClassVar[int] = 9
    baud_code: ClassVar[int] = 125
    start_code: ClassVar[int | None] = None
    watchdog_codes: ClassVar[tuple[int, ...]] = ()
    boot_s: ClassVar[float] = 1.0
    speed_unit: ClassVar[str] = "Hz"
    fault_kinds: ClassVar[Mapping[int, Kind]] = {}
    commissioned: ClassVar[Mapping[int, str]] = {}
    kept_in_reset: ClassVar[tuple[int, ...]] = ()

    def __init__(self, specs: Iterable[Spec]) -> None:
        self.params = Parameters(specs, set_count=self.set_count)
        self.motor = Motor()
        self.comm_error = CommError.NONE
        self.extended_fault = ExtendedError.NONE
        self.troubles = Troubles(self.fault_kinds)
        self.terminal_enable = True
        self.control = 0
        self.word_as_written = False
        self.only_changes = False
        self.digit_of = "lecom"
        self._written_word = 0
        self.watchdog_fired = 0
        self.deaf_until_s = 0.0
        self.readers: dict[int, Callable[[int], str]] = {}
        self.writers: dict[int, Callable[[str], None]] = {}
        self._now_s: float | None = None
        self._fed_at_s = 0.0
        self._fired = False
        self._guard: tuple[float, int] | None = None
        self._later: list[tuple[float, Callable[[], object]]] = []
        self._last_write_s = -1.0
        self.params.watch(self.watchdog_codes, self._look_again)
        self._install()
        for number, text in self.commissioned.items():
            self.params.set(number, text)
        self.control = self.start_word()

    # What a family says

    def _install(self) -> None:
        """Enter the family's computed codes into `readers` and `writers`."""

    def start_word(self) -> int:
        """The control word after power-on. Source: EDB2102EN 6.3.1; CMVLC401A 4.2."""
        if self.start_code is None:
            return 0
        return INHIBIT if self.params.text(self.start_code) == "1" else QSP

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Processing time t3 of an access, seconds."""
        raise NotImplementedError

    def watchdog_setting(self) -> tuple[float, int]:
        """The watchdog's time in seconds and its action's number."""
        if not self.watchdog_codes:
            return 0.0, 0
        time_ms, action = self.watchdog_codes
        return self.params.number(time_ms) / 1000.0, int(self.params.text(action))

    def expire(self, action: int) -> None:
        """1 inhibit, 2 quick stop. Source: EDB2102EN 6.3.3; CMVLC401A 7.3.3."""
        self.control |= INHIBIT if action == 1 else QSP

    def may_write(self, spec: Spec, text: str) -> None:
        """Refuse a write that the operating mode or the drive's state forbids.

        Raises:
            Refusal: It is forbidden.
        """

    def setpoint(self) -> float:
        """The signed frequency wanted now, before stops."""
        return 0.0

    def ramp(self) -> tuple[float, float, float, float]:
        """(greatest frequency, acceleration s, deceleration s, quick stop s) over that span."""
        return 50.0, 5.0, 5.0, 5.0

    def listens(self) -> bool:
        """Whether it follows the line at all; an SMVector can be set to another protocol."""
        return True

    def stores(self, spec: Spec) -> bool:
        """Whether an accepted write takes effect; an 820X drops some (EDB2102EN 6.4)."""
        return True

    # Time

    def advance(self, now_s: float) -> None:
        """Bring the drive to a time, monotonic seconds."""
        if self._now_s is None:
            self._now_s = self._fed_at_s = now_s
            self.steer()
        while self._later and self._later[0][0] <= now_s:
            at_s, action = self._later.pop(0)
            self._run_to(at_s)
            action()
        self._run_to(now_s)

    def _run_to(self, now_s: float) -> None:
        assert self._now_s is not None
        if self._guard is None:
            self._guard = self.watchdog_setting()
        time_s, action = self._guard
        due_s = self._fed_at_s + time_s
        if action and not self._fired and due_s < now_s:
            self.motor.advance(max(0.0, due_s - self._now_s))
            self._now_s = max(self._now_s, due_s)
            self._fired = True
            self.watchdog_fired += 1
            self.expire(action)
            self.steer()
        if now_s > self._now_s:
            motor = self.motor
            if motor.speed != motor.target:
                motor.advance(now_s - self._now_s)
            self._now_s = now_s

    def _look_again(self) -> None:
        self._guard = None

    def feed(self, now_s: float) -> None:
        """Note a telegram of the host to this drive: the watchdog is started again."""
        self._fed_at_s = now_s
        self._fired = False

    def later(self, at_s: float, action: Callable[[], object]) -> None:
        """Do something at a later time; times come in rising order."""
        self._later.append((at_s, action))

    # Codes

    def read(self, number: int, subcode: int) -> str:
        """Give a code's value as wire text.

        Raises:
            Refusal: There is no such code.
        """
        self.params.find(number, subcode)
        reader = self.readers.get(number)
        return reader(subcode) if reader else self.params.text(number, subcode)

    def write(self, number: int, subcode: int, text: str, now_s: float) -> None:
        """Take a value.

        Raises:
            Refusal: The drive does not take it.
            Restart: The drive restarts and never answers.
        """
        spec = self.params.find(number, subcode)
        if not spec.writable:
            raise Refusal(CommError.NO_ACCESS, ExtendedError.READ_ONLY)
        checked = spec.check(text)
        self.may_write(spec, checked)
        self._last_write_s = now_s
        if not self.stores(spec):
            return
        self.params.keep(spec, checked)
        writer = self.writers.get(number)
        if writer:
            writer(checked)
        self.steer()

    # Control

    @property
    def fault(self) -> int:
        """The active TRIP's LECOM number, 0 when none."""
        return self.troubles.trip

    def inhibited(self) -> bool:
        """Controller inhibit, by the line or by the terminal (EDB2102EN 5: always active)."""
        return bool(self.control & INHIBIT) or not self.terminal_enable

    def pulses_off(self) -> bool:
        """Whether the power stage is off, for any reason."""
        return self.inhibited() or bool(self.fault or self.troubles.message)

    def at_setpoint(self) -> bool:
        """Whether the ramp generator's output is its input."""
        return self.motor.powered and self.motor.speed == self.motor.target

    def reverse(self) -> bool:
        """The direction of rotation, shown also while it is only wanted."""
        return self.motor.speed < 0 or bool(self.control & REVERSE)

    def stop_wanted(self) -> bool:
        """Whether the drive ramps down on its own, instead of following its setpoint."""
        return bool(self.control & (QSP | DC_BRAKE))

    def steer(self) -> None:
        """Aim the motor according to control word, setpoint and faults."""
        if self.pulses_off():
            self.motor.release()
            return
        span, up_s, down_s, stop_s = self.ramp()
        stopped = self.stop_wanted()
        target = 0.0 if stopped else max(-span, min(span, self.setpoint()))
        fall_s = stop_s if stopped else down_s
        self.motor.aim(
            target,
            rate_up=span / up_s if up_s else _AT_ONCE,
            rate_down=span / fall_s if fall_s else _AT_ONCE,
            span=span,
        )

    def write_control_word(self, text: str) -> None:
        """Take a write of C0135, and keep it for drives that read it back as written."""
        before, word = self._written_word, int(text[1:], 16)
        held = self.control & QSP and not before & QSP if self.only_changes else 0
        self._written_word = word
        self.take_control_word(text)
        if held:
            self.control |= QSP

    def read_control_word(self) -> str:
        """Give C0135 as this kind of drive reads it back."""
        return word_text(self._written_word if self.word_as_written else self.control)

    def take_control_word(self, text: str) -> None:
        """Take C0135 over; the edge of bit 11 resets a TRIP."""
        word = int(text[1:], 16)
        edge = word & TRIP_RESET and not self.control & TRIP_RESET
        self.control = word
        if edge:
            self.reset_fault()

    def take_inhibit(self, text: str) -> None:
        """Take C0040 over: 0 inhibits, 1 enables, in every operating mode."""
        self.control = self.control & ~INHIBIT if text == "1" else self.control | INHIBIT

    def trip(self, number: int, *, stays: bool = False) -> None:
        """Let a fault occur, by its number (see `Troubles.occur`)."""
        self.troubles.occur(number, stays=stays)
        self.steer()

    def clear_fault(self) -> None:
        """Take the causes of all faults away; a TRIP still waits for its reset."""
        self.troubles.clear()
        self.steer()

    def reset_fault(self) -> None:
        """Acknowledge the TRIP; it remains while its cause is there."""
        self.troubles.reset()
        self.steer()

    def set_terminal(self, *, high: bool) -> None:
        """Set the level of the enable terminal; LOW inhibits the controller in any case."""
        self.terminal_enable = high
        self.steer()

    def factory_reset(self) -> None:
        """Put every stored parameter back to what the maker ships.

        Address, baud rate and what a family needs to be written to at all stay: a person who
        resets a drive has to set these at the keypad before the line can reach it again.
        """
        keep = {self.address_code, self.baud_code, *self.kept_in_reset}
        self.params.factory_reset(keep)
        self.steer()

    def power_cycle(self, now_s: float, off_s: float | None = None) -> None:
        """Switch off and on again; the drive hears nothing until it has started.

        Args:
            now_s: When.
            off_s: How long it hears nothing, seconds; default the family's start-up time.
        """
        self.advance(now_s)
        self.params.power_cycle()
        self.comm_error = CommError.NONE
        self.extended_fault = ExtendedError.NONE
        self.troubles.restart()
        self._later.clear()
        self.deaf_until_s = now_s + (self.boot_s if off_s is None else off_s)
        self.feed(self.deaf_until_s)
        self.motor = Motor()
        self.control = self.start_word()
        self._written_word = 0
        self.steer()

    def preset(self, key: int | tuple[int, int], value: str) -> None:
        """Set a code as a person at the keypad would, before or during a test."""
        number, subcode = key if isinstance(key, tuple) else (key, 0)
        spec = self.params.find(number, subcode)
        self.params.set(number, value, subcode)
        writer = self.writers.get(number)
        if writer and spec.kept is not Kept.DRIVE:
            writer(value)
        if number == self.start_code:
            self.control = self.start_word()
        self.steer()

    def frequency_text(self, value: float, decimals: int = 1) -> str:
        """Write a computed frequency as VD text."""
        return decimal_text(Decimal(f"{value:.{decimals}f}"))
