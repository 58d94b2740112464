"""The converter for the ThingsBoard gateway, over what a bridge says, and in the gateway itself.

The gateway brings another paho-mqtt under the same name, so it runs in an environment of its own
(`make test-long`). Elsewhere four of its classes are replaced by what the converter uses of them.
"""

from __future__ import annotations

import json
import logging
import os
import re
import runpy
import shutil
import subprocess
import sys
import types
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from integrations.conftest import DEPLOY, ROOT, Site
from support.daemon_host import started, until
from support.mqtt_parts import broker

pytestmark = [pytest.mark.real, pytest.mark.timeout(90)]

CONVERTER = DEPLOY / "thingsboard" / "lecombus_uplink_converter.py"
CONNECTOR: dict[str, Any] = json.loads((DEPLOY / "thingsboard" / "lecombus_mqtt.json").read_text())
LOCK = Path(__file__).parents[2] / "requirements" / "thingsboard.txt"
LOG = logging.getLogger("thingsboard")


class ConvertedData:
    """As the gateway's, as far as the converter uses it."""

    def __init__(self, device_name: str, device_type: str) -> None:
        self.device_name, self.device_type = device_name, device_type
        self.attributes: dict[str, Any] = {}
        self.telemetry: list[tuple[dict[str, Any], int | None]] = []

    def add_to_attributes(self, key: str, value: Any) -> None:
        self.attributes[key] = value

    def add_to_telemetry(self, entry: tuple[dict[str, Any], int | None]) -> None:
        self.telemetry.append(entry)

    @property
    def values(self) -> dict[str, Any]:
        """All telemetry, by key."""
        return {key: value for values, _ in self.telemetry for key, value in values.items()}


@pytest.fixture
def converter(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A converter as the gateway makes one."""
    classes: dict[str, dict[str, Any]] = {
        "connectors.mqtt.mqtt_uplink_converter": {"MqttUplinkConverter": object},
        "gateway.entities.converted_data": {"ConvertedData": ConvertedData},
        "gateway.entities.datapoint_key": {"DatapointKey": str},
        "gateway.entities.telemetry_entry": {
            "TelemetryEntry": lambda values, ts=None: (values, ts)
        },
    }
    for name, found in classes.items():
        module = types.ModuleType(name)
        vars(module).update(found)
        monkeypatch.setitem(sys.modules, f"thingsboard_gateway.{name}", module)
    made = runpy.run_path(str(CONVERTER))["LecombusUplinkConverter"]
    assert {mapping["converter"]["extension"] for mapping in CONNECTOR["mapping"]} == {
        made.__name__
    }
    return made(CONNECTOR["mapping"][0], LOG)


def one(converter: Any, topic: str, data: Any) -> ConvertedData:
    (found,) = converter.convert(topic, data)
    assert isinstance(found, ConvertedData)
    return found


def test_each_topic_of_the_connector_is_one_that_the_bridge_publishes(site: Site) -> None:
    for mapping in CONNECTOR["mapping"]:
        site.heard(mapping["topicFilter"], "ThingsBoard")


@pytest.mark.parametrize("drive", ["feeder", "belt"])
def test_a_drive_is_a_device_with_its_good_values_at_the_time_of_their_reading(
    site: Site, converter: Any, drive: str
) -> None:
    document = site.document(drive)
    found = one(converter, f"{ROOT}/{drive}/json", document)
    assert (found.device_name, found.device_type) == (f"hall-3/{drive}", "lecombus drive")
    assert found.attributes["family"] == document["family"]
    assert found.attributes["C0050 unit"] == "Hz"
    good = {code: value for code, value in document["values"].items()
            if value["quality"] == "good" and value["value"] is not None}  # fmt: skip
    assert found.values == {
        "state": "online", "doing": document["motion"]["doing"], "fault": 0,
        **{code: value["value"] for code, value in good.items()},
    }  # fmt: skip
    times = {code: at_ms for values, at_ms in found.telemetry for code in values}
    for code, value in good.items():
        at_s = datetime.fromisoformat(value["time"].replace("Z", "+00:00")).timestamp()
        assert times[code] == pytest.approx(at_s * 1000, abs=0.6)


def test_what_is_not_good_is_left_out(site: Site, converter: Any) -> None:
    document = site.document("feeder")
    for number, quality in enumerate(("stale", "bad", "unknown")):
        list(document["values"].values())[number]["quality"] = quality
    left_out = list(document["values"])[:3]
    found = one(converter, f"{ROOT}/feeder/json", document)
    assert not set(left_out) & found.values.keys()
    document["fault"] = {"number": None}
    assert "fault" not in one(converter, f"{ROOT}/feeder/json", document).values
    document["fault"] = {"number": 50}
    assert one(converter, f"{ROOT}/feeder/json", document).values["fault"] == 50
    for fault in (None, {"number": 50}):  # as last known: the drive is silent
        document |= {"state": "offline", "states": None, "fault": fault}
        assert "fault" not in one(converter, f"{ROOT}/feeder/json", document).values


def test_states_are_telemetry_and_what_is_not_ours_says_nothing(converter: Any) -> None:
    line = one(converter, f"{ROOT}/state", "offline")
    assert (line.device_name, line.values) == ("hall-3", {"state": "offline"})
    drive = one(converter, f"{ROOT}/feeder/state", "unknown")
    assert (drive.device_name, drive.values) == ("hall-3/feeder", {"state": "unknown"})
    for topic, data in ((f"{ROOT}/feeder/json", ""), (f"{ROOT}/state", ""), ("a/b/json", "x"),
                        (f"{ROOT}/feeder/json", [1]), ("a", {})):  # fmt: skip
        assert converter.convert(topic, data) == []


def test_a_stop_goes_where_the_bridge_takes_it(site: Site) -> None:
    calls = CONNECTOR["requestsMapping"]["serverSideRpc"]
    for device, target in (("hall-3/feeder", "feeder"), ("hall-3", "all")):
        (call,) = [one for one in calls if re.search(one["deviceNameFilter"], device)]
        assert re.search(call["methodFilter"], "quickStop")
        topic = call["requestTopicExpression"].replace("${deviceName}", device)
        assert topic == f"{ROOT}/{target}/do/quick-stop"
    assert CONNECTOR["mapping"][0]["converter"]["deviceInfo"], "else the gateway drops the calls"


RUN = """
import os, sys
os.chdir(sys.argv.pop())
from thingsboard_gateway.tb_gateway import main
main()
"""
NO_LIMITS = dict.fromkeys(("messages", "telemetryMessages", "telemetryDataPoints"), "0:0,")
SESSION = {"maxPayloadSize": 65536, "maxInflightMessages": 100, "rateLimits": NO_LIMITS,
           "gatewayRateLimits": NO_LIMITS}  # fmt: skip
"""What ThingsBoard answers to a gateway that connects."""


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter with the gateway from its lock, and our converter where it looks for it."""
    folder = tmp_path_factory.mktemp("gateway")
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / "bin" / "python"
    blocks = re.split(r"\n(?=\S)", LOCK.read_text())
    tools = folder / "tools.txt"
    tools.write_text("\n".join(one for one in blocks if one.startswith("setuptools==")))
    words = ["-m", "pip", "install", "-qq", "--require-hashes", "--no-deps", "--no-build-isolation"]
    install = [str(python), *words]
    subprocess.run([*install, "-r", tools], check=True)
    subprocess.run([*install, "-r", LOCK], check=True)
    (extensions,) = folder.glob("lib/python3*/site-packages/thingsboard_gateway/extensions/mqtt")
    shutil.copy(CONVERTER, extensions)
    return python


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_gateway_sends_good_values_and_stops_a_drive(
    site: Site, gateway: Path, tmp_path: Path
) -> None:
    """A broker takes the place of ThingsBoard, which speaks MQTT with the gateway."""
    shipped = next(gateway.parents[1].glob("lib/python3*/site-packages/thingsboard_gateway/config"))
    with broker(tmp_path) as platform, platform.client("v1/#") as client:
        connector = CONNECTOR | {"name": "lecombus"}
        connector["broker"] = CONNECTOR["broker"] | {"port": site.broker.port}
        (tmp_path / "lecombus_mqtt.json").write_text(json.dumps(connector))
        settings = json.loads((shipped / "tb_gateway.json").read_text())
        settings["thingsboard"] |= {
            "host": "127.0.0.1", "port": platform.port, "remoteConfiguration": False,
            "statistics": {"enable": False},
        }  # fmt: skip
        settings["connectors"] = [
            {"name": "lecombus", "type": "mqtt", "configuration": "lecombus_mqtt.json"}
        ]
        (tmp_path / "tb_gateway.json").write_text(json.dumps(settings))
        shutil.copy(shipped / "logs.json", tmp_path)
        (tmp_path / "logs").mkdir()
        # It asks for newer versions of itself: that shall end on this machine.
        nowhere = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
        env = {**os.environ, **nowhere, "TB_GW_CONFIG_DIR": str(tmp_path)}
        with started([str(gateway), "-c", RUN, str(tmp_path)], tmp_path / "log", env=env):
            asked = until(lambda: client.all("v1/devices/me/rpc/request/1"), "it connects",
                          within_s=60)[0].topic  # fmt: skip
            client.publish(asked.replace("request", "response"), json.dumps(SESSION), qos=1)

            def telemetry(device: str) -> dict[str, Any]:
                found: dict[str, Any] = {}
                for heard in client.all("v1/gateway/telemetry"):
                    for entry in json.loads(heard.text).get(device, ()):
                        found |= entry["values"]
                return found

            until(lambda: "C0050" in telemetry("hall-3/feeder"), "values", within_s=60)
            assert telemetry("hall-3/feeder")["state"] == "online"
            assert telemetry("hall-3") == {"state": "online"}
            assert site.daemon.cli("enable", "feeder").status == 0
            call = {"device": "hall-3/feeder",
                    "data": {"id": 1, "method": "quickStop", "params": {}}}  # fmt: skip
            client.publish("v1/gateway/rpc", json.dumps(call), qos=1)
            until(lambda: "quick stop" in site.daemon.cli("status").out, "the drive is stopped")
