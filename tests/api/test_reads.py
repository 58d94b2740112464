"""What is known, over HTTP: shapes, exact values, and no silently wrong answers."""

from __future__ import annotations

import json
from decimal import Decimal

import httpx2
import pytest

from lecombus.drive_state.store import DriveState
from lecombus.drives import family
from lecombus.errors import (
    CutReplyError,
    GarbledReplyError,
    LecombusError,
    LineClosedError,
    LineLostError,
    NakError,
    NoReplyError,
    OperationError,
    QueueFullError,
    UnknownCodeError,
)
from lecombus.parameters import Code, Value
from lecombus.schedule.request import Priority
from openapi.answer_models import (
    DescribedDocument,
    DriveDocument,
    DrivesDocument,
    GroupsDocument,
    LineDocument,
    ReadingDocument,
    RestoreDocument,
    WhyDocument,
)
from support.api_line import FREQUENCY, STATUS, Line
from support.golden import Golden

pytestmark = [pytest.mark.anyio, pytest.mark.clock]


async def test_a_stored_value_is_given_exactly_as_the_drive_said_it(
    client: httpx2.AsyncClient,
) -> None:
    answer = await client.get("/v1/drives/feeder/codes/C0046")
    assert answer.status_code == 200
    assert '"value": 35.40,' in answer.text
    found = ReadingDocument.model_validate(answer.json())
    assert (found.code, found.subcode, found.raw, found.quality) == ("C0046", 0, "35.40", "good")
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("written", ["C0046", "C46", "46", "c0046"])
async def test_codes_may_be_written_as_people_do(client: httpx2.AsyncClient, written: str) -> None:
    answer = await client.get(f"/v1/drives/feeder/codes/{written}")
    assert answer.json()["code"] == "C0046"


async def test_subcodes_stand_after_a_slash(client: httpx2.AsyncClient, line: Line) -> None:
    line.store.value_read("feeder", Code(39, 1), Value.parse("7"), 0.0)
    answer = await client.get("/v1/drives/feeder/codes/C0039/1")
    assert (answer.json()["subcode"], answer.json()["raw"]) == (1, "7")


async def test_a_value_never_read_is_bad_and_not_an_error(client: httpx2.AsyncClient) -> None:
    found = ReadingDocument.model_validate((await client.get("/v1/drives/belt/codes/46")).json())
    assert (found.value, found.quality, found.reason) == (None, "bad", "not read yet")


async def test_fresh_reads_now(client: httpx2.AsyncClient, line: Line) -> None:
    answer = await client.get("/v1/drives/feeder/codes/C0050?fresh=true")
    assert '"value": 50.10,' in answer.text
    assert line.ops.asked == [("read", "feeder", Code(50))]


async def test_long_work_reads_in_the_background_and_waits_longer_for_its_turn(
    client: httpx2.AsyncClient, line: Line
) -> None:
    told = []
    for query in ("fresh=true", "fresh=true&priority=interactive", "priority=background&fresh=1"):
        assert (await client.get(f"/v1/drives/feeder/codes/C0050?{query}")).status_code == 200
        told.append(line.ops.read_as)
    person, long_work = (Priority.INTERACTIVE, 10.0), (Priority.BACKGROUND, 45.0)
    assert told == [person, person, long_work]


async def test_a_priority_that_clients_may_not_have_is_refused(
    client: httpx2.AsyncClient, line: Line
) -> None:
    answer = await client.get("/v1/drives/feeder/codes/C0050?fresh=true&priority=stop")
    assert (answer.status_code, line.ops.asked) == (422, [])
    detail = answer.json()["detail"]
    assert detail.startswith('priority takes "interactive", or "background" for long work')


async def test_a_stored_read_never_asks_the_line(client: httpx2.AsyncClient, line: Line) -> None:
    for path in ("/v1/drives/feeder/codes/C0046", "/v1/drives", "/v1/line", "/metrics"):
        assert (await client.get(path)).status_code == 200
    assert line.ops.asked == []


async def test_a_misspelt_query_key_is_refused_with_the_nearest(
    client: httpx2.AsyncClient, golden: Golden
) -> None:
    answer = await client.get("/v1/drives/feeder/codes/C0046?fersh=true")
    assert answer.status_code == 422
    golden(answer.json()["detail"], answer.json()["remedy"])


@pytest.mark.parametrize("query", ["fresh=true&fresh=false", "fresh=perhaps", "x=1"])
async def test_queries_that_mean_nothing_are_refused(
    client: httpx2.AsyncClient, line: Line, query: str
) -> None:
    answer = await client.get(f"/v1/drives/feeder/codes/C0046?{query}")
    assert (answer.status_code, line.ops.asked) == (422, [])
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["/v1/line", "/v1/drives", "/v1/drives/feeder", "/v1/groups"])
async def test_lists_take_no_query(client: httpx2.AsyncClient, path: str) -> None:
    assert (await client.get(f"{path}?fresh=true")).status_code == 422


async def test_the_line_says_how_its_drives_are(client: httpx2.AsyncClient, line: Line) -> None:
    line.store.drive_state("belt", DriveState.OFFLINE, "no answer")
    line.store.note_line("echo", "the adapter echoes")
    found = LineDocument.model_validate((await client.get("/v1/line")).json())
    assert (found.line, found.state) == ("hall-3", "open")
    assert found.stretch == Decimal(1)
    assert found.drives == {"online": 1, "offline": 1}
    assert found.remarks == {"echo": "the adapter echoes"}


async def test_drives_come_with_every_value_and_its_quality(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.store.note("feeder", "watchdog", "C1923 differs")
    found = DrivesDocument.model_validate((await client.get("/v1/drives")).json())
    feeder, belt = found.drives
    assert (feeder.drive, feeder.address, feeder.family) == ("feeder", 11, "8200vector")
    assert feeder.remarks == {"watchdog": "C1923 differs"}
    assert [one.quality for one in feeder.values] == ["good"]
    assert [one.quality for one in belt.values] == ["bad"]


async def test_one_drive_is_the_same_document_as_in_the_list(
    client: httpx2.AsyncClient, line: Line
) -> None:
    for number in range(1000, 1040):
        line.store.value_read("feeder", Code(number), Value.parse("1"), 0.0)
    line.store.value_read("feeder", STATUS, Value.parse("H0900"), 0.0)
    found = DriveDocument.model_validate((await client.get("/v1/drives/feeder")).json())
    assert len(found.values) == 42
    assert found.values[0].code == str(FREQUENCY)
    assert found.values[-1].value == 0x900


async def test_whether_a_drive_may_be_restored_can_be_asked(client: httpx2.AsyncClient) -> None:
    found = RestoreDocument.model_validate((await client.get("/v1/drives/feeder/restore")).json())
    assert (found.drive, found.permitted, found.owned) == ("feeder", True, ["C1922", "C1923"])
    assert (await client.get("/v1/drives/fee/restore")).status_code == 404


async def test_groups_say_how_they_are_spoken_to(client: httpx2.AsyncClient) -> None:
    found = GroupsDocument.model_validate((await client.get("/v1/groups")).json())
    assert [(one.group, one.how, one.multicast_address) for one in found.groups] == [
        ("conveyors", "one-by-one", None),
        ("all", "multicast", 0),
    ]


async def test_an_unknown_drive_is_404_with_the_nearest_name(client: httpx2.AsyncClient) -> None:
    for path in ("/v1/drives/feedr", "/v1/drives/feedr/codes/C0046"):
        answer = await client.get(path)
        assert answer.status_code == 404
        problem = answer.json()
        assert problem["type"] == "urn:lecombus:problem:no-such-drive"
        assert (problem["drive"], problem["remedy"]) == ("feedr", "did you mean feeder?")


@pytest.mark.parametrize("code", ["X1", "C99999", "C0039/300", "C0039/x"])
async def test_a_path_that_names_no_code_is_404(client: httpx2.AsyncClient, code: str) -> None:
    answer = await client.get(f"/v1/drives/feeder/codes/{code}")
    assert answer.status_code == 404
    assert answer.json()["type"] == "urn:lecombus:problem:no-such-code"
    assert answer.json()["code"] == code


@pytest.mark.parametrize(
    ("error", "status", "kind"),
    [
        (NoReplyError("feeder: no answer"), 504, "no-answer"),
        (GarbledReplyError("wrong BCC"), 502, "garbled"),
        (UnknownCodeError("no such code"), 404, "no-such-code"),
        (NakError("NAK"), 409, "nak"),
        (LineLostError("unplugged"), 503, "line-lost"),
        (CutReplyError("feeder: the line was lost"), 503, "line-lost"),
        (LineClosedError("closing"), 503, "line-closed"),
        (QueueFullError(priority="interactive", depth=9, limit=9), 503, "queue-full"),
        (OperationError("offline", kind="offline", drive="feeder"), 504, "offline"),
        (OperationError("too late", kind="expired"), 503, "expired"),
        (OperationError("something new", kind="brand-new"), 409, "brand-new"),
        (LecombusError("odd"), 500, "internal"),
    ],
)
async def test_each_failure_of_a_fresh_read_has_its_status(
    client: httpx2.AsyncClient, line: Line, error: LecombusError, status: int, kind: str
) -> None:
    line.ops.error = error
    answer = await client.get("/v1/drives/feeder/codes/C0050?fresh=true")
    problem = answer.json()
    assert (answer.status_code, problem["status"]) == (status, status)
    assert problem["type"] == f"urn:lecombus:problem:{kind}"
    assert (problem["drive"], problem["code"]) == ("feeder", "C0050")
    assert problem["title"]


async def test_a_full_queue_says_when_to_ask_again(client: httpx2.AsyncClient, line: Line) -> None:
    line.ops.error = QueueFullError(priority="interactive", depth=9, limit=9)
    answer = await client.get("/v1/drives/feeder/codes/C0050?fresh=true")
    assert answer.headers["retry-after"] == "1"


async def test_a_mistake_in_lecombus_is_a_problem_document_too(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.error = ZeroDivisionError("oops")
    answer = await client.get("/v1/drives/feeder/codes/C0050?fresh=true")
    assert answer.status_code == 500
    assert answer.json()["type"] == "urn:lecombus:problem:internal"


async def test_unknown_paths_and_methods_are_problems(client: httpx2.AsyncClient) -> None:
    for path in ("/", "/v1", "/v1/drives/", "/docs", "/redoc"):
        answer = await client.get(path)
        assert (answer.status_code, answer.json()["status"]) == (404, 404)
        assert answer.headers["content-type"] == "application/problem+json"
    answer = await client.delete("/v1/drives")
    assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD")
    assert answer.json()["type"] == "urn:lecombus:problem:wrong-method"


async def test_health_and_readiness_follow_the_daemon(
    client: httpx2.AsyncClient, line: Line
) -> None:
    assert (await client.get("/healthz")).json()["status"] == "ok"
    assert (await client.get("/readyz")).json()["detail"] == "31 of 31 drives tried"
    line.ready = (False, "30 of 31 drives tried")
    line.healthy = (False, "no exchange for 10 s")
    answer = await client.get("/readyz")
    assert (answer.status_code, answer.json()["detail"]) == (503, "30 of 31 drives tried")
    assert (await client.get("/healthz")).status_code == 503


async def test_metrics_come_in_the_format_the_scraper_likes(client: httpx2.AsyncClient) -> None:
    text = await client.get("/metrics")
    assert text.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert "lecombus_drive_up{" in text.text
    accept = {"Accept": "application/openmetrics-text; version=1.0.0"}
    openmetrics = await client.get("/metrics", headers=accept)
    assert openmetrics.headers["content-type"].startswith("application/openmetrics-text")
    assert openmetrics.text.endswith("# EOF\n")


async def test_openapi_describes_every_path_and_refers_to_nothing_missing(
    client: httpx2.AsyncClient,
) -> None:
    text = (await client.get("/openapi.json")).text
    document = json.loads(text, parse_float=Decimal)
    assert {
        "/v1/journal",
        "/v1/journal/verify",
        "/v1/line",
        "/v1/line/addresses/{address}/codes/{code}",
        "/v1/line/addresses/{address}/codes/{code}/{subcode}",
        "/v1/drives",
        "/v1/drives/{drive}",
        "/v1/drives/{drive}/accept",
        "/v1/drives/{drive}/address",
        "/v1/drives/{drive}/described",
        "/v1/drives/{drive}/forget-times",
        "/v1/drives/{drive}/identity",
        "/v1/drives/{drive}/restore",
        "/v1/drives/{drive}/verbs/{verb}",
        "/v1/drives/{drive}/wear",
        "/v1/drives/{drive}/why",
        "/v1/drives/{drive}/codes/{code}",
        "/v1/drives/{drive}/codes/{code}/{subcode}",
        "/v1/groups",
        "/v1/groups/{group}/codes/{code}",
        "/v1/groups/{group}/codes/{code}/{subcode}",
        "/v1/plan",
        "/v1/reload",
        "/v1/stop",
        "/healthz",
        "/readyz",
        "/v1/events",
        "/v1/leases",
        "/v1/leases/{lease}",
    } == set(document["paths"])
    schemas = document["components"]["schemas"]
    references = {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]}
    assert references <= set(schemas)
    write = document["paths"]["/v1/drives/{drive}/codes/{code}"]["put"]
    assert set(write["requestBody"]["content"]["application/json"]["schema"]["properties"]) == {
        "value",
        "expires",
        "verify",
        "priority",
        "restore",
        "stops",
    }
    assert {"200", "403", "404", "409", "422", "503", "504"} <= set(write["responses"])
    ids = [one["operationId"] for path in document["paths"].values() for one in path.values()]
    assert len(ids) == len(set(ids))


async def test_the_described_codes_of_a_drive(client: httpx2.AsyncClient) -> None:
    answer = await client.get("/v1/drives/feeder/described")
    assert answer.status_code == 200
    found = DescribedDocument.model_validate_json(answer.text)
    assert (found.drive, found.family) == ("feeder", "8200vector")
    assert len(found.codes) == len(list(family("8200vector").described()))
    assert (await client.get("/v1/drives/nobody/described")).status_code == 404
    assert (await client.get("/v1/drives/feeder/described?x=1")).status_code == 422


async def test_a_reading_says_what_its_value_means(client: httpx2.AsyncClient, line: Line) -> None:
    line.store.value_read("feeder", Code(1922), Value.decimal(2), line.now_s)
    found = (await client.get("/v1/drives/feeder/codes/C1922")).json()
    assert (found["value"], found["text"]) == (2, "quick stop")
    line.store.value_read("feeder", Code(1922), Value.decimal(7), line.now_s)
    assert (await client.get("/v1/drives/feeder/codes/C1922")).json()["text"] is None


async def test_why_a_drive_does_not_turn_is_told_in_the_language_asked_for(
    client: httpx2.AsyncClient, line: Line
) -> None:
    found = WhyDocument.model_validate((await client.get("/v1/drives/feeder/why")).json())
    assert (found.answer, found.findings[0].remedy) == ("the controller is inhibited", None)
    assert found.history[0].meaning == "heat sink too hot"
    answer = await client.get("/v1/drives/feeder/why?fresh=true&lang=de")
    found = WhyDocument.model_validate(answer.json())
    assert found.findings[0].text == "der Regler ist gesperrt"
    assert line.ops.asked == [
        ("why", "feeder", False, Priority.INTERACTIVE),
        ("why", "feeder", True, Priority.INTERACTIVE),
    ]
    refused = await client.get("/v1/drives/feeder/why?lang=fr")
    assert refused.status_code == 422
