"""Pulling the line ten times, while clients never stop asking."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd
from real.test_ser2net import ser2net
from support.daemon_host import (
    Daemon,
    free_port,
    on_a_pty,
    running,
    short_dir,
    sim_line,
    until,
)
from support.real_parts import require
from support.rosters import Wanted, roster_text
from support.traffic import CUT, HANGING, Asked, Traffic, get, put

pytestmark = [pytest.mark.real, pytest.mark.slow, pytest.mark.timeout(180)]

DRIVES: tuple[Wanted, ...] = (("belt", 12, "smvector"), ("winder", 21, "93xx"))
KEYS = "cyclic: [{code: C0150, every: 500ms}, {code: C0050, every: 1s}]"
TIMES = 10
BACK_WITHIN_S = 15.0
"""Audits of two drives beside more requests than the line can carry: 5 to 9 s if it is quiet."""
PER_S = 12.0


def mixed() -> list[Asked]:
    """A load the line can carry: stops come first, so many of them would leave nothing else."""
    usual = [
        get("stored", "/v1/drives/belt/codes/C0150"),
        get("fresh", "/v1/drives/winder/codes/C0050?fresh=true"),
        put("write", "/v1/drives/belt/codes/C1061", value=20),
        get("fresh", "/v1/drives/belt/codes/C0068?fresh=true"),
    ]
    stop = put("stop", "/v1/stop", "POST", action="quick-stop", target="winder")
    return [*usual * 4, stop]


def good_since(daemon: Daemon) -> bool:
    """Whether the line is open, every drive online and every cyclic value good and new."""
    if daemon.line_state() != "open":
        return False
    drives = daemon.get("/v1/drives")["drives"]
    cyclic = [one for drive in drives for one in drive["values"] if one["code"] in CYCLIC]
    return all(drive["state"] == "online" for drive in drives) and all(
        one["quality"] == "good" and one["age_s"] < 1.5 for one in cyclic
    )


CYCLIC = ("C0150", "C0050")


def pull_again_and_again(
    daemon: Daemon, pull: Callable[[], None], back: Callable[[], None]
) -> None:
    """Pull and plug in ten times; each time everything is good again soon, and nobody hangs."""
    until(lambda: good_since(daemon), "everything is good at first")
    took: list[float] = []
    with Traffic(daemon.socket, mixed(), PER_S) as traffic:
        for _ in range(TIMES):
            pull()
            until(lambda: daemon.line_state() == "lost", "the loss is seen", within_s=3.0)
            back()
            plugged_s = time.monotonic()
            until(lambda: good_since(daemon), "everything is good again", within_s=BACK_WITHIN_S)
            took.append(time.monotonic() - plugged_s)
    said = (
        f"{traffic.issued} requests\n{traffic.summary()}\nback after {[f'{s:.1f}' for s in took]}"
    )
    assert max(took) < BACK_WITHIN_S, said
    assert sum(traffic.statuses.values()) == traffic.issued, said
    assert not {CUT, HANGING, 500} & set(traffic.statuses), said
    assert max(ends.longest_s for ends in traffic.ends.values()) < BACK_WITHIN_S, said
    assert traffic.ends["stored"].statuses.keys() == {200}, said
    # A read is never refused by a drive; what waited for a lost line says that it was that.
    assert traffic.ends["fresh"].statuses.keys() <= {200, 503, 504}, said
    assert {200, 503} <= traffic.ends["fresh"].statuses.keys(), said
    (opened,) = daemon.metric("lecombus_line_opens_total").values()
    assert opened == TIMES + 1, daemon.log()
    assert daemon.end() == 0
    print(said)  # noqa: T201 - shown by pytest -rP


def test_an_adapter_unplugged_ten_times_comes_back_under_its_stable_name() -> None:
    with short_dir() as folder, on_a_pty(folder, DRIVES, drive=KEYS) as (daemon, end):
        pull_again_and_again(daemon, end.unplug, end.replug)


def test_ser2net_killed_ten_times_is_found_again() -> None:
    require("ser2net")
    with short_dir() as folder, PtyEnd(sim_line(DRIVES), folder / "device") as end:
        port = free_port()
        served = Served(folder, Path(end.path), port)
        served.start()
        try:
            with running(
                roster_text(DRIVES, port=f"socket://127.0.0.1:{port}", folder=folder, drive=KEYS),
                folder,
            ) as daemon:
                pull_again_and_again(daemon, served.kill, served.start)
        finally:
            served.kill()


class Served:
    """A ser2net that is killed (SIGKILL) and started again."""

    def __init__(self, folder: Path, device: Path, port: int) -> None:
        self._what = (folder, device, port)
        self._running = ExitStack()

    def start(self) -> None:
        self._running.enter_context(ser2net(*self._what))

    def kill(self) -> None:
        self._running.close()
