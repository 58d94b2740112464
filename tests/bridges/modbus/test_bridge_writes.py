"""What a write does while the bridge believes that the daemon is away."""

from __future__ import annotations

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
from lecombus.bridges.modbus.register_values import ModbusError, ModbusException
from lecombus.client import UnreachableError
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
    def knock(path: str) -> None:
        if not is_there:
            raise UnreachableError(f"nothing listens at {path}")

    monkeypatch.setattr(bridge_module, "knock", knock)

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
