"""Where the API listens: real uvicorn on a Unix socket and on TCP."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import stat
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import anyio
import httpx2
import pytest

from lecombus.api import Served, serve, server
from lecombus.errors import OperationError
from lecombus.operations.actions import ACTOR, Actor
from lecombus.operations.operation_reports import WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.api_line import Line

pytestmark = [pytest.mark.anyio, pytest.mark.real]

SETPOINT = "/v1/drives/feeder/codes/C0046"
LOOPBACK = ("127.0.0.1", 0)


@asynccontextmanager
async def serving(
    line: Line, path: Path, http: tuple[str, int] | None = LOOPBACK
) -> AsyncIterator[Served]:
    """Serve a line until the block ends."""
    async with anyio.create_task_group() as tasks:
        served: Served = await tasks.start(serve, line.app, path, http)
        yield served
        tasks.cancel_scope.cancel()


def over_unix(path: Path) -> httpx2.AsyncClient:
    transport = httpx2.AsyncHTTPTransport(uds=str(path))
    return httpx2.AsyncClient(transport=transport, base_url="http://lecombus")


def own_name() -> str:
    return Path("/proc/self/comm").read_text().strip()


def together(call: Callable[..., Any], both: threading.Barrier, *, after: bool) -> Any:
    """Have threads meet before or after a call, as far as they can come that far together."""

    def slow(*args: Any) -> Any:
        found = call(*args) if after else None
        with suppress(threading.BrokenBarrierError):
            both.wait(0.5)
        return found if after else call(*args)

    return slow


def wait_until(condition: Callable[[], bool]) -> None:
    for _ in range(1000):
        if condition():
            return
        time.sleep(0.01)


def over_tcp(served: Served) -> httpx2.AsyncClient:
    assert served.http is not None
    return httpx2.AsyncClient(base_url=f"http://127.0.0.1:{served.http[1]}", trust_env=False)


async def test_the_unix_socket_takes_reads_and_writes(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path / "s") as served, over_unix(served.socket_path) as client:
        assert '"value": 35.40,' in (await client.get(SETPOINT)).text
        assert (await client.put(SETPOINT, json={"value": 1})).status_code == 200
    assert [one[0] for one in line.ops.asked] == ["write"]


@pytest.mark.parametrize("path", ["/metrics", "/healthz", "/readyz"])
async def test_head_is_get_without_the_body(line: Line, tmp_path: Path, path: str) -> None:
    async with serving(line, tmp_path / "s") as served:
        for client in (over_unix(served.socket_path), over_tcp(served)):
            async with client:
                got, looked = await client.get(path), await client.head(path)
                assert (looked.status_code, looked.content) == (got.status_code, b"")
                assert looked.headers["content-type"] == got.headers["content-type"]
                assert int(looked.headers["content-length"]) > 0
                # The connection is still in step: no body was left on it.
                assert (await client.get("/readyz")).json()["status"] == "ok"


async def test_tcp_answers_reads_and_nothing_else(line: Line, tmp_path: Path) -> None:
    async with serving(line, tmp_path / "s") as served, over_tcp(served) as client:
        assert '"value": 35.40,' in (await client.get(SETPOINT)).text
        assert (await client.get("/metrics")).status_code == 200
        stop = {"action": "inhibit", "target": "all"}
        for answer in (
            await client.put(SETPOINT, json={"value": 1}),
            await client.post("/v1/stop", json=stop),
            await client.delete("/v1/drives"),
            await client.options("/v1/drives"),
        ):
            assert answer.status_code == 403
            assert answer.json()["type"] == "urn:lecombus:problem:read-only"
            assert "Unix socket" in answer.json()["remedy"]
    assert line.ops.asked == []


@pytest.mark.parametrize(
    ("head", "status", "says"),
    [
        ("", 400, "names no host"),
        ("Host: localhost\r\nHost: localhost\r\n", 400, "localhost, localhost, where one host"),
        ("Host: localhost\r\n", 200, "hall-3"),
        ("Host: evil.example\r\n", 421, "host evil.example is not this machine"),
    ],
)
async def test_one_host_is_named_over_tcp(
    line: Line, tmp_path: Path, head: str, status: int, says: str
) -> None:
    async with serving(line, tmp_path / "s") as served:
        assert served.http is not None
        async with await anyio.connect_tcp(*served.http) as stream:
            close = "Connection: close\r\n\r\n"
            await stream.send(f"GET /v1/line HTTP/1.1\r\n{head}{close}".encode())
            answer = b"".join([part async for part in stream]).decode()
    assert answer.startswith(f"HTTP/1.1 {status} ")
    assert says in answer


async def test_the_unix_socket_stops_for_a_request_without_a_host(
    line: Line, tmp_path: Path
) -> None:
    body = '{"action": "inhibit", "target": "all"}'
    head = f"POST /v1/stop HTTP/1.1\r\nContent-Length: {len(body)}\r\nConnection: close"
    async with serving(line, tmp_path / "s") as served:
        stream = await anyio.connect_unix(served.socket_path)
        async with stream:
            await stream.send(f"{head}\r\n\r\n{body}".encode())
            answer = b"".join([part async for part in stream]).decode()
    assert answer.startswith("HTTP/1.1 200 ")
    assert [one[0] for one in line.ops.asked] == ["stop"]


async def test_the_socket_is_for_owner_and_group_and_goes_at_the_end(
    line: Line, tmp_path: Path
) -> None:
    path = tmp_path / "s"
    async with serving(line, path, None):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660
    assert not path.exists()


async def test_a_stale_socket_is_replaced(line: Line, tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    async with serving(line, path, None), over_unix(path) as client:
        assert (await client.get("/healthz")).status_code == 200


async def test_a_socket_that_is_served_is_left_alone(line: Line, tmp_path: Path) -> None:
    path = tmp_path / "s"
    async with serving(line, path, None), over_unix(path) as client:
        holder = re.escape(f"{path} is served by {own_name()} (pid {os.getpid()})")
        with pytest.raises(OperationError, match=holder) as caught:
            await serve(line.app, path)
        assert caught.value.kind == "socket-in-use"
        assert (await client.get("/healthz")).status_code == 200


@pytest.mark.parametrize("is_stale", [True, False])
def test_of_two_that_start_together_one_serves_and_the_other_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_stale: bool
) -> None:
    """Both are about to look, or have found the socket of a dead process."""
    path, both = tmp_path / "s", threading.Barrier(2)
    if is_stale:
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(path))
    name = "listener_at" if is_stale else "remove_stale"
    slow = together(getattr(server, name), both, after=is_stale)
    monkeypatch.setattr(server, name, slow)
    refused: list[OperationError] = []
    serving, ends = [], threading.Event()

    def start() -> None:
        try:
            with server.unix_socket(path) as listening:
                serving.append(listening)
                ends.wait(10)
        except OperationError as exc:
            refused.append(exc)

    threads = [threading.Thread(target=start) for _ in range(2)]
    for one in threads:
        one.start()
    wait_until(lambda: len(refused) + len(serving) == 2)
    try:
        assert (len(serving), len(refused)) == (1, 1)
        assert refused[0].kind == "socket-in-use"
        assert f"{path} is served by {own_name()} (pid {os.getpid()})" in str(refused[0])
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
            accepted, _ = serving[0].accept()
            accepted.close()
    finally:
        ends.set()
        for one in threads:
            one.join()
    assert not path.exists()


def test_the_end_of_one_does_not_remove_the_socket_of_its_successor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, ends, starts = tmp_path / "s", threading.Event(), threading.Event()
    is_ours = server.is_ours

    def slow(*args: Any) -> bool:
        found = is_ours(*args)
        ends.set()
        starts.wait(0.5)
        return found

    monkeypatch.setattr(server, "is_ours", slow)
    with ExitStack() as first, ExitStack() as second:
        first.enter_context(server.unix_socket(path))
        ending = threading.Thread(target=first.close)
        ending.start()
        try:
            assert ends.wait(10)
            second.enter_context(server.unix_socket(path))
        finally:
            starts.set()
            ending.join()
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))


def test_a_socket_that_may_not_be_removed_is_an_error_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))

    def refuse(self: Path, missing_ok: bool = False) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(Path, "unlink", refuse)
    found = re.escape(f"cannot listen on {path}: Operation not permitted")
    with pytest.raises(OperationError, match=found), server.unix_socket(path):
        pass


def test_a_folder_that_another_process_keeps_locked_keeps_no_daemon_from_its_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Everyone who may read the folder may lock it."""
    monkeypatch.setattr(server, "LOCK_S", 0.05)
    path, descriptor = tmp_path / "s", os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        with server.unix_socket(path), socket.socket(socket.AF_UNIX) as client:
            client.connect(str(path))
        assert "event=folder-locked" in caplog.text
        assert path.exists(), "another may just have found it stale: the next start removes it"
    finally:
        os.close(descriptor)
    with server.unix_socket(path):
        pass
    assert not path.exists()


async def test_a_file_that_is_no_socket_is_left_alone(line: Line, tmp_path: Path) -> None:
    path = tmp_path / "s"
    path.write_text("precious")
    with pytest.raises(OperationError, match="is not a socket"):
        await serve(line.app, path)
    assert path.read_text() == "precious"


async def test_a_folder_that_is_not_there_is_an_error_with_its_name(
    line: Line, tmp_path: Path
) -> None:
    with pytest.raises(OperationError, match="nowhere") as caught:
        await serve(line.app, tmp_path / "nowhere" / "s")
    assert caught.value.kind == "cannot-listen"
    assert "`api.socket`" in caught.value.remedy


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "example.com", "::"])
async def test_tcp_listens_on_loopback_only(line: Line, tmp_path: Path, host: str) -> None:
    with pytest.raises(OperationError, match="does not listen") as caught:
        await serve(line.app, tmp_path / "s", (host, 0))
    assert "127.0.0.1" in caught.value.remedy
    assert "`api.tokens` and `api.tls`" in caught.value.remedy
    assert not (tmp_path / "s").exists()


async def test_a_port_in_use_is_an_error_with_a_remedy(line: Line, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(OperationError, match=r"cannot listen on 127\.0\.0\.1") as caught:
            await serve(line.app, tmp_path / "s", ("127.0.0.1", taken.getsockname()[1]))
    assert "free the port" in caught.value.remedy
    assert not (tmp_path / "s").exists()


async def test_a_client_that_goes_away_cuts_nothing(line: Line, tmp_path: Path) -> None:
    line.ops.gate = anyio.Event()
    body = b'{"value": 1}'
    head = f"PUT {SETPOINT} HTTP/1.1\r\nHost: x\r\nContent-Length: {len(body)}\r\n"
    request = f"{head}Idempotency-Key: k\r\n\r\n".encode() + body
    with anyio.fail_after(15):
        async with serving(line, tmp_path / "s") as served:
            stream = await anyio.connect_unix(str(served.socket_path))
            await stream.send(request)
            await line.ops.begun.wait()
            await stream.aclose()
            line.ops.gate.set()
            async with over_unix(served.socket_path) as client:
                headers = {"Idempotency-Key": "k"}
                answer = await client.put(SETPOINT, content=body, headers=headers)
    assert answer.json()["outcome"] == "done"
    assert len(line.ops.asked) == 1


@pytest.mark.parametrize(
    ("method", "path", "status", "kind", "outcome"),
    [
        ("PUT", SETPOINT, 504, "unknown", "unknown"),
        ("GET", f"{SETPOINT}?fresh=true", 503, "line-closed", None),
    ],
)
async def test_a_request_that_takes_longer_than_the_closing_is_answered_all_the_same(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
    method: str, path: str, status: int, kind: str, outcome: str | None,
) -> None:  # fmt: skip
    monkeypatch.setattr(server, "CLOSE_S", 0.2)
    line.ops.gate = anyio.Event()  # stays closed
    answers: list[httpx2.Response] = []

    async def ask(http: httpx2.AsyncClient) -> None:
        body = None if method == "GET" else {"value": 1}
        answers.append(await http.request(method, path, json=body))

    socket_path = tmp_path / "x.sock"
    async with (
        over_unix(socket_path) as http,
        anyio.create_task_group() as tasks,
        serving(line, socket_path),
    ):
        tasks.start_soon(ask, http)
        await line.ops.begun.wait()
    (answer,) = answers
    assert (answer.status_code, answer.json()["outcome"]) == (status, outcome)
    assert answer.json()["type"] == f"urn:lecombus:problem:{kind}"
    assert "lecombus ended while this was under way" in answer.json()["detail"]
    assert "Traceback" not in caplog.text


async def test_closing_lets_a_request_under_way_end(line: Line, tmp_path: Path) -> None:
    line.ops.gate = gate = anyio.Event()
    answers: list[httpx2.Response] = []
    path = tmp_path / "s"

    async def ask() -> None:
        async with over_unix(path) as client:
            answers.append(await client.put(SETPOINT, json={"value": 1}))

    with anyio.fail_after(15):
        async with anyio.create_task_group() as clients, serving(line, path):
            clients.start_soon(ask)
            await line.ops.begun.wait()
            clients.start_soon(open_once_closing, gate, path)
    assert [one.status_code for one in answers] == [200]


async def open_once_closing(gate: anyio.Event, path: Path) -> None:
    """Open a gate once the server takes no more connections."""
    for _ in range(1000):
        try:
            await (await anyio.connect_unix(str(path))).aclose()
        except OSError:
            break
        await anyio.sleep(0.01)
    gate.set()


async def test_who_asks_is_known_to_whatever_is_done_for_them(line: Line, tmp_path: Path) -> None:
    found: list[Actor] = []

    def report(drive: str, code: Code) -> WriteReport:
        found.append(ACTOR.get())
        return WriteReport(drive, code, Outcome.DONE)

    line.ops.report = report
    async with serving(line, tmp_path / "s") as served, over_unix(served.socket_path) as client:
        await client.put(SETPOINT, json={"value": 1})
        await client.post("/v1/stop", json={"action": "inhibit", "target": "all"})
    assert [(one.who, one.uid, one.pid) for one in found] == 3 * [
        ("socket", os.getuid(), os.getpid())
    ]
    assert ACTOR.get().who == "lecombus"
