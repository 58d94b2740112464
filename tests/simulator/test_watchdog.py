"""Watchdogs fire at their time and not before, and do what they are set to (EDB2102EN 6.3.3)."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from support.sim_host import Host, read_telegram, write_telegram

BEHIND_2102 = ("820x", "821x", "822x", "824x", "8200vector", "93xx")


def running(family: str, codes: dict[int | tuple[int, int], str]) -> Host:
    speed = {"93xx": 141, "smvector": 1061}.get(family, 46)
    presets = {speed: "40", 135: "H0000", **codes}
    host = Host(SimLine([SimDrive(11, family, "d", presets)], baud=19200))
    host.wait(0)
    return host


def last_heard_s(host: Host) -> float:
    """Speak to the drive; give the time its telegram's last character arrived."""
    telegram = read_telegram(11, 4)
    at_s = host.now_s + len(telegram) * 10 / 19200
    host.ask(telegram)
    return at_s


@pytest.mark.parametrize("family", BEHIND_2102)
@pytest.mark.parametrize(("action", "bit"), [("1", 0x0200), ("2", 0x0008)])
def test_the_2102_watchdog_fires_at_its_time(family: str, action: str, bit: int) -> None:
    host = running(family, {1923: "400", 1922: action})
    drive = host.line["d"]
    heard_s = last_heard_s(host)
    drive.advance(heard_s + 0.400)
    assert drive.watchdog_fired == 0
    drive.advance(heard_s + 0.4001)
    assert drive.watchdog_fired == 1
    assert drive.model.control & bit
    drive.advance(heard_s + 60)
    assert drive.watchdog_fired == 1, "it fires once, until it is fed again"


def test_without_an_action_nothing_fires() -> None:
    host = running("822x", {1923: "50", 1922: "0"})
    host.wait(60)
    assert host.line["d"].watchdog_fired == 0


@pytest.mark.parametrize("family", ["822x", "93xx", "smvector"])
def test_a_fed_watchdog_never_fires(family: str) -> None:
    codes: dict[int | tuple[int, int], str] = (
        {1425: "300", 1426: "3"} if family == "smvector" else {1923: "300", 1922: "1"}
    )
    host = running(family, codes)
    for _ in range(50):
        host.read(11, 50)
        host.wait(0.2)
    assert host.line["d"].watchdog_fired == 0


def test_telegrams_to_others_groups_and_damaged_ones_do_not_feed() -> None:
    drives = [SimDrive(11, "822x", "d", {1923: "300", 1922: "2"}), SimDrive(12, "822x")]
    host = Host(SimLine(drives, baud=19200))
    host.read(11, 4)
    bad = write_telegram(11, 46, "10")
    for _ in range(4):
        host.wait(0.1)
        host.read(12, 4)
        host.write(0, 46, "10")
        host.ask(bad[:-1] + bytes((bad[-1] ^ 1,)))
    assert host.line["d"].watchdog_fired == 1


def test_a_refused_telegram_feeds() -> None:
    host = running("822x", {1923: "300", 1922: "2"})
    for _ in range(10):
        assert host.read(11, 999) == "EOT"
        assert host.write(11, 4711, "1") == "NAK"
        host.wait(0.1)
    assert host.line["d"].watchdog_fired == 0


def test_it_can_fire_again_after_it_was_fed_again() -> None:
    host = running("822x", {1923: "300", 1922: "2"})
    host.wait(1)
    host.read(11, 50)
    host.wait(1)
    assert host.line["d"].watchdog_fired == 2


def test_the_motor_stops_from_the_moment_it_fires() -> None:
    host = running("822x", {1923: "1000", 1922: "2", 12: "0", 105: "5"})
    drive = host.line["d"]
    heard_s = last_heard_s(host)
    drive.advance(heard_s + 1.0 + 2.0)
    # 40 Hz at 10 Hz/s for two seconds, though nobody looked when it fired.
    assert drive.model.motor.speed == pytest.approx(20, abs=0.01)


def test_the_motor_goes_on_until_the_moment_it_fires() -> None:
    host = running("822x", {1923: "2000", 1922: "2", 12: "5", 105: "5"})
    drive = host.line["d"]
    start_s = host.now_s
    heard_s = last_heard_s(host)
    drive.advance(heard_s + 2.0 + 1.0)
    # Up at 10 Hz/s until it fires, then down at 10 Hz/s for one second.
    assert drive.model.motor.speed == pytest.approx((heard_s + 2.0 - start_s) * 10 - 10, abs=0.01)


@pytest.mark.parametrize(("action", "bit"), [("1", 0x0200), ("2", 0x0008)])
def test_the_smvector_watchdog_inhibits_or_stops(action: str, bit: int) -> None:
    host = running("smvector", {1425: "500", 1426: action})
    host.wait(1)
    assert host.line["d"].watchdog_fired == 1
    assert host.word(11, 135) & bit


def test_the_smvector_watchdog_trips_with_fnf1() -> None:
    host = running("smvector", {1425: "500", 1426: "3"})
    host.wait(1)
    assert host.read(11, 1500) == "36"
    assert host.read(11, 1405) == "1"
    assert host.word(11, 68) & 0x8000
    assert not host.word(11, 150) & 0x8000
    assert host.write(11, 43, "1") == "ACK"
    assert host.word(11, 150) & 0x8000
    assert host.read(11, 1500) == "36"


def test_the_smvector_keeps_its_watchdog_over_a_power_cycle() -> None:
    host = running("smvector", {})
    assert host.write(11, 1425, "500") == "ACK"
    assert host.write(11, 1426, "2") == "ACK"
    host.line["d"].power_cycle(host.now_s, 0.2)
    host.wait(0.3)
    assert host.read(11, 1425) == "500"
    assert host.read(11, 1426) == "2"


def test_the_2102_forgets_its_watchdog_over_a_power_cycle() -> None:
    host = running("822x", {1923: "300", 1922: "2"})
    host.line["d"].power_cycle(host.now_s, 0.2)
    host.wait(60)
    assert host.line["d"].watchdog_fired == 0


def test_setting_a_watchdog_does_not_fire_it_before_its_time() -> None:
    host = running("822x", {})
    host.wait(30)
    assert host.write(11, 1923, "300") == "ACK"
    assert host.write(11, 1922, "2") == "ACK"
    assert host.line["d"].watchdog_fired == 0


@settings(max_examples=60, deadline=None)
@given(st.integers(50, 3000), st.lists(st.floats(0.0, 4.0), min_size=1, max_size=12))
def test_it_fires_exactly_for_the_gaps_that_are_too_long(time_ms: int, gaps: list[float]) -> None:
    drive = SimDrive(11, "822x", "d", {1923: str(time_ms), 1922: "2"})
    model = drive.model
    now_s = 0.0
    drive.advance(now_s)
    for gap in gaps:
        now_s += gap
        drive.advance(now_s)
        model.feed(now_s)
    expected = 0
    at_s = 0.0
    for gap in gaps:
        expected += at_s + time_ms / 1000.0 < at_s + gap
        at_s += gap
    assert drive.watchdog_fired == expected
