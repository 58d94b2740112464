"""A drive on the line: a model, its address, and how it answers a request.

Strategy: `hear` is given a whole request and the time its last character arrived, and gives the
answer's characters with the time the drive thinks before it speaks. Writes take effect when they
are heard, except with the shortened response (C1921), where they come later and may still fail.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from .families import MODELS
from .families.f82xx import Drive82XX
from .model import Model, Restart
from .parameters import CommError, ExtendedError, Refusal
from .receiver import ReceivedRequest
from .wire import ACK, NAK, read_code_field, unknown_code, value_reply

__all__ = ["LogEntry", "Overrides", "Reply", "SimDrive"]

Overrides = Mapping[int, str] | Mapping[tuple[int, int], str] | Mapping[int | tuple[int, int], str]

_BAUDS: Final = {"0": 9600, "1": 4800, "2": 2400, "3": 1200, "4": 19200}
_SHORT_S: Final = 0.002
"""A shortened response comes immediately; the manual gives no figure."""


@dataclass(slots=True)
class LogEntry:
    """A request that reached the drive; not to be changed (freezing would double its cost).

    Attributes:
        time_s: When its last character arrived.
        kind: `read`, `write` or `group`.
        code: Code number as resolved.
        subcode: Subcode as resolved.
        text: The value written, or read.
        accepted: Whether it was done.
    """

    time_s: float
    kind: str
    code: int
    subcode: int
    text: str
    accepted: bool


@dataclass(slots=True)
class Reply:
    """Seven-bit characters, and after how many seconds the drive begins to send them."""

    data: bytes
    after_s: float


class SimDrive:
    """One drive.

    Args:
        address: 1..99, not ending in 0.
        family: `820x 821x 822x 824x 8200vector 93xx smvector generic`.
        name: For people.
        overrides: Values to start with, by code number or (code, subcode), as wire text.
        spread: How much faster than the manual's time an answer may come, 0..1; random.
        silent_on_bad_write: Answer a bad write with nothing instead of NAK, as some devices do.
        log_size: How many requests `log` remembers; about 0.2 KB each.
        word_as_written: C0135 reads what was last written to it (see `Model`).
        only_changes: Of such a drive, only a change of bit 3 lifts a quick stop (see `Model`).
        digit_of: Which number C0068 of an SMVector shows the tens digit of (see `SMVector`).

    Attributes:
        log: The requests heard, oldest first, bounded.
        heard: How many requests were heard, unbounded.
        model: The drive's inside, for tests.
        present: Whether it is connected and switched on.
        moved: Called when its address or baud rate may have changed; for the line it is on.
    """

    def __init__(
        self,
        address: int,
        family: str,
        name: str = "",
        overrides: Overrides | None = None,
        *,
        spread: float = 0.0,
        silent_on_bad_write: bool = False,
        log_size: int = 1_000,
        word_as_written: bool = False,
        only_changes: bool = False,
        digit_of: str = "lecom",
    ) -> None:
        if not 1 <= address <= 99 or address % 10 == 0:
            raise ValueError(f"address {address} is not a drive address (1..99, not ending in 0)")
        if family not in MODELS:
            raise ValueError(f"no simulated family {family!r}: one of {', '.join(MODELS)}")
        self.name = name or f"drive-{address}"
        self.family = family
        self.model: Model = MODELS[family]()
        self.model.word_as_written = word_as_written or only_changes
        self.model.only_changes = only_changes
        self.model.digit_of = digit_of
        self.present = True
        self.log: deque[LogEntry] = deque(maxlen=log_size)
        self.heard = 0
        self._spread = spread
        self._silent = silent_on_bad_write
        self._address = address
        self._log_size = log_size
        self._baud = 0
        self.generic = family == "generic"
        self.moved: Callable[[], None] = lambda: None
        self._where: tuple[int, int] | None = None
        self._bank: tuple[int, int] | None = None
        codes = (self.model.address_code, self.model.baud_code)
        self.model.params.watch(codes, self._look_again)
        self.model.params.watch((248, 249), self._turn_page)
        if not self.generic:
            self.model.params.set(self.model.address_code, str(address))
        self._preset: set[int | tuple[int, int]] = set()
        for key, value in (overrides or {}).items():
            self.model.preset(key, value)
            self._preset.add(key)

    # Inspection

    @property
    def address(self) -> int:
        """The address it listens to; C0009 or P410 changes it."""
        return (self._where or self._look())[0]

    @property
    def baud(self) -> int:
        """The baud rate it speaks; C0125 or P411 changes it, for its very acknowledgement."""
        return (self._where or self._look())[1]

    def _look(self) -> tuple[int, int]:
        params = self.model.params
        address, baud = self._address, self._baud
        if not self.generic:
            address = int(params.text(self.model.address_code))
        if not self._own_rate:
            baud = _BAUDS[params.text(self.model.baud_code)]
        self._where = address, baud
        return self._where

    def _turn_page(self) -> None:
        self._bank = None

    def _look_again(self) -> None:
        self._where = None
        self.moved()

    @property
    def _own_rate(self) -> bool:
        """Whether no code says its rate: another maker's, or one that no code can name."""
        return self.generic or self._baud not in _BAUDS.values()

    def join(self, baud: int) -> None:
        """Be set to a line's baud rate, as by a person at the keypad, unless it has one already."""
        if self._baud:
            return
        self._baud = baud
        index = {rate: text for text, rate in _BAUDS.items()}.get(baud)
        code = self.model.baud_code
        if index is not None and not self.generic and code not in self._preset:
            self.model.params.set(code, index)
        self._look_again()

    def replacement(self, family: str | None, overrides: Overrides | None) -> SimDrive:
        """Give another drive with this one's name, address and baud rate, new from the maker.

        Args:
            family: Its family; None for the same.
            overrides: Values it has, such as its software in C0200.

        Raises:
            ValueError: No such family, or a code or value it does not know.
        """
        drive = SimDrive(
            self.address, family or self.family, self.name, overrides,
            spread=self._spread, silent_on_bad_write=self._silent, log_size=self._log_size,
            word_as_written=self.model.word_as_written, only_changes=self.model.only_changes,
            digit_of=self.model.digit_of,
        )  # fmt: skip
        drive.join(self.baud)
        return drive

    @property
    def watchdog_fired(self) -> int:
        """How often its watchdog has expired, up to the time last advanced to."""
        return self.model.watchdog_fired

    @property
    def wear(self) -> int:
        """Writes into its EEPROM."""
        return sum(self.model.params.wear.values())

    def text(self, number: int, subcode: int = 0) -> str:
        """What a read of a code would give, without a telegram."""
        return self.model.read(number, subcode)

    # Events

    def advance(self, now_s: float) -> None:
        """Bring it to a time."""
        self.model.advance(now_s)

    def trip(self, number: int, *, stays: bool = False) -> None:
        """Let a fault occur.

        Args:
            number: Its LECOM number; one that the family's manual lists.
            stays: Whether its cause lasts until `clear_fault`, so that no reset helps.

        Raises:
            ValueError: The family has no such fault.
        """
        self.model.trip(number, stays=stays)

    def clear_fault(self) -> None:
        """Take the causes of its faults away; a TRIP still waits for its reset."""
        self.model.clear_fault()

    def factory_reset(self) -> None:
        """Put its stored parameters back to the maker's; the line still reaches it."""
        self.model.factory_reset()

    def set_terminal(self, *, high: bool) -> None:
        """Open or close the contact at its enable terminal (SMVector: network enable)."""
        self.model.set_terminal(high=high)

    def power_cycle(self, now_s: float, off_s: float | None = None) -> None:
        """Switch it off and on; module settings are lost."""
        self.model.power_cycle(now_s, off_s)

    def interrupted(self, error: CommError = CommError.INTERRUPTED) -> None:
        """A new EOT has cut off what it was doing."""
        self.model.comm_error = error

    # Telegrams

    def hear(
        self, heard: ReceivedRequest, now_s: float, rng: random.Random, *, nak_reads: bool = False
    ) -> Reply | None:
        """Take a request to its own address.

        Args:
            heard: The request.
            now_s: When its last character arrived.
            rng: Decides the spread of the answer time.
            nak_reads: Say NAK to a read that it cannot carry out (CMVLC401A 6.1 beside 6.3).

        Returns:
            The answer; None when it stays silent.
        """
        model = self.model
        model.advance(now_s)
        if now_s < model.deaf_until_s or not model.listens():
            return None
        if model.standard_only and heard.field[:1] == b"!":
            return None
        if heard.damaged:
            return self._complain(heard, nak_reads=nak_reads)
        model.feed(now_s)
        code = read_code_field(heard.field)
        number, subcode = self._resolve(code) if code else (-1, 0)
        before = model.comm_error
        model.comm_error = before if number == 68 and heard.text is None else CommError.NONE
        if heard.text is None:
            reply = self._read(heard.field, number, subcode, now_s)
            if nak_reads and reply.data == unknown_code(heard.field):
                reply = Reply(bytes((NAK,)), reply.after_s)
            return self._spread_out(reply, rng)
        return self._spread_out(self._write(heard.text, number, subcode, now_s), rng)

    def takes_after_s(
        self, heard: ReceivedRequest, now_s: float, rng: random.Random
    ) -> float | None:
        """How long a write is processed by a drive that takes it at the end of that.

        Returns:
            Seconds; None: it does not hear.
        """
        model = self.model
        model.advance(now_s)
        if now_s < model.deaf_until_s or not model.listens():
            return None
        if model.standard_only and heard.field[:1] == b"!":
            return None
        if isinstance(model, Drive82XX) and model.shortened():
            return _SHORT_S
        code = read_code_field(heard.field)
        number, _ = self._resolve(code) if code else (-1, 0)
        after_s = model.think_s(number, write=True, now_s=now_s)
        return after_s * (1.0 - self._spread * rng.random())

    def hear_group(self, heard: ReceivedRequest, now_s: float) -> None:
        """Take a write to a group it belongs to: done or not, never answered, feeds nothing.

        Whether a multicast feeds a watchdog is stated nowhere; the simulator takes the worse case.
        """
        self.advance(now_s)
        if now_s < self.model.deaf_until_s or not self.model.listens() or heard.text is None:
            return
        if heard.damaged:
            self.model.comm_error = CommError.CHECKSUM
            return
        code = read_code_field(heard.field)
        number, subcode = self._resolve(code) if code else (-1, 0)
        self._try_write(heard.text, number, subcode, now_s, "group")

    def refuse(self, now_s: float) -> Reply:
        """Answer NAK without a reason; the fault `nak`."""
        self.advance(now_s)
        self.model.feed(now_s)
        self.model.comm_error = CommError.GENERAL
        return Reply(bytes((NAK,)), self.model.think_s(-1, write=True, now_s=now_s))

    def _resolve(self, code: tuple[int, int, bool]) -> tuple[int, int]:
        """Apply code bank and input selection. Source: EDB2102EN 8.3.1, 8.2 (C0248, C0249)."""
        number, subcode, extended = code
        if extended or not self.model.banked or number in (248, 249):
            return number, subcode
        if self._bank is None:
            params = self.model.params
            self._bank = 250 * int(params.text(249)), int(params.text(248))
        offset, selected = self._bank
        return number + offset, selected

    def _complain(self, heard: ReceivedRequest, *, nak_reads: bool) -> Reply:
        """Parity or block check wrong: `?` to a read, NAK to a write.

        Source: EDB2102EN 8.3; CMVLC401A 6.1 (NAK, also after ENQ), 6.3 (`?`).
        """
        self.model.comm_error = CommError.CHECKSUM
        self.model.extended_fault = ExtendedError.PARITY
        asks = heard.text is None and not nak_reads
        data = value_reply(heard.field, "?") if asks else bytes((NAK,))
        return Reply(data, self.model.think_s(-1, write=False, now_s=0.0))

    def _read(self, field: bytes, number: int, subcode: int, now_s: float) -> Reply:
        think_s = self.model.think_s(number, write=False, now_s=now_s)
        try:
            text = self.model.read(number, subcode)
        except Refusal as refusal:
            self._note(refusal)
            self._remember(LogEntry(now_s, "read", number, subcode, "", False))
            return Reply(unknown_code(field), think_s)
        self._remember(LogEntry(now_s, "read", number, subcode, text, True))
        return Reply(value_reply(field, text), think_s)

    def _write(self, text: str, number: int, subcode: int, now_s: float) -> Reply | None:
        model = self.model
        if isinstance(model, Drive82XX) and model.shortened():
            wait_s = model.shortened_s
            model.deaf_until_s = now_s + wait_s
            at_s = now_s + wait_s
            model.later(at_s, lambda: self._try_write(text, number, subcode, at_s, "write"))
            return Reply(bytes((ACK,)), _SHORT_S)
        think_s = model.think_s(number, write=True, now_s=now_s)
        done = self._try_write(text, number, subcode, now_s, "write")
        if done is None or (not done and self._silent):
            return None
        return Reply(bytes((ACK if done else NAK,)), think_s)

    def _try_write(
        self, text: str, number: int, subcode: int, now_s: float, kind: str
    ) -> bool | None:
        """Write, and remember it; None: the drive restarts, and says nothing."""
        entry = LogEntry(now_s, kind, number, subcode, text, True)
        self._remember(entry)
        try:
            self.model.write(number, subcode, text, now_s)
        except Refusal as refusal:
            self._note(refusal)
            entry.accepted = False
        except Restart:
            self.power_cycle(now_s)
            return None
        return entry.accepted

    def _remember(self, entry: LogEntry) -> None:
        self.heard += 1
        self.log.append(entry)

    def _note(self, refusal: Refusal) -> None:
        self.model.comm_error = refusal.error
        self.model.extended_fault = refusal.fault

    def _spread_out(self, reply: Reply | None, rng: random.Random) -> Reply | None:
        if reply is not None and self._spread:
            reply.after_s *= 1.0 - self._spread * rng.random()
        return reply
