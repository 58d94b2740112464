"""The examples, against a daemon that runs on a pseudo terminal of simulated drives."""

from __future__ import annotations

import csv
import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import anyio
import pytest

from lecombus.client import Line, connect
from lecombus.fieldbus.lecom.simulator.pty import PtyEnd
from support.daemon_host import Daemon, environment, on_a_pty, short_dir, until

pytestmark = [pytest.mark.real, pytest.mark.slow]

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
THREE = [("feeder", 11, "8200vector"), ("belt", 12, "8200vector"), ("winder", 13, "8200vector")]
LEASES = "lease: {required: true, time: 2s, on_lapse: quick-stop}"
CYCLIC = "cyclic: [{code: C0150, every: 200ms}, {code: C0050, every: 500ms}]"


def example(name: str) -> Any:
    """Load an example, which is not a part of any package."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module: ModuleType = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[Daemon, PtyEnd]]:
    with (
        short_dir() as folder,
        on_a_pty(folder, THREE, drive=CYCLIC, sections=LEASES) as (daemon, end),
    ):
        daemon.until_online()
        yield daemon, end


def speeds(daemon: Daemon) -> list[float]:
    """The output frequency of each drive, Hz, as read now."""
    path = "/v1/drives/{}/codes/C0050?fresh=true"
    return [float(daemon.get(path.format(name))["value"]) for name, _, _ in THREE]


def test_three_drives_ramp_together_and_stop(
    running: tuple[Daemon, PtyEnd], capsys: pytest.CaptureFixture[str]
) -> None:
    daemon, _ = running
    ramp = example("ramp_together")
    seen: list[list[float]] = []

    async def look(line: Line) -> None:
        while True:
            drives = [drive.document["motion"]["setpoint"] for drive in await line.drives()]
            seen.append([float(one["value"]) for one in drives if one is not None])
            await anyio.sleep(0.1)

    async def main() -> None:
        async with connect(str(daemon.socket)) as line, anyio.create_task_group() as tasks:
            tasks.start_soon(look, line)
            await ramp.ramp_together(line, [name for name, _, _ in THREE], 6, hold_s=0.5)
            tasks.cancel_scope.cancel()

    anyio.run(main)
    assert [6.0] * 3 in seen, "the last step is a part of one"
    apart = max(max(row) - min(row) for row in seen if len(row) == len(THREE))
    assert apart <= 2 * ramp.STEP_HZ, seen
    out = capsys.readouterr().out
    stopped = {line.split(":")[0] for line in out.splitlines()}
    assert stopped == {"feeder", "belt", "winder"}
    assert out.count("quick stop verified") == 3
    assert daemon.get("/v1/leases")["leases"] == []


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_drives_stop_when_the_program_that_ramps_them_dies_or_stalls(
    running: tuple[Daemon, PtyEnd], how: signal.Signals
) -> None:
    daemon, _ = running
    lapsed = daemon.log().count("end=lapsed")
    program = subprocess.Popen(
        [sys.executable, EXAMPLES / "ramp_together.py", "5", *(name for name, _, _ in THREE)],
        env=environment(LECOMBUS_SOCKET=str(daemon.socket)), stdout=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        until(lambda: min(speeds(daemon)) > 0, "all turn", within_s=30.0)
        program.send_signal(how)
        ended_s = time.monotonic()
        until(lambda: daemon.log().count("end=lapsed") == lapsed + 1, "it lapses")
        until(lambda: max(speeds(daemon)) == 0, "all stand", within_s=15.0)
        assert time.monotonic() - ended_s > 1.0, "it took the lease time to lapse"
        held = daemon.get("/v1/leases")
        assert held["leases"] == []
        assert [one["latched"] for one in held["drives"]] == [True] * 3
    finally:
        os.kill(program.pid, signal.SIGKILL)
        program.wait()


def test_values_are_logged_and_old_ones_are_not(
    running: tuple[Daemon, PtyEnd], tmp_path: Path
) -> None:
    daemon, end = running
    log = example("log_to_csv")
    file = tmp_path / "values.csv"
    wanted = [("feeder", "C0050"), ("belt", "C0050")]

    async def main(rows: int) -> None:
        async with connect(str(daemon.socket)) as line:
            await log.log_to_csv(line, wanted, file, every_s=0.2, rows=rows)

    anyio.run(main, 3)
    end.line.faults.absent = {12}
    until(lambda: daemon.states()["belt"] == "offline", "belt is offline")
    anyio.run(main, 1)
    end.line.faults.absent = set()
    daemon.until_online()
    head, *rows = csv.reader(file.read_text().splitlines())
    assert head == ["time", "feeder C0050", "belt C0050", "not good"]
    assert [row[1:] for row in rows[:3]] == [["0", "0", ""]] * 3
    assert rows[3][1:3] == ["0", ""]
    assert rows[3][3].startswith("belt C0050: ")


def ended(
    name: str, *words: str, socket: Path, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run an example to its end."""
    return subprocess.run(
        [sys.executable, EXAMPLES / name, *words], capture_output=True, text=True, check=False,
        env=environment(LECOMBUS_SOCKET=str(socket)), timeout=60, cwd=folder,
    )  # fmt: skip


@pytest.mark.parametrize("words", [
    ["ramp_together.py", "fast", "feeder"], ["ramp_together.py", "30"], ["ramp_together.py"],
    ["ramp_together.py", "nan", "feeder"], ["ramp_together.py", "-5", "feeder"],
    ["log_to_csv.py"], ["log_to_csv.py", "x.csv"], ["log_to_csv.py", "x.csv", "feeder"],
], ids=" ".join)  # fmt: skip
def test_wrong_words_end_an_example_with_how_to_call_it(words: list[str]) -> None:
    ran = ended(*words, socket=Path("/nowhere/lecombus.sock"))
    assert (ran.returncode, ran.stdout) == (1, "")
    assert ran.stderr.startswith(f"usage: {words[0]} ")
    assert "Traceback" not in ran.stderr


CALLS = {
    "ramp_together.py": ["5", "feeder", "belt"],
    "log_to_csv.py": ["values.csv", "feeder/C0050"],
    "react_to_trip.py": [],
}


def test_every_example_is_called_here() -> None:
    assert {one.name for one in EXAMPLES.glob("*.py")} == set(CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_without_a_daemon_an_example_ends_with_what_to_do(name: str, tmp_path: Path) -> None:
    ran = ended(name, *CALLS[name], socket=Path("/nowhere/lecombus.sock"), folder=tmp_path)
    assert (ran.returncode, ran.stdout) == (1, "")
    (line,) = ran.stderr.splitlines()
    assert "/nowhere/lecombus.sock" in line
    assert line.startswith("no daemon answers at")
    assert "start it" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("words", "said"), [
    (["ramp_together.py", "5", "fedeer"], "fedeer"),
    (["log_to_csv.py", "values.csv", "fedeer/C0050"], "fedeer"),
    (["log_to_csv.py", "values.csv", "feeder/speed"], "not a code"),
], ids=lambda one: one if isinstance(one, str) else " ".join(one))  # fmt: skip
def test_what_the_daemon_refuses_ends_an_example_with_its_words(
    running: tuple[Daemon, PtyEnd], words: list[str], said: str, tmp_path: Path
) -> None:
    ran = ended(*words, socket=running[0].socket, folder=tmp_path)
    assert ran.returncode == 1
    assert said in ran.stderr
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize("name", ["log_to_csv.py", "react_to_trip.py"])
def test_ctrl_c_ends_an_example_in_silence(
    running: tuple[Daemon, PtyEnd], name: str, tmp_path: Path
) -> None:
    daemon = running[0]

    def works() -> bool:
        readers = sum(daemon.metric("lecombus_event_readers").values())
        return readers > 0 or (tmp_path / "values.csv").exists()

    with subprocess.Popen(
        [sys.executable, EXAMPLES / name, *CALLS[name]], cwd=tmp_path, stderr=subprocess.PIPE,
        text=True, env=environment(LECOMBUS_SOCKET=str(daemon.socket)),
    ) as program:  # fmt: skip
        try:
            until(works, f"{name} works", within_s=30.0)
            program.send_signal(signal.SIGINT)
            _, errors = program.communicate(timeout=30.0)
        finally:
            program.kill()
    assert (program.returncode, errors) == (130, "")


@pytest.mark.parametrize("before", ["time,belt C0050,not good\r\n1,2,\r\n", "something else\n"])
def test_a_file_with_other_columns_stays_as_it_is(
    running: tuple[Daemon, PtyEnd], tmp_path: Path, before: str
) -> None:
    file = tmp_path / "values.csv"
    file.write_bytes(before.encode())
    ran = ended("log_to_csv.py", str(file), "feeder/C0050", socket=running[0].socket)
    assert ran.returncode == 1
    assert ran.stderr.splitlines() == [
        f"{file} has other columns than time, feeder C0050, not good; name another file"
    ]
    assert file.read_bytes() == before.encode()


def test_a_trip_of_one_drive_stops_all(running: tuple[Daemon, PtyEnd]) -> None:
    daemon, end = running
    end.line["feeder"].clear_fault()
    react = example("react_to_trip")
    said: list[str] = []
    done = anyio.Event()

    def say(text: str) -> None:
        said.append(text)
        if text.startswith("remedy"):
            done.set()

    async def main() -> None:
        async with connect(str(daemon.socket)) as line, anyio.create_task_group() as tasks:
            tasks.start_soon(react.react_to_trips, line, say)
            await anyio.sleep(0.5)
            async with line.lease("test", ["belt"], 2.0):
                (await line.drive("belt").enable()).check()
                (await line.drive("belt").set_speed(20, "Hz")).check()
                end.line["feeder"].trip(50)
                with anyio.fail_after(15.0):
                    await done.wait()
            tasks.cancel_scope.cancel()

    anyio.run(main)
    assert said[0].startswith("feeder tripped: ")
    assert "belt: quick stop verified" in " | ".join(said)
    until(lambda: speeds(daemon)[1] == 0, "belt stands")
