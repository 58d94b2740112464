"""A full line at 19200 baud under far more requests than it can carry.

The drives are simulated by a process of their own, so that their answers are paced well whatever
the clients in this process do.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.children import Child, child
from support.daemon_host import (
    Daemon,
    running,
    short_dir,
    until,
)
from support.rosters import Wanted, roster_text
from support.traffic import CUT, HANGING, Asked, Traffic, get, put

pytestmark = pytest.mark.real

SETPOINTS = {"8200vector": "C0046", "93xx": "C0141", "smvector": "C1061"}


def family_of(place: int) -> str:
    if place % 5 == 0:
        return "8200vector"
    return "smvector" if place % 2 else "93xx"


ADDRESSES = [n for n in range(11, 50) if n % 10][:31]
DRIVES: tuple[Wanted, ...] = tuple(
    (f"drive-{address}", address, family_of(place)) for place, address in enumerate(ADDRESSES)
)
ABSENT = (14, 28, 41)
PRESENT = tuple(name for name, address, _ in DRIVES if address not in ABSENT)
PER_S = 500.0
KEYS = "cyclic: [{code: C0150, every: 2s}, {code: C0050, every: 5s}]"


@contextmanager
def full_line(folder: Path) -> Iterator[tuple[Daemon, Child]]:
    """Run a daemon with 31 drives, three of them absent; each has been tried once."""
    watchdog = "{time: 2s, action: inhibit}"
    roster = roster_text(DRIVES, port=folder / "port", folder=folder, watchdog=watchdog, drive=KEYS)
    (folder / "line.yaml").write_text(roster)
    absent = "absent=" + "+".join(map(str, ABSENT))
    words = ("--roster", folder / "line.yaml", "--faults", absent)
    with child("support.paced_line", folder / "port", *words) as line:
        line.ask("so_far")
        with running(roster, folder) as daemon:
            until(lambda: daemon.client.get("/readyz").status_code == 200, "ready")
            yield daemon, line


def mixed() -> list[Asked]:
    """What clients ask: mostly what is known, but more of the line than it can carry."""
    asked = []
    for turn, (name, _, family) in enumerate(DRIVES * 4):
        path = f"/v1/drives/{name}/codes"
        asked += [get("stored", f"{path}/C0150")] * 3
        asked.append(get("drive", f"/v1/drives/{name}"))
        asked.append(get("fresh", f"{path}/C0050?fresh=true"))
        value = 10 + turn % 20
        asked.append(put("write", f"{path}/{SETPOINTS[family]}", value=value, expires="2s"))
        if turn % 31 == 0:
            asked.append(put("stop", "/v1/stop", "POST", action="quick-stop", target="drive-11"))
    return asked


def exchanges(daemon: Daemon) -> float:
    return sum(daemon.metric("lecombus_exchange_seconds_count").values())


def bear(seconds: float, *, settled: bool = False, told: list[str] | None = None) -> None:
    """Load a full line for a while and look whether everything was kept.

    Args:
        seconds: How long.
        settled: Begin when all drives are online: their audits take half a minute. Otherwise
            they come online under load.
        told: Gets the figures.
    """
    with short_dir() as folder, full_line(folder) as (daemon, line):
        if settled:
            daemon.until_online(*PRESENT, within_s=60.0)
        before, said_before = line.ask("so_far"), exchanges(daemon)
        missed_before = misses(daemon)
        with Traffic(daemon.socket, mixed(), PER_S) as traffic:
            time.sleep(seconds)
        after, said = line.ask("so_far"), exchanges(daemon) - said_before
        text = traffic.summary()
        if told is not None:
            status = Path(f"/proc/{daemon.process.pid}/status").read_text()
            told += [
                f"{traffic.issued} requests in {seconds:g} s, at most {traffic.late_s:.2f} s late",
                text,
                f"{said / seconds:.1f} exchanges/s",
                f"resident {status.partition('VmRSS:')[2].partition(chr(10))[0].strip()}",
                f"margin {min(daemon.metric('lecombus_watchdog_margin_seconds').values()):.2f} s",
            ]
        assert after["fired"] == before["fired"], text
        assert after["requests"] > before["requests"]
        assert after["collisions"] == 0
        assert traffic.issued >= 0.95 * PER_S * seconds, text
        assert sum(traffic.statuses.values()) == traffic.issued, text
        assert not {CUT, HANGING, 500} & set(traffic.statuses), text
        assert set(traffic.ends["stored"].statuses) <= {200, 503}, text
        assert set(traffic.ends["stop"].statuses) == {200}, text
        assert traffic.ends["stop"].longest_s < 3.0, text
        assert misses(daemon) == missed_before, text
        states = daemon.states()
        wanted = {"online"} if settled else {"online", "starting"}
        assert {states[name] for name in PRESENT} <= wanted
        assert daemon.end() == 0


def misses(daemon: Daemon) -> dict[str, float]:
    """How often the supervisor reckons that a drive which is there was fed too late."""
    counts = daemon.metric("lecombus_watchdog_misses_total")
    return {
        name: counts[f'lecombus_watchdog_misses_total{{line="test",drive="{name}"}}']
        for name in PRESENT
    }


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_full_line_keeps_every_watchdog_and_ends_every_request_under_load() -> None:
    bear(12.0)


@pytest.mark.long
@pytest.mark.timeout(240)
def test_a_full_line_bears_the_load_for_a_minute(capsys: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []
    try:
        bear(60.0, settled=True, told=told)
    finally:
        with capsys.disabled():
            print("", *told, sep="\n")  # noqa: T201
