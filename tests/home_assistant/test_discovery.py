"""What the MQTT bridge tells Home Assistant of drives, and that Home Assistant takes it."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest

from home_assistant.followed import Followed, devices
from home_assistant.installed import install
from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.discovery import PLATFORMS
from lecombus.bridges.mqtt.retained import JSON_STANDS_S, STATE_STANDS_S
from lecombus.drives import FAMILY_NAMES

HERE = Path(__file__).parent


def documents(*, control: bool) -> Iterator[tuple[str, str]]:
    for message in devices(Followed(), control=control).due():
        assert (message.is_retained, message.expiry_s) == (True, None)
        yield message.topic, message.payload.decode()


def test_a_drive_is_read_only_and_can_be_stopped_unless_the_roster_allows_more() -> None:
    writes = []
    for control in (False, True):
        found = json.loads(dict(documents(control=control))[
            "homeassistant/device/lecombus_hall-3_drive-8200vector/config"])  # fmt: skip
        parts = found["components"]
        writes.append({key for key, part in parts.items() if "command_topic" in part})
        assert (
            parts["quick_stop"]["command_topic"] == "lecombus/hall-3/drive-8200vector/do/quick-stop"
        )
        assert all(part["qos"] == 2 and not part["retain"] for part in parts.values()
                   if "command_topic" in part)  # fmt: skip
        value = parts["C0050"]
        assert (value["unit_of_measurement"], value["device_class"]) == ("Hz", "frequency")
        assert value["expire_after"] == 6  # read every 2 s: stale after 5 s
    assert writes == [{"quick_stop", "inhibit"}, {"quick_stop", "inhibit", "speed"}]


def test_all_that_is_shown_expires_as_nobody_says_that_a_message_expired() -> None:
    """A bridge that was lost together with its broker leaves no `offline`."""
    follower = Followed({"feeder": "8200vector"})
    (message,) = devices(follower, control=True).due()
    parts = json.loads(message.payload)["components"]
    shown = {key for key, part in parts.items() if part["platform"] in ("sensor", "binary_sensor")}
    assert {"state", "motion", "problem", "fault", "C0050"} <= shown
    assert all("expire_after" in parts[key] for key in shown)
    assert parts["state"]["expire_after"] > STATE_STANDS_S
    # The document stands until its first good value is stale, or as long as this.
    assert parts["motion"]["expire_after"] > JSON_STANDS_S
    follower._periods["feeder", "C0050"] = 60.0
    (message,) = devices(follower).due()
    assert json.loads(message.payload)["components"]["problem"]["expire_after"] > 121


def test_state_and_stops_are_there_while_the_daemon_is_also_if_the_line_is_lost() -> None:
    follower = Followed({"feeder": "8200vector"})
    (message,) = devices(follower).due()
    found = json.loads(message.payload)

    def shown_at(given: list[dict[str, str]], topic: str) -> list[str]:
        """At which words of a topic something is shown, by a template `value == ..` or `in ..`."""
        (template,) = (one["value_template"] for one in given if one["topic"] == topic)
        condition = template.removeprefix("{{ 'online' if value ").removesuffix(
            " else 'offline' }}"
        )
        return re.findall(r"'([a-z-]+)'", condition)

    line = "lecombus/hall-3/state"
    for key in ("state", "quick_stop", "inhibit"):
        there = found["components"][key]["availability"]
        assert shown_at(there, line) == ["online", "lost", "closed"]
    assert shown_at(found["availability"], line) == ["online"]
    assert shown_at(found["availability"], "lecombus/hall-3/feeder/state") == ["online", "degraded"]


def test_codes_and_periods_that_a_reload_changed_are_made_known() -> None:
    follower = Followed({"feeder": "8200vector"})
    known = devices(follower)
    known.looked()
    for message in known.due():
        known.sent(message)

    def expire_after(code: str) -> int | None:
        known.came = anyio.Event()
        known.looked()
        assert known.came.is_set()
        (message,) = known.due()
        known.sent(message)
        part = json.loads(message.payload)["components"][code]
        return None if part == {"platform": "sensor"} else int(part["expire_after"])

    follower._periods["feeder", "C0050"] = 20.0
    assert expire_after("C0050") == 42
    del follower._periods["feeder", "C0050"]
    assert expire_after("C0050") is None, "it is removed, as left out it would stay"
    follower._periods["feeder", "C0050"] = 2.0
    assert expire_after("C0050") == 6
    overfull: Any = SimpleNamespace(document={"planned_stretch": 2.0})
    follower.line = overfull
    assert expire_after("C0050") == 10


def test_all_is_sent_again_after_the_birth_of_home_assistant_and_only_what_changed_else() -> None:
    follower = Followed()
    known = devices(follower)
    for message in known.due():
        known.sent(message)
    assert known.due() == []
    assert known.takes(incoming("homeassistant/status", b"offline"))
    assert known.due() == []
    assert known.takes(incoming("homeassistant/status", b"online"))
    assert len(known.due()) == len(FAMILY_NAMES)


def test_a_drive_that_left_the_roster_is_removed_also_if_the_bridge_was_not_there() -> None:
    ours = dict(documents(control=False))
    topic = "homeassistant/device/lecombus_hall-3_drive-93xx/config"
    other_line = ours[topic].replace("lecombus/hall-3/", "lecombus/hall-30/")
    follower = Followed()
    del follower.drives["drive-93xx"]
    known = devices(follower)
    known.takes(incoming(topic, ours[topic].encode(), is_retained=True))
    for strange in (b"", b"[1]", b"{", b'{"device": 1}', b'{"device": {"serial_number": 1}}'):
        known.takes(incoming("homeassistant/device/strange/config", strange, is_retained=True))
    known.takes(incoming("homeassistant/device/other/config", other_line.encode()))
    gone = [message.topic for message in known.due() if not message.payload]
    assert gone == [topic]
    follower.is_connected = False  # nothing is removed while the drives are not known
    assert known.due() == []


def test_a_drive_that_left_is_removed_if_home_assistant_starts_before_the_daemon_answers() -> None:
    topic = "homeassistant/device/lecombus_hall-3_drive-93xx/config"
    ours = dict(documents(control=False))
    follower = Followed()
    del follower.drives["drive-93xx"]
    follower.is_connected = False
    known = devices(follower)
    known.takes(incoming(topic, ours[topic].encode(), is_retained=True))
    known.takes(incoming("homeassistant/status", b"online"))
    follower.is_connected = True
    assert topic in [message.topic for message in known.due() if not message.payload]


def test_the_speed_is_removed_when_the_roster_allows_no_control_any_more() -> None:
    """Home Assistant keeps a part that is only left out, until it is started again."""
    topic = "homeassistant/device/lecombus_hall-3_feeder/config"
    follower = Followed({"feeder": "8200vector"})
    (allowed,) = devices(follower, control=True).due()
    known = devices(follower)
    known.takes(incoming(topic, allowed.payload, is_retained=True))
    for _ in range(2):  # also when all is sent again
        (message,) = known.due()
        assert json.loads(message.payload)["components"]["speed"] == {"platform": "number"}
        known.sent(message)
        assert known.due() == []
        known.takes(incoming("homeassistant/status", b"online"))
    again = devices(follower, control=True)
    again.takes(incoming(topic, message.payload, is_retained=True))
    (message,) = again.due()
    assert "command_topic" in json.loads(message.payload)["components"]["speed"]


def test_parts_that_others_made_up_are_bounded() -> None:
    topic = "homeassistant/device/lecombus_hall-3_feeder/config"
    known = devices(Followed({"feeder": "8200vector"}))
    for strange in (b"", b"[1]", b'{"components": 1}', b'{"components": {"x": 1}}'):
        assert known.discovery.parts(strange) == {}
    (message,) = known.due()
    found = json.loads(message.payload)
    for number in range(2000):
        found["components"][f"x{number}"] = {"platform": "sensor" if number % 2 else "lock"}
    known.takes(incoming(topic, json.dumps(found).encode(), is_retained=True))
    (message,) = known.due()
    parts = json.loads(message.payload)["components"]
    assert len(parts) < 400
    assert {part["platform"] for part in parts.values()} <= set(PLATFORMS)


def incoming(topic: str, payload: bytes, *, is_retained: bool = False) -> Incoming:
    return Incoming(topic, payload, 1, is_retained, 0.0)


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter with Home Assistant."""
    return install(tmp_path_factory.mktemp("home-assistant"))


@pytest.mark.long
@pytest.mark.real
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("control", [False, True])
def test_home_assistant_takes_what_it_is_sent(python: Path, *, control: bool) -> None:
    sent = dict(documents(control=control))
    assert len(sent) == len(FAMILY_NAMES)
    assert said_of(python, sent) == []
    known = devices(Followed(), control=control)
    for topic, text in documents(control=not control):
        known.takes(incoming(topic, text.encode(), is_retained=True))
    assert said_of(python, {one.topic: one.payload.decode() for one in known.due()}) == []


@pytest.mark.long
@pytest.mark.real
@pytest.mark.timeout(1800)
def test_the_check_itself_finds_mistakes(python: Path) -> None:
    topic, text = next(documents(control=True))
    wrong = json.loads(text)
    wrong["components"]["state"]["expire_afterr"] = 5
    wrong["components"]["speed"]["command_topic"] = "a/#"
    wrong["components"]["fault"]["value_template"] = "{{ value_json."
    said = said_of(python, {topic: json.dumps(wrong)})
    assert len(said) == 3, said


def said_of(python: Path, sent: dict[str, str]) -> list[str]:
    done = subprocess.run(
        [python, HERE / "validate.py"], input=json.dumps(sent), capture_output=True, text=True,
        check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.splitlines()
