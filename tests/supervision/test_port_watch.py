"""That a line is silent as a whole, or its port read by another program, is said once and first."""

from __future__ import annotations

import pytest

from lecombus.config import LineEntry
from lecombus.drive_state.readings import LineState
from lecombus.drive_state.store import Store
from lecombus.supervision.port_watch import LONGEST_PAUSE_S, SILENCE, PortWatch

CAT = ("cat (pid 12)",)


class Line:
    """A watch, and what its line is like."""

    def __init__(self, port: str = "/dev/ttyUSB0") -> None:
        self.now_s = 100.0
        self.failures = 0
        self.is_open, self.silent, self.heard = True, False, False
        self.store = Store(lambda: self.now_s, lambda: 1e9)
        self.store.line_state(LineState.OPEN)
        self.watch = PortWatch(self.store, LineEntry(name="l", port=port))

    def second(self, others: tuple[str, ...] = (), *, failed: int = 0) -> bool:
        """Let a second pass; whether it was looked who else has the port open."""
        self.now_s += 1.0
        self.failures += failed
        looks = self.watch.note(
            self.failures, self.now_s, is_open=self.is_open, silent=self.silent, heard=self.heard
        )
        if looks:
            self.watch.found(others)
        return looks

    @property
    def remark(self) -> str:
        return self.store.line().remarks.get(SILENCE, "")


def events(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [one.split("event=")[1].split()[0] for one in caplog.messages]


def test_a_silent_line_is_told_once_with_what_to_check(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    line = Line()
    assert line.second(), "a port that was opened just now is looked at"
    assert not line.remark
    line.silent = True
    assert line.second(failed=3)
    assert "no drive answers: check the baud rate (9600 here" in line.remark
    assert "A and B" in line.remark
    for _ in range(100):
        line.second(failed=5)
    assert events(caplog) == ["line-silent"]
    line.silent, line.heard = False, True
    line.second()
    assert not line.remark
    assert events(caplog) == ["line-silent", "line-heard"]


def test_another_program_is_named_and_no_longer_when_it_is_gone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    line = Line()
    line.heard = True
    line.second()
    assert not line.second(CAT, failed=2), "two failures are no reason to look"
    for _ in range(5):
        line.second(CAT, failed=1)
    assert line.remark.startswith("cat (pid 12) has /dev/ttyUSB0 open too and takes bytes")
    line.silent = True
    line.second(CAT)
    assert line.remark.startswith("no drive answers: cat (pid 12) has /dev/ttyUSB0 open too")
    line.silent = False
    for _ in range(6):
        line.second()
    assert not line.remark
    assert events(caplog) == ["port-shared", "line-silent", "line-heard"]


def test_drives_have_time_to_be_heard_when_the_other_program_has_ended(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    line = Line()
    line.heard = True
    line.second()
    for _ in range(20):
        line.silent = True
        line.second(CAT, failed=3)
    for _ in range(5):  # each drive is asked again, one after the other
        line.second(failed=3)
    line.silent = False
    line.second()
    assert events(caplog) == ["line-silent", "line-heard"], "the baud rate was right"
    line.silent = True
    for _ in range(12):
        line.second(failed=3)
    assert "check the baud rate" in line.remark


def test_a_program_that_had_the_port_before_it_was_opened_is_the_first_thing_said() -> None:
    line = Line()
    line.second(CAT)
    assert "cat (pid 12)" in line.remark


def test_a_port_that_is_opened_again_and_again_is_told_silent_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    line = Line()
    for _ in range(5):
        line.is_open, line.silent = False, False
        line.second(failed=1)
        assert not line.remark
        line.is_open = True
        line.second(failed=1)
        line.silent = True
        line.second(failed=1)
        assert line.remark
    assert events(caplog) == ["line-silent"]


def test_one_drive_that_is_away_for_days_has_the_port_looked_at_ever_more_seldom() -> None:
    line = Line()
    line.heard = True
    looks = sum(line.second(failed=1) for _ in range(3600))
    assert 8 <= looks <= 8 + 3600 / LONGEST_PAUSE_S


def test_a_burst_of_failures_is_looked_into_soon_though_a_drive_was_away_for_days() -> None:
    line = Line()
    line.heard = True
    for _ in range(3600):
        line.second(failed=1)
    looked = [line.second(CAT, failed=4) for _ in range(6)]
    assert any(looked)


def test_of_a_device_server_its_own_settings_are_to_be_checked() -> None:
    line = Line("socket://10.0.0.5:4001")
    line.silent = True
    line.second()
    assert "the device server's baud rate and framing (9600, 8N1)" in line.remark
