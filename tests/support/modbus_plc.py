"""A Modbus TCP client made by hand, as a PLC has one; shares no code with the bridge.

Telegrams by the Modbus Application Protocol 1.1b3 and the Messaging on TCP/IP Guide 1.0b.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

HEAD = struct.Struct(">HHHB")


class ModbusRefusedError(Exception):
    """The answer is an exception.

    Args:
        code: Which one.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code:02X}")
        self.code = code


class ModbusClient:
    """One connection.

    Args:
        port: Of the bridge.
        unit: The unit identifier.
        source: The address to connect from.
    """

    def __init__(self, port: int, unit: int = 1, source: str = "127.0.0.1") -> None:
        self.unit = unit
        self.transaction = 0
        self.socket = socket.create_connection(
            ("127.0.0.1", port), timeout=10.0, source_address=(source, 0)
        )

    def close(self) -> None:
        self.socket.close()

    def frame(self, pdu: bytes) -> bytes:
        self.transaction = (self.transaction + 1) & 0xFFFF
        return HEAD.pack(self.transaction, 0, len(pdu) + 1, self.unit) + pdu

    def receive(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.socket.recv(count - len(data))
            if not part:
                raise ConnectionError("the bridge closed the connection")
            data += part
        return data

    def answer(self) -> tuple[int, bytes]:
        """Return the transaction identifier and the PDU of the next answer."""
        transaction, protocol, length, unit = HEAD.unpack(self.receive(HEAD.size))
        assert (protocol, unit) == (0, self.unit)
        return transaction, self.receive(length - 1)

    def ask(self, pdu: bytes) -> bytes:
        """Send a request, and return the answer behind its function code."""
        self.socket.sendall(self.frame(pdu))
        transaction, found = self.answer()
        assert transaction == self.transaction
        if found[0] & 0x80:
            assert (found[0] & 0x7F, len(found)) == (pdu[0], 2)
            raise ModbusRefusedError(found[1])
        assert found[0] == pdu[0]
        return found[1:]

    def read(self, first: int, count: int = 1, function: int = 3) -> list[int]:
        data = self.ask(struct.pack(">BHH", function, first, count))
        assert data[0] == 2 * count == len(data) - 1
        return list(struct.unpack(f">{count}H", data[1:]))

    def refused(self, first: int, count: int = 1, function: int = 3) -> int:
        """Return the exception that a read is answered with; 0: it is answered."""
        try:
            self.read(first, count, function)
        except ModbusRefusedError as exc:
            return exc.code
        return 0

    def signed(self, first: int) -> int:
        high, low = self.read(first, 2)
        number: int = struct.unpack(">i", struct.pack(">HH", high, low))[0]
        return number

    def write(self, first: int, *values: int) -> None:
        pdu = struct.pack(">BHHB", 16, first, len(values), 2 * len(values))
        assert self.ask(pdu + struct.pack(f">{len(values)}H", *values)) == struct.pack(
            ">HH", first, len(values)
        )

    def write_one(self, first: int, value: int) -> None:
        assert self.ask(struct.pack(">BHH", 6, first, value)) == struct.pack(">HH", first, value)


def halves(number: int) -> tuple[int, int]:
    """Return a number as two registers, the high word first."""
    high, low = struct.unpack(">HH", struct.pack(">i", number))
    return high, low


@dataclass
class Outputs:
    """What the program of a PLC writes in every cycle: heartbeat, command, setpoint."""

    command: int = 0
    setpoint: int = 0
    count: int = 0
    is_counting: bool = True

    def values(self) -> Sequence[int]:
        if self.is_counting:
            self.count = (self.count + 1) & 0xFFFF
        return (self.count, self.command, *halves(self.setpoint))


@contextmanager
def cycling(port: int, first: int, every_s: float = 0.1, command: int = 0) -> Iterator[Outputs]:
    """Run a PLC that writes four registers of a drive in every cycle, from `first` on."""
    outputs, ends = Outputs(command), threading.Event()
    client = ModbusClient(port)

    def run() -> None:
        while not ends.wait(every_s):
            try:
                client.write(first, *outputs.values())
            except ModbusRefusedError:
                pass
            except OSError:
                return

    thread = threading.Thread(target=run, name="plc", daemon=True)
    thread.start()
    try:
        yield outputs
    finally:
        ends.set()
        thread.join(5.0)
        client.close()
