"""`lecombus lease`: which daemon its command asks, and that the command ends with the lease."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import anyio
import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub, serve_stub
from lecombus.cli import leases
from lecombus.cli.arguments import DaemonOptions
from lecombus.cli.exits import CommandError
from lecombus.cli.leases import hold, variables_of

HERE = DaemonOptions(None, None, as_json=False)

GRANTED = {
    "name": "service", "token": "7-secret", "targets": ["feeder"], "drives": ["feeder"],
    "time_s": 1.0, "counter": 1, "latched": [],
}  # fmt: skip


@pytest.mark.parametrize(
    ("variable", "daemon", "wanted"),
    [
        ("LECOMBUS_SOCKET", DaemonOptions("b.sock", None, as_json=False), {"SOCKET": "b.sock"}),
        ("LECOMBUS_URL", DaemonOptions("b.sock", None, as_json=False), {"SOCKET": "b.sock"}),
        (
            "LECOMBUS_SOCKET",
            DaemonOptions(None, "https://b:1", False, "b.token", "ca.pem", "own.pem"),
            {"URL": "https://b:1", "TOKEN_FILE": "b.token", "CA": "ca.pem",
             "CERTIFICATE": "own.pem"},
        ),
        ("LECOMBUS_SOCKET", HERE, {"SOCKET": "a"}),
    ],
)  # fmt: skip
def test_the_command_asks_the_daemon_that_gave_the_lease(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    variable: str,
    daemon: DaemonOptions,
    wanted: dict[str, str],
) -> None:
    """It may go to another folder; another daemon may have a drive of the same name."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(variable, "a" if variable.endswith("SOCKET") else "http://a:1")
    found = variables_of(daemon, "7-secret")
    whole = {
        f"LECOMBUS_{key}": text if key == "URL" else str(tmp_path / text)
        for key, text in wanted.items()
    }
    whole["LECOMBUS_LEASE"] = "7-secret"
    assert {key: text for key, text in found.items() if key.startswith("LECOMBUS_")} == whole
    assert found["PATH"] == os.environ["PATH"]


@pytest.mark.real
@pytest.mark.parametrize(
    "ignores", [[], [int(signal.SIGTERM)], [int(signal.SIGTERM), int(signal.SIGHUP)]]
)
def test_a_command_ends_with_its_lease_also_one_that_ignores_signals(
    short_dir: Path, monkeypatch: pytest.MonkeyPatch, ignores: list[int]
) -> None:
    """An interactive shell ignores SIGTERM."""
    monkeypatch.setattr(leases, "END_WITHIN_S", 0.3)
    lease, up = "PUT /v1/leases/service", short_dir / "up"
    script = (
        f"import os, signal, time; [signal.signal(one, signal.SIG_IGN) for one in {ignores}]; "
        f"open({str(up)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    )
    with serve_stub(short_dir / "s") as stub:
        stub.answers["GET /v1/groups"] = (200, '{"groups": []}')
        stub.answers[lease] = (200, json.dumps(GRANTED))

        def lose() -> None:
            until_s = time.monotonic() + 20
            while not up.exists() and time.monotonic() < until_s:
                time.sleep(0.02)
            lost = {"type": "urn:lecombus:problem:lease-lost", "detail": "it was taken over"}
            stub.answers[lease] = (409, json.dumps(lost))

        thread = threading.Thread(target=lose)
        thread.start()
        daemon = DaemonOptions(str(short_dir / "s"), None, as_json=False)
        with pytest.raises(CommandError, match="it was taken over"):
            anyio.run(
                hold, daemon, ("service", ["feeder"], 1.0, ""), [sys.executable, "-c", script]
            )
        thread.join()
    with pytest.raises(ProcessLookupError):
        os.kill(int(up.read_text()), 0)


@pytest.mark.real
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("ctrl_c", [signal.default_int_handler, signal.SIG_IGN])
def test_a_command_ends_when_the_one_that_holds_its_lease_is_ended(
    run: Run, daemon: DaemonStub, tmp_path: Path, number: signal.Signals, ctrl_c: Any
) -> None:
    """It would go on without a lease. A script of a shell's background is deaf to Ctrl-C."""
    up = tmp_path / "up"
    script = (
        f"open({str(up)!r}, 'w').write(str(__import__('os').getpid())); import time; time.sleep(60)"
    )
    daemon.answers["GET /v1/groups"] = (200, '{"groups": []}')
    daemon.answers["PUT /v1/leases/service"] = (200, json.dumps(GRANTED))

    def end() -> None:
        until_s = time.monotonic() + 20
        while not (up.exists() and up.read_text()) and time.monotonic() < until_s:
            time.sleep(0.02)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=end)
    before = signal.signal(signal.SIGINT, ctrl_c)
    try:
        thread.start()
        ran = run("lease", "service", "--on", "feeder", "--", sys.executable, "-c", script)
    finally:
        signal.signal(signal.SIGINT, before)
    thread.join()
    assert ran.status == 130
    with pytest.raises(ProcessLookupError):
        os.kill(int(up.read_text()), 0)


@pytest.mark.real
@pytest.mark.parametrize(("script", "status"), [("exit 7", 7), ("kill -9 $$", 137)])
def test_the_status_is_that_of_the_command_as_a_shell_would_say_it(
    short_dir: Path, script: str, status: int
) -> None:
    with serve_stub(short_dir / "s") as stub:
        stub.answers["GET /v1/groups"] = (200, '{"groups": []}')
        stub.answers["PUT /v1/leases/service"] = (200, json.dumps(GRANTED))
        stub.answers["DELETE /v1/leases/service"] = (200, "{}")
        daemon = DaemonOptions(str(short_dir / "s"), None, as_json=False)
        asked = ("service", ["feeder"], 1.0, "")
        assert anyio.run(hold, daemon, asked, ["sh", "-c", script]) == status


@pytest.mark.real
def test_a_command_that_cannot_be_run_gives_the_lease_up(short_dir: Path) -> None:
    """A lease that lapses stops its drives, and latches them."""
    script = short_dir / "script"
    script.write_text("no interpreter is named\n")
    script.chmod(0o700)
    with serve_stub(short_dir / "s") as stub:
        stub.answers["GET /v1/groups"] = (200, '{"groups": []}')
        stub.answers["PUT /v1/leases/service"] = (200, json.dumps(GRANTED))
        stub.answers["DELETE /v1/leases/service"] = (200, "{}")
        daemon = DaemonOptions(str(short_dir / "s"), None, as_json=False)
        with pytest.raises(OSError, match="Exec format error"):
            anyio.run(hold, daemon, ("service", ["feeder"], 1.0, ""), [str(script)])
        assert "DELETE /v1/leases/service" in [what for what, _ in stub.asked]
