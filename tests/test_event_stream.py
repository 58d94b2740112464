"""The buffer of events: any reader gets each event once and in order, or a gap."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.event_stream import GAP, KINDS, EventFilter, EventStream
from lecombus.parameters import Json

FRAME = re.compile(r"id: (\w+)-(\d+)\nevent: (\w+)\ndata: (.*)\n\n")
ALL = EventFilter()


def stream(*, events: int = 1000, size: int = 100_000, run: str = "r") -> EventStream:
    made = EventStream(run, events_limit=events, bytes_limit=size)
    made.record(json.dumps)
    return made


def data_of(frames: bytes) -> list[tuple[int, str, Json]]:
    found = FRAME.findall(frames.decode())
    assert "".join(f"id: {r}-{n}\nevent: {k}\ndata: {d}\n\n" for r, n, k, d in found) == (
        frames.decode()
    )
    return [(int(number), kind, json.loads(data)) for _, number, kind, data in found]


def everything(made: EventStream, position: int, wanted: EventFilter = ALL) -> bytes:
    return made.batch(position, wanted, until=made.next, bytes_most=10**9)[0]


def publish(made: EventStream, *numbers: int) -> None:
    for number in numbers:
        made.publish("value", "a", {"n": number})


def test_an_event_has_an_id_a_kind_and_its_data_on_one_line() -> None:
    made = stream()
    made.publish("trip", "feeder", {"text": "two\nlines"})
    assert everything(made, made.first) == (
        b'id: r-2\nevent: trip\ndata: {"text": "two\\nlines"}\n\n'
    )


def test_nothing_is_rendered_while_nobody_reads() -> None:
    made = EventStream("r")
    publish(made, 1, 2, 3)
    assert (made.first, made.next, made.kept_bytes) == (1, 1, 0)


def test_an_event_is_rendered_once_for_all_readers() -> None:
    rendered: list[Json] = []

    def render(data: Json) -> str:
        rendered.append(data)
        return json.dumps(data)

    made = EventStream("r")
    made.record(render)
    made.record(json.dumps)  # a second reader changes nothing
    publish(made, 1)
    assert [everything(made, 2) for _ in range(100)] == [everything(made, 2)] * 100
    assert rendered == [{"n": 1}]


def test_followers_hear_when_recording_begins_and_ends() -> None:
    heard: list[bool] = []
    made = EventStream("r")
    made.follow(heard.append)
    made.record(json.dumps)
    made.record(json.dumps)
    made.forget()
    made.forget()
    assert heard == [True, False]


@pytest.mark.parametrize(
    ("wanted", "numbers"),
    [
        (ALL, [0, 1, 2, 3, 4]),
        (EventFilter(drives=frozenset({"a"})), [0, 2, 3, 4]),
        (EventFilter(kinds=frozenset({"value"})), [0, 1]),
        (EventFilter(drives=frozenset({"a"}), kinds=frozenset({"value", "line"})), [0, 4]),
        (EventFilter(visible=frozenset({"a"})), [0, 2, 4]),
        (EventFilter(visible=frozenset({"a", "b", "c"})), [0, 1, 2, 3, 4]),
        (EventFilter(drives=frozenset({"b"}), visible=frozenset({"a"})), [4]),
        (EventFilter(visible=frozenset()), [4]),
    ],
)
def test_a_filter_takes_events_by_drive_kind_and_what_may_be_seen(
    wanted: EventFilter, numbers: list[int]
) -> None:
    made = stream()
    made.publish("value", "a", {"n": 0})
    made.publish("value", "b", {"n": 1})
    made.publish("state", "a", {"n": 2})
    made.publish("write", "", {"n": 3}, ("a", "c"))
    made.publish("line", "", {"n": 4})
    taken = [data["n"] for _, _, data in data_of(everything(made, made.first, wanted))]  # type: ignore[index,call-overload]
    assert taken == numbers


@pytest.mark.parametrize(
    ("last_id", "missed"),
    [
        ("r-9", 0),
        ("r-8", 0),
        ("r-5", 0),
        ("r-4", 1),
        ("r-2", 3),
        ("r-1", 4),
        ("r-0", None),
        ("r-10", None),
        ("other-9", None),
        ("r-", None),
        ("r--1", None),
        ("9", None),
        ("r-9999999999999999999999999", None),
        ("r-²", None),
        ("\n", None),
    ],
)
def test_who_comes_back_gets_what_came_since_or_a_gap(last_id: str, missed: int | None) -> None:
    made = stream(events=4)
    publish(made, *range(2, 10))  # 2 to 9; 6 to 9 are kept
    position, gap = made.position_after(last_id)
    if missed == 0:
        assert (position, gap) == (int(last_id[2:]) + 1, b"")
    else:
        assert position == made.first == 6
        ((number, kind, data),) = data_of(gap)
        assert (number, kind) == (5, GAP)
        assert isinstance(data, dict)
        assert data["missed"] == missed


def test_what_was_not_recorded_is_a_gap() -> None:
    made = stream()
    publish(made, 1)
    last = f"r-{made.next - 1}"
    made.forget()
    publish(made, 2, 3)
    made.record(json.dumps)
    position, gap = made.position_after(last)
    assert (position, b"recorded only while they are read" in gap) == (made.next, True)
    publish(made, 4)
    assert [number for number, _, _ in data_of(everything(made, position))] == [made.next - 1]
    assert made.position_after(f"r-{made.next - 1}") == (made.next, b"")


def test_a_batch_ends_when_it_is_large_and_goes_on_behind_its_end() -> None:
    made = stream()
    publish(made, *range(50))
    position, taken = made.first, b""
    while position < made.next:
        frames, position = made.batch(position, ALL, until=made.next, bytes_most=100)
        assert 0 < len(frames) < 200
        taken += frames
    assert taken == everything(made, made.first)


def test_a_mark_is_read_on_from_and_is_no_event() -> None:
    made = stream()
    publish(made, 1, 2)
    assert made.mark(made.next) == b": \nid: r-3\n\n"
    assert made.position_after("r-3") == (made.next, b"")


@given(sizes=st.lists(st.integers(0, 400), max_size=120), limit=st.integers(1, 30),
       size=st.integers(50, 3000))  # fmt: skip
def test_memory_is_bounded_by_count_and_by_bytes(sizes: list[int], limit: int, size: int) -> None:
    made = stream(events=limit, size=size)
    for number in sizes:
        made.publish("value", "a", {"text": "x" * number})
        kept = everything(made, made.first)
        assert made.next - made.first <= limit
        assert len(kept) == made.kept_bytes <= size
    assert made.published["value"] == len(sizes)


@dataclass
class Client:
    """One who reads, is away at times, and remembers the last id it had."""

    wanted: EventFilter
    last_id: str = ""
    position: int | None = None
    had: list[int] = field(default_factory=list)
    gaps: list[tuple[int, int]] = field(default_factory=list)

    def take(self, frames: bytes) -> None:
        for number, kind, _ in data_of(frames):
            self.last_id = f"r-{number}"
            if kind == GAP:
                self.gaps.append((len(self.had), number))
            else:
                self.had.append(number)


Acts = list[tuple[object, ...]]
ACTS = st.lists(
    st.one_of(
        st.tuples(st.just("publish"), st.sampled_from(KINDS), st.sampled_from(("", "a", "b"))),
        st.tuples(st.just("come"), st.integers(0, 3)),
        st.tuples(st.just("read"), st.integers(0, 3), st.integers(1, 300)),
        st.tuples(st.just("go"), st.integers(0, 3)),
        st.just(("forget",)),
    ),
    max_size=150,
)


@given(acts=ACTS)
def test_any_reader_gets_each_event_once_and_in_order_or_a_gap(acts: Acts) -> None:
    """Readers that come, read at their own pace, go, and come back with their last id."""
    made = stream(events=8, size=1000)
    clients = [Client(ALL), Client(EventFilter(drives=frozenset({"a"}))),
               Client(EventFilter(kinds=frozenset({"value", "trip"}))), Client(ALL)]  # fmt: skip
    events: dict[int, tuple[str, str]] = {}
    begun: dict[int, int] = {}

    def come(number: int) -> None:
        made.record(json.dumps)
        client = clients[number]
        client.position, gap = made.position_after(client.last_id)
        if not client.last_id:
            begun[number] = client.position
            client.last_id = f"r-{client.position - 1}"
        client.take(gap)

    def read(number: int, size: int) -> None:
        client = clients[number]
        if client.position is None:
            return
        if client.position < made.first:
            client.position = None  # it did not keep up, and is cut
            return
        frames, client.position = made.batch(
            client.position, client.wanted, until=made.next, bytes_most=size
        )
        client.take(frames)
        client.last_id = f"r-{client.position - 1}"  # by the mark of an idle connection

    for act in acts:
        if act[0] == "publish" and made.is_recording:
            events[made.next] = (str(act[1]), str(act[2]))
            made.publish(str(act[1]), str(act[2]), {"n": made.next})
        elif act[0] == "come":
            come(int(str(act[1])))
        elif act[0] == "read":
            read(int(str(act[1])), int(str(act[2])))
        elif act[0] == "go":
            clients[int(str(act[1]))].position = None
        elif act[0] == "forget" and all(client.position is None for client in clients):
            made.forget()
    for number in begun:
        come(number)
        while (clients[number].position or 0) < made.next:
            read(number, 10**6)
    for number, since in begun.items():
        client = clients[number]
        assert client.had == sorted(set(client.had))
        wanted = [
            one for one, (kind, drive) in events.items()
            if one >= since
            and (not client.wanted.kinds or kind in client.wanted.kinds)
            and (not client.wanted.drives or not drive or drive in client.wanted.drives)
        ]  # fmt: skip
        lost = set(wanted) - set(client.had)
        assert set(client.had) <= set(wanted)
        for one in lost:  # each of them stands before a gap, and behind what was had before it
            assert any(
                one <= end and (before == 0 or client.had[before - 1] < one)
                for before, end in client.gaps
            ), one
