"""A daemon that is killed at any instant: its journal is whole, and no acknowledged write is lost.

A client writes as fast as it is answered, with a key and a value of its own for each write, and
asks again after each start for the one that was under way. The daemon is killed after a random
time, sometimes before it serves.
"""

from __future__ import annotations

import http.client
import random
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from support.journal_daemon import START_WITHIN_S, ask, daemon, wait_for

pytestmark = pytest.mark.real

CODE = "C0046"
ROSTER = """\
line: {{name: killed, port: "sim:", baud: 19200}}
drives:
  - name: feeder
    address: 11
    family: generic
    cyclic: [{{code: 40, every: 200ms}}]
    writable: [46]
api: {{socket: {folder}/s}}
state: {folder}/state.json
journal: {folder}/j.sqlite
"""


@dataclass
class Client:
    """Writes values, each once, until its daemon is gone."""

    path: Path
    acknowledged: dict[int, tuple[int, Any]] = field(default_factory=dict)
    under_way: int | None = None
    last: int = 0

    def write(self, value: int) -> tuple[int, Any]:
        where = f"/v1/drives/feeder/codes/{CODE}"
        return ask(self.path, "PUT", where, f'{{"value": {value}}}', f"key-{value}")

    def work(self) -> None:
        while True:
            try:
                if self.under_way is None:
                    self.last += 1
                    self.under_way = self.last
                status, answer = self.write(self.under_way)
            except (OSError, http.client.HTTPException, ValueError):
                if not self.path.exists() or not self.is_served():
                    return
                continue
            if answer.get("outcome") not in (None, "refused"):
                self.acknowledged[self.under_way] = status, answer
                self.under_way = None
            else:
                time.sleep(0.02)  # not audited yet

    def is_served(self) -> bool:
        try:
            ask(self.path, "GET", "/healthz")
        except (OSError, http.client.HTTPException, ValueError):
            return False
        return True


def is_polled(path: Path) -> bool:
    try:
        _, reading = ask(path, "GET", "/v1/drives/feeder/codes/C0040")
    except (OSError, http.client.HTTPException, ValueError):
        return False
    return bool(reading["quality"] == "good")


def all_rows(path: Path) -> list[dict[str, Any]]:
    rows, after = [], 0
    while True:
        status, page = ask(path, "GET", f"/v1/journal?after={after}&limit=500")
        assert status == 200, page
        rows += page["rows"]
        if page["next"] is None:
            return rows
        after = page["next"]


def check(client: Client) -> None:
    """See that the journal is whole, and holds what was acknowledged."""
    status, found = ask(client.path, "GET", "/v1/journal/verify")
    assert (status, found["problem"]) == (200, None)
    rows = all_rows(client.path)
    starts = [row["number"] for row in rows if row["what"] == "start"]
    without_end = [row for row in rows if row["outcome"] == "asked" and not row["ended"]]
    assert [row for row in without_end if row["number"] < starts[-1]] == []
    ends: dict[int, list[str]] = {}
    for row in rows:
        if row["what"] == "write" and row["outcome"] not in ("asked", "refused"):
            ends.setdefault(int(row["fields"]["value"]), []).append(row["outcome"])
    assert {value: found for value, found in ends.items() if len(found) > 1} == {}
    for value, (_, answer) in client.acknowledged.items():
        assert ends[value][0] in (answer["outcome"], "unknown")


def waited_s(process: subprocess.Popen[bytes]) -> float:
    """Return how long a process has waited for a processor, because others had it, seconds."""
    return int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[1]) / 1e9


def kill_often(folder: Path, kills: int, seed: int) -> str:
    """Kill and check so many times; return how long it took until drives were read again."""
    (folder / "roster.yaml").write_text(ROSTER.format(folder=folder))
    chance, client = random.Random(seed), Client(folder / "s")
    back_s: list[float] = []
    alone_s: list[float] = []
    for _ in range(kills):
        with daemon(folder) as process:
            begun_s = time.monotonic()
            if chance.random() < 0.15:  # while it opens the journal
                time.sleep(chance.uniform(0.0, 1.5))
            else:
                wait_for(lambda: is_polled(client.path))
                back_s.append(time.monotonic() - begun_s)
                alone_s.append(back_s[-1] - waited_s(process))
                assert ask(client.path, "GET", "/v1/journal/verify")[1]["problem"] is None
                known = dict(list(client.acknowledged.items())[-3:])
                assert {value: client.write(value) for value in known} == known
                writer = threading.Thread(target=client.work, daemon=True)
                writer.start()
                time.sleep(chance.uniform(0.0, 0.7))
            process.send_signal(signal.SIGKILL)
            process.wait(START_WITHIN_S)
        if "writer" in locals():
            writer.join(START_WITHIN_S)
    with daemon(folder):
        wait_for(lambda: is_polled(client.path))
        if client.under_way is not None:
            client.write(client.under_way)
        check(client)
    back_s.sort()
    alone_s.sort()
    half = len(back_s) // 2
    return (
        f"{kills} kills, {len(client.acknowledged)} writes acknowledged; read again after "
        f"{back_s[half]:.2f} s (median), {back_s[-1]:.2f} s (longest); less what it waited for a "
        f"processor {alone_s[half]:.2f} s and {alone_s[-1]:.2f} s"
    )


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_every_acknowledged_write_is_in_the_journal_after_kills(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    record_property("counted", kill_often(tmp_path, 20, seed=1))


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_every_acknowledged_write_is_in_the_journal_after_200_kills(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    record_property("counted", kill_often(tmp_path, 200, seed=2))
