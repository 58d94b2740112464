"""The flow for Node-RED: its functions over what a real bridge says, and all of it in Node-RED."""

from __future__ import annotations

import base64
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import httpx2
import pytest

from integrations.conftest import DEPLOY, ROOT, Site
from support.daemon_host import free_port, started, until
from support.mqtt_parts import Heard
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.timeout(90)]

HERE = Path(__file__).parent
FLOW: list[dict[str, Any]] = json.loads((DEPLOY / "node-red" / "flow.json").read_text())
NODES = {node["id"].removeprefix("lecombus-"): node for node in FLOW}


def said_by(*steps: dict[str, Any] | str) -> list[dict[str, Any]]:
    """Run functions one after the other: a function with its message, or `later`: its timers."""
    written = [
        {"later": True} if isinstance(step, str)
        else {**step, "func": NODES[step["id"]]["func"], "outputs": NODES[step["id"]]["outputs"]}
        for step in steps
    ]  # fmt: skip
    done = subprocess.run(
        [require("node"), HERE / "run_functions.js"], input=json.dumps(written),
        capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found


def buffer(data: bytes | None) -> dict[str, str]:
    return {"buffer": base64.b64encode(data or b"").decode()}


def incoming(heard: Heard) -> dict[str, Any]:
    """A message as a node `mqtt in` gives it."""
    msg: dict[str, Any] = {
        "topic": heard.topic, "payload": buffer(heard.text.encode()), "userProperties": heard.said,
    }  # fmt: skip
    if heard.expiry_s is not None:
        msg["messageExpiryInterval"] = heard.expiry_s
    if heard.correlation is not None:
        msg["correlationData"] = buffer(heard.correlation)
    return msg


def newest(site: Site, topic: str) -> Heard:
    found = site.client.last(topic)
    assert found is not None
    return found


def test_the_flow_hangs_together_and_listens_where_the_bridge_speaks(site: Site) -> None:
    ids = {node["id"] for node in FLOW}
    (broker,) = [node for node in FLOW if node["type"] == "mqtt-broker"]
    assert broker["protocolVersion"] == "5"
    assert broker["cleansession"] is True
    for node in FLOW:
        assert {one for wires in node.get("wires", ()) for one in wires} <= ids
        if node["type"] in ("mqtt in", "mqtt out"):
            assert node["broker"] == broker["id"]
        if node["type"] == "function":
            assert len(node["wires"]) == node["outputs"]
    site.client.publish(NODES["answers"]["topic"], "an answer")
    for name in ("json", "line-state", "drive-state", "answers"):
        site.heard(NODES[name]["topic"], "Node-RED")


def test_good_values_are_shown_and_what_is_stale_is_left_out(site: Site) -> None:
    document = site.document("feeder")
    good = {code for code, one in document["values"].items() if one["quality"] == "good"}
    heard = newest(site, f"{ROOT}/feeder/json")
    altered = json.loads(heard.text)
    altered["values"]["C0150"]["quality"] = "stale"
    msg = incoming(heard)
    other = {**msg, "payload": buffer(json.dumps(altered).encode())}
    gone = {**msg, "payload": buffer(b"")}
    first, second, third = said_by(*({"id": "values", "msg": one} for one in (msg, other, gone)))
    (shown,) = first["sent"]
    assert {one["code"] for one in shown} >= good - {"C0150"}
    (value,) = [one for one in shown if one["code"] == "C0050"]
    assert (value["topic"], value["payload"], value["unit"]) == ("feeder/C0050", 0, "Hz")
    assert value["time"].endswith("Z")
    assert "C0150" not in {one["code"] for one in second["sent"][0]}
    assert third["sent"] == [[]]


def test_a_drive_of_which_nothing_new_comes_is_not_known_any_more(site: Site) -> None:
    site.document("feeder")
    msg = incoming(newest(site, f"{ROOT}/feeder/json"))
    assert msg["messageExpiryInterval"] >= 1, "how long it is good"
    late = {**msg, "messageExpiryInterval": -5}
    quiet, _, known, _, unknown, again = (
        one["sent"][0] for one in said_by(
            {"id": "stale"}, {"id": "values", "msg": msg}, {"id": "stale"},
            {"id": "values", "msg": late}, {"id": "stale"}, {"id": "stale"},
        )
    )  # fmt: skip
    assert (quiet, known, again) == ([], [], [])
    assert [(one["topic"], one["payload"]) for one in unknown] == [("feeder", None)]


def test_states_and_trips_are_shown_with_what_to_do(site: Site) -> None:
    states = [newest(site, f"{ROOT}/state"), newest(site, f"{ROOT}/feeder/state")]
    shown = said_by(*({"id": "state", "msg": incoming(one)} for one in states))
    assert [one["sent"][0][0]["topic"] for one in shown] == ["line hall-3", "feeder"]
    assert {one["sent"][0][0]["payload"] for one in shown} == {"online"}

    before = len(site.client.all(f"{ROOT}/feeder/event"))
    site.trip("feeder", 50)

    def texts() -> list[str]:
        events = site.client.all(f"{ROOT}/feeder/event")[before:]
        found = said_by(*({"id": "trip", "msg": incoming(one)} for one in events))
        return [one["payload"] for step in found for one in step["sent"][0]]

    until(lambda: any("heat sink" in text for text in texts()), "the trip with its meaning")
    assert texts()[0].startswith("feeder has tripped")
    assert "(50)" in texts()[-1]
    site.heard(NODES["events"]["topic"], "Node-RED")
    site.reset("feeder")
    until(lambda: texts()[-1] == "feeder: no trip any more", "the end of the trip")


def test_a_stop_is_sent_and_its_outcome_is_known(site: Site) -> None:
    assert site.daemon.cli("enable", "feeder").status == 0
    (asked,) = said_by({"id": "stop"})
    ((command,), others) = asked["sent"]
    assert others == []
    correlation = base64.b64decode(command["correlationData"]["buffer"])
    site.client.publish(
        command["topic"], command["payload"], qos=command["qos"], retain=command["retain"],
        response=command["responseTopic"], correlation=correlation,
    )  # fmt: skip
    until(lambda: correlation in {
        one.correlation for one in site.client.all(command["responseTopic"])
    }, "the answer")  # fmt: skip
    answer = next(one for one in site.client.all(command["responseTopic"])
                  if one.correlation == correlation)  # fmt: skip
    assert "stopped" in site.daemon.cli("status").out
    known = f'flow.set("stop", "{correlation.decode()}");'

    def outcome(document: dict[str, Any] | None = None, key: bytes = correlation) -> list[Any]:
        msg = incoming(answer) | {"correlationData": buffer(key)}
        if document is not None:
            msg["payload"] = buffer(json.dumps(document).encode())
        step = {"id": "outcome", "msg": msg}
        func = NODES["outcome"]["func"]
        try:
            NODES["outcome"]["func"] = known + func
            found: list[Any] = said_by(step)[0]["sent"][0]
        finally:
            NODES["outcome"]["func"] = func
        return found

    (shown,) = outcome()
    assert (shown["outcome"], shown["payload"]) == ("verified", "stop: verified, all drives")
    assert outcome(key=b"another") == []
    document = json.loads(answer.text)
    document["members"][1] |= {"outcome": "unknown", "reason": "no answer"}
    (shown,) = outcome(document)
    assert shown["payload"] == "stop: NOT proven: belt (unknown: no answer)"
    (shown,) = outcome({"outcome": "refused", "reason": "the daemon is away"})
    assert shown["payload"] == "stop: NOT proven: the daemon is away"


def test_a_stop_without_an_answer_is_not_taken_for_one() -> None:
    first, later = said_by({"id": "stop"}, "later")
    assert first["sent"][1] == []
    ((), (shown,)) = later["sent"]
    assert shown["outcome"] == "unknown"
    assert "may still turn" in shown["payload"]


SETTINGS = """\
module.exports = {{flowFile: "flow.json", uiHost: "127.0.0.1", uiPort: {port},
    credentialSecret: false, diagnostics: {{enabled: false}}, telemetry: {{enabled: false}}}};
"""


@pytest.mark.long
@pytest.mark.timeout(600)
def test_node_red_runs_the_flow(site: Site, tmp_path: Path) -> None:
    """Node-RED from the npm lock: values, a trip, and a stop by its button."""
    for name in ("package.json", "package-lock.json"):
        (tmp_path / name).write_text((HERE / "node_red" / name).read_text())
    words = ("ci", "--ignore-scripts", "--no-audit", "--no-fund")
    subprocess.run([require("npm"), *words], cwd=tmp_path, check=True, timeout=300)
    port, log = free_port(), tmp_path / "log"
    for node in FLOW:
        node |= {"console": True} if node["type"] == "debug" else {}
        node |= {"port": str(site.broker.port)} if node["type"] == "mqtt-broker" else {}
    (tmp_path / "flow.json").write_text(json.dumps(FLOW))
    (tmp_path / "settings.js").write_text(SETTINGS.format(port=port))
    program = [
        str(require("node")),
        str(tmp_path / "node_modules/node-red/red.js"),
        "-u",
        str(tmp_path),
    ]

    def says(pattern: str) -> bool:
        return re.search(pattern, log.read_text(), re.DOTALL) is not None

    with started(program, log):
        until(lambda: says("Connected to broker"), "Node-RED runs the flow", within_s=60)
        until(lambda: says(r"debug:values\].*?topic: 'feeder/C0050'"), "a value")
        until(lambda: says(r"debug:states\].*?'line hall-3'.*?'online'"), "the line")
        site.trip("feeder", 50)
        until(lambda: says(r"debug:trips\].*?feeder has tripped: OH \(50\) heat sink"), "the trip")
        site.reset("feeder")
        assert site.daemon.cli("enable", "feeder").status == 0
        press = httpx2.post(f"http://127.0.0.1:{port}/inject/lecombus-press", trust_env=False)
        assert press.status_code == 200
        until(lambda: says("stop: verified, all drives"), "the outcome")
        assert "quick stop" in site.daemon.cli("status").out
        assert not says(r"\[error\]")
