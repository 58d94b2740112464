"""The daemon on a pseudo terminal, as a user meets it: command line, exit statuses, metrics."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from support.daemon_host import (
    Daemon,
    Ran,
    free_port,
    lecombus,
    on_a_pty,
    short_dir,
    until,
)
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.timeout(40)]

DRIVES = (("belt", 12, "smvector"), ("winder", 21, "93xx"), ("ghost", 31, "smvector"))
THERE = ("belt", "winder")
OPENMETRICS = "application/openmetrics-text; version=1.0.0"


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    """A daemon whose ghost does not answer."""
    with (
        short_dir() as folder,
        on_a_pty(
            folder,
            DRIVES,
            faults="absent=31",
            watchdog="{time: 2s, action: inhibit, configure: true}",
            http=free_port(),
        ) as (running, _),
    ):
        running.until_online(*THERE)
        until(lambda: running.states()["ghost"] == "offline", "the ghost is offline")
        yield running


# ---- the command line ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("status",), 0),
        (("status", "belt"), 0),
        (("read", "belt", "C0150"), 0),
        (("read", "winder", "C0050"), 0),
        (("write", "belt", "C1061", "20"), 0),
        (("write", "belt", "C1061", "21", "--verify"), 0),
        (("stop", "belt"), 0),
        (("stop", "--action", "inhibit", "winder"), 0),
        (("read", "belt", "C9999"), 1),
        (("read", "ghost", "C0150"), 1),
        (("write", "ghost", "C1061", "20"), 1),
        (("read", "nobody", "C0150"), 2),
        (("read", "belt", "C99999999"), 2),
        (("read", "belt"), 2),
        (("write", "belt", "C1061", "much"), 2),
        (("write", "belt", "C0001", "1"), 4),
    ],
    ids=lambda given: str(given) if isinstance(given, int) else " ".join(given),
)
def test_every_ending_of_a_command_has_its_exit_status_and_is_json_if_wanted(
    daemon: Daemon, words: tuple[str, ...], status: int
) -> None:
    ran = daemon.cli(*words, "--json")
    assert ran.status == status, ran.out + ran.err
    assert all(isinstance(said, dict) for said in documents(ran))


def documents(ran: Ran) -> list[Any]:
    """What a command with --json said: one document on standard output, or one a line of errors."""
    assert bool(ran.out) != bool(ran.err)
    return [json.loads(ran.out)] if ran.out else [json.loads(row) for row in ran.err.splitlines()]


def test_a_daemon_that_is_not_there_is_exit_status_3(tmp_path: Path) -> None:
    ran = lecombus("status", "--socket", tmp_path / "nobody.sock", "--json")
    assert ran.status == 3
    assert documents(ran)[0]["status"] == 3


def test_a_write_over_tcp_is_not_permitted(daemon: Daemon) -> None:
    ran = lecombus("write", "--url", http_url(daemon), "belt", "C1061", "20")
    assert ran.status == 4
    assert "Unix socket" in ran.err


def test_what_is_shown_after_a_write_is_never_what_was_read_before_it(daemon: Daemon) -> None:
    assert daemon.cli("write", "belt", "C1061", "20", "--verify").status == 0
    assert daemon.cli("read", "belt", "C1061").out.split("\t")[2] == "20"
    done = daemon.cli("write", "belt", "C1061", "30")
    assert done.out == "belt\tC1061\tdone\t\t\n"


def test_a_value_written_is_read_by_command_and_by_http(daemon: Daemon) -> None:
    verified = daemon.cli("write", "belt", "C1061", "22.5", "--verify", "--json").json()
    assert (verified["outcome"], verified["reading"]["raw"]) == ("verified", "22.5")
    found = daemon.get("/v1/drives/belt/codes/C1061?fresh=true")
    assert (found["value"], found["unit"], found["quality"]) == (22.5, "Hz", "good")


def http_url(daemon: Daemon) -> str:
    text = daemon.roster.read_text()
    return "http://" + text.partition("http: '")[2].partition("'")[0]


# ---- metrics ------------------------------------------------------------------------------------


@pytest.mark.parametrize("accept", ["text/plain", OPENMETRICS])
def test_promtool_takes_the_page_of_a_running_daemon(daemon: Daemon, accept: str) -> None:
    page = httpx2.get(f"{http_url(daemon)}/metrics", headers={"Accept": accept}, trust_env=False)
    assert page.headers["content-type"].startswith(accept.partition(";")[0])
    if accept == OPENMETRICS:
        assert page.text.endswith("\n# EOF\n")
        return  # promtool reads the plain format only; tests/prometheus: Prometheus reads this
    done = subprocess.run(
        [require("promtool"), "check", "metrics"],
        input=page.text, capture_output=True, text=True, timeout=15, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
