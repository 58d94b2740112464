"""The MQTT bridge between a real broker and a real daemon: what it shows, what it carries out."""

from __future__ import annotations

import gc
import json
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import anyio
import pytest

from lecombus.bridges.mqtt.broker import BrokerError, Limits, WillLimits, open_broker
from lecombus.bridges.mqtt.retained import Message
from lecombus.roster import MqttEntry
from support.certificates import make_certificates
from support.daemon_host import Daemon, running, short_dir, until
from support.mqtt_parts import Bridge, Broker, MqttClient, bridge, broker
from support.real_parts import require
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(90)]

DRIVES: tuple[Wanted, ...] = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))
ROOT = "lecombus/test"


def roster(port: int, folder: Path, *, control: bool = True, more: str = "") -> str:
    keys = f"host: 127.0.0.1, port: {port}, tls: no, control: {'yes' if control else 'no'}{more}"
    return roster_text(
        DRIVES, folder=folder, sections=f"mqtt: {{{keys}}}\njournal: {folder / 'journal.sqlite'}"
    )


@contextmanager
def served(
    folder: Path, *, control: bool = True, more: str = "", broker_more: str = ""
) -> Iterator[tuple[Broker, Daemon, Bridge]]:
    """A broker, a daemon with two simulated drives that are online, and a bridge."""
    with (
        broker(folder, more=broker_more) as message_broker,
        running(roster(message_broker.port, folder, control=control, more=more), folder) as daemon,
        bridge(folder) as its_bridge,
    ):
        daemon.until_online()
        yield message_broker, daemon, its_bridge


def shows(client: MqttClient, topic: str, text: str) -> None:
    until(lambda: client.text(f"{ROOT}/{topic}") == text, f"{topic} shows {text}")


def test_what_is_known_stands_at_the_broker_for_as_long_as_it_is_fresh() -> None:
    with (
        short_dir() as folder,
        served(folder) as (message_broker, daemon, its_bridge),
        message_broker.client(f"{ROOT}/#") as client,
    ):
        shows(client, "state", "online")
        shows(client, "feeder/state", "online")
        until(lambda: client.last(f"{ROOT}/feeder/value/C0050"), "a value")
        value = client.last(f"{ROOT}/feeder/value/C0050")
        assert value is not None
        assert value.text == "0"
        assert value.said["unit"] == "Hz"
        assert value.said["quality"] == "good"
        assert 1 <= (value.expiry_s or 0) <= 5  # read every 2 s: stale after 5 s
        document = json.loads(client.text(f"{ROOT}/feeder/json") or "")
        assert document["values"]["C0050"]["quality"] == "good"
        assert document["values"]["C0050"]["age_s"] < 5

        daemon.tell(signal.SIGSTOP)
        shows(client, "state", "daemon-away")
        shows(client, "feeder/state", "unknown")
        until(lambda: client.text(f"{ROOT}/feeder/value/C0050") == "", "the value is removed")
        until(lambda: not message_broker.standing(f"{ROOT}/+/value/#"), "all values are removed")
        daemon.tell(signal.SIGCONT)
        shows(client, "state", "online")
        until(lambda: client.text(f"{ROOT}/feeder/value/C0050") == "0", "the value is back")

        # Nobody removes anything now: the broker itself must drop what is not refreshed.
        its_bridge.process.send_signal(signal.SIGSTOP)
        until(
            lambda: not any("/value/C0050" in topic
                            for topic in message_broker.standing(f"{ROOT}/+/value/C0050")),
            "the broker drops values", within_s=8,
        )  # fmt: skip
        its_bridge.process.kill()
        shows(client, "state", "offline")


def test_commands_have_the_outcomes_of_http_and_are_carried_out_once() -> None:
    with short_dir() as folder, served(folder) as (message_broker, daemon, its_bridge):
        with message_broker.client("answers/test", f"{ROOT}/#") as client:
            shows(client, "feeder/state", "online")
            answer = client.ask(f"{ROOT}/feeder/set/C0046", "20.5", correlation=b"a")
            assert (answer.correlation, answer.said["outcome"]) == (b"a", "done")
            again = client.ask(f"{ROOT}/feeder/set/C0046", "20.5", correlation=b"a")
            assert json.loads(again.text) == {**json.loads(answer.text), "repeated": True}
            body = '{"value": 21, "verify": true, "expires": "2s"}'
            assert client.ask(f"{ROOT}/feeder/set/C0046", body).said["outcome"] == "verified"
            assert client.ask(f"{ROOT}/feeder/do/enable").said["outcome"] == "verified"
            refused = json.loads(client.ask(f"{ROOT}/feeder/set/C0011", "60").text)
            assert (refused["outcome"], refused["kind"]) == ("refused", "not-writable")
            for kind, topic, payload, more in (
                ("retained", "feeder/do/enable", "", {"retain": True}),
                ("no-key", "feeder/do/enable", "", {"qos": 1}),
                ("bad-value", "feeder/do/enable", "OFF", {}),
                ("no-such-drive", "nobody/do/enable", "", {}),
            ):
                said = json.loads(client.ask(f"{ROOT}/{topic}", payload, **more).text)
                assert (said["outcome"], said["kind"]) == ("refused", kind)
            stop = client.ask(f"{ROOT}/all/do/quick-stop", "any")
            assert stop.said["outcome"] == "verified"

            # What came while the bridge stood is old when it goes on.
            its_bridge.process.send_signal(signal.SIGSTOP)
            client.publish(f"{ROOT}/belt/do/enable", response="answers/test", expiry_s=3)
            time.sleep(4)  # the command for the belt is over then
            before = len(client.all("answers/test"))
            its_bridge.process.send_signal(signal.SIGCONT)
            until(lambda: len(client.all("answers/test")) > before, "an answer")
            said = json.loads(client.all("answers/test")[before].text)
            assert (said["target"], said["outcome"]) == ("belt", "expired")
        rows = daemon.get("/v1/journal?last=true&limit=50")["rows"]
        writes = [row for row in rows if row["what"] == "write" and row.get("asked")]
        from_mqtt = [row for row in writes if row["fields"].get("client") == "mqtt"]
        assert {row["fields"]["process"] for row in from_mqtt} == {"lecombus-mqtt"}
        assert sum(row["fields"].get("value") == "20.5" for row in from_mqtt) == 1


def test_a_broker_that_was_away_gets_all_events_and_the_newest_values() -> None:
    with (
        short_dir() as folder,
        broker(folder) as message_broker,
        running(roster(message_broker.port, folder), folder) as daemon,
    ):
        with message_broker.client(f"{ROOT}/feeder/event", session="reader"):
            pass
        message_broker.end()
        with bridge(folder) as its_bridge:
            daemon.until_online()
            until(
                lambda: sum(daemon.metric("lecombus_event_readers{").values()) == 1,
                "the bridge reads events",
            )
            daemon.cli("write", "feeder", "C0046", "11")
            files = [folder / "mqtt" / name for name in ("events.1", "events.2")]
            until(
                lambda: any('\\"11\\"' in file.read_text() for file in files if file.exists()),
                "the write is on the disk",
            )
            its_bridge.process.terminate()
            assert its_bridge.process.wait(8) == 0
        daemon.cli("write", "feeder", "C0046", "12")
        with bridge(folder) as its_bridge:
            until(
                lambda: sum(daemon.metric("lecombus_event_readers{").values()) == 1,
                "the bridge reads events again",
            )
            daemon.cli("write", "feeder", "C0046", "13")
            message_broker.start()
            until(lambda: "event=mqtt-connected" in its_bridge.log(), "it has the broker again")
            message_broker.end()
            until(lambda: "event=mqtt-lost" in its_bridge.log(), "the loss is logged")
            daemon.cli("write", "feeder", "C0046", "14")
            message_broker.start()
            with message_broker.client(session="reader") as reader:
                until(lambda: "14" in written(reader), "the writes of the outages", within_s=20)
                assert list(dict.fromkeys(written(reader))) == ["11", "12", "13", "14"]
            with message_broker.client(f"{ROOT}/#") as client:
                shows(client, "state", "online")
                until(lambda: client.text(f"{ROOT}/feeder/value/C0050"), "a value")
                its_bridge.process.terminate()
                assert its_bridge.process.wait(8) == 0
                shows(client, "state", "offline")
                said = client.last(f"{ROOT}/state")
                assert said is not None
                assert said.said["reason"] == "the bridge has ended"
                assert client.text(f"{ROOT}/feeder/state") == "unknown"


def written(client: MqttClient) -> list[str]:
    """The values that were written to C0046, as events say it."""
    said = [json.loads(one.text) for one in client.all(f"{ROOT}/feeder/event")]
    return [one["value"] for one in said if one["kind"] == "write" and one.get("code") == "C0046"]


# What paho leaves open when a handshake fails, the garbage collector closes.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_tls_certificate_password_and_limits_of_a_real_broker(tmp_path: Path) -> None:
    made = make_certificates(tmp_path)
    (tmp_path / "password").write_text("right\n")
    subprocess.run(
        [require("mosquitto_passwd"), "-b", "-c", tmp_path / "users", "hall-3", "right"],
        check=True, capture_output=True,
    )  # fmt: skip
    rows = (f"cafile {made.path('ca.pem')}", f"certfile {made.path('server.pem')}",
            f"keyfile {made.path('server.key')}", "require_certificate true",
            f"password_file {tmp_path / 'users'}", "max_inflight_messages 3",
            "max_packet_size 2000")  # fmt: skip
    with broker(tmp_path, more="\n".join(rows), anonymous=False) as message_broker:
        right = MqttEntry(
            host="localhost", port=message_broker.port, ca=str(made.path("ca.pem")),
            certificate=str(made.path("plc.pem")), key=str(made.path("plc.key")),
            username="hall-3", password_file=str(tmp_path / "password"),
        )  # fmt: skip
        limits, sent = anyio.run(connected, right)
        assert (limits.receive_maximum, limits.packet_bytes, limits.qos) == (3, 2000, 2)
        assert sent == [True, False]  # the second is larger than the broker takes
        (tmp_path / "wrong").write_text("wrong\n")
        for key, file in (("password_file", "wrong"), ("certificate", None), ("ca", None)):
            given = {key: None if file is None else str(tmp_path / file)}
            if key == "certificate":
                given["key"] = None
            with pytest.raises(BrokerError):
                anyio.run(connected, right.model_copy(update=given))
        with pytest.raises(BrokerError):  # the certificate is not for this name
            anyio.run(connected, right.model_copy(update={"host": "127.0.0.2"}))
        gc.collect()


async def connected(entry: MqttEntry) -> tuple[Limits, list[bool]]:
    """Connect, and send a small and a large message."""
    will = Message("test/will", b"gone", 1)
    async with open_broker(entry, "test", will, WillLimits(), lambda incoming: None) as found:
        sent = [await found.publish(Message("test/a", size * b"x", 1)) for size in (10, 5000)]
        for number in range(10):
            await found.publish(Message(f"test/{number}", b"x", 1))
        return found.limits, sent


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_of_a_thousand_commands_sent_twice_each_is_carried_out_once() -> None:
    """With QoS 1 and correlation data; broker and bridge are started again in between."""
    with short_dir() as folder, served(folder) as (message_broker, daemon, its_bridge):
        with message_broker.client("answers/test", f"{ROOT}/feeder/state") as client:
            shows(client, "feeder/state", "online")
            send_twice(client, range(400))
        message_broker.end()
        message_broker.start()
        until(lambda: its_bridge.log().count("mqtt-connected") == 2, "connected", within_s=60)
        with message_broker.client("answers/test") as client:
            send_twice(client, range(300, 700))
            its_bridge.process.kill()
            its_bridge.process.wait()
            with bridge(folder) as another:
                until(lambda: "mqtt-connected" in another.log(), "connected", within_s=60)
                send_twice(client, range(1000))
        counts = Counter(
            row["fields"]["value"] for row in journal_rows(daemon)
            if row["what"] == "write" and row["fields"].get("client") == "mqtt"
        )  # fmt: skip
        assert len(counts) > 900
        assert max(counts.values()) == 1


def send_twice(client: MqttClient, numbers: range) -> None:
    """Send commands with values of their own, each twice, and wait for the answers to the last."""
    for number in numbers:
        for _ in range(2):
            client.publish(
                f"{ROOT}/feeder/set/C0046", f"{number / 50:.2f}", qos=1, expiry_s=3000,
                correlation=f"{number}".encode(), response="answers/test",
            )  # fmt: skip
        if number % 40 == 39:  # no more may wait for one drive
            until_answered(client, f"{number}-{time.monotonic()}".encode())


def until_answered(client: MqttClient, correlation: bytes) -> None:
    """Wait until all commands for the drive that were sent before are answered."""
    client.publish(f"{ROOT}/feeder/do/none", response="answers/test", correlation=correlation)
    until(
        lambda: any(one.correlation == correlation for one in client.all("answers/test")),
        "all before are answered", within_s=300,
    )  # fmt: skip


def journal_rows(daemon: Daemon) -> list[dict[str, Any]]:
    """The ends of all that was asked, in order."""
    rows: list[dict[str, Any]] = []
    after = 0
    while True:
        page = daemon.get(f"/v1/journal?after={after}&limit=500")
        rows += [row for row in page["rows"] if row.get("asked")]
        if page["next"] is None:
            return rows
        after = page["next"]
