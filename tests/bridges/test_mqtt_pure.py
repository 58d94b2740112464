"""The pure parts of the MQTT bridge: topics, what stands at the broker and when, what is kept."""

from __future__ import annotations

import json
import re
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal
from math import inf
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue
from lecombus.bridges.mqtt import seen_commands
from lecombus.bridges.mqtt.board import Board
from lecombus.bridges.mqtt.discovery import BOTH_WAYS
from lecombus.bridges.mqtt.event_queue import EventQueue
from lecombus.bridges.mqtt.retained import Message, drive_messages
from lecombus.bridges.mqtt.seen_commands import KEPT, SeenCommands
from lecombus.bridges.mqtt.topics import CommandTopic, Topics
from lecombus.client import Quality, Reading
from lecombus.drives import FAMILY_NAMES, family

TOPICS = Topics("plant/lecombus", "hall-3")
ROOT = "plant/lecombus/hall-3"


@pytest.mark.parametrize(
    ("topic", "found"),
    [
        ("feeder/set/C0046", CommandTopic("feeder", "set", "C0046")),
        ("feeder/set/C0039/1", CommandTopic("feeder", "set", "C0039/1")),
        ("all/do/quick-stop", CommandTopic("all", "do", "quick-stop")),
        ("feeder/do/a/b", None),
        ("feeder/set", None),
        ("feeder/set/a/b/c", None),
        ("feeder/value/C0050", None),
        ("state", None),
    ],
)
def test_a_topic_says_what_a_command_asks_for(topic: str, found: CommandTopic | None) -> None:
    assert TOPICS.command(f"{ROOT}/{topic}") == found
    assert Topics("plant/lecombus", "hall-30").command(f"{ROOT}/{topic}") is None


def test_lines_with_names_that_look_the_same_are_other_clients_and_have_other_devices() -> None:
    """A broker ends the connection of a client when another one has its name."""
    lines = [("lecombus", "hall-3"), ("hall-7/lecombus", "hall-3"), ("hall-8/lecombus", "hall-3"),
             ("lecombus", "hall.3"), ("lecombus", "hall_3"), ("lecombus", "hall")]  # fmt: skip
    made = [Topics(prefix, line) for prefix, line in lines]
    assert len({one.client for one in made}) == len(lines)
    devices = {one.device(drive) for one in made for drive in ("feeder", "3_feeder")}
    assert len(devices) == 2 * len(lines)
    assert all(re.fullmatch(r"[A-Za-z0-9_-]+", one) for one in devices)
    assert (made[0].client, made[0].device("feeder")) == (
        "lecombus-hall-3", "lecombus_hall-3_feeder")  # fmt: skip


@pytest.mark.parametrize(
    ("topic", "may"),
    [
        ("answers/plc", True),
        ("", False),
        ("a/+/b", False),
        ("a/#", False),
        ("$SYS/a", False),
        (f"{ROOT}/feeder/do/enable", False),
        ("plant/lecombus/hall-4/feeder/set/C0046", False),
        ("homeassistant/device/x/config", False),
        ("plant/lecombusx", True),
    ],
)
def test_an_answer_does_not_go_where_it_would_be_a_command(topic: str, may: bool) -> None:
    assert TOPICS.may_answer(topic, "homeassistant") is may


def value(left_s: float, *, number: object = Decimal("35.40"), now_s: float = 100) -> FollowedValue:
    reading = Reading(
        "feeder", "C0050", 0, "output frequency", number, "35.40", "Hz",  # type: ignore[arg-type]
        Quality.GOOD, "", datetime(2026, 11, 23, 10, 0, 0, 5000, tzinfo=UTC), 0.2, "",
    )  # fmt: skip
    return FollowedValue(reading, now_s - 0.2, now_s + left_s)


def drive(**values: FollowedValue) -> FollowedDrive:
    return FollowedDrive("feeder", 11, "8200vector", "online", values=dict(values))


def messages(one: FollowedDrive, now_s: float = 100) -> dict[str, Message]:
    return {
        message.topic.removeprefix(f"{ROOT}/feeder/"): message
        for message in drive_messages(TOPICS, one, now_s)
    }


def test_a_value_stands_until_it_is_stale_and_no_longer() -> None:
    found = messages(drive(C0050=value(4.9)))["value/C0050"]
    assert (found.payload, found.expiry_s) == (b"35.40", 4)
    assert dict(found.properties) == {
        "unit": "Hz", "quality": "good", "time": "2026-11-23T10:00:00.005Z",
    }  # fmt: skip
    assert messages(drive(C0050=value(0.4)))["value/C0050"].expiry_s == 1


@pytest.mark.parametrize(
    "left", [value(0), value(-1), replace(value(9), good_until_s=-inf), value(9, number=None)]
)
def test_what_is_not_good_has_no_plain_value(left: FollowedValue) -> None:
    found = messages(drive(C0050=left))
    assert set(found) == {"state", "json"}
    assert json.loads(found["json"].payload)["values"]["C0050"]["quality"] == (
        "good" if left.is_good(100) else "stale"
    )


def test_the_json_of_a_drive_stands_no_longer_than_its_first_value() -> None:
    found = messages(drive(C0050=value(4.9), C0150=value(2.2)))["json"]
    assert found.expiry_s == 2
    assert b'"value":35.40' in found.payload  # as the daemon wrote it


def sent(board: Board, one: FollowedDrive, now_s: float) -> list[tuple[str, bytes]]:
    found = list(board.due(drive_messages(TOPICS, one, now_s), f"{ROOT}/feeder/", now_s))
    for message in found:
        board.sent(message, now_s)
    return [(message.topic.removeprefix(f"{ROOT}/feeder/"), message.payload) for message in found]


def test_a_value_is_sent_when_it_changes_and_before_it_expires_and_not_else() -> None:
    board, now_s = Board(), 100.0

    def plain() -> list[bytes]:
        return [payload for topic, payload in sent(board, one, now_s) if "value" in topic]

    one = drive(C0050=value(5, now_s=now_s))
    assert plain() == [b"35.40"]
    assert plain() == []
    now_s, one = 102.0, drive(C0050=value(5, now_s=102.0))  # read again, the same
    assert plain() == []
    one = drive(C0050=value(5, now_s=102.0, number=Decimal("35.50")))
    assert plain() == [b"35.50"]
    now_s = 105.5  # good until 107, and not read again
    assert plain() == []
    one = drive(C0050=value(5, now_s=105.0, number=Decimal("35.50")))
    assert plain() == [b"35.50"]
    now_s = 110.5
    assert plain() == [b""]
    assert plain() == []


def test_a_value_that_is_good_for_less_than_what_stands_says_is_sent_again() -> None:
    """As after a reload that has it read more often: the broker would keep it for too long."""
    board = Board()
    sent(board, drive(C0050=value(10)), 100)
    assert "value/C0050" in dict(sent(board, drive(C0050=value(5)), 100))
    assert dict(sent(board, drive(C0050=value(4.5)), 100)) == {}


def test_a_drive_that_is_gone_is_removed_and_no_other() -> None:
    board = Board()
    sent(board, drive(C0050=value(5)), 100)
    other = FollowedDrive("feeder-2", 12, "8200vector", "online")
    for message in drive_messages(TOPICS, other, 100):
        board.sent(message, 100)
    removed = {one.topic for one in board.due([], f"{ROOT}/feeder/", 100)}
    assert removed == {f"{ROOT}/feeder/{name}" for name in ("state", "json", "value/C0050")}


def test_after_a_broker_was_away_what_is_not_so_any_more_is_removed_and_all_else_sent() -> None:
    board = Board()
    sent(board, drive(C0050=value(100), C0135=value(100), C0150=value(5)), 100)
    board.connected(110)  # C0150 has expired by then
    known = drive(C0050=value(100), C0135=replace(value(100), good_until_s=-inf))
    found = sent(board, known, 110)
    assert {topic for topic, payload in found if payload} == {"state", "json", "value/C0050"}
    assert {topic for topic, payload in found if not payload} == {"value/C0135"}
    assert sent(board, known, 110) == []


# -- what is kept --------------------------------------------------------------------------------


def test_a_command_is_known_after_a_restart_but_not_how_it_ended(tmp_path: Path) -> None:
    seen = SeenCommands(tmp_path / "commands")
    seen.note("a")
    seen.ended("a", "20", {"outcome": "done"})
    assert seen.outcome("a") == {"outcome": "done"}
    assert [seen.said_else("a", "20"), seen.said_else("a", "30")] == [False, True]
    again = SeenCommands(tmp_path / "commands")
    assert "a" in again
    assert "b" not in again
    assert again.outcome("a") is None
    assert not again.said_else("a", "30"), "that is not known any more"


def test_commands_for_many_drives_are_kept_at_the_same_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is kept in a thread, and each thread makes the file be written again several times."""
    monkeypatch.setattr(seen_commands, "KEPT", 200)
    seen = SeenCommands(tmp_path / "commands")
    threads = 4
    # the last of each is noted when all others are: else a slow thread's 200 push it out
    others_are_noted = threading.Barrier(threads)

    def note(part: int) -> None:
        for number in range(299):
            seen.note(f"{part}-{number}")
        others_are_noted.wait(60)
        seen.note(f"{part}-299")

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(note, range(threads)))
    again = SeenCommands(tmp_path / "commands")
    assert all(f"{part}-299" in seen for part in range(threads))
    assert all(f"{part}-299" in again for part in range(threads))


def test_a_line_that_was_cut_off_costs_no_other_command(tmp_path: Path) -> None:
    file = tmp_path / "commands"
    SeenCommands(file).note("a")
    file.write_bytes(file.read_bytes() + b"b")
    SeenCommands(file).note("c")
    found = SeenCommands(file)
    assert [key in found for key in "abc"] == [True, False, True]


def test_the_file_of_commands_is_bounded(tmp_path: Path) -> None:
    file = tmp_path / "commands"
    file.write_text("".join(f"k{number} .\n" for number in range(2 * KEPT)))
    seen = SeenCommands(file)
    seen.note("new")
    assert len(file.read_text().splitlines()) == KEPT
    assert "new" in SeenCommands(file)
    assert "k0" not in SeenCommands(file)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sampled_from(["put", "send", "save", "crash", "end"]), max_size=60))
def test_events_come_in_order_and_none_is_lost_that_was_on_the_disk(
    tmp_path_factory: pytest.TempPathFactory, steps: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("events")
    queue, put, got = EventQueue(folder), 0, list[str]()
    safe: set[str] = set()
    waiting: list[str] = []
    on_disk = False
    for step in steps:
        if step == "put":
            queue.put("feeder", f"{put}")
            waiting.append(f"{put}")
            put += 1
        elif step == "send" and (entry := queue.first()) is not None:
            queue.done(entry)
            got.append(entry[1])
            waiting.remove(entry[1])
            on_disk = on_disk and bool(waiting)
        elif step in ("save", "end"):
            queue.save(at_end=step == "end")
            on_disk = bool(waiting)
        if on_disk:
            safe.update(waiting)
        if step in ("crash", "end"):
            queue = EventQueue(folder)
            waiting = [number for number in sorted(map(str, range(put)), key=int)
                       if number in in_copy(folder, tmp_path_factory.mktemp("copy"))]  # fmt: skip
            on_disk = bool(waiting)
    got += drained(queue)
    assert safe <= set(got)
    first_times = list(dict.fromkeys(got))
    assert first_times == sorted(first_times, key=int)
    assert [one for one in folder.iterdir() if one.name != "events.new"] == []


def drained(queue: EventQueue) -> list[str]:
    found = []
    while (entry := queue.first()) is not None:
        queue.done(entry)
        found.append(entry[1])
    return found


def in_copy(folder: Path, copy: Path) -> list[str]:
    """What waits on the disk, looked at in a copy."""
    shutil.copytree(folder, copy, dirs_exist_ok=True)
    return drained(EventQueue(copy))


def test_events_are_bounded_in_memory_and_on_the_disk(tmp_path: Path) -> None:
    queue = EventQueue(tmp_path, events_kept=50, bytes_kept=2000)
    queue.put("", "0")
    queue.save()
    for number in range(1, 1000):
        queue.put("", f"{number:04d}")
        assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 2500
    assert len(queue) == 50
    assert queue.first() == ("", "0950")
    for _ in range(2):  # a crash, then an end in good order
        again = EventQueue(tmp_path, events_kept=50, bytes_kept=2000)
        assert again.first() == ("", "0950")
        assert again.lost == 950
        again.save(at_end=True)
    assert queue.lost == 950


@given(st.lists(st.sampled_from(["put", "put", "send", "save", "crash", "end"]), max_size=150))
def test_no_event_is_lost_without_being_counted(
    tmp_path_factory: pytest.TempPathFactory, steps: list[str]
) -> None:
    """Events that were only in memory at a crash are asked of the daemon again, so not here."""
    folder = tmp_path_factory.mktemp("events")
    queue, put, sent, told = EventQueue(folder, events_kept=5, bytes_kept=200), 0, set[int](), 0
    queue.put("", "0")
    queue.save()
    for step in steps:
        if step == "put":
            put += 1
            queue.put("", f"{put}")
            if not queue.is_on_disk:
                queue.save()
        elif step == "send" and (entry := queue.first()) is not None:
            told += queue.lost
            queue.told_lost(queue.lost)
            sent.add(int(entry[1]))
            queue.done(entry)
        elif step in ("save", "end"):
            queue.save(at_end=step == "end")
        if step in ("crash", "end"):
            queue = EventQueue(folder, events_kept=5, bytes_kept=200)
    told += queue.lost
    sent.update(map(int, drained(queue)))
    assert told >= put + 1 - len(sent)
    if "crash" not in steps:
        assert told == put + 1 - len(sent)


@pytest.mark.parametrize("unit", sorted(BOTH_WAYS))
@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_the_speed_has_a_sign_where_the_setpoint_of_that_unit_has_one(name: str, unit: str) -> None:
    verbs = family(name).verbs
    setpoints = () if verbs is None else verbs.setpoints
    lowest = min((one.low for one in setpoints if one.unit == unit), default=0)
    assert (name in BOTH_WAYS[unit]) == (lowest < 0)
