"""Every bit and field has one name in German, whatever family it is of."""

from __future__ import annotations

import pytest

from lecombus.drives import FAMILY_NAMES, Family, family, german_name
from lecombus.drives.words import bit_names
from lecombus.errors import DescriptionError


def every_variant() -> list[Family]:
    plain = [family(name) for name in FAMILY_NAMES]
    return [*plain, *(one for each in plain for one in each.variants.values())]


def names_of(one: Family) -> set[str]:
    words, controls = one.words.values(), one.control_words.values()
    bits = {name for word in words for name, _ in word.bits}
    fields = {field.name for word in words for field in word.fields}
    return bits | fields | {name for word in controls for name in (*word.bits, *word.fields)}


def test_every_bit_and_field_has_a_german_name_and_no_other_does() -> None:
    used = {name for one in every_variant() for name in names_of(one)}
    given = bit_names()
    assert used == given.keys()
    assert len(set(given.values())) == len(given), "two bits would be told alike"
    assert [name for name in given.values() if "_" in name or not name.isprintable()] == []


def test_every_number_of_a_status_field_has_a_text_in_both_languages() -> None:
    for one in every_variant():
        for word in one.words.values():
            for field in word.fields:
                for number, text in field.texts.items():
                    assert text.en, (one.name, field.name, number)
                    assert text.de not in ("", text.en), (one.name, field.name, number)


def test_a_name_of_an_extension_is_its_own_german() -> None:
    assert german_name("pulse_inhibit") == "Impulssperre"
    assert german_name("spindle_warm") == "spindle_warm"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("names: {a: [b, c]}", "text"),
        ("names: {a: b, a: c}", "a"),
        ("names: {a: b}\nmore: 1", "more"),
        ("other: {}", "names"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(text: str, says: str) -> None:
    with pytest.raises(DescriptionError, match=says) as caught:
        bit_names({"bit-names.yaml": text}.__getitem__)
    assert "families/bit-names.yaml" in str(caught.value)
