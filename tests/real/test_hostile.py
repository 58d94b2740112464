"""Every kind of hostile request, one after the other, at a daemon with a full line.

What is looked at: no answer is an error of lecombus, no write reaches the line (its simulated end
counts them), the cycle is what it is without, no feed is late, no memory is lost.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, cast

import httpx2
import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lecombus.api.limits import EVENTS_PATH
from lecombus.tokens.grants import Scope
from lecombus.tokens.secret import digest_of, new_secret
from lecombus.tokens.token_file import TokenEntry, write_tokens
from openapi.document import FILE
from support.certificates import Certificates, client_context, make_certificates
from support.children import Child
from support.daemon_host import Daemon, free_port, short_dir
from support.tcp_attack import GET, Attack, Handshakes, full_line, resident_mb

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(900)]

ROW_S = 12.0
CALM_S = 20.0
DRIVE = "/v1/drives/drive-11"
OTHER = "drive-12"
MISSES = "lecombus_watchdog_misses_total"
EXAMPLES = 4

BUSY = "503 queue-full"
"""Too many requests wait for the line already; this one was not begun."""

WRITES: tuple[tuple[str, str, object], ...] = (
    ("PUT", f"{DRIVE}/codes/C0046", {"value": 1}),
    ("PUT", f"{DRIVE}/codes/C0012", {"value": 1}),
    ("PUT", "/v1/groups/all/codes/C0046", {"value": 1}),
    ("POST", "/v1/stop", {"action": "inhibit", "target": "all"}),
    ("POST", f"{DRIVE}/verbs/enable", {}),
    ("POST", f"{DRIVE}/verbs/inhibit", {}),
    ("POST", f"{DRIVE}/address", {"address": 13}),
    ("POST", f"{DRIVE}/accept", {"identity": {"C1810": "x"}}),
    ("PUT", "/v1/leases/x", {"targets": ["drive-11"], "time": "2s"}),
    ("POST", "/v1/reload", {}),
)
TRICKS = (
    "//v1/stop", "/v1/stop/", "/v1/./stop", "/v1/%73top", "/v1%2fstop", "/x/../v1/stop",
    f"/v1/drives/{OTHER}%2f..%2fdrive-11/verbs/inhibit", "http://localhost/v1/stop",
    f"/v1/drives/{OTHER}/../drive-11/verbs/inhibit", "/v1/drives/%64rive-11/verbs/inhibit",
    "/metrics/../v1/stop", "/healthz;/v1/stop", "/v1/stop%00", "/v1/stop?x=/healthz",
)  # fmt: skip
PLACES = {
    "drive": "drive-11", "group": "all", "code": "C0046", "subcode": "0", "address": "11",
    "verb": "enable",
}  # fmt: skip

DOCUMENT: dict[str, Any] = json.loads(FILE.read_text())
OPERATIONS = [
    one
    for found in cast(Any, schemathesis.openapi.from_dict(DOCUMENT)).get_all_operations()
    if (one := found.ok()).path != EVENTS_PATH
]


def request(
    method: str, path: str, body: object = None, *, token: str = "", head: Sequence[str] = ()
) -> bytes:
    """Return the bytes of a request."""
    content = b"" if body is None else json.dumps(body).encode()
    lines = [f"{method} {path} HTTP/1.1", f"Content-Length: {len(content)}"]
    if not any(one.startswith("Host:") for one in head):
        lines.append("Host: localhost")
    if token:
        lines.append(f"Authorization: Bearer {token}")
    return "\r\n".join([*lines, *head, "", ""]).encode() + content


def writes(token: str, *head: str) -> list[bytes]:
    return [request(*one, token=token, head=head) for one in WRITES]


class Asking:
    """Sends requests over TLS from entering until leaving, and counts the statuses of answers."""

    def __init__(self, place: tuple[str, int], tls: ssl.SSLContext, asked: list[bytes]) -> None:
        self._place, self._tls, self._asked = place, tls, asked
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.statuses: Counter[str] = Counter()

    def __enter__(self) -> Asking:
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._ends.set()
        self._thread.join()

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
        asked = itertools.cycle(self._asked)
        while not self._ends.is_set():
            with contextlib.suppress(OSError):
                self._ask_on_one_connection(asked)

    def _ask_on_one_connection(self, asked: Iterator[bytes]) -> None:
        plain = socket.create_connection(self._place, timeout=5.0)
        with (
            plain,
            self._tls.wrap_socket(plain, server_hostname="localhost") as one,
            one.makefile("rb") as answers,
        ):
            while not self._ends.is_set():
                self._send(one, next(asked))
                status, goes_on = status_of(answers)
                self.statuses[status] += 1
                if not goes_on:
                    return

    def _send(self, one: ssl.SSLSocket, data: bytes) -> None:
        with contextlib.suppress(OSError):  # it was refused before all of it was sent
            one.sendall(data)


class AskingSlowly(Asking):
    """Sends each byte of a request after a pause."""

    def _send(self, one: ssl.SSLSocket, data: bytes) -> None:
        for byte in data:
            if self._ends.wait(0.2):
                raise TimeoutError
            one.sendall(bytes([byte]))


def status_of(answers: BinaryIO) -> tuple[str, bool]:
    """Return the status of the next answer, and whether more may follow on the connection."""
    line = answers.readline()
    if not line.startswith(b"HTTP/1.1 "):
        raise ConnectionError
    length, goes_on = 0, True
    while (header := answers.readline().lower().strip()) != b"":
        if header.startswith(b"content-length:"):
            length = int(header.partition(b":")[2])
        goes_on = goes_on and header != b"connection: close"
    return said_of(int(line.split()[1]), answers.read(length)), goes_on


def said_of(status: int, body: bytes) -> str:
    """Return a status; of one from 500 on with the kind of its problem."""
    if status < 500:
        return str(status)
    return f"{status} {json.loads(body)['type'].removeprefix('urn:lecombus:problem:')}"


class Crowd(AbstractContextManager["Crowd"]):
    """Several at the same time."""

    def __init__(self, *members: Asking) -> None:
        self._members, self._stack = members, contextlib.ExitStack()

    def __enter__(self) -> Crowd:
        for one in self._members:
            self._stack.enter_context(one)
        return self

    def __exit__(self, *raised: object) -> None:
        self._stack.close()

    @property
    def statuses(self) -> Counter[str]:
        return sum((one.statuses for one in self._members), Counter[str]())


class Site:
    """The daemon, its line, and what was seen of them."""

    def __init__(self, daemon: Daemon, line: Child, made: Certificates, port: int) -> None:
        self.daemon, self.line, self.port = daemon, line, port
        self.tls = client_context(made)
        self.secrets: dict[str, str] = {}
        self.before_mb = resident_mb(daemon)

    def ask(self, asked: list[bytes], count: int = 2, kind: type[Asking] = Asking) -> Crowd:
        return Crowd(*(kind(("127.0.0.1", self.port), self.tls, asked) for _ in range(count)))

    def give(self, tokens: Path) -> None:
        """Make the tokens of the hostile clients, and take one back."""
        now, entries = datetime.now(UTC), []
        for name, scopes, targets, end_s in (
            ("reader", "read", (), 9999), ("plc", "write control", (), 9999),
            ("other", "write control", (OTHER,), 9999), ("expired", "write control", (), -1),
            ("revoked", "write control", (), 9999),
        ):  # fmt: skip
            self.secrets[name] = new_secret()
            entries.append(TokenEntry(
                name=name, sha256=digest_of(self.secrets[name]), created=now, targets=targets,
                scopes=tuple(map(Scope, scopes.split())), expires=now + timedelta(seconds=end_s),
            ))  # fmt: skip
        write_tokens(tokens, entries)
        time.sleep(2.5)
        write_tokens(tokens, entries[:-1])
        time.sleep(2.5)

    def seen(self, during: Callable[[], None]) -> tuple[float, int]:
        """Return telegrams in a second, and writes that the line heard."""
        self.line.ask("stops")
        before, began_s = self.line.ask("so_far")["requests"], time.monotonic()
        during()
        after = self.line.ask("so_far")["requests"]
        return (after - before) / (time.monotonic() - began_s), len(self.line.ask("stops"))


def from_the_document(site: Site) -> Counter[str]:
    """Ask what schemathesis makes of the document, right and wrong, with three tokens."""
    statuses: Counter[str] = Counter()
    url = f"https://localhost:{site.port}"
    modes = schemathesis.GenerationMode
    for name in ("reader", "other", ""):
        headers = {"Authorization": f"Bearer {site.secrets[name]}"} if name else {}
        with httpx2.Client(base_url=url, headers=headers, verify=site.tls, timeout=60) as client:
            for operation in OPERATIONS:
                cases = st.one_of(*(operation.as_strategy(generation_mode=mode) for mode in modes))
                ask_cases(client, statuses, cases)
    return statuses


def ask_cases(client: httpx2.Client, statuses: Counter[str], cases: st.SearchStrategy[Any]) -> None:
    """Ask some cases of schemathesis."""

    @settings(
        max_examples=EXAMPLES, deadline=None, database=None, derandomize=True,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(cases)
    def ask(case: Any) -> None:
        ask_case(client, statuses, case)

    ask()


def ask_case(client: httpx2.Client, statuses: Counter[str], case: Any) -> None:
    """Ask one case of schemathesis, about a drive that there is."""
    for name in case.path_parameters or {}:
        case.path_parameters[name] = PLACES.get(name, case.path_parameters[name])
    words = case.as_transport_kwargs(base_url=str(client.base_url))
    asked = {key: words[key] for key in ("method", "url", "params", "headers") if key in words}
    content = json.dumps(words["json"]) if "json" in words else words.get("data")
    with contextlib.suppress(httpx2.InvalidURL, httpx2.LocalProtocolError, UnicodeEncodeError):
        answer = client.request(**asked, content=content)
        statuses[said_of(answer.status_code, answer.content)] += 1


def mistakes(statuses: Counter[str]) -> set[str]:
    """Return the answers that no request may get."""
    return {one for one in statuses if int(one[:3]) >= 500} - {BUSY}


def nothing() -> Counter[str]:
    """Ask nothing for a while."""
    time.sleep(CALM_S)
    return Counter()


def rows(site: Site) -> dict[str, Crowd | Attack]:
    """Return all kinds of hostile clients but those that come from the document."""
    secrets, plc = site.secrets, site.secrets["plc"]
    put = f"PUT {DRIVE}/codes/C0046 HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {plc}\r\n"
    oversized = [
        f"{put}Content-Length: 9000\r\n\r\n".encode() + b"x" * 9000,
        f"{put}Transfer-Encoding: chunked\r\n\r\n".encode() + b"1\r\nx\r\n" * 9000,
        put.encode() + b"X: y\r\n" * 100 + b"\r\n",
        put.encode() + b"X: " + b"y" * 20_000 + b"\r\n\r\n",
        request("PUT", f"{DRIVE}/codes/C0046?{'a' * 5000}", {"value": 1}, token=plc),
    ]
    stop = {"action": "inhibit", "target": "drive-11"}
    tricks = [
        request("POST", path, stop, token=secrets[name])
        for path in TRICKS for name in ("reader", "other")
    ]  # fmt: skip
    hello = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"
    attack = partial(Attack, site.port)
    return {
        "wrong scope": site.ask(writes(secrets["reader"])),
        "wrong drive": site.ask(writes(secrets["other"])),
        "expired token": site.ask(writes(secrets["expired"])),
        "revoked token": site.ask(writes(secrets["revoked"])),
        "no token, a made-up token": site.ask(writes("") + writes(new_secret())),
        "oversized": site.ask(oversized),
        "slow": site.ask(writes(plc), 24, AskingSlowly),
        "rebinding": site.ask(writes(plc, "Host: drives.evil.example")),
        "foreign origin": site.ask(writes(plc, "Origin: https://evil.example")),
        "path tricks": site.ask(tricks),
        "2,000 connections": attack(2000, hello),
        "half handshakes": attack(200, hello),
        "whole handshakes": Handshakes(site.port, 1, site.tls),
        "requests without TLS": attack(64, GET % b"/v1/line" + b"\r\n"),
        "rubbish": attack(200, b"\x00" * 20_000),
    }


def test_no_hostile_request_writes_fails_or_slows_the_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    told: list[str] = []
    with short_dir() as folder:
        made, port = make_certificates(folder), free_port()
        tls = f"{{certificate: {made.path('server.pem')}, key: {made.path('server.key')}}}"
        api = f"tokens: {folder}/tokens, tls: {tls}"
        journal = f"journal: {{file: {folder}/journal.db}}\n"
        with full_line(folder, port, api, journal) as (daemon, line):
            site = Site(daemon, line, made, port)
            site.give(folder / "tokens")
            time.sleep(10.0)  # what audits have put off
            missed = daemon.metric(MISSES)
            calm, _ = site.seen(partial(time.sleep, CALM_S))
            failed: list[str] = []

            def look(name: str, during: Callable[[], Counter[str]]) -> None:
                statuses: Counter[str] = Counter()
                rate, written = site.seen(lambda: statuses.update(during()))
                grown_mb = resident_mb(daemon) - site.before_mb
                told.append(
                    f"{name}: cycle {rate / calm:.3f} of that without, {written} writes heard, "
                    f"memory {grown_mb:+.1f} MB, answers {dict(sorted(statuses.items()))}"
                )
                is_good = (
                    rate >= 0.95 * calm and not written and grown_mb <= 20
                    and mistakes(statuses) == set() and daemon.metric(MISSES) == missed
                )  # fmt: skip
                if not is_good:
                    failed.append(told[-1])

            try:
                for name, row in rows(site).items():

                    def during(row: Crowd | Attack = row) -> Counter[str]:
                        with row:
                            time.sleep(ROW_S)
                        return row.statuses if isinstance(row, Crowd) else Counter()

                    look(name, during)
                look("from the document", partial(from_the_document, site))
                look("without", nothing)
            finally:
                with capsys.disabled():
                    print("", f"{calm:.2f} telegrams/s without", *told, sep="\n")  # noqa: T201
            assert failed == []
            said = daemon.cli("journal", "--json")
            assert said.status == 0
            assert '"write"' not in said.out
            assert daemon.end() == 0
