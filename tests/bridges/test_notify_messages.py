"""What stands in a message, how many there are, and that nothing piles up behind a slow channel."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import anyio
import pytest

from bridges.test_notify_conditions import Seen
from lecombus.bridges.notify.bridge import Sender
from lecombus.bridges.notify.channels import NotSentError, short, variables
from lecombus.bridges.notify.conditions import Happening
from lecombus.bridges.notify.messages import (
    MOST_ENTRIES,
    Limiter,
    Notification,
    Pending,
    message_of,
    trial_message,
)
from lecombus.roster import MessageLimit, NotifyEntry
from support.virtual_loop import run

MADE_S = 1_795_000_000.0
OH = {"kind": "trip", "keypad": "OH", "number": 50, "meaning": "heat sink too hot",
      "cause": "the fan stands", "remedy": "clean it"}  # fmt: skip


def trip(drive: str = "feeder", at_s: float = MADE_S, *, active: bool = True) -> Happening:
    text = "trip OH (50): heat sink too hot" if active else "the fault is gone"
    return Happening("trip", drive, active, text, at_s, OH if active else None)


def message(*happenings: Happening, ends: bool = True) -> Notification:
    pending = Pending(ends=ends)
    for one in happenings:
        pending.add(one)
    entries, dropped = pending.take()
    return message_of("hall-3", entries, dropped, MADE_S)


# ---- what a message says ------------------------------------------------------------------------


def test_one_event_is_the_subject_and_the_text_has_cause_and_remedy() -> None:
    found = message(trip())
    assert found.subject == "hall-3: feeder: trip OH (50): heat sink too hot"
    for text in ("feeder: trip OH (50)", "cause: the fan stands", "remedy: clean it", "What to do"):
        assert text in found.text


def test_many_events_are_counted_the_worst_first() -> None:
    lost = Happening("drive-lost", "belt", True, "it does not answer", MADE_S)
    line = Happening("line-lost", "", True, "the port is not open", MADE_S)
    found = message(lost, *(trip(f"d{number}") for number in range(30)), line)
    assert found.subject == "hall-3: 1 line lost; 30 drives tripped; 1 drive lost"
    assert [one.event for one in found.entries][::31] == ["line-lost", "drive-lost"]


def test_what_came_and_went_is_one_line_with_its_count() -> None:
    happenings = [trip(at_s=MADE_S + at, active=at % 2 == 0) for at in range(6)]
    found = message(*happenings)
    (entry,) = found.entries
    assert (entry.begun, entry.active, entry.fault) == (3, False, OH)
    assert found.subject == "hall-3: feeder: drive tripped, over"
    assert "trip OH (50): heat sink too hot (3 times); over at" in found.text
    assert "What to do" not in found.text


def test_an_end_alone_is_said_unless_the_roster_says_otherwise() -> None:
    assert message(trip(active=False)).subject == "hall-3: feeder: drive tripped, over"
    assert message(trip(active=False), ends=False).entries == ()
    assert len(message(trip(), trip(active=False), ends=False).entries) == 1


def test_an_update_of_what_waits_is_in_its_message_and_one_of_what_was_sent_is_none() -> None:
    unknown = Happening("trip", "feeder", True, "trip of a number not known", MADE_S)
    known = Happening("trip", "feeder", True, "trip OH (50)", MADE_S + 1, OH, is_update=True)
    (entry,) = message(unknown, known).entries
    assert (entry.text, entry.begun, entry.fault) == ("trip OH (50)", 1, OH)
    assert message(known).entries == ()


def test_no_text_of_a_drive_can_add_a_line_or_a_header() -> None:
    nasty = Happening("trip", "feeder", True, "trip\r\nBcc: x@y.example\x1b[31m", MADE_S)
    found = message(nasty)
    assert "\n" not in found.subject
    assert "\r" not in found.text
    assert "\x1b" not in found.text
    assert not any(row.startswith("Bcc") for row in found.text.splitlines())


def test_the_json_of_a_message_is_what_the_manual_says() -> None:
    document = json.loads(json.dumps(message(trip()).as_json()))
    (event,) = document.pop("events")
    assert event == {
        "event": "trip", "drive": "feeder", "active": True, "count": 1,
        "text": "trip OH (50): heat sink too hot", "since": "2026-11-18T11:06:40.000Z",
        "time": "2026-11-18T11:06:40.000Z", "fault": OH,
    }  # fmt: skip
    assert document.pop("text").startswith("Line hall-3, ")
    assert document == {
        "version": 1, "line": "hall-3", "test": False, "time": "2026-11-18T11:06:40.000Z",
        "subject": "hall-3: feeder: trip OH (50): heat sink too hot", "dropped": 0,
    }  # fmt: skip
    assert trial_message("hall-3", MADE_S).as_json()["test"] is True


def test_variables_stay_short_however_much_happened() -> None:
    found = variables(message(*(trip(f"drive-{number}") for number in range(900))))
    assert found["LECOMBUS_EVENTS"] == "trip"
    assert sum(len(text) for text in found.values()) < 20_000


def test_entries_are_bounded_and_those_left_out_are_counted() -> None:
    found = message(*(trip(f"d{number}") for number in range(MOST_ENTRIES + 5)))
    assert len(found.entries) == MOST_ENTRIES
    assert found.dropped == 5
    assert f".. and {MOST_ENTRIES - 100 + 5} more" in found.text
    assert len(found.text.splitlines()) < 320


def test_a_password_is_not_shown_and_what_is_shown_is_one_short_line() -> None:
    assert short("535 bad\nlogin me:hunter2", "hunter2") == "535 bad login me:***"
    assert len(short("x" * 10_000)) < 400


# ---- how often ----------------------------------------------------------------------------------


def test_the_limiter_gives_a_burst_and_then_one_in_each_time() -> None:
    limiter = Limiter(2, 60.0)
    for _ in range(2):
        assert limiter.wait_s(0.0) == 0.0
        limiter.sent()
    assert limiter.wait_s(0.0) == pytest.approx(60.0)
    assert limiter.wait_s(45.0) == pytest.approx(15.0)
    assert limiter.wait_s(60.0) == 0.0
    limiter.sent()
    assert limiter.wait_s(60.0) == pytest.approx(60.0)
    assert limiter.wait_s(1e6) == 0.0


class Channel:
    """Takes messages, slowly or not at all."""

    name = "command"

    def __init__(self, takes_s: float = 0.0, fails: int = 0) -> None:
        self.takes_s = takes_s
        self.fails = fails
        self.tries: list[float] = []
        self.sent: list[tuple[float, Notification]] = []

    async def send(self, message: Notification) -> None:
        self.tries.append(anyio.current_time())
        await anyio.sleep(self.takes_s)
        if self.fails:
            self.fails -= 1
            raise NotSentError("the server is down")
        self.sent.append((anyio.current_time(), message))


def send(
    script: Callable[[Callable[[Happening], None]], Any], *channels: Channel, **entry: Any
) -> None:
    """Run a script that gives happenings to a sender for each channel, in virtual time."""

    async def work() -> None:
        settings = NotifyEntry(command=("/bin/page",), **entry)
        senders = [Sender(one, settings, "hall-3", anyio.current_time) for one in channels]

        def give(happening: Happening) -> None:
            for sender in senders:
                sender.take(happening)

        async with anyio.create_task_group() as tasks:
            for sender in senders:
                tasks.start_soon(sender.run)
            await script(give)
            tasks.cancel_scope.cancel()

    run(work())


async def thousand_trips(give: Callable[[Happening], None]) -> None:
    for number in range(1000):
        at_s = anyio.current_time()
        give(trip(f"drive-{number % 31}", at_s, active=number // 31 % 2 == 0))
        await anyio.sleep(0.06)


def begun(channel: Channel) -> int:
    return sum(entry.begun for _, message in channel.sent for entry in message.entries)


def test_a_thousand_trips_in_a_minute_are_a_few_messages_with_all_of_them() -> None:
    channel = Channel()

    async def script(give: Callable[[Happening], None]) -> None:
        await thousand_trips(give)
        await anyio.sleep(600)

    send(script, channel)
    assert len(channel.sent) == 6  # five, and after five minutes the rest
    expected = sum(number // 31 % 2 == 0 for number in range(1000))
    assert begun(channel) == expected
    assert all(len(message.entries) <= 31 for _, message in channel.sent)


def test_a_loose_connector_that_trips_two_drives_all_day_is_a_few_messages_an_hour() -> None:
    """From the events of the line to the messages."""
    channel = Channel()

    async def script(give: Callable[[Happening], None]) -> None:
        seen = Seen()
        seen.connect()
        for number in range(3600):
            for drive in ("feeder", "belt"):
                seen.fault(OH if number % 2 == 0 else None, drive)
            while seen.given:
                give(seen.given.pop(0))
            await anyio.sleep(1)
        await anyio.sleep(600)

    send(script, channel)
    assert len(channel.sent) <= 5 + 3600 / 300 + 1
    assert begun(channel) == 3600
    assert {entry.drive for _, message in channel.sent for entry in message.entries} == {
        "feeder", "belt",
    }  # fmt: skip


def test_what_belongs_together_is_one_message_after_the_time_to_gather() -> None:
    channel = Channel()

    async def script(give: Callable[[Happening], None]) -> None:
        start_s = anyio.current_time()
        give(trip("a"))
        await anyio.sleep(2)
        give(trip("b"))
        await anyio.sleep(60)
        give(trip("c"))
        await anyio.sleep(60)
        first, second = channel.sent
        assert first[0] - start_s == pytest.approx(5.0)
        assert [entry.drive for entry in first[1].entries] == ["a", "b"]
        assert [entry.drive for entry in second[1].entries] == ["c"]

    send(script, channel)


def test_a_message_that_fails_is_sent_later_with_what_happened_since() -> None:
    channel = Channel(fails=3)

    async def script(give: Callable[[Happening], None]) -> None:
        give(trip("a"))
        await anyio.sleep(20)
        give(trip("b"))
        await anyio.sleep(3)
        give(trip("a", active=False))
        await anyio.sleep(300)

    send(script, channel)
    pauses_s = [after - before for before, after in zip(channel.tries, channel.tries[1:])]  # noqa: B905
    assert pauses_s == pytest.approx([15.0, 25.0, 45.0])
    ((_, found),) = channel.sent
    assert {entry.drive: (entry.begun, entry.active) for entry in found.entries} == {
        "a": (1, False), "b": (1, True),
    }  # fmt: skip


def test_a_server_that_is_down_for_a_day_costs_no_memory_and_few_tries() -> None:
    channel = Channel(fails=10**6)

    async def script(give: Callable[[Happening], None]) -> None:
        for number in range(2000):
            give(trip(f"drive-{number % 31}", active=number % 2 == 0))
            await anyio.sleep(43.2)
        channel.fails = 0
        await anyio.sleep(600)

    send(script, channel)
    assert len(channel.tries) < 86_400 / 300 + 20
    ((_, found),) = channel.sent
    assert len(found.entries) == 31
    assert begun(channel) == 1000


def test_a_channel_that_hangs_holds_up_no_other() -> None:
    slow, quick = Channel(takes_s=60.0), Channel()

    async def script(give: Callable[[Happening], None]) -> None:
        give(trip("a"))
        await anyio.sleep(10)
        give(trip("b"))
        await anyio.sleep(20)
        assert [len(message.entries) for _, message in quick.sent] == [1, 1]
        assert slow.sent == []
        await anyio.sleep(200)
        assert [len(message.entries) for _, message in slow.sent] == [1, 1]

    send(script, slow, quick)


def test_one_message_at_a_time_where_the_roster_says_so() -> None:
    channel = Channel()

    async def script(give: Callable[[Happening], None]) -> None:
        for _ in range(100):
            give(trip("a"))
            give(trip("a", active=False))
            await anyio.sleep(6)

    send(script, channel, gather_s=0.0, limit=MessageLimit(burst=1, every_s=120.0))
    assert len(channel.sent) == 5
