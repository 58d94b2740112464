"""Whether a line can hold the watchdogs of a roster, and whether what is proposed would do."""

from __future__ import annotations

import re
from random import Random

import pytest

from lecombus.capacity.exchange_costs import dearest_feed_times, read_times
from lecombus.capacity.plan import make_plan
from lecombus.capacity.watchdog_demand import demand_of, least_time_s
from lecombus.capacity.watchdog_feasibility import find_infeasible
from lecombus.capacity.work_ahead import feeds_of
from lecombus.config import RosterError, line_timing
from lecombus.config.warnings import find_warnings
from lecombus.durations import parse_duration
from lecombus.schedule import Priority, Request, ignore_end

from .rosters import parsed, said


def line_of(count: int, time: str, baud: int = 9600, *, tolerate: int = 1) -> str:
    addresses = [address for address in range(1, 99) if address % 10][:count]
    drives = "".join(
        f"  - {{name: d{address}, address: {address}, family: smvector, "
        f"watchdog: {{time: {time}, action: quick-stop}}}}\n"
        for address in addresses
    )
    line = f"{{name: l, port: /dev/ttyS0, baud: {baud}, tolerate: {tolerate}}}"
    return f"line: {line}\ndrives:\n{drives}"


def test_50_ms_on_two_drives_at_9600_is_refused_with_the_arithmetic() -> None:
    first, second = said(line_of(2, "50ms"))
    assert first.startswith("3:")
    assert second.startswith("4:")
    for text in (first, second):
        assert "a watchdog of 50ms cannot be held at 9600 baud: within 45ms the line would" in text
        assert "the feeds of 2 drives (98ms) behind one exchange that fails (183ms)" in text
        assert "a time of 460ms or more" in text


def test_a_drive_alone_outlasts_its_own_lost_answer_or_is_refused_with_what_would_do() -> None:
    (refused,) = said(line_of(1, "250ms"))
    assert "cannot be held at 9600 baud if 1 answer is lost" in refused
    assert "an exchange, 1 lost answer (183ms each), and as far as the last tenth of" in refused
    assert "tolerate: 0 would do" in refused
    assert find_infeasible(parsed(line_of(1, "250ms", tolerate=0))) == []
    assert find_infeasible(parsed(line_of(1, "310ms"))) == []


def test_more_lost_answers_take_longer_watchdogs_and_plan_and_warning_agree() -> None:
    least = [
        least_time_s(demand_of(parsed(line_of(12, "10s", tolerate=tolerate))), all_alike=True)
        for tolerate in range(1, 4)
    ]
    times = [time_s for time_s in least if time_s is not None]
    assert len(times) == 3
    assert times == sorted(set(times))
    for tolerate, time_s in enumerate(times, 1):
        roster = parsed(line_of(12, f"{round(time_s * 1000)}ms", tolerate=tolerate))
        assert make_plan(roster).watchdogs[0].lost == tolerate
        assert any("may act when" in text for text in find_warnings(roster))
        assert said(line_of(12, f"{round(time_s * 1000) - 1}ms", tolerate=tolerate))


def test_a_full_line_with_2_s_can_be_held_at_19200() -> None:
    drives = line_of(31, "2s", 19200)
    assert find_infeasible(parsed(drives)) == []


@pytest.mark.parametrize(("count", "time", "baud"), [
    (2, "50ms", 9600), (31, "1s", 9600), (5, "300ms", 1200), (31, "700ms", 19200),
])  # fmt: skip
def test_the_times_proposed_are_held_and_a_little_less_is_not(
    count: int, time: str, baud: int
) -> None:
    text = said(line_of(count, time, baud))[0]
    proposed = re.search(r"a time of (\S+) or more", text)
    assert proposed is not None
    parsed(line_of(count, proposed[1], baud))
    roster = parsed(line_of(count, "60s", baud))
    feeding = demand_of(roster)
    least = least_time_s(feeding)
    assert least is not None
    assert least <= parse_duration(proposed[1])
    assert said(line_of(count, f"{round(least * 1000) - 2}ms", baud))


def test_the_baud_rate_proposed_does() -> None:
    text = said(line_of(14, "1s", 4800))[0]
    proposed = re.search(r"baud: (\d+)", text)
    assert proposed is not None
    parsed(line_of(14, "1s", int(proposed[1])))


def test_a_long_cyclic_read_in_the_way_is_named() -> None:
    slow = "\n  - {name: slow, address: 99, family: 821x, cyclic: [{code: C1923, every: 1min}]}\n"
    text = said(line_of(3, "700ms").rstrip("\n") + slow)[0]
    assert "not reading C1923 of slow cyclically" in text
    parsed(line_of(3, "700ms").rstrip("\n") + slow.replace("C1923", "C0050"))


def test_only_what_is_too_short_is_refused() -> None:
    text = line_of(2, "50ms") + (
        "  - {name: calm, address: 91, family: smvector, watchdog: {time: 10s, action: inhibit}}\n"
    )
    assert [line.split(":")[0] for line in said(text)] == ["3", "4"]


def test_a_second_lost_answer_is_worth_a_warning_with_the_time_that_outlasts_it() -> None:
    feeding = demand_of(parsed(line_of(2, "500ms")))
    least = least_time_s(feeding, lost=2)
    assert feeding.overload() is None
    assert least is not None
    assert least > 0.5


def test_a_watchdog_shorter_than_a_drives_own_stop_is_refused() -> None:
    """An 820X takes 230 ms for most writes, its inhibit among them."""
    drive = "  - {name: a, address: 11, family: 820x, watchdog: {time: TIME, action: inhibit}}\n"
    text = f"line: {{name: l, port: /dev/ttyS0, baud: 19200, tolerate: 0}}\ndrives:\n{drive}"
    refused = said(text.replace("TIME", "230ms"))
    assert len(refused) == 1
    assert (
        "the line would have to carry a write to a with the time for which it is left alone (467ms)"
        " and the feed of a (51ms)"
    ) in refused[0]
    proposed = re.search(r"a time of (\S+) or more", refused[0])
    assert proposed is not None
    assert find_infeasible(parsed(text.replace("TIME", proposed[1]))) == []


@pytest.mark.parametrize("tolerate", range(3))
def test_what_stands_behind_a_write_adds_up_to_more_than_there_is(tolerate: int) -> None:
    drives = "".join(
        f"  - {{name: {name}, address: {address}, family: 820x, "
        "watchdog: {time: TIME, action: inhibit}}\n"
        for name, address in (("a", 11), ("b", 12))
    )
    line = f"line: {{name: l, port: /dev/ttyS0, baud: 19200, tolerate: {tolerate}}}"
    text = f"{line}\ndrives:\n{drives}"
    least = least_time_s(demand_of(parsed(text.replace("TIME", "10s"))), all_alike=True)
    assert least is not None
    refused = said(text.replace("TIME", f"{round(least * 1000) - 1}ms"))[0]
    assert ("answer is lost" in refused or "answers are lost" in refused) == (tolerate > 0)
    found = re.search(r"within (\d+)ms the line would have to carry (.*)", refused)
    assert found is not None
    within, carried = found.groups()
    assert "left alone" in carried
    assert sum(int(ms) for ms in re.findall(r"\((\d+)ms\)", carried)) == pytest.approx(
        int(within), abs=4
    )


def test_a_watchdog_shorter_than_one_exchange_with_its_drive_is_refused() -> None:
    """A module takes half a second for its own codes."""
    text = (
        "line: {name: l, port: /dev/ttyS0, baud: 19200, tolerate: 0}\ndrives:\n"
        "  - {name: a, address: 11, family: 821x, cyclic: [{code: C1923, every: 10s}], "
        "watchdog: {time: TIME, action: inhibit}}\n"
    )
    (refused,) = said(text.replace("TIME", "500ms"))
    assert "one exchange with this drive, such as its stop, takes 5" in refused
    proposed = re.search(r"a time of (\S+) or more", refused)
    assert proposed is not None
    assert find_infeasible(parsed(text.replace("TIME", proposed[1]))) == []


def mixed(slow: str, fast: str, *, slow_first: bool = True) -> str:
    """Write an 820X, whose stop takes 230 ms and more, beside an SMVector."""
    guard = "watchdog: {{time: {}, action: inhibit}}"
    drives = [
        f"  - {{name: slow, address: 1, family: 820x, {guard.format(slow)}}}",
        f"  - {{name: fast, address: 2, family: smvector, {guard.format(fast)}}}",
    ]
    listed = "\n".join(drives if slow_first else drives[::-1])
    return f"line: {{name: l, port: 'sim:', baud: 2400, tolerate: 0}}\ndrives:\n{listed}\n"


@pytest.mark.parametrize("slow_first", [True, False])
def test_the_stop_of_the_drive_with_the_shortest_watchdog_stands_before_the_others(
    slow_first: bool,
) -> None:
    """1000 or 1001 ms for the other: what is said to the first does not feed the second."""
    refused = said(mixed("1000ms", "1001ms", slow_first=slow_first))
    assert "one stop (377ms)" in refused[0]
    assert said(mixed("1000ms", "1000ms", slow_first=slow_first))
    parsed(mixed("1200ms", "1201ms", slow_first=slow_first))


def test_whatever_time_is_proposed_does() -> None:
    """Also where raising one watchdog makes another drive the one that stands in the way."""
    random, proposals = Random(7), 0
    for _ in range(60):
        families = random.choices(("820x", "8200vector", "93xx", "smvector"), k=4)
        times = {name: random.choice((300, 500, 700, 1000, 2000)) for name in "abcd"}
        baud = random.choice((1200, 2400, 4800))
        try:
            parsed(drives_of(families, times, baud))
        except RosterError as refused:
            for mistake in refused.mistakes:
                proposed = re.search(r"a time of (\S+) or more", mistake.right)
                if proposed is not None:
                    name = "abcd"[mistake.line - 3]
                    times[name] = round(parse_duration(proposed[1]) * 1000)
                    proposals += 1
            parsed(drives_of(families, times, baud))
    assert proposals > 20


def drives_of(families: list[str], times: dict[str, int], baud: int) -> str:
    rows = "".join(
        f"  - {{name: {name}, address: {at}, family: {family}, "
        f"watchdog: {{time: {times[name]}ms, action: quick-stop}}}}\n"
        for at, (name, family) in enumerate(zip("abcd", families, strict=True), 1)
    )
    return f"line: {{name: l, port: 'sim:', baud: {baud}}}\ndrives:\n{rows}"


def three(time: str, baud: int = 19200) -> str:
    """Return a line on which a stop of an 820X that is not answered takes half a second."""
    drives = "".join(
        f"  - {{name: d{address}, address: {address}, family: {family}, cyclic: [], "
        f"watchdog: {{time: {time}, action: quick-stop, configure: true}}}}\n"
        for address, family in ((16, "821x"), (79, "820x"), (86, "8200vector"))
    )
    return f"line: {{name: l, port: 'sim:', baud: {baud}}}\ndrives:\n{drives}"


def test_a_lost_stop_of_an_820x_that_the_last_tenth_does_not_hold_takes_room_of_its_own() -> None:
    """With 708 ms the stop was lost when 418 ms were left, and a watchdog acted."""
    for text in said(three("708ms")):
        assert "cannot be held at 19200 baud if 1 answer is lost" in text
        assert "a stop (283ms, or 535ms without an answer)" in text
        assert "a time of 1.1s or more" in text
    roster = parsed(three("1100ms"))
    assert make_plan(roster).watchdogs[0].least_s == pytest.approx(0.702, abs=0.0015)
    assert make_plan(roster).watchdogs[0].lost == 1


def test_a_stop_that_is_lost_while_another_drive_is_left_alone_takes_room() -> None:
    """The 820X takes 230 ms to stop and is left alone for 230 ms; then another's stop is lost."""
    refused = said(three("1000ms"))
    assert refused
    for text in refused:
        assert "a write to d79 with the time for which it is left alone (467ms)" in text
        assert "1 lost answer and a stop beyond the last tenth (435ms)" in text


def test_check_names_a_watchdog_that_lost_answers_of_its_own_stop_may_let_act() -> None:
    def told(tolerate: int) -> list[str]:
        text = three("3s").replace("'sim:'", f"'sim:', tolerate: {tolerate}")
        return [one for one in find_warnings(parsed(text)) if "it is being stopped" in one]

    assert told(1) == []
    assert told(2) == [
        "d79: its watchdog may act when two answers are lost that are all of one stop of this "
        "drive: each holds the line for 535ms; it is being stopped"
    ]
    assert told(3) == told(2), "two are enough"


@pytest.mark.parametrize("seed", range(40))
def test_a_roster_that_is_accepted_has_room_for_its_reads_and_feeds(seed: int) -> None:
    """The schedule begins none without it: such a line would never be read."""
    random = Random(seed)
    families = ["820x", "821x", "8200vector", "93xx", "smvector"]
    baud, tolerate = random.choice((1200, 9600, 19200)), random.randrange(1, 4)
    spread = random.choice((0.0, 0.1, 1.0, 4.0))
    kinds = [random.choice(families) for _ in range(random.choice((2, 3, 8, 20)))]
    more = [random.uniform(0.0, spread) for _ in kinds]

    def text(least_s: float) -> str:
        return f"line: {{name: l, port: 'sim:', baud: {baud}, tolerate: {tolerate}}}\ndrives:\n" + (
            "".join(
                f"  - {{name: d{at}, address: {at + (at - 1) // 9}, family: {kind}, cyclic: "
                f"[{{code: C0150, every: 5s}}], watchdog: {{action: quick-stop, time: "
                f"{min(round(1000 * least_s * (1.0 + longer)), 65000)}ms}}}}\n"
                for at, (kind, longer) in enumerate(zip(kinds, more, strict=True), 1)
            )
        )

    low_s, high_s = 0.05, 60.0
    while high_s - low_s > 0.001:
        middle_s = (low_s + high_s) / 2
        low_s, high_s = (low_s, middle_s) if is_accepted(text(middle_s)) else (middle_s, high_s)
    roster = parsed(text(high_s))
    timing = line_timing(roster.line)
    feeds = feeds_of(roster, timing)
    for drive in roster.drives:
        feed = dearest_feed_times(drive, timing)
        read = read_times(drive, drive.cyclic[0].code, timing)
        for times in (feed, read):
            request = Request(drive.name, Priority.CYCLIC, times.usual_s, times.worst_s, ignore_end)
            assert feeds.never(request) == ""


def is_accepted(text: str) -> bool:
    try:
        parsed(text)
    except RosterError:
        return False
    return True
