"""Answer times against the manual's table (EDB2102EN 3.5), family by family and code by code."""

from __future__ import annotations

import pytest

from lecombus.drives import family
from lecombus.parameters import Code

LATER_82XX = ("821x", "822x", "824x", "8200vector")

READS_MS = [
    *[("820x", code, 35) for code in ("C0046", "C0135", "C0050", "C0150")],
    ("820x", "C0068", 70),
    ("820x", "C0011", 55),
    ("820x", "C0161", 55),
    ("820x", "C0700", 55),
    *[(name, code, 20) for name in LATER_82XX for code in ("C0046", "C0135", "C0050", "C0150")],
    *[(name, "C0068", 30) for name in LATER_82XX],
    *[(name, "C0011", 20) for name in LATER_82XX],
    *[("93xx", code, 20) for code in ("C0046", "C0135", "C0050", "C0150", "C0011", "C0168/1")],
    ("93xx", "C0068", 30),
    *[
        (name, code, 500)
        for name in ("820x", *LATER_82XX)
        for code in ("C1920", "C1921", "C1922", "C1923")
    ],
    ("93xx", "C1923", 20),
    ("smvector", "C0150", 20),
    ("smvector", "C1500", 20),
    ("generic", "C0001", 50),
    ("generic", "C0150", 50),
]

WRITES_MS = [
    ("820x", "C0046", 35, 70),
    ("820x", "C0135", 35, 70),
    ("820x", "C0040", 230, 230),
    ("820x", "C0011", 230, 230),
    *[(name, "C0046", 20, 20) for name in LATER_82XX],
    *[(name, "C0135", 20, 20) for name in LATER_82XX],
    *[(name, "C0040", 20, 50) for name in LATER_82XX],
    *[(name, "C0011", 20, 50) for name in LATER_82XX],
    *[(name, "C1923", 500, 500) for name in ("820x", *LATER_82XX)],
    ("93xx", "C0040", 20, 20),
    ("93xx", "C0141", 20, 20),
    ("smvector", "C1425", 20, 20),
    ("generic", "C0040", 50, 50),
]


@pytest.mark.parametrize(("name", "code", "ms"), READS_MS)
def test_reads_take_what_the_manual_says(name: str, code: str, ms: int) -> None:
    assert family(name).answer_time_s(Code.parse(code), write=False) == ms / 1000


@pytest.mark.parametrize(("name", "code", "usual_ms", "longest_ms"), WRITES_MS)
def test_writes_take_what_the_manual_says(
    name: str, code: str, usual_ms: int, longest_ms: int
) -> None:
    drive, number = family(name), Code.parse(code)
    assert drive.answer_time_s(number, write=True) == usual_ms / 1000
    assert drive.longest_answer_time_s(number, write=True) == longest_ms / 1000


@pytest.mark.parametrize(("mode", "ms"), [(None, 35), (0, 35), (1, 70), (2, 35), (3, 35)])
def test_820x_setpoint_takes_longer_in_operating_mode_1(mode: int | None, ms: int) -> None:
    drive = family("820x")
    assert drive.answer_time_s(Code(46), write=True, c0001=mode) == ms / 1000
    assert drive.answer_time_s(Code(135), write=True, c0001=mode) == ms / 1000
    assert drive.answer_time_s(Code(50), write=False, c0001=mode) == 0.035


def test_operating_mode_changes_nothing_on_later_drives() -> None:
    assert family("8200vector").answer_time_s(Code(46), write=True, c0001=1) == 0.020


@pytest.mark.parametrize(
    ("name", "ms"),
    [("820x", 230), *[(name, 50) for name in (*LATER_82XX, "93xx")], ("smvector", 0)],
)
def test_module_is_left_alone_after_a_shortened_response(name: str, ms: int) -> None:
    assert family(name).hold_after_write_s == ms / 1000
