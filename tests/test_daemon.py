"""What the daemon says of itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from lecombus.api.server import Served
from lecombus.daemon import tell_goodbye
from lecombus.drives import StopAction
from lecombus.operations.operation_reports import GroupReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome


@pytest.mark.parametrize(
    ("http", "written"),
    [
        (("127.0.0.1", 9740), "127.0.0.1:9740"),
        (("localhost", 80), "localhost:80"),
        (("::1", 9740), "[::1]:9740"),
        (("[::1]", 9740), "[::1]:9740"),
        (None, "none"),
    ],
)
def test_where_http_is_served_is_written_as_one_would_type_it(
    http: tuple[str, int] | None, written: str
) -> None:
    assert Served(Path("/run/api.sock"), http).address == written


@pytest.mark.parametrize(
    ("outcomes", "level", "told"),
    [
        ([Outcome.VERIFIED, Outcome.DONE], "INFO", "outcome=done"),
        ([Outcome.VERIFIED, Outcome.UNKNOWN], "ERROR", "outcome=unknown not-stopped=b"),
        ([Outcome.REFUSED, Outcome.REFUSED], "ERROR", "outcome=refused not-stopped=a,b"),
    ],
)
def test_a_drive_that_may_run_on_after_the_end_is_an_error_with_its_name(
    outcomes: list[Outcome], level: str, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    members = tuple(
        WriteReport(name, Code(40), outcome) for name, outcome in zip("ab", outcomes, strict=True)
    )
    with caplog.at_level("INFO"):
        tell_goodbye(
            StopAction.INHIBIT, GroupReport("all", "one-by-one", members[-1].outcome, members)
        )
    (record,) = caplog.records
    assert record.levelname == level
    assert record.getMessage() == f"event=shutdown-stop action=inhibit {told}"
