"""A line of drives behind a running daemon: what a program asks and what it has done.

Strategy: `connect` gives a `Line`; `Line.drive` and `Line.group` give objects that hold no more
than a name. Reads raise an error when there is no value to give. Writes, verbs and stops give a
result with an outcome, also when lecombus or the drive refuses; they raise an error only when
nothing can have been sent because the daemon is not there, or the request itself is wrong.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar
from urllib.parse import quote

from lecombus.client.connection import (
    ANSWER_WITHIN_S,
    LEASE_HEADER,
    REPEAT_FOR_S,
    AnswerLostError,
    Connection,
    Json,
    open_connection,
    problem_error,
)
from lecombus.client.documents import (
    Answer,
    Document,
    DriveStatus,
    GroupInfo,
    LineStatus,
)
from lecombus.client.drive import Drive, Group, StopAction
from lecombus.client.finding import find_daemon
from lecombus.client.requests import lease_document
from lecombus.client.results import GroupResult, Outcome, Result

if TYPE_CHECKING:
    from lecombus.client.events import Event
    from lecombus.client.lease import Lease

__all__ = ["Line", "connect"]

WRONG_REQUESTS: Final = frozenset((400, 401, 404, 405, 413, 414, 421, 422, 431))
"""HTTP statuses that say that the request is wrong, however often it is sent."""

R = TypeVar("R", bound=Result)


@asynccontextmanager
async def connect(
    socket: str | None = None,
    url: str | None = None,
    *,
    token_file: str | Path | None = None,
    ca: str | Path | None = None,
    certificate: str | Path | None = None,
    answer_within_s: float = ANSWER_WITHIN_S,
    repeat_for_s: float = REPEAT_FOR_S,
) -> AsyncIterator[Line]:
    """Connect to the daemon of a line.

    Args:
        socket: The path of its Unix socket.
        url: Its HTTP address, such as `https://hall-3.example:9740`. None for both: what
            LECOMBUS_SOCKET or LECOMBUS_URL says, else the only socket in /run/lecombus.
        token_file: The file that holds the bearer token, for a URL.
        ca: The file with the certificates that sign the daemon's; None: the system's.
        certificate: The file with the client's certificate and key, where the daemon asks for one.
        answer_within_s: How long to wait for an answer, seconds.
        repeat_for_s: How long a write whose connection broke is repeated, seconds; 0: never.

    Raises:
        AmbiguousDaemonError: Both are given, or it is not clear which daemon is meant.
        NotPermittedError: The socket or a file may not be opened.
        UnreachableError: No daemon listens at the socket.
    """
    path, base = find_daemon(socket, url)
    async with open_connection(
        path, base, token_file=token_file, ca=ca, certificate=certificate,
        answer_within_s=answer_within_s, repeat_for_s=repeat_for_s,
    ) as connection:  # fmt: skip
        yield Line(connection)


class Line:
    """A line of drives.

    Args:
        connection: Speaks with its daemon.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._leases: list[tuple[Lease, frozenset[str]]] = []

    @property
    def where(self) -> str:
        """The socket's path or the URL of its daemon."""
        return self.connection.where

    def drive(self, name: str) -> Drive:
        """Return a drive by its name in the roster; nothing is asked yet.

        Raises:
            ProblemError: No drive can have this name.
        """
        return Drive(self, name)

    def group(self, name: str) -> Group:
        """Return a group by its name in the roster; `all` is every drive.

        Raises:
            ProblemError: No group can have this name.
        """
        return Group(self, name)

    async def status(self) -> LineStatus:
        """Return how the line is doing; nothing is sent to it.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return LineStatus.of((await self.ask("/v1/line")).data)

    async def drives(self) -> list[DriveStatus]:
        """Return every drive with all that is known of it; nothing is sent to the line.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return [DriveStatus.of(one) for one in (await self.ask("/v1/drives")).data["drives"]]

    async def groups(self) -> list[GroupInfo]:
        """Return the groups of the roster.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return [GroupInfo.of(one) for one in (await self.ask("/v1/groups")).data["groups"]]

    async def stop(self, target: str = "all", action: StopAction = "quick-stop") -> GroupResult:
        """Stop drives, before everything else; needs no lease.

        Check the result: a stop that is not `verified` leaves motors that may turn. This is no
        safety function.

        Args:
            target: A drive, a group, or `all`.
            action: `quick-stop`: along the drive's ramp. `inhibit`: no torque, the motor coasts.

        Raises:
            ProblemError: There is no such drive or group.
            UnreachableError: The daemon cannot be reached: nothing was stopped.
        """
        document: dict[str, Json] = {"action": action, "target": target}
        what = {"target": target, "drive": target}
        return await self.result("POST", "/v1/stop", document, GroupResult.of, what)

    def events(
        self,
        *,
        drives: Iterable[str] = (),
        kinds: Iterable[str] = (),
        after: str = "",
        patience_s: float = 60.0,
    ) -> AsyncGenerator[Event, None]:
        """Give what happens, as it happens: `async for event in line.events(kinds=["trip"])`.

        A connection that breaks is opened again, and what happened in between follows; an event
        `gap` says that some of it is missing: `drives` then has what is known now.

        Args:
            drives: Events about these drives or groups, and about the line; none: about any.
            kinds: Of `value`, `state`, `remark`, `trip`, `write`, `lease`, `line`; none: of any.
            after: The id of the last event had; empty: begin now.
            patience_s: How long the daemon may be away, seconds.

        Raises:
            ProblemError: There is no such drive or kind.
            UnreachableError: The daemon is away for longer.
        """
        from lecombus.client.events import read_events  # it loads anyio

        params = {"drive": ",".join(drives), "kind": ",".join(kinds)}
        wanted = {key: text for key, text in params.items() if text}
        return read_events(self.connection, wanted, after, patience_s)

    @asynccontextmanager
    async def lease(
        self,
        name: str,
        targets: Iterable[str],
        time_s: float,
        *,
        take_over: str = "",
        renews: bool = True,
    ) -> AsyncIterator[Lease]:
        """Control drives: `async with line.lease("winder", ["feeder", "belt"], 2.0):`.

        Writes and verbs of this line to these drives carry the lease's token. A task of this event
        loop renews the lease. If the program ends, or its event loop stalls, the lease lapses after
        `time_s`, and lecombus does with the drives what `on_lapse` of the roster says. Drives that
        are latched must be enabled before they take setpoints.

        The end of the block gives the lease up. A block that ends with an error lets it lapse.

        Args:
            name: Its name, for people and for a later controller: 1 to 60 letters, digits, `.`,
                `_` and `-`.
            targets: The drives and groups.
            time_s: How long after the last renewal it lapses, seconds; at most `lease.time` of
                each drive.
            take_over: The name of the lease that holds the drives; its token counts no more.
            renews: False: no task renews it, the block calls `Lease.renew`.

        Raises:
            ProblemError: It is not granted: `lease-held`, `no-such-drive` ..
            UnreachableError: The daemon cannot be reached.
            LeaseLostError: The lease was lost; the block was cancelled.
            ValueError: The time is below 0.001 s or above an hour.
        """
        from lecombus.client.lease import hold  # it loads anyio

        document = lease_document(targets, time_s, take_over)
        groups = await self.groups()
        path = f"/v1/leases/{quote(name, safe='')}"
        async with hold(self.connection, path, document, renews=renews) as lease:
            whole = {one.name for one in groups if set(one.members) <= set(lease.drives)}
            covered = (lease, frozenset((*lease.drives, *whole)))
            self._leases.append(covered)
            try:
                yield lease
            finally:
                self._leases.remove(covered)

    async def ask(self, path: str, **params: str) -> Answer:
        """Ask for any document of docs/api.md.

        Raises:
            ProblemError: The daemon refuses.
            UnreachableError: It cannot be reached.
        """
        return await self.connection.ask(path, params)

    async def act(
        self, method: str, path: str, document: Mapping[str, Json] | None = None
    ) -> Answer:
        """Ask for any action of docs/api.md, with an `Idempotency-Key`.

        Returns:
            What the daemon answers, also if it is a problem document with an outcome.

        Raises:
            ProblemError: The daemon refuses, and nothing was sent to a drive.
            UnreachableError: It cannot be reached, or its answer was lost.
        """
        answer = await self.connection.act(method, path, document)
        done = 200 <= answer.status < 300
        found: Document = answer.data if isinstance(answer.data, dict) else {}
        if done or (found.get("outcome") and found.get("sent") is not False):
            return answer
        raise problem_error(answer)

    def _token_for(self, target: str) -> dict[str, str]:
        """Return the header that a write to a drive or a group carries."""
        for lease, covered in reversed(self._leases):
            if target in covered:
                return {LEASE_HEADER: lease.token}
        return {}

    async def result(
        self,
        method: str,
        path: str,
        document: Mapping[str, Json] | None,
        read: Callable[[Document, Answer | None], R],
        what: Mapping[str, Json],
        *,
        asked_ago_s: float = 0.0,
    ) -> R:
        """Have something done, and return how it ended, also if its answer was lost.

        Args:
            method: The HTTP method.
            path: The path.
            document: The body.
            read: Makes the result of the answer.
            what: What the result says of the request, where the daemon said nothing.
            asked_ago_s: How long ago it was asked for, seconds: a stop since then ends it.

        Raises:
            ProblemError: The request is wrong: it was not carried out.
            UnreachableError: Nothing was sent.
        """
        try:
            target = str(what.get("target") or what.get("drive"))
            answer = await self.connection.act(
                method, path, document, self._token_for(target), asked_ago_s=asked_ago_s
            )
        except AnswerLostError as exc:
            remedy = "it may have happened: read back, or look at the drive, before it is repeated"
            lost = {"reason": exc.problem, "remedy": remedy, "type": "answer-lost"}
            return read({**what, **lost, "outcome": Outcome.UNKNOWN.value}, None)
        found: Document = answer.data if isinstance(answer.data, dict) else {}
        if found.get("outcome"):
            return read({**what, **known_of(found)}, answer)
        if answer.status in WRONG_REQUESTS:
            raise problem_error(answer)
        refused = 400 <= answer.status < 500 or answer.status == 503
        outcome = Outcome.REFUSED if refused else Outcome.UNKNOWN
        return read({**what, **known_of(found), "outcome": outcome.value}, answer)


def known_of(document: Document) -> Document:
    """Return what a document says, without its keys of null."""
    return {key: found for key, found in document.items() if found is not None}
