"""Stopping a drive: what is written, what it must not disturb, and what counts as proof."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import (
    FAMILY_NAMES,
    Family,
    StopAction,
    confirm_codes,
    family,
    knows_stop,
    needs_control_word,
    stop_confirmed,
    stop_value,
)
from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

INHIBIT, QUICK_STOP = StopAction.INHIBIT, StopAction.QUICK_STOP
DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
SHOW_QUICK_STOP = ("820x", "821x", "822x", "824x", "smvector")


def word(number: int) -> Value:
    return Value.hexadecimal(number, 4)


@pytest.mark.parametrize("name", DESCRIBED)
def test_inhibit_is_c0040_set_to_0_and_needs_nothing(name: str) -> None:
    assert stop_value(family(name), INHIBIT, None) == (Code(40), Value.parse("0"))
    assert not needs_control_word(family(name), INHIBIT)


@pytest.mark.parametrize("name", DESCRIBED)
def test_quick_stop_sets_bit_3_of_the_known_control_word(name: str) -> None:
    assert needs_control_word(family(name), QUICK_STOP)
    assert stop_value(family(name), QUICK_STOP, 0x0000) == (Code(135), Value.parse("H0008"))
    assert stop_value(family(name), QUICK_STOP, 0x1205) == (Code(135), Value.parse("H120D"))


@given(
    control_word=st.integers(0, 0xFFFF),
    name=st.sampled_from([name for name in DESCRIBED if name != "820x"]),
)
def test_quick_stop_keeps_an_inhibit_and_gives_no_trip_reset(control_word: int, name: str) -> None:
    _, value = stop_value(family(name), QUICK_STOP, control_word)
    sent = value.number
    assert isinstance(sent, int)
    assert sent ^ control_word in (0, 0x0008, 0x0800, 0x0808)
    assert sent & 0x0808 == 0x0008


def test_820x_keeps_its_reserved_bit_11() -> None:
    assert stop_value(family("820x"), QUICK_STOP, 0x0A00)[1] == word(0x0A08)


@pytest.mark.parametrize("name", DESCRIBED)
def test_quick_stop_is_refused_while_the_control_word_is_unknown(name: str) -> None:
    with pytest.raises(OperationError, match="not known") as refused:
        stop_value(family(name), QUICK_STOP, None)
    assert refused.value.kind == "no-control-word"
    assert "inhibit" in refused.value.remedy


@pytest.mark.parametrize("action", list(StopAction))
def test_a_device_without_description_knows_no_stop_and_says_so(action: StopAction) -> None:
    generic = family("generic")
    assert not knows_stop(generic, action)
    assert not needs_control_word(generic, action)
    assert not stop_confirmed(generic, action, Code(40), Value.parse("0"))
    for asked in (lambda: stop_value(generic, action, 0), lambda: confirm_codes(generic, action)):
        with pytest.raises(OperationError) as refused:
            asked()
        assert refused.value.kind == "no-stop"


@pytest.mark.parametrize("name", DESCRIBED)
def test_inhibit_is_proven_by_status_word_or_by_c0040(name: str) -> None:
    drive = family(name)
    assert confirm_codes(drive, INHIBIT)[0] == Code(150)
    assert stop_confirmed(drive, INHIBIT, Code(150), word(0x0080))
    assert not stop_confirmed(drive, INHIBIT, Code(150), word(0xFF7F))
    assert stop_confirmed(drive, INHIBIT, Code(40), Value.parse("0"))
    assert not stop_confirmed(drive, INHIBIT, Code(40), Value.parse("1"))


@pytest.mark.parametrize("name", [name for name in DESCRIBED if name != "smvector"])
def test_operating_status_without_enable_proves_inhibit(name: str) -> None:
    assert stop_confirmed(family(name), INHIBIT, Code(68), word(0x0000))
    assert not stop_confirmed(family(name), INHIBIT, Code(68), word(0x0100))


def test_smvector_bit_8_means_something_else_and_proves_nothing() -> None:
    assert Code(68) not in confirm_codes(family("smvector"), INHIBIT)
    assert not stop_confirmed(family("smvector"), INHIBIT, Code(68), word(0x0000))


@pytest.mark.parametrize("name", SHOW_QUICK_STOP)
def test_quick_stop_is_proven_by_the_operating_status(name: str) -> None:
    drive = family(name)
    assert confirm_codes(drive, QUICK_STOP) == (Code(68), Code(135))
    assert stop_confirmed(drive, QUICK_STOP, Code(68), word(0x1000))
    assert not stop_confirmed(drive, QUICK_STOP, Code(68), word(0xEFFF))


@pytest.mark.parametrize("drive", [family("8200vector"), family("93xx").configured(1001)])
def test_where_bit_12_is_reserved_only_the_control_word_proves_quick_stop(drive: Family) -> None:
    assert confirm_codes(drive, QUICK_STOP) == (Code(135),)
    assert not stop_confirmed(drive, QUICK_STOP, Code(68), word(0x1000))
    assert stop_confirmed(drive, QUICK_STOP, Code(135), word(0x0208))
    assert not stop_confirmed(drive, QUICK_STOP, Code(135), word(0xFFF7))


@pytest.mark.parametrize("number", [None, 1000, 2001, 1012])
def test_a_control_word_that_a_93xx_may_not_follow_proves_no_quick_stop(number: int | None) -> None:
    drive = family("93xx").configured(number)
    assert not stop_confirmed(drive, QUICK_STOP, Code(135), word(0x0008))
    assert stop_confirmed(drive, INHIBIT, Code(150), word(0x0080)), "an inhibit acts in all of them"


@pytest.mark.parametrize("name", DESCRIBED)
def test_a_value_of_the_wrong_kind_proves_nothing(name: str) -> None:
    drive = family(name)
    assert not stop_confirmed(drive, INHIBIT, Code(150), Value.parse("128"))
    assert not stop_confirmed(drive, QUICK_STOP, Code(135), Value.parse("SH0008"))
    assert not stop_confirmed(drive, INHIBIT, Code(50), Value.parse("0"))
