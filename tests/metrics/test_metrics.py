"""What the metrics page promises: true, bounded, readable by Prometheus, never in the way."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable

import anyio
import pytest
from prometheus_client import Metric
from prometheus_client.openmetrics.parser import (
    text_string_to_metric_families as parse_openmetrics,
)
from prometheus_client.parser import text_string_to_metric_families as parse_text

from lecombus.drive_state.store import DriveState, LineState, Store
from lecombus.drives import family
from lecombus.metrics import (
    TELEGRAM_KINDS,
    TELEGRAM_OUTCOMES,
    LineSnapshot,
    Metrics,
    wants_openmetrics,
)
from lecombus.metrics.exposition import Block
from lecombus.parameters import Code, Value
from lecombus.schedule.request import Outcome, Priority
from support.real_parts import require

FREQUENCY = Code(46)
STATUS = Code(150)


class Hall:
    """A line of drives with its store and metrics, on a clock that stands still."""

    def __init__(self, drives: Iterable[str] = ("feeder",)) -> None:
        self.now_s = 100.0
        self.snapshot = LineSnapshot()
        self.store = Store(lambda: self.now_s, lambda: self.now_s)
        self.metrics = Metrics(
            "hall-3",
            self.store,
            version="1.2.3",
            clock=lambda: self.now_s,
            snapshot=lambda: self.snapshot,
        )
        self.store.line_state(LineState.OPEN)
        for address, name in enumerate(drives, start=1):
            self.store.add_drive(name, address, family("8200vector"))
            self.store.drive_state(name, DriveState.ONLINE)
            self.store.expect(name, FREQUENCY, 1.0)
            self.store.expect(name, STATUS, 1.0)
            self.metrics.counters.add_drive(name)

    def read(self, code: Code, raw: str, drive: str = "feeder") -> None:
        self.store.value_read(drive, code, Value.parse(raw), self.now_s)

    def render(self) -> str:
        self.metrics.ask()
        self.metrics.render_step(60.0)
        return self.metrics.page(openmetrics=False).decode()

    def samples(self, name: str) -> dict[tuple[str, ...], float]:
        """Return the samples of one name by the values of their labels but the line's."""
        found: dict[tuple[str, ...], float] = {}
        for metric in parse_text(self.render()):
            for sample in metric.samples:
                if sample.name == f"lecombus_{name}":
                    labels = dict(sample.labels)
                    assert labels.pop("line") == "hall-3"
                    found[tuple(labels.values())] = sample.value
        return found


def exchange(hall: Hall, kind: str = "read", outcome: str = "answered") -> None:
    hall.metrics.counters.exchange(
        "feeder",
        kind,
        outcome,
        took_s=0.037,
        busy_s=0.137,
        priority=Priority.CYCLIC,
        waited_s=0.012,
    )


def test_a_good_value_is_exported_exactly_with_code_name_and_unit() -> None:
    hall = Hall()
    hall.read(FREQUENCY, "35.4")
    (line,) = [one for one in hall.render().splitlines() if "drive_value{" in one]
    assert line.endswith(" 35.4")
    assert 'drive="feeder",code="C0046",subcode="0"' in line
    assert 'unit="Hz"' in line


def test_a_value_that_is_not_good_is_left_out_and_counted() -> None:
    hall = Hall()
    hall.read(FREQUENCY, "35.4")
    hall.read(STATUS, "H0001")
    assert hall.samples("drive_values_not_good") == {("feeder",): 0}
    hall.now_s += 3.1
    assert hall.samples("drive_value") == {}
    assert hall.samples("drive_status_bit") == {}
    assert hall.samples("drive_values_not_good") == {("feeder",): 2}


def test_values_read_on_demand_make_no_series() -> None:
    hall = Hall()
    hall.read(Code(4711), "1")
    assert hall.samples("drive_value") == {}


def test_strings_are_no_samples() -> None:
    hall = Hall()
    hall.read(FREQUENCY, "S33S2102I")
    assert hall.samples("drive_value") == {}


def test_status_bits_and_fault_follow_the_status_word() -> None:
    hall = Hall()
    vector = family("8200vector")
    hall.read(STATUS, "H0002")
    bits = {bit: on for (_, _, bit), on in hall.samples("drive_status_bit").items()}
    assert bits == vector.status_bits(STATUS, 2)
    assert bits


@pytest.mark.parametrize(
    ("line", "state", "up"),
    [
        (LineState.OPEN, DriveState.ONLINE, 1),
        (LineState.OPEN, DriveState.DEGRADED, 1),
        (LineState.OPEN, DriveState.STARTING, 0),
        (LineState.OPEN, DriveState.OFFLINE, 0),
        (LineState.LOST, DriveState.ONLINE, 0),
    ],
)
def test_a_drive_is_up_while_it_answers(line: LineState, state: DriveState, up: int) -> None:
    hall = Hall()
    hall.store.line_state(line)
    hall.store.drive_state("feeder", state)
    assert hall.samples("drive_up") == {("feeder",): up}


def test_every_telegram_series_begins_at_zero_and_counts() -> None:
    hall = Hall()
    before = hall.samples("telegrams_total")
    assert set(before.values()) == {0}
    assert len(before) == len(TELEGRAM_KINDS) * len(TELEGRAM_OUTCOMES)
    exchange(hall)
    exchange(hall, "write", "refused")
    hall.now_s += 2
    after = hall.samples("telegrams_total")
    assert {key for key, value in after.items() if value} == {
        ("feeder", "read", "answered"),
        ("feeder", "write", "refused"),
    }


def test_an_exchange_is_timed_and_its_quarantine_counts_as_busy() -> None:
    hall = Hall()
    exchange(hall)
    exchange(hall, outcome="echo")
    assert hall.samples("exchange_seconds_count")["read",] == 2
    assert hall.samples("exchange_seconds_bucket")["read", "0.04"] == 2
    assert hall.samples("queue_wait_seconds_bucket")["cyclic", "0.02"] == 2
    assert hall.samples("line_busy_seconds_total") == {(): pytest.approx(0.274)}
    assert hall.samples("echo_mismatches_total") == {(): 1}


def test_requests_are_counted_by_class_and_outcome() -> None:
    hall = Hall()
    hall.metrics.counters.request_ended(Priority.STOP, Outcome.VERIFIED)
    assert hall.samples("requests_total")["stop", "verified"] == 1
    assert len(hall.samples("requests_total")) == len(Priority) * len(Outcome)


def test_schedule_and_watchdogs_are_read_off_when_the_page_is_rendered() -> None:
    hall = Hall()
    hall.snapshot = LineSnapshot(
        {Priority.BACKGROUND: 1000},
        1.5,
        0.25,
        {"feeder": 0.7},
        {"feeder": 3},
        {Priority.BACKGROUND: 7},
        4,
        watchdog_lowest_s={"feeder": 0.6},
        watchdog_time_s={"feeder": 2.0},
    )
    assert hall.samples("queue_depth")["background",] == 1000
    assert hall.samples("queue_depth")["stop",] == 0
    assert hall.samples("cyclic_stretch_ratio") == {(): 1.5}
    assert hall.samples("cyclic_lateness_seconds") == {(): 0.25}
    assert hall.samples("watchdog_margin_seconds") == {("feeder",): 0.7}
    assert hall.samples("watchdog_margin_lowest_seconds") == {("feeder",): 0.6}
    assert hall.samples("watchdog_time_seconds") == {("feeder",): 2.0}
    assert hall.samples("watchdog_misses_total") == {("feeder",): 3}
    assert hall.samples("schedule_refusals_total")["background",] == 7
    assert hall.samples("cyclic_skipped_total") == {(): 4}


def test_groups_count_multicasts_only() -> None:
    hall = Hall()
    hall.metrics.counters.add_group("conveyors")
    hall.metrics.counters.exchange(
        "conveyors",
        "multicast",
        "sent",
        took_s=0.02,
        busy_s=0.02,
        priority=Priority.STOP,
        waited_s=0.0,
    )
    assert hall.samples("telegrams_total")["conveyors", "multicast", "sent"] == 1


def test_a_drive_that_left_the_roster_leaves_the_page() -> None:
    hall = Hall(("feeder", "belt"))
    hall.store.remove_drive("belt")
    hall.metrics.counters.remove("belt")
    assert 'drive="belt"' not in hall.render()


def test_a_drive_added_again_keeps_counting() -> None:
    hall = Hall()
    exchange(hall)
    hall.metrics.counters.add_drive("feeder")
    assert hall.samples("telegrams_total")["feeder", "read", "answered"] == 1


def test_names_with_quotes_do_not_break_the_page() -> None:
    hall = Hall(('a"b\\c\nd',))
    hall.read(FREQUENCY, "1", 'a"b\\c\nd')
    assert {labels[0] for labels in hall.samples("drive_value")} == {'a"b\\c\nd'}


def families(metrics: Iterable[Metric]) -> dict[str, list[tuple[str, float]]]:
    """Return what a parser found, in a form that can be compared."""
    return {
        metric.name: [
            (f"{one.name}{sorted(one.labels.items())}", one.value) for one in metric.samples
        ]
        for metric in metrics
    }


def full_hall() -> Hall:
    hall = Hall([f"drive{number}" for number in range(31)])
    for number in range(31):
        hall.read(FREQUENCY, "35.4", f"drive{number}")
        hall.read(STATUS, "H0900", f"drive{number}")
    hall.snapshot = LineSnapshot(watchdog_margin_s={"drive1": 1.0}, watchdog_misses={"drive1": 0})
    return hall


def test_both_formats_say_the_same_to_prometheus_own_parsers() -> None:
    hall = full_hall()
    text = families(parse_text(hall.render()))
    page = hall.metrics.page(openmetrics=True).decode()
    openmetrics = families(parse_openmetrics(page))  # type: ignore[no-untyped-call]
    assert text == openmetrics
    assert {"lecombus_telegrams", "lecombus_drive_value", "process_cpu_seconds"} <= set(text)


def test_promtool_finds_nothing_to_complain_about() -> None:
    promtool = require("promtool")
    hall = full_hall()
    page = hall.render()
    checked = subprocess.run(
        [promtool, "check", "metrics"], input=page, capture_output=True, text=True, check=False
    )
    ours = [line for line in checked.stderr.splitlines() if not line.startswith("process_")]
    assert (checked.returncode, ours) == (0, [])


def test_an_empty_family_has_no_heading() -> None:
    block = Block("lecombus_x", "gauge", "X.")
    block.close()
    assert block.text(openmetrics=False) == b""


def test_a_page_is_rendered_piece_by_piece() -> None:
    hall = full_hall()
    hall.metrics.ask()
    pieces = 1
    while not hall.metrics.render_step(0.0):
        pieces += 1
    assert pieces > 2 * 31


def test_a_page_is_rendered_at_most_about_once_a_second() -> None:
    hall = Hall()
    first = hall.render()
    hall.read(FREQUENCY, "1")
    assert hall.render() == first
    hall.now_s += 1.0
    assert hall.render() != first


def test_windows_render_only_what_a_scrape_wants() -> None:
    hall = Hall()
    hall.metrics.window(0.02)
    assert hall.metrics.page(openmetrics=False) == b""
    assert not hall.metrics.ask()
    hall.metrics.window(0.02)
    assert hall.metrics.ask()
    assert b"lecombus_drive_up" in hall.metrics.page(openmetrics=False)


@pytest.mark.clock
@pytest.mark.anyio
async def test_a_scrape_on_an_idle_line_renders_the_page_itself() -> None:
    hall = Hall()
    page = await hall.metrics.fresh_page(openmetrics=True)
    assert page.endswith(b"# EOF\n")


@pytest.mark.clock
@pytest.mark.anyio
async def test_a_scrape_takes_the_page_that_a_window_rendered() -> None:
    hall = Hall()
    pages: list[bytes] = []

    async def scrape() -> None:
        pages.append(await hall.metrics.fresh_page(openmetrics=False))

    with anyio.fail_after(10):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(scrape)
            tasks.start_soon(scrape)
            await anyio.wait_all_tasks_blocked()
            hall.metrics.window(1.0)
    assert len(pages) == 2
    assert pages[0] is pages[1]


@pytest.mark.parametrize(
    ("accept", "wanted"),
    [
        ("", False),
        ("*/*", False),
        ("text/plain", False),
        ("application/openmetrics-text", True),
        ("application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.3", True),
        ("application/openmetrics-text;q=0.2,text/plain;q=0.3", False),
        ("application/openmetrics-text;q=0", False),
        ("application/openmetrics-text;q=abc", False),
    ],
)
def test_openmetrics_is_served_to_those_who_like_it(accept: str, wanted: bool) -> None:
    assert wants_openmetrics(accept) is wanted


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def test_slack_is_absent_while_nothing_is_fed() -> None:
    hall = Hall()
    assert hall.samples("schedule_slack_seconds") == {}
    hall.now_s += 2.0
    hall.snapshot = LineSnapshot(slack_s=-0.25, woken_late_s=0.004)
    assert hall.samples("schedule_slack_seconds") == {(): -0.25}
    hall.now_s += 2.0
    assert hall.samples("scheduler_lateness_seconds") == {(): 0.004}


def test_line_time_is_told_by_class() -> None:
    hall = Hall()
    exchange(hall)
    found = hall.samples("line_seconds_total")
    assert len(found) == len(Priority)
    assert sum(found.values()) == pytest.approx(
        sum(hall.samples("line_busy_seconds_total").values())
    )
    assert sum(found.values()) > 0.0
