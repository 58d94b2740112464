"""Modbus TCP with clients: connections, telegrams, function codes; what they read is elsewhere.

Telegrams are coded and decoded by pymodbus; its server is not used (ADR 55). Requests of one
connection are answered one after the other in their order, also those sent without waiting for
answers. Function codes 3, 4, 6 and 16 are known, all others are answered with exception 01. What is
no Modbus TCP ends the connection, because the beginning of the next telegram cannot be found.

Bounds: connections only from allowed addresses and at most `MOST` of them. When there is no room,
the one that was idle longest makes room for the new one (Modbus Messaging on TCP/IP Implementation
Guide 1.0b, 4.2.1.1). A client that does not complete a telegram, or does not read its answers, for
`PATIENCE_S` is disconnected.
"""

from __future__ import annotations

import ipaddress
import logging
import math
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Final, Protocol

import anyio
from anyio.abc import SocketAttribute, SocketStream
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterResponse,
)

from lecombus.bridges.modbus.register_values import ModbusError, ModbusException
from lecombus.errors import LecombusError

__all__ = ["MOST", "ModbusServer", "Registers"]

logger = logging.getLogger(__name__)

MOST: Final = 32
PATIENCE_S: Final = 10.0
REFUSED_EVERY_S: Final = 10.0

HEADER_BYTES: Final = 7
LONGEST_PDU: Final = 253

READ_HOLDING: Final = 3
READ_INPUT: Final = 4
WRITE_ONE: Final = 6
WRITE_SEVERAL: Final = 16
FIXED_BYTES: Final = 5
"""A request that reads, or writes one register."""
WRITE_HEAD_BYTES: Final = 6
MOST_READ: Final = 125
MOST_WRITTEN: Final = 123
LAST_REGISTER: Final = 0xFFFF


class Registers(Protocol):
    """What is behind the registers."""

    def read(self, first: int, count: int) -> Sequence[int]:
        """Return registers.

        Raises:
            ModbusError: They cannot be read.
        """

    def write(self, client: str, first: int, values: Sequence[int]) -> None:
        """Take registers that a client wrote.

        Raises:
            ModbusError: They cannot be written.
        """


class ModbusServer:
    """Answers clients.

    Args:
        registers: What they read and write.
        units: The unit identifiers that are answered; others get exception 0B.
        allow: The addresses and networks that may connect.
        now: The time of `anyio.current_time`, seconds.
    """

    def __init__(
        self,
        registers: Registers,
        units: Iterable[int],
        allow: Iterable[str],
        now: Callable[[], float] = anyio.current_time,
    ) -> None:
        self._registers = registers
        self._units = frozenset(units)
        self._allow = [ipaddress.ip_network(one) for one in allow]
        self._now = now
        self._decoder = DecodePDU(True)
        self._framer = FramerSocket(self._decoder)
        self._refused, self._refused_due_s = 0, -math.inf
        self._failure = ""
        self._connections: dict[SocketStream, _Connection] = {}

    def is_allowed(self, client: str) -> bool:
        """Whether an address may connect."""
        try:
            address = ipaddress.ip_address(client.partition("%")[0])
        except ValueError:
            return False
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        return any((mapped or address) in network for network in self._allow)

    async def serve(self, stream: SocketStream) -> None:
        """Answer one connection until it ends."""
        async with stream:
            client = address_of(stream)
            if not self.is_allowed(client):
                self._say_refused(client)
                return
            await self._make_room()
            with anyio.CancelScope() as scope:
                self._connections[stream] = _Connection(client, scope, self._now())
                try:
                    await self._answer_all(stream, client)
                except (anyio.EndOfStream, anyio.BrokenResourceError, anyio.ClosedResourceError,
                        TimeoutError):  # fmt: skip
                    pass
                finally:
                    del self._connections[stream]

    def _say_refused(self, client: str) -> None:
        """Log that a client was refused, but not as often as it may try."""
        self._refused += 1
        if self._now() >= self._refused_due_s:
            self._refused_due_s = self._now() + REFUSED_EVERY_S
            logger.warning("event=modbus-client-refused client=%s count=%d", client, self._refused)
            self._refused = 0

    def _say_failed(self, error: LecombusError) -> None:
        """Log why a request cannot be answered, once for each reason."""
        if str(error) != self._failure:
            self._failure = str(error)
            logger.error("event=modbus-failed reason=%s", error)

    async def _make_room(self) -> None:
        """End the connection that was idle longest, where there are too many."""
        open_ones = [one for one in self._connections.values() if not one.scope.cancel_called]
        if len(open_ones) >= MOST:
            oldest = min(open_ones, key=lambda one: one.heard_s)
            logger.info("event=modbus-client-ended client=%s reason=%d connections are open",
                        oldest.client, MOST)  # fmt: skip
            oldest.scope.cancel()

    async def _answer_all(self, stream: SocketStream, client: str) -> None:
        data = b""
        while True:
            request, data = await next_request(stream, data)
            self._connections[stream].heard_s = self._now()
            transaction, unit, pdu = request
            answer = self.answer(client, unit, pdu)
            frame = self._framer.encode(
                bytes((answer.function_code,)) + answer.encode(), unit, transaction
            )
            with anyio.fail_after(PATIENCE_S):
                await stream.send(frame)

    def answer(self, client: str, unit: int, pdu: bytes) -> ModbusPDU:
        """Return the answer to one request."""
        try:
            if unit not in self._units:
                raise ModbusError(ModbusException.NOT_FRESH)
            return self._carry_out(client, self._decoded(pdu))
        except ModbusError as exc:
            return ExceptionResponse(pdu[0] & 0x7F, exc.code)
        except LecombusError as exc:  # such as a family that only a newer daemon knows
            self._say_failed(exc)
            return ExceptionResponse(pdu[0] & 0x7F, ModbusException.FAILURE)

    def _decoded(self, pdu: bytes) -> ModbusPDU:
        """Return a request that is whole and within the bounds of the protocol.

        Raises:
            ModbusError: It is not.
        """
        function = pdu[0]
        if function not in (READ_HOLDING, READ_INPUT, WRITE_ONE, WRITE_SEVERAL):
            raise ModbusError(ModbusException.NO_SUCH_FUNCTION)
        if function == WRITE_SEVERAL:
            is_whole = len(pdu) > WRITE_HEAD_BYTES and len(pdu) == WRITE_HEAD_BYTES + pdu[5]
        else:
            is_whole = len(pdu) == FIXED_BYTES
        if not is_whole:
            raise ModbusError(ModbusException.BAD_VALUE)
        most = MOST_WRITTEN if function == WRITE_SEVERAL else MOST_READ
        count = 1 if function == WRITE_ONE else int.from_bytes(pdu[3:5], "big")
        if not 1 <= count <= most or (function == WRITE_SEVERAL and pdu[5] != 2 * count):
            raise ModbusError(ModbusException.BAD_VALUE)
        # Only now: pymodbus logs each request that it cannot decode, which a client could repeat.
        request = self._decoder.decode(pdu)
        if request is None:
            raise ModbusError(ModbusException.BAD_VALUE)
        if request.address + count - 1 > LAST_REGISTER:
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        return request

    def _carry_out(self, client: str, request: ModbusPDU) -> ModbusPDU:
        first = request.address
        if request.function_code == READ_HOLDING:
            return ReadHoldingRegistersResponse(registers=self._read(first, request.count))
        if request.function_code == READ_INPUT:
            return ReadInputRegistersResponse(registers=self._read(first, request.count))
        self._registers.write(client, first, request.registers)
        if request.function_code == WRITE_ONE:
            return WriteSingleRegisterResponse(address=first, registers=request.registers)
        return WriteMultipleRegistersResponse(address=first, count=request.count)

    def _read(self, first: int, count: int) -> Sequence[int]:
        return self._registers.read(first, count)


class _Connection:
    """One connection.

    Args:
        client: The address of its other end.
        scope: Ends it.
        heard_s: When its last request came.
    """

    def __init__(self, client: str, scope: anyio.CancelScope, heard_s: float) -> None:
        self.client = client
        self.scope = scope
        self.heard_s = heard_s


def address_of(stream: SocketStream) -> str:
    """Return the address of a client; empty: it is gone already."""
    try:
        return str(stream.extra(SocketAttribute.remote_address)[0])
    except OSError:
        return ""


async def next_request(stream: SocketStream, data: bytes) -> tuple[tuple[int, int, bytes], bytes]:
    """Wait for a telegram, however long, and for its end no longer than `PATIENCE_S`.

    Args:
        stream: The connection.
        data: What was received of it already.

    Returns:
        As `split`, of a whole telegram.

    Raises:
        anyio.BrokenResourceError: This is no Modbus TCP, or the connection is lost.
        TimeoutError: It does not end in time, however often a part of it comes.
    """
    data = data or await stream.receive(4096)
    with anyio.fail_after(PATIENCE_S):
        while True:
            request, rest = split(data)
            if request is not None:
                return request, rest
            data += await stream.receive(4096)


def split(data: bytes) -> tuple[tuple[int, int, bytes] | None, bytes]:
    """Take the first telegram off what was received.

    Returns:
        Its transaction identifier, unit identifier and PDU, and the rest; None: it is not whole.

    Raises:
        anyio.BrokenResourceError: This is no Modbus TCP.
    """
    if len(data) < HEADER_BYTES:
        return None, data
    transaction, protocol, length, unit = struct.unpack(">HHHB", data[:HEADER_BYTES])
    if protocol != 0 or not 2 <= length <= LONGEST_PDU + 1:
        raise anyio.BrokenResourceError
    end = HEADER_BYTES - 1 + length
    if len(data) < end:
        return None, data
    return (transaction, unit, data[HEADER_BYTES:end]), data[end:]
