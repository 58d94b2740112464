"""The two ways in which a scan reaches a line: a port of its own, or a running daemon.

Both call `watch` before every question and at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import anyio

from lecombus.cli.client import Daemon
from lecombus.cli.own_line import OwnPort, own_port
from lecombus.config import LineEntry
from lecombus.operations.address_reads import read_address
from lecombus.protocol.values import Value
from lecombus.scanning import Ask, Heard, HeardKind, Scan
from lecombus.schedule import Priority

__all__ = ["scan_by_daemon", "scan_own_port"]

Watch = Callable[[], None]


async def scan_own_port(scan: Scan, line: LineEntry, watch: Watch) -> int:
    """Scan on a port of our own, reopened for every baud rate.

    Args:
        scan: The search.
        line: Port, parity and direction; its baud rate is not used.
        watch: Called before every question and at the end.

    Returns:
        How many bytes were received, echoes included.

    Raises:
        LineError: The port cannot be used, or another master speaks on the line.
    """
    async with own_port(line, retries=0) as port:
        try:
            await scan.run(_OnOwnPort(port, watch))
        finally:
            watch()
        return port.bytes_heard


def scan_by_daemon(scan: Scan, daemon: Daemon, watch: Watch) -> None:
    """Scan through a running daemon, which asks in its background class.

    Raises:
        CommandError: The daemon cannot be reached, or does not ask.
    """
    work = scan.run(_ByDaemon(daemon, watch))
    try:
        work.send(None)  # its questions block in HTTP, so that no event loop is needed
    except StopIteration:
        return
    finally:
        watch()


@dataclass(frozen=True, slots=True)
class _OnOwnPort:
    """`AddressAccess` on a port of our own."""

    port: OwnPort
    watch: Watch

    async def ask(self, ask: Ask) -> Heard:
        """Read a code at an address, once."""
        self.watch()
        own = await self.port.at(ask.baud)
        heard = await read_address(
            own.requests,
            ask.address,
            ask.code,
            form=ask.form,
            family_name=ask.family,
            patient=ask.patient,
            priority=Priority.INTERACTIVE,
            disturbances=lambda: own.disturbances,
        )
        return replace(heard, received=own.take_strays() + heard.received)

    async def listen(self, baud: int, for_s: float) -> Heard:
        """Send nothing for some seconds; return what was heard."""
        own = await self.port.at(baud)
        await anyio.sleep(for_s)
        return Heard(HeardKind.SILENCE, received=own.take_strays(), disturbances=own.disturbances)


@dataclass(frozen=True, slots=True)
class _ByDaemon:
    """`AddressAccess` through a running daemon."""

    daemon: Daemon
    watch: Watch

    async def ask(self, ask: Ask) -> Heard:
        """Read a code at an address, once."""
        self.watch()
        answer: dict[str, Any] = self.daemon.get(
            f"/v1/line/addresses/{ask.address}/codes/{ask.code}",
            addressing=ask.form.value,
            family=ask.family,
            patient="true" if ask.patient else "false",
        ).data
        raw = answer.get("raw")
        return Heard(
            HeardKind(answer["heard"]),
            None if raw is None else Value.parse(str(raw)),
            bytes.fromhex(answer.get("received") or ""),
            int(answer.get("disturbances") or 0),
        )

    async def listen(self, baud: int, for_s: float) -> Heard:
        """A daemon has listened to its line already."""
        return Heard(HeardKind.SILENCE)
