"""A connection over TCP with TLS.

asyncio's own TLS would make handshakes in the event loop, wait 60 s for them and 30 s for the end
of a session, and could not close in two steps. So the bytes go through `Handshake` here; all limits
of `TcpConnection` hold, for a client in its handshake as for any other, and a handshake must be
complete after `HANDSHAKE_S`.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from typing import Any, Final

from lecombus.api.tcp_connection import LingeringTransport, TcpConnection, counted
from lecombus.api.tls import Handshake, Step, TlsContexts

__all__ = ["HANDSHAKE_S", "TlsConnection", "TlsTransport"]

HANDSHAKE_S: Final = 5.0

HANDSHAKE_BYTES: Final = 64 * 1024
"""More than the longest useful chain of client certificates."""


class TlsTransport(LingeringTransport):
    """A transport whose bytes are sealed.

    Args:
        inner: The loop's transport.
        tls: The TLS of the connection.
    """

    def __init__(self, inner: asyncio.Transport, tls: Handshake) -> None:
        super().__init__(inner)
        self._tls = tls
        self.is_open = False  # the handshake is complete

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Return what the loop's transport knows, and the context: uvicorn says https by it."""
        if name == "sslcontext":
            return self._tls.context
        return super().get_extra_info(name, default)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send bytes sealed, unless it was closed or is not open yet."""
        if self.is_open and self._end is None and data:
            try:
                self._tls.session.write(data)
            except ssl.SSLError:  # the client ended the session
                self.abort()
                return
            self.send_sealed()

    def send_sealed(self) -> None:
        """Send what TLS has to say; never while a step of the handshake is under way."""
        sealed = self._tls.to_send()
        if sealed and not self._inner.is_closing():
            self._inner.write(sealed)

    def close(self) -> None:
        """End the session and send what is left; close soon after, or now where none began."""
        if not self.is_open:
            self._inner.close()  # there is no answer to be read, so nothing more is taken
            return
        if not self.is_closing():
            with contextlib.suppress(ssl.SSLError):  # the client has not ended it, which may be
                self._tls.session.unwrap()
            self.send_sealed()
        super().close()


class TlsConnection(TcpConnection):
    """A connection over TCP with TLS."""

    contexts: TlsContexts
    transport: TlsTransport

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take the connection; called by the loop."""
        self._tls = self.contexts.begin()
        self._sealed = bytearray()  # what came since the last step began
        self._sealed_bytes = 0  # of the whole handshake
        self._is_stepping = False  # a step waits for its turn, or is under way
        super().connection_made(transport)
        self._handshake_end = self.loop.call_later(HANDSHAKE_S, self._cut_handshake)

    def _lingering(self, transport: asyncio.Transport) -> TlsTransport:
        return TlsTransport(transport, self._tls)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back; called by the loop."""
        self._handshake_end.cancel()
        super().connection_lost(exc)

    @counted
    def buffer_updated(self, nbytes: int) -> None:
        """Take the bytes that were read; called by the loop."""
        sealed = bytes(self.buffer[:nbytes])
        if self.transport.is_closing():
            self.data_received(sealed)  # which counts and drops it
        elif self.transport.is_open:
            self._tls.take(sealed)
            self._open()
        else:
            self._sealed += sealed
            self._sealed_bytes += nbytes
            if self._sealed_bytes > HANDSHAKE_BYTES:
                self.transport.abort()
            elif not self._is_stepping:
                self._is_stepping = True
                self.transport.pause_reading()
                self.share.take(self, self._step)

    def eof_received(self) -> bool:  # type: ignore[override]
        """The client sends no more; called by the loop."""
        return self.transport.is_open and super().eof_received()

    def _cut_handshake(self) -> None:
        if not self.transport.is_open:
            self.transport.abort()

    def _step(self) -> None:
        """Go on with the handshake; nothing is read until that has ended."""
        if not self.transport.is_closing():
            self._tls.take(bytes(self._sealed))
            self._sealed.clear()
            self._tls.step().add_done_callback(self._stepped)

    @counted
    def _stepped(self, ended: asyncio.Future[Step]) -> None:
        self._is_stepping = False
        if ended.cancelled():
            return
        step = ended.result()
        self.share.spend(step.took_s)
        if self.transport.is_closing():
            return
        self.transport.send_sealed()  # in a failure it says why
        if step.is_failed:
            self.transport.close()
            return
        if step.is_done:
            self._handshake_end.cancel()
            self._actor.subject = step.subject
            self.transport.is_open = True
        self.transport.resume_reading()
        if step.is_done:
            self._open()  # a client may send its request with the end of the handshake

    def _open(self) -> None:
        """Pass on what the bytes say."""
        try:
            said, is_end = self._tls.opened()
        except ssl.SSLError:
            self.transport.send_sealed()
            self.transport.abort()
            return
        self.transport.send_sealed()
        if said:
            self.data_received(said)
        if is_end and not self.eof_received():
            self.transport.close()
