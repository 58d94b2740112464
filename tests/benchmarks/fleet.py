"""What a site takes: ten daemons on one computer, a broker's messages, `lecombus fleet` by lines.

Ten full lines of 31 drives at 19200 baud with the default reads run at the same time; memory is the
proportional share of each (a page that ten processes share counts once), processor time is that
of the daemons alone, the simulated lines are on the other core. The broker is mosquitto, which
uses one core; what it carries is reckoned from its processor time for a message.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import httpx2

from support.children import (
    MASTER_CORE,
    OTHER_CORE,
    ROOT,
    Child,
    child,
    die_with_parent,
    environment,
)
from support.paced_line import drives
from support.rosters import roster_text

from .machine import free_port
from .table import Row, spread

__all__ = ["measure"]

Process = subprocess.Popen[bytes]

DAEMONS, DRIVES, BAUD = 10, 31, 19200
MOST_MB, MOST_PERCENT = 600.0, 10.0
ONLINE_WITHIN_S = 180.0
TURN_S = 10.0
WARM_S = 5.0
FLEETS = (50, 500, 2000, 10_000)
VALUES_A_SECOND = 2000
SCRAPED_FOR_S = 30.0
RULES = ROOT / "deploy" / "prometheus" / "lecombus.rules.yml"
FEDERATED = ['{__name__=~"line:lecombus_.+"}', 'up{job=~"lecombus.*"}']
SCRAPES = """\
global: {{scrape_interval: 5s, evaluation_interval: 5s}}
rule_files: [rules.yml]
scrape_configs:
  - job_name: lecombus
    static_configs:
      - targets: [{targets}]
"""


def measure(folder: Path, rounds: int) -> list[Row]:
    """Measure the daemons and a bridge, then the broker, then the fleet."""
    broker_port = free_port()
    with mosquitto(folder, broker_port) as broker:
        rows = of_daemons(folder, rounds, broker, broker_port)
        rows += of_broker(broker, broker_port, rounds)
        for count in FLEETS:
            rows += of_fleet(broker, broker_port, count, rounds)
    return rows


# ---- ten daemons, and the bridge of one ---------------------------------------------------------


def of_daemons(folder: Path, rounds: int, broker: Process, broker_port: int) -> list[Row]:
    """Measure ten daemons on full lines, then what the bridge of one of them takes."""
    with contextlib.ExitStack() as stack:
        daemons, sockets, lines = [], [], []
        ports = [free_port() for _ in range(DAEMONS)]
        for number in range(DAEMONS):
            place = folder / f"l{number}"
            place.mkdir()
            link = place / "port"
            lines.append(
                stack.enter_context(
                    child("support.paced_line", link, "--baud", str(BAUD), core=OTHER_CORE)
                )
            )
            roster = place / "roster.yaml"
            roster.write_text(
                roster_text(
                    drives(DRIVES), name=f"line-{number}", port=place / "port", baud=BAUD,
                    folder=place, http=ports[number], line="turnaround: 2ms, echo: no",
                    sections=f"mqtt: {{host: 127.0.0.1, port: {broker_port}, tls: no}}",
                )
            )  # fmt: skip
            until(lambda place=place: (place / "port").exists(), "a simulated line")  # type: ignore[misc]
            daemons.append(stack.enter_context(lecombus("run", "-c", roster)))
            sockets.append(place / "api.sock")
        for socket in sockets:
            until(lambda socket=socket: are_online(socket), "drives online")  # type: ignore[misc]
        time.sleep(WARM_S)
        site = Site(daemons, lines)
        loads, rates = zip(*(site.turn() for _ in range(rounds)), strict=True)
        held = [sum(map(shared_mb, daemons)) for _ in range(rounds)]
        alone = [sum(map(resident_mb, daemons))]
        scrapes = of_prometheus(folder, ports, site, rounds)
        rows = of_bridge(stack, folder / "l0" / "roster.yaml", broker, broker_port, rounds)
    return [
        Row(
            f"{DAEMONS} daemons of {DRIVES} drives, {BAUD} bit/s: memory", f"{spread(held)} MB",
            f"resident, shared pages ten times: {spread(alone)} MB", median(held), MOST_MB,
            digits=1, note="MB, proportional share",
        ),
        Row(
            "the same daemons: processor", f"{spread(loads)} % of a core", "", median(loads),
            MOST_PERCENT, digits=1,
            note="% of a core, all together, full lines with the default reads, "
            f"{spread(rates, 0)} exchanges a second",
        ),
        *rows,
        *scrapes,
    ]  # fmt: skip


@dataclass
class Site:
    """Ten daemons and their simulated lines."""

    daemons: Sequence[Process]
    lines: Sequence[Child]

    def turn(self) -> tuple[float, float]:
        """Measure the daemons for a while: percent of one core, and exchanges a second."""
        began_s, first = time.monotonic(), self._exchanges()
        load = percent_of(self.daemons)
        return load, (self._exchanges() - first) / (time.monotonic() - began_s)

    def _exchanges(self) -> int:
        return sum(int(line.ask("mark")[0]) for line in self.lines)


def of_prometheus(folder: Path, ports: Sequence[int], site: Site, rounds: int) -> list[Row]:
    """Measure a Prometheus that scrapes these lines, with the rules."""
    port = free_port()
    targets = ", ".join(f"'127.0.0.1:{one}'" for one in ports)
    shutil.copy(RULES, folder / "rules.yml")
    (folder / "prometheus.yml").write_text(SCRAPES.format(targets=targets))
    words = [
        tool("prometheus"), f"--config.file={folder / 'prometheus.yml'}",
        f"--storage.tsdb.path={folder / 'tsdb'}", f"--web.listen-address=127.0.0.1:{port}",
    ]  # fmt: skip
    process = subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, preexec_fn=die_with_parent
    )
    base = f"http://127.0.0.1:{port}"
    try:
        with httpx2.Client(base_url=base, trust_env=False, timeout=30.0) as client:
            time.sleep(SCRAPED_FOR_S)
            loads, turns = [], []
            for _ in range(rounds):
                before_s = used_s(process)
                turns.append(site.turn())
                loads.append(100 * (used_s(process) - before_s) / TURN_S)
            page = httpx2.get(f"http://127.0.0.1:{ports[0]}/metrics", trust_env=False).text
            series = sum(not row.startswith("#") for row in page.splitlines())
            federated = client.get("/federate", params={"match[]": FEDERATED}).text
            rows = sum(not row.startswith("#") for row in federated.splitlines())
            held = resident_mb(process)
    finally:
        process.kill()
        process.wait()
    return [
        Row(
            f"Prometheus for {DAEMONS} such lines, each 5 s: series of a line", f"{series}", "",
            series, digits=0, note=f"{len(page) / 1000:.0f} kB a page; {spread(loads)} % of a core "
            f"and {held:.0f} MB; {rows / DAEMONS:.1f} federated series a line; the daemons take "
            f"{spread([one[0] for one in turns])} % of a core then, with "
            f"{median(one[1] for one in turns):.0f} exchanges a second",
        ),
    ]  # fmt: skip


def of_bridge(
    stack: contextlib.ExitStack, roster: Path, broker: Process, port: int, rounds: int
) -> list[Row]:
    """Measure the bridge of one line, and how many messages and bytes it sends."""
    empty_mb = shared_mb(broker)
    heard = stack.enter_context(counting(port))
    bridge = stack.enter_context(lecombus("bridge", "mqtt", "-c", roster))
    time.sleep(2 * WARM_S)
    rates, volumes, loads = [], [], []
    for _ in range(rounds):
        (messages, sent), began_s = heard(), time.monotonic()
        loads.append(percent_of([bridge]))
        passed_s, now = time.monotonic() - began_s, heard()
        rates.append((now[0] - messages) / passed_s)
        volumes.append((now[1] - sent) / passed_s / 1000)
    kept_mb = shared_mb(broker) - empty_mb
    return [
        Row(
            "MQTT bridge of one such line: messages", f"{spread(rates)} /s", "", median(rates),
            digits=1, note=f"{spread(loads)} % of a core, {shared_mb(bridge):.0f} MB; "
            f"{median(volumes):.0f} kB/s of topics and payloads; {kept_mb:.1f} MB in the broker",
        ),
    ]  # fmt: skip


@contextlib.contextmanager
def counting(port: int) -> Iterator[Callable[[], tuple[int, int]]]:
    """Count messages and bytes of lines at the broker, in this process."""
    import paho.mqtt.client as paho
    from paho.mqtt.enums import CallbackAPIVersion

    heard = [0, 0]

    def take(client: paho.Client, data: object, message: paho.MQTTMessage) -> None:
        heard[0] += 1
        heard[1] += len(message.topic) + len(message.payload)

    client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
    client.on_message = take
    client.connect("127.0.0.1", port)
    client.loop_start()
    client.subscribe("lecombus/#")
    try:
        yield lambda: (heard[0], heard[1])
    finally:
        client.disconnect()
        client.loop_stop()


def are_online(socket: Path) -> bool:
    """Whether all drives of a line are online."""
    transport = httpx2.HTTPTransport(uds=str(socket))
    with (
        contextlib.suppress(httpx2.HTTPError),
        httpx2.Client(transport=transport, base_url="http://lecombus", timeout=5.0) as client,
    ):
        return bool(client.get("/v1/line").json()["drives"].get("online") == DRIVES)
    return False


# ---- the broker and the fleet -------------------------------------------------------------------


def of_broker(broker: Process, port: int, rounds: int) -> list[Row]:
    """Measure what the broker takes for the values of lines, with one who reads all of them."""
    words = (str(port), "values", str(VALUES_A_SECOND))
    with child("benchmarks.fleet_lines", *words) as lines, reading_all(port):
        time.sleep(WARM_S)
        costs, rates = [], []
        for _ in range(rounds):
            first = lines.ask("sent")
            began_s, before_s = time.monotonic(), used_s(broker)
            time.sleep(TURN_S)
            count = lines.ask("sent") - first
            costs.append((used_s(broker) - before_s) / count * 1e6)
            rates.append(count / (time.monotonic() - began_s))
    return [
        Row(
            "broker: processor for a value, one reader", f"{spread(costs)} µs", "",
            1e6 / median(costs), digits=0,
            note=f"messages a second for one core; measured at {median(rates):.0f} a second",
        ),
    ]  # fmt: skip


@contextlib.contextmanager
def reading_all(port: int) -> Iterator[None]:
    """Read all values in a process beside."""
    words = [tool("mosquitto_sub"), "-p", str(port), "-V", "5", "-t", "plant/#"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, preexec_fn=die_with_parent)
    try:
        yield
    finally:
        process.kill()
        process.wait()


def of_fleet(broker: Process, port: int, count: int, rounds: int) -> list[Row]:
    """Measure `lecombus fleet` and the broker while so many lines are shown."""
    with child("benchmarks.fleet_lines", str(port), str(count)) as lines:
        time.sleep(WARM_S)
        with lecombus("fleet", "--json", "--broker", f"mqtt://127.0.0.1:{port}") as fleet:
            time.sleep(2 * WARM_S)
            loads, brokers, rates = [], [], []
            for _ in range(rounds):
                first, began_s, before_s = lines.ask("sent"), time.monotonic(), used_s(broker)
                loads.append(percent_of([fleet]))
                passed_s = time.monotonic() - began_s
                brokers.append(100 * (used_s(broker) - before_s) / passed_s)
                rates.append((lines.ask("sent") - first) / passed_s)
            held = shared_mb(fleet)
    time.sleep(1.0)
    return [
        Row(
            f"`lecombus fleet` with {count} lines", f"{spread(loads)} % of a core", "", held,
            digits=1, note=f"MB; {median(rates):.0f} messages a second, "
            f"{spread(brokers)} % of a core for the broker",
        ),
    ]  # fmt: skip


# ---- processes ----------------------------------------------------------------------------------


@contextlib.contextmanager
def lecombus(*words: str | Path) -> Iterator[Process]:
    """Run a command as a user does, on the masters' core, and end it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "lecombus", *words], stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, env=environment(), preexec_fn=die_with_parent,
    )  # fmt: skip
    os.sched_setaffinity(process.pid, {MASTER_CORE})
    try:
        yield process
    finally:
        process.kill()
        process.wait(20.0)


@contextlib.contextmanager
def mosquitto(folder: Path, port: int) -> Iterator[Process]:
    """Run a broker with its usual limits."""
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen(
        [tool("mosquitto"), "-c", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        preexec_fn=die_with_parent,
    )  # fmt: skip
    try:
        time.sleep(1.0)
        yield process
    finally:
        process.kill()
        process.wait()


def tool(name: str) -> str:
    """Find a program of Debian."""
    found = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if found is None:
        raise SystemExit(f"{name} is not installed: see requirements/debian.txt")
    return found


def percent_of(processes: Sequence[Process]) -> float:
    """Measure the processor time of processes for a while, percent of one core."""
    began_s, before_s = time.monotonic(), sum(map(used_s, processes))
    time.sleep(TURN_S)
    return 100 * (sum(map(used_s, processes)) - before_s) / (time.monotonic() - began_s)


def used_s(process: Process) -> float:
    """Return the processor time that a process has used."""
    words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def shared_mb(process: Process) -> float:
    """Return a process's proportional share of memory, megabytes."""
    return kilobytes(process, "smaps_rollup", "Pss:")


def resident_mb(process: Process) -> float:
    """Return what a process holds in memory, shared or not, megabytes."""
    return kilobytes(process, "status", "VmRSS:")


def kilobytes(process: Process, file: str, name: str) -> float:
    """Return a row of a file of /proc, megabytes."""
    for row in Path(f"/proc/{process.pid}/{file}").read_text().splitlines():
        if row.startswith(name):
            return int(row.split()[1]) * 1024 / 1e6
    raise RuntimeError("a process has ended")


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait until a condition holds."""
    end_s = time.monotonic() + ONLINE_WITHIN_S
    while not condition():
        if time.monotonic() > end_s:
            raise RuntimeError(f"not within {ONLINE_WITHIN_S:g} s: {what}")
        time.sleep(0.2)
