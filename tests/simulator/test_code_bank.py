"""Code bank C0249 and input selection C0248: what old drivers need, and what they break.

Source: EDB2102EN 8.2, 8.3.1; CMVLC401A 5.3.2, 5.3.3.
"""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from support.sim_host import Host

BANKED = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")


def single(family: str, codes: dict[int | tuple[int, int], str] | None = None) -> Host:
    return Host(SimLine([SimDrive(11, family, "d", codes)], baud=19200))


def test_the_code_bank_adds_250_for_each_bank_to_standard_addressing() -> None:
    host = single("smvector", {1103: "55"})
    assert host.write(11, 249, "4") == "ACK"
    assert host.read(11, 103) == "55", "C1103 of CMVLC401A 5.3.2"
    assert host.read(11, 500) == "0", "above 255 the offset counts as well: C1500"
    assert host.write(11, 103, "52") == "ACK"
    assert host.read(11, 1103, extended=True) == "52", "extended addressing knows no bank"
    assert host.read(11, 1103) == "EOT", "C2103"


@pytest.mark.parametrize("family", BANKED)
def test_bank_and_selection_are_always_reached_by_their_own_numbers(family: str) -> None:
    host = single(family)
    assert host.write(11, 249, "3") == "ACK"
    assert host.write(11, 248, "2") == "ACK"
    assert (host.read(11, 249), host.read(11, 248)) == ("3", "2")
    assert host.write(11, 248, "0") == "ACK"
    assert host.write(11, 249, "0") == "ACK"
    assert host.read(11, 150)[0] == "H"


def test_a_stop_under_a_code_bank_reaches_another_code() -> None:
    host = single("822x", {135: "H0000", 249: "1"})
    assert host.write(11, 40, "0") == "NAK"
    assert host.write(0, 40, "0") == ""
    assert host.read(11, 40, extended=True) == "1", "nobody has inhibited it"
    assert host.write(11, 40, "0", extended=True) == "ACK"
    assert host.read(11, 40, extended=True) == "0"


def test_the_input_selection_is_the_subcode_of_standard_addressing() -> None:
    host = single("93xx", {(39, 1): "7", (39, 2): "8"})
    assert host.read(11, 39) == "EOT", "the array has no element 0"
    assert host.write(11, 248, "2") == "ACK"
    assert host.read(11, 39) == "8"
    assert host.write(11, 39, "9") == "ACK"
    assert host.read(11, 39, 2, extended=True) == "9"
    assert host.read(11, 39, 1, extended=True) == "7", "extended addressing brings its own"


def test_a_parameter_without_elements_is_not_there_under_an_input_selection() -> None:
    host = single("822x", {248: "1"})
    assert host.read(11, 12) == "EOT"
    assert host.write(11, 12, "5") == "NAK"
    assert host.read(11, 1962, extended=True) == "4", "invalid subcode"


@pytest.mark.parametrize(("family", "most"), [("822x", 15), ("93xx", 15), ("smvector", 7)])
def test_there_are_only_the_banks_of_the_manual(family: str, most: int) -> None:
    host = single(family)
    assert host.write(11, 249, str(most)) == "ACK"
    assert host.write(11, 249, str(most + 1)) == "NAK"


@pytest.mark.parametrize("family", BANKED)
def test_both_are_0_again_after_power_on(family: str) -> None:
    host = single(family)
    host.write(11, 249, "1")
    host.write(11, 248, "1")
    host.line["d"].power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert (host.read(11, 249), host.read(11, 248)) == ("0", "0")


@pytest.mark.parametrize("family", ["822x", "smvector"])
def test_neither_wears_the_memory(family: str) -> None:
    host = single(family)
    host.write(11, 249, "1")
    host.write(11, 248, "1")
    assert host.line["d"].wear == 0
