"""Requests made from the description of the interface, at both doors: schemathesis.

Every operation is asked with what the document says is right and with what it says is wrong;
whatever comes back must be described, and nothing may be a mistake of lecombus.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from collections.abc import Iterator
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


class Doors:
    """Both doors of a line with fake operations, served in a thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._end: Event

    @contextlib.contextmanager
    def open(self) -> Iterator[dict[str, httpx2.Client]]:
        """Serve, and give a client of each door."""
        with start_blocking_portal() as portal:
            ended, served = portal.start_task(self._run)
            unix = httpx2.HTTPTransport(uds=str(served.socket_path))
            with (
                httpx2.Client(transport=unix, base_url="http://localhost") as over_unix,
                httpx2.Client(base_url=f"http://127.0.0.1:{served.http[1]}") as over_tcp,
            ):
                yield {"unix": over_unix, "tcp": over_tcp}
            portal.call(self._end.set)
            ended.result()

    async def _run(self, *, task_status: Any) -> None:
        self._end = Event()
        async with create_task_group() as tasks:
            served: Served = await tasks.start(
                serve, make_line().app, self._folder / "s", ("127.0.0.1", 0)
            )
            task_status.started(served)
            await self._end.wait()
            tasks.cancel_scope.cancel()


@pytest.fixture(scope="module")
def doors() -> Iterator[dict[str, httpx2.Client]]:
    with tempfile.TemporaryDirectory(prefix="lb-") as folder, Doors(Path(folder)).open() as made:
        yield made


@pytest.mark.parametrize("door", ["unix", "tcp"])
@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda one: one.label)
def test_what_comes_back_is_described(
    doors: dict[str, httpx2.Client], door: str, operation: Any
) -> None:
    modes = schemathesis.GenerationMode
    cases = st.one_of(
        *(operation.as_strategy(generation_mode=mode) for mode in (modes.POSITIVE, modes.NEGATIVE))
    )

    @settings(
        max_examples=EXAMPLES, deadline=None, database=None, derandomize=True,
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

    ask()
