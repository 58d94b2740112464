"""Documents of descriptions say what the descriptions say, and nothing that they do not."""

from __future__ import annotations

import pytest

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.descriptions import code_document, family_document
from lecombus.parameters import Code
from openapi.answer_models import CodeDocument


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_code_has_a_document_of_the_published_form(name: str) -> None:
    drive = family(name)
    for info in drive.described():
        document = CodeDocument.model_validate(code_document(drive, info))
        assert (document.name, document.source) == (info.name, info.source)
        assert (document.low, document.high) == (info.low, info.high)
        assert [one.value for one in document.selection] == list(info.selection)


@pytest.mark.parametrize("name", [name for name in FAMILY_NAMES if name != "generic"])
def test_every_bit_of_a_control_word_stands_once(name: str) -> None:
    for drive in {family(name), *family(name).variants.values()}:
        info = drive.info(Code(135))
        assert info is not None
        document = CodeDocument.model_validate(code_document(drive, info))
        bits = [bit for one in document.bits for bit in range(one.low, one.high + 1)]
        assert bits == list(range(16))


def test_free_bits_have_neither_name_nor_meaning() -> None:
    drive = family("8200vector")
    info = drive.info(Code(150))
    assert info is not None
    document = CodeDocument.model_validate(code_document(drive, info))
    free = [one for one in document.bits if one.kind == "free"]
    assert [one.low for one in free] == [0, 2, 3, 4, 5, 14, 15]
    assert all(one.name is None and not one.meanings for one in free)


def test_a_family_says_how_its_sets_are_reached() -> None:
    assert family_document(family("8200vector"))["parameter_set_offsets"] == [0, 2000, 4000, 6000]
    assert family_document(family("93xx").configured(4001))["configuration"] == "4xx1"
    assert family_document(family("93xx"))["configuration"] is None
