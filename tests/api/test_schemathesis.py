"""Requests made from the description of the interface, at every door: schemathesis.

TCP is asked without tokens, and with TLS by a token for everything, one that reads, one for one
drive, and none.

Every operation is asked with what the document says is right and with what it says is wrong;
whatever comes back must be described, and nothing may be a mistake of lecombus.
"""

from __future__ import annotations

import contextlib
import json
import ssl
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import httpx2
import pytest
import schemathesis
from anyio import Event, create_task_group
from anyio.from_thread import start_blocking_portal
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from lecombus.api import Served, serve
from lecombus.api.limits import EVENTS_PATH
from openapi.document import FILE
from support.api_line import make_line
from support.certificates import client_context, make_certificates
from support.guarded_door import guarded_door

pytestmark = pytest.mark.real

DOCUMENT: dict[str, Any] = json.loads(FILE.read_text())
SCHEMA = schemathesis.openapi.from_dict(DOCUMENT)
FOUND: list[Any] = [found.ok() for found in cast(Any, SCHEMA.get_all_operations())]
OPERATIONS = [one for one in FOUND if one.path != EVENTS_PATH]  # that has no end: test_events.py
CHECKS = [
    not_a_server_error,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
]
PLACES = {"drive": "feeder", "group": "all", "code": "C0046", "subcode": "0", "address": "21"}
EXAMPLES = 8
GUARDED_EXAMPLES = 4


REFUSED = {400, 401, 403, 404, 405, 413, 414, 421, 429, 431}


class Doors:
    """All doors of a line with fake operations, served in a thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._end: Event
        self._guarded: dict[str, tuple[str, str, ssl.SSLContext]] = {}

    @contextlib.contextmanager
    def open(self) -> Iterator[dict[str, httpx2.Client]]:
        """Serve, and give a client of each door."""
        with start_blocking_portal() as portal:
            ended, served = portal.start_task(self._run)
            unix = httpx2.HTTPTransport(uds=str(served.socket_path))
            with ExitStack() as clients:
                doors = {
                    "unix": httpx2.Client(transport=unix, base_url="http://localhost"),
                    "tcp": httpx2.Client(base_url=f"http://127.0.0.1:{served.http[1]}"),
                }
                for name, (url, secret, tls) in self._guarded.items():
                    headers = {"Authorization": f"Bearer {secret}"} if secret else {}
                    doors[name] = httpx2.Client(base_url=url, headers=headers, verify=tls)
                yield {name: clients.enter_context(door) for name, door in doors.items()}
            portal.call(self._end.set)
            ended.result()

    async def _run(self, *, task_status: Any) -> None:
        self._end = Event()
        async with create_task_group() as tasks:
            served: Served = await tasks.start(
                serve, make_line().app, self._folder / "s", ("127.0.0.1", 0)
            )
            (self._folder / "t").mkdir()
            made = make_certificates(self._folder / "t")
            async with guarded_door(make_line(), self._folder / "t", made, patience_s=600) as door:
                tls = client_context(made)
                for name, scopes, targets in (
                    ("everything", ("write", "control"), ()),
                    ("reads", ("read",), ()),
                    ("belt", ("write", "control"), ("belt",)),
                ):  # fmt: skip
                    secret = await door.give(name, *scopes, targets=targets)
                    self._guarded[name] = (door.url, secret, tls)
                self._guarded["without"] = (door.url, "", tls)
                task_status.started(served)
                await self._end.wait()
            tasks.cancel_scope.cancel()


@pytest.fixture(scope="module")
def doors() -> Iterator[dict[str, httpx2.Client]]:
    with tempfile.TemporaryDirectory(prefix="lb-") as folder, Doors(Path(folder)).open() as made:
        yield made


@pytest.mark.parametrize("door", ["unix", "tcp", "everything", "reads", "belt", "without"])
@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda one: one.label)
def test_what_comes_back_is_described(
    doors: dict[str, httpx2.Client], door: str, operation: Any
) -> None:
    modes = schemathesis.GenerationMode
    cases = st.one_of(
        *(operation.as_strategy(generation_mode=mode) for mode in (modes.POSITIVE, modes.NEGATIVE))
    )

    @settings(
        max_examples=EXAMPLES if door in ("unix", "tcp") else GUARDED_EXAMPLES,
        deadline=None, database=None, derandomize=True,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(cases, st.booleans())
    def ask(case: Any, is_there: bool) -> None:
        if is_there:
            for name in case.path_parameters or {}:
                case.path_parameters[name] = PLACES.get(name, case.path_parameters[name])
        words = case.as_transport_kwargs(base_url=str(doors[door].base_url))
        request = {
            key: words[key] for key in ("method", "url", "params", "headers") if key in words
        }
        content = words.get("data")
        if "json" in words:
            content = json.dumps(words["json"])
        try:
            answer = doors[door].request(**request, content=content)
        except (httpx2.InvalidURL, httpx2.LocalProtocolError, UnicodeEncodeError):
            return  # the client itself does not send it
        case.validate_response(answer, checks=CHECKS)
        if door == "without":
            assert answer.status_code in REFUSED
        if door == "reads" and request["method"] not in ("GET", "HEAD"):
            assert answer.status_code in REFUSED

    ask()
