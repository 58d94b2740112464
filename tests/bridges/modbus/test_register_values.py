"""What registers read: numbers that are fresh, or an exception, and never an old number."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue, LineFollower
from lecombus.bridges.modbus.register_map import BLOCK, DRIVE, LINE, STATES, RegisterPart
from lecombus.bridges.modbus.register_values import ModbusError, ModbusException, RegisterReader
from lecombus.client import LineStatus, Reading

NOW_S = 1000.0
FEEDER = 11 * BLOCK
NEVER = 0xFFFF


class NoControl:
    def line_registers(self) -> Mapping[str, int]:
        return {one.name: 0 for one in LINE}

    def drive_registers(self, drive: str) -> Mapping[str, int]:
        return {one.name: 0 for one in DRIVE}


def value(code: str, number: Any, *, age_s: float = 1.0, left_s: float = 5.0) -> FollowedValue:
    reading = Reading.of({"drive": "feeder", "code": code, "value": number, "quality": "good"})
    return FollowedValue(reading, NOW_S - age_s, NOW_S + left_s)


def feeder(**values: FollowedValue) -> FollowedDrive:
    found = FollowedDrive("feeder", 11, "8200vector", "online", states=("enabled", "ready"))
    found.values = dict(values)
    found.doing = "running"
    return found


def reader(*drives: FollowedDrive, away: bool = False) -> RegisterReader:
    follower = LineFollower("/nowhere")
    follower.is_connected = not away
    follower.drives = {one.name: one for one in drives}
    if not away:
        follower.line = LineStatus.of({"line": "test", "state": "open"})
    at_start = [FollowedDrive("feeder", 11, "8200vector")]
    return RegisterReader(follower, NoControl(), at_start, lambda: NOW_S)


def refused(of: RegisterReader, first: int, count: int = 1) -> ModbusException | None:
    try:
        of.read(first, count)
    except ModbusError as exc:
        return exc.code
    return None


ALL = {
    "C0150": value("C0150", 0x8600, age_s=0.31),
    "C0050": value("C0050", Decimal("35.4"), age_s=1.0),
    "C0046": value("C0046", Decimal("-0.0001"), age_s=2.0),
}


def test_fresh_values_are_numbers_scaled_and_high_word_first() -> None:
    of = reader(feeder(**ALL))
    assert of.read(FEEDER, 10) == [2, 0b1111, 4, 10, 20, 1, 1, 0, 0, 0]
    states = 1 << STATES.index("enabled") | 1 << STATES.index("ready")
    assert of.read(FEEDER + 20, 10) == [0x8600, 0, states, 1, 0, 0, 5, 0x66D0, 0xFFFF, 0xFFFF]
    assert 5 << 16 | 0x66D0 == 354000


def test_a_fault_is_shown_by_kind_and_number() -> None:
    drive = feeder(**ALL)
    drive.fault = {"kind": "trip", "number": 50}
    assert reader(drive).read(FEEDER + 24, 2) == [1, 50]
    drive.fault = {"kind": "warning", "number": None}
    assert reader(drive).read(FEEDER + 24, 2) == [3, 0]


@pytest.mark.parametrize(("code", "registers", "bit"), [
    ("C0150", (20, 21, 23, 24, 25), 0), ("C0050", (26,), 2), ("C0046", (28,), 3),
])  # fmt: skip
@pytest.mark.parametrize("how", ["stale", "missing", "no number"])
def test_a_value_that_is_not_fresh_is_an_exception_and_the_rest_can_be_read(
    code: str, registers: tuple[int, ...], bit: int, how: str
) -> None:
    values = dict(ALL)
    if how == "missing":
        del values[code]
    else:
        number = values[code].reading.value if how == "stale" else "S33"
        values[code] = value(code, number, left_s=0.0 if how == "stale" else 5.0)
    of = reader(feeder(**values))
    sizes = {one.offset: one.words for one in DRIVE}
    for one in DRIVE:
        expected = None
        if one.offset in registers:
            expected = ModbusException.NOT_FRESH
        assert refused(of, FEEDER + one.offset, sizes[one.offset]) == expected
    assert refused(of, FEEDER + 20, 10) == ModbusException.NOT_FRESH
    fresh = of.read(FEEDER + 1, 1)[0]
    assert fresh == 0b1111 & ~(0b11 if bit == 0 else 1 << bit)
    age = of.read(FEEDER + 2, 3)[{0: 0, 2: 1, 3: 2}[bit]]
    assert (age == NEVER) == (how == "missing")


def test_states_that_are_not_known_are_an_exception_though_the_word_is_fresh() -> None:
    drive = feeder(**ALL)
    drive.states = None
    of = reader(drive)
    assert refused(of, FEEDER + 20) is None
    assert refused(of, FEEDER + 21, 2) == ModbusException.NOT_FRESH
    assert of.read(FEEDER + 1, 1) == [0b1101]


def test_while_the_daemon_is_away_every_value_is_an_exception_and_states_are_unknown() -> None:
    drive = feeder(**ALL)
    drive.state = "unknown"
    for of in (reader(drive, away=True), reader(away=True)):
        assert of.read(FEEDER, 1) == [0]
        assert len(of.read(FEEDER, 17)) == 17
        assert of.read(0, 8)[2] == 0
        assert refused(of, 20) == ModbusException.LECOMBUS_AWAY
        for one in DRIVE:
            if one.part is RegisterPart.FRESH:
                found = refused(of, FEEDER + one.offset, one.words)
                assert found == ModbusException.LECOMBUS_AWAY


def test_the_line_counts_its_drives() -> None:
    drives = [
        FollowedDrive(f"d{number}", number, "820x", state)
        for number, state in enumerate(("online", "online", "degraded", "offline", "starting"), 1)
    ]
    assert reader(*drives).read(20, 5) == [1, 5, 2, 1, 1]


@pytest.mark.parametrize(("first", "count"), [
    (FEEDER + 17, 1), (FEEDER + 30, 1), (FEEDER + 44, 1), (FEEDER, 18), (FEEDER + 26, 1),
    (FEEDER + 27, 1), (FEEDER + 25, 2), (FEEDER + 27, 2), (FEEDER + 42, 1), (12 * BLOCK, 1),
    (99, 1), (8, 1), (0, 21), (65535, 1), (FEEDER - 1, 2),
])  # fmt: skip
def test_registers_that_are_not_there_and_half_numbers_are_refused(first: int, count: int) -> None:
    assert refused(reader(feeder(**ALL)), first, count) == ModbusException.NO_SUCH_REGISTER


def test_ages_are_rounded_up_and_end_at_65535() -> None:
    drive = feeder(C0150=value("C0150", 1, age_s=0.01), C0050=value("C0050", 1, age_s=6553.4),
                   C0046=value("C0046", 1, age_s=7000))  # fmt: skip
    assert reader(drive).read(FEEDER + 2, 3) == [1, 65534, NEVER]


@given(
    st.dictionaries(
        st.sampled_from(["C0150", "C0050", "C0046"]),
        st.tuples(st.floats(-10, 10), st.one_of(st.integers(0, 0xFFFF), st.none(), st.text())),
    ),
    st.integers(0, 50), st.integers(1, 60), st.booleans(),
)  # fmt: skip
def test_no_read_answers_with_a_number_that_is_not_fresh(
    values: dict[str, tuple[float, Any]], offset: int, count: int, away: bool
) -> None:
    drive = feeder(**{
        code: value(code, number, left_s=left_s) for code, (left_s, number) in values.items()
    })  # fmt: skip
    of = reader(drive, away=away)
    try:
        words = of.read(FEEDER + offset, count)
    except ModbusError:
        return
    assert len(words) == count
    behind = {20: "C0150", 21: "C0150", 23: "C0150", 24: "C0150", 25: "C0150", 26: "C0050",
              28: "C0046"}  # fmt: skip
    for register, code in behind.items():
        if offset <= register < offset + count:
            left_s, number = values[code]
            assert left_s > 0
            assert isinstance(number, int)
            assert not away
