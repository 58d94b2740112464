"""What somebody had done to a drive leaves a trace, and never more than the log can take."""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import Mock

import pytest

from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.operations.actions import (
    ACTOR,
    EACH,
    LINES_PER_S,
    WINDOW_S,
    WINDOWS_LIMIT,
    Actions,
    Actor,
)
from lecombus.operations.facade import Operations
from lecombus.operations.group_writes import GroupWrites
from lecombus.operations.identities import Identities
from lecombus.operations.operation_reports import GroupReport, VerbReport, WriteReport
from lecombus.operations.readdress import Readdress
from lecombus.operations.stop_requests import Stops
from lecombus.operations.verb_operations import Verbs
from lecombus.operations.write_kinds import WriteKinds
from lecombus.operations.writes import Writes
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, with_plant

FREQUENCY, PASSWORD, CONTROL = Code(46), Code(94), Code(135)


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def actions(clock: Clock, caplog: pytest.LogCaptureFixture) -> Actions:
    caplog.set_level(logging.INFO, "lecombus.operations.actions")
    return Actions(clock)


@pytest.fixture(autouse=True)
def somebody() -> Iterator[None]:
    token = ACTOR.set(Actor("socket", 1000, os.getpid()))
    yield
    ACTOR.reset(token)


class Drives:
    """Operations that end as a test says."""

    def __init__(self, outcome: Outcome = Outcome.DONE, error: OperationError | None = None):
        self.outcome, self.error = outcome, error

    def _end(self) -> Outcome:
        if self.error is not None:
            raise self.error
        return self.outcome

    async def write(self, drive: str, code: Code, value: Any, **how: Any) -> WriteReport:
        return WriteReport(drive, code, self._end(), "it says so")

    async def write_group(self, group: str, code: Code, value: Any, **how: Any) -> GroupReport:
        return await self.stop(StopAction.INHIBIT, group)

    async def stop(self, action: StopAction, target: str) -> GroupReport:
        members = (
            WriteReport("feeder", FREQUENCY, Outcome.DONE),
            WriteReport("belt", FREQUENCY, self._end()),
        )
        return GroupReport(target, "one-by-one", self.outcome, members, "silence")

    async def verb(self, drive: str, verb: Verb, **how: Any) -> VerbReport:
        return VerbReport(drive, verb, self._end(), written=((FREQUENCY, "35"),))

    async def change(self, drive: str, address: int) -> WriteReport:
        return await self.write(drive, Code(9), address)

    def accept(self, drive: str, shown: object) -> object:
        return self._end()


Recorded = Callable[[Drives], Operations]


@pytest.fixture
def recorded(actions: Actions, monkeypatch: pytest.MonkeyPatch) -> Recorded:
    """The operations of a line, each of which ends as the drives say."""

    def make(drives: Drives) -> Operations:
        parts = {
            Writes: "write", GroupWrites: "write_group", Stops: "stop", Verbs: "verb",
            Identities: "accept", Readdress: "change",
        }  # fmt: skip
        for part, name in parts.items():
            monkeypatch.setattr(part, name, getattr(drives, name))
        monkeypatch.setattr(WriteKinds, "is_secret", lambda kinds, target, code: code == PASSWORD)
        monkeypatch.setattr(
            WriteKinds, "on_the_wire", lambda kinds, target, code, value: str(value)
        )
        line, state = Mock(), Mock(lease_number=0)
        operations = Operations(
            Mock(), Mock(), state, line, Mock(), lambda: 0.0, follow=Mock(), disturbances=Mock()
        )
        operations.actions = actions
        return operations

    return make


async def everything(ops: Operations) -> None:
    await ops.write("feeder", FREQUENCY, 20, expires_s=None, verify=False)
    await ops.write_group("line", FREQUENCY, 20, expires_s=None, verify=False)
    await ops.verb("feeder", Verb.RESET_FAULT)
    await ops.verb("feeder", Verb.QUICK_STOP)
    await ops.stop(StopAction.QUICK_STOP, "line")
    await ops.readdress("feeder", 12)
    ops.accept("feeder", {})


@pytest.mark.anyio
async def test_everything_that_moves_a_drive_leaves_one_event_with_who_it_was(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    await everything(recorded(Drives()))
    events = [re.search("event=([a-z-]+)", text)[1] for text in caplog.messages]  # type: ignore[index]
    assert events == [
        "write", "group-write", "verb", "stop", "stop", "readdress-asked", "accept",
    ]  # fmt: skip
    for text in caplog.messages:
        assert f"who=socket uid=1000 pid={os.getpid()} process=" in text
        assert "outcome=done drive=" in text
    assert "code=C0046 value=20" in caplog.messages[0]
    assert "verb=reset-fault written=C0046:35" in caplog.messages[2]
    assert "drive=line action=quick-stop" in caplog.messages[4]
    levels = {record.levelname for record in caplog.records if "event=stop" in record.message}
    assert levels == {"WARNING"}


@pytest.mark.anyio
async def test_what_was_refused_or_not_done_everywhere_says_so(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    drives = Drives(error=OperationError("who=root may", kind="locked", remedy=""))
    with pytest.raises(OperationError):
        await recorded(drives).write("feeder", FREQUENCY, 1)
    assert "outcome=refused drive=feeder code=C0046 value=1 reason=who:root may" in caplog.text
    await recorded(Drives(Outcome.UNKNOWN)).stop(StopAction.INHIBIT, "all")
    assert "outcome=unknown drive=all action=inhibit how=one-by-one not_done=belt:unknown" in (
        caplog.text
    )


@pytest.mark.anyio
async def test_lecombus_itself_is_named_where_nobody_asked(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    ACTOR.set(Actor())
    await recorded(Drives()).stop(StopAction.INHIBIT, "all")
    assert "event=stop who=lecombus outcome=done drive=all" in caplog.text


@pytest.mark.anyio
async def test_a_password_is_not_shown_nor_is_a_reason_that_may_quote_it(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    drives = Drives(error=OperationError("4711 is too big", kind="bad-value", remedy=""))
    with pytest.raises(OperationError):
        await recorded(drives).write("feeder", PASSWORD, 4711)
    assert "value=***" in caplog.text
    assert "4711" not in caplog.text.replace(str(os.getpid()), "")


@pytest.mark.anyio
async def test_no_text_of_a_client_forges_a_field(
    recorded: Recorded, caplog: pytest.LogCaptureFixture
) -> None:
    odd = 'x" who=root\nevent=stop ' + "y" * 5000
    await recorded(Drives()).write(odd, FREQUENCY, odd)
    assert len(caplog.messages) == 1
    assert caplog.messages[0].count("event=") == caplog.messages[0].count("who=") == 1
    assert len(caplog.messages[0]) < 400


def test_what_is_beyond_the_first_is_told_as_a_sum(
    actions: Actions, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(500):
        actions.log("write", "feeder", "done" if number % 5 else "nak", {"value": str(number)})
    assert len(caplog.messages) == EACH
    clock.now_s = WINDOW_S - 0.1
    actions.look()
    assert len(caplog.messages) == EACH
    clock.now_s = WINDOW_S
    actions.look()
    assert len(caplog.messages) == EACH + 1
    said = caplog.messages[-1]
    assert "what=write count=495 outcomes=done:396,nak:99 drive=feeder last=499" in said
    actions.log("write", "feeder", "done", {})
    assert len(caplog.messages) == EACH + 2, "a window of its own"


def test_a_flood_of_one_hides_neither_another_client_nor_a_stop(
    actions: Actions, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(1000):
        actions.log("write", f"drive-{number % 50}", "done", {})
    assert len(caplog.messages) == LINES_PER_S
    for _ in range(LINES_PER_S * 2):
        actions.log("stop", "all", "verified", {"action": "inhibit"})
    assert sum("event=stop" in text for text in caplog.messages) == EACH


def test_lines_and_memory_are_bounded_whatever_names_are_given(
    actions: Actions, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for second in range(20):
        clock.now_s = float(second)
        before = len(caplog.messages)
        for number in range(2000):
            actions.log("write", f"nobody-{second}-{number}", "refused", {})
        actions.look()
        assert len(caplog.messages) - before <= LINES_PER_S
        assert len(actions._windows) <= WINDOWS_LIMIT + 1


def test_a_process_that_is_gone_or_hidden_is_a_question_mark() -> None:
    assert Actor("socket", 0, 2**22 + 1).fields()["process"] == "?"
    assert Actor("socket", 0, 0).fields()["process"] == "?"
    assert Actor("tcp", client="127.0.0.1:1").fields() == {"who": "tcp", "client": "127.0.0.1:1"}


@pytest.mark.parametrize(
    ("code", "values", "shown"),
    [
        (CONTROL, ["H8", "0x8", "H0008", 8], "H0008"),
        (FREQUENCY, ["020", "20.0", 20], "20"),
        (CONTROL, ["9"], "9"),
    ],
)
def test_a_value_is_logged_as_it_goes_on_the_wire(
    code: Code, values: list[str | int], shown: str, caplog: pytest.LogCaptureFixture
) -> None:
    """However it was written; one that is refused as it was written."""
    caplog.set_level(logging.INFO, "lecombus.operations.actions")

    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        for value in values:
            with contextlib.suppress(OperationError):
                await operations.write("feeder", code, value)
            with contextlib.suppress(OperationError):
                await operations.write_group("all", code, value)

    drives = [("feeder", 11, "8200vector"), ("belt", 12, "821x")]
    with_plant(test, roster_text(drives))
    logged = re.findall(rf"event=(?:group-)?write .*code={code} value=(\S+)", caplog.text)
    assert logged == [shown] * 2 * len(values)
