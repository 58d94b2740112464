"""`lecombus fleet` with a real broker: fifty lines, two of them whole, and what befalls them."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from lecombus.cli import main
from support.daemon_host import (
    SRC,
    Daemon,
    Ran,
    command,
    environment,
    running,
    short_dir,
    until,
)
from support.mqtt_parts import Bridge, Broker, bridge, broker
from support.real_parts import require
from support.rosters import Wanted, roster_text

pytestmark = [pytest.mark.real, pytest.mark.timeout(120)]

DRIVES: tuple[Wanted, ...] = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))
PLAYED, EACH = 48, 5


class Lines:
    """The process of the played lines."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, *words: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(words) + "\n")
        self.process.stdin.flush()
        self.heard()

    def heard(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ok\n"


@contextmanager
def played(port: int, count: int = PLAYED) -> Iterator[Lines]:
    """Lines with real bridges and played daemons."""
    path = os.pathsep.join((str(SRC), str(SRC.parent / "tests")))
    words = [sys.executable, "-m", "fleet.many_lines", str(port), str(count), str(EACH)]
    process = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=environment(PYTHONPATH=path),
    )  # fmt: skip
    try:
        lines = Lines(process)
        lines.heard()
        yield lines
    finally:
        process.kill()
        process.communicate()


@contextmanager
def whole_line(
    folder: Path, port: int, name: str, more: str = ""
) -> Iterator[tuple[Daemon, Bridge]]:
    """A real daemon with simulated drives, and its real bridge."""
    place = folder / name
    place.mkdir()
    text = roster_text(
        DRIVES, name=name, folder=place,
        sections=f"mqtt: {{host: 127.0.0.1, port: {port}, tls: no{more}}}",
    )  # fmt: skip
    with running(text, place) as daemon, bridge(place) as its_bridge:
        yield daemon, its_bridge


@contextmanager
def following(folder: Path, port: int) -> Iterator[Callable[[], dict[str, Any]]]:
    """`lecombus fleet --json`, read along: gives the last status of each line by its name."""
    words = command("fleet", "--json", "--broker", f"mqtt://127.0.0.1:{port}")
    file = folder / "fleet.jsonl"
    with file.open("wb") as out:
        process = subprocess.Popen(words, stdout=out, stderr=out, env=environment())

    def last() -> dict[str, Any]:
        assert process.poll() is None, file.read_text()
        rows = file.read_text().splitlines(keepends=True)
        said = [json.loads(row) for row in rows if row.endswith("\n")]
        return {one.get("line", "broker"): one for one in said}

    try:
        yield last
    finally:
        process.kill()
        process.wait()


def fleet(port: int, *words: str | Path, user: str = "") -> Ran:
    """`lecombus fleet` to its end, in this process: a start takes longer than all it does."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        url = f"mqtt://{user}127.0.0.1:{port}"
        status = main(["fleet", "--broker", url, *map(str, words)])
    return Ran(status, out.getvalue(), err.getvalue())


def statuses(found: dict[str, Any]) -> dict[str, str]:
    return {name: one["status"] for name, one in found.items() if name != "broker"}


def not_ok(found: dict[str, Any]) -> dict[str, str]:
    return {name: status for name, status in statuses(found).items() if status != "ok"}


def test_fifty_lines_of_which_some_need_attention() -> None:
    with ExitStack() as stack:
        folder = stack.enter_context(short_dir())
        hub = stack.enter_context(broker(folder))
        seen = stack.enter_context(following(folder, hub.port))
        whole = {name: stack.enter_context(whole_line(folder, hub.port, name))
                 for name in ("hall-a", "hall-b")}  # fmt: skip
        lines = stack.enter_context(played(hub.port))
        until(lambda: len(statuses(seen())) == 50 and not not_ok(seen()), "50 lines are ok",
              within_s=40)  # fmt: skip
        ran = fleet(hub.port, "--once", "--json")
        assert (ran.status, ran.json()["counts"]) == (0, {"lines": 50, "ok": 50, "attention": 0})
        assert ran.json()["drives"] == {"online": 2 * 2 + PLAYED * EACH}

        lines.tell("trip", "line-07", "drive-2")
        lines.tell("offline", "line-08", "drive-0")
        lines.tell("away", "line-09")
        whole["hall-b"][1].process.kill()
        wanted = {"line-07": "trip", "line-08": "drive-offline", "line-09": "daemon-away",
                  "hall-b": "bridge-offline"}  # fmt: skip
        until(lambda: not_ok(seen()) == wanted, "four lines need attention", within_s=30)
        ran = fleet(hub.port, "--once")
        assert ran.status == 1
        rows = [row.split("\t") for row in ran.out.splitlines()]
        assert [row[:4] for row in rows[:4]] == [
            ["hall-b", "bridge offline", "", "its bridge is not connected to the broker"],
            ["line-09", "daemon away", "", "no daemon answers"],
            ["line-07", "trip", "drive-2", "trip OH (50): heat sink too hot"],
            ["line-08", "drive offline", "drive-0", "it does not answer"],
        ]
        assert [rows[3][5], rows[0][5]] == ["4 online, 1 offline", "2 unknown"]
        assert {row[1] for row in rows[4:]} == {"ok"}
        assert len(rows) == 50

        stops(hub, whole["hall-a"][0])
        broker_restarts(hub, seen, wanted)
        with played(hub.port, 1):  # a second line-00: each takes the connection from the other
            until(lambda: statuses(seen())["line-00"] == "name-clash", "the clash is found")


def stops(hub: Broker, daemon: Daemon) -> None:
    """Stop lines by name: one that is whole, one that is played, one without a bridge."""
    assert daemon.cli("enable", "feeder").status == 0
    ran = fleet(hub.port, "stop", "hall-a", "line-01", "hall-b", "nowhere")
    assert ran.status == 1
    assert ran.err == (
        "2 of 4 lines did not confirm the quick stop of every drive: motors may still turn, use "
        "the emergency stop circuit\n"
    )
    rows = [row.split("\t") for row in ran.out.splitlines()]
    outcomes = {(row[0], row[1]): row[3] for row in rows}
    assert outcomes == {
        ("hall-a", "feeder"): "verified", ("hall-a", "belt"): "verified",
        **{("line-01", f"drive-{at}"): "verified" for at in range(EACH)},
        ("hall-b", ""): "refused", ("nowhere", ""): "refused",
    }  # fmt: skip
    until(lambda: "quick-stop" in stopped_by(daemon, "feeder"), "the feeder is stopped")
    ran = fleet(hub.port, "stop", "hall-a", "--target", "feeder", "--action", "inhibit", "--json")
    (said,) = ran.json()["stops"]
    assert (ran.status, said["outcome"], said["answer"]["target"]) == (0, "verified", "feeder")
    ran = fleet(hub.port, "stop", "hall-a", "--target", "nix")
    assert ran.status == 1
    assert "there is no drive and no group 'nix'" in ran.out
    everything = fleet(hub.port, "stop", "--all", "--json").json()["stops"]
    assert len(everything) == 50
    assert {one["line"] for one in everything if one["outcome"] != "verified"} == {
        "hall-b", "line-09"
    }  # fmt: skip


def stopped_by(daemon: Daemon, drive: str) -> list[str]:
    found = next(one for one in daemon.get("/v1/drives")["drives"] if one["drive"] == drive)
    return [one["name"] for one in found["motion"]["stops"]]


def broker_restarts(
    hub: Broker, seen: Callable[[], dict[str, Any]], wanted: dict[str, str]
) -> None:
    """Nothing is known while the broker is away; then every line is shown again."""
    hub.end(kill=True)
    until(lambda: set(statuses(seen()).values()) == {"unknown"}, "nothing is known")
    assert seen()["broker"]["connected"] is False
    assert seen()["line-00"]["drives"] == {"unknown": EACH}
    ran = fleet(hub.port, "--once")
    assert (ran.status, ran.out) == (3, "")
    assert "connection refused; is the broker running" in ran.err
    ran = fleet(hub.port, "stop", "hall-a")
    assert ran.status == 3
    assert ran.err.startswith("no drive has confirmed the quick stop: motors may still turn")
    hub.start()
    until(lambda: not_ok(seen()) == wanted, "the lines are back", within_s=40)


def test_a_bridge_that_stands_is_not_shown_as_fine() -> None:
    """Its connection is there, and what stands at the broker says `online`."""
    with short_dir() as folder, broker(folder) as hub, hub.client() as client:
        client.publish("lecombus/a/state", "online", retain=True)
        summary = {"bridge": "x", "state": "online", "stands_s": 30, "drives": {"online": 1},
                   "attention": []}  # fmt: skip
        text = json.dumps(summary)
        client.publish("lecombus/a/summary", text, retain=True, expiry_s=2)
        client.publish("lecombus/b/state", "online", retain=True)
        client.publish("lecombus/b/summary", text, retain=True)  # for ever, of any age
        client.publish("lecombus/lamp/state", "ON", retain=True)
        client.publish("lecombus/c d/state", "online", retain=True)
        client.publish("lecombus/e/state", "online", retain=True)
        client.publish("lecombus/e/summary", b"\x00\xff{", retain=True, expiry_s=30)
        first = fleet(hub.port, "--once", "--json").json()
        assert statuses({one["line"]: one for one in first["lines"]}) == {
            "a": "ok", "b": "no-news", "e": "no-news",
        }  # fmt: skip
        (folder / "lines").write_text("a  # the first\n\nb\nz\n")

        def second() -> bool:
            ran = fleet(hub.port, "--once", "--expect", folder / "lines")
            words = [row.split("\t")[:2] for row in ran.out.splitlines()]
            return (ran.status, words) == (
                1, [["z", "missing"], ["a", "no news"], ["b", "no news"], ["e", "no news"]]
            )  # fmt: skip

        until(second, "the broker has dropped the summary of a")


ACCESS = """\
user watcher
topic read lecombus/+/state
topic read lecombus/+/summary
topic read lecombus-fleet/#
user stopper
topic read lecombus/+/state
topic read lecombus-fleet/#
topic write lecombus/+/all/do/quick-stop
user deaf
topic write lecombus/+/all/do/quick-stop
user line
topic readwrite lecombus/line-00/#
topic write lecombus-fleet/#
"""


def test_who_may_stop_is_decided_by_the_broker() -> None:
    with short_dir() as folder:
        passwords = folder / "passwords"
        passwords.touch(mode=0o600)
        for user in ("watcher", "stopper", "deaf", "line"):
            subprocess.run(
                [require("mosquitto_passwd"), "-b", passwords, user, "secret"], check=True,
                capture_output=True,
            )  # fmt: skip
        (folder / "access").write_text(ACCESS)
        for name in ("secret", "wrong"):
            (folder / name).touch(mode=0o600)
            (folder / name).write_text(f"{name}\n")
        more = f"password_file {passwords}\nacl_file {folder / 'access'}"
        with broker(folder, more=more, anonymous=False) as hub:
            login = f", username: line, password_file: '{folder / 'secret'}'"
            with whole_line(folder, hub.port, "line-00", login) as (daemon, _):
                daemon.until_online()

                def ask(user: str, *words: str, secret: str = "secret") -> Ran:
                    file = folder / secret
                    return fleet(hub.port, *words, "--password-file", file, user=f"{user}@")

                until(lambda: ask("watcher", "--once").status == 0, "the watcher sees it well")
                ran = ask("watcher", "stop", "line-00")
                assert ran.status == 4
                assert "the broker does not let this user publish it" in ran.out
                assert "did not confirm the quick stop" in ran.err
                assert ask("stopper", "stop", "line-00").status == 0
                ran = ask("stopper", "stop", "line-00", "--action", "inhibit")
                assert ran.status == 4
                ran = ask("deaf", "stop", "line-00", "--within", "1s")
                assert ran.status == 1
                assert "it is not known whether it was carried out" in ran.out
                assert ask("deaf", "--once").status == 1
                ran = ask("stopper", "stop", "line-00", secret="wrong")
                assert ran.status == 4
                assert "no drive has confirmed" in ran.err
