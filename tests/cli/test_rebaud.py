"""`lecombus rebaud` as it is called: refusals, endings, and once through a real pseudo terminal."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import pty
import signal
import socket
import termios
import tty
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from cli.conftest import Run
from cli.test_simulate import simulated
from lecombus.cli import main, rebaud
from lecombus.cli.rebaud_access import carry_out
from lecombus.config import Roster, parse_roster
from lecombus.errors import LineLostError
from lecombus.fieldbus.lecom.rebaud import LineAccess, Subject
from lecombus.line.event_loop import run as run_loop
from support.golden import Golden
from support.rebauding import RebaudLine, Step, Write
from support.rosters import roster_text

pytestmark = pytest.mark.clock

DRIVES = [("feeder", 11, "8200vector"), ("belt", 12, "smvector")]


@pytest.fixture(autouse=True)
def _hang_up_is_not_ignored() -> Iterator[None]:
    """As it is under nohup."""
    old = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, old)


@pytest.fixture
def roster(short_dir: Path) -> Path:
    path = short_dir / "bench.yaml"
    path.write_text(
        roster_text(DRIVES, name="bench", port=short_dir / "bus", baud=None, folder=short_dir)
    )
    return path


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> RebaudLine:
    """Simulated drives in computed time in the place of the port."""
    drives = RebaudLine(DRIVES)

    def instead(
        _: object, procedure: Callable[[LineAccess], Awaitable[None]], roster: Roster,
        subjects: tuple[Subject, ...],
        interrupt: Callable[[], None], watch: Callable[[], None],
    ) -> None:  # fmt: skip
        drives.subjects = {one.name: one for one in subjects}
        drives.run(procedure)
        watch()

    monkeypatch.setattr(rebaud, "run", instead)
    return drives


# ---- refused before a telegram ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("", ""), ("9600",)),
        (("", ""), ("19200", "--from", "19200")),
        (("", ""), ("9601",)),
        (("/", "socket://192.0.2.7:4001#"), ("19200",)),
        (("8200vector", "generic"), ("19200",)),
    ],
)
def test_what_cannot_be_done_is_refused_with_what_can(
    run: Run, roster: Path, change: tuple[str, str], words: tuple[str, ...], golden: Golden
) -> None:
    text = roster.read_text()
    if change[0] == "/":
        text = text.replace(str(roster.parent / "bus"), "socket://192.0.2.7:4001")
    elif change[0]:
        text = text.replace(*change)
    roster.write_text(text)
    ran = run("rebaud", *words, "-c", str(roster), "--yes")
    assert ran.status == 2
    golden(ran.err)


def test_a_rate_at_which_the_watchdogs_cannot_be_fed_is_refused_beforehand(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    watchdog = "smvector, watchdog: {time: 450ms, action: inhibit}"
    roster.write_text(roster.read_text().replace("smvector", watchdog))
    ran = run("rebaud", "1200", "-c", str(roster), "--yes")
    assert ran.status == 2
    assert "belt: a watchdog of 450ms cannot be held at 1200 baud" in ran.err
    assert line.steps == []
    assert run("rebaud", "19200", "-c", str(roster), "--yes").status == 0


def test_a_running_daemon_is_named_and_must_be_stopped(run: Run, roster: Path) -> None:
    with socket.socket(socket.AF_UNIX) as served:
        served.bind(str(roster.parent / "api.sock"))
        served.listen()
        ran = run("rebaud", "19200", "-c", str(roster), "--yes")
    assert ran.status == 1
    assert "a daemon of line bench runs" in ran.err
    assert "stop it first" in ran.err


def test_a_port_that_is_in_use_is_refused(run: Run, roster: Path) -> None:
    bus = roster.parent / "bus"
    with simulated("-c", str(roster), "--pty", str(bus)):
        held = os.open(bus, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(held, termios.TIOCEXCL)
        fcntl.flock(held, fcntl.LOCK_EX)
        try:
            ran = run("rebaud", "19200", "-c", str(roster), "--yes")
        finally:
            os.close(held)
    assert ran.status == 1
    assert str(bus) in ran.err


# ---- how it ends --------------------------------------------------------------------------------


HELD = "in quick stop, output frequency 0; whether its motor still turns it does not measure"


def test_a_dry_run_shows_the_plan_and_writes_nothing(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    ran = run("rebaud", "19200", "-c", str(roster), "--dry-run")
    assert ran.status == 0
    assert [one.split("\t") for one in ran.out.splitlines()] == [
        ["feeder", "11", "8200vector", "9600 baud", "C0125 = 4", HELD, ""],
        ["belt", "12", "smvector", "9600 baud", "P411 = 4", HELD, ""],
    ]
    planned = json.loads(run("rebaud", "19200", "-c", str(roster), "--dry-run", "--json").out)
    assert planned["ending"] == "planned"
    assert [one["motion"] for one in planned["drives"]] == [HELD, HELD]
    assert not [one for one in line.steps if isinstance(one, Write)]


def test_nobody_is_written_to_unasked(
    run: Run, roster: Path, line: RebaudLine, golden: Golden
) -> None:
    ran = run("rebaud", "19200", "-c", str(roster))
    assert ran.status == 2
    golden(ran.err)
    assert not [one for one in line.steps if isinstance(one, Write)]


def test_the_line_to_write_into_the_roster_is_shown(
    run: Run, roster: Path, line: RebaudLine, golden: Golden
) -> None:
    before = roster.read_text()
    ran = run("rebaud", "19200", "-c", str(roster), "--yes")
    assert (ran.status, ran.err) == (0, "")
    golden(ran.out.splitlines()[-1])
    assert roster.read_text() == before
    assert line.rates == {"feeder": 19200, "belt": 19200}


def test_what_stands_against_it_is_named_for_people_and_programs(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    line["belt"].present = False
    (roster.parent / "state.json").write_text(
        json.dumps({"version": 1, "drives": {"feeder": {"identity": {"C1810": "OTHER"}}}})
    )
    ran = run("rebaud", "19200", "-c", str(roster), "--yes", "--json")
    assert (ran.status, ran.out) == (1, "")
    problems: list[Any] = [json.loads(one) for one in ran.err.splitlines()]
    assert [(one["drive"], one["kind"]) for one in problems] == [
        ("feeder", "swapped"),
        ("belt", "no-answer"),
    ]


def test_a_state_file_that_cannot_be_read_is_no_permission(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    (roster.parent / "state.json").write_text("{")
    ran = run("rebaud", "19200", "-c", str(roster), "--yes")
    assert ran.status == 1
    assert "state.json" in ran.err
    assert line.steps == []


@pytest.mark.parametrize(("words", "ending"), [((), "mixed"), (("--back",), "unchanged")])
def test_a_drive_that_refuses_splits_the_line_or_all_go_back(
    run: Run, roster: Path, line: RebaudLine, words: tuple[str, ...], ending: str
) -> None:
    def before(step: Step) -> None:
        refused = isinstance(step, Write) and step.drive == "belt"
        line.line.faults.nak = 1.0 if refused else 0.0

    line.before = before
    ran = run("rebaud", "19200", "-c", str(roster), "--yes", "--json", *words)
    document = json.loads(ran.out)
    assert (ran.status, document["ending"]) == (1, ending)
    rates = {one["drive"]: one["baud"] for one in document["drives"]}
    assert rates == line.rates
    assert rates["feeder"] == (9600 if words else 19200)
    assert any("rebaud 9600 --from 19200" in one for one in document["remedies"]) is not bool(words)


def test_drives_are_fetched_from_another_rate_than_the_rosters(
    run: Run, roster: Path, line: RebaudLine, golden: Golden
) -> None:
    line["feeder"].model.params.set(125, "4")
    ran = run("rebaud", "9600", "--from", "19200", "-c", str(roster), "--yes")
    assert ran.status == 0
    assert line.rates == {"feeder": 9600, "belt": 9600}
    golden(ran.out.splitlines()[-1])


def test_a_lost_port_ends_it_with_where_everybody_is(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    def before(step: Step) -> None:
        if isinstance(step, Write) and step.drive == "belt":
            raise LineLostError("the port is gone", line="bench")

    line.before = before
    ran = run("rebaud", "19200", "-c", str(roster), "--yes")
    assert ran.status == 1
    assert "ended early: " in ran.err
    assert "feeder\t11\tat 19200 baud\t" in ran.out
    assert "belt\t12\tat 9600 or 19200 baud: a write ended" in ran.out


def test_json_names_no_rate_of_a_drive_that_was_not_seen_since_a_write(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    def before(step: Step) -> None:
        if isinstance(step, Write) and step.drive == "belt":
            raise LineLostError("the port is gone", line="bench")

    line.before = before
    ran = run("rebaud", "19200", "-c", str(roster), "--yes", "--json")
    places = [(one["place"], one["baud"]) for one in json.loads(ran.out)["drives"]]
    assert places == [("new", 19200), ("written", None)]


# ---- the port -----------------------------------------------------------------------------------


@pytest.fixture
def terminal() -> Iterator[str]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield name
    os.close(master)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_interrupts_and_lets_the_step_end(
    roster: Path, terminal: str, number: signal.Signals
) -> None:
    read = parse_roster(roster.read_text().replace(str(roster.parent / "bus"), terminal), "r")
    noted: list[str] = []

    async def procedure(line: LineAccess) -> None:
        os.kill(os.getpid(), number)
        await line.wait(9600, 0.3)
        noted.append("ended")

    run_loop(carry_out, procedure, read, (), lambda: noted.append("interrupted"), lambda: None)
    assert noted == ["interrupted", "ended"]


def test_a_hangup_that_the_user_keeps_away_interrupts_nothing(
    roster: Path, terminal: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = parse_roster(roster.read_text().replace(str(roster.parent / "bus"), terminal), "r")
    noted: list[str] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does

    async def procedure(line: LineAccess) -> None:
        os.kill(os.getpid(), signal.SIGHUP)
        await line.wait(9600, 0.3)

    try:
        run_loop(carry_out, procedure, read, (), lambda: noted.append("interrupted"), lambda: None)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert noted == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_at_the_question_behind_a_split_line_still_shows_where_the_drives_are(
    run: Run, roster: Path, line: RebaudLine, monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
) -> None:  # fmt: skip
    def before(step: Step) -> None:
        refused = isinstance(step, Write) and step.drive == "belt"
        line.line.faults.nak = 1.0 if refused else 0.0

    def asked(question: str) -> bool:
        if question.startswith("Not every drive"):
            os.kill(os.getpid(), number)
        return True

    line.before = before
    monkeypatch.setattr(rebaud, "can_ask", lambda: True)
    monkeypatch.setattr(rebaud, "make_sure", lambda question, as_json: None)
    monkeypatch.setattr("click.confirm", asked)
    ran = run("rebaud", "19200", "-c", str(roster))
    assert ran.status == 1
    assert "feeder\t11\tat 19200 baud\t" in ran.out


def test_the_report_reaches_a_file_when_the_terminal_is_gone(
    roster: Path, line: RebaudLine, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    master, slave = pty.openpty()

    def before(step: Step) -> None:
        nonlocal master
        if isinstance(step, Write) and master >= 0:
            os.close(master)
            master = -1

    line.before = before
    kept = os.dup(2)
    os.dup2(slave, 2)
    os.close(slave)
    try:
        status = main(["rebaud", "19200", "-c", str(roster), "--yes"])
    finally:
        os.dup2(kept, 2)
        os.close(kept)
    assert (status, master) == (0, -1)
    assert "feeder\t11\tat 19200 baud\t" in capfd.readouterr().out


def test_a_port_lost_before_the_first_write_says_that_nothing_was_written(
    run: Run, roster: Path, line: RebaudLine
) -> None:
    def before(step: Step) -> None:
        raise LineLostError("the port is gone", line="bench")

    line.before = before
    ran = run("rebaud", "19200", "-c", str(roster), "--yes")
    assert ran.status == 1
    assert "the port is gone; nothing was written" in ran.err


@pytest.mark.parametrize("error", [PermissionError, serial.SerialException])
def test_a_port_that_may_not_be_opened_is_a_matter_of_permission(
    run: Run, roster: Path, line: RebaudLine, error: type[OSError]
) -> None:
    """Of a serial port it is pyserial's own error, which only has the number."""

    def before(step: Step) -> None:
        lost = LineLostError("no permission for the port", line="bench")
        raise lost from error(errno.EACCES, "Permission denied")

    line.before = before
    assert run("rebaud", "19200", "-c", str(roster), "--dry-run").status == 4


@pytest.mark.real
def test_on_a_pseudo_terminal_there_and_back(run: Run, roster: Path) -> None:
    with simulated("-c", str(roster), "--pty", str(roster.parent / "bus")) as (_, port):
        there = run("rebaud", "19200", "-c", str(roster), "--yes", "--json")
        assert (there.status, there.err) == (0, "")
        found = {one["drive"]: one["baud"] for one in json.loads(there.out)["drives"]}
        assert found == {"feeder": 19200, "belt": 19200}
        words = ("--port", port, "--baud", "19200", "--address", "12", "C1411", "--json")
        assert json.loads(run("read", *words).out)["raw"] == "4"
        back = run("rebaud", "9600", "--from", "19200", "-c", str(roster), "--yes")
        assert back.status == 0
        assert run("read", "--port", port, "--address", "12", "C1411").status == 0
