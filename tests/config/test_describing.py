"""`check` is told what a roster comes to, what is suspicious, and what does nothing yet."""

from __future__ import annotations

import json

import pytest

from config.rosters import CONFIG, GOOD, drive_with, line_with, parsed, roster_with
from lecombus.cli.check import pipe_rows
from lecombus.config import describe, line_timing, load_roster
from lecombus.fieldbus.lecom.protocol.addressing import group_reach
from support.golden import Golden
from support.rosters import roster_text


def warned(text: str) -> list[str]:
    return list(describe(parsed(text)).warnings)


def test_groups_say_whether_one_telegram_reaches_them() -> None:
    members = "both: {members: [belt, feeder]}, one: {members: [belt], multicast: yes}"
    description = describe(parsed(roster_with(f"groups: {{{members}}}")))
    rows = [(one.name, one.how, one.writes, one.multicast_address) for one in description.groups]
    assert rows == [
        ("all", "multicast", "one-by-one", 10),
        ("both", "multicast", "one-by-one", 10),
        ("one", "one-by-one", "one-by-one", None),
    ]
    one_telegram = "one multicast to 10 (reaches every drive at 11 to 19)"
    shown = pipe_rows(description, group_reach)
    assert ("group", "both", one_telegram, "one after another", "belt, feeder") in shown
    assert ("group", "one", "one after another", "one after another", "belt") in shown
    assert any("group one: multicast does nothing" in text for text in description.warnings)


def test_a_parameter_of_an_smvector_is_named_as_at_its_keypad() -> None:
    text = roster_text([("fan", 11, "smvector")], drive="also_writable: [C1502]")
    said = [one for one in warned(text) if "writable here" in one]
    assert said == ["fan: P502 (drive ID) is writable here, read only in its manual"]
    text = roster_text([("fan", 11, "smvector")], drive="cyclic: [{code: C1527, every: 1s}]")
    assert any("add {code: C0150, every: 1s}" in one for one in warned(text))


def test_writes_go_as_one_telegram_where_the_roster_says_that_it_knows_every_drive() -> None:
    text = "groups: {all: {multicast: yes}, both: {members: [belt, feeder], multicast: yes}}"
    description = describe(parsed(roster_with(text)))
    assert [(one.how, one.writes) for one in description.groups] == [("multicast", "multicast")] * 2
    assert description.groups[0].members == ("feeder", "belt")
    one_telegram = "one multicast to 10 (reaches every drive at 11 to 19)"
    rows = pipe_rows(description, group_reach)
    assert ("group", "both", one_telegram, one_telegram, "belt, feeder") in rows
    assert not [text for text in description.warnings if "multicast" in text]


def test_drives_are_told_with_what_was_filled_in() -> None:
    text = drive_with("watchdog: {time: 2s, action: inhibit}", "cyclic: [{code: 46, every: 1s}]")
    (drive,) = describe(parsed(text)).drives
    assert (drive.name, drive.address, drive.family) == ("feeder", 11, "8200vector")
    assert (drive.watchdog, drive.cyclic) == ("2s inhibit, compared only", "C0046 1s")
    assert drive.writable == "C0040, C0043, C0046, C0135, C1922, C1923"


def test_a_description_is_json() -> None:
    found = json.loads(json.dumps(describe(parsed(GOOD)).as_json()))
    assert [drive["name"] for drive in found["drives"]] == ["feeder", "belt"]
    assert found["groups"][0]["how"] == "multicast"


def test_the_small_example_gives_no_cause_for_wonder() -> None:
    assert describe(load_roster(CONFIG / "small.yaml")).warnings == ()


SAFE = "watchdog: {time: 2s, action: inhibit, configure: true}"


def added(text: str) -> str:
    """What a roster has that the good one has not."""
    rows = [row.strip() for row in text.splitlines() if row not in GOOD.splitlines()]
    return " ".join(rows) or "nothing"


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("/dev/serial/by-id/usb-1", "/dev/ttyUSB0"),
        line_with("direction: rts"),
        line_with("direction: kernel", "medium: fibre"),
        line_with("medium: fibre", "echo: no"),
        line_with("parity: port"),
        line_with("late_answer: 200ms"),
        line_with("stall: 0"),
        GOOD,
        drive_with("watchdog: {time: 2s, action: none, configure: true}"),
        drive_with("watchdog: {time: 2s, action: inhibit}"),
        drive_with("watchdog: {time: 450ms, action: inhibit, configure: true}"),
        drive_with("cyclic: [{code: C0150, every: 10ms}]"),
        drive_with("writable: [C0150]"),
        drive_with("writable: [C0125]", "allow_address_change: true"),
        drive_with("lease: {required: true, on_lapse: hold}"),
        drive_with("lease: {required: true}"),
    ],
    ids=added,
)
def test_what_is_valid_but_suspicious_is_said(text: str, golden: Golden) -> None:
    golden(*warned(text))


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ("lease: {on_lapse: hold}", "feeder: on_lapse hold lets the drive run on"),
        (
            "lease: {on_lapse: silence}, watchdog: {time: 2s, action: inhibit, configure: true}, "
            "stop_fallback: none",
            "feeder: on_lapse silence ends in inhibit by its watchdog",
        ),
        (
            "lease: {on_lapse: inhibit}, stop_fallback: none",
            "feeder: on_lapse inhibit lets the motor coast",
        ),
    ],
)
def test_a_lapse_that_does_not_stop_or_lets_a_load_go_is_said_though_no_lease_is_required(
    keys: str, what: str
) -> None:
    found = warned(roster_text([("feeder", 11, "8200vector")], drive=keys))
    assert [text for text in found if text.startswith(what)], found


@pytest.mark.parametrize(
    ("family", "writable", "verbs"),
    [
        ("8200vector", "[C0012]", "enable (C0040, C0135); reset-fault (C0043); set-speed (C0046)"),
        ("8200vector", "[C0040, C0135, C0046]", "reset-fault (C0043)"),
        ("820x", "[C0040]", "enable (C0135); reset-fault (C0135); set-speed (C0046 or C0141)"),
        ("821x", "[C0040, C0043, C0135, C0141]", ""),
        ("93xx", "[C0040, C0043, C0135]", "set-speed (C0141)"),
        ("smvector", "[C0040, C0043, C0135]", "set-speed (C1061)"),
        ("generic", "[C0012]", ""),
    ],
)
def test_a_list_that_takes_verbs_away_is_told_with_the_codes_they_need(
    family: str, writable: str, verbs: str, golden: Golden
) -> None:
    told = [
        text for text in warned(drive_with(SAFE if family != "generic" else "cyclic: []",
                                           f"writable: {writable}", family=family))
        if "leaves out" in text
    ]  # fmt: skip
    assert all(verbs in text for text in told)
    assert bool(told) is bool(verbs)
    if told:
        golden(*told)
    assert not any("leaves out" in text for text in warned(drive_with(family=family)))


@pytest.mark.parametrize(("family", "told"), [("8200vector", True), ("generic", False)])
def test_an_empty_list_is_told_to_refuse_verbs(family: str, told: bool, golden: Golden) -> None:
    safe = SAFE if family != "generic" else "cyclic: []"
    found = [
        text for text in warned(drive_with(safe, "writable: []", family=family))
        if "no code may be written" in text
    ]  # fmt: skip
    assert bool(found) is told
    if told:
        golden(*found)


@pytest.mark.parametrize("family", ["8200vector", "smvector", "93xx"])
def test_a_watched_drive_on_a_plain_line_is_fine(family: str) -> None:
    assert warned(drive_with(SAFE, family=family)) == []


@pytest.mark.parametrize(
    ("text", "latency_s"),
    [
        (GOOD, 0.016), (GOOD.replace("/dev/serial/by-id/usb-1", "socket://h:1"), 0.05),
        (GOOD.replace("/dev/serial/by-id/usb-1", "sim"), 0.005),
        (line_with("adapter_latency: 1ms"), 0.001),
    ],
)  # fmt: skip
def test_the_latency_follows_from_the_port_unless_written(text: str, latency_s: float) -> None:
    timing = line_timing(parsed(text).line)
    assert timing.adapter_latency_s == latency_s
    assert (timing.baud, timing.turnaround_s) == (9600, 0.002)
    assert timing.quarantine_s == pytest.approx(0.03 + 2 * latency_s)


def test_the_quarantine_is_no_longer_than_an_answer_can_be_late() -> None:
    assert line_timing(parsed(line_with("late_answer: 10ms")).line).quarantine_s == 0.01


@pytest.mark.parametrize(
    ("family", "cyclic", "left_out"),
    [
        ("8200vector", "[{code: C0050, every: 1s}]", "C0150 and C0068"),
        ("93xx", "[{code: C0051, every: 1s}]", "C0150 and C0068"),
        ("8200vector", "[{code: C0050, every: 1s}, {code: C0068, every: 5s}]", ""),
        ("8200vector", "[{code: C0150, every: 1s}]", ""),
        ("8200vector", "[]", ""),
        ("generic", "[{code: C0050, every: 1s}]", ""),
    ],
)
def test_cyclic_reads_that_show_no_trip_are_told(family: str, cyclic: str, left_out: str) -> None:
    drive = f"  - {{name: d1, address: 1, family: {family}, cyclic: {cyclic}}}\n"
    told = [
        one for one in warned(GOOD.partition("drives:")[0] + "drives:\n" + drive)
        if "a trip is not noticed" in one
    ]  # fmt: skip
    assert len(told) == bool(left_out)
    assert all(one.startswith(f"d1: `cyclic` leaves out {left_out},") for one in told)


def watched(times: list[str], family: str = "8200vector", more: str = "configure: true") -> str:
    """Return a roster of drives d1, d2 .. with these watchdog times, watched only by the line."""
    drives = [
        f"  - {{name: d{number}, address: {number + (number - 1) // 9}, family: {family}, "
        f"cyclic: [], watchdog: {{time: {time}, action: quick-stop, {more}}}}}\n"
        for number, time in enumerate(times, 1)
    ]
    return GOOD.partition("drives:")[0] + "drives:\n" + "".join(drives)


def test_watchdogs_that_can_be_neither_read_nor_set_beside_the_feeding_are_told() -> None:
    (told,) = warned(watched(["1s"] * 8))
    assert told.startswith(
        "the watchdogs of 8 drives (d1, d2, d3, d4, d5, d6, d7, d8) can be neither checked nor set "
        "while the others are fed: reading C1922 may hold the line for 0.73 s and 0.46 s is left; "
    )
    assert "a watchdog time of at least 1.4 s, a higher baud rate or fewer drives" in told
    assert warned(watched(["1.4s"] * 8)) == []
    assert warned(watched(["1.1s"] * 4)) == []


def test_a_higher_baud_rate_makes_room_for_slow_codes() -> None:
    def told(text: str) -> list[str]:
        return [one for one in warned(text) if "neither checked nor set" in one]

    slow = watched(["2.2s"] * 31)
    assert "of at least 2.6 s" in told(slow)[0]
    assert told(watched(["2.6s"] * 31)) == []
    assert told(slow.replace("drives:", "  baud: 19200\ndrives:", 1)) == []


def test_only_drives_whose_codes_are_slow_can_be_without_room() -> None:
    assert warned(watched(["1s"] * 8, family="smvector")) == []
    mixed = watched(["1s"] * 8).replace("8200vector", "smvector", 7)
    (told,) = warned(mixed)
    assert told.startswith("the watchdog of 1 drive (d8) can be neither checked nor set")


def test_a_long_watchdog_beside_a_short_one_takes_nothing_from_its_room() -> None:
    assert warned(watched(["1s", *["30s"] * 10])) == []
    (told,) = warned(watched(["540ms"]))
    assert "while it is fed" in told


def test_what_is_true_of_many_drives_is_said_once(golden: Golden) -> None:
    told = warned(watched(["3s", "3s", "2.5s"], more="configure: false"))
    assert len(told) == 1
    golden(*told)
