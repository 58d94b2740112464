"""The codes of a simulated drive: what exists, in which format, within which limits, kept where.

Strategy: a family is a table of immutable `Spec` entries; a drive holds only the texts that differ
from the defaults. Where a value is kept decides what a power cycle does to it: the drive's EEPROM
keeps it (and wears), the 2102 module and the process image forget it (EDB2102EN 6, 6.1.1).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import Enum, IntEnum, auto

from .wire import decimal_text, read_decimal, read_hexadecimal

__all__ = ["CommError", "ExtendedError", "Kept", "Parameters", "Refusal", "Spec", "d", "h", "s"]

Key = tuple[int, int]

_LONGEST_STRING = 20
"""Characters of a string. Source: CMVLC401A 5.4."""


class CommError(IntEnum):
    """Bits 4..7 of C0068. Source: EDB2102EN 8.2."""

    NONE = 0
    CHECKSUM = 1
    FRAME = 2
    INVALID_CODE = 4
    INVALID_VALUE = 5
    NO_ACCESS = 6
    INTERRUPTED = 7
    GENERAL = 15


class ExtendedError(IntEnum):
    """C1962, the entries the simulator uses. Source: EDB2102EN 8.2, fault list."""

    NONE = 0
    DATA_TYPE = 3
    SUBCODE = 4
    CODE = 5
    OPERATING_STATE = 7
    OPERATING_MODE = 8
    READ_ONLY = 9
    VALUE_RANGE = 13
    GENERAL = 17
    PARITY = 35


class Refusal(Exception):  # noqa: N818 - a valid way for a drive to answer, not an error
    """A drive does not do what it was asked.

    Args:
        error: What C0068 will say.
        fault: What C1962 will say.
    """

    def __init__(self, error: CommError, fault: ExtendedError) -> None:
        super().__init__(f"{error.name}, {fault.name}")
        self.error = error
        self.fault = fault


class Kept(Enum):
    """Where a value lives."""

    DRIVE = auto()
    """EEPROM: survives, every accepted write wears it."""
    MEMORY = auto()
    """The drive's RAM: back to what was saved after a power cycle (93XX)."""
    MODULE = auto()
    """The fieldbus module: back to the default."""
    PROCESS = auto()
    """Setpoints and control words: back to the default."""


@dataclass(frozen=True, slots=True)
class Spec:
    """One code.

    Attributes:
        number: 0..65535.
        subcode: 0..255.
        format: `D`, `H` or `S`.
        default: Text as on the wire.
        low: Least number, inclusive.
        high: Greatest number, inclusive.
        decimals: Digits after the point that the drive can hold.
        writable: Whether the bus may write it at all.
        kept: Where the value lives.
        sets: Whether each parameter set has its own.
    """

    number: int
    subcode: int
    format: str
    default: str
    low: Decimal = Decimal(0)
    high: Decimal = Decimal(0)
    decimals: int = 0
    writable: bool = False
    kept: Kept = Kept.DRIVE
    sets: bool = False

    def check(self, text: str) -> str:
        """Give the text to keep for a value received, or refuse it.

        Raises:
            Refusal: Wrong format or outside the limits.
        """
        if self.format == "H":
            return self._check_word(text)
        number = read_decimal(text) if self.format == "D" else None
        if number is None:
            raise Refusal(CommError.INVALID_VALUE, ExtendedError.DATA_TYPE)
        fits = round(number, self.decimals) == number
        if not (fits and self.low <= number <= self.high):
            raise Refusal(CommError.INVALID_VALUE, ExtendedError.VALUE_RANGE)
        return decimal_text(number)

    def at_keypad(self, text: str) -> str:
        """Give the wire text for what a person sets, also where the bus may only read.

        Raises:
            Refusal: No value of this format, or outside the limits.
        """
        if self.format == "S":
            if not (text.isascii() and text.isprintable() and len(text) <= _LONGEST_STRING):
                raise Refusal(CommError.INVALID_VALUE, ExtendedError.DATA_TYPE)
            return "S" + text
        if self.format == "H" or self.writable:
            return self.check(text)
        if read_decimal(text) is None:
            raise Refusal(CommError.INVALID_VALUE, ExtendedError.DATA_TYPE)
        return text

    def _check_word(self, text: str) -> str:
        word = read_hexadecimal(text)
        if word is None or word[1] != len(self.default) - 1:
            raise Refusal(CommError.INVALID_VALUE, ExtendedError.DATA_TYPE)
        return text


def d(
    number: int,
    default: str,
    limits: tuple[int | str, int | str] | None = None,
    *,
    subcode: int = 0,
    decimals: int = 0,
    kept: Kept = Kept.DRIVE,
    sets: bool = False,
) -> Spec:
    """Write a decimal code of a table; without limits it is read only."""
    low, high = limits or (0, 0)
    return Spec(
        number,
        subcode,
        "D",
        default,
        Decimal(low),
        Decimal(high),
        decimals,
        limits is not None,
        kept,
        sets,
    )


def h(number: int, default: str, *, writable: bool = False, kept: Kept = Kept.PROCESS) -> Spec:
    """Write a hexadecimal code of a table."""
    return Spec(number, 0, "H", default, writable=writable, kept=kept)


def s(number: int, text: str) -> Spec:
    """Write a string of a table; strings are only sent. Source: EDB2102EN 8.3.1."""
    return Spec(number, 0, "S", "S" + text)


class Parameters:
    """The values of one drive.

    Args:
        specs: The family's table.
        set_count: How many parameter sets can be reached by code offsets of 2000.

    Attributes:
        wear: Accepted writes into EEPROM by (code, subcode); 82XX parameters are stored on every
            write (EDB2102EN 6.1.1).
    """

    def __init__(self, specs: Iterable[Spec], *, set_count: int = 1) -> None:
        self._specs: dict[Key, Spec] = {(spec.number, spec.subcode): spec for spec in specs}
        self._numbers = {number for number, _ in self._specs}
        self._texts: dict[Key, str] = {}
        self._saved: dict[Key, str] = {}
        self._sets = set_count
        self._watchers: dict[int, Callable[[], None]] = {}
        self.wear: dict[Key, int] = {}

    def watch(self, numbers: Collection[int], changed: Callable[[], None]) -> None:
        """Call back whenever one of some codes may have changed."""
        self._watchers |= dict.fromkeys(numbers, changed)

    @property
    def specs(self) -> Mapping[Key, Spec]:
        """The codes this drive has."""
        return self._specs

    def find(self, number: int, subcode: int) -> Spec:
        """Find a code, also in a further parameter set.

        Raises:
            Refusal: There is no such code or subcode.
        """
        spec = self._specs.get((number, subcode))
        if spec is not None:
            return spec
        which, base = divmod(number, 2000)
        basic = self._specs.get((base, subcode))
        if basic is not None and basic.sets and which < self._sets:
            return replace(basic, number=number)
        known = number in self._numbers
        fault = ExtendedError.SUBCODE if known else ExtendedError.CODE
        raise Refusal(CommError.INVALID_CODE, fault)

    def put_in_sets(self, number: int) -> None:
        """Let a code stand in each parameter set."""
        self._specs[number, 0] = replace(self._specs[number, 0], sets=True)

    def text(self, number: int, subcode: int = 0) -> str:
        """The text kept for a code that exists."""
        key = (number, subcode)
        kept = self._texts.get(key)
        if kept is not None:
            return kept
        spec = self._specs.get(key)
        return (spec or self.find(number, subcode)).default

    def number(self, number: int, subcode: int = 0) -> float:
        """The number kept under a decimal code."""
        return float(self.text(number, subcode))

    def keep(self, spec: Spec, text: str) -> None:
        """Take a checked value over, and count the wear."""
        key = (spec.number, spec.subcode)
        self._texts[key] = text
        self._tell(spec.number)
        if spec.kept is Kept.DRIVE:
            self.wear[key] = self.wear.get(key, 0) + 1

    def set(self, number: int, text: str, subcode: int = 0) -> None:
        """Set a value from inside the drive or from a test: unchecked, no wear."""
        self.find(number, subcode)
        self._texts[(number, subcode)] = text
        self._tell(number)

    def save(self) -> None:
        """Make what stands in RAM survive (93XX, C0003)."""
        for key, text in self._texts.items():
            if self.find(*key).kept is Kept.MEMORY:
                self._saved[key] = text
                self.wear[key] = self.wear.get(key, 0) + 1

    def power_cycle(self) -> None:
        """Forget what only the module, the process image or the RAM knew."""
        self._texts = {
            key: text for key, text in self._texts.items() if self.find(*key).kept is Kept.DRIVE
        } | self._saved
        self._tell(*self._watchers)

    def factory_reset(self, keep: Collection[int]) -> None:
        """Put stored parameters of all sets back to their defaults, but for some codes."""
        stored = (Kept.DRIVE, Kept.MEMORY)
        for key in [k for k in self._texts if k[0] not in keep and self.find(*k).kept in stored]:
            del self._texts[key]
        self._saved = {key: text for key, text in self._saved.items() if key[0] in keep}
        self._tell(*self._watchers)

    def _tell(self, *numbers: int) -> None:
        for number in numbers:
            if number in self._watchers:
                self._watchers[number]()
