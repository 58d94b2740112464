"""`lecombus scan` as it is called: on a port of its own, and through a daemon."""

from __future__ import annotations

import json
import os
import pty
import resource
import select
import stat
import subprocess
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from cli.test_simulate import simulated
from lecombus.cli import scan, scan_access
from lecombus.cli.arguments import whole_path
from lecombus.config import load_roster, parse_roster
from lecombus.fieldbus.lecom.protocol.controls import bcc
from support.golden import Golden
from support.rosters import roster_text

pytestmark = pytest.mark.clock

NINE = roster_text(
    [
        ("a", 1, "820x"), ("b", 11, "8200vector"), ("c", 12, "93xx"), ("d", 13, "smvector"),
        ("e", 14, "smvector"), ("f", 21, "smvector"), ("g", 57, "generic"), ("h", 58, "generic"),
        ("i", 99, "smvector"),
    ],
    name="hall-3",
)  # fmt: skip
FEW = roster_text([("c", 12, "generic"), ("d", 13, "smvector")], name="hall-3")
ADDRESSES = "1-3,11-15,21,57,58,99"


@pytest.fixture(autouse=True)
def _no_state_of_this_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(scan, "STATE_DIR", tmp_path / "lib")


@contextmanager
def drives(tmp_path: Path, roster: str, *words: str) -> Iterator[str]:
    path, link = tmp_path / "simulated.yaml", tmp_path / "bus"
    path.write_text(roster)
    with simulated("-c", str(path), "--pty", str(link), *words) as (_, port):
        yield port


@pytest.mark.slow
@pytest.mark.real
def test_nine_drives_of_five_families_at_an_unknown_rate_become_a_roster(
    run: Run, tmp_path: Path
) -> None:
    wanted = tmp_path / "scanned.yaml"
    with drives(tmp_path, NINE) as port:
        words = ("--port", port, "--all-bauds", "--addresses", ADDRESSES, "--name", "hall-3")
        ran = run("scan", *words, "-o", str(wanted))
    assert (ran.status, ran.err) == (0, "")
    roster = load_roster(wanted)
    assert (roster.line.port, roster.line.baud) == (port, 19200)
    assert [(one.name, one.address, one.family) for one in roster.drives] == [
        ("drive-1", 1, "820x"),
        ("drive-11", 11, "8200vector"),
        ("drive-12", 12, "93xx"),
        ("drive-13", 13, "smvector"),
        ("drive-14", 14, "smvector"),
        ("drive-21", 21, "smvector"),
        ("drive-57", 57, "generic"),
        ("drive-58", 58, "generic"),
        ("drive-99", 99, "smvector"),
    ]
    assert ran.out.splitlines()[0].split("\t")[:3] == ["1", "19200", "820x"]
    assert run("check", "-c", str(wanted)).status == 0


@pytest.mark.real
def test_the_roster_runs(run: Run, tmp_path: Path, short_dir: Path) -> None:
    wanted = short_dir / "scanned.yaml"
    with drives(tmp_path, FEW) as port:
        words = ("--port", port, "--bauds", "19200", "--addresses", "12-14", "--name")
        assert run("scan", *words, short_dir.name, "-o", str(wanted)).status == 0
        roster = load_roster(wanted)
        assert roster.api.socket.endswith(f"{short_dir.name}.sock")
        assert roster.state == str(wanted.resolve().with_name(f"{short_dir.name}.state.json"))
        with subprocess.Popen(
            [sys.executable, "-m", "lecombus", "run", "-c", str(wanted), "--log-format", "json"],
            stderr=subprocess.PIPE,
            text=True,
        ) as running:
            assert running.stderr is not None
            events = []
            for line in running.stderr:
                events.append(json.loads(line))
                if events[-1]["event"] == "ready":
                    break
            running.kill()
    online = {one["drive"] for one in events if one.get("to") == "online"}
    assert events[-1]["event"] == "ready", events
    assert online <= {"drive-12", "drive-13"}
    assert {one["level"] for one in events} <= {"info", "warning"}


def test_the_roster_goes_to_standard_output_and_a_pipe_stays_quiet(
    run: Run, tmp_path: Path
) -> None:
    with drives(tmp_path, FEW) as port:
        ran = run("scan", "--port", port, "--bauds", "19200", "--addresses", "13")
    assert (ran.status, ran.err) == (0, "")
    (tmp_path / "piped.yaml").write_text(ran.out)
    assert [one.family for one in load_roster(tmp_path / "piped.yaml").drives] == ["smvector"]


def test_with_json_everything_stands_in_one_document(run: Run, tmp_path: Path) -> None:
    with drives(tmp_path, FEW) as port:
        ran = run("scan", "--port", port, "--bauds", "19200", "--addresses", "13", "--json")
    found = json.loads(ran.out)
    assert (ran.status, found["port"], found["baud"], found["unclear"]) == (0, port, 19200, [])
    (drive,) = found["drives"]
    assert (drive["drive"], drive["family"], drive["certain"]) == ("drive-13", "smvector", True)
    assert drive["says"]["C1494"] == "1.20"
    assert drive["watchdog"] == {"time_s": 0.05, "action": "none"}
    assert found["roster"].startswith("# What `lecombus scan` found.")


@pytest.mark.real
@pytest.mark.parametrize("words", [("12-13",), ("12",)])
def test_two_drives_at_one_address_of_which_one_answers_later_are_remarked(
    run: Run, tmp_path: Path, words: tuple[str, ...]
) -> None:
    with drives(tmp_path, FEW, "--faults", "twins=12") as port:
        ran = run("scan", "--port", port, "--bauds", "19200", "--addresses", *words, "--json")
    remarks = {one["address"]: one["remarks"] for one in json.loads(ran.out)["drives"]}
    said = [text for text in remarks.pop(12) if text.startswith("two drives at address 12?")]
    assert not [text for texts in remarks.values() for text in texts if "two drives" in text]
    assert ran.status == 0
    # Where the second answers are late on a busy computer it is not certain whose they are.
    assert bool(said) is ("two drives at one address" not in ran.err)


@pytest.mark.real
def test_a_line_that_doubles_every_answer_is_not_called_two_drives(
    run: Run, tmp_path: Path
) -> None:
    with drives(tmp_path, FEW, "--faults", "double=1:0.1s") as port:
        ran = run("scan", "--port", port, "--bauds", "19200", "--addresses", "12-13", "--json")
    said = [text for one in json.loads(ran.out)["drives"] for text in one["remarks"]]
    assert not [text for text in said if "two drives" in text]
    assert "answers came that nobody asked for, behind those of address 12, 13: two" in ran.err


# ---- lines that give nothing --------------------------------------------------------------------


def test_no_drive_is_said_with_what_to_look_at(run: Run, tmp_path: Path) -> None:
    with drives(tmp_path, FEW) as port:
        ran = run("scan", "--port", port, "--addresses", "11-12")
    assert (ran.status, ran.out) == (1, "")
    assert "no drive answers at 9600 baud: not one byte came back; try --all-bauds" in ran.err


def test_another_program_that_takes_the_bytes_is_named(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who else has a port open is found out in tests/line/test_devices.py."""
    monkeypatch.setattr("lecombus.line.devices.holders", lambda path: {12: "cat (pid 12)"})
    with drives(tmp_path, FEW) as port:
        ran = run("scan", "--port", port, "--addresses", "11-12")
    assert (ran.status, ran.out) == (1, "")
    assert f"no drive answers: cat (pid 12) has {port} open too and takes bytes" in ran.err
    assert "end it" in ran.err


def test_an_echo_is_told_from_silence(run: Run, tmp_path: Path) -> None:
    with drives(tmp_path, FEW, "--faults", "echo") as port:
        ran = run("scan", "--port", port, "--bauds", "19200", "--addresses", "17-18")
        assert (ran.status, ran.out) == (1, "")
        assert "what is sent comes back" in ran.err
        found = run("scan", "--port", port, "--bauds", "19200", "--addresses", "13")
        assert found.status == 0


@contextmanager
def far_end(act: Callable[[int], None]) -> Iterator[str]:
    """A port at whose other end something is done again and again; gives its path."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    end = threading.Event()

    def work() -> None:
        while not end.wait(0.01):
            act(master)

    worker = threading.Thread(target=work)
    worker.start()
    try:
        yield os.ttyname(slave)
    finally:
        end.set()
        worker.join()
        os.close(slave)
        os.close(master)


def test_another_masters_line_is_not_spoken_on(run: Run) -> None:
    def ask_for_12(master: int) -> None:
        os.write(master, bytes.fromhex("84 b1 b2 b0 3f 05"))

    with far_end(ask_for_12) as port:
        ran = run("scan", "--port", port, "--addresses", "11")
    assert (ran.status, ran.out) == (1, "")
    assert "another master speaks on this line" in ran.err


def test_a_device_server_that_frames_7e1_is_told_from_a_silent_line(run: Run) -> None:
    def answer(master: int) -> None:
        if select.select([master], [], [], 0)[0]:
            field = bytes(byte & 0x7F for byte in os.read(master, 64))[3:5]
            body = field + b"0\x03"
            os.write(master, b"\x02" + body + bytes((bcc(body),)))

    with far_end(answer) as port:
        ran = run("scan", "--port", port, "--addresses", "11-12")
        assert (ran.status, ran.out) == (1, "")
        assert "no character has the parity expected: the port frames 7E1 itself; try" in ran.err
        assert "--parity port" in ran.err


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["--port", "/dev/no-such-port"], 1),
        (["--port", "/dev/x", "--bauds", "9601"], 2),
        (["--port", "/dev/x", "--addresses", "10,20"], 2),
        (["--port", "/dev/x", "--addresses", "x"], 2),
        (["--port", "/dev/x", "--addresses", "1-99999999999"], 1),
        (["--port", "/dev/x", "--name", "hall 3"], 2),
        (["--port", "COM1"], 2),
        (["--port", "/dev/x", "--url", "http://127.0.0.1:1"], 2),
        (["--port", "/dev/x", "-o", "/no/such/place.yaml"], 2),
        (["--all-bauds"], 2),
        (["--port", "/dev/x", "--all-bauds", "--bauds", "9600"], 2),
        ([], 3),
    ],
)
def test_what_cannot_be_is_said(run: Run, words: list[str], status: int, golden: Golden) -> None:
    ran = run("scan", *words)
    assert (ran.status, ran.out) == (status, "")
    golden(ran.err.partition("; is the adapter")[0])  # which are there, each machine says


@pytest.mark.parametrize("words", [["--parity", "port"], ["--direction", "rts"], ["--name", "x"]])
def test_an_option_of_the_port_is_refused_where_a_daemon_scans(run: Run, words: list[str]) -> None:
    ran = run("scan", *words)
    assert (ran.status, ran.out) == (2, "")
    assert f"without --port, {words[0]} would do nothing" in ran.err


def test_a_file_is_overwritten_only_when_told_to(run: Run, tmp_path: Path) -> None:
    wanted = tmp_path / "kept.yaml"
    wanted.write_text("mine")
    wanted.chmod(0o640)
    with drives(tmp_path, FEW) as port:
        words = ("scan", "--port", port, "--bauds", "19200", "--addresses", "13", "-o", str(wanted))
        ran = run(*words)
        assert (ran.status, wanted.read_text()) == (2, "mine")
        assert "exists; name another file, or overwrite it with --force" in ran.err
        assert run(*words, "--force").status == 0
    assert load_roster(wanted).drives[0].address == 13
    assert stat.S_IMODE(wanted.stat().st_mode) == 0o640


def only_so_large() -> None:
    """Let no file grow, as on a full disk; pipes are none."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300))


def test_a_full_disk_spoils_no_roster_and_hides_nothing_that_was_found(tmp_path: Path) -> None:
    old, other = tmp_path / "kept.yaml", tmp_path / "other.yaml"
    old.write_text("mine")
    with drives(tmp_path, FEW) as port:
        scanned = ("scan", "--port", port, "--bauds", "19200", "--addresses", "12,13")
        for wanted, more in ((old, ("--force", "--json")), (other, ())):
            command = [sys.executable, "-m", "lecombus", *scanned, "-o", str(wanted), *more]
            ran = subprocess.run(
                command, capture_output=True, text=True, timeout=60, preexec_fn=only_so_large
            )
            assert ran.returncode == 1
            assert f"{wanted}: file too large" in ran.stderr
            roster = json.loads(ran.stdout)["roster"] if more else ran.stdout
            assert [one.address for one in parse_roster(roster, "shown").drives] == [12, 13]
    assert old.read_text() == "mine"
    assert [one.name for one in tmp_path.glob(".*.new")] == []
    assert not other.exists()


# ---- through a daemon ---------------------------------------------------------------------------


def test_a_daemon_is_asked_only_for_addresses_that_its_roster_does_not_have(
    run: Run, daemon: DaemonStub
) -> None:
    line = {"line": "hall-3", "port": "/dev/x", "baud": 19200}
    daemon.answers["GET /v1/line"] = (200, json.dumps(line))
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": [{"address": 11}]}))
    silence = {"heard": "silence", "raw": None, "received": None, "disturbances": 0}
    for code in ("C0248", "C0249"):
        for address in (11, 12, 13):
            path = f"/v1/line/addresses/{address}/codes/{code}"
            query = "addressing=standard&family=generic&patient=false"
            daemon.answers[f"GET {path}?{query}"] = (200, json.dumps(silence))
    ran = run("scan", "--addresses", "11-13")
    assert (ran.status, ran.out) == (1, "")
    assert "at an address that the roster does not have, at 19200 baud" in ran.err
    asked = [what.split()[1].partition("?")[0] for what, _ in daemon.asked]
    assert asked[2:4] == [
        "/v1/line/addresses/12/codes/C0248",
        "/v1/line/addresses/13/codes/C0249",
    ]


class InTurn(dict[str, tuple[int, str | None]]):
    """Answers that change: each but the last of a list is given once."""

    def __init__(self, lists: dict[str, list[tuple[int, str | None]]]) -> None:
        super().__init__()
        self._lists = lists

    def get(self, asked: str, default: Any = None) -> Any:
        """Return the next answer to what is asked."""
        answers = self._lists.get(asked)
        if answers is None:
            return default
        return answers.pop(0) if len(answers) > 1 else answers[0]


@pytest.mark.parametrize("is_opened", [True, False], ids=["opened again", "stays lost"])
def test_a_port_that_the_daemon_opens_again_as_no_drive_answers_ends_no_scan(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, is_opened: bool
) -> None:
    monkeypatch.setattr(scan_access, "REOPENED_WITHIN_S", 0.3)
    why = "no drive answers: cat (pid 7) has /dev/x open too"
    line = {"line": "hall-3", "port": "/dev/x", "baud": 9600, "remarks": {"silence": why}}
    lost = (200, json.dumps({**line, "state": "lost"}))
    is_open = (200, json.dumps({**line, "state": "open"}))
    silence = {"heard": "silence", "raw": None, "received": None, "disturbances": 0}
    nothing = (200, json.dumps(silence))
    gone = (503, json.dumps({"type": "urn:lecombus:problem:line-lost", "status": 503,
                             "title": "Line lost", "detail": "no byte for 30 s"}))  # fmt: skip
    path = "GET /v1/line/addresses/12/codes/{}?addressing=standard&family=generic&patient=false"
    daemon.answers = InTurn({
        "GET /v1/line": [is_open, lost, is_open] if is_opened else [is_open, lost],
        "GET /v1/drives": [(200, json.dumps({"drives": []}))],
        path.format("C0248"): [gone, nothing],
        path.format("C0249"): [gone, nothing],
    })  # fmt: skip
    ran = run("scan", "--addresses", "12")
    assert (ran.status, ran.out) == (1, "")
    assert (why in ran.err) == is_opened
    assert ("no byte for 30 s" in ran.err) != is_opened


def test_an_older_daemon_is_told_from_a_line_without_drives(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/line"] = (200, json.dumps({"line": "hall-3"}))
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": []}))
    ran = run("scan")
    assert ran.status == 3
    assert "cannot scan" in ran.err


def test_a_device_may_be_named_from_the_folder_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "line").touch()
    monkeypatch.chdir(tmp_path)
    assert whole_path(None, None, "line") == str(tmp_path / "line")  # type: ignore[arg-type]
    for other in ("socket://127.0.0.1:1", "COM1", None):
        assert whole_path(None, None, other) == other  # type: ignore[arg-type]
