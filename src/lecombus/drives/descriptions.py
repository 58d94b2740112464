"""What a family's description says, as documents: for the API, and for `describe` without a daemon.

Strategy: one document a code, made from `CodeInfo` and, for words, from what takes them apart.
Texts stand in both languages, so that a document does not depend on who asks; what the manual
does not give is null or missing from a list, never filled in. A description never changes while
the daemon runs, but it depends on the signal configuration, so documents are made when asked for.
"""

from __future__ import annotations

from collections.abc import Iterator

from lecombus.drives import CodeInfo, ControlWordInfo, Family, Text, WordInfo, german_name
from lecombus.parameters import Json

__all__ = ["code_document", "family_document"]


def family_document(family: Family) -> dict[str, Json]:
    """Return what a family is, without its codes."""
    offsets: list[Json] = list(family.set_offsets)
    return {
        "family": family.name,
        "title": family.title,
        "configuration": family.configuration or None,
        "configured_by": None if family.configured_by is None else str(family.configured_by),
        "saved_by": None if family.saved_by is None else str(family.saved_by),
        "parameter_set_offsets": offsets,
    }


def code_document(family: Family, info: CodeInfo) -> dict[str, Json]:
    """Return what is known of a code."""
    selection: list[Json] = [
        {"value": number, **text_document(text)} for number, text in info.selection.items()
    ]
    return {
        "code": f"C{info.code.number:04d}",
        "subcode": info.code.subcode,
        "name": info.name,
        "name_de": info.name_de or info.name,
        "unit": info.unit,
        "format": info.format.value,
        "low": info.low,
        "high": info.high,
        "step": info.step,
        "selection": selection,
        "selection_partial": info.selection_partial,
        "array": info.array,
        "default": info.default,
        "readable": info.readable,
        "writable": info.writable,
        "write_class": info.write_class.value,
        "needs_inhibit": info.needs_inhibit,
        "motion": info.motion,
        "storage": info.storage.value,
        "parameter_set": info.parameter_set,
        "secret": info.secret,
        "bits": bits_document(family, info),
        "source": info.source,
    }


def bits_document(family: Family, info: CodeInfo) -> list[Json]:
    """Return the bits of a word, the lowest first; empty for a code that is none."""
    control, word = family.control_words.get(info.code), family.words.get(info.code)
    found = [*(control_bits(control) if control else ()), *(status_bits(word) if word else ())]
    found.sort(key=lambda one: one[0])
    return [document for _, document in found]


def control_bits(word: ControlWordInfo) -> Iterator[tuple[int, dict[str, Json]]]:
    """Give the bits of a control word with their number."""
    for bit in word.bits.values():
        levels = (text_document(bit.off), text_document(bit.on))
        yield bit.bit, bit_document(bit.bit, bit.bit, "bit", bit.name, dict(enumerate(levels)))
    for field in word.fields.values():
        meanings = {number: text_document(text) for number, text in field.texts.items()}
        yield field.low, bit_document(field.low, field.high, "field", field.name, meanings)
    for number in word.free:
        yield number, bit_document(number, number, "free", "", {})
    for number in word.reserved:
        yield number, bit_document(number, number, "reserved", "", {})


def status_bits(word: WordInfo) -> Iterator[tuple[int, dict[str, Json]]]:
    """Give the bits of a status word with their number."""
    for name, mask in word.bits:
        number = mask.bit_length() - 1
        yield number, bit_document(number, number, "bit", name, {})
    for field in word.fields:
        meanings = {number: text_document(text) for number, text in field.texts.items()}
        yield field.low, bit_document(field.low, field.high, "field", field.name, meanings)
    for number in word.free:
        yield number, bit_document(number, number, "free", "", {})


def bit_document(
    low: int, high: int, kind: str, name: str, meanings: dict[int, dict[str, Json]]
) -> dict[str, Json]:
    """Return one bit or field: its place, what it is, and what its values mean."""
    return {
        "low": low,
        "high": high,
        "kind": kind,
        "name": name or None,
        "name_de": german_name(name) or None,
        "meanings": [{"value": number, **text} for number, text in meanings.items()],
    }


def text_document(text: Text) -> dict[str, Json]:
    """Return a text in both languages."""
    return {"en": text.en, "de": text.de}
