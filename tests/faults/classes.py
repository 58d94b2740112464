"""The classes of faults: what is put in, how often, and what is promised."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Final

import httpx2

from faults.bench import Bench, Seen
from support.daemon_host import until
from support.mqtt_parts import MqttClient, bridge

__all__ = ["CLASSES", "FaultClass"]

Injected = str
"""What was put in, and how often, in words."""


@dataclass(frozen=True)
class FaultClass:
    """One class of faults.

    Args:
        name: Its name.
        area: Where it is put in.
        promised: What the documentation says of it.
        inject: Puts it in and takes it out again; says what, and how often.
        may_fire: It takes telegrams from drives for longer than their watchdogs' time.
        may_cut: It ends the daemon, or its connections.
        clients: Clients ask all the time.
    """

    name: str
    area: str
    promised: str
    inject: Callable[[Bench, Seen], Injected]
    may_fire: bool = False
    may_cut: bool = False
    clients: bool = True


CLASSES: Final[dict[str, FaultClass]] = {}


def fault(
    name: str, area: str, promised: str, **more: bool
) -> Callable[[Callable[[Bench, Seen], Injected]], Callable[[Bench, Seen], Injected]]:
    """Put a function that injects into the table."""

    def keep(inject: Callable[[Bench, Seen], Injected]) -> Callable[[Bench, Seen], Injected]:
        CLASSES[name] = FaultClass(name, area, promised, inject, **more)
        return inject

    return keep


# ---- the line ----------------------------------------------------------------------------------

ON_THE_LINE_S: Final = 10.0
STAYS: Final = "requests end in one outcome, no value looks fresh that is not, no watchdog acts"


def _on_the_line(name: str, faults: str, promised: str = STAYS, **more: bool) -> None:
    def inject(bench: Bench, seen: Seen) -> Injected:
        before = sum(bench.daemon.metric("lecombus_telegrams_total").values())
        bench.line.ask("faults", text=faults)
        time.sleep(ON_THE_LINE_S)
        bench.line.ask("faults")
        asked = sum(bench.daemon.metric("lecombus_telegrams_total").values()) - before
        return f"`{faults}` for {ON_THE_LINE_S:g} s, {asked:.0f} telegrams"

    fault(name, "line", promised, **more)(inject)


_on_the_line("answers lost", "lost=0.1")
_on_the_line("requests not heard", "unheard=0.1")
_on_the_line("answers late", "late=0.1:0.2s-0.4s", "none is used for another exchange; " + STAYS)
_on_the_line("noise", "noise=0.1,request-noise=0.05")
_on_the_line("wrong block check or parity", "bad-bcc=0.05,parity=0.05")
_on_the_line("answers broken off", "half=0.1")
_on_the_line("answers without end", "endless=0.02", may_fire=True)
_on_the_line("writes refused", "nak=0.3", "the client gets the refusal; nothing is called done")
_on_the_line("telegrams damaged", "damaged=0.1")
_on_the_line(
    "drives lose their supply", "power-cycle=0.01:1s",
    "settings are checked before a drive is online again; nothing is enabled", may_fire=True,
)  # fmt: skip


@fault(
    "a drive falls silent", "line",
    "it is offline, its values stale; the others are fed; back without a restart", may_fire=True,
)  # fmt: skip
def _silent(bench: Bench, seen: Seen) -> Injected:
    before = bench.line.ask("fired")
    for _ in range(2):
        bench.line.ask("faults", text="absent=12")
        until(lambda: bench.daemon.states()["belt"] == "offline", "it is offline", within_s=20.0)
        found = bench.get("/v1/drives/belt/codes/C0150")
        assert found["quality"] != "good", "a drive that is offline has a good value"
        bench.line.ask("faults")
        until(lambda: bench.daemon.states()["belt"] == "online", "it is back", within_s=40.0)
    after = bench.line.ask("fired")
    others = [name for name in after if name != "belt" and after[name] > before[name]]
    assert not others, f"watchdogs of others acted: {others}"
    return "one drive silent, 2 times, until it was offline"


# ---- the adapter -------------------------------------------------------------------------------


@fault(
    "the adapter is unplugged", "adapter",
    "the line is `lost` within 3 s; found again by its name; values stale", may_fire=True,
)  # fmt: skip
def _unplug(bench: Bench, seen: Seen) -> Injected:
    for _ in range(3):
        bench.line.ask("unplug")
        until(lambda: bench.daemon.line_state() == "lost", "the loss is seen", within_s=3.0)
        time.sleep(1.0)
        bench.line.ask("replug")
        until(bench.is_good, "all is good again", within_s=30.0)
    return "pseudo terminal closed and opened, 3 times"


def _opens(bench: Bench) -> float:
    return sum(bench.daemon.metric("lecombus_line_opens_total").values())


@fault(
    "the adapter stalls", "adapter", "the port is opened again after `line.stall`", may_fire=True
)  # fmt: skip
def _stall(bench: Bench, seen: Seen) -> Injected:
    opened = _opens(bench)
    bench.line.ask("faults", text="unplugged")
    until(lambda: _opens(bench) > opened, "it is reopened", within_s=20.0)
    bench.line.ask("faults")
    return "nothing passes, no error, until the port was opened again"


_on_the_line("the adapter holds bytes back", "late=1:1ms-16ms", "all as usual, a little slower")


# ---- disk --------------------------------------------------------------------------------------


@contextlib.contextmanager
def _limited(bench: Bench, what: int, value: int) -> Iterator[None]:
    """Set a limit of the running daemon for a while."""
    soft, hard = resource.prlimit(bench.pid, what)
    resource.prlimit(bench.pid, what, (value, hard))
    try:
        yield
    finally:
        resource.prlimit(bench.pid, what, (soft, hard))


@fault(
    "the disk is full", "disk",
    "writes are refused by name while nothing can be recorded; stops go out; all comes back",
)  # fmt: skip
def _full(bench: Bench, seen: Seen) -> Injected:
    files = list(bench.folder.glob("journal.sqlite*"))
    largest = max(one.stat().st_size for one in files)
    with _limited(bench, resource.RLIMIT_FSIZE, largest):
        until(lambda: bool(_remark(bench)), "it is noticed", within_s=20.0)
        assert bench.write(21)["type"].endswith("journal-failing"), "a write without a record"
        took_s, answer = bench.stop("winder")
        assert answer["outcome"] == "verified", f"the stop was {answer['outcome']}"
        seen.notes.append(f"stop verified in {took_s:.2f} s")
    until(lambda: not _remark(bench), "it works again", within_s=20.0)
    assert bench.get("/v1/journal/verify")["problem"] is None, "the chain is broken"
    return "no file may grow (RLIMIT_FSIZE) until it was noticed; once"


def _remark(bench: Bench) -> str:
    return str(bench.get("/v1/line")["remarks"].get("journal", ""))


@fault(
    "the state file cannot be replaced", "disk",
    "the line goes on, the log says so; it is saved when it can be again",
)  # fmt: skip
def _state(bench: Bench, seen: Seen) -> Injected:
    state = bench.folder / "state.json"
    state.unlink(missing_ok=True)
    (state / "x").mkdir(parents=True)
    assert bench.write(5, "feeder", "C0012")["outcome"] == "verified", "a write needs no state"
    until(lambda: "state" in str(bench.get("/v1/line")["remarks"]), "it is said", within_s=45.0)
    (state / "x").rmdir()
    state.rmdir()
    until(state.is_file, "the state is saved again", within_s=60.0)
    return "a folder stands in its place until it was noticed; once"


# ---- clock -------------------------------------------------------------------------------------


HOUR_S: Final = 3600.0
DAY_S: Final = 24 * HOUR_S


def _clock_jumps(name: str, offsets_s: tuple[float, ...], how: str) -> None:
    def inject(bench: Bench, seen: Seen) -> Injected:
        for offset_s in offsets_s:
            bench.set_clock(offset_s)
            until(partial(_shows, bench, time.time() + offset_s), "the new time is shown")
            answer = bench.write(5, "feeder", "C0012")
            assert answer["outcome"] == "verified", f"{offset_s:+g} s: a write is {answer}"
            _, stopped = bench.stop("winder")
            assert stopped["outcome"] == "verified", f"{offset_s:+g} s: a stop is {stopped}"
            assert bench.get("/v1/journal/verify")["problem"] is None, "the chain is broken"
            read = bench.get("/v1/drives/belt/codes/C0150")
            assert read["quality"] == "good", f"{offset_s:+g} s: a value is {read['quality']}"
            time.sleep(1.5)
        bench.set_clock(0.0)
        return how

    fault(name, "clock", "times shown change, and nothing else: no expiry, no age, no feed")(inject)


def _shows(bench: Bench, at_s: float) -> bool:
    """Whether values are shown with that time, Unix seconds; it may have trembled since."""
    read = bench.get("/v1/drives/belt/codes/C0150")
    return abs(datetime.fromisoformat(read["time"]).timestamp() - at_s) < 30.0


_clock_jumps(
    "the clock jumps ahead", (HOUR_S, 30 * DAY_S, 3650 * DAY_S), "by 1 h, 30 days, 10 years"
)
_clock_jumps(
    "the clock jumps back", (-HOUR_S, -30 * DAY_S, -3650 * DAY_S), "by 1 h, 30 days, 10 years"
)
_clock_jumps("the clock trembles", (2.0, -2.0) * 4, "2 s ahead and back, 8 times")


# ---- memory and descriptors ----------------------------------------------------------------------


@fault(
    "no memory", "memory",
    "a request may fail; the line goes on, or the daemon ends and the watchdogs act",
    may_fire=True, may_cut=True,
)  # fmt: skip
def _memory(bench: Bench, seen: Seen) -> Injected:
    began = bench.pid
    with _limited(bench, resource.RLIMIT_AS, bench.status("VmSize") * 1024):
        for _ in range(20):
            with contextlib.suppress(httpx2.TransportError, ValueError):
                bench.client.get("/v1/journal?limit=500")
                bench.client.get("/metrics")
            time.sleep(0.4)
    assert bench.process.poll() is None, "the daemon has ended"
    assert bench.pid == began
    return "not a page more than at that time (RLIMIT_AS), for 8 s"


@fault(
    "no descriptors", "memory", "new connections are refused; the line and old ones go on",
    may_cut=True,
)  # fmt: skip
def _descriptors(bench: Bench, seen: Seen) -> Injected:
    open_now = bench.descriptors()
    sockets = []
    with _limited(bench, resource.RLIMIT_NOFILE, open_now + 2):
        for _ in range(60):
            one = socket.socket(socket.AF_UNIX)
            one.settimeout(1.0)
            with contextlib.suppress(OSError):
                one.connect(str(bench.folder / "api.sock"))
            sockets.append(one)
        time.sleep(6.0)
    for one in sockets:
        one.close()
    until(lambda: bench.descriptors() <= open_now + 12, "descriptors are given back")
    return "2 more than open then (RLIMIT_NOFILE), 60 connections, for 6 s"


# ---- processor -----------------------------------------------------------------------------------


@fault("the processors are busy", "processor", "feeds are in time; answers take longer")
def _busy(bench: Bench, seen: Seen) -> Injected:
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in os.sched_getaffinity(bench.pid)
    ]
    time.sleep(12.0)
    for one in loops:
        one.kill()
        one.wait()
    return f"{len(loops)} busy loops of the same priority, one a core, for 12 s"


@fault(
    "the daemon is paused for moments", "processor",
    "no drive is called silent, none slow; feeds are in time",
)  # fmt: skip
def _moments(bench: Bench, seen: Seen) -> Injected:
    for _ in range(20):
        bench.process.send_signal(signal.SIGSTOP)
        time.sleep(0.25)
        bench.process.send_signal(signal.SIGCONT)
        time.sleep(0.25)
    return "SIGSTOP for 0.25 s, 20 times"


@fault(
    "the daemon is paused for long", "processor",
    "watchdogs act; no motor starts by itself; no old value is good", may_fire=True,
)  # fmt: skip
def _long(bench: Bench, seen: Seen) -> Injected:
    for _ in range(2):
        bench.process.send_signal(signal.SIGSTOP)
        time.sleep(6.0)
        bench.process.send_signal(signal.SIGCONT)
        until(bench.is_good, "all is good again", within_s=30.0)
    return "SIGSTOP for 6 s, 2 times"


@fault(
    "the daemon is killed", "processor",
    "watchdogs stop the drives; nothing is enabled by the next start; the journal is whole",
    may_fire=True, may_cut=True,
)  # fmt: skip
def _killed(bench: Bench, seen: Seen) -> Injected:
    for _ in range(3):
        bench.kill()
        time.sleep(0.5)
        bench.start()
        assert bench.get("/v1/journal/verify")["problem"] is None, "the chain is broken"
    return "SIGKILL and start, 3 times"


# ---- the broker of the MQTT bridge -------------------------------------------------------------

UNDISTURBED: Final = "the line and its clients notice nothing; "
SHOWN: Final = "lecombus/test/belt/value/C0150"


class _Commands:
    """Sends commands by MQTT, each twice, and all again after every fault.

    Each writes a value of its own, so that the journal shows how often it was carried out.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._before = bench.written_by_mqtt()
        self._sent: list[str] = []

    def send(self, count: int = 10) -> None:
        """Send so many new commands, all older ones too, and wait for their answers."""
        first = self._before.total() + len(self._sent)
        self._sent += [f"{(first + one) / 50:.2f}" for one in range(count)]
        with self._bench.broker.client("answers/test", SHOWN) as client:
            # What comes before the bridge has subscribed again is nobody's.
            until(partial(_is_heard, client), "the bridge takes commands", within_s=40.0)
            for value in self._sent * 2:
                client.ask("lecombus/test/feeder/set/C0046", value, correlation=value.encode())
            until(lambda: client.text(SHOWN), "a value is shown", within_s=40.0)

    def judge(self) -> str:
        """Look how often each was carried out."""
        carried_out = self._bench.written_by_mqtt() - self._before
        wanted = Counter(f"{float(value):g}" for value in self._sent)
        assert carried_out == wanted, f"carried out: {carried_out}"
        return f"{len(self._sent)} commands, each carried out once"


def _is_heard(client: MqttClient) -> bool:
    client.publish("lecombus/test/feeder/do/none", response="answers/test", correlation=b"probe")
    time.sleep(0.5)
    return any(one.correlation == b"probe" for one in client.all("answers/test"))


@contextlib.contextmanager
def _bridged(bench: Bench) -> Iterator[_Commands]:
    """Run a broker and the bridge; look at the end at what was carried out."""
    bench.broker.start()
    try:
        with bridge(bench.folder):
            commands = _Commands(bench)
            with bench.broker.client(SHOWN) as client:
                until(lambda: client.text(SHOWN), "a value is shown", within_s=40.0)
            commands.send()
            yield commands
    finally:
        bench.broker.end(kill=True)


@fault(
    "the broker is killed", "broker",
    UNDISTURBED + "values are shown again when it is back; no command is carried out twice",
)  # fmt: skip
def _broker_killed(bench: Bench, seen: Seen) -> Injected:
    with _bridged(bench) as commands:
        for _ in range(3):
            bench.broker.end(kill=True)
            time.sleep(3.0)
            bench.broker.start()
            commands.send()
        seen.notes.append(commands.judge())
    return "SIGKILL, and started again after 3 s, 3 times"


@fault(
    "the broker hangs", "broker",
    UNDISTURBED + "values are shown again when it goes on; no command is carried out twice",
)  # fmt: skip
def _broker_hangs(bench: Bench, seen: Seen) -> Injected:
    with _bridged(bench) as commands:
        process = bench.broker.process
        assert process is not None
        for _ in range(2):
            process.send_signal(signal.SIGSTOP)
            time.sleep(8.0)
            process.send_signal(signal.SIGCONT)
            commands.send()
        seen.notes.append(commands.judge())
    return "SIGSTOP for 8 s, 2 times"


@fault(
    "rubbish comes by the broker", "broker",
    UNDISTURBED + "nothing of it is carried out; commands are answered before and after it",
)  # fmt: skip
def _broker_rubbish(bench: Bench, seen: Seen) -> Injected:
    words = ("", "nan", "1e999", "0x", '{"value": {}}', "[" * 4000, "9" * 4000, '"\\ud800"')
    random = [bytes((number * 7 + place * 13) % 256 for place in range(60)) for number in range(8)]
    kinds = ("set/C0046", "set/C99999", "set/..", "do/enable", "do/set-speed", "do/", "event")
    count = 0
    with _bridged(bench) as commands:
        with bench.broker.client() as client:
            for kind in kinds:
                for payload in (*(word.encode() for word in words[1:]), *random):
                    for retain in (False, True):
                        client.publish(f"lecombus/test/feeder/{kind}", payload, retain=retain)
                        count += 1
                client.publish(f"lecombus/test/feeder/{kind}", b"", retain=True)  # forget it
        commands.send()
        seen.notes.append(commands.judge())
    return f"{count} messages with random bytes and JSON that is none, half of them retained"


# ---- clients -------------------------------------------------------------------------------------

WRITE: Final = (
    b"PUT /v1/drives/belt/codes/C1061 HTTP/1.1\r\nHost: x\r\nContent-Length: 13\r\n\r\n"
    b'{"value": 24}'
)


def _connection(bench: Bench) -> socket.socket:
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(5.0)
    one.connect(str(bench.folder / "api.sock"))
    return one


@fault("clients leave in the middle", "client", "what was not sent is not sent; no leak")
def _leave(bench: Bench, seen: Seen) -> Injected:
    before = bench.descriptors()
    for number in range(200):
        one = _connection(bench)
        one.sendall(WRITE if number % 2 else WRITE[: 10 + number % 80])
        one.close()
        if number % 10 == 0:
            time.sleep(0.2)
    until(lambda: bench.descriptors() <= before + 12, "descriptors are given back")
    return "200 connections closed in the middle of a write"


@fault("clients are slow", "client", "they disturb no other client")
def _slow(bench: Bench, seen: Seen) -> Injected:
    slow = [_connection(bench) for _ in range(20)]
    for place in range(40):
        for one in slow:
            with contextlib.suppress(OSError):
                one.send(WRITE[place : place + 1])
        time.sleep(0.25)
    for one in slow:
        one.close()
    return "20 clients, 4 bytes a second each, for 10 s"


@fault("connections without a word", "client", "they disturb no other client", may_cut=True)
def _mute(bench: Bench, seen: Seen) -> Injected:
    mute = []
    for _ in range(150):
        with contextlib.suppress(OSError):
            mute.append(_connection(bench))
    time.sleep(8.0)
    for one in mute:
        one.close()
    return f"{len(mute)} connections that say nothing, for 8 s"


@fault("a reader of events does not read", "client", "its events are bounded, others read on")
def _reader(bench: Bench, seen: Seen) -> Injected:
    before = bench.status("VmRSS")
    readers = [_connection(bench) for _ in range(8)]
    for one in readers:
        one.sendall(b"GET /v1/events HTTP/1.1\r\nHost: x\r\n\r\n")
    time.sleep(10.0)
    for one in readers:
        one.close()
    grown = bench.status("VmRSS") - before
    assert grown < 20_000, f"it has grown by {grown} kB"
    return "8 readers that read nothing, for 10 s"


@fault("clients say rubbish", "client", "400, and the end of the connection")
def _rubbish(bench: Bench, seen: Seen) -> Injected:
    for number in range(100):
        with contextlib.suppress(OSError), _connection(bench) as one:
            one.sendall(
                bytes((number * 7 + place * 13) % 256 for place in range(400)) + b"\r\n\r\n"
            )
            said = one.recv(100)
            assert not said or b" 400 " in said[:20], f"answered by {said[:20]!r}"
    return "100 connections with random bytes"
