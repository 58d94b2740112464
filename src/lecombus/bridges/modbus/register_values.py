"""What the registers read: encoded from what is known of the line, or refused.

A read is answered whole or not at all: with the numbers of all its registers, or with one Modbus
exception. No register that must be fresh is answered with an old number. Exceptions, by the Modbus
Application Protocol 1.1b3, 7: 02 for registers that are not there or half a number of 32 bits, 0A
("gateway path unavailable") while lecombus does not answer the bridge, 0B ("target device failed to
respond") where the value of a drive was never read or is stale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from decimal import Decimal
from enum import IntEnum
from typing import Any, Final, Protocol

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue, LineFollower
from lecombus.bridges.modbus.register_map import (
    DOING,
    DRIVE,
    DRIVE_STATES,
    FAULT_KINDS,
    LINE,
    LINE_STATES,
    MAP_VERSION,
    SCALE,
    STATES,
    UNITS,
    Register,
    RegisterPart,
    Sources,
    place_of,
    sources_of,
)
from lecombus.drives import family
from lecombus.parameters import Code

__all__ = ["ControlRegisters", "ModbusError", "ModbusException", "RegisterReader", "words_of"]

NEVER: Final = 0xFFFF
LARGEST: Final = 0x7FFF_FFFF


class ModbusException(IntEnum):
    """The exception codes that the bridge answers with."""

    NO_SUCH_FUNCTION = 0x01
    NO_SUCH_REGISTER = 0x02
    BAD_VALUE = 0x03
    FAILURE = 0x04
    BUSY = 0x06
    LECOMBUS_AWAY = 0x0A
    NOT_FRESH = 0x0B


class ModbusError(Exception):
    """A request is answered with an exception.

    Args:
        code: Which one.
    """

    def __init__(self, code: ModbusException) -> None:
        super().__init__(code.name)
        self.code = code


class ControlRegisters(Protocol):
    """What the writing part of the bridge says of itself."""

    def line_registers(self) -> Mapping[str, int]:
        """Return the registers of the line that it knows, by name."""

    def drive_registers(self, drive: str) -> Mapping[str, int]:
        """Return the registers of a drive that it knows, by name; 32 bits as one number."""


class RegisterReader:
    """Answers reads.

    Args:
        follower: Knows the line.
        control: Knows leases, commands and their outcomes.
        drives: Name and address of the drives, as the roster has them: the follower knows none
            before the daemon has answered once.
        now: The time of `anyio.current_time`, seconds.
    """

    def __init__(
        self,
        follower: LineFollower,
        control: ControlRegisters,
        drives: Iterable[FollowedDrive],
        now: Callable[[], float],
    ) -> None:
        self._follower = follower
        self._control = control
        self._at_start = tuple(drives)
        self._now = now
        self._begun_s = now()
        self._layouts = {True: by_offset(LINE), False: by_offset(DRIVE)}

    def drive_at(self, address: int) -> FollowedDrive | None:
        """Return the drive with an address; None: there is none."""
        known = self._follower.drives.values() or self._at_start
        return next((one for one in known if one.address == address), None)

    def read(self, first: int, count: int) -> list[int]:
        """Return registers.

        Raises:
            ModbusError: They cannot be read, or one of them cannot.
        """
        words: list[int] = []
        drives: dict[int, DriveValues] = {}
        at = first
        while at < first + count:
            address, offset = place_of(at)
            register = self._layouts[address == 0].get(offset)
            if register is None or at + register.words > first + count:
                raise ModbusError(ModbusException.NO_SUCH_REGISTER)
            if address and address not in drives:
                drives[address] = self._values(address)
            words += words_of(self._number(drives.get(address), register), register.words)
            at += register.words
        return words

    def _values(self, address: int) -> DriveValues:
        drive = self.drive_at(address)
        if drive is None:
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        return DriveValues(drive, self._now())

    def _number(self, drive: DriveValues | None, register: Register) -> int:
        return self._line_number(register) if drive is None else self._drive_number(drive, register)

    # -- the line --------------------------------------------------------------------------------

    def _line_number(self, register: Register) -> int:
        if register.part is RegisterPart.FRESH:
            return self._fresh_line_number(register.name)
        if register.name == "map version":
            return MAP_VERSION
        if register.name == "seconds":
            return int(self._now() - self._begun_s) & 0xFFFF
        if register.name == "lecombus":
            return int(self._follower.is_connected)
        return self._control.line_registers()[register.name]

    def _fresh_line_number(self, name: str) -> int:
        line = self._follower.line
        if line is None:
            raise ModbusError(ModbusException.LECOMBUS_AWAY)
        if name == "line state":
            return number_in(LINE_STATES, line.state)
        states = [drive.state for drive in self._follower.drives.values()]
        return len(states) if name == "drives" else states.count(name.removeprefix("drives "))

    # -- a drive ---------------------------------------------------------------------------------

    def _drive_number(self, values: DriveValues, register: Register) -> int:
        if register.part is RegisterPart.FRESH:
            if not self._follower.is_connected:
                raise ModbusError(ModbusException.LECOMBUS_AWAY)
            number = values.fresh(register.name)
            if number is None:
                raise ModbusError(ModbusException.NOT_FRESH)
            if abs(number) > LARGEST:
                raise ModbusError(ModbusException.FAILURE)
            return number
        if register.name == "latched":
            return int(values.name in latched_drives(self._follower.leases))
        always = values.always(register.name)
        return (
            self._control.drive_registers(values.name)[register.name] if always is None else always
        )


class DriveValues:
    """The values behind the registers of one drive, at one time.

    Args:
        drive: The drive.
        now_s: The time of `anyio.current_time`, seconds.
    """

    def __init__(self, drive: FollowedDrive, now_s: float) -> None:
        self.name = drive.name
        self._drive = drive
        self._now_s = now_s
        self._sources: Sources = sources_of(family(drive.family))
        self._status = self._value(self._sources.status)
        self._speed = self._value(self._sources.speed)
        self._setpoint = self._newest(self._sources.setpoints)

    def always(self, name: str) -> int | None:
        """Return a register that can be read at any time; None: the values do not say it."""
        if name == "drive state":
            return number_in(DRIVE_STATES, self._drive.state)
        if name == "fresh":
            readable = ("status word", "states", "actual speed", "setpoint")
            return sum(1 << bit for bit, one in enumerate(readable) if self.fresh(one) is not None)
        if name == "unit of speed":
            return number_in(UNITS, self._sources.speed_unit)
        if name == "unit of setpoint":
            return number_in(UNITS, self._sources.setpoint_unit)
        ages = {"status word": self._status, "speed": self._speed, "setpoint": self._setpoint}
        of = name.removeprefix("age of ")
        return self._age(ages[of]) if of in ages else None

    def fresh(self, name: str) -> int | None:
        """Return a register that must be fresh; None: it is not."""
        if name == "actual speed":
            return self._scaled(self._speed)
        if name == "setpoint":
            return self._scaled(self._setpoint)
        status = self._good(self._status)
        if name == "status word" or status is None:
            return int(status) if isinstance(status, int) and 0 <= status <= 0xFFFF else None
        states = self._drive.states
        if states is None:
            return None
        if name == "states":
            return sum(1 << bit for bit, one in enumerate(STATES) if one in states)
        if name == "motion":
            return number_in(DOING, self._drive.doing)
        fault: Mapping[str, Any] = self._drive.fault or {}
        if name == "fault kind":
            return number_in(FAULT_KINDS, str(fault.get("kind") or FAULT_KINDS[0]))
        return min(int(fault.get("number") or 0), 0xFFFF)

    def _value(self, code: Code | None) -> FollowedValue | None:
        return None if code is None else self._drive.values.get(str(code))

    def _newest(self, codes: Iterable[Code]) -> FollowedValue | None:
        known = [value for code in codes if (value := self._value(code)) is not None]
        return max(known, key=lambda value: value.read_at_s, default=None)

    def _good(self, value: FollowedValue | None) -> Decimal | int | None:
        """Return a number that may be shown as the one of now."""
        if value is None or not value.is_good(self._now_s):
            return None
        number = value.reading.value
        return number if isinstance(number, Decimal | int) else None

    def _scaled(self, value: FollowedValue | None) -> int | None:
        number = self._good(value)
        return None if number is None else round(Decimal(number) * SCALE)

    def _age(self, value: FollowedValue | None) -> int:
        """Return an age in tenths of a second, rounded up."""
        age_s = float("inf") if value is None else value.age_s(self._now_s)
        return NEVER if age_s * 10 >= NEVER else max(0, -int(-age_s * 10 // 1))


def latched_drives(leases: Mapping[str, Any]) -> set[str]:
    """Return the drives that take no setpoint until they are enabled, by `GET /v1/leases`."""
    return {str(one["drive"]) for one in leases.get("drives") or () if one.get("latched")}


def by_offset(registers: Iterable[Register]) -> dict[int, Register]:
    """Return registers by the offset of their first word."""
    return {one.offset: one for one in registers}


def number_in(words: Sequence[str], word: str) -> int:
    """Return the number that stands for a word; 0 for one that the map does not have."""
    return words.index(word) if word in words else 0


def words_of(number: int, words: int) -> Sequence[int]:
    """Return the registers of a number, the high word first; negative ones in two's complement."""
    if words == 1:
        return (number & 0xFFFF,)
    return ((number >> 16) & 0xFFFF, number & 0xFFFF)
