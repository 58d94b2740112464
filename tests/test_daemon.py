"""What the daemon says of itself."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from lecombus.api.server import Served
from lecombus.daemon import PING, Notifier, log_last_stop
from lecombus.drives import StopAction
from lecombus.operations.operation_reports import GroupReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome

pytestmark = pytest.mark.clock


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


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's end; nothing reads it but the test."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(tmp_path / "notify"))
        end.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield end


def read(end: socket.socket) -> list[str]:
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(end.recv(4096).decode())
    return found


def test_a_service_manager_that_does_not_read_holds_nothing_up(manager: socket.socket) -> None:
    """Its queue takes ten datagrams here, and some hundred under systemd."""
    notifier = Notifier()
    most = int(Path("/proc/sys/net/unix/max_dgram_qlen").read_text()) + 1
    waits = threading.Timer(20, lambda: read(manager))  # else this would hang for ever
    waits.start()
    try:
        for _ in range(most + 20):
            notifier.tell(PING)
        notifier.tell("READY=1", "STATUS=open")
        notifier.tell(PING)
        notifier.tell("RELOADING=1")
        assert waits.is_alive()
    finally:
        waits.cancel()
    assert set(read(manager)) == {PING}
    notifier.tell(PING)
    assert read(manager) == ["READY=1\nSTATUS=open", "RELOADING=1", PING]
    notifier.tell(PING)
    assert read(manager) == [PING]


def test_what_waits_for_a_service_manager_that_is_gone_is_bounded(
    manager: socket.socket, tmp_path: Path
) -> None:
    notifier = Notifier()
    (tmp_path / "notify").rename(tmp_path / "away")
    for number in range(100):
        notifier.tell(f"STATUS={number}")
    (tmp_path / "away").rename(tmp_path / "notify")
    notifier.tell("STOPPING=1")
    assert read(manager)[-2:] == ["STATUS=99", "STOPPING=1"]


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
        log_last_stop(
            StopAction.INHIBIT, GroupReport("all", "one-by-one", members[-1].outcome, members)
        )
    (record,) = caplog.records
    assert record.levelname == level
    assert record.getMessage() == f"event=shutdown-stop action=inhibit {told}"
