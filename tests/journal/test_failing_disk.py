"""A disk that is full, or in whose place something else stands: writes are refused, stops are not.

The limit on the size of a process' files stands for the disk: it needs no rights and can be lifted.
"""

from __future__ import annotations

import resource
from pathlib import Path
from typing import Any

import pytest

from support.journal_daemon import ask, daemon, wait_for

pytestmark = [pytest.mark.real, pytest.mark.timeout(180)]

ROSTER = """\
line: {{name: full, port: "sim:", baud: 19200}}
drives:
  - name: feeder
    address: 11
    family: 821x
    cyclic: [{{code: C0150, every: 200ms}}]
    watchdog: {{time: 2s, action: inhibit, configure: true}}
api: {{socket: {folder}/s}}
state: {folder}/state.json
journal: {{file: {folder}/j.sqlite, on_failure: {on_failure}}}
"""
CODE = "/v1/drives/feeder/codes/C0046"


def is_online(socket: Path) -> bool:
    try:
        return bool(ask(socket, "GET", "/v1/drives/feeder")[1]["state"] == "online")
    except OSError:
        return False


def write(socket: Path, value: int) -> tuple[int, dict[str, Any]]:
    return ask(socket, "PUT", CODE, f'{{"value": {value}}}')


def remark(socket: Path) -> str:
    return str(ask(socket, "GET", "/v1/line")[1]["remarks"].get("journal", ""))


def rows(socket: Path, what: str) -> list[dict[str, Any]]:
    page = ask(socket, "GET", "/v1/journal?last=true&limit=500")[1]
    return [row for row in page["rows"] if row["what"] == what]


def stop_of(socket: Path) -> dict[str, Any]:
    body = '{"action": "inhibit", "target": "feeder"}'
    status, answer = ask(socket, "POST", "/v1/stop", body)
    assert (status, answer["outcome"]) == (200, "verified")
    return dict(answer)


@pytest.mark.slow
@pytest.mark.parametrize("on_failure", ["refuse", "go-on"])
def test_a_full_disk_stops_writes_if_the_roster_says_so_and_never_stops(
    tmp_path: Path, on_failure: str
) -> None:
    text = ROSTER.format(folder=tmp_path, on_failure=on_failure)
    (tmp_path / "roster.yaml").write_text(text)
    socket, file = tmp_path / "s", tmp_path / "j.sqlite"
    with daemon(tmp_path) as process:
        wait_for(lambda: is_online(socket))
        assert write(socket, 20)[1]["outcome"] == "done"
        wait_for(lambda: file.stat().st_size > 1_000_000)  # the reserve is there
        _, hard = resource.prlimit(process.pid, resource.RLIMIT_FSIZE)
        full = max(path.stat().st_size for path in tmp_path.glob("j.sqlite*"))
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (full, hard))

        def is_noticed() -> bool:
            write(socket, 21)
            return bool(remark(socket))

        wait_for(is_noticed)
        assert "no room" in remark(socket)
        status, answer = write(socket, 22)
        if on_failure == "refuse":
            assert (status, answer["type"]) == (503, "urn:lecombus:problem:journal-failing")
            assert answer["outcome"] == "refused"
        else:
            assert (status, answer["outcome"]) == (200, "done")
        stops = len(rows(socket, "stop"))
        for _ in range(3):
            stop_of(socket)
        wait_for(lambda: len(rows(socket, "stop")) == stops + 6)
        _, read = ask(socket, "GET", "/v1/drives/feeder/codes/C0150?fresh=true")
        assert read["quality"] == "good"
        assert is_online(socket)
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (hard, hard))
        wait_for(lambda: not remark(socket))
        assert write(socket, 23)[1]["outcome"] == "done"
        wait_for(lambda: bool(rows(socket, "journal-works")))
        assert ask(socket, "GET", "/v1/journal/verify")[1]["problem"] is None
        of_22 = [one for one in rows(socket, "write") if one["fields"]["value"] == "22"]
        expected = ["refused"] if on_failure == "refuse" else ["asked", "done"]
        assert sorted(one["outcome"] for one in of_22)[-len(expected) :] == expected


@pytest.mark.slow
def test_a_journal_whose_place_is_taken_comes_back_by_itself(tmp_path: Path) -> None:
    text = ROSTER.format(folder=tmp_path, on_failure="refuse")
    (tmp_path / "roster.yaml").write_text(text)
    socket, file = tmp_path / "s", tmp_path / "j.sqlite"
    file.mkdir()
    with daemon(tmp_path):
        wait_for(lambda: is_online(socket))
        assert "is not a regular file" in remark(socket)
        assert write(socket, 20)[0] == 503
        stop_of(socket)
        file.rmdir()
        wait_for(lambda: write(socket, 21)[0] == 200)
        assert remark(socket) == ""
        assert rows(socket, "start"), "what happened before is written too"
        assert [row["outcome"] for row in rows(socket, "stop")]
        file.unlink()
        wait_for(lambda: write(socket, 22)[0] == 503)
        wait_for(lambda: write(socket, 23)[0] == 200)
        assert "replaced" in remark(socket)
        assert not ask(socket, "GET", "/v1/journal/verify")[1]["whole"]
