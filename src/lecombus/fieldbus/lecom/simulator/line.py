"""A line with drives on it: bytes in, bytes out, time as an argument.

Theory of operation. The host's bytes travel one character time each and are heard by all drives
when they have arrived. A drive that was asked thinks, then speaks; its characters travel too.
Three queues hold what is under way, each ordered by time: `_incoming` (host to drives), `_events`
(a drive begins to speak, an adapter lets an answer through), `_outbox` (bytes to the host).
`_run` works them off in the order of time: how often or how late it is called does not matter.
A whole undisturbed request is processed in one step, when its last character arrives;
where its single characters matter (echo, drives that think or speak, damage, pieces of a telegram)
each is processed by itself. Host and drives see no difference.

A good EOT drops what a drive is thinking about and cuts off what it is saying. The host speaking
while a drive speaks is a collision: counted, and what the drive says from then on is garbled.
Unpaced, characters take no time and answers come whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import Enum, auto
from heapq import heappop, heappush
from typing import Final

from .drive import Overrides, Reply, SimDrive
from .faults import TWIN_S, Faults, LateKind, Spoiler, parse_faults
from .outbox import Outbox, Speech
from .parameters import CommError
from .receiver import ReceivedRequest, RequestReceiver

__all__ = ["SimLine", "build"]

_BITS: Final = 10
"""A character: start bit, 7 data bits, parity, stop bit. Source: EDB2102EN 3.2."""


_NOBODY: Final[list[SimDrive]] = []


class _Event(Enum):
    TAKE = auto()
    SPEAK = auto()
    LET_THROUGH = auto()
    COPY = auto()


class SimLine:
    """The line.

    Args:
        drives: The drives on it, each address once.
        baud: 1200..19200 bit/s.
        faults: Faults switched on; the object may be changed at any time.
        seed: Where all chance starts from.
        parity: Whether bytes in and out carry even parity in bit 7 (an 8N1 port).
        paced: Whether characters take their time.
        think_scale: Factor on the drives' processing times; 0 answers immediately.

    Attributes:
        faults: The line's faults.
        drive_faults: Faults of single drives by address, instead of the line's.
        collisions: How often the host spoke while a drive was speaking.
        clashes: How often two drives sent simultaneously, which only stubborn late ones do.
        aborted: How often an EOT made a drive drop or cut off an answer.
        requests: Whole requests heard on the line.
        host_baud: What the host's port is set to; drives that speak at another rate do not
            understand it. The line's own, unless an end knows better.
        on_request: Called with time and request whenever one was heard; for benches and tests.
        on_answer: Called with drive, begin and end of its characters whenever one begins to
            speak, before anything cuts it short; for benches and tests.
    """

    def __init__(
        self,
        drives: Sequence[SimDrive],
        *,
        baud: int,
        faults: Faults | None = None,
        seed: int = 0,
        parity: bool = True,
        paced: bool = True,
        think_scale: float = 1.0,
    ) -> None:
        addresses = [drive.address for drive in drives]
        twice = {address for address in addresses if addresses.count(address) > 1}
        if twice:
            raise ValueError(f"addresses given twice: {sorted(twice)}")
        for drive in drives:
            drive.join(baud)
            drive.moved = self._look_again
        self._by_address: dict[int, list[SimDrive]] | None = None
        self.drives = tuple(drives)
        self.baud = baud
        self.faults = faults if faults is not None else Faults()
        self.drive_faults: dict[int, Faults] = {}
        self.parity = parity
        self.paced = paced
        self.collisions = 0
        self.clashes = 0
        self.aborted = 0
        self.requests = 0
        self.on_request: Callable[[float, ReceivedRequest], None] | None = None
        self.on_answer: Callable[[SimDrive, float, float], None] | None = None
        self._think_scale = think_scale
        self._host_baud = baud
        self._char_s = _BITS / baud if paced else 0.0
        self._spoiler = Spoiler(seed, parity=parity)
        self._outbox = Outbox(self._spoiler)
        self._listener = RequestReceiver(parity=parity)
        self._incoming: deque[tuple[float, int, int, ReceivedRequest | None]] = deque()
        self._host_free_s = 0.0
        self._events: list[tuple[float, int, _Event, Speech]] = []
        self._count = 0
        self._thinking: list[Speech] = []
        self._speaking: list[Speech] = []
        self._to_host_free_s = 0.0

    def __getitem__(self, name: str | int) -> SimDrive:
        """Find a drive by its name or its present address."""
        for drive in self.drives:
            if name in (drive.name, drive.address):
                return drive
        raise KeyError(name)

    @property
    def host_baud(self) -> int:
        """What the host's port is set to, bit/s."""
        return self._host_baud

    @host_baud.setter
    def host_baud(self, baud: int) -> None:
        self._host_baud = baud
        self._char_s = _BITS / baud if self.paced else 0.0

    def swap(
        self,
        name: str | int,
        now_s: float,
        family: str | None = None,
        overrides: Overrides | None = None,
    ) -> SimDrive:
        """Put another drive in a drive's place, with its address and baud rate set.

        Args:
            name: The old one's name or address.
            now_s: When it is switched on.
            family: The new one's family; None for the same.
            overrides: Values the new one has, by code number or (code, subcode), as wire text.

        Raises:
            KeyError: No such drive.
            ValueError: No such family, or it does not know a code or value.
        """
        self._run(now_s)
        old = self[name]
        new = old.replacement(family, overrides)
        for speech in (*self._thinking, *self._speaking):
            if speech.drive is old:
                speech.cut_at_s = now_s
        self.drives = tuple(new if drive is old else drive for drive in self.drives)
        new.moved = self._look_again
        self._look_again()
        new.power_cycle(now_s)
        return new

    # The two directions

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes the host has handed to its port.

        Args:
            data: The bytes.
            now_s: When, monotonic seconds, never earlier than in an earlier call.
        """
        if self._incoming or self._events:
            self._run(now_s)
        if self.faults.unplugged:
            return
        heard, echo = data, data
        faults = self.faults
        if faults.request_noise and self._spoiler.happens(faults.request_noise):
            heard = self._spoiler.one_character(data)
        if faults.bad_echo and self._spoiler.happens(faults.bad_echo):
            echo = self._spoiler.one_character(data)
        start_s = max(now_s, self._host_free_s)
        char_s = self._char_s
        end_s = start_s + len(data) * char_s
        whole = self._listener.whole(heard) if self._is_calm(start_s) else None
        if whole is not None:
            self._incoming.append((end_s, 0, 0, whole))
        else:
            for place, byte in enumerate(heard):
                self._incoming.append((start_s + (place + 1) * char_s, byte, echo[place], None))
        self._host_free_s = end_s
        if not self.paced:
            self._run(now_s)

    def _is_calm(self, start_s: float) -> bool:
        """Whether a telegram begun then meets nothing on its way, so that it matters as a whole."""
        if self._incoming or self._thinking or self.faults.echo:
            return False
        before_s = start_s - self._char_s  # well before: no rounding decides
        return all(speech.end_s(self._char_s) < before_s for speech in self._speaking)

    def next_event_s(self, *, gathered: bool = False) -> float | None:
        """When `poll` is worth calling again; None when nothing is under way.

        Args:
            gathered: What arrives is gathered from the moment at which a drive begins to speak.
        """
        runs = self._outbox.runs
        next_s = runs[0][0] if runs else None
        if self._incoming:
            # Without echo nothing comes of a telegram before its last character has arrived.
            heard_s = self._incoming[0 if self.faults.echo else -1][0]
            next_s = heard_s if next_s is None or heard_s < next_s else next_s
        if self._events:
            first_s = self._events[0][0]
            if not gathered:  # a drive begins to speak: there is nothing to give before its first
                first_s += self._char_s
            next_s = first_s if next_s is None or first_s < next_s else next_s
        return next_s

    def poll(self, now_s: float) -> bytes:
        """Give the bytes that have arrived at the host by now."""
        if self._incoming or self._events:
            self._run(now_s)
        arrived = self._outbox.take(now_s)
        return b"" if self.faults.unplugged else arrived

    def advance(self, now_s: float) -> None:
        """Bring the line and every drive to a time, for looking at them."""
        self._run(now_s)
        for drive in self.drives:
            drive.advance(now_s)

    def under_way(self, now_s: float) -> bool:
        """Whether anything is: a telegram, a drive that thinks or speaks, bytes to the host."""
        if self._incoming or self._events:
            self._run(now_s)
        if self._incoming or self._outbox.runs:
            return True
        for speech in self._speaking:
            if speech.end_s(self._char_s) > now_s:
                return True
        return any(speech.cut_at_s is None for speech in self._thinking)

    def drop_everything(self, now_s: float) -> None:
        """Forget all that is under way, as when the plug is pulled."""
        self._run(now_s)
        self._incoming.clear()
        self._events.clear()
        self._outbox.clear()
        self._thinking.clear()
        self._speaking.clear()
        self._listener = RequestReceiver(parity=self.parity)
        self._host_free_s = self._to_host_free_s = now_s

    # Working off

    def _run(self, now_s: float) -> None:
        incoming, events = self._incoming, self._events
        while True:
            if incoming and (not events or incoming[0][0] <= events[0][0]):
                if incoming[0][0] > now_s:
                    return
                at_s, byte, echo, whole = incoming.popleft()
                if whole is None:
                    self._character(at_s, byte, echo)
                else:
                    self._request(at_s, whole)
            elif events and events[0][0] <= now_s:
                at_s, _, kind, speech = heappop(events)
                if kind is _Event.SPEAK:
                    self._speak(speech, at_s)
                elif kind is _Event.TAKE:
                    self._take(speech, at_s)
                elif kind is _Event.LET_THROUGH:
                    self._let_through(speech, at_s)
                else:
                    self._deliver(speech, at_s)
            else:
                return

    def _character(self, at_s: float, byte: int, echo: int) -> None:
        if self.faults.echo:
            self._outbox.put(at_s, bytes((echo,)), None)
        if self._speaking:
            self._collide(at_s)
        listener = self._listener
        heard = listener.feed(byte)
        if listener.started:
            self._interrupt(at_s, listener.cut_short)
        elif heard is not None:
            self._request(at_s, heard)

    def _request(self, at_s: float, heard: ReceivedRequest) -> None:
        self.requests += 1
        if self.on_request is not None:
            self.on_request(at_s, heard)
        for drive in self._reached(heard.address):
            faults = self._faults_of(drive)
            if faults.unheard and self._spoiler.happens(faults.unheard):
                continue
            if heard.address % 10 == 0:
                drive.hear_group(heard, at_s)
            elif faults.power_cycle and self._spoiler.happens(faults.power_cycle):
                drive.power_cycle(at_s, faults.power_off_s)
            elif faults.eot_drops_writes and heard.text is not None and not heard.damaged:
                self._process_write(drive, heard, at_s)
            else:
                self._ask(drive, heard, at_s, faults)

    def _process_write(self, drive: SimDrive, heard: ReceivedRequest, at_s: float) -> None:
        """Let a drive process a write before it takes it; an EOT meanwhile ends that."""
        after_s = drive.takes_after_s(heard, at_s, self._spoiler.rng)
        if after_s is None:
            return
        take_s = at_s + after_s * self._think_scale
        write = Speech(drive, b"", take_s, 0.0, False, 0, heard=heard)
        self._thinking.append(write)
        self._schedule(take_s, _Event.TAKE, write)

    def _take(self, write: Speech, at_s: float) -> None:
        """Let a drive take the write that it has processed, and answer."""
        if write in self._thinking:
            self._thinking.remove(write)
        if write.cut_at_s is not None:
            return
        assert write.heard is not None
        if self._hears(write.drive):
            faults = self._faults_of(write.drive)
            reply = self._hear(write.drive, write.heard, at_s, faults)
            self._reply(write.drive, reply, at_s, faults)

    def _collide(self, at_s: float) -> None:
        """The host's character overlaps with what drives are saying."""
        began_s = at_s - self._char_s
        self._speaking = [
            speech for speech in self._speaking if speech.end_s(self._char_s) > began_s
        ]
        for speech in self._speaking:
            if speech.garbled_from_s is None:
                speech.garbled_from_s = max(began_s, speech.begin_s)
                self.collisions += 1

    def _interrupt(self, at_s: float, unfinished: int | None) -> None:
        """An EOT: drives drop what they were about to say, or stop saying it."""
        for speech in (*self._thinking, *self._speaking):
            if not speech.stubborn and speech.cut_at_s is None:
                speech.cut_at_s = at_s
                free_s = at_s + speech.held_up_s  # nothing of it comes after that
                self._to_host_free_s = min(self._to_host_free_s, free_s)
                speech.drive.interrupted()
                self.aborted += 1
        self._thinking = [speech for speech in self._thinking if speech.stubborn]
        if unfinished is not None:
            for drive in self._reached(unfinished):
                drive.interrupted(CommError.FRAME)

    def _reached(self, address: int) -> list[SimDrive]:
        """The drives an address or group address reaches. Source: EDB2102EN 8.3.4."""
        if address % 10:
            found = (self._by_address or self._look()).get(address, _NOBODY)
        elif address == 0:
            found = list(self.drives)
        else:
            found = [drive for drive in self.drives if drive.address // 10 == address // 10]
        return [drive for drive in found if self._hears(drive)]

    def _look(self) -> dict[int, list[SimDrive]]:
        found: dict[int, list[SimDrive]] = {}
        for drive in self.drives:
            found.setdefault(drive.address, []).append(drive)
        self._by_address = found
        return found

    def _look_again(self) -> None:
        self._by_address = None

    def _hears(self, drive: SimDrive) -> bool:
        if not drive.present or drive.baud != self._host_baud:
            return False
        absent = self._faults_of(drive).absent if self.drive_faults else self.faults.absent
        return not absent or drive.address not in absent

    def _faults_of(self, drive: SimDrive) -> Faults:
        if not self.drive_faults:
            return self.faults
        return self.drive_faults.get(drive.address, self.faults)

    def _ask(self, drive: SimDrive, heard: ReceivedRequest, at_s: float, faults: Faults) -> None:
        reply = self._hear(drive, heard, at_s, faults)
        if reply is not None:
            self._reply(drive, reply, at_s + reply.after_s * self._think_scale, faults)

    def _hear(
        self, drive: SimDrive, heard: ReceivedRequest, at_s: float, faults: Faults
    ) -> Reply | None:
        if heard.text is not None and not heard.damaged and self._spoiler.happens(faults.nak):
            return drive.refuse(at_s)
        if faults.damaged and self._spoiler.happens(faults.damaged):
            heard = replace(heard, damaged=True)
        return drive.hear(heard, at_s, self._spoiler.rng, nak_reads=faults.nak_reads)

    def _reply(self, drive: SimDrive, reply: Reply | None, begin_s: float, faults: Faults) -> None:
        if reply is None or (faults.lost and self._spoiler.happens(faults.lost)):
            return
        data = self._answer(reply.data, drive, faults)
        speech = Speech(drive, data, begin_s, 0.0, False, len(reply.data))
        if faults.late and self._spoiler.happens(faults.late):
            extra_s = self._spoiler.rng.uniform(*faults.late_s)
            if faults.late_kind is LateKind.ADAPTER:
                speech.held_up_s = extra_s
            else:
                speech.begin_s += extra_s
                speech.stubborn = faults.late_kind is LateKind.STUBBORN
        self._thinking.append(speech)
        self._schedule(speech.begin_s, _Event.SPEAK, speech)

    def _answer(self, reply: bytes, drive: SimDrive, faults: Faults) -> bytes:
        if drive.baud != self._host_baud:
            # Spoken at another baud rate: the host sees framing errors and nonsense.
            return self._spoiler.nonsense(len(reply))
        return self._spoiler.answer(reply, faults)

    def _speak(self, speech: Speech, at_s: float) -> None:
        if speech in self._thinking:
            self._thinking.remove(speech)
        if speech.cut_at_s is not None:
            return
        if self._speaking:
            self._speaking = [one for one in self._speaking if one.end_s(self._char_s) > at_s]
        for other in self._speaking:
            # Two drives send simultaneously: neither can be understood from here on.
            self.clashes += 1
            speech.garbled_from_s = at_s
            if other.garbled_from_s is None:
                other.garbled_from_s = at_s
        self._speaking.append(speech)
        if self.on_answer is not None:
            self.on_answer(speech.drive, at_s, at_s + speech.own_chars * self._char_s)
        if speech.held_up_s:
            self._schedule(at_s + speech.held_up_s, _Event.LET_THROUGH, speech)
        else:
            self._let_through(speech, at_s)

    def _let_through(self, speech: Speech, at_s: float) -> None:
        """Let an answer's bytes arrive at the host, and perhaps once more later."""
        self._deliver(speech, at_s)
        faults = self._faults_of(speech.drive)
        twins = self.faults.twins
        twin = bool(twins) and speech.drive.address in twins
        if twin or (faults.double and self._spoiler.happens(faults.double)):
            least_s, most_s = TWIN_S if twin else faults.double_s
            later_s = at_s + self._spoiler.rng.uniform(least_s, most_s)
            copy = Speech(speech.drive, speech.data, later_s, 0.0, True, speech.own_chars)
            self._schedule(later_s, _Event.COPY, copy)

    def _deliver(self, speech: Speech, at_s: float) -> None:
        """Let bytes arrive at the host, not in the middle of another answer."""
        base_s = max(at_s, self._to_host_free_s)
        speech.held_up_s = base_s - speech.begin_s
        if not self.paced:
            self._outbox.put(base_s, speech.data, speech)
            return
        self._outbox.put(base_s, speech.data, speech, self._char_s)
        self._to_host_free_s = base_s + len(speech.data) * self._char_s

    def _schedule(self, at_s: float, kind: _Event, speech: Speech) -> None:
        self._count += 1
        heappush(self._events, (at_s, self._count, kind, speech))


def build(
    drives: Sequence[tuple[str, int, str]],
    *,
    baud: int = 9600,
    seed: int = 0,
    faults: Faults | str = "",
    parity: bool = True,
    paced: bool = True,
    spread: float = 0.0,
    think_scale: float = 1.0,
    overrides: Mapping[str, Overrides] | None = None,
    log_size: int = 1_000,
    word_as_written: bool = False,
    only_changes: bool = False,
    digit_of: str = "lecom",
) -> SimLine:
    """Build a line.

    Args:
        drives: Name, address and family of each.
        baud: 1200..19200 bit/s.
        seed: Where all chance starts from.
        faults: Faults, or their short text (see `parse_faults`).
        parity: Whether bytes carry even parity in bit 7.
        paced: Whether characters take their time.
        spread: How much faster than the manual's time an answer may come, 0..1.
        think_scale: Factor on processing times.
        overrides: Values to start with, by the drive's name (see `SimDrive`).
        log_size: How many requests each drive remembers.
        word_as_written: C0135 of the drives reads what was last written to it (see `SimDrive`).
        only_changes: Of such drives, only a change of bit 3 lifts a quick stop (see `SimDrive`).
        digit_of: Which number C0068 of an SMVector shows the tens digit of (see `SMVector`).

    Raises:
        ValueError: A family, an address or a fault is unknown.
    """
    presets = overrides or {}
    line = SimLine(
        [
            SimDrive(
                address, family, name, presets.get(name), spread=spread, log_size=log_size,
                word_as_written=word_as_written, only_changes=only_changes, digit_of=digit_of,
            )
            for name, address, family in drives
        ],
        baud=baud, faults=parse_faults(faults) if isinstance(faults, str) else faults,
        seed=seed, parity=parity, paced=paced, think_scale=think_scale,
    )  # fmt: skip
    by_address = {drive.address: drive for drive in line.drives}
    for address, number, stays in line.faults.trips:
        if address not in by_address:
            there = ", ".join(map(str, by_address))
            raise ValueError(f"fault 'trip': no drive has the address {address}: one of {there}")
        by_address[address].trip(number, stays=stays)
    return line
