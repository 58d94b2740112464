"""What the store promises: values are never silently old, and memory is bounded."""

from __future__ import annotations

from decimal import Decimal

import pytest

from lecombus.drive_state.motion import Doing
from lecombus.drive_state.readings import rfc3339
from lecombus.drive_state.store import (
    ON_DEMAND_LIMIT,
    DriveChanged,
    DriveState,
    Event,
    LineChanged,
    LineState,
    Quality,
    Store,
    ValueChanged,
)
from lecombus.drives import Family, OperatingState, family
from lecombus.errors import OperationError
from lecombus.parameters import Code, Value
from support.golden import Golden

FREQUENCY = Code(46)
STATUS = Code(150)
NOON_S = 1_795_255_200.0
"""2026-11-21T10:00:00Z"""


class Clocks:
    """A monotonic clock and a time of day that move only when told."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.wall_s = NOON_S

    def tick(self, seconds: float) -> None:
        """Let time pass on both."""
        self.now_s += seconds
        self.wall_s += seconds


@pytest.fixture
def clocks() -> Clocks:
    """Return clocks that stand still."""
    return Clocks()


@pytest.fixture
def vector() -> Family:
    """Return the family used throughout."""
    return family("8200vector")


@pytest.fixture
def store(clocks: Clocks, vector: Family) -> Store:
    """Return a store of one online drive on an open line."""
    made = Store(lambda: clocks.now_s, lambda: clocks.wall_s)
    made.add_drive("feeder", 11, vector)
    made.line_state(LineState.OPEN)
    made.drive_state("feeder", DriveState.ONLINE)
    return made


def quality(store: Store, code: Code = FREQUENCY) -> tuple[Quality, str | None]:
    """Return quality and reason of one code."""
    reading = store.reading("feeder", code)
    assert reading is not None
    return reading.quality, reading.reason


def test_a_value_just_read_is_good_and_carries_its_time(store: Store, clocks: Clocks) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    clocks.tick(0.4)
    reading = store.reading("feeder", FREQUENCY)
    assert reading is not None
    assert reading.quality is Quality.GOOD
    assert reading.age_s == pytest.approx(0.4)
    assert reading.time_s == pytest.approx(NOON_S)


def test_a_reading_has_the_shape_every_face_shows(store: Store, clocks: Clocks) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    clocks.tick(0.4)
    reading = store.reading("feeder", FREQUENCY)
    assert reading is not None
    shown = reading.as_json()
    assert list(shown) == [
        *("drive", "code", "subcode", "name", "value", "raw", "format", "unit"),
        *("quality", "reason", "time", "age_s", "text"),
    ]
    assert shown["drive"] == "feeder"
    assert (shown["code"], shown["subcode"]) == ("C0046", 0)
    assert (shown["value"], shown["raw"], shown["format"]) == (Decimal("35.4"), "35.4", "VD")
    assert (shown["quality"], shown["reason"]) == ("good", None)
    assert (shown["time"], shown["age_s"]) == ("2026-11-21T10:00:00.000Z", Decimal("0.400"))


@pytest.mark.parametrize(
    ("wire", "value"),
    [
        ("H0900", 0x900),
        ("S33S2102I_10000", "33S2102I_10000"),
        ("O0AFF", "0aff"),
        ("50.10", Decimal("50.10")),
    ],
)
def test_each_format_becomes_the_value_a_reader_expects(
    store: Store, clocks: Clocks, wire: str, value: object
) -> None:
    store.value_read("feeder", STATUS, Value.parse(wire), clocks.now_s)
    reading = store.reading("feeder", STATUS)
    assert reading is not None
    shown = reading.as_json()
    assert shown["value"] == value
    assert str(shown["value"]) == str(value)
    assert shown["raw"] == wire


def test_a_cyclic_code_never_read_is_bad(store: Store) -> None:
    store.expect("feeder", FREQUENCY, 0.5)
    assert quality(store) == (Quality.BAD, "not read yet")
    reading = store.reading("feeder", FREQUENCY)
    assert reading is not None
    assert (reading.as_json()["time"], reading.as_json()["age_s"]) == (None, None)


def test_a_code_nobody_asked_for_is_unknown_and_asking_keeps_nothing(store: Store) -> None:
    assert store.reading("feeder", Code(999)) is None
    assert store.unread("feeder", Code(999)).reason == "not read yet"
    assert store.reading("feeder", Code(999)) is None


def test_a_cyclic_value_goes_stale_after_two_periods_and_a_second(
    store: Store, clocks: Clocks, golden: Golden
) -> None:
    store.expect("feeder", FREQUENCY, 0.5)
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    clocks.tick(1.99)
    assert quality(store)[0] is Quality.GOOD
    clocks.tick(0.02)
    shown, reason = quality(store)
    assert shown is Quality.STALE
    golden(reason)


def test_a_planned_stretch_allows_cyclic_values_more_age(store: Store, clocks: Clocks) -> None:
    store.expect("feeder", FREQUENCY, 0.5)
    store.plan_stretch(4.0)
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    clocks.tick(4.9)
    assert quality(store)[0] is Quality.GOOD
    clocks.tick(0.2)
    assert quality(store)[0] is Quality.STALE


def test_a_line_that_reads_nothing_any_more_makes_no_value_fresh(
    store: Store, clocks: Clocks, golden: Golden
) -> None:
    store.expect("feeder", FREQUENCY, 0.5)
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    store.set_stretch(1000.0)
    clocks.tick(2.1)
    assert quality(store)[0] is Quality.STALE, "what happened of late does not count"
    store.plan_stretch(1000.0)
    assert quality(store)[0] is Quality.GOOD
    clocks.tick(3.0)
    shown, reason = quality(store)
    assert shown is Quality.STALE
    golden(reason)


def test_a_value_read_once_goes_stale_after_ten_seconds(
    store: Store, clocks: Clocks, golden: Golden
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    clocks.tick(9.9)
    assert quality(store)[0] is Quality.GOOD
    clocks.tick(0.2)
    shown, reason = quality(store)
    assert shown is Quality.STALE
    golden(reason)


def test_a_failed_attempt_makes_the_value_bad_until_the_next_good_one(
    store: Store, clocks: Clocks
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    store.value_failed("feeder", FREQUENCY, "no answer within 120 ms")
    assert quality(store) == (Quality.BAD, "no answer within 120 ms")
    reading = store.reading("feeder", FREQUENCY)
    assert reading is not None
    assert reading.as_json()["raw"] == "35.4"
    store.value_read("feeder", FREQUENCY, Value.parse("35.5"), clocks.now_s)
    assert quality(store) == (Quality.GOOD, None)


def test_an_offline_drive_has_no_good_values(store: Store, clocks: Clocks, golden: Golden) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    store.drive_state("feeder", DriveState.OFFLINE, "no answer to 5 telegrams")
    shown, reason = quality(store)
    assert shown is Quality.STALE
    golden(reason)


@pytest.mark.parametrize("state", [LineState.LOST, LineState.CLOSED])
def test_a_line_that_is_not_open_shows_no_fresh_value(
    store: Store, clocks: Clocks, state: LineState
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    store.line_state(state, "unplugged")
    assert quality(store) == (Quality.BAD, f"line {state}: unplugged")


@pytest.mark.parametrize("state", [LineState.LOST, LineState.CLOSED])
def test_no_drive_looks_well_while_the_line_is_not_open(
    store: Store, clocks: Clocks, state: LineState
) -> None:
    clocks.tick(5)
    store.line_state(state, "unplugged")
    (info,) = store.drives()
    assert info == store.drive("feeder")
    assert (info.state, info.reason) == (DriveState.OFFLINE, f"line {state}: unplugged")
    assert info.since_s == NOON_S + 5
    store.line_state(LineState.OPEN)
    assert store.drive("feeder").state is DriveState.ONLINE


def test_codes_asked_for_once_are_bounded_and_cyclic_ones_stay(
    store: Store, clocks: Clocks
) -> None:
    store.expect("feeder", FREQUENCY, 0.5)
    for number in range(1000, 1000 + ON_DEMAND_LIMIT + 5):
        store.value_read("feeder", Code(number), Value.parse("1"), clocks.now_s)
    assert len(store.readings("feeder")) == ON_DEMAND_LIMIT + 1
    assert store.readings("feeder")[0].code == FREQUENCY
    assert store.reading("feeder", Code(1004)) is None
    assert store.reading("feeder", Code(1005)) is not None


def test_cyclic_readings_leave_out_what_was_asked_for_once(store: Store, clocks: Clocks) -> None:
    store.value_read("feeder", STATUS, Value.parse("H0001"), clocks.now_s)
    store.expect("feeder", FREQUENCY, 0.5)
    only = [reading.code for reading in store.readings("feeder", cyclic_only=True)]
    assert only == [FREQUENCY]
    store.expect("feeder", FREQUENCY, None)
    assert store.readings("feeder", cyclic_only=True) == []
    assert len(store.readings("feeder")) == 2


def test_codes_are_listed_like_readings(store: Store, clocks: Clocks) -> None:
    store.value_read("feeder", STATUS, Value.parse("H0001"), clocks.now_s)
    store.expect("feeder", FREQUENCY, 0.5)
    assert store.codes("feeder") == (FREQUENCY, STATUS)
    assert [one.code for one in store.readings("feeder")] == [FREQUENCY, STATUS]


def test_an_unknown_drive_is_refused_with_the_nearest_name(store: Store) -> None:
    with pytest.raises(OperationError) as caught:
        store.reading("feedr", FREQUENCY)
    assert caught.value.kind == "no-such-drive"
    assert caught.value.remedy == "did you mean feeder?"


def test_since_moves_with_the_state_and_not_with_the_reason(store: Store, clocks: Clocks) -> None:
    clocks.tick(5)
    store.drive_state("feeder", DriveState.DEGRADED, "1 lost answer")
    since_s = store.drive("feeder").since_s
    clocks.tick(5)
    store.drive_state("feeder", DriveState.DEGRADED, "2 lost answers")
    info = store.drive("feeder")
    assert (info.since_s, info.reason) == (since_s, "2 lost answers")


def test_a_reloaded_roster_keeps_values_of_the_same_device_only(
    store: Store, clocks: Clocks, vector: Family
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("35.4"), clocks.now_s)
    store.add_drive("feeder", 11, vector)
    assert store.reading("feeder", FREQUENCY) is not None
    store.add_drive("feeder", 12, vector)
    assert store.reading("feeder", FREQUENCY) is None


def test_a_removed_drive_is_gone(store: Store) -> None:
    store.remove_drive("feeder")
    store.remove_drive("feeder")
    assert store.drives() == []


def test_remarks_stand_until_they_are_cleared(store: Store) -> None:
    store.note("feeder", "watchdog", "C1923 is 3000 ms, roster says 2000 ms")
    store.note_line("cadence", "stretched 2 times")
    assert store.drive("feeder").as_json()["remarks"] == {
        "watchdog": "C1923 is 3000 ms, roster says 2000 ms"
    }
    assert store.line().as_json()["remarks"] == {"cadence": "stretched 2 times"}
    store.note("feeder", "watchdog", None)
    assert store.drive("feeder").remarks == {}


def test_subscribers_hear_of_changes_and_only_of_changes(store: Store, clocks: Clocks) -> None:
    heard: list[Event] = []
    store.subscribe(heard.append)
    store.value_read("feeder", FREQUENCY, Value.parse("1"), clocks.now_s)
    store.value_failed("feeder", FREQUENCY, "no answer")
    store.drive_state("feeder", DriveState.ONLINE)
    store.drive_state("feeder", DriveState.DEGRADED, "noise")
    store.line_state(LineState.OPEN)
    store.line_state(LineState.LOST, "unplugged")
    store.note("feeder", "x", None)
    value = ValueChanged("feeder", FREQUENCY)
    assert heard == [value, value, DriveChanged("feeder"), LineChanged()]
    store.unsubscribe(heard.append)


def test_an_unsubscribed_listener_hears_nothing(store: Store, clocks: Clocks) -> None:
    heard: list[Event] = []
    store.subscribe(heard.append)
    store.unsubscribe(heard.append)
    store.value_read("feeder", FREQUENCY, Value.parse("1"), clocks.now_s)
    assert heard == []


def test_a_clock_that_is_put_right_moves_the_time_but_not_the_age(
    store: Store, clocks: Clocks
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("1"), clocks.now_s)
    clocks.wall_s += 3600
    reading = store.reading("feeder", FREQUENCY)
    assert reading is not None
    assert reading.time_s == pytest.approx(NOON_S + 3600)
    assert reading.age_s == 0.0


def test_the_time_of_a_value_does_not_flicker_with_clock_jitter(
    store: Store, clocks: Clocks
) -> None:
    store.value_read("feeder", FREQUENCY, Value.parse("1"), clocks.now_s)
    times = set()
    for jitter_s in (0.0, 0.004, -0.004):
        clocks.wall_s += jitter_s
        reading = store.reading("feeder", FREQUENCY)
        assert reading is not None
        times.add(reading.as_json()["time"])
    assert times == {"2026-11-21T10:00:00.000Z"}


@pytest.mark.parametrize(
    ("time_s", "text"),
    [
        (0.0, "1970-01-01T00:00:00.000Z"),
        (0.9996, "1970-01-01T00:00:01.000Z"),
        (NOON_S + 902.113, "2026-11-21T10:15:02.113Z"),
    ],
)
def test_times_are_written_with_milliseconds_in_utc(time_s: float, text: str) -> None:
    assert rfc3339(time_s) == text


@pytest.mark.parametrize(
    ("code", "value"), [(Code(135), Value.hexadecimal(0, 4)), (Code(40), Value.decimal("1"))]
)
def test_status_words_read_before_a_command_do_not_tell_what_the_drive_does_after_it(
    clocks: Clocks, code: Code, value: Value
) -> None:
    store = Store(lambda: clocks.now_s, lambda: clocks.wall_s)
    store.line_state(LineState.OPEN)
    store.add_drive("hoist", 3, family("821x"))
    store.drive_state("hoist", DriveState.ONLINE)
    for status, every_s, word in ((STATUS, 1.0, 0x8680), (Code(68), 10.0, 0x1040)):
        store.expect("hoist", status, every_s)
        store.value_read("hoist", status, Value.hexadecimal(word, 4), clocks.now_s)
    store.value_read("hoist", Code(50), Value.decimal("0"), clocks.now_s)
    assert store.motion("hoist").doing is Doing.STOPPED
    clocks.tick(0.2)

    store.value_written("hoist", Code(12), clocks.now_s)  # no command: nothing is doubtful
    assert store.motion("hoist").doing is Doing.STOPPED
    store.value_written("hoist", code, clocks.now_s)
    assert store.motion("hoist").doing is Doing.UNKNOWN
    assert store.drive("hoist").states is None
    reading = store.reading("hoist", STATUS)
    assert reading is not None
    assert reading.quality is Quality.GOOD  # the word itself was read in time

    clocks.tick(0.2)
    store.value_read("hoist", code, value, clocks.now_s)
    store.value_read("hoist", STATUS, Value.hexadecimal(0x8600, 4), clocks.now_s)
    seen, states = store.motion("hoist"), store.drive("hoist").states
    assert (seen.doing, seen.stops, seen.age_s) == (Doing.RUNNING, (), 0.0)
    assert states is not None
    assert OperatingState.ENABLED in states
    assert OperatingState.QUICK_STOP not in states


def test_a_command_of_a_quick_stop_outlives_a_write_of_another_command(clocks: Clocks) -> None:
    store = Store(lambda: clocks.now_s, lambda: clocks.wall_s)
    store.line_state(LineState.OPEN)
    store.add_drive("hoist", 3, family("8200vector"))
    store.drive_state("hoist", DriveState.ONLINE)
    store.value_read("hoist", Code(135), Value.hexadecimal(0x0008, 4), clocks.now_s)
    clocks.tick(0.2)
    store.value_written("hoist", Code(40), clocks.now_s)
    clocks.tick(0.2)
    store.value_read("hoist", STATUS, Value.hexadecimal(0x0640, 4), clocks.now_s)
    assert [one.name for one in store.motion("hoist").stops] == ["quick-stop"]
