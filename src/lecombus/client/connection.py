"""HTTP with one daemon: requests, what an answer is, and repeats that are safe.

Strategy: a question (`ask`) is repeated once when a connection that was kept open turns out to be
closed. A request that acts (`act`) carries an `Idempotency-Key` and is repeated only when its
connection broke after it may have been sent. The repeat says with `Lecombus-Asked` how long ago it
was asked for first, so that the daemon gives the first answer, or carries it out if nothing of it
was done and no stop came since. A repeat that the daemon turned away before it looked at its key
says nothing of the first request, and is repeated too. What is asked for after `repeat_for_s` is
not asked for again: the answer is lost (`AnswerLostError`), and so the outcome is unknown.
"""

from __future__ import annotations

import json
import math
import socket
import ssl
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any, Final, TypeVar
from uuid import uuid4

import httpx2

from lecombus.client.credentials import headers_for, trusted
from lecombus.client.documents import Answer, Document, kind_of
from lecombus.client.errors import ProblemError, UnreachableError
from lecombus.client.finding import no_daemon_at, try_socket

__all__ = [
    "BY",
    "KEY",
    "LEASE_HEADER",
    "AnswerLostError",
    "Connection",
    "Json",
    "finish",
    "open_connection",
    "problem_error",
]

Json = None | bool | int | Decimal | str | list["Json"] | dict[str, "Json"]
"""What may stand in a body: no float, so that no decimal is rounded by accident."""

LOCAL: Final = "http://localhost"
"""What a request over a socket calls the machine."""

CONNECT_WITHIN_S: Final = 10.0
ANSWER_WITHIN_S: Final = 60.0
"""A write to a silent drive or a group read back member by member takes its time."""

REPEAT_FOR_S: Final = 5.0
"""A daemon that is started again by systemd is back by then."""

FIRST_PAUSE_S: Final = 0.05
LONGEST_PAUSE_S: Final = 1.0

T = TypeVar("T")

KEY: Final = "idempotency-key"
ASKED: Final = "lecombus-asked"
BY: Final = "lecombus-by"
"""For whom a program asks, such as a bridge; it stands in the log and in the journal."""

LEASE_HEADER: Final = "lecombus-lease"

BROKEN: Final = (
    httpx2.ReadError, httpx2.WriteError, httpx2.CloseError, httpx2.RemoteProtocolError,
    httpx2.DecodingError,
)  # fmt: skip
"""A connection that ended, or an answer that cannot be read, after a request may have been sent."""


TURNED_AWAY: Final = frozenset((401, 429, 503))
"""HTTP statuses without an outcome: of a daemon that has not looked at the key."""


class AnswerLostError(UnreachableError):
    """What was asked may have happened: the answer did not come."""


class Connection:
    """A daemon that is spoken with over HTTP.

    Args:
        http: Speaks HTTP with it.
        where: The socket's path or the URL, for messages.
        repeat_for_s: How long a request that acts is repeated after its connection broke, seconds.
        pause: Lets seconds pass before a repeat.
    """

    def __init__(
        self,
        http: httpx2.AsyncClient,
        where: str,
        *,
        repeat_for_s: float = REPEAT_FOR_S,
        pause: Callable[[float], Awaitable[None]] | None = None,
    ) -> None:
        self.http = http
        self.where = where
        self._repeat_for_s = repeat_for_s
        self._pause = pause or let_pass

    async def ask(self, path: str, params: Mapping[str, str] | None = None) -> Answer:
        """Ask for a document.

        Raises:
            ProblemError: The daemon refuses.
            UnreachableError: It cannot be reached.
        """
        try:
            response = await self.http.get(path, params=params)
        except BROKEN:  # such as a connection that was idle for long
            response = await self._send("GET", path, None, {}, params)
        except (httpx2.HTTPError, ssl.SSLError) as exc:
            raise self.unreachable(exc) from exc
        answer = self.answer_of(response)
        if not response.is_success:
            raise problem_error(answer)
        return answer

    async def act(
        self,
        method: str,
        path: str,
        document: Mapping[str, Json] | None = None,
        headers: Mapping[str, str] | None = None,
        *,
        asked_ago_s: float = 0.0,
    ) -> Answer:
        """Ask for something to be done, once; a problem document is an answer too.

        Args:
            method: The HTTP method.
            path: The path.
            document: The body.
            headers: Further headers, or another `KEY`.
            asked_ago_s: How long ago it was asked for first, seconds, by one for whom this
                program asks; it is not carried out if a stop came since.

        Raises:
            AnswerLostError: It may have happened; what the daemon said of it is not known.
            UnreachableError: Nothing was sent.
        """
        begun_s = now_s()
        sent = {KEY: uuid4().hex, **(headers or {})}
        if asked_ago_s > 0:
            sent[ASKED] = seconds_text(asked_ago_s)
        try:
            return self._end_of(await self._send(method, path, document, sent))
        except AnswerLostError as exc:
            if not isinstance(exc.__cause__, BROKEN):
                raise
            lost = exc
        pause_s = FIRST_PAUSE_S
        while (ago_s := now_s() - begun_s) < self._repeat_for_s:
            sent[ASKED] = seconds_text(asked_ago_s + ago_s)
            try:
                answer = self._end_of(await self._send(method, path, document, sent))
            except UnreachableError as exc:
                if isinstance(exc.__cause__, httpx2.TimeoutException):
                    break
            else:
                if not is_turned_away(answer):
                    return answer
            await self._pause(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
        raise lost

    async def once(
        self,
        method: str,
        path: str,
        document: Mapping[str, Json] | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> Answer:
        """Ask for something to be done, without a key and without any repeat.

        Raises:
            UnreachableError: It cannot be reached; an `AnswerLostError`: it may have happened.
        """
        return self._end_of(await self._send(method, path, document, headers or {}))

    async def _send(
        self,
        method: str,
        path: str,
        document: Mapping[str, Json] | None,
        headers: Mapping[str, str],
        params: Mapping[str, str] | None = None,
    ) -> httpx2.Response:
        content = None
        if document is not None:
            content = body_text(document)
            headers = {**headers, "content-type": "application/json"}
        try:
            return await self.http.request(
                method, path, content=content, headers=headers, params=params
            )
        except (httpx2.HTTPError, ssl.SSLError) as exc:
            raise self.unreachable(exc) from exc

    def unreachable(self, exc: httpx2.HTTPError | ssl.SSLError) -> UnreachableError:
        """Return what it means that a daemon could not be spoken with."""
        said = str(exc).upper()
        if "ALERT" in said and ("CERTIFICATE" in said or "UNKNOWN_CA" in said):
            problem = f"{self.where} does not accept your certificate, or asks for one: {exc}"
            return UnreachableError(
                problem, "name your certificate with its key (certificate; --certificate FILE)"
            )
        if isinstance(exc, httpx2.ReadTimeout | httpx2.WriteTimeout):
            problem = f"the daemon at {self.where} does not answer in time"
            return AnswerLostError(problem, "look at its log")
        if isinstance(exc, httpx2.TimeoutException):
            problem = f"the daemon at {self.where} does not answer in time"
            return UnreachableError(problem, "look at its log")
        if isinstance(exc, BROKEN):
            problem = f"the daemon at {self.where} ended before it answered"
            remedy = "what was asked may have happened; look at its log, then ask again"
            return AnswerLostError(problem, remedy)
        if isinstance(exc, ssl.SSLError):
            problem = f"the connection to {self.where} broke: {exc}"
            return AnswerLostError(problem, "what was asked may have happened; look at its log")
        if "CERTIFICATE" in said:
            problem = f"the certificate of {self.where} is not trusted: {exc}"
            return UnreachableError(
                problem, "name the file of the CA that signed it (ca; --ca FILE)"
            )
        if is_because_of(exc, socket.gaierror):
            problem = f"the host of {self.where} is not known: {exc}"
            return UnreachableError(problem, "look at its name, and at this machine's name server")
        return no_daemon_at(self.where)

    def _end_of(self, response: httpx2.Response) -> Answer:
        """Return what a response to something that acts says.

        Raises:
            AnswerLostError: A proxy may have sent it on, and has lost the answer.
            UnreachableError: It is not lecombus'.
        """
        try:
            return self.answer_of(response)
        except UnreachableError as exc:
            if response.status_code < 500:
                raise
            remedy = "what was asked may have happened; look at the proxy and at the daemon's log"
            raise AnswerLostError(exc.problem, remedy) from exc

    def answer_of(self, response: httpx2.Response) -> Answer:
        """Return what a response says.

        Raises:
            UnreachableError: It is not lecombus'.
        """
        try:
            data = json.loads(response.text, parse_float=Decimal)
        except ValueError as exc:
            status = response.status_code
            problem = f"what answers at {self.where} is not lecombus (HTTP status {status})"
            raise UnreachableError(problem, "look at the address and the port") from exc
        return Answer(response.text, data, response.status_code)


@asynccontextmanager
async def open_connection(
    path: str,
    url: str,
    *,
    token_file: str | Path | None = None,
    ca: str | Path | None = None,
    certificate: str | Path | None = None,
    answer_within_s: float = ANSWER_WITHIN_S,
    repeat_for_s: float = REPEAT_FOR_S,
    blocking: bool = False,
) -> AsyncIterator[Connection]:
    """Connect to a daemon at a socket or a URL, one of them empty; nothing is asked yet.

    Args:
        path: Of its Unix socket.
        url: Its HTTP address.
        token_file: Holds the bearer token, for a URL.
        ca: Holds the certificates that sign the daemon's, for an https URL; None: the system's.
        certificate: Holds the client's certificate and its key, for an https URL.
        answer_within_s: How long to wait for an answer, seconds.
        repeat_for_s: As in `Connection`.
        blocking: Every request blocks, and needs no event loop: `finish` runs it.

    Raises:
        NotPermittedError: The socket or a file may not be opened.
        UnreachableError: Nothing listens at the socket.
    """
    if path:
        try_socket(path)
    settings: dict[str, Any] = {
        "uds": path or None,
        "verify": trusted(url, ca, certificate),
        # No limit: a stop or a renewal of a lease waits for no other request.
        "limits": httpx2.Limits(max_connections=None, max_keepalive_connections=4),
    }
    transport = BlockingTransport(settings) if blocking else httpx2.AsyncHTTPTransport(**settings)
    http = httpx2.AsyncClient(
        base_url=url or LOCAL,
        headers=headers_for(url, token_file),
        # No environment: a proxy from there would be given the token.
        trust_env=False,
        timeout=httpx2.Timeout(CONNECT_WITHIN_S, read=answer_within_s),
        transport=transport,
    )
    async with http:
        yield Connection(
            http, path or url, repeat_for_s=repeat_for_s, pause=block if blocking else None
        )


class BlockingTransport(httpx2.AsyncBaseTransport):
    """HTTP that blocks instead of waiting in an event loop.

    An event loop takes 0.08 s to load, and `lecombus stop` can do without.

    Args:
        settings: Of `httpx2.HTTPTransport`.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._transport = httpx2.HTTPTransport(**settings)

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        """Send a request, and return its answer whole."""
        sent = httpx2.Request(
            request.method, request.url, headers=request.headers, stream=request.stream,
            extensions=request.extensions,
        )  # fmt: skip
        response = self._transport.handle_request(sent)
        assert isinstance(response.stream, httpx2.SyncByteStream)
        try:
            content = b"".join(response.stream)
        finally:
            response.close()
        return httpx2.Response(
            response.status_code, headers=response.headers, stream=httpx2.ByteStream(content),
            extensions=response.extensions,
        )  # fmt: skip

    async def aclose(self) -> None:
        """Close the connections."""
        self._transport.close()


def finish(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine that blocks where others wait, to its end."""
    try:
        work.send(None)
    except StopIteration as ended:
        result: T = ended.value
        return result
    work.close()
    raise RuntimeError("this waits for something: it needs an event loop")


async def let_pass(for_s: float) -> None:
    """Let seconds pass in an event loop."""
    import anyio  # a connection that blocks does without

    await anyio.sleep(for_s)


async def block(for_s: float) -> None:
    """Let seconds pass without an event loop."""
    time.sleep(for_s)  # noqa: ASYNC251 - there is no other task


def seconds_text(for_s: float) -> str:
    """Return seconds as `Lecombus-Asked` takes them, never less than they are."""
    return f"{math.ceil(for_s * 1000) / 1000:.3f}"


def is_because_of(exc: BaseException | None, kind: type[BaseException]) -> bool:
    """Whether an error, or one of those that led to it, is of a kind."""
    while exc is not None and not isinstance(exc, kind):
        exc = exc.__cause__ or exc.__context__
    return exc is not None


def is_turned_away(answer: Answer) -> bool:
    """Whether a repeat was refused before it was known what became of the first request."""
    document: Document = answer.data if isinstance(answer.data, dict) else {}
    return answer.status in TURNED_AWAY and not document.get("outcome")


def problem_error(answer: Answer) -> ProblemError:
    """Return the error that a problem document stands for."""
    document: Document = answer.data if isinstance(answer.data, dict) else {}

    def text(*keys: str) -> str:
        return next((str(document[key]) for key in keys if document.get(key)), "")

    problem = text("detail", "title") or f"the daemon refused (HTTP status {answer.status})"
    return ProblemError(
        answer.status, problem, text("remedy"), kind_of(document), text("drive"), text("code"),
        text("cause"),
    )  # fmt: skip


def body_text(document: Mapping[str, Json]) -> str:
    """Write a document with its decimals exactly as they were given.

    `json` cannot, and a float would round them.
    """
    return (
        "{" + ", ".join(f"{json.dumps(key)}: {text_of(one)}" for key, one in document.items()) + "}"
    )


def text_of(value: Json) -> str:
    """Write one value of a body."""
    if isinstance(value, Decimal):
        return format(value, "f")
    if isinstance(value, dict):
        return body_text(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(text_of, value)) + "]"
    return json.dumps(value)


def now_s() -> float:
    """Return a clock that nothing sets back and that goes on while the machine sleeps, seconds."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
