"""Signals, and what the service manager is told, by a real datagram socket."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import cycle
from pathlib import Path

import anyio
import httpx2
import pytest

from lecombus import daemon as daemon_module
from lecombus import line_runtime
from lecombus.fieldbus.lecom.simulator import PtyEnd
from lecombus.journal.journal_file import JournalFile
from lecombus.journal.reading import rows_after
from lecombus.line.worker import LineWorker
from support.daemon_host import FIVE, Daemon, running, short_dir, sim_line, until
from support.rosters import Wanted, make_roster, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(40)]

BELT: Wanted = ("belt", 12, "smvector")
WINDER: Wanted = ("winder", 21, "93xx")
FAN: Wanted = ("fan", 23, "smvector")
DRIVES = (BELT, WINDER)
WATCHDOG = "{time: 2s, action: inhibit, configure: true}"


class Manager:
    """A service manager's end of NOTIFY_SOCKET."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.1)
        self._ended = threading.Event()
        self._told: list[tuple[float, str]] = []
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()

    @property
    def told(self) -> list[str]:
        """All states told so far, in order."""
        return [state for _, state in self._told]

    def at(self, state: str) -> float:
        """When a state was told last."""
        return max(at_s for at_s, told in self._told if told == state)

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                data = self._socket.recv(4096)
            except TimeoutError:
                continue
            self._told += [(time.monotonic(), state) for state in data.decode().split("\n")]


@contextmanager
def managed(
    *, faults: str = "", drives: tuple[Wanted, ...] = DRIVES, sections: str = ""
) -> Iterator[tuple[Daemon, Manager, PtyEnd]]:
    """Run a daemon as a service manager would, with watchdogs that inhibit after 2 s."""
    with (
        short_dir() as folder,
        PtyEnd(sim_line((*DRIVES, FAN), faults=faults), folder / "device") as end,
    ):
        manager = Manager(folder / "notify")
        text = roster_text(
            drives, port=end.path, folder=folder, watchdog=WATCHDOG, sections=sections
        )
        try:
            with running(text, folder, env={"NOTIFY_SOCKET": str(manager.path)}) as daemon:
                yield daemon, manager, end
        finally:
            manager.close()


def heard(end: PtyEnd) -> dict[str, int]:
    """How many requests each drive has heard."""
    with end.lock:
        return {drive.name: len(drive.log) for drive in end.line.drives}


def fired(end: PtyEnd) -> dict[str, int]:
    """How often each drive's watchdog has expired up to now."""
    with end.lock:
        end.line.advance(time.monotonic())
        return {drive.name: drive.watchdog_fired for drive in end.line.drives}


def test_ready_is_told_once_the_last_drive_was_tried_and_not_before() -> None:
    """Three of five drives are absent: being tried takes each of them a time-out or two."""
    absent = tuple((f"ghost-{n}", n, "smvector") for n in (31, 32, 33))
    with managed(drives=(*DRIVES, *absent)) as (daemon, manager, end):
        while "READY=1" not in manager.told:
            was_ready = daemon.client.get("/readyz").status_code == 200
            assert not was_ready or daemon.get("/v1/line")["state"] == "open"
        states = daemon.states()
        assert min(heard(end)[name] for name, _, _ in DRIVES) > 0
        assert {states[name] for name, _, _ in absent} == {"offline"}
        assert daemon.client.get("/readyz").status_code == 200
        assert manager.told.count("READY=1") == 1


def test_a_line_that_cannot_be_opened_is_alive_but_not_ready() -> None:
    with managed() as (daemon, manager, end):
        until(lambda: "READY=1" in manager.told, "ready")
        end.unplug()
        until(lambda: daemon.client.get("/readyz").status_code == 503, "not ready any more")
        pings = manager.told.count("WATCHDOG=1")
        until(lambda: manager.told.count("WATCHDOG=1") > pings + 2, "pings go on")
        assert daemon.client.get("/healthz").status_code == 200
        assert daemon.end() == 0


def test_a_reload_does_not_make_a_line_ready_that_is_not() -> None:
    """The adapter is not there yet: the service stays `activating`, whatever is reloaded."""
    with short_dir() as folder:
        manager = Manager(folder / "notify")
        text = roster_text(DRIVES, port=folder / "missing", folder=folder, watchdog=WATCHDOG)
        try:
            with running(text, folder, env={"NOTIFY_SOCKET": str(manager.path)}) as daemon:
                for _ in range(2):
                    assert daemon.client.post("/v1/reload").status_code == 200
                assert daemon.client.get("/readyz").status_code == 503
                until(lambda: manager.told.count("WATCHDOG=1") > 2, "pings")
                assert not {"READY=1", "RELOADING=1"} & set(manager.told)
                assert daemon.end() == 0
        finally:
            manager.close()


def test_sigterm_inhibits_the_drives_if_wanted_and_ends_with_status_0() -> None:
    with managed(sections="on_shutdown: inhibit") as (daemon, manager, end):
        daemon.until_online()
        for name, code in (("belt", "C0135"), ("winder", "C0135")):
            answer = daemon.client.put(f"/v1/drives/{name}/codes/{code}", json={"value": "H0000"})
            assert answer.status_code == 200, answer.text
        assert not any(inhibited(end, name) for name in ("belt", "winder"))
        began_s = time.monotonic()
        assert daemon.end() == 0
        assert time.monotonic() - began_s < 5.0
        assert all(inhibited(end, name) for name in ("belt", "winder"))
        assert manager.told[-1] == "STOPPING=1"
        assert not daemon.socket.exists()
        with end.lock:
            assert end.line.collisions == 0
            assert end.line.aborted == 0
        assert "Traceback" not in daemon.log()


def inhibited(end: PtyEnd, name: str) -> bool:
    """Whether bit 9 of the control word is set: controller inhibit."""
    with end.lock:
        return bool(int(end.line[name].text(135)[1:], 16) & 1 << 9)


def test_signals_while_it_ends_do_not_cut_the_end_short() -> None:
    """Such as a second Ctrl-C, or the SIGHUP of a terminal that is closed."""
    with short_dir() as folder:
        journal = folder / "journal.sqlite"
        text = roster_text(FIVE, folder=folder, sections=f"journal: {journal}")
        with running(text, folder) as daemon:
            until(lambda: daemon.client.get("/readyz").status_code == 200, "ready")
            daemon.process.send_signal(signal.SIGINT)
            for number in cycle((signal.SIGHUP, signal.SIGTERM)):
                time.sleep(0.02)
                if daemon.process.poll() is not None:
                    break
                daemon.process.send_signal(number)
            assert daemon.process.returncode == 0, daemon.log()
        file = JournalFile(journal, 16_000_000)
        file.open(0)
        rows, _ = file.ask(partial(rows_after, after=0, since_ms=0, drives=[], most=500))
        file.close()
        assert (rows[-1].kind, rows[-1].whole()) == ("end", {"reason": "SIGINT"})


def test_requests_under_way_at_sigterm_all_get_an_answer() -> None:
    with managed() as (daemon, _, end):
        daemon.until_online()
        statuses: list[int] = []

        def ask() -> None:
            path = "/v1/drives/belt/codes/C0050?fresh=true"
            statuses.append(daemon.client.get(path).status_code)

        askers = [threading.Thread(target=ask) for _ in range(8)]
        before = heard(end)["belt"]
        for asker in askers:
            asker.start()
        until(lambda: heard(end)["belt"] > before, "the first is under way")
        assert daemon.end() == 0
        for asker in askers:
            asker.join()
        assert len(statuses) == len(askers)
        assert set(statuses) <= {200, 503}


def test_a_wrong_roster_is_refused_at_sighup_with_every_mistake_and_the_old_one_kept() -> None:
    with managed() as (daemon, manager, end):
        daemon.until_online()
        good = daemon.roster.read_text()
        bad = good.replace("address: 12", "address: 20").replace("93xx", "94xx")
        daemon.roster.write_text(bad)
        daemon.tell(signal.SIGHUP)
        until(lambda: manager.told.count("READY=1") == 2, "reloading is over")
        refused = [row for row in daemon.log().splitlines() if "event=reload-refused" in row]
        assert len(refused) == 2, daemon.log()
        assert all(str(daemon.roster) in row for row in refused)
        assert "94xx" in refused[0] + refused[1]
        assert daemon.states() == {"belt": "online", "winder": "online"}
        remark = daemon.get("/v1/line")["remarks"]["reload"]
        assert remark.startswith("the last reload was refused, the old roster is used: ")
        assert "1 more: `lecombus reload` lists them" in remark
        reloading = manager.told.index("RELOADING=1")
        assert manager.told[reloading + 1].startswith("MONOTONIC_USEC=")
        assert "READY=1" in manager.told[reloading:]
        daemon.roster.write_text(good)
        daemon.tell(signal.SIGHUP)
        until(
            lambda: "reload" not in daemon.get("/v1/line")["remarks"],
            "a good reload ends the remark",
        )
        assert daemon.end() == 0
        assert fired(end) == {"belt": 0, "winder": 0, "fan": 0}


def test_a_reload_by_a_command_says_what_changed_or_every_mistake() -> None:
    with managed() as (daemon, manager, end):
        daemon.until_online()
        good = daemon.roster.read_text()
        with_fan = roster_text(
            (*DRIVES, FAN), port=end.path, folder=daemon.folder, watchdog=WATCHDOG
        )
        daemon.roster.write_text(with_fan + "on_shutdown: inhibit\n")
        changed = daemon.cli("reload")
        assert (changed.status, changed.err) == (0, "")
        assert changed.out == "drive\tfan\tadded\t\nkey\ton_shutdown\tchanged\t\n"
        since = daemon.get("/v1/drives/winder")["since"]
        daemon.roster.write_text(good.replace("baud: 19200", "baud: 9600, echo: yes"))
        refused = daemon.cli("reload")
        assert refused.status == 2
        assert [row.split(": ")[1] for row in refused.err.splitlines()] == [
            "`line.baud` cannot change while lecombus runs, restart lecombus, or put the old value "
            "back",
            "`line.echo` cannot change while lecombus runs, restart lecombus, or put the old value "
            "back",
        ]
        assert "reload" in daemon.get("/v1/line")["remarks"]
        as_json = daemon.cli("reload", "--json")
        assert (as_json.status, len(as_json.json()["mistakes"])) == (2, 2)
        assert set(daemon.states()) == {"belt", "winder", "fan"}
        assert daemon.get("/v1/drives/winder")["since"] == since
        daemon.roster.write_text(good)
        assert daemon.cli("reload", "--json").json()["removed"] == ["fan"]
        assert "reload" not in daemon.get("/v1/line")["remarks"]
        assert manager.told.count("RELOADING=1") == 4


def test_reloads_at_the_same_time_run_one_after_the_other() -> None:
    with managed() as (daemon, manager, end):
        daemon.until_online()
        folder = daemon.folder
        with_fan = roster_text((*DRIVES, FAN), port=end.path, folder=folder, watchdog=WATCHDOG)
        daemon.roster.write_text(with_fan)
        answers: list[httpx2.Response] = []
        askers = [
            threading.Thread(target=lambda: answers.append(daemon.client.post("/v1/reload")))
            for _ in range(4)
        ]
        for asker in askers:
            asker.start()
        daemon.tell(signal.SIGHUP)
        for asker in askers:
            asker.join()
        until(lambda: manager.told.count("RELOADING=1") == 5, "five reloads")
        until(lambda: manager.told.count("READY=1") == 6, "all of them are over")
        assert {one.status_code for one in answers} == {200}
        added = [one.json()["added"] for one in answers]
        assert added.count(["fan"]) + added.count([]) == 4
        assert daemon.log().count("added=fan") == 1
        told = [one for one in manager.told if one in ("RELOADING=1", "READY=1")]
        assert told[told.index("RELOADING=1") :] == ["RELOADING=1", "READY=1"] * 5


@pytest.mark.slow
def test_drives_come_and_go_at_sighup_while_the_others_stay_fed() -> None:
    with managed() as (daemon, _, end):
        daemon.until_online()
        folder = daemon.folder
        with_fan = roster_text((*DRIVES, FAN), port=end.path, folder=folder, watchdog=WATCHDOG)
        without_belt = roster_text((WINDER, FAN), port=end.path, folder=folder, watchdog=WATCHDOG)
        since = daemon.get("/v1/drives/winder")["since"]
        daemon.roster.write_text(with_fan)
        daemon.tell(signal.SIGHUP)
        until(lambda: daemon.states().get("fan") == "online", "the new drive is online")
        assert daemon.get("/v1/drives/winder")["since"] == since
        daemon.roster.write_text(without_belt)
        daemon.tell(signal.SIGHUP)
        until(lambda: "belt" not in daemon.states(), "the old drive is gone")
        assert daemon.client.get("/v1/drives/belt").status_code == 404
        before = heard(end)
        # The drive taken out is not spoken to any more: its own watchdog acts, the others' do not.
        until(lambda: fired(end)["belt"] == 1, "the watchdog of the drive taken out acts")
        assert heard(end)["belt"] == before["belt"]
        assert fired(end) == {"belt": 1, "winder": 0, "fan": 0}
        assert daemon.metric('lecombus_drive_up{line="test",drive="belt"') == {}
        assert daemon.end() == 0


def test_pings_stop_when_the_line_task_stalls_though_all_else_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In this process: the real line task never hangs, so one that does takes its place."""

    async def hang(_: LineWorker) -> None:
        await anyio.sleep_forever()

    monkeypatch.setattr(LineWorker, "run", hang)
    monkeypatch.setattr(line_runtime, "STUCK_S", 0.5)
    with short_dir() as folder:
        manager = Manager(folder / "notify")
        monkeypatch.setenv("NOTIFY_SOCKET", str(manager.path))
        try:
            roster = make_roster(FIVE, folder=folder)
            anyio.run(end_when_unhealthy, daemon_module.Daemon(roster, None), manager)
        finally:
            manager.close()
    assert manager.told[-1] == "STOPPING=1"
    assert "READY=1" not in manager.told


async def end_when_unhealthy(stuck: daemon_module.Daemon, manager: Manager) -> None:
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(stuck.main)
        for _ in range(1000):
            await anyio.sleep(0.01)
            if stuck.runtime is not None and not stuck.healthy()[0]:
                break
        pings = manager.told.count("WATCHDOG=1")
        assert pings > 0
        for _ in range(10):  # the daemon looks ten times a second until it is ready
            await anyio.sleep(0.1)
        assert manager.told.count("WATCHDOG=1") <= pings + 1
        stuck.end()
