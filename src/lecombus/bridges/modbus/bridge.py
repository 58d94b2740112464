"""The Modbus TCP bridge of one line: the follower of the line, the registers, and the server.

It is a client of the daemon, on its Unix socket; the roster says where that is. When the bridge
ends, it gives no lease up: the leases lapse, and the drives stop as `on_lapse` says.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Final, Literal

import anyio
from anyio.abc import TaskGroup

from lecombus.bridges.line_follower import FollowedDrive, LineFollower
from lecombus.bridges.modbus.drive_control import LastWrite, PlcControl, StopControl
from lecombus.bridges.modbus.modbus_server import ModbusServer
from lecombus.bridges.modbus.register_map import (
    DRIVE,
    LINE,
    Command,
    Register,
    RegisterPart,
    place_of,
    sources_of,
)
from lecombus.bridges.modbus.register_values import ModbusError, ModbusException, RegisterReader
from lecombus.client import ClientError, Line, connect
from lecombus.client.finding import try_socket
from lecombus.drives import family
from lecombus.roster import ModbusEntry, Roster

__all__ = ["ModbusBridge", "run_bridge"]

logger = logging.getLogger(__name__)

LOCAL: Final = ("127.0.0.0/8", "::1/128")
ANSWERING: Final = ("online", "degraded")
CONNECT_EVERY_S: Final = 0.5
REPEAT_FOR_S: Final = 0.0
"""A write whose connection broke is not repeated: the PLC decides, by the outcome. A stop is."""

READ_ONLY: Final[Mapping[str, int]] = {
    one.name: 0
    for one in (*LINE, *DRIVE)
    if one.part in (RegisterPart.ALWAYS, RegisterPart.WRITTEN)
}
"""What the registers of control read while there is none."""


class ModbusBridge:
    """What is behind the registers of one line.

    Args:
        roster: The roster; its drives count until the daemon has named them.
        follower: Follows the line.
        tasks: In which leases are held and stops carried out.
    """

    def __init__(self, roster: Roster, follower: LineFollower, tasks: TaskGroup) -> None:
        assert roster.modbus is not None
        self._follower = follower
        self._tasks = tasks
        self._is_controlling = roster.modbus.control
        self._entries = {entry.name: entry for entry in roster.drives}
        self._line: Line | None = None
        self._stop_line: Line | None = None
        self._drives: dict[str, PlcControl] = {}
        self._stop_register = 0
        self._last_stop = LastWrite()
        self._stops = StopControl("all", self.stop_line, tasks, self._last_stop)
        at_start = [
            FollowedDrive(one.name, one.address, one.family) for one in roster.drives
        ]  # fmt: skip
        self._reader = RegisterReader(follower, self, at_start, anyio.current_time)

    async def connect(self) -> None:
        """Connect to the daemon for writing as soon as it is there, and stay connected."""
        while True:
            try:
                async with (
                    connect(self._follower.socket, repeat_for_s=REPEAT_FOR_S) as line,
                    connect(self._follower.socket) as stop_line,
                ):
                    self._line, self._stop_line = line, stop_line
                    await anyio.sleep_forever()
            except ClientError:
                await anyio.sleep(CONNECT_EVERY_S)

    def line(self) -> Line:
        """Return the daemon for writing; `write` has seen that it is there."""
        assert self._line is not None
        return self._line

    def stop_line(self) -> Line:
        """Return the daemon for stops: one whose connection broke is repeated for some seconds."""
        return self.line() if self._stop_line is None else self._stop_line

    # -- for the server ----------------------------------------------------------------------------

    def read(self, first: int, count: int) -> Sequence[int]:
        """Return registers.

        Raises:
            ModbusError: They cannot be read.
        """
        return self._reader.read(first, count)

    def write(self, client: str, first: int, values: Sequence[int]) -> None:
        """Take registers that a client wrote: all of them, or none.

        Raises:
            ModbusError: They cannot be written.
        """
        if not self._is_controlling:
            raise ModbusError(ModbusException.NO_SUCH_FUNCTION)
        address, offset = place_of(first)
        found = written(LINE if address == 0 else DRIVE, offset, values)
        drive = None if address == 0 else self._reader.drive_at(address)
        if address and drive is None:
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        command = found.get("command", found.get("stop all", 0))
        highest = Command.RESET_FAULT if address else Command.INHIBIT
        if not 0 <= command <= highest:
            raise ModbusError(ModbusException.BAD_VALUE)
        if not self._follower.is_connected or self._line is None:
            if Command(command).is_stop:
                self._try_to_stop(client, drive, Command(command))
            raise ModbusError(ModbusException.LECOMBUS_AWAY)
        if drive is None:
            self._write_stop_all(client, command)
        else:
            self._write_drive(client, self._control_of(drive.name), found)

    def _try_to_stop(self, client: str, drive: FollowedDrive | None, command: Command) -> None:
        """Send a stop to a daemon that the follower has lost, in case it is there again.

        The follower finds that out some seconds later, and a stop does not wait for it.
        """
        if self._line is None:
            return
        try:
            try_socket(self._follower.socket)
        except ClientError:
            return
        if drive is None:
            self._write_stop_all(client, int(command))
        else:
            self._control_of(drive.name).write_stop(command, client)

    def _write_stop_all(self, client: str, number: int) -> None:
        before, self._stop_register = self._stop_register, number
        if number:
            self._stops.write(Command(number), before, client)
            for control in self._drives.values():
                control.stopped_with_all()

    def _write_drive(self, client: str, control: PlcControl, found: Mapping[str, int]) -> None:
        command = Command(found["command"]) if "command" in found else None
        if command is not None and command.is_stop:
            control.write_stop(command, client)
        if control.is_busy_for(client):
            if command is None or not command.is_stop or len(found) > 1:
                raise ModbusError(ModbusException.BUSY)
            return
        if "heartbeat" in found:
            control.write_heartbeat(client, found["heartbeat"])
        if "setpoint demand" in found:
            control.write_setpoint(client, found["setpoint demand"])
        if command is not None and not command.is_stop:
            control.write_command(client, command)

    def _control_of(self, drive: str) -> PlcControl:
        if drive not in self._drives:
            self._drives[drive] = PlcControl(
                drive, self.line, self._tasks, self, stop_line=self.stop_line
            )
        return self._drives[drive]

    # -- for the registers -------------------------------------------------------------------------

    def line_registers(self) -> Mapping[str, int]:
        """Return the registers of the line that the writing part knows, by name."""
        return {
            "control": int(self._is_controlling),
            "stop sequence": self._last_stop.sequence,
            "stop command": self._last_stop.command,
            "stop outcome": self._last_stop.outcome,
            "stop reason": self._last_stop.reason,
            "stop all": self._stop_register,
        }

    def drive_registers(self, drive: str) -> Mapping[str, int]:
        """Return the registers of a drive that the writing part knows, by name."""
        return self._control_of(drive).registers() if self._is_controlling else READ_ONLY

    # -- what control depends on -------------------------------------------------------------------

    def is_online(self, drive: str) -> bool:
        """Whether a drive answers."""
        found = self._follower.drives.get(drive)
        return found is not None and found.state in ANSWERING

    def setpoint_unit(self, drive: str) -> Literal["Hz", "%"] | None:
        """Return the unit of a drive's setpoint; None: it takes none."""
        found = self._follower.drives.get(drive)
        unit = "" if found is None else sources_of(family(found.family)).setpoint_unit
        return "Hz" if unit == "Hz" else "%" if unit == "%" else None

    def lease_time_s(self, drive: str) -> float:
        """Return the longest time that a lease of a drive may last, seconds."""
        for one in self._follower.leases.get("drives") or ():
            if one.get("drive") == drive and one.get("time_s"):
                return float(one["time_s"])
        entry = self._entries.get(drive)
        return 2.0 if entry is None else entry.lease.time_s


def written(registers: Sequence[Register], offset: int, values: Sequence[int]) -> dict[str, int]:
    """Return the numbers written to a block, by the names of their registers.

    Raises:
        ModbusError: There are no such registers, or half a number of 32 bits was written.
    """
    layout = {one.offset: one for one in registers if one.part is RegisterPart.WRITTEN}
    found: dict[str, int] = {}
    at = 0
    while at < len(values):
        register = layout.get(offset + at)
        if register is None or at + register.words > len(values):
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        number = values[at]
        if register.words == 2:
            number = (values[at] << 16 | values[at + 1]) - ((values[at] & 0x8000) << 17)
        found[register.name] = number
        at += register.words
    return found


async def run_bridge(
    roster: Roster,
    entry: ModbusEntry,
    started: Callable[[int], Awaitable[None] | None] | None = None,
) -> None:
    """Run the bridge until cancelled.

    Args:
        roster: The roster.
        entry: Its key `modbus`.
        started: Called with the TCP port once connections are taken.

    Raises:
        OSError: The address cannot be listened on.
    """
    follower = LineFollower(roster.api.socket)
    listener = await anyio.create_tcp_listener(local_host=entry.host, local_port=entry.port)
    async with anyio.create_task_group() as tasks, listener:
        bridge = ModbusBridge(roster, follower, tasks)
        server = ModbusServer(bridge, entry.units, entry.allow or LOCAL)
        tasks.start_soon(follower.run)
        if entry.control:
            tasks.start_soon(bridge.connect)
        port = listener.extra(anyio.abc.SocketAttribute.local_port)
        logger.info(
            "line=%s event=modbus-serving host=%s port=%d control=%s",
            roster.line.name, entry.host, port, "yes" if entry.control else "no",
        )  # fmt: skip
        if started is not None:
            started(port)
        await listener.serve(server.serve)
