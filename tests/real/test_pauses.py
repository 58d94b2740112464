"""A daemon that is stopped and let run again and again, as SIGSTOP and SIGCONT do it."""

from __future__ import annotations

import signal
import time

import pytest

from support.daemon_host import on_a_pty, short_dir

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(400)]

COUNT = 31
PAUSE_S = 0.25
PAUSED_FOR_S = 30.0


def test_a_daemon_that_was_paused_for_half_a_minute_does_all_as_before() -> None:
    """A process that is stopped in `epoll_wait` finds its timers first and the bytes after them."""
    drives = [(f"d{number}", 1 + number + number // 9, "smvector") for number in range(COUNT)]
    watchdog = "{time: 2s, action: trip, configure: true}"
    with short_dir() as folder, on_a_pty(folder, drives, watchdog=watchdog) as (daemon, _):
        daemon.until_online(within_s=120.0)
        stretch = float(daemon.get("/v1/line")["stretch"])
        began = len(daemon.log())
        until_s = time.monotonic() + PAUSED_FOR_S
        while time.monotonic() < until_s:
            daemon.tell(signal.SIGSTOP)
            time.sleep(PAUSE_S)
            daemon.tell(signal.SIGCONT)
            time.sleep(PAUSE_S)
        log = daemon.log()[began:]
        assert "to=offline" not in log
        assert "event=slow-drive" not in log
        time.sleep(60.0)
        assert set(daemon.states().values()) == {"online"}
        for name, *_ in drives:
            answer = daemon.client.put(f"/v1/drives/{name}/codes/C1061", json={"value": 10})
            assert (answer.status_code, answer.json()["outcome"]) == (200, "done"), answer.text
            fresh = daemon.client.get(f"/v1/drives/{name}/codes/C0150", params={"fresh": "true"})
            assert fresh.status_code == 200
        assert float(daemon.get("/v1/line")["stretch"]) < 2.0 * stretch
        for name in daemon.states():
            assert "answers later" not in daemon.client.get(f"/v1/drives/{name}").text
