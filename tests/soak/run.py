"""`make soak`: a full line for hours, on a machine that is busy, and what grows meanwhile.

    python -m soak.run [--hours 1] [--idle]

31 simulated drives at 19200 on a pseudo terminal, served by a process of their own; the daemon with
its journal, the Modbus bridge, and the MQTT bridge with a broker; scrapes, readers of events, and
clients that read, write and stop; and busy loops of lower priority on every core (none with
`--idle`). At the end, and every minute, memory, descriptors, threads and the size of the journal
are shown. It fails if

* a watchdog of a drive acted, or the daemon says that it fed one too late;
* memory of the daemon, or of daemon and bridges together, grew by 1 % or more after the first ten
  minutes, or that of a bridge by 2 % (shown only, where it runs for less than twenty: caches and
  the buffer of events fill up at first, and what a bridge keeps spreads over its heap for an hour);
* threads grew by more than `SPARE`, or the journal beyond its largest size;
* more than `SPARE` further descriptors are open when the clients have gone;
* a request ended otherwise than documented;
* a bridge ended, or lost the daemon or the broker.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx2
import pytest

from support import mqtt_parts
from support.children import child, take_priority
from support.daemon_host import (
    Daemon,
    command,
    environment,
    free_port,
    running,
    short_dir,
    started,
    until,
)
from support.rosters import Wanted, roster_text
from support.traffic import CUT, HANGING, Asked, Traffic, get, put

__all__ = ["DRIVES", "Sample", "grown", "main", "soak"]

ADDRESSES: Final = [address for address in range(11, 50) if address % 10][:31]
DRIVES: Final[tuple[Wanted, ...]] = tuple(
    (f"d{address}", address, ("8200vector", "smvector", "93xx")[place % 3])
    for place, address in enumerate(ADDRESSES)
)
SETPOINTS: Final = {"8200vector": "C0046", "smvector": "C1061", "93xx": "C0141"}
KEYS: Final = "cyclic: [{code: C0150, every: 2s}, {code: C0050, every: 5s}]"
WATCHDOG: Final = "{time: 2s, action: inhibit, configure: true}"
JOURNAL_BYTES: Final = 32 * 1000 * 1000
PER_S: Final = 60.0
SCRAPE_EVERY_S: Final = 5.0
READERS: Final = 4
SPARE: Final = 12
GROWTH: Final = 0.01
GROWTH_OF_BRIDGE: Final = 0.02
DAEMON, TOGETHER = "daemon", "daemon and bridges"
SETTLED_S: Final = 600.0


@dataclass(frozen=True)
class Sample:
    """What the daemon takes at one time, and the memory of the bridges by name."""

    at_s: float
    rss_kb: int
    descriptors: int
    threads: int
    journal_bytes: int
    bridges_kb: dict[str, int]

    def memory_kb(self, of: str) -> int:
        """Return what the daemon takes, a bridge, or all of them together."""
        if of == TOGETHER:
            return self.rss_kb + sum(self.bridges_kb.values())
        return self.rss_kb if of == DAEMON else self.bridges_kb[of]

    @property
    def text(self) -> str:
        """In one line."""
        return (
            f"{self.at_s / 60:6.1f} min  {self.rss_kb / 1000:7.1f} MB  "
            f"{self.descriptors:4} descriptors  {self.threads:3} threads  "
            f"journal {self.journal_bytes / 1e6:.2f} MB"
        ) + "".join(f"  {name} {kb / 1000:.1f} MB" for name, kb in self.bridges_kb.items())


def number(pid: int, key: str) -> int:
    """Return a number that the kernel knows of a process, such as VmRSS in kB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition(f"{key}:")[2].split()[0])


def sample(pid: int, journal: Path, at_s: float, bridges: Mapping[str, int]) -> Sample:
    """Look at the daemon, and at its bridges by name."""
    files = list(Path(f"/proc/{pid}/fd").iterdir())
    size = sum(one.stat().st_size for one in journal.parent.glob(f"{journal.name}*"))
    memory = {name: number(one, "VmRSS") for name, one in bridges.items()}
    return Sample(at_s, number(pid, "VmRSS"), len(files), number(pid, "Threads"), size, memory)


def grown(samples: list[Sample], from_s: float, of: str = DAEMON) -> float:
    """Return by what part memory grew: the median of the last fifth against that after `from_s`.

    Args:
        samples: All of them.
        from_s: Those before are left out.
        of: `DAEMON`, `TOGETHER`, or a bridge.
    """
    later = [one.memory_kb(of) for one in samples if one.at_s >= from_s]
    fifth = max(1, len(later) // 5)
    first, last = sorted(later[:fifth]), sorted(later[-fifth:])
    return last[len(last) // 2] / first[len(first) // 2] - 1.0


def mixed() -> list[Asked]:
    """What clients ask all the time."""
    asked = []
    for turn, (name, _, family) in enumerate(DRIVES):
        path = f"/v1/drives/{name}/codes"
        asked += [get("stored", f"{path}/C0150")] * 4
        asked.append(get("drive", f"/v1/drives/{name}"))
        if turn % 3 == 0:
            asked.append(get("fresh", f"{path}/C0050?fresh=true"))
            setpoint = f"{path}/{SETPOINTS[family]}"
            asked.append(put("write", setpoint, value=10 + turn, expires="5s"))
        if turn % 16 == 0:
            asked.append(put("stop", "/v1/stop", "POST", action="inhibit", target=name))
    return asked


def roster(folder: Path, http: int, modbus: int, broker: int) -> str:
    """Write the roster of the line."""
    return roster_text(
        DRIVES, port=folder / "port", folder=folder, watchdog=WATCHDOG, drive=KEYS, http=http,
        sections=f"journal: {{file: {folder / 'journal.sqlite'}, max_size: 32MB}}\n"
        f"modbus: {{port: {modbus}}}\nmqtt: {{host: 127.0.0.1, port: {broker}, tls: false}}",
    )  # fmt: skip


def soak(seconds: float, *, idle: bool) -> tuple[list[Sample], list[str]]:
    """Run for a time; give the samples and what was broken."""
    broken: list[str] = []
    with ExitStack() as stack:
        folder = stack.enter_context(short_dir())
        http, modbus = free_port(), free_port()
        broker = stack.enter_context(mqtt_parts.broker(folder))
        text = roster(folder, http, modbus, broker.port)
        (folder / "line.yaml").write_text(text)
        line = stack.enter_context(
            child("support.paced_line", folder / "port", "--roster", folder / "line.yaml")
        )
        line.ask("so_far")
        daemon = stack.enter_context(running(text, folder))
        daemon.until_online(within_s=240.0)
        words = command("bridge", "modbus", "-c", folder / "roster.yaml")
        bridges = {
            "modbus": stack.enter_context(started(words, folder / "modbus.log")),
            "mqtt": stack.enter_context(mqtt_parts.bridge(folder)).process,
        }
        pids = {name: one.pid for name, one in bridges.items()}
        listener = stack.enter_context(broker.client("#"))
        pid, journal = daemon.process.pid, folder / "journal.sqlite"
        for _ in range(READERS):
            reader = command("events", "--socket", daemon.socket, "--json")
            stack.enter_context(started(reader, folder / "events.log"))
        if not idle:
            for _ in range(2):
                loop = ["nice", "-n", str(5 - os.nice(0)), sys.executable, "-c", "while True: pass"]
                stack.enter_context(started(loop, folder / "busy.log", env=environment()))
        scraper = stack.enter_context(httpx2.Client(timeout=12.0))
        fired, missed = line.ask("so_far")["fired"], _missed(daemon)
        samples, scrapes, began_s = [sample(pid, journal, 0.0, pids)], 0, time.monotonic()
        heard = 0
        print(samples[0].text, flush=True)
        with Traffic(daemon.socket, mixed(), PER_S) as traffic:
            while (at_s := time.monotonic() - began_s) < seconds:
                scrapes += scraper.get(f"http://127.0.0.1:{http}/metrics").status_code == 200
                heard += len(listener.heard)
                listener.heard.clear()
                samples.append(sample(pid, journal, at_s, pids))
                if at_s // 60 > samples[-2].at_s // 60:
                    print(samples[-1].text, flush=True)
                time.sleep(SCRAPE_EVERY_S)
        print(f"{traffic.issued} requests, {scrapes} scrapes, {heard} messages by the broker")
        print(traffic.summary(), flush=True)
        after = line.ask("so_far")
        print(f"{after['requests']} telegrams", flush=True)
        if after["fired"] != fired:
            broken.append(f"watchdogs acted: {after['fired']}")
        if _missed(daemon) != missed:
            broken.append(f"fed too late: {_missed(daemon)}")
        if {HANGING, CUT, 500} & set(traffic.statuses):
            broken.append(f"requests ended as {dict(traffic.statuses)}")
        broken += [f"bridge {one}: ended" for one in bridges if bridges[one].poll() is not None]
        for name, log in (("modbus", folder / "modbus.log"), ("mqtt", folder / "bridge.log")):
            broken += [f"bridge {name}: {row}" for row in lost_by(log, name)]
        if not heard:
            broken.append("nothing came by the broker")
        try:
            least = samples[0].descriptors + SPARE
            until(lambda: sample(pid, journal, 0.0, {}).descriptors <= least, "", within_s=90.0)
        except pytest.fail.Exception:
            broken.append(f"descriptors stay open: {sample(pid, journal, 0.0, {}).text}")
        broken += judged(samples, SETTLED_S)
        until(lambda: set(daemon.states().values()) == {"online"}, "all online", within_s=30.0)
        if daemon.end() != 0:
            broken.append("the daemon did not end well")
    return samples, broken


def lost_by(log: Path, name: str) -> list[str]:
    """Return the rows of a bridge's log that say that it lost something, or had it never."""
    rows = log.read_text().splitlines()
    found = [row for row in rows if "event=daemon-away" in row or "event=mqtt-lost" in row]
    wanted = {"daemon-connected"} | ({"mqtt-connected"} if name == "mqtt" else set())
    missing = [one for one in sorted(wanted) if not any(f"event={one} " in row for row in rows)]
    return [*found, *(f"no {one}" for one in missing)]


def judged(samples: list[Sample], from_s: float) -> list[str]:
    """Return what grew beyond what it may."""
    broken = []
    is_long = samples[-1].at_s >= 2 * from_s
    from_s = from_s if is_long else samples[-1].at_s / 2
    for of in (DAEMON, TOGETHER, *samples[0].bridges_kb):
        growth, most = grown(samples, from_s, of), GROWTH
        if of in samples[0].bridges_kb:
            most = GROWTH_OF_BRIDGE
        print(f"memory of {of}: grew by {growth:.2%} after {from_s / 60:.1f} min", flush=True)
        if is_long and growth >= most:
            broken.append(f"memory of {of}: grew by {growth:.2%}")
    later = [one for one in samples if one.at_s >= from_s]
    if (most := max(one.threads for one in later)) > later[0].threads + SPARE:
        broken.append(f"threads grew to {most}")
    if (size := max(one.journal_bytes for one in samples)) > 2 * JOURNAL_BYTES:
        broken.append(f"the journal grew to {size} bytes")
    return broken


def _missed(daemon: Daemon) -> dict[str, float]:
    return daemon.metric("lecombus_watchdog_misses_total")


def main() -> int:
    """Run; exit status 1 where something was broken."""
    parser = argparse.ArgumentParser(prog="make soak", description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--idle", action="store_true", help="no busy loops beside it")
    given = parser.parse_args()
    take_priority()
    _, broken = soak(given.hours * 3600.0, idle=given.idle)
    print("\n".join(f"BROKEN: {one}" for one in broken) or "nothing broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
