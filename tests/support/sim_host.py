"""A host for tests that speaks to a `SimLine` by hand, in pure computed time."""

from __future__ import annotations

from lecombus.fieldbus.lecom.simulator import SimLine
from lecombus.fieldbus.lecom.simulator.wire import PARITY_TABLE, bcc

__all__ = ["Host", "code_field", "read_telegram", "write_telegram"]


def code_field(number: int, subcode: int = 0, *, extended: bool = False) -> bytes:
    """Write a code field. Source: EDB2102EN 8.3.1."""
    if extended:
        return b"!%04X%02X" % (number, subcode)
    page, rest = divmod(number, 790)
    tens, ones = divmod(rest, 10)
    return bytes((tens + 48, ones + page * 10 + 48))


def read_telegram(address: int, number: int, subcode: int = 0, *, extended: bool = False) -> bytes:
    field = code_field(number, subcode, extended=extended)
    return b"\x04%02d" % address + field + b"\x05"


def write_telegram(
    address: int, number: int, text: str, subcode: int = 0, *, extended: bool = False
) -> bytes:
    body = code_field(number, subcode, extended=extended) + text.encode() + b"\x03"
    return b"\x04%02d\x02" % address + body + bytes((bcc(body),))


class Host:
    """Says telegrams and hears answers.

    Attributes:
        now_s: The host's clock; moves when it listens.
        arrivals: (time, bytes) of all that was heard last.
    """

    def __init__(self, line: SimLine) -> None:
        self.line = line
        self.now_s = 100.0
        self.arrivals: list[tuple[float, bytes]] = []

    def say(self, data: bytes, *, raw: bool = False) -> None:
        if self.line.parity and not raw:
            data = data.translate(PARITY_TABLE)
        self.line.receive(data, self.now_s)

    def hear(self, *, until_s: float | None = None) -> bytes:
        """Listen until nothing more is under way, or until a time; bytes as on the port."""
        self.arrivals = []
        while True:
            due_s = self.line.next_event_s()
            if due_s is None or (until_s is not None and due_s > until_s):
                break
            self.now_s = max(self.now_s, due_s)
            data = self.line.poll(self.now_s)
            if data:
                self.arrivals.append((self.now_s, data))
        if until_s is not None:
            self.now_s = until_s
            data = self.line.poll(until_s)
            if data:
                self.arrivals.append((until_s, data))
        return b"".join(data for _, data in self.arrivals)

    def ask(self, data: bytes) -> bytes:
        """Say a telegram and hear the whole answer, parity stripped."""
        self.say(data)
        return bytes(byte & 0x7F for byte in self.hear())

    def read(self, address: int, number: int, subcode: int = 0, *, extended: bool = False) -> str:
        """Read a code; the value's text, "EOT" for an unknown code, "" for silence."""
        answer = self.ask(read_telegram(address, number, subcode, extended=extended))
        field = code_field(number, subcode, extended=extended)
        if not answer:
            return ""
        assert answer[:1] == b"\x02", answer
        assert answer[1 : 1 + len(field)] == field
        if answer[1 + len(field) :] == b"\x04":
            return "EOT"
        assert answer[-2:] == bytes((3, bcc(answer[1:-1])))
        return answer[1 + len(field) : -2].decode()

    def write(
        self, address: int, number: int, text: str, subcode: int = 0, *, extended: bool = False
    ) -> str:
        """Write a code: "ACK", "NAK" or ""."""
        answer = self.ask(write_telegram(address, number, text, subcode, extended=extended))
        return {b"\x06": "ACK", b"\x15": "NAK", b"": ""}[answer]

    def word(self, address: int, number: int) -> int:
        return int(self.read(address, number)[1:], 16)

    def wait(self, seconds: float) -> None:
        """Let time pass; what arrives is dropped."""
        self.hear(until_s=self.now_s + seconds)
        self.line.advance(self.now_s)
