"""TLS of the TCP server: the context that new connections get, and their handshakes.

The certificate is read at the start and at each reload; a wrong one is refused and the one before
stays. Connections that are open keep theirs.

A handshake signs with the private key, up to some milliseconds of processor time (RSA 4096). So
handshakes are made in a thread, one after the other: the event loop sends telegrams during that.
There are no sessions to be resumed: each connection shows its certificate.

A certificate in use that soon expires is said by a note and in the log, long before clients refuse
it.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
import stat
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NoReturn

import anyio
import anyio.to_thread

from lecombus.config.certificate_dates import expiries_of, expiry_text
from lecombus.errors import OperationError
from lecombus.roster import TlsEntry

__all__ = ["Handshake", "ServerTls", "Step", "TlsContexts", "TlsFileError", "context_of"]

logger = logging.getLogger(__name__)

THEN: Final = {"certificate": "clients refuse it then", "client_ca": "its clients are refused then"}

LOOK_S: Final = 12 * 3600.0
"""From one look at the dates of the certificates to the next."""

CIPHERS: Final = "ECDHE+AESGCM:ECDHE+CHACHA20"
"""For TLS 1.2; those of TLS 1.3 are all good."""


class TlsFileError(OperationError):
    """A file of `api.tls` cannot be used.

    Args:
        file: The file.
        what: What is wrong with it.
        remedy: What would be right.
    """

    def __init__(self, file: str, what: str, remedy: str = "") -> None:
        right = remedy or "check `api.tls` of the roster, and the file's owner and mode"
        super().__init__(f"{file}: {what}", kind="tls", remedy=right)
        self.file = file
        self.what = what


@dataclass(frozen=True, slots=True)
class ServerTls:
    """What was read from the files of `api.tls`.

    Args:
        context: Certificate and rules.
        expires: Until when the certificates are valid, by the roster's key, Unix seconds.
    """

    context: ssl.SSLContext
    expires: Mapping[str, float] = field(default_factory=dict)


class TlsContexts:
    """The TLS context that new connections get.

    Args:
        entry: Where the certificate is.
        note: Gets which certificate soon expires, and None when there is none.
        wall: The time of day, Unix seconds.
    """

    def __init__(
        self,
        entry: TlsEntry,
        note: Callable[[str | None], None] = lambda text: None,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._entry = entry
        self._wall = wall
        self._note = note
        self._current: ServerTls | None = None
        self._thread = ThreadPoolExecutor(1, "tls")

    @property
    def expires(self) -> Mapping[str, float]:
        """Until when the certificates in use are valid, by the roster's key, Unix seconds."""
        return {} if self._current is None else self._current.expires

    async def read(self) -> ServerTls:
        """Return what the files say now; read in a thread.

        Raises:
            TlsFileError: A file is wrong.
        """
        return await anyio.to_thread.run_sync(server_tls_of, self._entry, abandon_on_cancel=True)

    def use(self, read: ServerTls) -> None:
        """Give new connections another context."""
        self._current = read
        self.look()

    async def run(self) -> None:
        """Look at the dates again and again."""
        while True:
            await anyio.sleep(LOOK_S)
            self.look()

    def look(self) -> None:
        """Say which certificate in use soon expires, in the log and by the note."""
        said = []
        for key, expires_s in self.expires.items():
            if text := expiry_text(expires_s, self._wall()):
                file = getattr(self._entry, key)
                logger.warning("event=certificate-expires file=%s reason=%s", file, text)
                said.append(f"{file}: {text}; {THEN[key]}")
        remedy = "write another there, then run `lecombus reload`"
        self._note(f"TLS: {'; '.join(said)} ({remedy})" if said else None)

    def begin(self) -> Handshake:
        """Return the handshake of a new connection."""
        assert self._current is not None, "no certificate was read before the server listened"
        return Handshake(self._current.context, self._thread)

    def close(self) -> None:
        """Make no more handshakes."""
        self._thread.shutdown(wait=False, cancel_futures=True)


@dataclass(frozen=True, slots=True)
class Step:
    """The result of one step of a handshake.

    Args:
        is_done: The handshake is complete.
        is_failed: It never will be.
        took_s: Processor time that it took, seconds.
        subject: Who the client's certificate says it is.
    """

    took_s: float
    is_done: bool = False
    is_failed: bool = False
    subject: str = ""


class Handshake:
    """The TLS of one connection, from its first byte.

    Args:
        context: Certificate and rules.
        thread: Makes the steps.
    """

    def __init__(self, context: ssl.SSLContext, thread: ThreadPoolExecutor) -> None:
        self.context = context
        self._thread = thread
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._session: ssl.SSLObject | None = None

    @property
    def session(self) -> ssl.SSLObject:
        """The session; there is one from the first step on, which is not made in the loop."""
        if self._session is None:
            self._session = self.context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        return self._session

    def take(self, sealed: bytes) -> None:
        """Take bytes as they came; never while a step is under way."""
        self._incoming.write(sealed)

    def to_send(self) -> bytes:
        """Return the bytes to be sent; never while a step is under way."""
        return self._outgoing.read()

    def step(self) -> asyncio.Future[Step]:
        """Go on with the handshake, in the thread."""
        return asyncio.get_running_loop().run_in_executor(self._thread, self._go_on)

    def _go_on(self) -> Step:
        began_s = time.thread_time()
        try:
            self.session.do_handshake()
        except ssl.SSLWantReadError:
            return Step(time.thread_time() - began_s)
        except ssl.SSLError:
            return Step(time.thread_time() - began_s, is_failed=True)
        subject = subject_of(self.session.getpeercert())
        return Step(time.thread_time() - began_s, is_done=True, subject=subject)

    def opened(self) -> tuple[bytes, bool]:
        """Return what the taken bytes say, and whether the client will send no more.

        Raises:
            ssl.SSLError: They are not what TLS says.
        """
        parts = []
        try:
            while part := self.session.read(16 * 1024):
                parts.append(part)
        except ssl.SSLWantReadError:
            return b"".join(parts), False
        except ssl.SSLZeroReturnError:
            pass
        return b"".join(parts), True


def subject_of(certificate: Any) -> str:
    """Return the subject of a certificate, such as `CN=plc,O=Works`; empty without one."""
    names = (certificate or {}).get("subject", ())
    short = {"commonName": "CN", "organizationName": "O", "organizationalUnitName": "OU"}
    return ",".join(f"{short.get(key, key)}={value}" for part in names for key, value in part)


def server_tls_of(entry: TlsEntry) -> ServerTls:
    """Return what the files of an entry say.

    Raises:
        TlsFileError: A file cannot be used.
    """
    context = context_of(entry)
    try:
        return ServerTls(context, expiries_of(entry))
    except (OSError, ValueError) as exc:  # OpenSSL takes it, so it is used
        logger.warning("event=certificate-date-unknown reason=%s", exc)
        return ServerTls(context)


def context_of(entry: TlsEntry) -> ssl.SSLContext:
    """Return the context of a certificate.

    Raises:
        TlsFileError: A file cannot be used.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION | ssl.OP_NO_TICKET | ssl.OP_NO_COMPRESSION
    context.num_tickets = 0
    context.set_ciphers(CIPHERS)
    context.set_alpn_protocols(["http/1.1"])
    check_key(entry.key)
    load(entry.certificate, f" with the key {entry.key}", lambda: context.load_cert_chain(
        entry.certificate, entry.key, password=no_password
    ))  # fmt: skip
    if entry.client_ca is not None:
        ca = entry.client_ca
        load(ca, "", lambda: context.load_verify_locations(ca))
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def check_key(path: str) -> None:
    """Refuse a private key that others may read or write.

    Raises:
        TlsFileError: It is such.
    """
    try:
        mode = stat.S_IMODE(Path(path).stat().st_mode)
    except OSError as exc:
        raise TlsFileError(path, f"it cannot be read ({exc.strerror})") from exc
    if mode & 0o027:
        what = f"others may read or write it: its mode is {mode:04o}"
        raise TlsFileError(path, what, f"chmod 0640 {path}, and give it to the group lecombus")


def load(path: str, more: str, use: Callable[[], object]) -> None:
    """Have the ssl module read a file.

    Raises:
        TlsFileError: It cannot be used.
    """
    if not Path(path).is_file():
        raise TlsFileError(path, "there is no such file")
    try:
        use()
    except ssl.SSLError as exc:  # before OSError, of which it is one
        what = (exc.reason or "no PEM").replace("_", " ").lower()
        raise TlsFileError(path, f"it cannot be used{more} ({what})") from exc
    except OSError as exc:
        raise TlsFileError(path, f"it cannot be read{more} ({exc.strerror or exc})") from exc
    except ValueError as exc:
        raise TlsFileError(path, f"it cannot be used{more} ({exc})") from exc


def no_password() -> NoReturn:
    """Refuse a key that is encrypted: OpenSSL would ask for the password on a terminal."""
    raise ValueError("the key is encrypted; a service has no one who could type the password")
