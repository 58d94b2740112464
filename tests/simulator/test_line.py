"""Time on the line: pacing, processing times, aborts, collisions, groups."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.simulator import Faults, LateKind, SimDrive, SimLine, build
from support.sim_host import Host, read_telegram, write_telegram

CHAR_S = 10 / 9600


def timed(family: str, telegram: bytes, **overrides: str) -> float:
    """Seconds from the request's last character to the answer's start."""
    presets = {int(key[1:]): value for key, value in overrides.items()}
    host = Host(SimLine([SimDrive(11, family, overrides=presets)], baud=9600))
    start_s = host.now_s
    host.say(telegram)
    host.hear()
    return host.arrivals[0][0] - CHAR_S - (start_s + len(telegram) * CHAR_S)


@pytest.mark.parametrize("baud", [1200, 2400, 4800, 9600, 19200])
def test_bytes_are_paced_exactly(baud: int) -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=baud))
    start_s = host.now_s
    host.say(read_telegram(11, 50))
    answer = host.hear()
    char_s = 10 / baud
    begin_s = start_s + 6 * char_s + 0.020
    assert [data for _, data in host.arrivals] == [bytes((byte,)) for byte in answer]
    for place, (at_s, _) in enumerate(host.arrivals):
        assert at_s == pytest.approx(begin_s + (place + 1) * char_s, abs=1e-9)


@pytest.mark.parametrize(
    ("family", "number", "expected_s"),
    [
        ("820x", 46, 0.035),
        ("820x", 50, 0.035),
        ("820x", 150, 0.035),
        ("820x", 68, 0.070),
        ("820x", 11, 0.055),
        ("820x", 1923, 0.500),
        ("821x", 46, 0.020),
        ("822x", 150, 0.020),
        ("824x", 68, 0.030),
        ("8200vector", 11, 0.020),
        ("8200vector", 1922, 0.500),
        ("93xx", 50, 0.020),
        ("93xx", 68, 0.030),
        ("smvector", 150, 0.020),
        ("generic", 10, 0.020),
    ],
)
def test_reads_take_the_manuals_processing_time(
    family: str, number: int, expected_s: float
) -> None:
    assert timed(family, read_telegram(11, number)) == pytest.approx(expected_s, abs=1e-9)


@pytest.mark.parametrize(
    ("family", "number", "text", "expected_s"),
    [
        ("820x", 46, "10", 0.035),
        ("820x", 135, "H0000", 0.035),
        ("820x", 12, "3", 0.230),
        ("821x", 12, "3", 0.020),
        ("8200vector", 1923, "2000", 0.500),
        ("93xx", 141, "50", 0.020),
        ("smvector", 1061, "30", 0.020),
    ],
)
def test_writes_take_the_manuals_processing_time(
    family: str, number: int, text: str, expected_s: float
) -> None:
    assert timed(family, write_telegram(11, number, text)) == pytest.approx(expected_s, abs=1e-9)


def test_the_setpoint_of_an_820x_in_keypad_mode_takes_70_ms() -> None:
    assert timed("820x", write_telegram(11, 46, "10"), c1="1") == pytest.approx(0.070, abs=1e-9)


def test_a_write_right_after_a_write_takes_50_ms() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    host.write(11, 12, "3")
    start_s = host.now_s
    telegram = write_telegram(11, 13, "4")
    host.ask(telegram)
    assert host.now_s - start_s == pytest.approx((len(telegram) + 1) * CHAR_S + 0.050, abs=1e-9)


def test_spread_only_makes_answers_come_sooner() -> None:
    host = Host(SimLine([SimDrive(11, "822x", spread=0.2)], baud=9600))
    seen = set()
    for _ in range(20):
        start_s = host.now_s
        host.ask(read_telegram(11, 4))
        think_s = host.arrivals[0][0] - start_s - 7 * CHAR_S
        assert 0.016 - 1e-9 <= think_s <= 0.020 + 1e-9
        seen.add(round(think_s, 6))
    assert len(seen) > 10


def test_unpaced_answers_come_whole_after_the_processing_time() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600, paced=False))
    start_s = host.now_s
    host.say(read_telegram(11, 4))
    host.hear()
    assert len(host.arrivals) == 1
    assert host.arrivals[0][0] == pytest.approx(start_s + 0.020)


def test_without_thinking_and_pacing_the_answer_is_there_at_once() -> None:
    line = SimLine([SimDrive(11, "822x")], baud=9600, paced=False, think_scale=0.0)
    host = Host(line)
    host.say(read_telegram(11, 4))
    assert line.poll(host.now_s)


def test_the_host_cannot_send_faster_than_the_line() -> None:
    host = Host(SimLine([SimDrive(11, "822x"), SimDrive(12, "822x")], baud=9600))
    start_s = host.now_s
    host.say(b"\x00" * 96)
    host.say(read_telegram(11, 4))
    host.hear()
    assert host.arrivals[0][0] == pytest.approx(start_s + (96 + 6 + 1) * CHAR_S + 0.020)


def test_eot_makes_a_drive_drop_its_answer_and_report_it() -> None:
    line = SimLine([SimDrive(11, "822x"), SimDrive(12, "822x")], baud=9600)
    host = Host(line)
    host.say(read_telegram(11, 4))
    host.hear(until_s=host.now_s + 0.015)
    host.say(b"\x04")
    assert host.hear() == b""
    assert line.aborted == 1
    assert line.collisions == 0
    assert host.word(11, 68) >> 4 & 0xF == 7
    assert host.word(12, 68) >> 4 & 0xF == 0
    host.read(11, 4)
    assert host.word(11, 68) >> 4 & 0xF == 0


def test_speaking_over_a_drive_is_a_collision_and_cuts_it_off() -> None:
    line = SimLine([SimDrive(11, "822x")], baud=9600)
    host = Host(line)
    host.say(read_telegram(11, 200))
    whole = len(host.hear())
    host.say(read_telegram(11, 200))
    host.hear(until_s=host.now_s + (6 + 5) * CHAR_S + 0.020)
    host.say(b"\x04")
    rest = host.hear()
    assert line.collisions == 1
    assert 5 + len(rest) < whole
    assert host.word(11, 68) >> 4 & 0xF == 7


def test_a_new_request_gets_its_own_answer_after_an_abort() -> None:
    host = Host(SimLine([SimDrive(11, "822x"), SimDrive(12, "822x")], baud=9600))
    host.say(read_telegram(11, 4))
    host.hear(until_s=host.now_s + 0.010)
    host.line["drive-12"].model.params.set(4, "77")
    assert host.read(12, 4) == "77"


def test_a_write_cut_short_by_eot_is_a_frame_error() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    host.say(write_telegram(11, 11, "60")[:-3])
    host.say(b"\x04")
    host.hear()
    assert host.word(11, 68) >> 4 & 0xF == 2
    assert host.read(11, 11) == "50"


@pytest.mark.parametrize(
    ("group", "reached"),
    [(0, [1, 9, 11, 19, 21, 99]), (10, [11, 19]), (20, [21]), (90, [99]), (50, [])],
)
def test_group_addresses_reach_their_decade_and_are_never_answered(
    group: int, reached: list[int]
) -> None:
    drives = [SimDrive(n, "822x") for n in (1, 9, 11, 19, 21, 99)]
    host = Host(SimLine(drives, baud=9600))
    assert host.write(group, 46, "12") == ""
    assert [drive.address for drive in drives if drive.text(46) == "12"] == reached
    assert host.ask(read_telegram(group, 46)) == b""


def test_addresses_ending_in_0_and_double_addresses_are_refused() -> None:
    with pytest.raises(ValueError, match="20"):
        SimDrive(20, "822x")
    with pytest.raises(ValueError, match="twice"):
        build([("a", 11, "822x"), ("b", 11, "820x")])
    with pytest.raises(ValueError, match="823x"):
        build([("a", 11, "823x")])


def test_a_changed_address_holds_from_the_next_telegram() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    assert host.write(11, 9, "17") == "ACK"
    assert host.read(11, 46) == ""
    assert host.read(17, 46) == "0"


def test_a_changed_baud_rate_makes_the_drive_seem_dead() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    host.say(write_telegram(11, 125, "4"))
    assert host.hear() != b"\x06"
    assert host.read(11, 46) == ""


def test_a_host_at_the_changed_rate_reaches_that_drive_and_no_other() -> None:
    drives = build([("a", 11, "822x"), ("b", 12, "822x")], baud=9600)
    host = Host(drives)
    host.ask(write_telegram(11, 125, "4"))  # acknowledged at the new rate already
    drives.host_baud = 19200
    before_s = host.now_s
    assert host.read(11, 125) == "4"
    assert host.now_s - before_s == pytest.approx((6 + 6) * 10 / 19200 + 0.020)
    assert host.read(12, 125) == ""


def test_nobody_answers_for_an_address_without_a_drive() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    assert host.read(12, 46) == ""


def test_the_log_tells_what_was_asked_and_done() -> None:
    host = Host(SimLine([SimDrive(11, "822x", "feeder")], baud=9600))
    host.write(11, 46, "12")
    host.write(11, 46, "999")
    host.read(11, 46)
    host.write(0, 46, "5")
    entries = host.line["feeder"].log
    assert [(e.kind, e.code, e.text, e.accepted) for e in entries] == [
        ("write", 46, "12", True),
        ("write", 46, "999", False),
        ("read", 46, "12", True),
        ("group", 46, "5", True),
    ]


def test_an_observer_sees_every_request_at_its_last_character() -> None:
    host = Host(SimLine([SimDrive(11, "822x")], baud=9600))
    seen: list[tuple[float, int]] = []
    host.line.on_request = lambda at_s, heard: seen.append((at_s, heard.address))
    start_s = host.now_s
    host.say(read_telegram(11, 4))
    host.hear()
    host.read(77, 4)
    assert seen[0][0] == pytest.approx(start_s + 6 * CHAR_S)
    assert [address for _, address in seen] == [11, 77]


def test_a_built_line_starts_with_the_values_given_and_remembers_as_much_as_asked() -> None:
    line = build([("a", 11, "822x")], overrides={"a": {46: "12.5"}}, log_size=3)
    host = Host(line)
    assert [host.read(11, 46) for _ in range(5)] == ["12.5"] * 5
    assert len(line["a"].log) == 3
    assert line["a"].heard == 5


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from([46, 50, 68, 150, 200, 999, 1923]), min_size=1, max_size=5),
    st.lists(st.floats(0.0001, 0.05), min_size=1, max_size=60),
    st.integers(0, 1000),
)
def test_how_often_one_looks_does_not_change_what_comes(
    codes: list[int], steps: list[float], seed: int
) -> None:
    def hear(steps: list[float]) -> bytes:
        faults = Faults(noise=0.3, late=0.3, late_kind=LateKind.ADAPTER, half=0.1, lost=0.1)
        line = SimLine([SimDrive(11, "820x")], baud=9600, faults=faults, seed=seed)
        host = Host(line)
        heard = []
        for code in codes:
            host.say(read_telegram(11, code))
            end_s = host.now_s + 1.5
            for step in steps:
                if host.now_s + step < end_s:
                    host.now_s += step
                    heard.append(line.poll(host.now_s))
            heard.append(host.hear(until_s=end_s))
        return b"".join(heard)

    assert hear(steps) == hear([])
