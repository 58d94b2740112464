"""`lecombus demo`, as whoever cloned the project sees it first."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from support.daemon_host import command, environment, free_port, lecombus, started, until

pytestmark = [pytest.mark.real, pytest.mark.timeout(60)]

DRIVES = {"feeder", "belt", "pump", "winder", "fan"}


@contextlib.contextmanager
def demo(log: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    words = command("demo", "--http", f"127.0.0.1:{port}")
    with started(words, log) as process:
        yield process


def values_shown(text: str) -> set[str]:
    """Drives whose row shows a state, a frequency (a 93XX has none) and a status word."""
    return set(
        re.findall(r"^(\w+) .*?(?:online|starting) +(?:[\d.]+(?: Hz)?|-) +H[0-9A-F]{4}", text, re.M)
    )


@pytest.mark.slow
def test_the_demo_shows_live_values_of_five_families_and_ends_at_ctrl_c(tmp_path: Path) -> None:
    log, port = tmp_path / "log", free_port()
    url = f"http://127.0.0.1:{port}"
    with demo(log, port) as process, httpx2.Client(base_url=url, trust_env=False) as client:
        until(lambda: values_shown(log.read_text()) == DRIVES, "all shown", within_s=30.0)
        families = {one["family"] for one in client.get("/v1/drives").json()["drives"]}
        assert len(families) == 5
        assert "lecombus_drive_value{" in client.get("/metrics").text
        said = re.search(r"commands: lecombus (\w+) --socket (\S+)", log.read_text())
        assert said is not None
        ran = lecombus(said[1], "--socket", said[2])
        assert (ran.status, ran.err) == (0, "")
        until(lambda: running_drives(client), "a motor turns", within_s=30.0)
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
    assert "Traceback" not in log.read_text()
    assert log.read_text().endswith("good-bye\n")
    assert not Path(said[2]).exists()


def running_drives(client: httpx2.Client) -> bool:
    drives = client.get("/v1/drives").json()["drives"]
    speeds = [one["value"] for drive in drives for one in drive["values"] if one["code"] == "C0050"]
    return any(speed for speed in speeds)


def test_a_second_ctrl_c_while_it_ends_is_no_traceback(tmp_path: Path) -> None:
    log, port = tmp_path / "log", free_port()
    with demo(log, port) as process:
        until(lambda: log.exists() and "exchanges, open" in log.read_text(), "the line is open")
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGINT)
        until(lambda: ended_or_told(process), "it ended")
        # The last one may come when Python has given its signal handlers back already.
        assert process.wait(10) in (0, 130, -signal.SIGINT)
    assert "Traceback" not in log.read_text(), log.read_text()


def ended_or_told(process: subprocess.Popen[bytes]) -> bool:
    """Keep pressing Ctrl-C until it has ended."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    return process.poll() is not None


def test_a_port_in_use_is_said_plainly() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ran = lecombus("demo", "--for", "5s", "--http", f"127.0.0.1:{port}")
    assert (ran.status, ran.out) == (1, "")
    assert ran.err == (
        f"cannot listen on 127.0.0.1:{port}: the port is in use, or not for this user; name "
        "another one, such as --http 127.0.0.1:0 for any that is free\n"
    )


def test_without_a_wish_a_port_in_use_is_gone_round() -> None:
    with contextlib.ExitStack() as stack:
        # Where it is taken by somebody else already, all the better.
        with contextlib.suppress(OSError):
            stack.enter_context(socket.create_server(("127.0.0.1", 9740)))
        ran = lecombus("demo", "--for", "1s")
    assert (ran.status, ran.err) == (0, "")
    said = re.search(r"port 9740 is in use: HTTP is served on port (\d+) this time", ran.out)
    assert said is not None
    assert f"metrics: http://127.0.0.1:{said[1]}/metrics" in ran.out


def test_a_time_for_the_demo_is_kept() -> None:
    done = subprocess.run(
        command("demo", "--for", "2s", "--http", f"127.0.0.1:{free_port()}"),
        capture_output=True, text=True, env=environment(), timeout=15, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
