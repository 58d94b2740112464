"""A lease as a program holds it: taken, renewed beside its body, given up or left to lapse.

Strategy: a task of the same event loop renews the lease with a counter; a program that crashed, and
one whose event loop stalls, renews nothing, and lecombus carries out `on_lapse`. The end is
calculated from the time at which the last successful renewal was sent, so that the program never
counts the lease as held for longer than the daemon does. Then the body is cancelled.

A body that ends with an error does not give the lease up: it lapses, as after a crash, because
giving up leaves drives alone whose roster requires no lease.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Final

import anyio

from lecombus.client.connection import LEASE_HEADER, Connection, Json, problem_error
from lecombus.client.documents import Answer, Document, kind_of
from lecombus.client.errors import ClientError, LeaseLostError, UnreachableError

__all__ = ["Lease", "hold"]

RENEWALS: Final = 4
"""Within the lease time: some may be lost."""

GIVE_UP_WITHIN_S: Final = 5.0

NEWER: Final = "stale-counter"
"""A renewal that came after a later one; nothing is lost by it."""


class Lease:
    """A lease that this program holds.

    Args:
        connection: Speaks with the daemon.
        path: Of the lease.
        answer: What the daemon said when it was taken.
        asked_s: When that was asked.

    Attributes:
        name: Its name.
        token: What writes under it carry; the library adds it.
        targets: The drives and groups as they were named.
        drives: The drives.
        time_s: It lapses so long after the last renewal, seconds; a reload may have shortened it.
        document: What the daemon said last.
        lost: Why it was lost; None: it is held.
    """

    def __init__(
        self, connection: Connection, path: str, answer: Document, asked_s: float, counter: int
    ) -> None:
        self._connection = connection
        self._path = path
        self._counter = counter
        self.name = str(answer["name"])
        self.token = str(answer["token"])
        self.targets = tuple(answer.get("targets") or ())
        self.drives = tuple(answer["drives"])
        self.time_s = float(answer["time_s"])
        self._renewed_s = asked_s
        self.document = answer
        self.lost: ClientError | None = None

    @property
    def valid_until_s(self) -> float:
        """When it ends unless it is renewed, by `anyio.current_time`."""
        return self._renewed_s + self.time_s

    @property
    def latched(self) -> tuple[str, ...]:
        """The drives that take no setpoint until they are enabled, as the daemon said last."""
        return tuple(self.document.get("latched") or ())

    @property
    def is_valid(self) -> bool:
        """Whether it is held, as far as this program can know."""
        return self.lost is None and anyio.current_time() < self.valid_until_s

    @property
    def left_s(self) -> float:
        """How long it still lasts without a renewal, seconds."""
        return max(0.0, self.valid_until_s - anyio.current_time())

    async def renew(self) -> None:
        """Renew it once, with the next number of the counter.

        A control loop that calls this itself (`renews=False`) shows that it turns.

        Raises:
            LeaseLostError: It has ended.
            UnreachableError: This renewal did not succeed; the next one may.
        """
        asked_s = anyio.current_time()
        if not self.is_valid:
            raise self.end(f"lease {self.name} was not renewed within {self.time_s:g} s")
        self._counter += 1
        document: dict[str, Json] = {"token": self.token, "counter": self._counter}
        answer = await self._connection.once("PUT", self._path, document)
        found: Document = answer.data if isinstance(answer.data, dict) else {}
        if answer.status == 200:
            self.document = found
            self.time_s = float(found.get("time_s") or self.time_s)
            self._renewed_s = max(self._renewed_s, asked_s)
        elif answer.status >= 500 or answer.status == 429:
            raise UnreachableError(problem_error(answer).problem)
        elif kind_of(found) != NEWER:
            problem = problem_error(answer)
            raise self.end(problem.problem, problem.remedy)

    def end(self, problem: str, remedy: str = "") -> LeaseLostError:
        """Let it count as lost; returns the error."""
        left = "lecombus does to its drives what `on_lapse` says; take it again, then enable them"
        self.lost = LeaseLostError(problem, remedy or left, "lease-lost")
        return self.lost

    async def keep(self) -> None:
        """Renew it until it is lost."""
        next_s = anyio.current_time()
        while self.lost is None:
            every_s = self.time_s / RENEWALS
            next_s = max(next_s + every_s, anyio.current_time())
            await anyio.sleep_until(min(next_s, self.valid_until_s))
            # A renewal that is held up must not keep the next one from being sent. Of those that
            # fail none is the last, until the time is over: then `renew` says so.
            with (
                suppress(LeaseLostError, UnreachableError),
                anyio.move_on_after(min(1.5 * every_s, self.left_s)),
            ):
                await self.renew()

    async def give_up(self) -> None:
        """End it on purpose: drives whose roster requires a lease are stopped.

        Raises:
            LeaseLostError: It had ended.
            UnreachableError: The daemon cannot be reached: it lapses.
        """
        headers = {LEASE_HEADER: self.token}
        try:
            with anyio.fail_after(GIVE_UP_WITHIN_S, shield=True):
                answer = await self._connection.once("DELETE", self._path, None, headers)
        except TimeoutError as exc:
            problem = f"the daemon at {self._connection.where} does not answer in time"
            remedy = f"lease {self.name} lapses within {self.time_s:g} s unless it was given up"
            raise UnreachableError(problem, remedy) from exc
        if answer.status != 200:
            raise self.end(problem_error(answer).problem)


@asynccontextmanager
async def hold(
    connection: Connection, path: str, document: Mapping[str, Json], *, renews: bool
) -> AsyncIterator[Lease]:
    """Take a lease and hold it for as long as the block runs.

    Args:
        connection: Speaks with the daemon.
        path: Of the lease.
        document: What is asked for.
        renews: Whether a task renews it; otherwise the block calls `renew`.

    Raises:
        ProblemError: It is not granted.
        UnreachableError: The daemon cannot be reached.
        LeaseLostError: It was lost while the block ran, which was cancelled.
    """
    asked_s = anyio.current_time()
    lease = lease_of(await connection.once("PUT", path, document), connection, path, asked_s)
    failure: Exception | None = None
    async with anyio.create_task_group() as tasks:

        async def keep() -> None:
            await (lease.keep() if renews else watch(lease))
            tasks.cancel_scope.cancel()

        tasks.start_soon(keep)
        try:
            yield lease
        except Exception as exc:  # noqa: BLE001 - raised again below, without a group round it
            failure = exc
        tasks.cancel_scope.cancel()
    if lease.lost is not None:
        raise lease.lost from (None if failure is lease.lost else failure)
    if failure is not None:
        raise failure
    await lease.give_up()


async def watch(lease: Lease) -> None:
    """Wait until a lease that its block renews has ended."""
    while (left_s := lease.left_s) > 0 and lease.lost is None:  # noqa: ASYNC110 - it is renewed
        await anyio.sleep(min(left_s, lease.time_s / RENEWALS))  # a renewal may shorten it
    if lease.lost is None:
        lease.end(f"lease {lease.name} was not renewed within {lease.time_s:g} s")


def lease_of(answer: Answer, connection: Connection, path: str, asked_s: float) -> Lease:
    """Return the lease that the daemon granted.

    Raises:
        ProblemError: It granted none.
    """
    if answer.status != 200:
        raise problem_error(answer)
    return Lease(connection, path, answer.data, asked_s, int(answer.data.get("counter") or 1))
