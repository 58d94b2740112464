"""One connection to a broker: its limits, its files, and the names of aiomqtt that it relies on."""

from __future__ import annotations

import asyncio
import socket
import time
from pathlib import Path
from typing import Any

import aiomqtt
import paho.mqtt.client as paho
import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from lecombus.bridges.mqtt.broker import (
    BrokerError,
    Incoming,
    Limits,
    WillLimits,
    client_for,
    password_of,
    properties_of,
    refusal,
    tls_of,
)
from lecombus.bridges.mqtt.retained import Message
from lecombus.roster import MqttEntry
from support.certificates import make_certificates

ENTRY = MqttEntry(host="127.0.0.1", port=1883, tls=False)


def test_the_private_names_of_the_libraries_are_there() -> None:
    for name in (
        "_on_connect", "_on_message", "_on_publish", "_on_socket_register_write", "_wait_for"
    ):  # fmt: skip
        assert callable(getattr(aiomqtt.Client, name))
    for name in ("_sock_close", "connect_timeout"):
        assert hasattr(paho.Client, name)


def test_a_socket_that_is_closed_before_its_turn_to_write_is_left_alone() -> None:
    """Its number may be another's by then."""

    async def test() -> None:
        said: list[dict[str, Any]] = []
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: said.append(context))
        client = client_for(ENTRY, "test", Message("a", b""), WillLimits())
        for is_closed in (False, True):
            near, far = socket.socketpair()
            number = near.fileno()
            client._on_socket_register_write(client._client, None, near)
            if is_closed:
                near.close()
            await asyncio.sleep(0)
            assert loop.remove_writer(number) is not is_closed
            near.close()
            far.close()
        assert said == []

    asyncio.run(test())


def test_a_message_came_when_it_was_read_and_not_when_it_is_handed_out() -> None:
    async def test() -> None:
        taken: list[Incoming] = []
        client = client_for(ENTRY, "test", Message("a", b""), WillLimits())
        client.take = taken.append
        message = paho.MQTTMessage(1, b"a/b")
        message.qos, message.payload, message.timestamp = 2, b"1", time.monotonic() - 7
        client._on_message(client._client, None, message)
        assert asyncio.get_running_loop().time() - taken[0].came_s == pytest.approx(7, abs=0.5)

    asyncio.run(test())


def test_what_a_broker_says_of_itself_is_read() -> None:
    assert Limits.of(None) == Limits()
    said = Properties(PacketTypes.CONNACK)  # type: ignore[no-untyped-call]
    said.ReceiveMaximum, said.MaximumPacketSize, said.MaximumQoS = 3, 500, 1
    said.RetainAvailable, said.WildcardSubscriptionAvailable = 0, 0
    assert Limits.of(said) == Limits(3, 500, 1, retain=False, wildcards=False)


def test_a_will_that_the_broker_does_not_take_is_made_smaller() -> None:
    limits = WillLimits()
    for code, left in ((154, (False, 1)), (155, (False, 0)), (134, (False, 0))):
        exc = aiomqtt.MqttCodeError(ReasonCode(PacketTypes.CONNACK, identifier=code))
        assert isinstance(refusal(exc, limits), BrokerError)
        assert (limits.retain, limits.qos) == left


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (ConnectionRefusedError(111, "Connection refused"), "connection refused; is the broker "),
        (OSError(113, "No route to host"), "No route to host"),
        (OSError("odd"), "odd"),
    ],
)
def test_why_there_is_no_connection_is_said_in_words(cause: OSError, text: str) -> None:
    error = aiomqtt.MqttError(str(cause))
    error.__context__ = cause  # all that aiomqtt leaves of it
    assert str(refusal(error, WillLimits())).startswith(text)


def test_a_user_whom_the_broker_refuses_is_asked_to_check_user_and_password() -> None:
    code = ReasonCode(PacketTypes.CONNACK, identifier=135)
    error = refusal(aiomqtt.MqttCodeError(code), WillLimits())
    assert error.is_refused
    text = "it refuses the connection (Not authorized); are user and password right?"
    assert str(error) == text


def test_texts_from_drives_do_not_break_a_message() -> None:
    message = Message("a", b"1", properties=(("reason", "a\0b" + "x" * 70_000),), expiry_s=3)
    packed = properties_of(message).pack()  # type: ignore[no-untyped-call]
    assert len(packed) < 1100


def test_the_password_is_the_first_line_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "password"
    entry = ENTRY.model_copy(update={"username": "u", "password_file": str(file)})
    assert password_of(ENTRY) is None
    with pytest.raises(BrokerError, match="cannot be read"):
        password_of(entry)
    file.write_text("secret word\n")
    file.chmod(0o644)
    with pytest.raises(BrokerError, match=r"all users may read .*: chmod o= "):
        password_of(entry)
    file.chmod(0o640)
    file.write_text("\nx")
    with pytest.raises(BrokerError, match="no password"):
        password_of(entry)
    file.write_text("secret word\n")
    assert password_of(entry) == "secret word"


def test_files_of_tls_that_are_wrong_are_said(tmp_path: Path) -> None:
    assert tls_of(ENTRY) is None
    tls = ENTRY.model_copy(update={"tls": True, "ca": str(tmp_path / "ca.pem")})
    with pytest.raises(BrokerError, match=r"ca\.pem"):
        tls_of(tls)
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(BrokerError, match=r"ca\.pem"):
        tls_of(tls)
    made = make_certificates(tmp_path)
    assert tls_of(tls) is not None
    shows = {"certificate": str(made.path("plc.pem")), "key": str(made.path("ca.pem"))}
    made.path("ca.pem").chmod(0o644)
    with pytest.raises(BrokerError, match=r"all users may read .*ca\.pem: chmod o= "):
        tls_of(tls.model_copy(update=shows))
    made.path("ca.pem").chmod(0o600)
    with pytest.raises(BrokerError, match=r"plc\.pem"):
        tls_of(tls.model_copy(update=shows))
    shows["key"] = str(made.path("plc.key"))
    assert tls_of(tls.model_copy(update=shows)) is not None
