"""A URL leads to the right end of the seam, or to a message that says which would."""

from __future__ import annotations

import os
import socket

import pytest

from lecombus.errors import LineLostError
from lecombus.fieldbus.port import PortSettings
from lecombus.line.event_loop import run
from lecombus.line.opening import open_port, url_mistake
from lecombus.line.serial_port import SerialPort
from lecombus.line.tcp_port import TcpPort

pytestmark = pytest.mark.clock


class Deaf:
    """A receiver that is told nothing in these tests."""

    def received(self, data: bytes) -> None:
        raise AssertionError(data)

    def lost(self, exc: Exception | None) -> None:
        raise AssertionError(exc)


def opened(url: str) -> object:
    async def main() -> object:
        port = await open_port(PortSettings(url, line="hall-3"), Deaf())
        port.abort()
        return port

    return run(main)


def test_a_path_opens_a_serial_device() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    try:
        assert isinstance(opened(path), SerialPort)
    finally:
        os.close(master)


def test_a_path_with_colons_is_a_path() -> None:
    with pytest.raises(LineLostError, match="no such device"):
        opened("/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0")


def test_a_socket_url_opens_a_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        assert isinstance(opened(url), TcpPort)
        assert isinstance(opened(url.replace("socket", "SOCKET")), TcpPort)


@pytest.mark.parametrize("url", ["telnet://server:23", "tcp://server:4001", "COM3", "ttyUSB0", ""])
def test_an_unknown_port_lists_what_there_is(url: str) -> None:
    with pytest.raises(LineLostError) as caught:
        opened(url)
    for right in ("/dev/serial/by-id/", "socket://HOST:PORT"):
        assert right in str(caught.value)
    assert caught.value.line == "hall-3"


@pytest.mark.parametrize("url", ["rfc2217://server:4001", "RFC2217://server"])
def test_rfc2217_is_refused_with_what_to_write_instead(url: str) -> None:
    with pytest.raises(LineLostError, match="not supported: use socket://HOST:PORT"):
        opened(url)


@pytest.mark.parametrize(
    "url", ["/dev/ttyUSB0", "/dev/serial/by-id/usb-x", "socket://server:4001", "socket://[::1]:23"]
)
def test_a_right_url_is_no_mistake(url: str) -> None:
    assert url_mistake(url) is None


def test_a_socket_url_without_a_port_is_a_mistake_before_anything_is_opened() -> None:
    assert "HOST:PORT" in (url_mistake("socket://server") or "")
