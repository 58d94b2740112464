"""Repeats made safe: with the same `Idempotency-Key` a request gets the result of the first.

Strategy: the first request with a key runs; others with the same key and the same content wait
for its end if need be and are given the same response; the same key with other content is
refused. Every final answer is remembered, also a refusal: what was refused once, such as an
enable of a latched drive, must not happen because an old request is repeated. An error in lecombus
is remembered too, and so is the end of a request that was cancelled: each may have been sent. What
only says "later" (`TRY_LATER`: queue full, line lost, refused too often, the client gone) is not:
the same key may be tried again, and a request that waited for such a first one takes its place.

Stops are different (`SharedStops`): a repeat shares the first one's result only while that is under
way. Afterwards the drive may have been started again, so a repeat is a new stop and is sent; and
no stop is refused for its key being in use, for too many keys, or for a key that cannot be kept.

A repeat may say in `Lecombus-Asked` how long ago the same was asked for first. It counts as asked
for then: it expires earlier, and a stop or a start of lecombus since then ends it. So a
repeat cannot start what was stopped after the first request was lost.

Memory is bounded: `KEY_LIMIT` keys for `KEEP_S` seconds, the oldest finished one going first.
Where there is a journal, keys and responses are kept in it too: a key before its request is carried
out, its response before that is sent. So a repeat is answered after a restart of lecombus as well;
where the first request was under way at its end, by `unknown`. They are kept for `KEEP_S` seconds
from the restart on: how long lecombus was away is not known for certain. Where they could not be
read at the start, they are read once the journal works. Until then a request with a key may have
been carried out before (`NOT_KNOWN`), and the journal's record refuses what controls a drive.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Final

import anyio
from anyio import current_time
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import STATUS_BY_KIND, ProblemDocument, RefusedRequestError
from lecombus.api.decimal_json import short
from lecombus.api.error_answers import known_error, unexpected_error
from lecombus.api.scopes import LEASE_HEADER
from lecombus.errors import LecombusError
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.kept import NOT_KNOWN, KeyRow
from lecombus.operations.awaited_requests import CAME_S
from lecombus.schedule.request import Outcome

__all__ = [
    "ASKED_HEADER",
    "KEEP_S",
    "KEY_CHARS",
    "KEY_LIMIT",
    "Idempotency",
    "SharedStops",
    "key_mistake",
    "keys_of",
    "time_left",
]

KEY_LIMIT: Final = 1000
KEEP_S: Final = 600.0
KEY_CHARS: Final = 255
ASKED_HEADER: Final = "Lecombus-Asked"
ASKED_RIGHT: Final = re.compile(r"[0-9]{1,3}(\.[0-9]{1,6})?", re.ASCII)
"""Seconds; a client that has waited for longer has a person look first."""

KEPT_BYTES: Final = 16384
"""A longer response, of a group of some 30 drives, is not kept in the journal: a repeat after a
restart is answered by `unknown` then. All keys together take less than half of the least file."""

CLIENT_GONE: Final = STATUS_BY_KIND["client-gone"][0]
TRY_LATER: Final = frozenset((CLIENT_GONE, 429, 503))
"""Statuses of refusals after which the same request, with the same key, may be sent again."""

OPEN_END: Final = ProblemDocument(
    "unknown",
    "lecombus ended this, or itself, while it was under way: whether it was done is not known",
    remedy="look at the drive, then ask for it again; over HTTP with a new Idempotency-Key",
    outcome=Outcome.UNKNOWN.value,
)


@dataclass(slots=True, eq=False)
class Entry:
    """One key: what it was used for, and the response once there is one."""

    content: bytes
    begun_s: float
    ended: anyio.Event = field(default_factory=anyio.Event)
    response: Response | None = None


class Idempotency:
    """The keys used lately.

    Args:
        clock: A monotonic clock, seconds.
        journal: Keeps them across restarts; None: nothing does.
        kept: Those of the run before; None: the journal could not be read yet.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        journal: Journal | None = None,
        kept: Sequence[KeyRow] | None = (),
    ) -> None:
        self._clock = clock
        self._started_s = clock()
        self._journal = journal
        self._knows_former = kept is not None
        self._entries = {row.name: entry_of(row, self._started_s) for row in kept or ()}

    def __len__(self) -> int:
        """Return how many keys are remembered."""
        return len(self._entries)

    async def run(
        self, request: Request, body: bytes, act: Callable[[], Awaitable[Response]]
    ) -> Response:
        """Carry out a request once per key; without a key each time.

        Args:
            request: The request.
            body: Its body.
            act: Carries it out; what it raises is answered, and remembered unless `TRY_LATER`.
                An error that is a mistake in lecombus is raised again, for the log.

        Raises:
            ProblemError: The key was used for another request, is malformed or one of two, or too
                many are in use.
        """
        keys, ago_s = keys_of(request), asked_ago_s(request)
        if not keys:
            NOT_KNOWN.set("")  # it is that of the request before on the same connection
            return await act()
        check_keys(keys)
        key = keys[0]
        content = content_of(request, body)
        NOT_KNOWN.set(await self._why_not_known())
        while (entry := self._entries.get(key)) is not None and self._is_current(entry):
            if entry.content != content:
                raise reused(key)
            await entry.ended.wait()
            if entry.response is not None:
                return entry.response
        self._go_back(ago_s)
        return await self._first(request, key, content, lambda: answer_of(request, act))

    async def _why_not_known(self) -> str:
        """Read the keys of the run before, if need be; returns why that cannot be done yet."""
        if self._knows_former or self._journal is None:
            return ""
        try:
            rows = await self._journal.keys()
        except JournalFileError as exc:
            return str(exc)
        if not self._knows_former:
            former = {row.name: entry_of(row, self._started_s) for row in rows}
            self._entries = {**former, **self._entries}
            self._knows_former = True
        return ""

    def _go_back(self, ago_s: float) -> None:
        """Let a repeat count as asked for when it was asked for first.

        Raises:
            ProblemError: lecombus started since then: what was stopped since is not known.
        """
        if not ago_s:
            return
        came_s = CAME_S.get()
        asked_s = (self._clock() if came_s is None else came_s) - ago_s
        if asked_s < self._started_s:
            raise RefusedRequestError(
                ProblemDocument(
                    "unknown",
                    "lecombus started again since this was asked for: nothing was sent now, and "
                    "what was done before is not known",
                    remedy="look at the drive, then ask for it again",
                    outcome=Outcome.UNKNOWN.value,
                )
            )
        CAME_S.set(asked_s)

    async def _first(
        self, request: Request, key: str, content: bytes, act: Callable[[], Awaitable[Response]]
    ) -> Response:
        self._entries.pop(key, None)  # so that keys stand in the order of their age
        self._make_room()
        entry = self._entries[key] = Entry(content, self._clock())
        if self._journal is not None and not NOT_KNOWN.get():
            self._journal.keep(KeyRow(key, content))
        later = False
        try:
            entry.response = response = await act()
            later = response.status_code == CLIENT_GONE
            if not later:
                await self._keep(key, content, response)
            return response
        except LecombusError:  # `answer_of` lets pass only what was not done
            later = True
            raise
        except Exception as exc:  # a mistake in lecombus: what was done is not known
            if entry.response is None:
                entry.response = await unexpected_error(request, exc)
                await self._keep(key, content, entry.response)
            raise
        finally:
            if later:
                entry.response = None
                if not NOT_KNOWN.get():  # else the file may have its answer of the run before
                    self._forget(key)
                if self._entries.get(key) is entry:
                    del self._entries[key]
            elif entry.response is None:  # cancelled: what was sent by then is not known
                entry.response = OPEN_END.response()
            entry.ended.set()

    async def _keep(self, key: str, content: bytes, response: Response) -> None:
        """Have the journal keep a response, and wait for that; one that fails is not waited for."""
        body = bytes(response.body)
        if self._journal is None or len(body) > KEPT_BYTES:
            return
        row = KeyRow(key, content, response.status_code, response.media_type or "", body)
        with contextlib.suppress(JournalFileError):
            await self._journal.keep_now(row)

    def _forget(self, key: str) -> None:
        if self._journal is not None:
            self._journal.keep(KeyRow(key))

    def _is_current(self, entry: Entry) -> bool:
        return not entry.ended.is_set() or self._clock() - entry.begun_s < KEEP_S

    def _make_room(self) -> None:
        """Drop what is too old, and the oldest finished keys while there are too many."""
        for key, entry in list(self._entries.items()):
            if self._is_current(entry):
                break
            del self._entries[key]
            self._forget(key)
        if len(self._entries) < KEY_LIMIT:
            return
        for key, entry in self._entries.items():
            if entry.ended.is_set():
                del self._entries[key]
                self._forget(key)
                return
        raise RefusedRequestError(
            ProblemDocument("queue-full", f"{KEY_LIMIT} requests with a key are under way already")
        )


async def answer_of(request: Request, act: Callable[[], Awaitable[Response]]) -> Response:
    """Return the answer to a request, also where it is refused for good.

    Raises:
        LecombusError: It may be tried again later.
    """
    try:
        return await act()
    except LecombusError as exc:
        response = await known_error(request, exc)
        if response.status_code in TRY_LATER:
            raise
        return response


def entry_of(row: KeyRow, now_s: float) -> Entry:
    """Return what is known of a key of the run before."""
    ended = anyio.Event()
    ended.set()
    if row.status is None:
        return Entry(row.content, now_s, ended, OPEN_END.response())
    response = Response(row.body, row.status, media_type=row.type or None)
    return Entry(row.content, now_s, ended, response)


class SharedStops:
    """The stops under way that were given a key."""

    def __init__(self) -> None:
        self._under_way: dict[tuple[str, bytes], Entry] = {}

    async def run(
        self, request: Request, body: bytes, act: Callable[[], Awaitable[Response]]
    ) -> Response:
        """Stop, or share the result of the same stop with the same key while it is under way.

        Without a key, or with one that cannot be kept, it stops.

        Args:
            request: The request.
            body: Its body, as far as it counts.
            act: Stops; when it raises, each request that waited for its result stops by itself.
        """
        keys = keys_of(request)
        if not keys or key_mistake(keys):
            return await act()
        key = keys[0]
        content = content_of(request, body)
        while (entry := self._under_way.get((key, content))) is not None:
            await entry.ended.wait()
            if entry.response is not None:
                return entry.response
        entry = self._under_way[key, content] = Entry(content, 0.0)
        try:
            entry.response = await act()
            return entry.response
        finally:
            del self._under_way[key, content]
            entry.ended.set()


def keys_of(request: Request) -> list[str]:
    """Return the `Idempotency-Key` headers of a request; more than one is a mistake."""
    return request.headers.getlist("idempotency-key")


def asked_ago_s(request: Request) -> float:
    """Return how long ago a repeat was asked for first, seconds; 0: it is not a repeat.

    Raises:
        ProblemError: The header is wrong, or stands without a key.
    """
    found = request.headers.getlist(ASKED_HEADER)
    if not found:
        return 0.0
    if len(found) == 1 and ASKED_RIGHT.fullmatch(found[0]) and len(keys_of(request)) == 1:
        return float(found[0])
    right = f"{ASKED_HEADER} takes seconds such as 1.250, once, with the Idempotency-Key repeated"
    raise RefusedRequestError(
        ProblemDocument("bad-request", right, remedy="leave it out of a first request")
    )


def time_left(request: Request, expires_s: float | None) -> Callable[[], float | None]:
    """Return what says how long a request that has come whole just now may still wait, seconds.

    Its time began when it was asked first. It goes on while the request waits for the first one
    with its key, and for what is read to judge it.
    """
    if expires_s is None:
        return lambda: None
    until_s = current_time() + expires_s - asked_ago_s(request)
    return lambda: until_s - current_time()


def content_of(request: Request, body: bytes) -> bytes:
    """Return a digest that differs between different requests with the same key.

    The token of the lease is part of it: a controller that has taken a new lease and counts its
    keys from 1 again must not be told what was done under the one before.
    """
    scope = request.scope
    digest = sha256()
    tokens = [token.strip().encode() for token in request.headers.getlist(LEASE_HEADER)]
    what = (scope["method"].encode(), scope["path"].encode(), scope["query_string"], body)
    for part in (*what, *tokens):
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.digest()


def key_mistake(keys: Sequence[str]) -> str:
    """Return what is wrong with the keys of a request, or nothing.

    There are two, or the one is empty or too long to keep.
    """
    if len(keys) > 1:
        return f"header Idempotency-Key stands {len(keys)} times: it is not clear which key to use"
    if not keys or 0 < len(keys[0]) <= KEY_CHARS:
        return ""
    return f"Idempotency-Key has {len(keys[0])} characters, 1 to {KEY_CHARS} are taken"


def check_keys(keys: Sequence[str]) -> None:
    """Refuse keys that cannot be kept.

    Raises:
        ProblemError: They are such.
    """
    mistake = key_mistake(keys)
    if mistake and len(keys) > 1:
        raise RefusedRequestError(
            ProblemDocument("doubled-header", mistake, remedy="send the header once")
        )
    if mistake:
        raise RefusedRequestError(ProblemDocument("bad-request", mistake, remedy="send a UUID"))


def reused(key: str) -> RefusedRequestError:
    """Return the error for a key that was used for another request."""
    return RefusedRequestError(
        ProblemDocument(
            "key-reused",
            f"Idempotency-Key {short(key)} was used for another request before",
            remedy="make a new key for every new request",
        )
    )
