"""The TCP port: a device server that passes raw bytes, as `socket://HOST:PORT`.

Strategy: an asyncio protocol that passes all events to its receiver. A device server whose power
was pulled says nothing, so silence is made to end the connection: keepalive probes while nothing is
sent, TCP_USER_TIMEOUT while something is. Telegrams are sent immediately (TCP_NODELAY), since a
telegram held back for the acknowledgement of the one before would cost up to 40 ms.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from typing import cast
from urllib.parse import urlsplit

import anyio

from lecombus.fieldbus.port import PortSettings, Receiver

__all__ = ["CONNECT_TIMEOUT_S", "TcpPort", "host_and_port", "open_tcp"]

CONNECT_TIMEOUT_S = 3.0
"""A device server on the same site answers in milliseconds; resolving its name may take longer."""

_NEXT_ADDRESS_S = 0.5
"""After so long the next address of a name is tried as well: one that leads nowhere, such as of
IPv6 in a network without it, would use up the time of all."""

_KEEPALIVE_IDLE_S = 3
_KEEPALIVE_EVERY_S = 1
_KEEPALIVE_PROBES = 3
"""A server that vanished is noticed 6 s after its last sign of life."""

_UNACKNOWLEDGED_MS = 5000
"""How long bytes may go without an acknowledgement."""

_READ_SIZE = 65536


class TcpPort(asyncio.Protocol):
    """A connection to a device server behind the port seam; made by `open_tcp`.

    Args:
        receiver: Gets the bytes and the loss.
        settings: What it was opened with.
    """

    def __init__(self, receiver: Receiver, settings: PortSettings) -> None:
        self._receiver = receiver
        self._settings = settings
        self._transport: asyncio.Transport | None = None
        self._silent = True
        self._why = "the device server ended the connection; is another client connected to it?"
        self._peer = ""
        self.carries_parity = settings.framing == "8N1"

    def write(self, data: bytes) -> None:
        """Hand all of `data` to the connection."""
        transport = self._transport
        if transport is None or transport.is_closing():
            raise self._settings.error("the connection is closed")
        transport.write(data)

    def discard_input(self) -> None:
        """Drop what has arrived and was not given on."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        fd = transport.get_extra_info("socket").fileno()
        with contextlib.suppress(OSError):  # empty, or broken: then the loop finds out next
            while os.read(fd, _READ_SIZE):
                pass

    def look(self) -> None:
        """Read what the kernel holds. The loop reports an end or an error."""
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        data = b""
        with contextlib.suppress(OSError):  # empty, or broken
            data = os.read(transport.get_extra_info("socket").fileno(), _READ_SIZE)
        if data:
            self.data_received(data)

    def abort(self) -> None:
        """Close immediately and drop what was not sent."""
        self._silent = True
        if self._transport is not None:
            self._transport.abort()

    def begin(self) -> None:
        """Start to call the receiver; bytes received before were no answer.

        Raises:
            LineLostError: The connection ended while it was being made.
        """
        if self._transport is None:
            raise self._settings.error(self._why)
        self._silent = False

    def describe(self) -> str:
        """Say where this leads, such as `socket://server:4001 (192.0.2.7:4001), raw 8N1`."""
        framing = self._settings.framing
        return f"{self._settings.url} ({self._peer}), raw, device server frames {framing}"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take over the connection; called by the loop."""
        self._transport = cast("asyncio.Transport", transport)
        host, port, *_ = transport.get_extra_info("peername")
        self._peer = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        _watch(transport.get_extra_info("socket"))

    def data_received(self, data: bytes) -> None:
        """Give bytes on; called by the loop."""
        if not self._silent:
            self._receiver.received(data)

    def pause_writing(self) -> None:
        """Give the connection up: the server takes no bytes; called by the loop."""
        self._why = "the device server takes no more bytes"
        if self._transport is not None:
            self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Report the loss, unless the connection was closed here; called once by the loop."""
        self._transport = None
        if exc is not None:
            self._why = _reason(exc)
        if not self._silent:
            self._receiver.lost(self._settings.error(self._why))


def host_and_port(url: str) -> tuple[str, int]:
    """Take `socket://HOST:PORT` apart; an IPv6 address stands in brackets.

    Raises:
        ValueError: It has another form; the message says which is right.
    """
    scheme = url.partition(":")[0]
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or not port or url.partition("//")[2] != parts.netloc or "@" in url:
        raise ValueError(f"not of the form {scheme}://HOST:PORT, PORT in 1..65535")
    return host, port


async def open_tcp(settings: PortSettings, receiver: Receiver) -> TcpPort:
    """Connect to a device server.

    Args:
        settings: With `socket://HOST:PORT` as `url`.
        receiver: Gets the bytes and the loss.

    Raises:
        LineLostError: It cannot be reached, or the URL is wrong; the message says what to do.
    """
    loop = asyncio.get_running_loop()
    port = TcpPort(receiver, settings)
    try:
        host, number = host_and_port(settings.url)
        with anyio.fail_after(CONNECT_TIMEOUT_S):
            await loop.create_connection(
                lambda: port, host, number, happy_eyeballs_delay=_NEXT_ADDRESS_S
            )
    except (OSError, ValueError) as exc:  # a time-out is an OSError
        raise settings.error(_why_not_open(exc)) from exc
    port.begin()
    return port


def _watch(sock: socket.socket) -> None:
    """Have the kernel send at once and detect a server that vanished silently."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _KEEPALIVE_IDLE_S)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _KEEPALIVE_EVERY_S)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _KEEPALIVE_PROBES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)


def _why_not_open(exc: Exception) -> str:
    if isinstance(exc, ConnectionRefusedError):
        return "connection refused; is the device server running and is that its port?"
    if isinstance(exc, PermissionError):
        return (
            "operation not permitted; a firewall of this machine refuses it, or the "
            "service needs the drop-in device-server.conf (docs/install.md)"
        )
    if isinstance(exc, TimeoutError):
        return f"no answer within {CONNECT_TIMEOUT_S:g} s; check host and network"
    if isinstance(exc, socket.gaierror):
        return f"the host name cannot be resolved ({exc.strerror}); check it"
    return _reason(exc)


def _reason(exc: Exception) -> str:
    number = getattr(exc, "errno", None)
    return os.strerror(number) if number else str(exc)
