"""Who may do what over TCP; that the server uses these rules is in `test_server`."""

from __future__ import annotations

import httpx2
import pytest
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from lecombus.api.access import OwnPagesAccess, ReadOnlyAccess
from lecombus.operations.actions import ACTOR
from support.api_line import Line

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200),
        ("LOCALHOST:9740", 200),
        ("127.0.0.1:1", 200),
        ("127.8.8.8", 200),
        ("[::1]:9740", 200),
        ("evil.example", 421),
        ("evil.example:80", 421),
        ("127.0.0.1.evil.example", 421),
        ("10.0.0.1", 421),
        ("[fe80::1]", 421),
        ("[::1].evil", 400),
        ("[::1]evil:80", 400),
        ("127.0.0.1:80:evil", 400),
        ("127.0.0.1:evil", 400),
        ("", 400),
    ],
)
async def test_only_the_names_of_this_machine_are_answered_to(
    line: Line, host: str, status: int
) -> None:
    transport = httpx2.ASGITransport(app=ReadOnlyAccess(line.app, "127.0.0.1"))
    async with httpx2.AsyncClient(transport=transport, base_url="http://x") as client:
        answer = await client.get("/v1/line", headers={"Host": host})
    assert answer.status_code == status
    if status != 200:
        assert "localhost" in answer.json()["remedy"]


@pytest.mark.parametrize(
    ("by", "client"),
    [
        ("mqtt", "mqtt"),
        ("modbus 192.0.2.7:1502", "modbus 192.0.2.7:1502"),
        ("", ""),
        ("a" * 61, ""),
        ('a"b', ""),
        ("a\\nb", ""),
    ],
)
async def test_a_program_at_the_socket_says_for_whom_it_asks(by: str, client: str) -> None:
    seen = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        seen.append(ACTOR.get().client)
        await Response()(scope, receive, send)

    transport = httpx2.ASGITransport(app=OwnPagesAccess(app))
    async with httpx2.AsyncClient(transport=transport, base_url="http://x") as asking:
        await asking.get("/", headers={"Lecombus-By": by})
    assert seen == [client]
