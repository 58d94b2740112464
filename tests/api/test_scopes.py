"""What each call needs: the guard behind every route, with any door's grant."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, cast

import httpx2
import pytest
from starlette.applications import Starlette
from starlette.routing import Route

from lecombus.api.limits import EVENTS_PATH
from lecombus.api.scopes import NEEDS, Need, Of, guarded
from lecombus.operations.actions import ACTOR, Actor
from lecombus.operations.facade import Operations
from lecombus.operations.operation_reports import GroupFacts
from lecombus.tokens.grants import NOTHING, Grant, Scope, granted
from support.api_line import Line, make_line

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

METHODS = {
    "/v1/stop": {"action": "inhibit", "target": "all"},
    "/v1/leases/{lease}": {"targets": ["feeder"], "time": "1s", "counter": 1},
    "/v1/drives/{drive}/address": {"address": 12},
    "/v1/drives/{drive}/accept": {"identity": {"C1810": "NEW"}},
    "/v1/drives/{drive}/verbs/{verb}": {"value": 10, "unit": "Hz"},
}
"""Bodies by path; codes take a value."""

PLACES = {"drive": "feeder", "group": "conveyors", "code": "C0012", "subcode": "0",
          "verb": "set-speed", "lease": "plc", "address": "21"}  # fmt: skip


@contextmanager
def acting(grant: Grant) -> Iterator[None]:
    token = ACTOR.set(Actor("test", grant=grant))
    try:
        yield
    finally:
        ACTOR.reset(token)


async def ask(
    app: Starlette, method: str, template: str, body: dict[str, Any] | None = None, **places: str
) -> httpx2.Response:
    path = template.format(**PLACES | places)
    transport = httpx2.ASGITransport(app=app)
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
        if method == "GET":
            if path == EVENTS_PATH and (head := await client.head(path)).status_code == 200:
                return head  # events have no end
            return await client.get(path)
        default = {"value": 1} if "{code}" in template else {}
        given = METHODS.get(template, default) if body is None else body
        return await client.request(method, path, json=given)


def allows(answer: httpx2.Response) -> bool:
    kind = answer.json()["type"] if answer.status_code == 403 else ""
    return not kind.endswith((":not-permitted", ":read-only"))


@pytest.mark.parametrize(("method", "path"), NEEDS)
async def test_nothing_is_answered_without_a_grant(line: Line, method: str, path: str) -> None:
    with acting(NOTHING):
        answer = await ask(line.app, method, path)
    assert (answer.status_code, answer.json()["type"]) == (
        403,
        "urn:lecombus:problem:not-permitted",
    )
    assert line.ops.asked == []


@pytest.mark.parametrize(("call", "need"), NEEDS.items())
@pytest.mark.parametrize("scope", Scope)
async def test_a_scope_opens_the_calls_that_need_it(
    line: Line, call: tuple[str, str], need: Need, scope: Scope
) -> None:
    """C0012 is a setting: its write needs `write`."""
    grant = granted([scope])
    with acting(grant):
        answer = await ask(line.app, *call)
    assert allows(answer) == ((need.scope or Scope.WRITE) in grant.scopes)
    assert allows(answer) or line.ops.asked == []
    if not allows(answer):
        wanted = need.scope or Scope.WRITE
        assert f'scope="{wanted}"' in answer.headers["www-authenticate"]


@pytest.mark.parametrize(("call", "need"), NEEDS.items())
async def test_a_token_for_another_drive_opens_no_call_about_this_one(
    line: Line, call: tuple[str, str], need: Need
) -> None:
    with acting(granted(Scope, ["belt"])):
        answer = await ask(line.app, *call)
    assert allows(answer) == (need.of is Of.NO_DRIVE)
    assert allows(answer) or line.ops.asked == []


@pytest.mark.parametrize(
    ("code", "scope"),
    [
        ("C0046", "control"),  # setpoint
        ("C0040", "control"),  # controller inhibit
        ("C0135", "control"),  # control word
        ("C0012", "write"),  # acceleration time
        ("C0001", "control"),  # says who controls it: the line or the terminals
        ("C2001", "control"),  # the same of another parameter set
        ("C0011", "control"),  # what 100 % of a setpoint are
        ("C2011", "control"),  # the same of another parameter set
        ("C0410", "control"),  # wires its signals
        ("C0002", "control"),  # loads parameter sets
        ("C0043", "control"),  # resets a trip
        ("C1234", "control"),  # nothing is known of it
    ],
)
async def test_what_may_move_a_drive_needs_control(line: Line, code: str, scope: str) -> None:
    for template in ("/v1/drives/{drive}/codes/{code}", "/v1/groups/{group}/codes/{code}"):
        for given in (Scope.WRITE, Scope.CONTROL):
            with acting(granted([given])):
                answer = await ask(line.app, "PUT", template, code=code)
            assert allows(answer) == (given == scope), (template, given)


async def test_a_code_that_is_none_is_not_found_rather_than_forbidden(line: Line) -> None:
    with acting(granted([Scope.WRITE])):
        answer = await ask(line.app, "PUT", "/v1/drives/{drive}/codes/{code}", code="Q1")
    assert answer.json()["type"] == "urn:lecombus:problem:no-such-code"


@pytest.mark.parametrize(
    ("targets", "target", "stops"),
    [
        (["feeder"], "feeder", True),
        (["feeder"], "belt", False),
        (["feeder"], "conveyors", False),
        (["feeder"], "all", True),  # the fake's group of all has one drive
        (["belt"], "all", False),
        (["conveyors"], "conveyors", True),
        (["conveyors"], "belt", True),
        (["feeder", "belt"], "conveyors", True),
        (["feeder"], "nowhere", False),
        (["all"], "nowhere", True),  # which the operations refuse
    ],
)
async def test_a_stop_needs_all_that_it_stops(
    line: Line, targets: list[str], target: str, stops: bool
) -> None:
    with acting(granted([Scope.CONTROL], targets)):
        answer = await ask(line.app, "POST", "/v1/stop", {"action": "inhibit", "target": target})
    assert allows(answer) == stops
    assert bool(line.ops.asked) == stops


async def test_a_group_that_a_reload_widens_while_the_body_comes_is_judged_by_what_it_is_then(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body() -> AsyncIterator[bytes]:
        yield b'{"val'
        wide = GroupFacts("conveyors", ("feeder", "belt", "fan"), None)
        monkeypatch.setattr(line.ops, "groups", lambda: (wide,))
        yield b'ue": 1}'

    transport = httpx2.ASGITransport(app=line.app)
    with acting(granted([Scope.CONTROL], ["feeder", "belt"])):
        async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
            answer = await client.put("/v1/groups/conveyors/codes/C0046", content=body())
    assert answer.status_code == 403, answer.text
    assert line.ops.asked == []


async def test_a_lease_of_other_drives_is_neither_seen_nor_ended(line: Line) -> None:
    path = "/v1/leases/{lease}"
    token = (await ask(line.app, "PUT", path)).json()["token"]
    with acting(granted(Scope, ["belt"])):
        assert not allows(await ask(line.app, "PUT", path, {"token": token, "counter": 2}))
        assert not allows(await ask(line.app, "DELETE", path))
        seen = (await ask(line.app, "GET", "/v1/leases")).json()
        assert seen == {"leases": [], "drives": []}
    assert [lease.counter for lease in line.ops.leases.held()] == [1]


async def test_a_take_over_of_a_lease_says_nothing_of_drives_that_the_token_is_not_for(
    line: Line,
) -> None:
    path = "/v1/leases/{lease}"
    both = {"targets": ["feeder", "belt"], "time": "1s", "counter": 1}
    await ask(line.app, "PUT", path, both)
    with acting(granted(Scope, ["belt"])):
        taking = {**both, "targets": ["belt"], "take_over": PLACES["lease"]}
        answer = await ask(line.app, "PUT", path, taking, lease="other")
    assert (answer.status_code, answer.json()["type"]) == (
        403,
        "urn:lecombus:problem:not-permitted",
    )
    assert "feeder" not in answer.text
    assert [lease.name for lease in line.ops.leases.held()] == [PLACES["lease"]]


async def test_lists_show_the_drives_of_the_token_only(line: Line) -> None:
    async def seen() -> tuple[list[str], list[str], int]:
        drives = (await ask(line.app, "GET", "/v1/drives")).json()["drives"]
        groups = (await ask(line.app, "GET", "/v1/groups")).json()["groups"]
        counts = (await ask(line.app, "GET", "/v1/line")).json()["drives"]
        return [one["drive"] for one in drives], [one["group"] for one in groups], counts["online"]

    assert await seen() == (["feeder", "belt"], ["conveyors", "all"], 2)
    with acting(granted([Scope.READ], ["belt"])):
        assert await seen() == (["belt"], [], 1)
    with acting(granted([Scope.READ], ["conveyors"])):
        assert await seen() == (["feeder", "belt"], ["conveyors", "all"], 2)


@pytest.mark.parametrize(("call", "need"), NEEDS.items())
async def test_a_read_only_daemon_reads_and_stops(call: tuple[str, str], need: Need) -> None:
    line = make_line()
    routes = cast(list[Route], line.app.routes)
    ops, family_of = cast(Operations, line.ops), line.store.family
    line.app.router.routes[:] = guarded(routes, ops, family_of, read_only=True)
    answer = await ask(line.app, *call)
    reads = need.scope in (Scope.METRICS, Scope.READ)
    assert allows(answer) == (reads or need.is_stop)
    if not allows(answer):
        assert answer.json()["type"] == "urn:lecombus:problem:read-only"
        assert line.ops.asked == []
    assert {need.is_stop for call, need in NEEDS.items() if call[1] == "/v1/stop"} == {True}


def test_a_route_without_a_row_ends_the_start(line: Line) -> None:
    async def open_door(request: Any) -> Any: ...

    with pytest.raises(AssertionError, match=r"no row .* POST /v1/new"):
        guarded(
            [Route("/v1/new", open_door, methods=["POST"])], cast(Operations, line.ops),
            line.store.family, read_only=False,
        )  # fmt: skip


def test_every_row_is_a_route(line: Line) -> None:
    found = {
        (method, route.path)
        for route in line.app.routes
        if isinstance(route, Route)
        for method in route.methods or ()
    }
    assert {call for call in found if call[0] != "HEAD"} == set(NEEDS)


@pytest.mark.parametrize(
    "path",
    ["/v1//drives/belt", "/v1/drives/feeder/../belt", "/v1/drives/feeder%2F..%2Fbelt",
     "/v1/drives/feeder/%2e%2e/belt", "/v1/drives/./belt", "/v1/drives/belt/", "/v1/drives/belt%00",
     "/v1/drives/%62elt", "/V1/drives/belt", "/v1/drives/feeder%2fcodes", "/v1/drives/belt;x=1",
     "//v1/drives/belt"],
)  # fmt: skip
async def test_no_spelling_of_a_path_leads_to_another_drive(line: Line, path: str) -> None:
    with acting(granted([Scope.READ], ["feeder"])):
        transport = httpx2.ASGITransport(app=line.app)
        async with httpx2.AsyncClient(transport=transport, base_url="http://x") as client:
            answer = await client.get(path)
    assert answer.status_code in (403, 404)
    assert "35.4" not in answer.text


def test_what_asks_is_shown_by_name_and_without_its_rights() -> None:
    actor = Actor("tcp", client="10.0.0.7:5000", token="plc", subject="CN=plc 1")
    actor = replace(actor, grant=granted([Scope.CONTROL]))
    assert actor.fields() == {
        "who": "tcp", "token": "plc", "subject": "CN_plc_1", "client": "10.0.0.7:5000"
    }  # fmt: skip
    assert actor.kind() == "tcp plc"
