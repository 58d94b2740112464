"""The example for Home Assistant: its entities are those of the discovery, and it runs."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from home_assistant.followed import Followed, devices
from home_assistant.installed import install
from integrations.conftest import DEPLOY, Site
from lecombus.bridges.mqtt.topics import Topics
from support.daemon_host import free_port, started, until

EXAMPLE = DEPLOY / "home-assistant"
PACKAGE: dict[str, Any] = yaml.safe_load((EXAMPLE / "lecombus.yaml").read_text())
DASHBOARD: dict[str, Any] = yaml.safe_load((EXAMPLE / "dashboard.yaml").read_text())
DRIVES = {"feeder": "8200vector", "belt": "smvector"}
ENTITY = re.compile(r"\b((?:sensor|binary_sensor|button|number|script)\.[a-z0-9_]+)")
CARDS = {"entities", "history-graph"}
"""Those of Home Assistant's own cards that are used."""


def slug(text: str) -> str:
    """A name in an entity's id."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def known() -> Iterator[str]:
    """The ids of all entities, as Home Assistant makes them from names."""
    for message in devices(Followed(DRIVES), control=True).due():
        found = json.loads(message.payload)
        for part in found["components"].values():
            yield f"{part['platform']}.{slug(found['device']['name'])}_{slug(part['name'])}"
    for sensor in PACKAGE["mqtt"]["sensor"]:
        yield f"sensor.{slug(sensor['name'])}"
    for name in PACKAGE["script"]:
        yield f"script.{name}"


def leaves(found: Any) -> Iterator[str]:
    """All texts of a document."""
    if isinstance(found, dict):
        for value in found.values():
            yield from leaves(value)
    elif isinstance(found, list):
        for value in found:
            yield from leaves(value)
    elif isinstance(found, str):
        yield found


@pytest.mark.parametrize("document", [PACKAGE, DASHBOARD], ids=["package", "dashboard"])
def test_each_entity_is_one_that_home_assistant_has(document: dict[str, Any]) -> None:
    used = {one for text in leaves(document) for one in ENTITY.findall(text)}
    assert len(used) >= 5
    assert used - set(known()) == set()


def test_both_drives_and_all_that_stops_them_are_on_the_dashboard() -> None:
    shown = set(leaves(DASHBOARD))
    for drive in DRIVES:
        for part in ("state", "motion", "fault_meaning"):
            assert f"sensor.hall_3_{drive}_{part}" in shown
        assert f"button.hall_3_{drive}_quick_stop" in shown
    assert {card["type"] for view in DASHBOARD["views"] for card in view["cards"]} == CARDS


def test_its_topics_are_those_of_the_bridge() -> None:
    topics = Topics("lecombus", "hall-3")
    (sensor,) = PACKAGE["mqtt"]["sensor"]
    assert sensor["state_topic"] == topics.line_state
    assert sensor["expire_after"] > 60, "the state is said again within a minute"
    (script,) = PACKAGE["script"].values()
    (publish,) = [
        step["data"] for step in script["sequence"] if step.get("action") == "mqtt.publish"
    ]
    assert publish["topic"] == topics.do("all", "quick-stop")
    assert publish["retain"] is False


CONFIGURATION = """\
homeassistant:
  packages:
    lecombus: !include lecombus.yaml
http: {{server_host: 127.0.0.1, server_port: {port}}}
lovelace:
  dashboards:
    drives-hall-3: {{mode: yaml, title: hall-3, filename: dashboard.yaml}}
mqtt_statestream: {{base_topic: states}}
automation test:
  - alias: press
    triggers: [{{trigger: mqtt, topic: test/press}}]
    actions: [{{action: script.lecombus_hall_3_stop}}]
  - alias: say
    mode: queued
    triggers: [{{trigger: persistent_notification, update_type: [added, updated]}}]
    actions:
      - action: mqtt.publish
        data:
          topic: test/said
          payload: "{{{{ trigger.notification.title }}}}: {{{{ trigger.notification.message }}}}"
"""
"""Beside the example: what a test must see of Home Assistant, over MQTT."""


def config_entry(port: int) -> dict[str, Any]:
    """Home Assistant's broker, as its user would have entered it."""
    at = "2026-01-01T00:00:00+00:00"
    entry = {
        "created_at": at, "modified_at": at, "disabled_by": None, "discovery_keys": {},
        "domain": "mqtt", "entry_id": 26 * "0", "version": 1, "minor_version": 2, "options": {},
        "pref_disable_new_entities": False, "pref_disable_polling": False, "source": "user",
        "title": "broker", "unique_id": None,
        "data": {"broker": "127.0.0.1", "port": port, "protocol": "5", "discovery": True,
                 "discovery_prefix": "homeassistant"},
    }  # fmt: skip
    key = "core.config_entries"
    return {"version": 1, "minor_version": 4, "key": key, "data": {"entries": [entry]}}


@pytest.mark.long
@pytest.mark.real
@pytest.mark.timeout(1800)
def test_home_assistant_runs_the_example(site: Site, tmp_path: Path) -> None:
    """Its entities are there, a trip and a lost daemon are said, and the script stops the line."""
    python = install(tmp_path / "python")
    for file in EXAMPLE.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    (tmp_path / "configuration.yaml").write_text(CONFIGURATION.format(port=free_port()))
    (tmp_path / ".storage").mkdir()
    entries = json.dumps(config_entry(site.broker.port))
    (tmp_path / ".storage" / "core.config_entries").write_text(entries)
    words = [str(python), "-m", "homeassistant", "-c", str(tmp_path), "--skip-pip"]

    def said() -> list[str]:
        return [one.text for one in site.client.all("test/said")]

    def shows(entity: str, text: str) -> bool:
        return site.client.text(f"states/{entity.replace('.', '/')}/state") == text

    with started(words, tmp_path / "log"):
        until(lambda: all(shows(f"sensor.hall_3_{drive}_motion", "stopped") for drive in DRIVES),
              "the drives", within_s=120)  # fmt: skip
        assert site.daemon.cli("enable", "feeder").status == 0
        assert site.daemon.cli("set-speed", "feeder", "20", "Hz").status == 0
        until(lambda: shows("sensor.hall_3_feeder_motion", "running"), "it runs")
        site.client.publish("test/press", b"")
        until(lambda: shows("sensor.hall_3_feeder_motion", "stopped"), "the stop", within_s=30)
        until(lambda: shows("script.lecombus_hall_3_stop", "off"), "the end of the script")
        assert said() == []
        site.trip("feeder", 50)
        until(lambda: "hall-3 feeder Fault: heat sink too hot" in said(), "the trip is said")
        site.reset("feeder")
        site.daemon.tell(signal.SIGSTOP)
        try:
            until(lambda: any(one.startswith("Line hall-3 is daemon-away") for one in said()),
                  "the loss is said", within_s=40)  # fmt: skip
        finally:
            site.daemon.tell(signal.SIGCONT)
        assert "ERROR" not in (tmp_path / "log").read_text()
