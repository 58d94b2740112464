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


def roster(
    port: int,
    folder: Path,
    *,
    control: bool = True,
    more: str = "",
    drives: tuple[Wanted, ...] = DRIVES,
    drive: str = "",
) -> str:
    keys = f"host: 127.0.0.1, port: {port}, tls: no, control: {'yes' if control else 'no'}{more}"
    names = ", ".join(name for name, _, _ in drives)
    sections = (
        f"mqtt: {{{keys}}}", f"journal: {folder / 'journal.sqlite'}",
        f"groups: {{pair: {{members: [{names}]}}}}",
    )  # fmt: skip
    return roster_text(drives, folder=folder, drive=drive, sections="\n".join(sections))


@contextmanager
def served(
    folder: Path, *, broker_more: str = "", **keys: Any
) -> Iterator[tuple[Broker, Daemon, Bridge]]:
    """A broker, a daemon with two simulated drives that are online, and a bridge."""
    with (
        broker(folder, more=broker_more) as message_broker,
        running(roster(message_broker.port, folder, **keys), folder) as daemon,
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

        def documented() -> dict[str, Any]:
            document = json.loads(client.text(f"{ROOT}/feeder/json") or "{}")
            value: dict[str, Any] = document.get("values", {}).get("C0050", {})
            return value if value.get("quality") == "good" else {}  # bad while it is starting

        assert until(documented, "the document")["age_s"] < 5

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
            both = dict.fromkeys(("feeder", "belt"), "verified")
            for target in ("pair", "all"):
                body = '{"value": 0, "verify": true}'
                said = json.loads(client.ask(f"{ROOT}/{target}/set/C0040", body).text)
                assert outcomes(said) == both, said
                said = json.loads(client.ask(f"{ROOT}/{target}/set/C0046", "17").text)
                assert (said["outcome"], said["kind"]) == ("refused", "not-writable"), "of the belt"
                for verb in ("inhibit", "quick-stop"):
                    stop = client.ask(f"{ROOT}/{target}/do/{verb}", "any")
                    assert stop.said["outcome"] == "verified"
                    assert outcomes(json.loads(stop.text)) == both
            started = json.loads(client.ask(f"{ROOT}/pair/do/enable").text)
            assert started["outcome"] == "refused", "a group is not enabled"

            # What came while the bridge stood is old when it goes on: also the later ones, whose
            # handshake ends after the next pulse.
            its_bridge.process.send_signal(signal.SIGSTOP)
            for _ in range(4):
                client.publish(f"{ROOT}/belt/do/enable", response="answers/test", expiry_s=3)
            time.sleep(4)  # the commands for the belt are over then
            before = len(client.all("answers/test"))
            its_bridge.process.send_signal(signal.SIGCONT)
            until(lambda: len(client.all("answers/test")) >= before + 4, "all answers")
            for one in client.all("answers/test")[before:]:
                said = json.loads(one.text)
                assert (said["target"], said["outcome"]) == ("belt", "expired")
        rows = daemon.get("/v1/journal?last=true&limit=50")["rows"]
        writes = [row for row in rows if row["what"] == "write" and row.get("asked")]
        from_mqtt = [row for row in writes if row["fields"].get("client") == "mqtt"]
        assert {row["fields"]["process"] for row in from_mqtt} == {"lecombus-mqtt"}
        assert sum(row["fields"].get("value") == "20.5" for row in from_mqtt) == 1


def outcomes(answer: dict[str, Any]) -> dict[str, str]:
    """The outcome of each drive of a group."""
    return {one["drive"]: one["outcome"] for one in answer["members"]}


def test_home_assistant_hears_of_all_drives_after_its_birth_and_of_none_that_left() -> None:
    own = "homeassistant/device/lecombus_test_{}/config"
    with (
        short_dir() as folder,
        served(folder, more=", home_assistant: homeassistant") as (message_broker, daemon, _),
        message_broker.client("homeassistant/#") as client,
    ):

        def known(name: str) -> int:
            return sum(bool(one.text) for one in client.all(own.format(name)))

        until(lambda: known("feeder") and known("belt"), "both drives are known")
        parts = json.loads(client.text(own.format("feeder")) or "")["components"]
        assert {"state", "problem", "C0050", "speed", "quick_stop"} <= parts.keys()
        until(lambda: set(message_broker.standing("homeassistant/device/#")) == {
            own.format("feeder"), own.format("belt")}, "they stand at the broker")  # fmt: skip

        before = known("feeder"), known("belt")
        client.publish("homeassistant/status", b"online")
        until(lambda: known("feeder") > before[0] and known("belt") > before[1], "sent again")

        (folder / "roster.yaml").write_text(
            roster(message_broker.port, folder, more=", home_assistant: homeassistant",
                   drives=DRIVES[:1])
        )  # fmt: skip
        assert daemon.cli("reload").status == 0
        until(lambda: client.text(own.format("belt")) == "", "the drive that left is removed")
        assert list(message_broker.standing("homeassistant/device/#")) == [own.format("feeder")]
        until(lambda: not message_broker.standing(f"{ROOT}/belt/#"), "nothing stands of it")
        assert client.text(own.format("feeder")) != ""


def test_an_outage_longer_than_values_are_good_shows_nothing_old_and_repeats_nothing() -> None:
    """What an hour would do: all that stood is old, and senders send again what was carried out.

    The broker keeps what is retained on its disk and is killed; the bridge stands still, so that
    nothing but the broker itself can drop what is old.
    """
    fast = "cyclic: [{code: C0050, every: 500ms}]"  # stale after 2 s
    numbers = range(20)
    with short_dir() as folder, served(folder, drive=fast) as (message_broker, daemon, its_bridge):
        with message_broker.client("answers/test", f"{ROOT}/#") as client:
            shows(client, "feeder/state", "online")
            until(lambda: client.text(f"{ROOT}/feeder/value/C0050"), "a value")
            state = client.last(f"{ROOT}/state")
            assert state is not None
            assert 1 <= (state.expiry_s or 0) <= 60, "nor does the line look alive for ever"
            send_twice(client, numbers)
            its_bridge.process.send_signal(signal.SIGSTOP)
            time.sleep(1.2)  # the broker saves once a second
        message_broker.end(kill=True)
        time.sleep(2)
        message_broker.start()
        assert message_broker.standing(f"{ROOT}/state"), "it has kept what was retained"
        stands = message_broker.standing(f"{ROOT}/+/value/#")
        assert [topic for topic in stands if topic.endswith("/C0050")] == []
        for topic, one in stands.items():  # read once, and good for longer: its time ran on
            before = client.last(topic)
            assert before is not None
            assert one.expiry_s is not None
            assert before.expiry_s is not None
            assert one.expiry_s <= before.expiry_s - (one.at_s - before.at_s) + 1
        assert message_broker.standing(f"{ROOT}/+/json") == {}
        with message_broker.client("answers/test", f"{ROOT}/#") as client:
            send_twice(client, numbers, wait=False)  # nobody is there to take them
            its_bridge.process.send_signal(signal.SIGCONT)
            until(lambda: client.text(f"{ROOT}/feeder/value/C0050"), "a value", within_s=30)
            send_twice(client, numbers)
            again = [json.loads(one.text) for one in client.all("answers/test")]
            assert len(again) >= 2 * len(numbers)
            assert all(one["repeated"] for one in again if one.get("code"))
        assert carried_out(daemon) == Counter({f"{number / 50:g}": 1 for number in numbers})


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
    for name in ("right", "wrong"):
        (tmp_path / name).touch(mode=0o600)
        (tmp_path / name).write_text(f"{name}\n")
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
            username="hall-3", password_file=str(tmp_path / "right"),
        )  # fmt: skip
        limits, sent = anyio.run(connected, right)
        assert (limits.receive_maximum, limits.packet_bytes, limits.qos) == (3, 2000, 2)
        assert sent == [True, False]  # the second is larger than the broker takes
        for key, file in (("password_file", "wrong"), ("certificate", None), ("ca", None)):
            given = {key: None if file is None else str(tmp_path / file)}
            if key == "certificate":
                given["key"] = None
            with pytest.raises(BrokerError):
                anyio.run(connected, right.model_copy(update=given))
        with pytest.raises(BrokerError):  # the certificate is not for this name
            anyio.run(connected, right.model_copy(update={"host": "127.0.0.2"}))
        gc.collect()


def test_what_the_broker_does_not_let_the_bridge_send_is_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "acl").write_text("topic readwrite test/may/#\n")

    async def send(entry: MqttEntry) -> list[bool]:
        async with open_broker(entry, "test", None, WillLimits(), lambda incoming: None) as found:
            topics = ("test/may/a", "test/must-not/a", "test/must-not/b", "test/may/b")
            return [await found.publish(Message(topic, b"x", 1)) for topic in topics]

    with broker(tmp_path, more=f"acl_file {tmp_path / 'acl'}") as message_broker:
        entry = MqttEntry(host="127.0.0.1", port=message_broker.port, tls=False)
        assert anyio.run(send, entry) == [True, False, False, True]
    said = [record.getMessage() for record in caplog.records]
    assert said == ["event=mqtt-refused topic=test/must-not/a reason=Not authorized"]


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
        counts = carried_out(daemon)
        assert len(counts) > 900
        assert max(counts.values()) == 1


def carried_out(daemon: Daemon) -> Counter[str]:
    """How often each value was written by MQTT."""
    return Counter(
        row["fields"]["value"] for row in journal_rows(daemon)
        if row["what"] == "write" and row["fields"].get("client") == "mqtt"
    )  # fmt: skip


def send_twice(client: MqttClient, numbers: range, *, wait: bool = True) -> None:
    """Send commands with values of their own, each twice, and wait for the answers to the last."""
    for number in numbers:
        for _ in range(2):
            client.publish(
                f"{ROOT}/feeder/set/C0046", f"{number / 50:.2f}", qos=1, expiry_s=3000,
                correlation=f"{number}".encode(), response="answers/test",
            )  # fmt: skip
        if wait and (number == numbers[-1] or number % 40 == 39):  # no more may wait for one drive
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
