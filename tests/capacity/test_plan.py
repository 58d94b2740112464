"""What a plan says: loads, watchdogs, other baud rates, absent drives, and the picture."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from lecombus.capacity.plan import make_plan
from lecombus.capacity.timeline import picture, preview
from lecombus.capacity.watchdog_demand import demand_of
from lecombus.capacity.watchdog_feasibility import AWAY_ATTEMPTS
from lecombus.config import Roster, RosterError, line_timing
from lecombus.schedule.shares import LISTEN_EVERY_S, LISTEN_S
from support.rosters import make_roster

from .rosters import line_of


def test_the_load_is_the_sum_of_what_is_read() -> None:
    plan = make_plan(line_of(2, time="", only="smvector"))
    reads = sum(one.times.usual_s / one.every_s for one in plan.exchanges)
    assert plan.load.cyclic == pytest.approx(reads)
    assert plan.load.feeding == 0.0
    assert plan.load.stretch == 1.0


def test_feeds_count_only_where_reads_do_not_feed() -> None:
    often = make_plan(line_of(3, time="2s"))
    never = make_plan(line_of(3, time="2s", cyclic="cyclic: []"))
    assert often.load.feeding == 0.0
    feed_s = sum(one.times.usual_s for one in never.exchanges if one.what == "feed")
    assert never.load.feeding == pytest.approx(feed_s / 1.8)


def test_a_line_asked_for_too_much_says_by_how_much_cycles_grow() -> None:
    fast = "cyclic: [{code: C0150, every: 100ms}]"
    plan = make_plan(line_of(10, time="", cyclic=fast))
    assert plan.load.total > 3.0
    assert plan.load.stretch == pytest.approx(plan.load.total)
    assert plan.exchanges[0].cycle_s == pytest.approx(0.1 * plan.load.stretch)


def test_every_least_time_holds_and_a_millisecond_less_does_not() -> None:
    """Taken by whoever checks rosters, not only by the formula that found it."""
    for one in make_plan(line_of(6, time="4s")).watchdogs:
        assert one.least_s is not None
        assert one.outlasts_s is not None
        assert one.least_s < one.outlasts_s
        for time_s, lost in ((one.least_s, 1), (one.outlasts_s, AWAY_ATTEMPTS + 1)):
            assert is_held(one.drive, time_s, lost), one
            assert not is_held(one.drive, time_s - 0.001, lost), one


def is_held(drive: str, time_s: float, lost: int) -> bool:
    """Whether the roster with another watchdog time for one drive is held."""
    times = {drive: f"{round(time_s * 1000)}ms"}
    try:
        roster = line_of(6, time="4s", times=times)
    except RosterError:
        return False
    return demand_of(roster).holds(lost=lost)


def test_at_every_baud_rate_held_means_that_such_a_roster_is_taken() -> None:
    for one in make_plan(line_of(6, time="1500ms", baud=19200)).bauds:
        try:
            line_of(6, time="1500ms", baud=one.baud)
        except RosterError:
            assert not one.held
        else:
            assert one.held
        assert one.least_s is not None
        least_ms = round(one.least_s * 1000)
        line_of(6, time=f"{least_ms}ms", baud=one.baud)
        with pytest.raises(RosterError):
            line_of(6, time=f"{least_ms - 1}ms", baud=one.baud)


def test_a_line_without_watchdogs_has_no_least_time_for_them() -> None:
    assert [one.least_s for one in make_plan(line_of(2, time="")).bauds] == [None] * 5


def test_the_verdict_follows_from_the_times() -> None:
    assert make_plan(line_of(2, time="4s")).watchdogs[0].verdict.startswith("held, also")
    assert make_plan(line_of(1, time="330ms")).watchdogs[0].verdict == (
        "held while no drive goes away"
    )


def test_a_faster_line_is_asked_for_less_of_itself() -> None:
    bauds = make_plan(line_of(10)).bauds
    assert [one.baud for one in bauds] == [1200, 2400, 4800, 9600, 19200]
    loads = [one.load.total for one in bauds]
    assert loads == sorted(loads, reverse=True)
    assert not bauds[0].held
    assert bauds[-1].held


def test_an_adapter_as_slow_as_it_may_be_is_reckoned_beside() -> None:
    """Five drives within 1.35 s: not with half a second of adapter in every answer."""

    def with_adapter(latency: str) -> Roster:
        drives = [(f"d{at}", at, "smvector") for at in range(1, 6)]
        watchdog = "{time: 1500ms, action: inhibit}"
        return make_roster(drives, line=f"adapter_latency: {latency}", watchdog=watchdog)

    slow = make_plan(with_adapter("500ms"))
    assert slow.adapter.latency_s == 0.5
    assert not slow.adapter.held
    assert slow.adapter.load.total > 4.0
    assert slow.adapter.least_s is not None
    quick = make_plan(with_adapter("1ms"))
    assert quick.adapter.held
    assert quick.adapter.load.total == pytest.approx(
        quick.load.total + 0.001 * sum(1 / one.every_s for one in quick.exchanges
                                       if one.what != "feed"), rel=1e-3)  # fmt: skip


def test_the_schedule_takes_what_must_be_and_some_more() -> None:
    for time, cyclic in (("2s", ""), ("2s", "cyclic: []"), ("4s", FIVE), ("10s", FIVE)):
        roster = line_of(12, time=time, cyclic=cyclic)
        load, shown = make_plan(roster).load, preview(roster, line_timing(roster.line))
        assert shown.cyclic == pytest.approx(load.cyclic, abs=0.05)
        assert load.feeding - 0.02 <= shown.feeding < 2.0 * load.feeding + 0.15


FIVE = "cyclic: [{code: C0150, every: 5s}]"


def test_reads_that_are_stretched_leave_more_to_feed() -> None:
    """One drive that its reads would feed, beside ten that ask for three lines."""
    drives = [("d1", 1, "smvector"), *((f"e{at}", at, "smvector") for at in range(11, 20))]
    own = {name: "cyclic: [{code: C0150, every: 100ms}]" for name, _, _ in drives[1:]}
    own["d1"] = "watchdog: {time: 500ms, action: inhibit}, cyclic: [{code: C0150, every: 400ms}]"
    roster = make_roster(drives, own=own)
    load, shown = make_plan(roster).load, preview(roster, line_timing(roster.line))
    assert load.stretch > load.cyclic > 2.0
    assert load.feeding > 0.03
    assert load.feeding == pytest.approx(shown.feeding, rel=0.3)
    assert load.cyclic / load.stretch + load.feeding == pytest.approx(1.0)


def test_absent_drives_take_their_share_and_leave_their_own() -> None:
    plan = make_plan(line_of(31, time="4s", baud=19200))
    assert [one.absent for one in plan.absent] == [1, 3, 10]
    for one in plan.absent:
        assert one.load.probing <= 0.10 + LISTEN_S / LISTEN_EVERY_S
        assert one.cycle_rate >= 0.85
        assert one.load.cyclic < plan.load.cyclic


def test_the_plan_is_json_with_every_part() -> None:
    found = json.loads(json.dumps(make_plan(line_of(3)).as_json(), allow_nan=False))
    assert set(found) == {
        *("line", "baud", "load", "exchanges", "waits", "silent_stop", "watchdogs", "bauds"),
        *("adapter", "absent", "room", "stretch"),
    }  # fmt: skip
    assert [one["name"] for one in found["waits"]] == [
        "stop", "control", "watchdog", "interactive", "cyclic", "background",
    ]  # fmt: skip
    assert found["watchdogs"][0]["verdict"]
    loads = [found["load"], found["adapter"]["load"], found["bauds"][0]["load"],
             found["absent"][0]["load"]]  # fmt: skip
    for load in loads:
        parts = load["cyclic"] + load["feeding"] + load["probing"]
        assert load["total"] == pytest.approx(parts, abs=2e-6)
        assert load["stretch"] >= 1.0


def test_the_preview_never_shows_two_at_once_and_keeps_every_deadline() -> None:
    roster = line_of(20, time="2s", baud=19200)
    shown = preview(roster, line_timing(roster.line))
    ends = 0.0
    for span in shown.spans:
        assert span.start_s >= ends - 1e-9
        ends = span.end_s
    for drive, times in shown.deadlines.items():
        starts = [span.start_s for span in shown.spans if span.drive == drive]
        ends_of = [span.end_s for span in shown.spans if span.drive == drive]
        for due_s in (one for one in times if one > 1.8):  # earlier: fed before the picture
            fed = any(due_s - 1.8 < end <= due_s + 1e-9 for end in ends_of)
            assert fed or due_s > max(starts), (drive, due_s)


def test_the_picture_is_well_formed_and_escapes_names() -> None:
    roster = line_of(5)
    names = tuple(drive.name for drive in roster.drives)
    shown = preview(roster, line_timing(roster.line))
    tree = ElementTree.fromstring(picture("<hall> & yard", names, shown))
    texts = [element.text for element in tree.iter("{http://www.w3.org/2000/svg}text")]
    assert set(names) <= set(texts)
    assert "<hall> & yard" in texts
    assert any(text and "hyperperiod of the cyclic reads: 60 s, its first 10 s" in text
               for text in texts)  # fmt: skip
    boxes = [
        element for element in tree.iter("{http://www.w3.org/2000/svg}rect")
        if len(element)  # an exchange has a title
    ]  # fmt: skip
    assert len(boxes) == sum(1 for span in shown.spans if span.start_s < shown.length_s)


@pytest.mark.parametrize(
    ("every", "said", "ends"),
    [
        ("2s", "hyperperiod of the cyclic reads: 2 s, all of it is shown", 1),
        ("400ms", "hyperperiod of the cyclic reads: 0.4 s, 1 s are shown", 2),
        ("60s", "hyperperiod of the cyclic reads: 60 s, its first 10 s are shown", 0),
        ("50ms", "hyperperiod of the cyclic reads: 0.12 s, stretched by 2.32", 8),
    ],
)
def test_the_picture_says_its_hyperperiod_and_marks_its_end(
    every: str, said: str, ends: int
) -> None:
    cyclic = f"cyclic: [{{code: C0150, every: {every}}}]"
    roster = line_of(3, time="2s", only="smvector", cyclic=cyclic)
    shown = preview(roster, line_timing(roster.line))
    drawn = picture("l", tuple(drive.name for drive in roster.drives), shown)
    assert said in drawn
    assert drawn.count('class="round"') == ends + 1  # one in the legend
    if every != "60s":
        assert "<title>d1, C0150: " in drawn


def test_a_line_that_reads_nothing_has_no_hyperperiod() -> None:
    roster = line_of(2, time="1s", cyclic="cyclic: []")
    drawn = picture("l", ("d1", "d2"), preview(roster, line_timing(roster.line)))
    assert "no cyclic reads; 1 s are shown" in drawn
    assert ", feed: " in drawn


def test_a_long_name_is_whole_and_does_not_reach_into_the_picture() -> None:
    roster = line_of(2, only="smvector")
    shown = preview(roster, line_timing(roster.line))
    names = {"d1": "w" * 32, "d2": "short"}
    spans = tuple(replace(one, drive=names[one.drive]) for one in shown.spans)
    drawn = picture("l", tuple(names.values()), replace(shown, spans=spans, deadlines={}))
    size = re.search(r'style="font-size:([0-9.]+)px">w{32}</text>', drawn)
    assert size is not None
    assert 32 * 0.8 * float(size[1]) < 140.0
    assert drawn.count("font-size:") == 1 + drawn.count(".head{font-size:")


@pytest.mark.parametrize(
    ("time", "verdict"),
    [("2s", "may act"), ("7s", "if fed 1.9 s before"), ("60s", "outlasts it")],
)
def test_which_watchdogs_outlast_a_restart(time: str, verdict: str) -> None:
    drives = [("a", 1, "8200vector"), ("b", 2, "8200vector")]
    own = {"a": f"watchdog: {{time: {time}, action: inhibit}}"}
    (one,) = make_plan(make_roster(drives, baud=9600, own=own)).watchdogs
    assert one.at_restart == verdict
