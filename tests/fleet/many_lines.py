"""Many lines at one broker, from one process: the real bridge of each, and a daemon that is played.

    python -m fleet.many_lines PORT COUNT DRIVES

Each line runs `MqttBridge` with its own connection. What the bridge asks of its daemon is answered
here, from a state that lines on standard input change: `trip LINE DRIVE`, `well LINE DRIVE`,
`offline LINE DRIVE`, `away LINE` (its daemon does not answer). Each is answered by a line `ok`.
"""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import anyio
import anyio.to_thread

from lecombus.bridges.mqtt.bridge import MqttBridge
from lecombus.client import LineStatus, UnreachableError
from lecombus.client.documents import Answer
from support.rosters import make_roster

__all__ = ["PlayedDaemon", "main"]

FAULT = {"kind": "trip", "keypad": "OH", "number": 50, "meaning": "heat sink too hot"}


class PlayedDaemon:
    """What a bridge asks of the daemon of one line.

    Args:
        names: Its drives.
    """

    def __init__(self, names: list[str]) -> None:
        self.is_away = False
        self.drives = {
            name: {
                "drive": name, "address": 11 + at, "family": "8200vector", "state": "online",
                "reason": None, "states": ["enabled"], "fault": None, "remarks": {},
                "motion": {"doing": "running"}, "values": [],
            }
            for at, name in enumerate(names)
        }  # fmt: skip
        self.stops: list[Any] = []
        self.connection = SimpleNamespace(act=self.act)

    @asynccontextmanager
    async def connect(self, socket: str) -> AsyncIterator[Any]:
        if self.is_away:
            raise UnreachableError("no daemon answers")
        yield self

    async def status(self) -> LineStatus:
        return LineStatus.of({"line": "x", "state": "open", "reason": "", "remarks": {}})

    async def ask(self, path: str) -> Answer:
        if self.is_away:
            raise UnreachableError("no daemon answers")
        documents: dict[str, Any] = {
            "/v1/plan": {"roster": {"drives": []}}, "/v1/leases": {"leases": [], "drives": []},
            "/v1/drives": {"drives": [dict(one) for one in self.drives.values()]},
        }  # fmt: skip
        return Answer("", documents[path])

    async def events(self, **more: Any) -> AsyncIterator[Any]:
        await anyio.sleep_forever()
        yield

    async def act(self, method: str, path: str, document: Any, *words: Any, **more: Any) -> Answer:
        self.stops.append(document)
        members = [
            {"drive": name, "code": "C0135", "outcome": "verified", "reason": "it is held"}
            for name in self.drives
        ]
        return Answer("", {"outcome": "verified", "how": "multicast", "members": members})


def play(bridge: MqttBridge, daemon: PlayedDaemon) -> None:
    """Let a bridge ask a played daemon."""
    connect: Any = daemon.connect
    bridge.follower._connect = connect
    bridge._commands._connect = connect


async def serve(port: int, count: int, drives: int) -> None:
    names = [f"drive-{at}" for at in range(drives)]
    daemons: dict[str, PlayedDaemon] = {}
    text = [(name, 11 + at, "8200vector") for at, name in enumerate(names)]
    roster = make_roster(
        text, sections=f"mqtt: {{host: 127.0.0.1, port: {port}, tls: no}}"
    )  # fmt: skip
    async with anyio.create_task_group() as tasks:
        for number in range(count):
            line = f"line-{number:02}"
            daemon = daemons[line] = PlayedDaemon(names)
            own = roster.model_copy(
                update={"line": roster.line.model_copy(update={"name": line}),
                        "api": roster.api.model_copy(update={"socket": "/nowhere"})}
            )  # fmt: skip
            bridge = MqttBridge(own, None)
            play(bridge, daemon)
            tasks.start_soon(bridge.run)
        say_ok()
        while words := (await anyio.to_thread.run_sync(sys.stdin.readline)).split():
            change(words, daemons)
            say_ok()
        tasks.cancel_scope.cancel()


def say_ok() -> None:
    sys.stdout.write("ok\n")
    sys.stdout.flush()


def change(words: list[str], daemons: dict[str, PlayedDaemon]) -> None:
    what, line, *drive = words
    daemon = daemons[line]
    changes: dict[str, Callable[[dict[str, Any]], None]] = {
        "trip": lambda one: one.update(fault=FAULT),
        "well": lambda one: one.update(fault=None, state="online"),
        "offline": lambda one: one.update(state="offline", reason="it does not answer"),
    }
    if what == "away":
        daemon.is_away = True
    else:
        changes[what](daemon.drives[drive[0]])


def main() -> None:
    """Run until standard input ends."""
    port, count, drives = map(int, sys.argv[1:])
    anyio.run(serve, port, count, drives)


if __name__ == "__main__":
    main()
