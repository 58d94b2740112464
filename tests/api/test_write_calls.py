"""Every call that writes leaves one row of the journal, and needs the lease that a roster asks for.

All calls of `NEEDS` that need `write` or `control` are made on a whole line of simulated drives, so
a call that is new is checked too, or must be named here with a reason.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import httpx2
import pytest

from lecombus.api.scopes import NEEDS
from lecombus.fieldbus.requests import ReadWork
from lecombus.operations.actions import ACTOR, Act, Actor
from lecombus.schedule import Request
from lecombus.tokens.grants import EVERYTHING, Scope
from support.api_line import app_of
from support.rosters import roster_text
from support.site_host import Plant, with_plant

DRIVES = [("a", 11, "8200vector"), ("b", 12, "8200vector")]
GROUPS = "\ngroups: {pair: {members: [a, b], multicast: yes}}"

ROWS_ELSEWHERE = {
    ("PUT", "/v1/leases/{lease}"): "tests/supervision/test_journal_record.py: leases",
    ("DELETE", "/v1/leases/{lease}"): "the same",
    ("POST", "/v1/reload"): "the same: rosters",
}
"""Calls that are not operation: what the journal has of them is recorded by other means."""

NO_LEASE = {
    *ROWS_ELSEWHERE,
    ("POST", "/v1/drives/{drive}/accept"),  # sends nothing
    ("POST", "/v1/drives/{drive}/forget-times"),  # sends nothing
}
"""Calls that change no drive."""

CALLS = [
    call for call, need in NEEDS.items()
    if need.scope in (None, Scope.WRITE, Scope.CONTROL) and call not in ROWS_ELSEWHERE
]  # fmt: skip

UNDER_LEASE = [call for call in CALLS if call not in NO_LEASE and not NEEDS[call].is_stop]

BODIES: dict[str, dict[str, Any]] = {
    "/v1/stop": {"action": "inhibit", "target": "a"},
    "/v1/drives/{drive}/verbs/{verb}": {"value": 20, "unit": "Hz"},
    "/v1/drives/{drive}/address": {"address": 35},
    "/v1/drives/{drive}/accept": {"identity": {"C0099": "another"}},
}
"""Bodies by path; a write of a code takes a value."""

PLACES = {"drive": "a", "group": "pair", "code": "C0012", "subcode": "0", "verb": "set-speed"}

LEASE = "/v1/leases/plc"

Ask = Callable[[tuple[str, str]], Awaitable[httpx2.Response]]


class Follower:
    """Remembers operations and their ends."""

    def __init__(self) -> None:
        self.ends: list[tuple[str, str]] = []

    def begun(self, act: Act) -> None:
        return None

    def ended(self, act: Act, outcome: str, fields: object) -> None:
        self.ends.append((act.target, outcome))


def with_calls(
    test: Callable[[Plant, httpx2.AsyncClient, Ask], Awaitable[None]], *, lease: str = ""
) -> None:
    """Run a test with a line behind HTTP, and what makes a call of `NEEDS` there."""

    async def scenario(plant: Plant) -> None:
        await plant.online()
        ACTOR.set(Actor("socket", grant=EVERYTHING))
        transport = httpx2.ASGITransport(app_of(plant))
        async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:

            async def ask(call: tuple[str, str]) -> httpx2.Response:
                method, path = call
                default = {"value": 7} if "{code}" in path else {}
                body = BODIES.get(path, default)
                return await client.request(method, path.format(**PLACES), json=body)

            await test(plant, client, ask)

    with_plant(
        scenario,
        roster_text(
            DRIVES,
            drive=f"allow_address_change: true, also_writable: [C0012]{lease}",
            sections=GROUPS,
        ),
    )


@pytest.mark.parametrize("call", CALLS, ids=" ".join)
def test_a_call_that_writes_ends_in_one_row(call: tuple[str, str]) -> None:
    async def test(plant: Plant, client: httpx2.AsyncClient, ask: Ask) -> None:
        follower = Follower()
        plant.site.operations.actions.followers += (follower,)
        answer = await ask(call)
        assert answer.status_code != 422, answer.text
        target = "pair" if "{group}" in call[1] else "a"
        assert [end[0] for end in follower.ends] == [target]

    with_calls(test)


@pytest.mark.parametrize("call", UNDER_LEASE, ids=" ".join)
def test_a_call_that_changes_a_drive_needs_its_lease(call: tuple[str, str]) -> None:
    """Without it nothing is sent; with it, the lease is asked for before every telegram."""

    async def test(plant: Plant, client: httpx2.AsyncClient, ask: Ask) -> None:
        submitted: list[Request] = []
        schedule = plant.site.schedule
        submit = schedule.submit

        def noted(request: Request, now_s: float) -> None:
            submitted.append(request)
            submit(request, now_s)

        schedule.submit = noted  # type: ignore[method-assign]
        refused = await ask(call)
        assert refused.json()["type"] == "urn:lecombus:problem:lease-required", refused.text
        assert [one for one in submitted if is_write(one)] == []
        asked = {"targets": ["a", "b"], "time": "60s", "counter": 1}
        token = (await client.put(LEASE, json=asked)).raise_for_status().json()["token"]
        client.headers["Lecombus-Lease"] = token
        if call[1] != "/v1/drives/{drive}/address":  # which wants a stopped drive
            (await client.post("/v1/drives/a/verbs/enable")).raise_for_status()
            (await client.post("/v1/drives/b/verbs/enable")).raise_for_status()
        submitted.clear()
        done = await ask(call)
        assert done.status_code == 200, done.text
        writes = [one for one in submitted if is_write(one)]
        assert writes
        assert [one for one in writes if one.lease_ended is None] == []

    with_calls(test, lease=", lease: {required: true, time: 60s}")


def is_write(request: Request) -> bool:
    return not isinstance(request.work, ReadWork)
