"""The summary of a line: what needs attention, and what makes it worth sending again."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from decimal import Decimal
from math import inf
from typing import Any

import pytest

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue, LineFollower
from lecombus.bridges.mqtt.board import Board
from lecombus.bridges.mqtt.retained import Message
from lecombus.bridges.mqtt.summary import KINDS, STANDS_S, LineSummarizer
from lecombus.bridges.mqtt.topics import Topics
from lecombus.client import LineStatus, Quality, Reading
from lecombus.supervision.lease_watch import LATCHES

TRIP = {"kind": "trip", "keypad": "OH", "number": 50, "meaning": "heat sink too hot"}
ROOT = "plant/lecombus/hall-3"


class Scene:
    """A line of three drives whose daemon answers."""

    def __init__(self) -> None:
        self.follower = LineFollower("/nowhere")
        self.follower.is_connected = True
        self.line()
        self.summary = LineSummarizer(Topics("plant/lecombus", "hall-3"), "hall-3")
        for name, address in (("feeder", 11), ("belt", 12), ("fan", 13)):
            one = FollowedDrive(name, address, "8200vector", "online", doing="running")
            self.follower.drives[name] = one

    def line(self, state: str = "open", reason: str = "", **remarks: str) -> None:
        document = {"line": "hall-3", "state": state, "reason": reason, "remarks": remarks}
        self.follower.line = LineStatus.of(document)

    def value(self, drive: str, code: str, *, good: bool, reason: str = "", read: bool = True,
              cyclic: bool = True) -> None:  # fmt: skip
        quality = Quality.BAD if reason else Quality.GOOD
        time = datetime(2026, 11, 23, tzinfo=UTC) if read else None
        reading = Reading(
            drive, code, 0, "", Decimal(1), "1", "Hz", quality, reason, time, 0.1, ""
        )  # fmt: skip
        until_s = 1e9 if good else -inf
        self.follower.drives[drive].values[code] = FollowedValue(reading, 0.0, until_s)
        if cyclic:
            self.follower._periods[drive, code] = 1.0

    def message(self, now_s: float = 100.0) -> Message:
        return self.summary.message(self.follower, now_s)

    def said(self, now_s: float = 100.0) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.message(now_s).payload)
        return found

    def needs(self, now_s: float = 100.0) -> list[tuple[str, str | None]]:
        return [(one["kind"], one["drive"]) for one in self.said(now_s)["attention"]]


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_a_line_that_is_well_says_so(scene: Scene) -> None:
    message, said = scene.message(), scene.said()
    assert (message.topic, message.expiry_s) == (f"{ROOT}/summary", STANDS_S)
    assert message.is_retained
    assert said["state"] == "online"
    assert said["drives"] == {"online": 3}
    assert said["doing"] == {"running": 3}
    assert (said["attention"], said["more"], said["stands_s"]) == ([], 0, STANDS_S)
    assert said["bridge"] == scene.summary.bridge
    assert LineSummarizer(Topics("a", "b"), "b").bridge != scene.summary.bridge


def test_what_needs_attention_stands_worst_first(scene: Scene) -> None:
    drives = scene.follower.drives
    scene.line(cadence="the line cannot hold the cyclic reads asked for")
    drives["fan"].remarks = {"watchdog": "the drive's watchdog is off, the roster says 2 s"}
    drives["belt"].state, drives["belt"].reason = "offline", "it does not answer"
    scene.value("feeder", "C0050", good=False)
    scene.value("feeder", "C0068", good=False, reason="the drive refuses this code")
    scene.value("feeder", "C0161", good=False, read=False)  # its first read is still to come
    scene.value("feeder", "C0001", good=False, cyclic=False)  # read once
    scene.value("belt", "C0050", good=False)  # that it is offline says it
    drives["fan"].fault = TRIP
    wanted = [
        ("trip", "fan"), ("drive-offline", "belt"), ("stale-value", "feeder"),
        ("bad-value", "feeder"), ("remark", None), ("remark", "fan"),
    ]  # fmt: skip
    assert scene.needs(100.0) == wanted[:2] + wanted[4:]  # a lost answer is read again
    assert scene.needs(119.9) == wanted[:2] + wanted[4:]
    assert scene.needs(120.1) == wanted
    texts = {one["kind"]: one["text"] for one in scene.said(120.1)["attention"]}
    assert texts["trip"] == "trip OH (50): heat sink too hot"
    assert texts["drive-offline"] == "it does not answer"
    assert texts["stale-value"] == "C0050"
    assert texts["bad-value"] == "C0068: the drive refuses this code"


@pytest.mark.parametrize("state", ["degraded", "starting"])
def test_states_that_are_not_well_are_said(scene: Scene, state: str) -> None:
    scene.follower.drives["fan"].state = state
    assert scene.needs() == [(state, "fan")]


def test_a_lesser_fault_is_none_as_bad_as_a_trip(scene: Scene) -> None:
    scene.follower.drives["fan"].fault = {**TRIP, "kind": "warning", "number": None, "meaning": ""}
    assert scene.needs() == [("fault", "fan")]
    assert scene.said()["attention"][0]["text"] == "warning OH of a number not known"


def test_leases_that_lapsed_are_said_and_those_not_taken_yet_are_not(scene: Scene) -> None:
    def latched(drive: str, because: str) -> dict[str, object]:
        return {"drive": drive, "latched": True, "because": because, "lease": None}

    text = f"latched ({next(iter(LATCHES.values()))}): take a lease, then enable it"
    scene.follower.drives["feeder"].remarks = {"lease": text}
    scene.follower.drives["belt"].remarks = {"lease": "latched (its lease lapsed): take a lease"}
    scene.follower.leases = {"drives": [latched("feeder", "started"), latched("belt", "lapsed")]}
    assert scene.needs() == [("lease-lapsed", "belt")]


def test_a_drive_that_runs_on_without_a_controller_is_said(scene: Scene) -> None:
    from pathlib import Path

    from lecombus.bridges.mqtt.summary import HOLDS
    from lecombus.supervision import lease_watch

    assert lease_watch.__file__ is not None
    assert f"runs on {HOLDS}" in Path(lease_watch.__file__).read_text()  # the daemon's own words
    scene.follower.drives["belt"].remarks = {"lease": f"runs on {HOLDS} (on_lapse: hold): stop it"}
    assert scene.needs() == [("no-controller", "belt")]


def test_a_missed_watchdog_is_said_for_five_minutes(scene: Scene) -> None:
    scene.summary.watchdog_missed({"feeder": 3, "belt": 0}, 100.0)
    assert scene.needs() == []  # before the bridge was there
    scene.summary.watchdog_missed({"feeder": 4, "belt": 0}, 110.0)
    assert scene.needs(110.0) == [("watchdog-missed", "feeder")]
    assert scene.needs(409.0) == [("watchdog-missed", "feeder")]
    assert scene.needs(411.0) == []
    scene.summary.watchdog_missed({"feeder": 0, "belt": 1}, 500.0)  # the daemon was started again
    assert scene.needs(500.0) == [("watchdog-missed", "belt")]


def test_while_the_line_is_lost_no_drive_is_blamed_for_it(scene: Scene) -> None:
    scene.line("lost", "the adapter is gone")
    scene.follower.drives["belt"].state = "offline"
    scene.follower.drives["fan"].fault = TRIP
    said = scene.said()
    assert (said["state"], said["reason"]) == ("lost", "the adapter is gone")
    assert scene.needs() == [("trip", "fan")]


def test_while_the_daemon_is_away_nothing_else_is_said(scene: Scene) -> None:
    scene.follower.drives["fan"].fault = TRIP
    scene.follower.is_connected, scene.follower.why_away = False, "it did not answer"
    said = scene.said()
    assert (said["state"], said["reason"], said["attention"]) == (
        "daemon-away", "it did not answer", []
    )  # fmt: skip


def test_how_long_it_lasts_is_said_and_is_no_reason_to_send_it_again(scene: Scene) -> None:
    board = Board()

    def sent(now_s: float) -> bool:
        due = list(board.due([scene.message(now_s)], "\0", now_s))
        for one in due:
            board.sent(one, now_s)
        return bool(due)

    assert sent(100.0)
    scene.follower.drives["fan"].fault = TRIP
    assert sent(101.5)
    assert scene.said(101.5)["attention"][0]["for_s"] == 0
    assert not sent(110.0)
    assert scene.said(110.0)["attention"][0]["for_s"] == 8.5
    assert sent(121.6)  # renewed while a third of its time is left
    assert scene.said(121.6)["attention"][0]["for_s"] == 20.1
    scene.follower.drives["fan"].fault = None
    assert sent(125.0)


def test_a_summary_is_bounded(scene: Scene) -> None:
    for number in range(99):
        name = f"drive-{number:02}"
        one = FollowedDrive(name, number, "8200vector", "offline", "x" * 5000)
        one.fault = {**TRIP, "meaning": "y" * 5000}
        scene.follower.drives[name] = one
    message, said = scene.message(), scene.said()
    assert len(message.payload) < 20_000
    assert len(said["attention"]) + said["more"] == 198
    assert {one["kind"] for one in said["attention"]} == {"trip"}
    assert said["drives"] == {"online": 3, "offline": 99}


def test_every_kind_has_its_place() -> None:
    assert len(set(KINDS)) == len(KINDS)
