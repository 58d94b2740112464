"""A daemon on a line of simulated drives, with clients, into which faults are put.

What holds for every fault is looked at here, whatever the fault is:

* the daemon lives, and everything is online and good again some time after the fault has ended;
* every request that is answered is answered by what is documented; none is left without an end;
* a stop is answered within `STOP_WITHIN_S`, where the fault leaves the daemon and the line running;
* no value of a drive that says nothing is shown as good for longer than its time (`Freshness`);
* no watchdog acts but where the fault takes the drive's telegrams away, and no motor turns that
  no client has enabled.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import httpx2
import pytest

from faults.shifted_clock import OFFSET
from support.children import Child, child
from support.daemon_host import (
    Daemon,
    command,
    environment,
    free_port,
    listens,
    short_dir,
    until,
)
from support.mqtt_parts import Broker
from support.rosters import Wanted, roster_text
from support.traffic import CUT, HANGING, Asked, Traffic, get, put

__all__ = ["DRIVES", "Bench", "Seen"]

DRIVES: Final[tuple[Wanted, ...]] = (
    ("feeder", 11, "8200vector"),
    ("belt", 12, "smvector"),
    ("winder", 21, "93xx"),
)
PERIOD_S: Final = 0.5
OLDEST_GOOD_S: Final = 4 * 2 * PERIOD_S + 1.0
"""A cyclic value may be twice its period and 1 s old, on a stretched line four times that."""

LATE_S: Final = 0.25
"""From then on it is said that the machine had no time for the bench itself."""

STOP_WITHIN_S: Final = 5.0
BACK_WITHIN_S: Final = 40.0
PER_S: Final = 12.0


def mixed() -> list[Asked]:
    """What clients ask all the time."""
    usual = [
        get("stored", "/v1/drives/belt/codes/C0150"),
        get("fresh", "/v1/drives/winder/codes/C0050?fresh=true"),
        put("write", "/v1/drives/belt/codes/C1061", value=20, expires="2s"),
        put("write", "/v1/drives/feeder/codes/C0046", value=12, expires="2s"),
        get("drives", "/v1/drives"),
    ]
    return [*usual * 4, put("stop", "/v1/stop", "POST", action="quick-stop", target="winder")]


@dataclass
class Seen:
    """What came of one fault.

    Attributes:
        broken: What was promised and did not hold.
        fired: The drives whose watchdogs acted.
        requests: How many there were; `statuses` how they ended.
        back_s: After the fault's end until all was online and good, seconds.
        notes: What else is worth a word.
    """

    broken: list[str] = field(default_factory=list)
    fired: dict[str, int] = field(default_factory=dict)
    requests: int = 0
    statuses: dict[int, int] = field(default_factory=dict)
    longest_stop_s: float = 0.0
    oldest_good_s: float = 0.0
    back_s: float = 0.0
    notes: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """In one line."""
        ends = ", ".join(f"{count} x {status}" for status, count in sorted(self.statuses.items()))
        acted = ", ".join(f"{name} {count}" for name, count in self.fired.items()) or "none"
        said = [
            f"{self.requests} requests ({ends})" if self.requests else "",
            f"longest stop {self.longest_stop_s:.1f} s" if self.longest_stop_s else "",
            f"watchdogs that acted: {acted}",
            f"good again after {self.back_s:.1f} s",
            *self.notes,
        ]
        return "; ".join(filter(None, said))


class Freshness:
    """Looks at all values ten times a second: none that is called good may be too old.

    Attributes:
        oldest_s: The age of the oldest good one.
        late_s: How late it was itself at most, because the machine was busy.
    """

    def __init__(self, socket: Path) -> None:
        self._socket = socket
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="freshness")
        self.oldest_s = self.late_s = 0.0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        transport = httpx2.HTTPTransport(uds=str(self._socket))
        with httpx2.Client(transport=transport, base_url="http://lecombus", timeout=12.0) as client:
            due_s = time.monotonic() + 0.1
            while not self._end.wait(0.1):
                self.late_s = max(self.late_s, time.monotonic() - due_s)
                with contextlib.suppress(httpx2.TransportError, KeyError, ValueError):
                    for drive in client.get("/v1/drives").json()["drives"]:
                        for value in drive["values"]:
                            if value["code"] == "C0150" and value["quality"] == "good":
                                self.oldest_s = max(self.oldest_s, value["age_s"])
                due_s = time.monotonic() + 0.1


class Bench:
    """The daemon and its line; restarted for whoever ends it."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self.process: subprocess.Popen[bytes]

    def __enter__(self) -> Self:
        self.folder = self._stack.enter_context(short_dir())
        self.clock = self.folder / "clock"
        self.clock.write_bytes(OFFSET.pack(0.0))
        self.broker = Broker(self.folder, free_port())  # of the faults that need one
        text = roster_text(
            DRIVES, port=self.folder / "port", folder=self.folder,
            watchdog="{time: 2s, action: inhibit, configure: true}", line="stall: 5s",
            own={"feeder": "also_writable: [C0012]"},
            drive=f"cyclic: [{{code: C0150, every: {PERIOD_S * 1000:.0f}ms}}]",
            sections=f"journal: {self.folder / 'journal.sqlite'}\n"
            f"mqtt: {{host: 127.0.0.1, port: {self.broker.port}, tls: no, control: yes}}",
        )  # fmt: skip
        (self.folder / "roster.yaml").write_text(text)
        words = ("--roster", self.folder / "roster.yaml")
        self.line: Child = self._stack.enter_context(
            child("faults.line_child", self.folder / "port", *words)
        )
        self.line.ask("fired")
        transport = httpx2.HTTPTransport(uds=str(self.folder / "api.sock"))
        self.client = self._stack.enter_context(
            httpx2.Client(transport=transport, base_url="http://lecombus", timeout=12.0)
        )
        self._log = self._stack.enter_context((self.folder / "log").open("ab"))
        self.start()
        self._stack.callback(self._kill)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    @property
    def daemon(self) -> Daemon:
        """How to talk to it."""
        return Daemon(self.process, self.folder, self.client)

    @property
    def pid(self) -> int:
        """Of the daemon."""
        return self.process.pid

    def start(self) -> None:
        """Start the daemon and wait until all is good."""
        words = command("run", "-c", self.folder / "roster.yaml")
        words[2:3] = ["faults.shifted_clock", str(self.clock)]
        env = environment()
        env["PYTHONPATH"] += f":{Path(__file__).parents[1]}"
        self.process = subprocess.Popen(words, stdout=self._log, stderr=self._log, env=env)
        until(lambda: listens(self.folder / "api.sock"), "the API answers", within_s=30.0)
        until(self.is_good, "all is good", within_s=60.0)

    def kill(self) -> None:
        """Kill the daemon without a word."""
        self.process.kill()
        self.process.wait()

    def _kill(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.kill()

    def set_clock(self, offset_s: float) -> None:
        """Set the wall clock that the daemon sees: by how much it is ahead, seconds."""
        with self.clock.open("r+b") as file:  # in its place: the daemon has it mapped
            file.write(OFFSET.pack(offset_s))

    def get(self, path: str) -> Any:
        """Read a document."""
        return self.client.get(path).json()

    def log(self) -> str:
        """All it has logged."""
        return (self.folder / "log").read_text()

    def written_by_mqtt(self) -> Counter[str]:
        """How often each value was written by MQTT, since the journal began."""
        found: Counter[str] = Counter()
        after: int | None = 0
        while after is not None:
            page = self.get(f"/v1/journal?after={after}&limit=500")
            found.update(
                row["fields"]["value"] for row in page["rows"]
                if row.get("asked") and row["what"] == "write"
                and row["fields"].get("client") == "mqtt" and row["outcome"] != "refused"
            )  # fmt: skip
            after = page["next"]
        return found

    def is_good(self) -> bool:
        """Whether every drive is online and every cyclic value good and new."""
        drives = self.get("/v1/drives")["drives"]
        return all(
            drive["state"] == "online"
            and any(
                one["code"] == "C0150" and one["quality"] == "good" and one["age_s"] < 1.5
                for one in drive["values"]
            )
            for drive in drives
        )

    def status(self, key: str) -> int:
        """A number out of the daemon's /proc/PID/status, such as `VmRSS` in kB."""
        text = Path(f"/proc/{self.pid}/status").read_text()
        return int(text.partition(f"{key}:")[2].split()[0])

    def descriptors(self) -> int:
        """How many files it has open."""
        return len(list(Path(f"/proc/{self.pid}/fd").iterdir()))

    @contextlib.contextmanager
    def watched(self, *, may_fire: bool, may_cut: bool, clients: bool) -> Iterator[Seen]:
        """Look at all that must hold, from before a fault until all is good after it."""
        seen, before = Seen(), self.line.ask("fired")
        socket = self.folder / "api.sock"
        with ExitStack() as stack:
            freshness = stack.enter_context(Freshness(socket))
            traffic = stack.enter_context(Traffic(socket, mixed(), PER_S)) if clients else None
            try:
                yield seen
            except (AssertionError, httpx2.TransportError, pytest.fail.Exception) as exc:
                seen.broken.append(str(exc).splitlines()[0] if str(exc) else "an assertion")
                self.line.ask("faults")
            ended_s = time.monotonic()
            try:
                until(self.is_good, "all is good again", within_s=BACK_WITHIN_S)
            except pytest.fail.Exception:
                states = {one["drive"]: one["state"] for one in self.get("/v1/drives")["drives"]}
                seen.broken.append(f"not good again within {BACK_WITHIN_S:g} s: {states}")
            seen.back_s = time.monotonic() - ended_s
        after = self.line.ask("fired")
        seen.fired = {
            name: count - before[name] for name, count in after.items() if count > before[name]
        }
        if seen.fired and not may_fire:
            seen.broken.append(f"watchdogs acted: {seen.fired}")
        seen.oldest_good_s = freshness.oldest_s
        if freshness.late_s > LATE_S:
            seen.notes.append(f"the machine was {freshness.late_s:.1f} s late itself")
        if freshness.oldest_s > OLDEST_GOOD_S:
            seen.broken.append(f"a value {freshness.oldest_s:.1f} s old was shown as good")
        if turning := self.line.ask("turns"):
            seen.broken.append(f"motors turn that nobody enabled: {turning}")
        if traffic is not None:
            self._judge(traffic, seen, may_cut=may_cut, may_fire=may_fire)

    def _judge(self, traffic: Traffic, seen: Seen, *, may_cut: bool, may_fire: bool) -> None:
        seen.requests = traffic.issued
        seen.statuses = dict(traffic.statuses)
        seen.longest_stop_s = traffic.ends["stop"].longest_s
        if sum(traffic.statuses.values()) != traffic.issued:
            seen.broken.append("requests without an end")
        wrong = {HANGING, 500} | (set() if may_cut else {CUT})
        if found := wrong & set(traffic.statuses):
            seen.broken.append(f"requests ended as {found}: {traffic.summary()}")
        if set(traffic.ends["stored"].statuses) - {200, 503, CUT}:
            seen.broken.append(f"stored values: {traffic.ends['stored'].said}")
        if seen.longest_stop_s > STOP_WITHIN_S and not (may_cut or may_fire):
            seen.broken.append(f"a stop took {seen.longest_stop_s:.1f} s")

    def write(self, value: int, drive: str = "belt", code: str = "C1061") -> dict[str, Any]:
        """Write, and give the answer."""
        path = f"/v1/drives/{drive}/codes/{code}"
        return dict(self.client.put(path, json={"value": value, "verify": True}).json())

    def stop(self, target: str = "all") -> tuple[float, dict[str, Any]]:
        """Stop; give how long it took and the answer."""
        began_s = time.monotonic()
        answer = self.client.post("/v1/stop", json={"action": "inhibit", "target": target})
        return time.monotonic() - began_s, json.loads(answer.text)
