"""The journal over HTTP: pages of rows, and whether they are whole."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import anyio.lowlevel
import httpx2
import pytest
from starlette.applications import Starlette

from lecombus.api.error_answers import ERROR_ANSWERS
from lecombus.api.journal_routes import JournalRoutes
from lecombus.journal.journal import Journal
from openapi.answer_models import JournalDocument, VerifiedDocument

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

AFTER = "after takes the number of a row, 0 to 9007199254740992, not"

GROUPS = {"all": SimpleNamespace(members=("a", "b")), "one": SimpleNamespace(members=("b",))}


def client_of(journal: Journal | None) -> httpx2.AsyncClient:
    ops: Any = SimpleNamespace(context=SimpleNamespace(groups=GROUPS))
    app = Starlette(
        routes=JournalRoutes(journal, ops).routes(),
        exception_handlers=ERROR_ANSWERS,
    )
    transport = httpx2.ASGITransport(app=app)
    return httpx2.AsyncClient(transport=transport, base_url="http://localhost")


@pytest.fixture
async def journal(tmp_path: Path) -> AsyncIterator[Journal]:
    journal = await Journal.opened(tmp_path / "j", 16_000_000, time.time)
    yield journal
    await journal.close()


@pytest.fixture
async def client(journal: Journal) -> AsyncIterator[httpx2.AsyncClient]:
    for number in range(30):
        intent = journal.intend("write", "ab"[number % 2], {"value": str(number)})
        journal.conclude(intent, "done", {"reason": "x"})
    journal.record("stop", "all", {"action": "inhibit"}, outcome="verified")
    journal.record("start")
    with anyio.fail_after(30):
        while journal.head.number < 62:  # noqa: ASYNC110 - a thread's work
            await anyio.sleep(0.01)
    async with client_of(journal) as client:
        yield client


async def numbers(client: httpx2.AsyncClient, **query: str) -> tuple[list[int], int | None]:
    answer = await client.get("/v1/journal", params=query)
    assert answer.status_code == 200, answer.text
    document = JournalDocument.model_validate(answer.json())
    return [row.number for row in document.rows], document.next


async def test_rows_come_in_pages(client: httpx2.AsyncClient) -> None:
    assert await numbers(client, limit="3") == ([1, 2, 3], 3)
    assert await numbers(client, after="3", limit="500") == (list(range(4, 63)), None)
    assert await numbers(client, after="62") == ([], None)
    assert await numbers(client, last="true", limit="2") == ([61, 62], None)
    assert (await numbers(client, since="2000-01-01T00:00:00Z", limit="1"))[0] == [1]
    assert await numbers(client, since="2100-01-01T00:00:00+01:00") == ([], None)


async def test_a_drive_has_the_rows_of_its_groups_too(client: httpx2.AsyncClient) -> None:
    found, _ = await numbers(client, drive="a", last="true", limit="3")
    assert found == [57, 58, 61]
    assert (await numbers(client, drive="all"))[0] == [61]
    assert (await numbers(client, drive="gone"))[0] == []


async def test_a_row_has_what_was_asked_and_how_it_ended(client: httpx2.AsyncClient) -> None:
    document = JournalDocument.model_validate((await client.get("/v1/journal?limit=2")).json())
    asked, end = document.rows
    assert (asked.outcome, asked.ended, asked.asked) == ("asked", True, None)
    assert (end.outcome, end.ended, end.asked) == ("done", False, 1)
    assert end.fields == {"value": "0", "reason": "x"}
    assert end.drive == "a"


async def test_verifying_names_the_head(client: httpx2.AsyncClient, journal: Journal) -> None:
    answer = await client.get("/v1/journal/verify")
    document = VerifiedDocument.model_validate(answer.json())
    assert (document.whole, document.rows, document.head) == (True, 62, str(journal.head))
    answer = await client.get("/v1/journal/verify", params={"head": str(journal.head)})
    assert answer.json()["whole"]
    answer = await client.get("/v1/journal/verify", params={"head": f"62:{'0' * 64}"})
    assert not answer.json()["whole"]


@pytest.mark.parametrize(
    "query",
    ["after=-1", "limit=0", "limit=501", "since=soon", "last=true&after=1", "drives=a", "last=7"],
)
async def test_what_cannot_be_asked_is_refused(client: httpx2.AsyncClient, query: str) -> None:
    assert (await client.get(f"/v1/journal?{query}")).status_code == 422


@pytest.mark.parametrize(
    ("path", "said"),
    [
        (f"?after={2**53 + 1}", f"{AFTER} '9007199254740993'"),
        (f"?after={2**63 - 1}", AFTER),
        (f"?after={'9' * 5000}", AFTER),
        ("?limit=501", "limit takes a whole number, 1 to 500, not '501'"),
        ("?last=maybe", "last takes true or false, not 'maybe'"),
        ("?since=soon", "since takes a time, not 'soon'"),
        ("?since=2026-11-23T06:00:00", "since takes a time with its zone, not "),
        ("/verify?head=305:00", "head takes NUMBER:HASH as in the log's event journal-head, with"),
    ],
    ids=lambda word: word[:30],
)
async def test_a_wrong_value_is_said_with_what_it_takes(
    client: httpx2.AsyncClient, path: str, said: str
) -> None:
    answer = await client.get(f"/v1/journal{path}")
    assert answer.status_code == 422
    assert answer.json()["detail"].startswith(said)
    assert "openapi" not in answer.text
    assert "pattern" not in answer.text


async def test_the_largest_number_and_the_first_and_last_times_are_answered(
    client: httpx2.AsyncClient,
) -> None:
    assert await numbers(client, after=str(2**53)) == ([], None)
    assert (await numbers(client, since="0001-01-01T00:00:00+14:00", limit="1"))[0] == [1]
    assert await numbers(client, since="9999-12-31T23:59:59-14:00") == ([], None)


@pytest.mark.parametrize("head", ["5", "5:12", "x:" + "0" * 64])
async def test_a_head_that_is_none_is_refused(client: httpx2.AsyncClient, head: str) -> None:
    assert (await client.get(f"/v1/journal/verify?head={head}")).status_code == 422


async def test_without_a_journal_that_is_said() -> None:
    async with client_of(None) as client:
        for path in ("/v1/journal", "/v1/journal/verify"):
            answer = await client.get(path)
            assert (answer.status_code, answer.json()["type"].split(":")[-1]) == (404, "no-journal")


async def test_one_that_cannot_be_read_is_a_problem(tmp_path: Path) -> None:
    journal = await Journal.opened(tmp_path / "no" / "j", 16_000_000, time.time)
    async with client_of(journal) as client:
        for path in ("/v1/journal", "/v1/journal/verify"):
            answer = await client.get(path)
            assert answer.status_code == 503
            assert answer.json()["type"].endswith(":journal-failing")
    await journal.close()


@pytest.mark.parametrize("query", [{"last": "true"}, {"after": "60"}])
async def test_a_row_that_comes_while_rows_are_read_is_found_behind_the_head(
    journal: Journal, client: httpx2.AsyncClient, query: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Who follows asks for the rows behind the head: each row is given once."""
    checkpoint = anyio.lowlevel.checkpoint

    async def slow() -> None:
        monkeypatch.setattr("lecombus.api.journal_routes.anyio.lowlevel.checkpoint", checkpoint)
        journal.record("message", "a", {})
        while journal.head.number < 63:  # noqa: ASYNC110 - a thread's work
            await anyio.sleep(0.01)

    monkeypatch.setattr("lecombus.api.journal_routes.anyio.lowlevel.checkpoint", slow)
    page = (await client.get("/v1/journal", params=query)).json()
    shown = [row["number"] for row in page["rows"]]
    behind = page["next"] or int(page["head"].partition(":")[0])
    more, _ = await numbers(client, after=str(behind))
    assert [*shown, *more][-3:] == [61, 62, 63]
