"""Writes and stops over HTTP: exact numbers in, one outcome out, repeats made safe."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any, cast

import anyio
import anyio.lowlevel
import httpx2
import pytest
from starlette.requests import Request
from starlette.responses import Response

from lecombus.api.answers import RefusedRequestError
from lecombus.api.idempotency import KEEP_S, KEY_LIMIT, Idempotency, content_of
from lecombus.api.limits import BODY_LIMIT
from lecombus.config import Mistake, RosterChanges, RosterError
from lecombus.drives import StopAction
from lecombus.errors import CodeValueError, NoReplyError, OperationError, QueueFullError
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.kept import NOT_KNOWN, KeyRow
from lecombus.operations.operation_reports import WriteReport
from lecombus.schedule.request import Outcome, Priority
from openapi.answer_models import GroupOutcomeDocument, OutcomeDocument, ReloadDocument
from support.api_line import FREQUENCY, Line
from support.golden import Golden

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

SETPOINT = "/v1/drives/feeder/codes/C0046"


async def put(
    client: httpx2.AsyncClient, text: str | bytes, path: str = SETPOINT, key: str | None = None
) -> httpx2.Response:
    headers = {"Content-Type": "application/json"}
    if key is not None:
        headers["Idempotency-Key"] = key
    return await client.put(path, content=text, headers=headers)


@pytest.mark.parametrize(
    ("written", "given"),
    [
        ("35.4", Decimal("35.4")),
        ("50.10", Decimal("50.10")),
        ("0.1", Decimal("0.1")),
        ("-214748.3648", Decimal("-214748.3648")),
        ("35", 35),
        ("3.5e1", Decimal("35")),
        ('"H0008"', "H0008"),
    ],
)
async def test_a_value_arrives_exactly_as_it_was_written(
    client: httpx2.AsyncClient, line: Line, written: str, given: object
) -> None:
    answer = await put(client, f'{{"value": {written}}}')
    assert answer.status_code == 200
    ((what, drive, code, value, expires_s, verify),) = line.ops.asked
    assert (what, drive, code, expires_s, verify) == ("write", "feeder", FREQUENCY, None, False)
    assert value == given
    assert type(value) is type(given)


@pytest.mark.usefixtures("standing_clock")
@pytest.mark.parametrize(
    ("written", "expires_s"),
    [
        ('"2s"', 2.0),
        ('"500ms"', 0.5),
        ('"1.5 s"', 1.5),
        ('"1h"', 3600.0),
        ("2", 2.0),
        ("0.25", 0.25),
        ("null", None),
    ],
)
async def test_expiry_is_a_duration_or_seconds(
    client: httpx2.AsyncClient, line: Line, written: str, expires_s: float | None
) -> None:
    await put(client, f'{{"value": 1, "expires": {written}, "verify": true}}')
    assert line.ops.asked == [("write", "feeder", FREQUENCY, 1, expires_s, True)]


async def test_a_repeat_that_waited_for_the_first_request_expires_when_it_would_have(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.gate = anyio.Event()
    line.ops.error = OperationError("the client is gone", kind="client-gone", remedy="")
    answers: list[int] = []

    async def ask() -> None:
        body = '{"value": 1, "expires": "60s"}'
        answers.append((await put(client, body, key="a")).status_code)

    async with anyio.create_task_group() as tasks:
        tasks.start_soon(ask)
        await line.ops.begun.wait()
        tasks.start_soon(ask)
        await anyio.sleep(0.2)
        line.ops.gate.set()
    assert answers == [408, 408], "the first was not sent, so the second takes its place"
    left: list[Any] = [one[4] for one in line.ops.asked]
    assert left[0] - left[1] >= 0.15


async def test_a_write_may_say_that_it_has_time(client: httpx2.AsyncClient, line: Line) -> None:
    for said, urgency in (("", None), (', "priority": "background"', Priority.BACKGROUND)):
        assert (await put(client, f'{{"value": 1{said}}}')).status_code == 200
        assert line.ops.written_as == (urgency, False)
    answer = await put(client, '{"value": 1, "priority": "control"}')
    assert (answer.status_code, len(line.ops.asked)) == (422, 2)
    assert 'priority takes "interactive", or "background"' in answer.json()["detail"]


@pytest.mark.parametrize(
    "body",
    [
        "",
        "{",
        "[1]",
        b'{"value": "\xff"}',
        '{"value": NaN}',
        '{"value": Infinity}',
        '{"value": 1, "value": 2}',
        "[" * 8000,
        "{}",
        '{"value": true}',
        '{"value": null}',
        '{"value": [1]}',
        '{"value": {}}',
        '{"value": ""}',
        '{"value": 1e999999}',
        '{"value": 1e9999999999999999999}',
        '{"value": 1e-9999999999999999999}',
        '{"value": 1e-999999999999999999}',
        '{"value": 1, "expires": 1e9999999999999999999}',
        '{"value": 1, "expires": 1e-9999999999999999999}',
        '{"value": 1, "expires": 1e-999999}',
        '{"\\ud800": 1}',
        '{"value": 1, "\\udfff": 1}',
        '{"valeu": 1}',
        '{"value": 1, "expire": "2s"}',
        '{"value": 1, "expires": "2"}',
        '{"value": 1, "expires": 0}',
        '{"value": 1, "expires": -1}',
        '{"value": 1, "expires": "2h"}',
        '{"value": 1, "expires": true}',
        '{"value": 1, "verify": "yes"}',
        '{"value": 1, "verify": 1}',
    ],
)
async def test_a_wrong_body_is_refused_and_nothing_is_sent(
    client: httpx2.AsyncClient, line: Line, body: str | bytes, golden: Golden
) -> None:
    answer = await put(client, body)
    assert answer.status_code == 422
    golden(answer.json()["detail"])
    assert answer.json()["remedy"].startswith("send {")
    assert line.ops.asked == []


async def test_all_mistakes_are_told_at_once(client: httpx2.AsyncClient) -> None:
    answer = await put(client, '{"valeu": 1, "verify": 3}')
    for part in ("key value is missing", "no key valeu", "verify takes"):
        assert part in answer.json()["detail"]


async def test_what_is_said_of_a_wrong_request_is_bounded(client: httpx2.AsyncClient) -> None:
    many = ", ".join(f'"{"k" * 500}{number}": 1' for number in range(14))
    long = "x" * 3000
    for answer in (
        await put(client, "{" + many + "}"),
        await put(client, f'{{"{long}": 1, "{long}": 2}}'),
        await put(client, '{"value": 1}', f"/v1/drives/feeder/codes/{long}"),
        await put(client, '{"value": 1}', f"/{long}"),
        await put(client, '{"value": 1}', f"{SETPOINT}?{long}=1"),
        await client.get(f"/v1/drives/{long}"),
        await client.get(f"/v1/drives/feeder/codes/{long}"),
    ):
        assert 400 <= answer.status_code < 500
        assert len(answer.text) < 2000
        assert "..." in answer.json()["detail"]


async def test_a_body_too_big_is_refused(client: httpx2.AsyncClient, line: Line) -> None:
    answer = await put(client, '{"value": "' + "x" * BODY_LIMIT + '"}')
    assert (answer.status_code, line.ops.asked) == (413, [])


async def test_a_query_on_a_write_is_refused(client: httpx2.AsyncClient, line: Line) -> None:
    answer = await put(client, '{"value": 1}', f"{SETPOINT}?verify=true")
    assert (answer.status_code, line.ops.asked) == (422, [])


async def test_a_verified_write_shows_what_was_read_back(
    client: httpx2.AsyncClient, line: Line
) -> None:
    reading = line.store.reading("feeder", FREQUENCY)
    line.ops.report = lambda drive, code: WriteReport(
        drive, code, Outcome.VERIFIED, reading=reading
    )
    answer = await put(client, '{"value": 35.4}')
    found = OutcomeDocument.model_validate(answer.json())
    assert (found.outcome, found.code) == ("verified", "C0046")
    assert found.reading is not None
    assert '"value": 35.40,' in answer.text


@pytest.mark.parametrize(
    ("outcome", "kind", "status"),
    [
        (Outcome.REFUSED, "nak", 409),
        (Outcome.REFUSED, "", 409),
        (Outcome.REFUSED, "not-writable", 403),
        (Outcome.REFUSED, "offline", 504),
        (Outcome.REFUSED, "line-lost", 503),
        (Outcome.EXPIRED, "", 503),
        (Outcome.SUPERSEDED, "", 409),
        (Outcome.UNKNOWN, "no-answer", 504),
        (Outcome.UNKNOWN, "", 504),
    ],
)
async def test_each_outcome_has_its_status_and_names_cause_and_remedy(
    client: httpx2.AsyncClient, line: Line, outcome: Outcome, kind: str, status: int
) -> None:
    line.ops.report = lambda drive, code: WriteReport(
        drive, code, outcome, "it said no", "C0001 is not 3", kind, "write C0001 = 3"
    )
    answer = await put(client, '{"value": 35.4}')
    problem = answer.json()
    assert (answer.status_code, problem["outcome"]) == (status, outcome.value)
    assert (problem["drive"], problem["code"]) == ("feeder", "C0046")
    assert (problem["detail"], problem["cause"]) == ("it said no", "C0001 is not 3")
    assert problem["remedy"] == "write C0001 = 3"


@pytest.mark.parametrize(
    ("error", "status", "outcome", "sent"),
    [
        (CodeValueError("too many decimals"), 422, None, None),
        (OperationError("not in the roster", kind="not-writable"), 403, "refused", False),
        (OperationError("no such group", kind="no-such-group"), 404, None, None),
        (NoReplyError("silence"), 504, "refused", False),
    ],
)
async def test_a_write_that_is_not_taken_says_why(
    client: httpx2.AsyncClient,
    line: Line,
    error: Exception,
    status: int,
    outcome: str | None,
    sent: bool | None,
) -> None:
    line.ops.error = error
    for path in (SETPOINT, "/v1/groups/conveyors/codes/C0046/2"):
        answer = await put(client, '{"value": 35.4}', path)
        assert (answer.status_code, answer.json()["outcome"]) == (status, outcome)
        assert answer.json().get("sent") is sent


async def test_a_group_write_has_an_outcome_per_member(
    client: httpx2.AsyncClient, line: Line
) -> None:
    answer = await put(client, '{"value": 1}', "/v1/groups/conveyors/codes/C0040/0")
    found = GroupOutcomeDocument.model_validate(answer.json())
    assert (answer.status_code, found.outcome, found.how) == (200, "done", "one-by-one")
    assert [(one.drive, one.outcome) for one in found.members] == [
        ("feeder", "done"),
        ("belt", "done"),
    ]


async def test_a_group_that_was_not_reached_whole_is_a_problem_with_its_members(
    client: httpx2.AsyncClient, line: Line, golden: Golden
) -> None:
    line.ops.report = lambda drive, code: (
        WriteReport(drive, code, Outcome.UNKNOWN, "no answer")
        if drive == "belt"
        else WriteReport(drive, code, Outcome.REFUSED, "NAK", kind="nak")
    )
    answer = await put(client, '{"value": 1}', "/v1/groups/conveyors/codes/C0040")
    problem = answer.json()
    assert (answer.status_code, problem["target"]) == (504, "conveyors")
    assert [one["outcome"] for one in problem["members"]] == ["refused", "unknown"]
    golden(problem["detail"])


async def test_a_member_that_was_sent_nothing_names_no_code(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.report = lambda drive, code: WriteReport(
        drive, None, Outcome.REFUSED, "no inhibit is known", kind="no-stop"
    )
    answer = await client.post("/v1/stop", json={"action": "inhibit", "target": "all"})
    members = [OutcomeDocument.model_validate(one) for one in answer.json()["members"]]
    assert answer.status_code == 409
    assert {(one.code, one.subcode, one.outcome) for one in members} == {(None, None, "refused")}


async def test_stop_names_action_and_target(client: httpx2.AsyncClient, line: Line) -> None:
    body = {"action": "quick-stop", "target": "all"}
    answer = await client.post("/v1/stop", json=body)
    GroupOutcomeDocument.model_validate(answer.json())
    assert answer.status_code == 200
    assert line.ops.asked == [("stop", StopAction.QUICK_STOP, "all")]


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ('{"action": "halt", "target": "all"}', "quick-stop"),
        ('{"action": "inhibit"}', "target is missing"),
        ('{"action": "inhibit", "target": 5}', "target takes"),
        ('{"action": "inhibit", "targets": "all"}', "did you mean target?"),
    ],
)
async def test_a_stop_that_is_not_understood_says_what_is_right(
    client: httpx2.AsyncClient, line: Line, body: str, says: str
) -> None:
    answer = await client.post("/v1/stop", content=body)
    assert (answer.status_code, line.ops.asked) == (422, [])
    assert says in answer.json()["detail"]


async def test_a_repeat_with_the_same_key_writes_once(
    client: httpx2.AsyncClient, line: Line
) -> None:
    first = await put(client, '{"value": 1}', key="a")
    line.ops.report = lambda drive, code: WriteReport(drive, code, Outcome.REFUSED)
    again = await put(client, '{"value": 1}', key="a")
    assert (again.status_code, again.text) == (first.status_code, first.text)
    assert len(line.ops.asked) == 1
    assert (await put(client, '{"value": 1}', key="b")).status_code == 409


async def test_a_repeat_while_the_first_is_under_way_waits_for_it(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.gate = anyio.Event()
    answers: list[httpx2.Response] = []

    async def ask() -> None:
        answers.append(await put(client, '{"value": 1}', key="a"))

    with anyio.fail_after(10):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(ask)
            tasks.start_soon(ask)
            await anyio.wait_all_tasks_blocked()
            assert answers == []
            line.ops.gate.set()
    assert [one.status_code for one in answers] == [200, 200]
    assert len(line.ops.asked) == 1


async def stop(client: httpx2.AsyncClient, target: str = "all", key: str = "a") -> httpx2.Response:
    headers = {"Idempotency-Key": key}
    body = {"action": "inhibit", "target": target}
    return await client.post("/v1/stop", json=body, headers=headers)


async def test_a_stop_repeated_later_with_the_same_key_is_a_new_stop(
    client: httpx2.AsyncClient, line: Line
) -> None:
    assert [(await stop(client)).status_code for _ in range(2)] == [200, 200]
    assert len(line.ops.asked) == 2


async def test_a_stop_repeated_while_it_is_under_way_shares_its_result(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.gate = anyio.Event()
    answers: list[httpx2.Response] = []

    async def ask(target: str = "all") -> None:
        answers.append(await stop(client, target))

    with anyio.fail_after(10):
        async with anyio.create_task_group() as tasks:
            for target in ("all", "all", "feeder"):
                tasks.start_soon(ask, target)
            await anyio.wait_all_tasks_blocked()
            line.ops.gate.set()
    assert [one.status_code for one in answers] == [200, 200, 200]
    assert sorted(str(one[2]) for one in line.ops.asked) == ["all", "feeder"]


async def test_a_stop_whose_like_failed_stops_by_itself(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.gate = anyio.Event()
    line.ops.error = QueueFullError(priority="stop", depth=1, limit=1)
    answers: list[httpx2.Response] = []

    async def ask() -> None:
        answers.append(await stop(client))

    with anyio.fail_after(10):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(ask)
            tasks.start_soon(ask)
            await anyio.wait_all_tasks_blocked()
            line.ops.gate.set()
    assert [one.status_code for one in answers] == [503, 503]
    assert len(line.ops.asked) == 2


async def test_no_stop_is_refused_for_its_key(client: httpx2.AsyncClient, line: Line) -> None:
    line.ops.gate = anyio.Event()
    with anyio.fail_after(15):
        async with anyio.create_task_group() as tasks:
            for number in range(KEY_LIMIT):
                tasks.start_soon(put, client, '{"value": 1}', SETPOINT, str(number))
            await anyio.wait_all_tasks_blocked()
            line.ops.gate.set()
            assert (await stop(client, key="one too many")).status_code == 200
            assert (await stop(client, key="0")).status_code == 200


async def test_a_key_used_for_another_request_is_refused(
    client: httpx2.AsyncClient, line: Line
) -> None:
    await put(client, '{"value": 1}', key="a")
    for path, body in ((SETPOINT, '{"value": 2}'), ("/v1/drives/belt/codes/46", '{"value": 1}')):
        answer = await put(client, body, path, key="a")
        assert (answer.status_code, answer.json()["type"]) == (
            422,
            "urn:lecombus:problem:key-reused",
        )
    assert len(line.ops.asked) == 1


async def test_a_key_of_a_request_that_was_never_sent_may_be_tried_again(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.error = QueueFullError(priority="control", depth=1, limit=1)
    assert (await put(client, '{"value": 1}', key="a")).status_code == 503
    line.ops.error = None
    assert (await put(client, '{"value": 1}', key="a")).status_code == 200


@pytest.mark.parametrize(
    ("kind", "status"), [("lease-required", 403), ("latched", 409), ("offline", 504)]
)
async def test_a_refusal_is_remembered_so_that_a_late_repeat_moves_nothing(
    client: httpx2.AsyncClient, line: Line, kind: str, status: int
) -> None:
    line.ops.error = OperationError("not now", kind=kind, remedy="")
    first = await put(client, '{"value": 1}', key="a")
    line.ops.error = None
    again = await put(client, '{"value": 1}', key="a")
    assert (first.status_code, again.status_code, again.text) == (status, status, first.text)
    assert first.json()["sent"] is False
    assert (await put(client, '{"value": 1}', key="b")).status_code == 200


async def test_an_unknown_outcome_is_remembered(client: httpx2.AsyncClient, line: Line) -> None:
    line.ops.report = lambda drive, code: WriteReport(drive, code, Outcome.UNKNOWN)
    assert (await put(client, '{"value": 1}', key="a")).status_code == 504
    assert (await put(client, '{"value": 1}', key="a")).status_code == 504
    assert len(line.ops.asked) == 1


async def test_a_key_is_forgotten_after_its_time(client: httpx2.AsyncClient, line: Line) -> None:
    await put(client, '{"value": 1}', key="a")
    line.now_s += KEEP_S + 1
    assert (await put(client, '{"value": 2}', key="a")).status_code == 200


@pytest.mark.parametrize("key", ["", "x" * 256])
async def test_malformed_keys_are_refused(client: httpx2.AsyncClient, line: Line, key: str) -> None:
    assert (await put(client, '{"value": 1}', key=key)).status_code == 422
    assert line.ops.asked == []


@pytest.mark.parametrize("keys", [("a", "b"), ("a", "a"), ("a", "")])
@pytest.mark.parametrize("path", [SETPOINT, "/v1/groups/all/codes/C0046"])
async def test_a_write_with_two_keys_is_refused(
    client: httpx2.AsyncClient, line: Line, keys: tuple[str, str], path: str
) -> None:
    headers = [("Idempotency-Key", key) for key in keys]
    answer = await client.put(path, content='{"value": 1}', headers=headers)
    assert answer.status_code == 400
    assert answer.json()["type"].endswith(":doubled-header")
    assert "Idempotency-Key stands 2 times" in answer.json()["detail"]
    assert line.ops.asked == []


@pytest.mark.parametrize(
    ("body", "shown"),
    [
        ('{"value": 1, "verify": 5}', "not 5"),
        ('{"value": 1, "verify": "5"}', "not '5'"),
        ('{"value": 1, "verify": 5.50}', "not 5.50"),
        ('{"value": 1, "expires": -1}', "not -1"),
        ('{"value": 1, "verify": "true"}', "not 'true'"),
    ],
)
async def test_a_wrong_value_is_shown_as_it_was_given(
    client: httpx2.AsyncClient, line: Line, body: str, shown: str
) -> None:
    answer = await put(client, body)
    assert answer.status_code == 422
    assert answer.json()["detail"].endswith(shown)


def keyed(key: str) -> Request:
    headers = [(b"idempotency-key", key.encode())]
    scope = {"type": "http", "method": "PUT", "path": "/", "query_string": b"", "headers": headers}
    return Request(scope)


@pytest.mark.parametrize("again", [None, b"2-b"])
async def test_a_key_of_another_lease_is_not_answered_by_what_was_done_before(
    again: bytes | None,
) -> None:
    keys, done = Idempotency(lambda: 0.0), list[str]()

    def under(token: bytes | None) -> Request:
        request = keyed("1")
        lease = [] if token is None else [(b"lecombus-lease", token)]
        request.scope["headers"] = [*request.scope["headers"], *lease]
        return Request(request.scope)

    async def act() -> Response:
        done.append("sent")
        return Response("x")

    await keys.run(under(b"1-a"), b"", act)
    await keys.run(under(b"1-a"), b"", act)
    with pytest.raises(RefusedRequestError, match="another request"):
        await keys.run(under(again), b"", act)
    assert done == ["sent"]


async def test_keys_take_bounded_memory() -> None:
    keys = Idempotency(lambda: 0.0)

    async def act() -> Response:
        return Response("x")

    for number in range(KEY_LIMIT + 50):
        await keys.run(keyed(str(number)), b"", act)
    assert len(keys) == KEY_LIMIT


async def test_old_keys_make_room_for_new_ones() -> None:
    now_s = 0.0
    keys = Idempotency(lambda: now_s)

    async def act() -> Response:
        return Response("x")

    for number in range(100):
        await keys.run(keyed(str(number)), b"", act)
    now_s = KEEP_S + 1
    await keys.run(keyed("new"), b"", act)
    assert len(keys) == 1


async def test_more_keys_under_way_than_fit_are_refused() -> None:
    keys = Idempotency(lambda: 0.0)
    gate = anyio.Event()

    async def act() -> Response:
        await gate.wait()
        return Response("x")

    with anyio.fail_after(15):
        async with anyio.create_task_group() as tasks:
            for number in range(KEY_LIMIT):
                tasks.start_soon(keys.run, keyed(str(number)), b"", act)
            await anyio.wait_all_tasks_blocked()
            with pytest.raises(RefusedRequestError):
                await keys.run(keyed("one too many"), b"", act)
            gate.set()


async def test_codes_in_group_paths_are_checked_too(client: httpx2.AsyncClient) -> None:
    answer = await put(client, '{"value": 1}', "/v1/groups/conveyors/codes/C0040/999")
    assert (answer.status_code, answer.json()["code"]) == (404, "C0040/999")


async def test_a_reload_says_what_changed(client: httpx2.AsyncClient, line: Line) -> None:
    async def reload() -> RosterChanges:
        return RosterChanges("hall.yaml", 2, ("fan",), (), {"belt": ("cyclic",)}, ("all",), ())

    line.reload = reload
    answer = await client.post("/v1/reload")
    assert answer.status_code == 200
    told = ReloadDocument.model_validate(answer.json())
    assert (told.outcome, told.added, told.groups) == ("done", ["fan"], ["all"])
    assert [(one.drive, one.keys) for one in told.changed] == [("belt", ["cyclic"])]


async def test_a_refused_reload_lists_every_mistake(client: httpx2.AsyncClient, line: Line) -> None:
    async def reload() -> RosterChanges:
        raise RosterError(Mistake("hall.yaml", row, 3, "wrong", "right") for row in (7, 4))

    line.reload = reload
    answer = await client.post("/v1/reload", headers={"Idempotency-Key": "x"})
    assert (answer.status_code, answer.json()["outcome"]) == (409, "refused")
    assert [one["line"] for one in answer.json()["mistakes"]] == [4, 7]
    assert answer.json()["detail"] == "hall.yaml has 2 mistakes: hall.yaml:4:3: wrong, right"


async def test_a_daemon_without_a_roster_file_says_so(client: httpx2.AsyncClient) -> None:
    answer = await client.post("/v1/reload", content=b"{}")
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:lecombus:problem:no-roster")


@pytest.mark.parametrize("more", ["?x=1", ""])
async def test_a_reload_takes_no_keys(client: httpx2.AsyncClient, more: str) -> None:
    answer = await client.post(f"/v1/reload{more}", content=b"" if more else b'{"file": "x"}')
    assert answer.status_code == 422


class KeptKeys:
    """A journal that keeps keys in memory, as its file would."""

    def __init__(self) -> None:
        self.rows: dict[str, KeyRow] = {}
        self.events: list[str] = []
        self.fails = False
        self.cannot_be_read = ""

    async def keys(self) -> list[KeyRow]:
        if self.cannot_be_read:
            raise JournalFileError(self.cannot_be_read)
        return list(self.rows.values())

    def keep(self, row: KeyRow) -> None:
        self.events.append(f"keep {row.status}" if row.content else "forget")
        if row.content:
            self.rows[row.name] = row
        else:
            self.rows.pop(row.name, None)

    async def keep_now(self, row: KeyRow) -> None:
        if self.fails:
            raise JournalFileError("no room")
        self.keep(row)


async def test_a_key_is_kept_before_its_request_and_its_answer_before_it_is_sent() -> None:
    kept = KeptKeys()
    keys = Idempotency(lambda: 0.0, cast(Journal, kept))

    async def act() -> Response:
        kept.events.append("act")
        return Response('{"outcome": "done"}', 200, media_type="application/json")

    await keys.run(keyed("k"), b"x", act)
    assert kept.events == ["keep None", "act", "keep 200"]
    later = Idempotency(lambda: 5.0, cast(Journal, kept), list(kept.rows.values()))
    again = await later.run(keyed("k"), b"x", act)
    assert (again.status_code, again.body) == (200, b'{"outcome": "done"}')
    assert again.media_type == "application/json"
    assert kept.events.count("act") == 1
    with pytest.raises(RefusedRequestError, match="another request"):
        await later.run(keyed("k"), b"y", act)


async def test_what_was_under_way_at_the_end_of_lecombus_is_unknown_and_not_repeated() -> None:
    kept = KeptKeys()
    kept.rows["k"] = KeyRow("k", content_of(keyed("k"), b"x"))
    keys = Idempotency(lambda: 0.0, cast(Journal, kept), list(kept.rows.values()))

    async def act() -> Response:
        raise AssertionError

    answer = await keys.run(keyed("k"), b"x", act)
    assert answer.status_code == 504
    assert json.loads(bytes(answer.body))["outcome"] == "unknown"


async def test_what_may_be_tried_later_is_not_kept() -> None:
    kept = KeptKeys()
    keys = Idempotency(lambda: 0.0, cast(Journal, kept))

    async def refuse() -> Response:
        raise OperationError("the disk is full", kind="journal-failing", remedy="")

    with pytest.raises(OperationError):
        await keys.run(keyed("k"), b"x", refuse)
    assert kept.events == ["keep None", "forget"]
    assert kept.rows == {}


async def slip() -> Response:
    raise RuntimeError("a mistake in lecombus")


async def test_after_a_mistake_in_lecombus_a_repeat_gets_the_same_answer_and_does_nothing(
    client: httpx2.AsyncClient, line: Line
) -> None:
    line.ops.error = RuntimeError("a mistake in lecombus")
    first = await put(client, '{"value": 1}', key="a")
    line.ops.error = None
    again = await put(client, '{"value": 1}', key="a")
    assert (first.status_code, first.json()["outcome"]) == (500, "unknown")
    assert (again.status_code, again.text) == (500, first.text)
    assert len(line.ops.asked) == 1
    assert (await put(client, '{"value": 1}', key="b")).status_code == 200


async def test_who_waits_for_a_request_that_ends_in_a_mistake_gets_its_answer() -> None:
    keys = Idempotency(lambda: 0.0)
    gate = anyio.Event()
    done: list[str] = []
    answers: list[int] = []

    async def act() -> Response:
        done.append("first")
        await gate.wait()
        return await slip()

    async def other() -> Response:
        done.append("second")
        return Response("x")

    async def ask() -> None:
        answers.append((await keys.run(keyed("k"), b"", other)).status_code)

    async def first() -> None:
        with pytest.raises(RuntimeError):
            await keys.run(keyed("k"), b"", act)

    with anyio.fail_after(10):
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(first)
            await anyio.wait_all_tasks_blocked()
            tasks.start_soon(ask)
            await anyio.wait_all_tasks_blocked()
            gate.set()
    assert (done, answers) == (["first"], [500])


async def test_what_ended_in_a_mistake_is_known_after_a_restart() -> None:
    kept = KeptKeys()
    keys = Idempotency(lambda: 0.0, cast(Journal, kept))
    with pytest.raises(RuntimeError):
        await keys.run(keyed("k"), b"x", slip)
    later = Idempotency(lambda: 5.0, cast(Journal, kept), list(kept.rows.values()))
    again = await later.run(keyed("k"), b"x", slip)
    assert again.status_code == 500
    assert "RuntimeError while answering" in bytes(again.body).decode()


async def test_a_request_that_was_cancelled_is_not_carried_out_again() -> None:
    """It may have been sent: cancelling it ends the waiting, not the write."""
    kept = KeptKeys()
    keys = Idempotency(lambda: 0.0, cast(Journal, kept))
    done: list[str] = []

    async def act() -> Response:
        done.append("act")
        await anyio.sleep_forever()
        raise AssertionError

    with anyio.move_on_after(0.01):
        await keys.run(keyed("k"), b"x", act)
    with anyio.fail_after(5.0):
        answer = await keys.run(keyed("k"), b"x", act)
    assert done == ["act"]
    assert (answer.status_code, json.loads(bytes(answer.body))["outcome"]) == (504, "unknown")


async def test_a_refusal_is_known_after_a_restart() -> None:
    kept = KeptKeys()
    keys = Idempotency(lambda: 0.0, cast(Journal, kept))

    async def refuse() -> Response:
        raise OperationError("enable it first", kind="latched", remedy="enable it")

    async def act() -> Response:
        raise AssertionError

    first = await keys.run(keyed("k"), b"x", refuse)
    later = Idempotency(lambda: 5.0, cast(Journal, kept), list(kept.rows.values()))
    again = await later.run(keyed("k"), b"x", act)
    assert (again.status_code, again.body) == (409, first.body)
    assert again.media_type == "application/problem+json"


async def test_keys_that_could_not_be_read_at_the_start_are_read_before_the_next_request() -> None:
    kept = KeptKeys()
    first = await Idempotency(lambda: 0.0, cast(Journal, kept)).run(keyed("k"), b"x", enable)
    kept.events.clear()
    kept.cannot_be_read = "it is in use by another program"
    later = Idempotency(lambda: 5.0, cast(Journal, kept), None)

    async def refuse() -> Response:  # as the record of the journal does
        raise OperationError(NOT_KNOWN.get(), kind="journal-failing", remedy="see to its disk")

    async def never() -> Response:
        raise AssertionError

    with pytest.raises(OperationError, match="in use by another program"):
        await later.run(keyed("k"), b"x", refuse)
    assert kept.events == [], "the answer of the run before stays in the file"
    assert (await later.run(keyed("new"), b"y", enable)).status_code == 200
    kept.cannot_be_read = ""
    again = await later.run(keyed("k"), b"x", never)
    assert (again.status_code, again.body) == (200, first.body)
    assert (await later.run(keyed("new"), b"y", never)).status_code == 200
    assert NOT_KNOWN.get() == ""
    with pytest.raises(RefusedRequestError, match="another request"):
        await later.run(keyed("k"), b"z", never)


async def test_a_request_without_a_key_is_not_refused_for_the_one_before_it() -> None:
    """The task of a request has the context of the one before on the same connection."""
    kept = KeptKeys()
    kept.cannot_be_read = "it is in use by another program"
    keys = Idempotency(lambda: 5.0, cast(Journal, kept), None)
    assert (await keys.run(keyed("k"), b"x", enable)).status_code == 200
    seen: list[str] = []

    async def act() -> Response:
        seen.append(NOT_KNOWN.get())
        return await enable()

    await keys.run(Request({"type": "http", "headers": []}), b"x", act)
    assert seen == [""]


async def enable() -> Response:
    return Response('{"outcome": "verified"}', 200, media_type="application/json")


async def test_kept_keys_are_forgotten_with_those_in_memory() -> None:
    now_s, kept = 0.0, KeptKeys()
    keys = Idempotency(lambda: now_s, cast(Journal, kept))

    async def act() -> Response:
        return Response("x")

    for number in range(100):
        await keys.run(keyed(str(number)), b"", act)
    now_s = KEEP_S + 1
    await keys.run(keyed("new"), b"", act)
    assert list(kept.rows) == ["new"]


async def test_a_failing_journal_holds_no_answer_back() -> None:
    kept = KeptKeys()
    kept.fails = True

    async def act() -> Response:
        return Response("x")

    keys = Idempotency(lambda: 0.0, cast(Journal, kept))
    assert (await keys.run(keyed("k"), b"", act)).status_code == 200
    assert (await keys.run(keyed("k"), b"", act)).status_code == 200
