"""A line of another protocol, from its roster to its metrics, by the program as it is run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from lecombus.config import RosterError, parse_roster
from support.daemon_host import short_dir

pytestmark = pytest.mark.clock

TESTS = Path(__file__).parents[1]
ROSTER = """\
line: {{name: toys, port: "sim:", protocol: toy, baud: 9600}}
drives:
  - {{name: belt, address: 5, family: toymotor}}
  - {{name: fan, address: 6, family: toymotor}}
api: {{socket: {socket}}}
"""


def command(*words: object) -> list[str]:
    return [sys.executable, str(Path(__file__).parent / "run.py"), *map(str, words)]


ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{TESTS.parent / 'src'}{os.pathsep}{TESTS}"}


ALONE = {**ENVIRONMENT, "WITHOUT_LECOM": "1"}
"""A room that needs LECOM fails: a line of another protocol must not load it."""


def run(*words: object, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*words), env=env, capture_output=True, text=True, timeout=60, check=False
    )


@pytest.fixture
def client() -> Iterator[httpx2.Client]:
    """The daemon of a toy line, and a client of it."""
    with short_dir() as folder:
        socket, roster = folder / "s", folder / "toys.yaml"
        roster.write_text(ROSTER.format(socket=socket))
        daemon = subprocess.Popen(command("run", "-c", roster), env=ALONE)
        try:
            transport = httpx2.HTTPTransport(uds=str(socket))
            with httpx2.Client(transport=transport, base_url="http://toys", timeout=20.0) as found:
                wait_for(lambda: socket.exists() and speed(found, "fan") is not None)
                yield found
            daemon.send_signal(signal.SIGTERM)
            assert daemon.wait(30) == 0
        finally:
            daemon.kill()
            daemon.wait()


def wait_for(condition: object, within_s: float = 40.0) -> None:
    assert callable(condition)
    until_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.05)


def speed(client: httpx2.Client, drive: str) -> float | None:
    """Return a speed that was read of late; None: there is none."""
    try:
        answer = client.get(f"/v1/drives/{drive}/codes/C0002").json()
    except httpx2.TransportError:
        return None
    return float(answer["value"]) if answer.get("quality") == "good" else None


def test_a_toy_line_is_read_written_and_stopped_over_http(client: httpx2.Client) -> None:
    wait_for(lambda: client.get("/v1/drives/fan").json()["state"] == "online")
    for code, value in (("C0001", 42), ("C0003", 1)):
        path = f"/v1/drives/fan/codes/{code}"
        written = client.put(path, json={"value": value, "verify": True})
        assert (written.status_code, written.json()["outcome"]) == (200, "verified"), written.text
    read = client.get("/v1/drives/fan/codes/C0002", params={"fresh": "true"})
    assert (read.status_code, read.json()["raw"]) == (200, "42")
    wait_for(lambda: speed(client, "fan") == 42.0)
    assert speed(client, "belt") == 0.0
    refused = client.put("/v1/drives/fan/codes/C0001", json={"value": 100})
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:lecombus:problem:bad-value")
    halves = client.put("/v1/drives/fan/codes/C0001", json={"value": 1.5})
    assert "no digit may follow the point" in halves.json()["detail"]
    unknown = client.get("/v1/drives/fan/codes/C0077", params={"fresh": "true"})
    assert unknown.json()["type"] == "urn:lecombus:problem:no-such-code"

    stopped = client.post("/v1/stop", json={"action": "inhibit", "target": "fan"})
    (member,) = stopped.json()["members"]
    assert (stopped.status_code, member["outcome"]) == (200, "verified"), stopped.text
    assert (member["proof"]["code"], member["proof"]["raw"]) == ("C0003", "0")
    wait_for(lambda: speed(client, "fan") == 0.0)
    everybody = client.post("/v1/stop", json={"action": "inhibit", "target": "all"}).json()
    assert (everybody["outcome"], everybody["how"]) == ("verified", "one-by-one"), everybody

    page = client.get("/metrics").text
    assert 'lecombus_drive_up{line="toys",drive="fan"} 1' in page
    counted = [line for line in page.splitlines() if line.startswith("lecombus_telegrams_total")]
    assert any('drive="fan"' in line and 'outcome="answered"' in line for line in counted)
    assert client.get("/v1/line").json()["state"] == "open"


def test_check_and_plan_calculate_a_toy_line(tmp_path: Path) -> None:
    roster = tmp_path / "toys.yaml"
    roster.write_text(ROSTER.format(socket=tmp_path / "s"))
    checked = run("check", "-c", roster, env=ALONE)
    assert (checked.returncode, checked.stderr) == (0, ""), checked
    assert "belt\t5\ttoymotor" in checked.stdout
    planned = run("plan", "-c", roster, "--json", env=ALONE)
    assert planned.returncode == 0, planned.stderr
    assert [row["baud"] for row in json.loads(planned.stdout)["bauds"]] == [4800, 9600]


@pytest.mark.parametrize(
    ("old", "new", "right"),
    [
        ("family: toymotor", "family: 820x", "`family` `820x` speaks lecom"),
        ("address: 5", "address: 10", "1 to 9 would be right"),
        ("baud: 9600", "baud: 19200", "4800 or 9600 would be right"),
        ("baud: 9600", "baud: 9600, parity: port", "has no key"),
        ("family: toymotor}", "family: toymotor, also_writable: [C0100]}", "run from 0 to 99"),
        ("protocol: toy", "protocol: toi", "lecom or toy would be right"),
        ("protocol: toy", "protocol: lecom", "speaks toy, and the protocol of the line is lecom"),
    ],
)
def test_a_roster_is_checked_by_the_rules_of_its_protocol(
    tmp_path: Path, old: str, new: str, right: str
) -> None:
    roster = tmp_path / "toys.yaml"
    roster.write_text(ROSTER.format(socket=tmp_path / "s").replace(old, new, 1))
    checked = run("check", "-c", roster, env=ENVIRONMENT)
    assert checked.returncode == 2
    assert right in checked.stderr


def test_a_protocol_that_is_not_known_is_refused_at_its_place() -> None:
    with pytest.raises(RosterError) as found:
        parse_roster(ROSTER.format(socket="/tmp/s"), "toys.yaml")
    (first, *_) = found.value.mistakes
    assert (first.line, first.what) == (1, "`protocol` `toy` is unknown")
    assert first.right == "lecom would be right"
