"""A lease in a block: renewed, given up, lost; on the virtual clock, against a fake daemon."""

from __future__ import annotations

import json
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import anyio
import httpx2
import pytest

from client.conftest import line_of
from lecombus.client import LeaseLostError, Line, ProblemError, UnreachableError
from support.virtual_loop import run

TOKEN = "7-secret"
TIME_S = 2.0


def problem(status: int, kind: str) -> httpx2.Response:
    return httpx2.Response(status, json={"type": f"urn:lecombus:problem:{kind}", "detail": kind})


@dataclass
class FakeDaemon:
    """Grants one lease for `feeder` and `belt`, and writes what it is told."""

    renewals: list[tuple[float, int]] = field(default_factory=list)
    asked: list[tuple[str, str, str]] = field(default_factory=list)
    renewal: Callable[[], httpx2.Response | None] = lambda: None
    delay_s: Callable[[int], float] = lambda number: 0.0
    granted: httpx2.Response | None = None
    hangs: bool = False

    async def __call__(self, request: httpx2.Request) -> httpx2.Response:
        path = request.url.path
        self.asked.append((request.method, path, request.headers.get("lecombus-lease", "")))
        if path == "/v1/groups":
            both = {"group": "both", "members": ["feeder", "belt"]}
            three = {"group": "all", "members": ["feeder", "belt", "fan"]}
            return httpx2.Response(200, json={"groups": [both, three]})
        if not path.startswith("/v1/leases/"):
            return httpx2.Response(200, json={"outcome": "done"})
        if request.method == "DELETE":
            await anyio.sleep(1000.0 if self.hangs else 0.0)
            return httpx2.Response(200, json={})
        body = json.loads(request.content)
        if "token" not in body:
            return self.granted or httpx2.Response(200, json=self.document(body["counter"]))
        assert body["token"] == TOKEN
        self.renewals.append((anyio.current_time(), body["counter"]))
        await anyio.sleep(self.delay_s(len(self.renewals)))
        return self.renewal() or httpx2.Response(200, json=self.document(body["counter"]))

    def document(self, counter: int) -> dict[str, Any]:
        return {
            "name": "winder", "token": TOKEN, "targets": ["both"], "drives": ["feeder", "belt"],
            "time_s": TIME_S, "counter": counter, "latched": ["belt"],
        }  # fmt: skip

    def given_up(self) -> bool:
        return ("DELETE", "/v1/leases/winder", TOKEN) in self.asked


def broken() -> httpx2.Response:
    raise httpx2.ConnectError("refused")


def with_daemon(work: Callable[[Line, FakeDaemon], Awaitable[None]]) -> FakeDaemon:
    fake = FakeDaemon()
    run(work(line_of(httpx2.MockTransport(fake)), fake))  # type: ignore[arg-type]
    return fake


def test_a_lease_is_renewed_by_a_rising_counter_and_given_up_at_the_end() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        async with line.lease("winder", ["both"], TIME_S) as lease:
            assert (lease.name, lease.drives, lease.latched) == (
                "winder", ("feeder", "belt"), ("belt",),
            )  # fmt: skip
            await anyio.sleep(10.2)
            assert lease.is_valid
        assert not fake.given_up() or fake.asked[-1][0] == "DELETE"

    fake = with_daemon(work)
    assert fake.given_up()
    counters = [counter for _, counter in fake.renewals]
    assert counters == list(range(2, 22))


def test_writes_carry_the_token_only_where_the_lease_holds() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        async with line.lease("winder", ["both"], TIME_S):
            await line.drive("feeder").enable()
            await line.group("both").write("C0046", 5)
            await line.drive("fan").write("C0046", 5)
            await line.group("all").write("C0046", 5)
        await line.drive("feeder").write("C0046", 0)

    fake = with_daemon(work)
    tokens = [token for _, path, token in fake.asked if "leases" not in path and "C0" in path]
    assert tokens == [TOKEN, "", "", ""]
    assert ("POST", "/v1/drives/feeder/verbs/enable", TOKEN) in fake.asked


def test_a_block_that_fails_lets_the_lease_lapse_and_raises_its_own_error() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        async def block() -> None:
            async with line.lease("winder", ["both"], TIME_S):
                await anyio.sleep(1)
                _ = 1 / 0

        with pytest.raises(ZeroDivisionError):
            await block()

    fake = with_daemon(work)
    assert not fake.given_up()


def test_a_daemon_that_does_not_answer_the_end_is_an_error_of_the_client() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        with pytest.raises(UnreachableError, match="does not answer"):
            async with line.lease("winder", ["both"], TIME_S):
                fake.hangs = True

    assert with_daemon(work).given_up()


def test_a_block_that_is_cancelled_lets_the_lease_lapse() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        with anyio.move_on_after(1.2):
            async with line.lease("winder", ["both"], TIME_S):
                await anyio.sleep(100)

    fake = with_daemon(work)
    assert (fake.given_up(), len(fake.renewals)) == (False, 2)


@pytest.mark.parametrize(
    ("status", "kind"), [(409, "lease-lost"), (404, "no-such-lease"), (403, "not-permitted")]
)
def test_a_lease_that_the_daemon_ended_cancels_the_block(status: int, kind: str) -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: problem(status, kind) if len(fake.renewals) == 3 else None
        began_s = anyio.current_time()
        with pytest.raises(LeaseLostError, match=kind):
            async with line.lease("winder", ["both"], TIME_S) as lease:
                await anyio.sleep(100)
        assert anyio.current_time() - began_s == pytest.approx(1.5)
        assert not lease.is_valid

    assert not with_daemon(work).given_up()


def test_a_daemon_that_is_away_for_the_lease_time_cancels_the_block_then() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: None if len(fake.renewals) < 3 else broken()
        with pytest.raises(LeaseLostError, match="was not renewed within 2 s; lecombus does"):
            async with line.lease("winder", ["both"], TIME_S):
                await anyio.sleep(100)
        last_s = fake.renewals[1][0]
        assert anyio.current_time() == pytest.approx(last_s + TIME_S)

    with_daemon(work)


def test_a_daemon_that_is_away_for_less_is_not_noticed() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: broken() if len(fake.renewals) in (3, 4, 7) else None
        async with line.lease("winder", ["both"], TIME_S):
            await anyio.sleep(20)

    assert with_daemon(work).given_up()


def test_a_renewal_that_hangs_does_not_keep_the_next_from_being_sent() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.delay_s = lambda number: 1000.0 if number == 2 else 0.0
        async with line.lease("winder", ["both"], TIME_S):
            await anyio.sleep(20)

    assert with_daemon(work).given_up()


def test_a_renewal_counts_from_when_it_was_sent() -> None:
    """The daemon may have taken it at that moment."""

    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.delay_s = lambda number: 0.4 if number == 1 else 1000.0
        with pytest.raises(LeaseLostError):
            async with line.lease("winder", ["both"], TIME_S):
                await anyio.sleep(100)
        assert anyio.current_time() == pytest.approx(fake.renewals[0][0] + TIME_S)

    with_daemon(work)


def test_a_renewal_that_came_late_loses_nothing() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: problem(409, "stale-counter") if len(fake.renewals) == 2 else None
        async with line.lease("winder", ["both"], TIME_S):
            await anyio.sleep(5)

    assert with_daemon(work).given_up()


def test_a_block_may_renew_by_itself_and_must_then() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        async def block() -> None:
            async with line.lease("winder", ["both"], TIME_S, renews=False) as lease:
                for _ in range(4):
                    await anyio.sleep(1.5)
                    await lease.renew()
                await anyio.sleep(100)

        with pytest.raises(LeaseLostError, match="was not renewed"):
            await block()
        assert anyio.current_time() == pytest.approx(fake.renewals[-1][0] + TIME_S)

    assert [counter for _, counter in with_daemon(work).renewals] == [2, 3, 4, 5]


def test_a_lost_lease_is_one_error_when_the_block_finds_out_itself() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: problem(409, "lease-lost")
        with pytest.raises(LeaseLostError) as caught:
            async with line.lease("winder", ["both"], TIME_S, renews=False) as lease:
                await lease.renew()
        assert caught.value.__cause__ is None

    with_daemon(work)


def test_a_lease_that_is_not_granted_is_an_error_before_the_block() -> None:
    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.granted = problem(409, "lease-held")
        with pytest.raises(ProblemError, match="lease-held"):
            async with line.lease("winder", ["both"], TIME_S, take_over="other"):
                raise AssertionError
        fake.granted = httpx2.Response(200, text="<html>")
        with pytest.raises(UnreachableError, match="is not lecombus"):
            async with line.lease("winder", ["both"], TIME_S):
                raise AssertionError

    with_daemon(work)


@pytest.mark.parametrize("renews", [True, False])
def test_a_time_that_a_reload_shortened_counts_for_the_client_too(renews: bool) -> None:
    """The daemon answers each renewal with the time that holds from then on."""

    async def work(line: Line, fake: FakeDaemon) -> None:
        fake.renewal = lambda: (
            httpx2.Response(200, json=fake.document(2) | {"time_s": 1.0})
            if len(fake.renewals) == 1
            else broken()
        )

        async def block() -> None:
            async with line.lease("winder", ["both"], TIME_S, renews=renews) as lease:
                await anyio.sleep(0.5)
                if not renews:
                    await lease.renew()
                await anyio.sleep(100)

        with pytest.raises(LeaseLostError, match="was not renewed within 1 s"):
            await block()
        assert anyio.current_time() == pytest.approx(fake.renewals[0][0] + 1.0)

    with_daemon(work)


@pytest.mark.clock
def test_an_event_loop_that_stalls_loses_the_lease() -> None:
    async def work() -> None:
        fake = FakeDaemon()
        line = line_of(httpx2.MockTransport(fake))
        fake.granted = httpx2.Response(200, json=fake.document(1) | {"time_s": 0.2})

        async def block() -> None:
            async with line.lease("winder", ["both"], 0.2):
                time.sleep(0.3)  # noqa: ASYNC251 - that is the mistake
                await anyio.sleep(100)

        with pytest.raises(LeaseLostError):
            await block()
        assert fake.renewals == []

    anyio.run(work)
