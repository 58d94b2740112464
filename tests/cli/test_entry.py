"""From words to an exit status: usage errors, Ctrl-C, pipes that close, and what is imported."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import click
import pytest
import serial

import lecombus
from cli.conftest import Run
from lecombus.cli import entry
from lecombus.errors import CodeValueError, LineLostError, OperationError
from support.certificates import Certificates, make_certificates
from support.golden import Golden

pytestmark = pytest.mark.clock

ROSTER = """\
line: {name: hall-3, port: /dev/null-1, baud: 19200}
drives:
  - {name: feeder, address: 11, family: 8200vector}
"""


@pytest.fixture
def roster(tmp_path: Path) -> Path:
    path = tmp_path / "hall-3.yaml"
    path.write_text(ROSTER)
    return path


@pytest.mark.parametrize(
    "words",
    [
        ["frobnicate"],
        ["write", "feeder", "C0046"],
        ["write", "feeder", "C0046", "5", "--verfy"],
        ["write", "feeder", "C0046", "35,4"],
        ["write", "feeder", "C0046", "fast"],
        ["write", "feeder", "C99999", "5"],
        ["write", "feeder", "C0046", "5", "--expires", "2"],
        ["write", "feeder", "C0046", "5", "--expires", "-2s"],
        ["write", "feeder", "C0046", "5", "--expires", "0s"],
        ["write", "feeder", "C0046", "5", "--expires", "0.1ms"],
        ["group", "all", "C0046", "5", "--expires", "2h"],
        ["set-speed", "feeder", "5%", "--expires", "0"],
        ["write", "feeder", "C0046", "1e1"],
        ["write", "feeder", "C0046", "-2.5E-1"],
        ["write", "feeder", "C0046", "1e999999999999999999999"],
        ["read", "feeder"],
        ["read", "feeder", "C1", "--port", "/dev/x", "--address", "1"],
        ["read", "C1", "--port", "/dev/x"],
        ["stop", "--action", "brake"],
        ["simulate", "-c", "x.yaml"],
        ["check", "-c", "/nowhere.yaml"],
    ],
)
def test_a_usage_error_is_one_line_that_says_what_is_right(
    run: Run, words: list[str], golden: Golden
) -> None:
    ran = run(*words)
    assert ran.status == 2
    assert ran.out == ""
    assert ran.err.count("\n") == 1
    golden(ran.err)


def test_no_command_shows_the_help(run: Run) -> None:
    ran = run()
    assert ran.status == 2
    assert "Commands:" in ran.err


@pytest.mark.parametrize("command", ["", *entry.COMMANDS])
def test_every_command_has_help(run: Run, command: str) -> None:
    ran = run(*filter(None, [command, "--help"]))
    assert ran.status == 0
    assert ran.out.startswith(f"Usage: lecombus {command}".rstrip())


def test_the_version_is_told(run: Run) -> None:
    assert run("--version").out.startswith("lecombus 0.")


LONG_RUNNING = {("bridge", "mqtt"), ("bridge", "notify")}
"""Parts of a command that run until they are ended."""


@pytest.mark.parametrize(
    "command", [name for name in entry.COMMANDS if name not in ("demo", "run")]
)
def test_every_command_but_the_long_running_takes_json(command: str) -> None:
    found = entry.lecombus.get_command(click.Context(entry.lecombus), command)
    assert found is not None
    parts = found.commands.values() if isinstance(found, click.Group) else [found]
    for part in parts:
        if (command, part.name) in LONG_RUNNING:
            continue
        assert "--json" in [option for param in part.params for option in param.opts]


def raising(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let `lecombus demo` end with an error."""

    def run_demo(seconds: float | None, http: str) -> int:
        raise error

    module = ModuleType("lecombus.demo")
    module.__dict__["run_demo"] = run_demo
    monkeypatch.setitem(sys.modules, "lecombus.demo", module)


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (LineLostError("the port is gone"), 1, "the port is gone\n"),
        (CodeValueError("no such code"), 2, "no such code\n"),
        (
            OperationError("it waits", kind="offline", remedy="look at it"),
            1,
            "it waits; look at it\n",
        ),
        (PermissionError(13, "Permission denied", "/dev/x"), 4, "/dev/x: permission denied\n"),
        (FileNotFoundError(2, "No such file", "/dev/x"), 2, "/dev/x: no such file\n"),
        (
            FileNotFoundError(2, "No such file", "/dev/pts/1", None, "/x/pty"),
            2,
            "/dev/pts/1 -> /x/pty: no such file\n",
        ),
        (OSError(98, "Address already in use"), 1, "address already in use\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_an_error_becomes_its_status_and_one_line(
    run: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, said: str
) -> None:
    raising(monkeypatch, error)
    ran = run("demo")
    assert (ran.status, ran.out, ran.err.lstrip("\n")) == (status, "", said)


def test_a_port_that_may_not_be_opened_is_not_permitted(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error of the line's room has the system's as its cause, by number."""

    def refuse(device: object) -> None:
        raise serial.SerialException(13, "could not open port /dev/pts/7: Permission denied")

    monkeypatch.setattr("lecombus.line.serial_device.Device.open", refuse)
    ran = run("read", "--port", "/dev/null", "--address", "11", "C0150")
    assert (ran.status, ran.out) == (4, "")
    assert "permission denied; the user needs to be in group" in ran.err
    assert "roster" not in ran.err


@pytest.mark.parametrize("word", ["statsu", "Stop", "setspeed"])
def test_a_misspelt_command_is_told_the_nearest(run: Run, word: str, golden: Golden) -> None:
    ran = run(word)
    assert ran.status == 2
    golden(ran.err)


def test_without_a_roster_nothing_is_said_of_ports_that_need_one(run: Run) -> None:
    ran = run("read", "--port", "nonsense", "--address", "11", "C0150")
    assert ran.err.count("sim:") == 0


def test_a_bug_is_not_hidden(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    raising(monkeypatch, ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        run("demo")


def test_demo_passes_on_how_long_and_where(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[float | None, str]] = []

    def run_demo(seconds: float | None, http: str) -> int:
        given.append((seconds, http))
        return 0

    monkeypatch.setitem(sys.modules, "lecombus.demo", SimpleNamespace(run_demo=run_demo))
    assert run("demo", "--for", "30s", "--http", "127.0.0.1:0").status == 0
    assert given == [(30.0, "127.0.0.1:0")]


def test_run_gives_the_daemons_status_back(
    run: Run, roster: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[tuple[Path, str]] = []

    def run_daemon(path: Path, *, log_format: str) -> int:
        given.append((path, log_format))
        return 1

    monkeypatch.setattr("lecombus.cli.run.set_up_logging", lambda level, style: None)
    monkeypatch.setitem(sys.modules, "lecombus.daemon", SimpleNamespace(run=run_daemon))
    assert run("run", "-c", str(roster), "--log-format", "json").status == 1
    assert given == [(roster, "json")]


def test_check_shows_every_mistake_on_its_own_line(run: Run, roster: Path) -> None:
    roster.write_text(ROSTER.replace("11", "10").replace("19200", "19201"))
    ran = run("check", "-c", str(roster))
    assert ran.status == 2
    assert [line.split(": ")[0] for line in ran.err.splitlines()] == [
        f"{roster}:1:47",
        f"{roster}:3:29",
    ]
    document = json.loads(run("check", "-c", str(roster), "--json").out)
    assert document["ok"] is False
    assert [mistake["line"] for mistake in document["mistakes"]] == [1, 3]


def test_check_describes_a_right_roster(run: Run, roster: Path) -> None:
    ran = run("check", "-c", str(roster))
    assert (ran.status, ran.err) == (0, "")
    rows = [line.split("\t") for line in ran.out.splitlines()]
    assert {row[0]: len(row) for row in rows} == {"line": 3, "drive": 7, "group": 5, "warning": 2}
    assert rows[1][:4] == ["drive", "feeder", "11", "8200vector"]
    document = json.loads(run("check", "-c", str(roster), "--json").out)
    assert document["ok"] is True
    assert document["groups"][0]["name"] == "all"


def test_check_names_codes_on_a_terminal_as_the_keypad_does(
    run: Run, roster: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    roster.write_text(ROSTER.replace("8200vector", "smvector"))
    assert "C1500 1min" in run("check", "-c", str(roster)).out
    monkeypatch.setattr("lecombus.cli.check.on_terminal", lambda: True)
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    shown = run("check", "-c", str(roster)).out
    assert "P500 1min" in shown
    assert "C0150 " in shown


@pytest.fixture
def files(tmp_path: Path) -> Certificates:
    return make_certificates(tmp_path)


def warned(run: Run, roster: Path, sections: str) -> list[str]:
    """The warnings of check beyond those of the bare roster."""
    roster.write_text(ROSTER)
    usual = json.loads(run("check", "-c", str(roster), "--json").out)["warnings"]
    roster.write_text(ROSTER + sections)
    ran = run("check", "-c", str(roster), "--json")
    assert (ran.status, ran.err) == (0, "")
    return [one for one in json.loads(ran.out)["warnings"] if one not in usual]


@pytest.mark.parametrize(
    ("certificate", "key", "said"),
    [
        ("server.pem", "server.key", ""),
        ("gone.pem", "server.key", "gone.pem: there is no such file"),
        ("server.pem", "gone.key", "gone.key: it cannot be read (No such file or directory)"),
        ("server.key", "server.pem", "server.pem: others may read or write it"),
        ("server.pem", "plc.key", "server.pem: it cannot be used with the key"),
        ("server.key", "plc.key", "server.key: it cannot be used with the key"),
    ],
)
def test_check_warns_of_tls_files_that_run_would_refuse(
    run: Run, roster: Path, files: Certificates, certificate: str, key: str, said: str
) -> None:
    tls = f"{{certificate: {files.path(certificate)}, key: {files.path(key)}}}"
    found = warned(run, roster, f"api: {{http: '127.0.0.1:1', tls: {tls}}}")
    assert len(found) == bool(said)
    assert all(f"api.tls: {files.folder}/{said}" in one for one in found)


def test_check_warns_of_tokens_that_would_not_be_used(run: Run, roster: Path) -> None:
    path = roster.parent / "tokens"
    sections = f"api: {{http: '127.0.0.1:1', tokens: {path}}}"
    assert ["there is no such file" in one for one in warned(run, roster, sections)] == [True]
    path.write_text("{")
    path.chmod(0o640)
    assert ["it is no JSON" in one for one in warned(run, roster, sections)] == [True]
    path.write_text('{"version": 1, "tokens": []}')
    assert warned(run, roster, sections) == []
    path.chmod(0o666)
    assert ["others may write it" in one for one in warned(run, roster, sections)] == [True]


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("j.sqlite", ""),
        ("folder", "this is a directory"),
        ("gone/j.sqlite", "there is no directory"),
        ("file/j.sqlite", "file is not a directory"),
        ("/var/lib/lecombus/j.sqlite", ""),
        ("/dev/null", "this is not a regular file"),
    ],
)
def test_check_warns_of_a_journal_that_cannot_be(
    run: Run, roster: Path, place: str, said: str
) -> None:
    (roster.parent / "folder").mkdir()
    (roster.parent / "file").write_text("")
    found = warned(run, roster, f"journal: {roster.parent / place}")
    assert [said in one for one in found] == [True] * bool(said)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("a.sock", ""),
        ("gone/a.sock", "there is no directory"),
        ("file/a.sock", "file is not a directory"),
        ("file", "something else has its place"),
        ("/run/lecombus/hall-3.sock", ""),
        ("a.sock, socket_group: nosuchgroup", "there is no group nosuchgroup"),
    ],
)
def test_check_warns_of_a_socket_with_which_run_would_not_start(
    run: Run, roster: Path, place: str, said: str
) -> None:
    (roster.parent / "file").write_text("")
    found = warned(run, roster, f"api: {{socket: {roster.parent / place}}}")
    assert [said in one and "does not start" in one for one in found] == [True] * bool(said)


@pytest.mark.parametrize(
    ("place", "said"), [("s.json", ""), ("gone/s.json", "there is no directory")]
)
def test_check_warns_of_a_state_file_that_cannot_be(
    run: Run, roster: Path, place: str, said: str
) -> None:
    found = warned(run, roster, f"state: {roster.parent / place}")
    assert [said in one and "nothing is kept" in one for one in found] == [True] * bool(said)


def command_line(*words: str) -> list[str]:
    return [sys.executable, "-m", "lecombus", *words]


def test_a_pipe_that_closes_is_no_error(roster: Path) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "w") as closed:
        done = subprocess.run(
            command_line("check", "-c", str(roster)),
            stdout=closed,
            stderr=subprocess.PIPE,
            timeout=15,
            check=False,
        )
    assert (done.returncode, done.stderr) == (141, b"")


def hearing_ctrl_c() -> None:
    """Before a command starts: these tests may run in the background themselves, deaf to it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def launcher(tmp_path: Path) -> Path:
    """The command as it is installed, beside a Python that has lecombus."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    python.chmod(0o755)
    source = Path(lecombus.__file__).parents[2] / "bin" / "lecombus"
    command = tmp_path / "lecombus"
    command.write_bytes(source.read_bytes())
    command.chmod(0o755)
    return command


@pytest.mark.parametrize("after_ms", range(0, 121, 12))
def test_a_ctrl_c_while_a_command_starts_shows_no_traceback(
    launcher: Path, roster: Path, after_ms: int
) -> None:
    process = subprocess.Popen(
        [launcher, "check", "-c", roster],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=hearing_ctrl_c,
    )
    with process:
        time.sleep(after_ms / 1000)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert said == b""
    assert process.returncode in (-signal.SIGINT, 130, 0)


def test_a_ctrl_c_that_came_before_the_first_line_of_ours_ends_it(launcher: Path) -> None:
    """It was held back, and takes effect when the command can take it."""
    script = launcher.with_name("python")
    script.write_text(f"#!/bin/sh\nkill -INT $$\n{script.read_text().splitlines()[1]}\n")
    ran = subprocess.run(
        [launcher, "--version"],
        capture_output=True,
        timeout=30,
        check=False,
        preexec_fn=hearing_ctrl_c,
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (-signal.SIGINT, b"", b"")


def test_a_job_that_was_started_deaf_to_ctrl_c_stays_so(launcher: Path) -> None:
    script = f"trap '' INT; exec {shlex.quote(str(launcher))} --version"
    look = launcher.with_name("python")
    text = look.read_text().splitlines()[1]
    look.write_text(f"#!/bin/sh\nkill -INT $$\n{text}\n")
    ran = subprocess.run(["sh", "-c", script], capture_output=True, timeout=30, check=False)
    assert (ran.returncode, ran.stderr) == (0, b"")


def test_the_command_is_started_with_the_python_beside_it_and_its_own_name(launcher: Path) -> None:
    link = launcher.with_name("linked")
    link.symlink_to(launcher)
    ran = subprocess.run(
        [link, "--version"], capture_output=True, text=True, timeout=30, check=False
    )
    assert (ran.returncode, ran.stdout) == (0, f"lecombus {lecombus.__version__}\n")
    words = "import lecombus.__main__ as m; m._take_name(); print(open('/proc/self/comm').read())"
    named = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    )
    assert named.stdout.strip() == "lecombus"


@pytest.mark.parametrize(
    ("closed", "numbers"),
    [("<&-", [0]), (">&-", [1]), ("2>&-", [2]), ("<&- >&- 2>&-", [0, 1, 2])],
)
def test_a_stream_that_is_closed_ends_nothing_and_its_number_is_taken(
    launcher: Path, tmp_path: Path, closed: str, numbers: list[int]
) -> None:
    """Else the port could get the number of standard error, and what is written there."""
    said = tmp_path / "said"
    words = (
        "import os; from lecombus.__main__ import _open_streams; _open_streams(); "
        f"leads = [os.readlink(f'/proc/self/fd/{{n}}') for n in {numbers}]; "
        f"open({str(said)!r}, 'w').write(' '.join(leads))"
    )
    for command in (
        [sys.executable, "-c", words],
        [str(launcher), "describe", "8200vector", "C0046"],
    ):
        done = subprocess.run(
            ["sh", "-c", f"{shlex.join(command)} {closed}"],
            capture_output=True, stdin=subprocess.PIPE, timeout=30, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, b"")
    assert said.read_text().split() == ["/dev/null"] * len(numbers)


def test_asking_for_help_imports_nothing_heavy() -> None:
    heavy = ("starlette", "uvicorn", "pydantic", "rich", "httpx2", "serial")
    script = (
        "import sys; from lecombus.cli import main; main(['--help']); "
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=15, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_stop_does_not_wait_for_the_server_s_libraries() -> None:
    script = (
        "import sys; import lecombus.cli.verb_commands; "
        "print([name for name in ('starlette', 'uvicorn', 'serial') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=15, check=True
    )
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("module", ["verb_commands", "status", "code_commands", "drive_commands"])
def test_a_command_for_the_daemon_imports_nothing_heavy(module: str) -> None:
    heavy = "{'pydantic', 'rich', 'yaml', 'starlette', 'anyio', 'serial', 'lecombus.config'}"
    program = (
        f"import sys, lecombus.cli.entry, lecombus.cli.{module}; "
        f"print(sorted({heavy} & set(sys.modules)), None in sys.modules.values())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[] False\n"
