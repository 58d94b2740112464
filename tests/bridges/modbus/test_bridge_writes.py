"""What a write does while the bridge believes that the daemon is away."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import anyio
import httpx2
import pytest

from bridges.modbus.fake_daemon import PLC, FakeDaemon
from client.conftest import line_of
from lecombus.bridges.line_follower import LineFollower
from lecombus.bridges.modbus import bridge as bridge_module
from lecombus.bridges.modbus.bridge import ModbusBridge
from lecombus.bridges.modbus.register_map import OUTCOMES
from lecombus.bridges.modbus.register_values import ModbusError, ModbusException
from lecombus.client import Line, UnreachableError
from support.virtual_loop import run

FEEDER_COMMAND, STOP_ALL = 1141, 40
DRIVES = (SimpleNamespace(name="feeder", address=11, family="8200vector"),)
ROSTER: Any = SimpleNamespace(modbus=SimpleNamespace(control=True), drives=DRIVES)


@pytest.mark.parametrize(
    ("register", "command", "is_there", "sent"),
    [
        (FEEDER_COMMAND, 1, True, ["quick-stop feeder"]),
        (FEEDER_COMMAND, 2, True, ["inhibit feeder"]),
        (STOP_ALL, 1, True, ["quick-stop all"]),
        (STOP_ALL, 0, True, []),
        (FEEDER_COMMAND, 3, True, []),
        (FEEDER_COMMAND, 1, False, []),
        (STOP_ALL, 1, False, []),
    ],
)
def test_a_stop_goes_out_once_though_the_follower_has_not_found_the_daemon_again(
    monkeypatch: pytest.MonkeyPatch, register: int, command: int, is_there: bool, sent: list[str]
) -> None:
    def try_socket(path: str) -> None:
        if not is_there:
            raise UnreachableError(f"nothing listens at {path}")

    monkeypatch.setattr(bridge_module, "try_socket", try_socket)

    async def write() -> list[str]:
        daemon = FakeDaemon()
        async with anyio.create_task_group() as tasks:
            bridge = ModbusBridge(ROSTER, LineFollower("/run/x.sock"), tasks)
            line = line_of(httpx2.MockTransport(daemon.answer))
            async with line.connection.http:
                cast(Any, bridge)._line = line
                for _ in range(20):  # a PLC writes in every cycle
                    with pytest.raises(ModbusError) as refused:
                        bridge.write(PLC, register, [command])
                    assert refused.value.code == ModbusException.LECOMBUS_AWAY
                    await anyio.sleep(0.1)
        return daemon.sent

    assert run(write()) == sent


def test_a_stop_of_all_that_is_written_again_later_is_a_new_one() -> None:
    async def write() -> list[str]:
        daemon = FakeDaemon()
        async with anyio.create_task_group() as tasks:
            follower = LineFollower("/run/x.sock")
            follower.is_connected = True
            bridge = ModbusBridge(ROSTER, follower, tasks)
            line = line_of(httpx2.MockTransport(daemon.answer))
            async with line.connection.http:
                cast(Any, bridge)._line = line
                for _ in range(2):
                    for _ in range(10):  # a PLC writes in every cycle
                        bridge.write(PLC, STOP_ALL, [1])
                        await anyio.sleep(0.1)
                    await anyio.sleep(60)
        return daemon.sent

    assert run(write()) == 2 * ["quick-stop all"]


@pytest.mark.parametrize(("register", "sent"), [
    (FEEDER_COMMAND, "quick-stop feeder"), (STOP_ALL, "quick-stop all"),
])  # fmt: skip
def test_a_stop_whose_connection_broke_is_repeated_though_it_was_written_only_once(
    monkeypatch: pytest.MonkeyPatch, register: int, sent: str
) -> None:
    """As when the daemon crashes, and is started again; all else is left to the PLC."""

    async def write() -> tuple[list[str], int]:
        daemon, broken = FakeDaemon(), 3

        async def answer(request: httpx2.Request) -> httpx2.Response:
            nonlocal broken
            if request.url.path == "/v1/stop" and broken:
                broken -= 1
                raise httpx2.ReadError("gone")
            return await daemon.answer(request)

        @asynccontextmanager
        async def connect(socket: str, repeat_for_s: float = 5.0) -> AsyncIterator[Line]:
            line = line_of(httpx2.MockTransport(answer), repeat_for_s=repeat_for_s)
            async with line.connection.http:
                yield line

        monkeypatch.setattr(bridge_module, "connect", connect)
        async with anyio.create_task_group() as tasks:
            follower = LineFollower("/run/x.sock")
            follower.is_connected = True
            bridge = ModbusBridge(ROSTER, follower, tasks)
            tasks.start_soon(bridge.connect)
            await anyio.sleep(0.1)
            bridge.write(PLC, register, [1])
            await anyio.sleep(10)
            found = {**bridge.line_registers(), **bridge.drive_registers("feeder")}
            tasks.cancel_scope.cancel()
        outcome = "stop outcome" if register == STOP_ALL else "command outcome"
        return daemon.sent, found[outcome]

    assert run(write()) == ([sent], OUTCOMES.index("verified"))
