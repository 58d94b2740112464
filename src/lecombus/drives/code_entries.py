"""Building the described codes of a family from the entries of its data files.

Strategy: an entry is read and checked on its own (`read_entry`), then spread: over its subcodes,
and over the family's parameter sets if it says so. `CodeBook` takes all of them and refuses what
overlaps: a code described twice, a subcode range over another entry, an entry that another
parameter set's offset lands on. What an entry cannot mean is refused with file, line and column:
a range that its format cannot carry, a selection outside the range, a step that does not lead
from one end of the range to the other.

An entry reads, with all keys there are::

    - {code: C0011, name: maximum field frequency, name_de: maximale Drehfeldfrequenz, unit: Hz,
       format: VD, chars: 5, range: [7.5, 480], step: 0.02, default: 50, writable: true,
       storage: stored, needs_inhibit: true, sets: true, source: "8.2"}

`subcodes: [1, 8]` makes one entry many: each gets its subcode after its name. A value made of
bits has `bits: {0: [english, german]}` in place of a range or a selection. `selection_partial:
true` marks a selection of which the manual names some values only, `array: true` a code whose
values are reached by subcodes, of which it does not say how many. What must hold
between codes and the rest of a family is `loading`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal

from lecombus.protocol.addressing import HIGHEST_SUBCODE, Code
from lecombus.protocol.values import (
    HIGHEST_DECIMAL,
    HIGHEST_VALUE_CHARS,
    LOWEST_DECIMAL,
    Format,
    Value,
)

from .codes import CodeInfo, PlainWhen, Storage, WriteClass
from .document import Item, Table
from .readers import (
    WORD_MAX,
    read_choice,
    read_code_number,
    read_decimal,
    read_flag,
    read_source,
    read_text,
)
from .texts import Text

__all__ = ["CodeBook"]

HEX_DIGITS = (2, 4, 8)

HIGHEST_BIT = 15
"""Of the words that drives give."""

TYPICAL_CHARS = {Format.VD: 9, Format.VS: 16, Format.VO: HIGHEST_VALUE_CHARS}
"""Length of a value where the file does not say: 9 is what the manual's tables of telegram times
take for a number; 16 is a string of 15, such as a software label (EDB2102EN 3.5, 8.2)."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """One entry of `codes`: what it describes, and how far it reaches."""

    info: CodeInfo
    subcodes: tuple[int, int] | None
    sets: bool


@dataclass(frozen=True, slots=True)
class _Limits:
    """Which values a code can have."""

    low: Decimal | None
    high: Decimal | None
    step: Decimal | None
    selection: Mapping[int, Text]


class CodeBook:
    """The codes of one family while its files are read.

    Args:
        offsets: What is added to a code's number for each parameter set; the first is 0.
        stored_needs_inhibit: Every stored code needs inhibit before it is written.
    """

    def __init__(self, offsets: tuple[int, ...], *, stored_needs_inhibit: bool) -> None:
        self.codes: dict[Code, CodeInfo] = {}
        self._offsets = offsets
        self._inhibit = stored_needs_inhibit

    def add(self, item: Item, manual: str) -> None:
        """Take one entry.

        Raises:
            DescriptionError: The entry cannot be, or describes what another one does already.
        """
        entry = _read_entry(item.table(), manual)
        info = entry.info
        if self._inhibit and info.writable and info.storage is Storage.STORED:
            info = replace(info, needs_inhibit=True)
        for one in _spread_subcodes(info, entry.subcodes):
            self._put(item, one)
            if entry.sets:
                self._put_further_sets(item, one)

    def _put_further_sets(self, item: Item, info: CodeInfo) -> None:
        """Take a code once more for each further parameter set."""
        number = info.code.number
        for parameter_set, offset in enumerate(self._offsets[1:], start=2):
            if number >= self._offsets[1]:
                item.fail(f"{info.code} lies in parameter set 2, which begins at C{offset}")
            code = Code(number + offset, info.code.subcode)
            self._put(item, replace(info, code=code, parameter_set=parameter_set))

    def _put(self, item: Item, info: CodeInfo) -> None:
        other = self.codes.get(info.code)
        if other is not None:
            one, two = (
                f"{known.name} in parameter set {known.parameter_set}" for known in (other, info)
            )
            item.fail(f"{info.code} is described twice: as {one} and as {two}", code=str(info.code))
        self.codes[info.code] = info


def _spread_subcodes(info: CodeInfo, subcodes: tuple[int, int] | None) -> list[CodeInfo]:
    if subcodes is None:
        return [info]
    first, last = subcodes
    return [
        replace(
            info,
            code=Code(info.code.number, number),
            name=f"{info.name} {number}",
            name_de=f"{info.name_de} {number}",
        )
        for number in range(first, last + 1)
    ]


def _read_entry(table: Table, manual: str) -> _Entry:
    """Read one entry of `codes`."""
    code = read_code_number(table.take("code"))
    name, name_de = table.take("name").text(), table.get("name_de")
    unit, chars = table.get("unit"), table.get("chars")
    readable, write_class = table.get("readable"), table.get("write_class")
    kind = read_choice(table.take("format"), Format)
    digits = _hex_digits(table, kind)
    writable, motion = read_flag(table, "writable"), read_flag(table, "motion")
    limits = _limits(table, kind, digits)
    usual_chars = TYPICAL_CHARS.get(kind, 1 + (digits or 0))
    info = CodeInfo(
        code=code,
        name=name,
        unit=unit.text() if unit else None,
        format=kind,
        hex_digits=digits,
        chars=chars.integer(1, HIGHEST_VALUE_CHARS) if chars else usual_chars,
        write_class=read_choice(write_class, WriteClass) if write_class else WriteClass.PLAIN,
        plain_when=_plain_when(table.get("plain_when")),
        writable=writable,
        motion=motion,
        source=read_source(table, manual),
        name_de=name_de.text() if name_de else name,
        low=limits.low,
        high=limits.high,
        step=limits.step,
        selection=limits.selection,
        bits=_bits(table.get("bits"), limits),
        storage=_storage(table.get("storage"), writable=writable, motion=motion),
        readable=readable.flag() if readable else True,
        needs_inhibit=read_flag(table, "needs_inhibit"),
        default=_default(table.get("default"), kind, digits, limits),
        secret=read_flag(table, "secret"),
        selection_partial=read_flag(table, "selection_partial"),
        array=read_flag(table, "array"),
    )
    entry = _Entry(info, _subcodes(table.get("subcodes"), code), read_flag(table, "sets"))
    table.done()
    if info.selection_partial and (not info.selection or info.low is not None):
        table.fail("selection_partial belongs to a selection without a range")
    if not info.writable and not info.readable:
        table.fail(f"{code} can neither be read nor written")
    if not info.writable and info.needs_inhibit:
        table.fail(f"{code} cannot be written, so it needs no inhibit")
    return entry


def _storage(item: Item | None, *, writable: bool, motion: bool) -> Storage:
    """Say where a value is kept: what moves a drive or is only read is a process value.

    Source: EDB2102EN 6, 6.1.1 (control words and setpoints are not saved).
    """
    if item is not None:
        return read_choice(item, Storage)
    return Storage.STORED if writable and not motion else Storage.VOLATILE


def _limits(table: Table, kind: Format, digits: int | None) -> _Limits:
    carried = _carried(kind, digits)
    low, high = _range(table.get("range"), carried)
    step = _step(table.get("step"), low, high)
    within = (low, high) if low is not None and high is not None else carried
    return _Limits(low, high, step, _selection(table.get("selection"), within))


def _carried(kind: Format, digits: int | None) -> tuple[Decimal, Decimal] | None:
    """Give the numbers a format can carry; None for one that carries no numbers.

    Source: EDB2102EN 8.3.1; CMVLC401A 5.4.
    """
    if kind is Format.VH:
        assert digits is not None
        return Decimal(0), Decimal(16**digits - 1)
    return (LOWEST_DECIMAL, HIGHEST_DECIMAL) if kind is Format.VD else None


def _range(
    item: Item | None, carried: tuple[Decimal, Decimal] | None
) -> tuple[Decimal | None, Decimal | None]:
    if item is None:
        return None, None
    ends = item.items()
    if carried is None or len(ends) != 2:
        item.fail("a range is [lowest, highest], and only numbers (VD, VH) have one")
    low, high = (_number(end, carried) for end in ends)
    if low >= high:
        item.fail(f"the range runs from {low} to {high}: the lower end comes first")
    return low, high


def _number(item: Item, carried: tuple[Decimal, Decimal]) -> Decimal:
    """Read a number that the code's format can carry."""
    whole = carried[0] == 0  # hexadecimal: no sign, no fraction
    number = Decimal(item.integer(0, int(carried[1]))) if whole else read_decimal(item)
    if not carried[0] <= number <= carried[1]:
        item.fail(f"{number} cannot be sent: {carried[0]} to {carried[1]} can")
    return number


def _step(item: Item | None, low: Decimal | None, high: Decimal | None) -> Decimal | None:
    if item is None:
        return None
    step = read_decimal(item)
    if low is None or high is None:
        item.fail("a step is counted from the range's lower end: give the range too")
    if step <= 0 or (high - low) % step:
        item.fail(f"steps of {step} do not lead from {low} to {high}")
    return step


def _selection(item: Item | None, within: tuple[Decimal, Decimal] | None) -> Mapping[int, Text]:
    if item is None:
        return {}
    if within is None:
        item.fail("only numbers (VD, VH) have a selection")
    texts: dict[int, Text] = {}
    for key, value in item.table().pairs():
        number = key.integer(int(LOWEST_DECIMAL), 0xFFFF_FFFF)
        if not within[0] <= number <= within[1]:
            key.fail(f"{number} lies outside {within[0]} to {within[1]}")
        if number in texts:
            key.fail(f"{number} stands here twice")
        texts[number] = read_text(value)
    return texts


def _bits(item: Item | None, limits: _Limits) -> Mapping[int, Text]:
    """Read what single bits mean: of a value that is no word of its own (`words`)."""
    if item is None:
        return {}
    if limits.selection or limits.low is not None:
        item.fail("a value is made of bits, or it has a range or a selection")
    texts: dict[int, Text] = {}
    for key, value in item.table().pairs():
        bit = key.integer(0, HIGHEST_BIT)
        if texts and bit <= max(texts):
            key.fail(f"bit {bit} stands after {max(texts)}: the lowest comes first")
        texts[bit] = read_text(value)
    return texts


def _default(item: Item | None, kind: Format, digits: int | None, limits: _Limits) -> str | None:
    """Read the value as delivered, as it stands on the wire."""
    if item is None:
        return None
    carried = _carried(kind, digits)
    if carried is None:
        return item.text()
    number = _number(item, carried)
    if limits.low is not None and limits.high is not None:
        if not limits.low <= number <= limits.high:
            item.fail(f"{number} lies outside {limits.low} to {limits.high}")
    elif limits.selection and number not in limits.selection:
        item.fail(f"{number} is not in the selection")
    value = Value.hexadecimal(int(number), digits) if digits else Value.decimal(number)
    return value.raw


def _subcodes(item: Item | None, code: Code) -> tuple[int, int] | None:
    if item is None:
        return None
    ends = item.items()
    if len(ends) != 2 or code.subcode:
        item.fail("subcodes is [first, last], and the code then has none: C0168")
    first = ends[0].integer(1, HIGHEST_SUBCODE)
    return first, ends[1].integer(first, HIGHEST_SUBCODE)


def _plain_when(item: Item | None) -> PlainWhen | None:
    if item is None:
        return None
    table = item.table()
    rule = PlainWhen(
        mask=table.take("mask").integer(1, WORD_MAX),
        equals=table.take("equals").integer(0, WORD_MAX),
    )
    table.done()
    return rule


def _hex_digits(table: Table, kind: Format) -> int | None:
    item = table.get("hex_digits")
    if (item is not None) != (kind is Format.VH):
        table.fail("hex_digits belongs to format VH, and only there")
    if item is None:
        return None
    digits = item.integer(2, 8)
    if digits not in HEX_DIGITS:
        item.fail(f"{digits} hexadecimal digits are not sent; 2, 4 or 8 are")
    return digits
