"""TCP with tokens and TLS, and clients that mean no good."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket
import ssl
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import anyio
import httpx2
import pytest
from starlette.responses import StreamingResponse
from starlette.routing import Route
from starlette.types import Scope

from lecombus.api import serve, tcp_connection, tls_connection
from lecombus.api.server import Doors
from lecombus.api.tcp_connection import CpuShare
from lecombus.api.tls import TlsFileError, context_of
from lecombus.api.token_access import TokenAccess
from lecombus.errors import OperationError
from lecombus.operations.actions import ACTOR
from lecombus.operations.awaited_requests import CAME_S
from lecombus.operations.operation_reports import WriteReport
from lecombus.tokens.secret import new_secret
from support.api_line import Line
from support.certificates import Certificates, client_context, make_certificates
from support.guarded_door import GuardedDoor, guarded_door

pytestmark = [pytest.mark.anyio, pytest.mark.real]

SETPOINT = "/v1/drives/feeder/codes/C0046"
SETTING = "/v1/drives/feeder/codes/C0012"
STOP = {"action": "inhibit", "target": "all"}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return make_certificates(tmp_path_factory.mktemp("tls"))


def kind(answer: httpx2.Response) -> str:
    return str(answer.json()["type"]).removeprefix("urn:lecombus:problem:")


async def raw(door: GuardedDoor, request: bytes, tls: ssl.SSLContext | None = None) -> bytes:
    """Send bytes, and return all that comes back."""
    reader, writer = await asyncio.open_connection(
        *door.place, ssl=tls, server_hostname=None if tls is None else "localhost"
    )
    writer.write(request)
    try:
        return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.close()


async def test_a_controller_writes_reads_and_stops_over_tls(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("plc", "control")
        async with door.client("plc") as client:
            assert (await client.get(SETPOINT)).json()["value"] == 35.4
            assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
            assert (await client.post("/v1/stop", json=STOP)).status_code == 200
            assert (await client.get("/v1/drives")).status_code == 200
            answer = await client.put(SETTING, json={"value": 1})
            assert (answer.status_code, kind(answer)) == (403, "not-permitted")
    assert [one[0] for one in line.ops.asked] == ["write", "stop"]


@pytest.mark.parametrize(
    ("header", "wanted"),
    [
        (None, "no-token"),
        ("Basic bGVuemU6bGVuemU=", "bad-token"),
        ("Bearer", "bad-token"),
        ("Bearer lcb_x", "bad-token"),
        (f"Bearer {new_secret()}", "bad-token"),
        ("Bearer " + "x" * 4000, "bad-token"),
        ("Bearer \xff\xfe", "bad-token"),
    ],
)
async def test_without_a_valid_token_nothing_is_said(
    line: Line, tmp_path: Path, header: str | None, wanted: str
) -> None:
    async with guarded_door(line, tmp_path) as door, door.client() as client:
        await door.give("plc", "control")
        headers = {} if header is None else {b"Authorization": header.encode("latin-1")}
        for method, path in (
            ("GET", "/v1/drives"), ("PUT", SETPOINT), ("POST", "/v1/stop"), ("GET", "/nowhere"),
            ("GET", "/metrics"), ("GET", "/healthz"), ("OPTIONS", "/v1/drives"),
        ):  # fmt: skip
            answer = await client.request(method, path, headers=headers)
            assert (answer.status_code, kind(answer)) == (401, wanted)
            assert answer.headers["www-authenticate"].startswith("Bearer ")
            assert answer.headers["connection"] == "close"
            assert "feeder" not in answer.text
    assert line.ops.asked == []


async def test_a_revoked_and_an_expired_token_are_worth_nothing(line: Line, tmp_path: Path) -> None:
    async with guarded_door(line, tmp_path) as door:
        await door.give("plc", "control")
        await door.give("short", "control", ends_in_s=-1)
        async with door.client("plc") as client, door.client("short") as short:
            assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
            assert (await short.put(SETPOINT, json={"value": 2})).status_code == 401
            await door.revoke("plc")
            assert (await client.put(SETPOINT, json={"value": 3})).status_code == 401
            assert (await client.post("/v1/stop", json=STOP)).status_code == 401
    assert [one[3] for one in line.ops.asked] == [1]


async def test_a_token_that_is_revoked_while_a_body_comes_writes_nothing(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client may take ten seconds for the rest of its request."""
    async with guarded_door(line, tmp_path) as door:
        secret = await door.give("plc", "control")
        begun = asyncio.Event()
        judge = TokenAccess._judge

        def judged(self: TokenAccess, scope: Scope) -> object:
            begun.set()
            return judge(self, scope)

        monkeypatch.setattr(TokenAccess, "_judge", judged)
        reader, writer = await asyncio.open_connection(*door.place)
        rows = (f"PUT {SETPOINT} HTTP/1.1", "Host: localhost", f"Authorization: Bearer {secret}",
                "Content-Length: 12", "", '{"val')  # fmt: skip
        writer.write("\r\n".join(rows).encode())
        await begun.wait()
        await asyncio.sleep(0.05)
        await door.revoke("plc")
        writer.write(b'ue": 1}')
        head = await reader.readuntil(b"\r\n\r\n")
        writer.close()
        assert head.startswith(b"HTTP/1.1 401"), head
        assert b"connection: close" in head.lower()
    assert line.ops.asked == []


async def test_a_write_that_waits_for_the_share_of_tcp_came_when_its_bytes_came(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop that comes before its turn ends it; the share keeps it back for up to a second."""
    shares: list[CpuShare] = []
    came: list[float] = []
    write = line.ops.write

    def made(**given: Any) -> CpuShare:
        shares.append(CpuShare(**given))
        return shares[-1]

    async def noted(*given: Any, **more: Any) -> WriteReport:
        came.append(CAME_S.get() or 0.0)
        return await write(*given, **more)

    monkeypatch.setattr("lecombus.api.server.CpuShare", made)
    monkeypatch.setattr(line.ops, "write", noted)
    async with guarded_door(line, tmp_path) as door:
        await door.give("plc", "control")
        async with door.client("plc") as client:
            assert (await client.get("/v1/line")).status_code == 200
            turns: list[float] = []
            for _ in range(2):
                shares[0].spend(0.1)
                turns.append(shares[0]._free_at_s)
                assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
    assert all(came_s < turn_s for came_s, turn_s in zip(came, turns, strict=True))
    assert came[1] >= turns[0], "each request has its own time"


async def test_two_tokens_in_one_request_are_refused(line: Line, tmp_path: Path) -> None:
    async with guarded_door(line, tmp_path) as door:
        secret = await door.give("plc", "control")
        head = f"GET /v1/line HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\n"
        two = f"{head}Authorization: Bearer {new_secret()}\r\n\r\n"
        assert b"HTTP/1.1 400" in await raw(door, two.encode())


async def test_wrong_tokens_are_slowed_down_and_a_right_one_never(
    line: Line, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "lecombus")
    async with guarded_door(line, tmp_path) as door:
        secret = await door.give("plc", "control")
        async with door.client() as client, door.client("plc") as good:
            statuses = []
            for _ in range(30):
                headers = {"Authorization": f"Bearer {new_secret()}"}
                answer = await client.get("/v1/line", headers=headers)
                statuses.append(answer.status_code)
                if answer.status_code == 429:
                    assert int(answer.headers["retry-after"]) > 0
            assert statuses[:10] == [401] * 10
            assert set(statuses[10:]) == {429}
            for _ in range(5):
                assert (await good.get("/v1/line")).status_code == 200
    said = [one.getMessage() for one in caplog.records if "token-refused" in one.getMessage()]
    assert 1 <= len(said) < 30
    assert not re.search("lcb_", caplog.text)
    assert secret[4:12] not in caplog.text


@pytest.mark.parametrize(
    ("header", "status"),
    [
        ("Host: evil.example", 421),
        ("Host: 127.0.0.1.evil.example", 421),
        ("Host: 0.0.0.0", 421),
        ("Host: [::1].evil", 400),
        ("Host: ", 400),
        ("Host: localhost\r\nHost: localhost", 400),
        ("Host: localhost\r\nOrigin: http://evil.example", 403),
        ("Host: localhost\r\nOrigin: null", 403),
        ("Host: localhost\r\nOrigin: https://localhost", 403),
        ("Host: localhost\r\nSec-Fetch-Site: cross-site", 403),
        ("Host: drives.example", 200),
        ("Host: DRIVES.example:9740", 200),
        ("Host: 127.0.0.1", 200),
        ("Host: localhost\r\nOrigin: http://localhost", 200),
    ],
)
async def test_other_names_and_origins_are_refused_also_with_a_token(
    line: Line, tmp_path: Path, header: str, status: int
) -> None:
    async with guarded_door(line, tmp_path) as door:
        secret = await door.give("plc", "control")
        head = f"GET /v1/line HTTP/1.1\r\n{header}\r\nAuthorization: Bearer {secret}\r\n"
        answer = await raw(door, f"{head}Connection: close\r\n\r\n".encode())
        assert answer.startswith(f"HTTP/1.1 {status} ".encode())


@pytest.mark.parametrize(
    "path",
    ["//v1/stop", "/v1/stop/", "///v1/stop//", "/v1/./stop", "/v1/%73top", "/v1%2fstop",
     "/x/../v1/stop", "/v1/drives/belt/verbs/inhibit", "//v1/drives/belt/verbs/quick-stop/",
     "/v1/drives/feeder%2f..%2fbelt/verbs/inhibit", "/v1/drives/feeder/../belt/verbs/inhibit",
     "/v1/drives/%62elt/verbs/inhibit", "http://localhost/v1/stop", "/v1/stop?x=/healthz",
     "/metrics/../v1/stop", "/healthz;/v1/stop", "/v1/stop%00", "/v1/stop%20"],
)  # fmt: skip
async def test_no_path_trick_stops_what_the_token_is_not_for(
    line: Line, tmp_path: Path, path: str
) -> None:
    body = b'{"action": "inhibit", "target": "belt"}'
    async with guarded_door(line, tmp_path) as door:
        for name, scopes, targets in (
            ("reader", ("read",), ()), ("other", ("control",), ("feeder",)),
        ):  # fmt: skip
            secret = await door.give(name, *scopes, targets=targets)
            head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\n"
            length = f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
            answer = await raw(door, (head + length).encode() + body)
            assert answer.split(b" ")[1] in (b"400", b"403", b"404", b"405"), answer
    assert line.ops.asked == []


@pytest.mark.parametrize(
    "sent",
    [b"", b"\x16\x03\x01", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(40),
     b"GET / HTTP/1.1\r\n\r\n", b"\x80\x2e\x01\x00\x02", b"\x00" * 100_000],
)  # fmt: skip
async def test_a_handshake_that_does_not_end_is_cut(
    line: Line, tmp_path: Path, certificates: Certificates, sent: bytes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(tls_connection, "HANDSHAKE_S", 0.2)
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("plc", "control")
        with anyio.fail_after(5):
            answer = await raw(door, sent)
        assert b"HTTP" not in answer
        async with door.client("plc") as client:
            assert (await client.get("/v1/line")).status_code == 200


async def test_a_handshake_byte_by_byte_is_cut_too(
    line: Line, tmp_path: Path, certificates: Certificates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls_connection, "HANDSHAKE_S", 0.3)
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    hello = client_context(certificates).wrap_bio(incoming, outgoing, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        hello.do_handshake()
    async with guarded_door(line, tmp_path, certificates) as door:
        reader, writer = await asyncio.open_connection(*door.place)
        with anyio.fail_after(5), contextlib.suppress(ConnectionError):
            for one in outgoing.read():
                writer.write(bytes([one]))
                await writer.drain()
                await asyncio.sleep(0.02)
                if reader.at_eof():
                    break
            await reader.read()
        writer.close()


async def test_half_handshakes_do_not_lock_out_a_client(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    """Each takes a place, and gives it to a newer connection."""
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("plc", "control")
        half = []
        async with door.client("plc") as client:
            assert (await client.get("/v1/line")).status_code == 200
            for _ in range(300):
                one = await asyncio.to_thread(socket.create_connection, door.place)
                with contextlib.suppress(OSError):  # it was one too many
                    one.send(b"\x16\x03\x01\x02\x00")
                half.append(one)
            assert (await client.post("/v1/stop", json=STOP)).status_code == 200
        async with door.client("plc") as late:
            assert (await late.get("/v1/line")).status_code == 200
        for one in half:
            one.close()


async def test_an_oversized_or_slow_request_is_cut_also_with_a_token(
    line: Line, tmp_path: Path, certificates: Certificates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tcp_connection, "PATIENCE_S", 0.2)
    tls = client_context(certificates)
    async with guarded_door(line, tmp_path, certificates) as door:
        secret = await door.give("plc", "control", "write")
        head = f"PUT {SETPOINT} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\n"
        big = f"{head}Content-Length: 9000\r\n\r\n".encode() + b"x" * 9000
        assert b"HTTP/1.1 413" in await raw(door, big, tls)
        chunks = f"{head}Transfer-Encoding: chunked\r\n\r\n".encode() + b"1\r\nx\r\n" * 9000
        assert b"HTTP/1.1 413" in await raw(door, chunks, tls)
        long = head.encode() + b"X: y\r\n" * 100 + b"\r\n"
        assert b"HTTP/1.1 431" in await raw(door, long, tls)
        with anyio.fail_after(5):
            assert await raw(door, f"{head}Content-Length: 10\r\n\r\n1".encode(), tls) == b""
    assert line.ops.asked == []


async def test_a_flood_of_connections_ends_and_a_stop_comes_through(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    """2,000, for longer: `tests/real/test_hostile.py`."""
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("plc", "control")

        async def flood(count: int) -> None:
            for number in range(count):
                with contextlib.suppress(OSError):
                    _, writer = await asyncio.open_connection(*door.place)
                    writer.write(b"\x16\x03\x01" if number % 2 else b"GET / HTTP/1.1\r\n\r\n")
                    opened.append(writer)

        opened: list[asyncio.StreamWriter] = []
        async with door.client("plc") as client:
            assert (await client.get("/v1/line")).status_code == 200
            async with anyio.create_task_group() as tasks:
                for _ in range(20):
                    tasks.start_soon(flood, 30)
                await asyncio.sleep(0.2)
                assert (await client.post("/v1/stop", json=STOP)).status_code == 200
            assert (await client.get("/v1/line")).status_code == 200
        assert len(opened) > 300
        for one in opened:
            one.close()
    assert [one[0] for one in line.ops.asked] == ["stop"]


async def test_a_long_answer_comes_whole_over_tls(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("plc", "read")
        async with door.client("plc") as client:
            whole = await client.get("/openapi.json")
            assert len(whole.content) > 50_000
            assert whole.json()["info"]["title"] == "lecombus"
            for _ in range(20):  # the connection is kept
                assert (await client.get("/v1/line")).status_code == 200


async def test_who_asks_is_known_by_token_and_certificate(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    seen: list[dict[str, str]] = []
    groups = line.ops.groups

    def noted() -> object:
        seen.append(ACTOR.get().fields())
        return groups()

    line.ops.groups = noted  # type: ignore[method-assign, assignment]
    async with guarded_door(
        line, tmp_path, certificates, certificates.server(client_ca=True)
    ) as door:
        await door.give("plc", "control")
        async with door.client("plc", shows=True) as client:
            assert (await client.get("/v1/groups")).status_code == 200
        async with door.client("plc") as without:
            with pytest.raises((httpx2.TransportError, ssl.SSLError)):
                await without.get("/v1/groups")
    assert len(seen) == 1 or all(one == seen[0] for one in seen)
    assert seen[0]["token"] == "plc"
    assert seen[0]["subject"] == "O_Works,CN_plc_1"
    assert seen[0]["client"].startswith("127.0.0.1:")


async def test_a_new_certificate_is_used_and_a_wrong_one_is_not(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    made = make_certificates(tmp_path)
    async with guarded_door(line, tmp_path, made) as door:
        assert door.tls is not None

        def number() -> str:
            context = client_context(made)
            with (
                socket.create_connection(door.place) as plain,
                context.wrap_socket(plain, server_hostname="localhost") as one,
            ):
                certificate = one.getpeercert()
                assert certificate is not None
                return str(certificate["serialNumber"])

        first = await anyio.to_thread.run_sync(number)
        made.sign("server", "/CN=localhost")
        door.tls.use(await door.tls.read())
        second = await anyio.to_thread.run_sync(number)
        assert second != first
        made.path("server.pem").write_text("no certificate")
        with pytest.raises(TlsFileError, match=r"server\.pem"):
            await door.tls.read()
        assert await anyio.to_thread.run_sync(number) == second


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        ("missing certificate", "no such file"),
        ("missing key", "cannot be read"),
        ("other key", "mismatch"),
        ("open key", "mode is 0644"),
        ("rubbish key", "cannot be used"),
        ("encrypted key", "encrypted"),
        ("rubbish ca", "cannot be used"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_its_reason(
    tmp_path: Path, spoil: str, says: str
) -> None:
    made = make_certificates(tmp_path)
    key = made.path("server.key")
    if spoil == "missing certificate":
        made.path("server.pem").unlink()
    elif spoil == "missing key":
        key.unlink()
    elif spoil == "other key":
        key.write_text(made.path("plc.key").read_text())
    elif spoil == "open key":
        key.chmod(0o644)
    elif spoil == "rubbish key":
        key.write_text("rubbish")
    elif spoil == "encrypted key":
        call = ["openssl", "pkey", "-in", str(key), "-aes256", "-passout", "pass:x"]
        key.write_bytes(subprocess.run(call, check=True, capture_output=True).stdout)
    else:
        made.path("ca.pem").write_text("rubbish")
    with pytest.raises(TlsFileError, match=says) as caught:
        context_of(made.server(client_ca=True))
    assert str(tmp_path) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("missing", ["tokens", "tls", "both"])
async def test_without_tokens_and_tls_nothing_listens_beyond_this_machine(
    line: Line, tmp_path: Path, certificates: Certificates, missing: str
) -> None:
    async with guarded_door(line, tmp_path, certificates) as door:
        doors = Doors(
            tokens=None if missing in ("tokens", "both") else door.watch,
            tls=None if missing in ("tls", "both") else door.tls,
        )
        with pytest.raises(OperationError, match=r"does not listen on 0\.0\.0\.0"):
            await serve(line.app, tmp_path / "other", ("0.0.0.0", 0), doors=doors)


async def test_with_both_it_listens_in_every_network(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    async with guarded_door(line, tmp_path, certificates, host="0.0.0.0") as door:
        await door.give("plc", "read")
        async with door.client("plc") as client:
            assert (await client.get("/v1/line")).status_code == 200


async def test_old_tls_and_plain_http_get_nothing(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    old = client_context(certificates)
    async with guarded_door(line, tmp_path, certificates) as door:
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            old.minimum_version = old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises((ssl.SSLError, ConnectionError)):
            await asyncio.open_connection(*door.place, ssl=old, server_hostname="localhost")
        for version in (ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3):
            new = client_context(certificates)
            new.minimum_version = new.maximum_version = version
            answer = await raw(door, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", new)
            assert answer.startswith(b"HTTP/1.1 401")


@pytest.mark.parametrize("secured", [False, True])
async def test_a_write_of_a_client_that_left_is_not_sent(
    line: Line, tmp_path: Path, certificates: Certificates, secured: bool
) -> None:
    tls = client_context(certificates) if secured else None
    async with guarded_door(line, tmp_path, certificates if secured else None) as door:
        secret = await door.give("plc", "control")
        gone = anyio.Event()
        head = f"PUT {SETPOINT} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {secret}\r\n"
        _, writer = await asyncio.open_connection(
            *door.place, ssl=tls, server_hostname=None if tls is None else "localhost"
        )
        line.ops.gate = gone
        writer.write(f'{head}Content-Length: 12\r\n\r\n{{"value": 1}}'.encode())
        await line.ops.begun.wait()
        assert line.ops.is_gone is not None
        assert not line.ops.is_gone()
        writer.transport.abort()
        await asyncio.sleep(0.1)  # the kernel takes the bytes of the end by itself
        assert line.ops.is_gone()
        gone.set()


async def test_an_answer_under_way_ends_when_its_token_is_revoked(
    line: Line, tmp_path: Path
) -> None:
    async def parts() -> AsyncIterator[bytes]:
        while True:
            yield b"data\n"
            await asyncio.sleep(0.01)

    async def endless(request: object) -> StreamingResponse:
        return StreamingResponse(parts())

    line.app.router.routes.append(Route("/endless", endless))
    async with guarded_door(line, tmp_path) as door:
        await door.give("reader", "read")
        async with door.client("reader") as client, client.stream("GET", "/endless") as answer:
            taken = 0
            with anyio.fail_after(5):
                async for part in answer.aiter_bytes():
                    taken += len(part)
                    if taken > 20 and "reader" in door.entries:
                        await door.revoke("reader")
        assert taken > 20


async def test_events_are_read_over_tls_until_the_token_is_revoked(
    line: Line, tmp_path: Path, certificates: Certificates
) -> None:
    async with guarded_door(line, tmp_path, certificates) as door:
        await door.give("reader", "read", targets=("belt",))
        async with (
            door.client("reader") as client,
            client.stream("GET", "/v1/events") as answer,
        ):
            text = ""
            with anyio.fail_after(10), contextlib.suppress(httpx2.TransportError):
                async for part in answer.aiter_text():
                    text += part
                    line.events.publish("value", "feeder", {"value": "secret"})
                    line.events.publish("value", "belt", {"value": "seen"})
                    if "seen" in text and "reader" in door.entries:
                        await door.revoke("reader")
        assert "seen" in text
        assert "secret" not in text
