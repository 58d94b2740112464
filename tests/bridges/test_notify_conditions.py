"""Which happenings are found in what a bridge sees of a line: each once, also those it missed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, get_args

import pytest

from lecombus.bridges.line_follower import FollowedDrive, LineFollower
from lecombus.bridges.notify.conditions import Conditions, Happening
from lecombus.bridges.watchdog_misses import misses_of
from lecombus.client import Event, LineStatus
from lecombus.roster import NotifyEvent

OH = {"kind": "trip", "keypad": "OH", "number": 50, "meaning": "heat sink too hot"}
GONE_S = 15.0


class Seen:
    """Conditions over a picture that the test draws, on a clock that stands still."""

    def __init__(self, *events: str) -> None:
        self.now_s = 100.0
        self.given: list[Happening] = []
        self.follower = LineFollower("/run/x.sock")
        self.conditions = Conditions(
            self.follower, events or get_args(NotifyEvent), GONE_S,
            clock=lambda: self.now_s, wall=lambda: 1000.0 + self.now_s, give=self.given.append,
        )  # fmt: skip

    def connect(self, line: str = "open", leases: tuple[Mapping[str, Any], ...] = ()) -> None:
        follower = self.follower
        follower.is_connected, follower.why_away = True, ""
        follower.line = LineStatus("hall-3", line, "", {}, {}, {})
        follower.leases = {"drives": list(leases)}
        for name in ("feeder", "belt"):
            follower.drives.setdefault(name, FollowedDrive(name, 11, "8200vector")).state = "online"
        self.say("connected")
        self.say("looked")

    def lose(self, why: str = "no daemon answers") -> None:
        self.follower.is_connected, self.follower.why_away, self.follower.line = False, why, None
        for drive in self.follower.drives.values():
            drive.state = "unknown"
        self.say("away")

    def say(self, kind: str, drive: str = "", **data: Any) -> None:
        self.conditions.take(Event("", kind, drive, data))

    def fault(self, fault: Mapping[str, Any] | None, drive: str = "feeder") -> None:
        self.follower.drives[drive].fault = fault
        self.say("trip", drive)

    def state(self, state: str, drive: str = "feeder", reason: str = "") -> None:
        self.follower.drives[drive].state, self.follower.drives[drive].reason = state, reason
        self.say("state", drive)

    def silence(self, *drives: str) -> None:
        """Have the picture show just these drives as silenced."""
        self.follower.silenced = set(drives)

    def line(self, state: str, reason: str = "") -> None:
        assert self.follower.line is not None
        self.follower.line = replace(self.follower.line, state=state, reason=reason)
        self.say("line")

    def found(self) -> list[tuple[str, str, bool]]:
        """What was given since the last call, without texts."""
        found = [(one.event, one.drive, one.active) for one in self.given]
        self.given.clear()
        return found


@pytest.fixture
def seen() -> Seen:
    seen = Seen()
    seen.connect()
    assert seen.found() == []
    return seen


def test_a_trip_begins_and_ends_once(seen: Seen) -> None:
    seen.fault(OH)
    assert [one.text for one in seen.given] == ["trip OH (50): heat sink too hot"]
    assert seen.given[0].fault == OH
    assert seen.given[0].at_s == 1100.0
    seen.say("looked")
    seen.say("trip", "feeder")
    assert seen.found() == [("trip", "feeder", True)]
    seen.fault(None)
    seen.say("looked")
    assert seen.found() == [("trip", "feeder", False)]


def test_what_is_known_of_a_trip_later_is_an_update_and_another_trip_is_none(seen: Seen) -> None:
    seen.fault({"kind": "trip", "number": None, "keypad": None, "meaning": None})
    seen.fault(OH)
    seen.fault({**OH, "keypad": "OC1", "number": 11, "meaning": "short circuit"})
    assert [(one.text, one.is_update) for one in seen.given] == [
        ("trip of a number not known", False),
        ("trip OH (50): heat sink too hot", True),
        ("trip OC1 (11): short circuit", False),
    ]


@pytest.mark.parametrize("kind", ["message", "warning"])
def test_lesser_faults_are_none(seen: Seen, kind: str) -> None:
    seen.fault({**OH, "kind": kind})
    assert seen.found() == []


def test_a_drive_is_lost_when_it_is_offline_and_back_when_it_answers(seen: Seen) -> None:
    seen.state("degraded")
    seen.state("offline", reason="4 exchanges failed")
    assert [one.text for one in seen.given] == ["it does not answer: 4 exchanges failed"]
    assert seen.found() == [("drive-lost", "feeder", True)]
    seen.state("starting")
    assert seen.found() == []
    seen.state("online")
    assert seen.found() == [("drive-lost", "feeder", False)]


def test_a_lost_line_is_one_happening_and_its_drives_are_none(seen: Seen) -> None:
    seen.line("lost", "the adapter is gone")
    seen.state("offline")
    seen.state("offline", "belt")
    assert [one.text for one in seen.given] == ["the port is not open: the adapter is gone"]
    assert seen.found() == [("line-lost", "", True)]
    seen.line("open")
    seen.say("looked")
    assert seen.found() == [("line-lost", "", False)], "they were not asked again yet"
    for drive in ("feeder", "belt"):
        seen.state("starting", drive)
    seen.state("online")
    seen.state("offline", "belt")
    assert seen.found() == [("drive-lost", "belt", True)]


def test_a_drive_that_was_lost_before_its_line_ends_when_it_answers(seen: Seen) -> None:
    seen.state("offline")
    seen.line("lost")
    seen.line("open")
    seen.state("starting")
    seen.state("online")
    assert seen.found() == [
        ("drive-lost", "feeder", True), ("line-lost", "", True), ("line-lost", "", False),
        ("drive-lost", "feeder", False),
    ]  # fmt: skip


def test_a_daemon_is_lost_after_its_time_and_back_when_it_answers(seen: Seen) -> None:
    seen.fault(OH)
    seen.found()
    seen.lose()
    seen.conditions.look()
    seen.now_s += GONE_S - 1
    seen.conditions.look()
    assert seen.found() == []
    seen.now_s += 1
    seen.conditions.look()
    seen.conditions.look()
    assert [one.text for one in seen.given] == ["the daemon does not answer: no daemon answers"]
    assert seen.found() == [("daemon-lost", "", True)]
    seen.connect()
    seen.say("looked")
    seen.conditions.look()
    assert seen.found() == [("daemon-lost", "", False)], "the trip stands on"


def test_a_daemon_that_comes_back_in_time_was_not_lost(seen: Seen) -> None:
    for _ in range(3):
        seen.lose()
        seen.now_s += GONE_S - 1
        seen.conditions.look()
        seen.connect()
    assert seen.found() == []


def test_a_daemon_that_never_answered_is_lost() -> None:
    seen = Seen()
    seen.now_s += GONE_S
    seen.conditions.look()
    assert seen.found() == [("daemon-lost", "", True)]


def test_what_stands_at_the_start_or_happened_while_the_daemon_was_away_is_found() -> None:
    seen = Seen()
    seen.connect()
    seen.fault(OH)
    seen.lose()
    seen.follower.drives["feeder"].fault = None
    seen.follower.drives["belt"].fault = OH
    lapsed = {"drive": "belt", "lease": None, "latched": True, "because": "lapsed",
              "on_lapse": "inhibit"}  # fmt: skip
    seen.found()
    seen.connect(leases=(lapsed,))
    seen.say("looked")
    assert seen.found() == [
        ("lease-lapse", "belt", True), ("trip", "feeder", False), ("trip", "belt", True),
    ]  # fmt: skip


@pytest.mark.parametrize("end", ["lapsed", "none-taken", "came-back"])
def test_the_lapse_of_a_lease_ends_with_the_next_one(seen: Seen, end: str) -> None:
    seen.follower.leases = {"drives": [{"drive": "feeder", "on_lapse": "quick-stop"}]}
    seen.say("lease", what="ended", end=end, lease="plc", drives=["feeder", "belt"])
    assert "on_lapse: quick-stop" in seen.given[0].text
    assert seen.found() == [("lease-lapse", "feeder", True), ("lease-lapse", "belt", True)]
    seen.say("lease", what="taken", lease="plc", drives=["feeder"])
    assert seen.found() == [("lease-lapse", "feeder", False)]


@pytest.mark.parametrize("end", ["released", "taken-over"])
def test_a_lease_that_was_given_up_did_not_lapse(seen: Seen, end: str) -> None:
    seen.say("lease", what="ended", end=end, lease="plc", drives=["feeder"])
    assert seen.found() == []


def test_a_drive_on_hold_is_named_as_such(seen: Seen) -> None:
    seen.say("lease", what="ended", end="lapsed", lease="plc", drives=["feeder"])
    seen.say("lease", what="hold", lease="plc", drives=["feeder"])
    assert seen.given[-1].text == "it runs on without a controller (on_lapse: hold)"
    assert not seen.given[-1].is_update
    seen.say("lease", what="unlatched", drives=["feeder"])
    assert seen.found()[-1] == ("lease-lapse", "feeder", False)


def test_a_drive_that_is_silenced_on_purpose_is_not_lost(seen: Seen) -> None:
    """As in the alerts of Prometheus: it has a message of its own, and is not a silent drive."""
    seen.say("lease", what="ended", end="released", lease="plc", drives=["feeder"])
    seen.silence("feeder")
    reason = "sent nothing, so that its watchdog acts"
    seen.say("lease", what="silenced", drives=["feeder"], reason=reason)
    seen.state("offline", reason=reason)
    seen.say("looked")
    assert [one.text for one in seen.given] == [
        "silenced on purpose, so that its own watchdog stops it: see that it stands"
    ]
    assert seen.found() == [("lease-lapse", "feeder", True)]
    seen.say("lease", what="taken", lease="plc", drives=["feeder"])
    seen.state("offline", reason=reason)
    assert seen.found() == [("lease-lapse", "feeder", False)]
    seen.silence()
    seen.say("lease", what="silence-ended", drives=["feeder"])
    seen.state("starting")
    seen.state("offline", reason="4 exchanges failed")
    assert seen.found() == [("drive-lost", "feeder", True)], "it is spoken to, and does not answer"


def test_a_drive_that_was_lost_before_it_is_silenced_stays_lost(seen: Seen) -> None:
    seen.state("offline", reason="4 exchanges failed")
    seen.silence("feeder")
    seen.say("lease", what="silenced", drives=["feeder"])
    seen.state("offline", reason="quick-stop is not proven, its watchdog is left to act")
    assert seen.found() == [("drive-lost", "feeder", True), ("lease-lapse", "feeder", True)]
    seen.silence()
    seen.state("online")
    assert seen.found() == [("drive-lost", "feeder", False)]


@pytest.mark.parametrize("because", ["lapsed", "released", "started"])
def test_a_drive_that_is_silenced_when_the_bridge_starts_is_said_so(because: str) -> None:
    seen = Seen()
    seen.connect()
    seen.lose()
    row = {"drive": "feeder", "lease": None, "latched": True, "because": because,
           "on_lapse": "silence", "silenced": True}  # fmt: skip
    seen.silence("feeder")
    seen.found()
    seen.connect(leases=(row,))
    seen.state("offline", reason="sent nothing")
    assert [one.text for one in seen.given] == [
        "silenced on purpose, so that its own watchdog stops it: see that it stands"
    ]
    assert seen.found() == [("lease-lapse", "feeder", True)]


def test_the_watchdog_of_a_silenced_drive_acts_on_purpose(seen: Seen) -> None:
    seen.conditions.watchdog_missed({"feeder": 0})
    seen.silence("feeder")
    seen.conditions.watchdog_missed({"feeder": 1})
    assert [one.text for one in seen.given] == [
        "its watchdog was not fed, on purpose: it has probably acted"
    ]


def test_missed_watchdogs_are_those_since_the_last_look(seen: Seen) -> None:
    seen.conditions.watchdog_missed({"feeder": 7, "belt": 0})
    assert seen.found() == []
    seen.conditions.watchdog_missed({"feeder": 7, "belt": 2})
    assert [one.text for one in seen.given] == [
        "its watchdog was fed too late 2 times: it has probably acted"
    ]
    assert seen.found() == [("watchdog-missed", "belt", True)]
    seen.conditions.watchdog_missed({"feeder": 1, "belt": 0})  # the daemon was started again
    assert seen.found() == [("watchdog-missed", "feeder", True)]


def test_counts_of_missed_watchdogs_are_found_in_a_page_of_metrics() -> None:
    page = """# TYPE lecombus_watchdog_misses_total counter
lecombus_watchdog_misses_total{line="hall-3",drive="feeder"} 3.0
lecombus_watchdog_misses_total{line="hall-3",drive="belt-2"} 0
lecombus_watchdog_margin_seconds{line="hall-3",drive="belt-2"} 1.5
"""
    assert misses_of(page) == {"feeder": 3, "belt-2": 0}


def test_only_the_events_that_are_wanted_are_given() -> None:
    seen = Seen("drive-lost")
    seen.connect()
    seen.fault(OH)
    seen.state("offline")
    assert seen.found() == [("drive-lost", "feeder", True)]


def test_what_stood_of_a_drive_that_left_the_roster_ends(seen: Seen) -> None:
    seen.fault(OH)
    del seen.follower.drives["feeder"]
    seen.say("looked")
    assert seen.found() == [("trip", "feeder", True), ("trip", "feeder", False)]
