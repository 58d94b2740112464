"""Reading control words from the entries of a family's data files.

Every bit of a control word must be accounted for, because whoever changes one has to know what
the others are: `check_whole` refuses a word of which a bit has two meanings, or none. How the
entries of signal configurations are joined with the general ones is `word_entries`.
"""

from __future__ import annotations

from lecombus.protocol.addressing import Code

from .commands import ControlBit, ControlField, ControlWordInfo
from .document import Item, Table
from .readers import read_items, read_numbers, read_source, read_span, read_text

__all__ = ["check_whole", "control_bits", "read_control_word"]

CONTROL_BITS = frozenset(range(16))


def read_control_word(table: Table, code: Code, manual: str) -> ControlWordInfo:
    """Read one entry of `control_words`, or of what a configuration adds to one."""
    bits: dict[str, ControlBit] = {}
    for key, value in table.take("bits").table().pairs():
        bit = _read_control_bit(key, value.table())
        if bit.name in bits:
            key.fail(f"two bits have the name {bit.name}")
        bits[bit.name] = bit
    fields: dict[str, ControlField] = {}
    for item in read_items(table, "fields"):
        field = _read_control_field(item.table())
        if field.name in fields or field.name in bits:
            item.fail(f"{field.name} stands here twice")
        fields[field.name] = field
    return ControlWordInfo(
        code=code,
        bits=bits,
        fields=fields,
        free=read_numbers(table, "free", 15),
        reserved=read_numbers(table, "reserved", 15),
        source=read_source(table, manual),
    )


def _read_control_bit(key: Item, table: Table) -> ControlBit:
    bit = ControlBit(
        name=table.take("name").text(),
        bit=key.integer(0, 15),
        off=read_text(table.take("off")),
        on=read_text(table.take("on")),
    )
    table.done()
    return bit


def _read_control_field(table: Table) -> ControlField:
    low, high = read_span(table, 15)
    highest = (1 << high - low + 1) - 1
    texts = table.take("texts").table()
    field = ControlField(
        name=table.take("name").text(),
        low=low,
        high=high,
        texts={key.integer(0, highest): read_text(value) for key, value in texts.pairs()},
    )
    table.done()
    return field


def check_whole(item: Item, word: ControlWordInfo) -> None:
    """Refuse a control word of which a bit has two meanings, or none."""
    every = [*control_bits(word), *word.free, *word.reserved]
    for bit in sorted(CONTROL_BITS | set(every)):
        if every.count(bit) != 1:
            times = "two meanings" if bit in every else "no meaning: named, field, free, reserved?"
            item.fail(f"bit {bit} has {times}", code=str(word.code))


def control_bits(word: ControlWordInfo) -> list[int]:
    """Give the numbers of the bits that have a name or lie in a field, each as often as that."""
    named = [bit.bit for bit in word.bits.values()]
    fields = word.fields.values()
    return named + [bit for field in fields for bit in range(field.low, field.high + 1)]
