"""A daemon as far as the control of a drive asks it, on the virtual clock; the client is real."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, Literal

import anyio
import httpx2

from client.conftest import line_of
from lecombus.bridges.modbus.drive_control import PlcControl
from lecombus.bridges.modbus.register_map import Command
from support.virtual_loop import run

LEASE_S = 2.0
PLC = "192.0.2.7"
OTHER_PLC = "192.0.2.8"


class FakeDaemon:
    """Grants leases, and answers verbs and stops as a test says.

    Attributes:
        sent: What was carried out: `enable`, `set-speed 35.4 Hz`, `quick-stop feeder`.
        renewals: When the lease was renewed.
        asked_ago_s: How long ago each `enable` was asked for.
    """

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.renewals: list[float] = []
        self.asked_ago_s: list[float] = []
        self.asked_at_s: list[float] = []
        self.outcome = "verified"
        self.kind = ""
        self.takes_s = 0.0
        self.is_held_by_other = False
        self.is_latched = True
        self.is_stopped = True
        self.is_gone = False
        self._valid_until_s = -1.0
        self._time_s = 0.0
        self._number = 0

    @property
    def token(self) -> str:
        return f"token-{self._number}"

    def leased(self) -> bool:
        return anyio.current_time() < self._valid_until_s

    async def answer(self, request: httpx2.Request) -> httpx2.Response:
        if self.is_gone:
            raise httpx2.ConnectError("gone")
        path, body = request.url.path, json.loads(request.content or b"{}")
        if path == "/v1/groups":
            return httpx2.Response(200, json={"groups": []})
        if path.startswith("/v1/leases/"):
            return self.lease(request.method, body)
        if path == "/v1/stop":
            self.asked_at_s.append(anyio.current_time())
            await anyio.sleep(self.takes_s)
            self.sent.append(f"{body['action']} {body['target']}")
            self.is_stopped = True
            return self.result({"target": body["target"], "how": "one-by-one", "members": []})
        if path.endswith("/enable"):
            self.asked_ago_s.append(float(request.headers["lecombus-asked"]))
        return await self.verb(path, body, request.headers.get("lecombus-lease", ""))

    async def verb(self, path: str, body: dict[str, Any], token: str) -> httpx2.Response:
        _, _, _, drive, _, verb = path.split("/")
        if not self.leased() or token != self.token:
            return self.problem(403, "lease-required")
        if verb == "set-speed" and self.is_latched and not self.is_stopped:
            return self.problem(409, "latched")
        self.asked_at_s.append(anyio.current_time())
        await anyio.sleep(self.takes_s)
        self.sent.append(
            f"{verb} {body['value']:g} {body['unit']}" if verb == "set-speed" else verb
        )
        if verb == "enable" and self.outcome == "verified":
            self.is_latched = False
        return self.result({"drive": drive, "verb": verb})

    def result(self, what: dict[str, Any]) -> httpx2.Response:
        kind = f"urn:lecombus:problem:{self.kind}" if self.kind else None
        status = 200 if self.outcome in ("done", "verified") else 409
        return httpx2.Response(status, json={**what, "outcome": self.outcome, "type": kind})

    def problem(self, status: int, kind: str) -> httpx2.Response:
        document = {"type": f"urn:lecombus:problem:{kind}", "detail": kind, "outcome": "refused"}
        return httpx2.Response(status, json=document)

    def lease(self, method: str, body: dict[str, Any]) -> httpx2.Response:
        now_s = anyio.current_time()
        if method == "DELETE":
            raise AssertionError("a lease is never given up: its drive would run on")
        if "token" in body:
            if body["token"] != self.token or not self.leased():
                return self.problem(409, "lease-lost")
            self.renewals.append(now_s)
            self._valid_until_s = now_s + self._time_s
        elif self.is_held_by_other or self.leased():
            return self.problem(409, "lease-held")
        else:
            self._number += 1
            self._time_s = float(body["time"].removesuffix("ms")) / 1000
            self._valid_until_s, self.is_latched = now_s + self._time_s, True
        return httpx2.Response(200, json={
            "name": "modbus-feeder", "token": self.token, "targets": ["feeder"],
            "drives": ["feeder"], "time_s": self._time_s, "counter": body["counter"],
            "latched": ["feeder"] if self.is_latched else [],
        })  # fmt: skip


class Bench:
    """The control of one drive, a daemon behind it, and a PLC before it."""

    def __init__(self, daemon: FakeDaemon, control: PlcControl, facts: SimpleNamespace) -> None:
        self.daemon = daemon
        self.control = control
        self.facts = facts
        self.count = 0

    def registers(self, *names: str) -> tuple[int, ...]:
        found = self.control.registers()
        return tuple(int(found[name]) for name in names)

    @property
    def command(self) -> tuple[int, ...]:
        return self.registers("command sequence", "command outcome", "command reason")

    @property
    def setpoint(self) -> tuple[int, ...]:
        return self.registers("setpoint sequence", "setpoint outcome", "setpoint reason")

    def beat(self, client: str = PLC) -> None:
        self.count = (self.count + 1) & 0xFFFF
        self.control.write_heartbeat(client, self.count)

    async def cycle(
        self, for_s: float, command: Command = Command.NONE, setpoint: int | None = None,
        *, every_s: float = 0.1, counts: bool = True,
    ) -> None:  # fmt: skip
        """Write as a PLC does in every cycle: heartbeat, setpoint, command."""
        end_s = anyio.current_time() + for_s
        while anyio.current_time() < end_s:
            if counts:
                self.beat()
            else:
                self.control.write_heartbeat(PLC, self.count)
            if setpoint is not None:
                self.control.write_setpoint(PLC, setpoint)
            if command.is_stop:
                self.control.write_stop(command)
            else:
                self.control.write_command(PLC, command)
            await anyio.sleep(every_s)


def on_a_bench(test: Callable[[Bench], Awaitable[None]]) -> None:
    """Run a test with a daemon and the control of its drive `feeder`."""

    async def main() -> None:
        daemon = FakeDaemon()
        unit: Literal["Hz"] = "Hz"
        facts = SimpleNamespace(online=True)
        facts.is_online = lambda drive: facts.online
        facts.setpoint_unit = lambda drive: unit
        facts.lease_time_s = lambda drive: LEASE_S
        line = line_of(httpx2.MockTransport(daemon.answer), repeat_for_s=0.0)
        async with line.connection.http, anyio.create_task_group() as tasks:
            control = PlcControl("feeder", lambda: line, tasks, facts)
            await test(Bench(daemon, control, facts))
            tasks.cancel_scope.cancel()

    run(main())
