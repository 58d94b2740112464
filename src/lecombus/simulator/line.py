"""A line with drives on it: bytes in, bytes out, time as an argument.

Theory of operation. The host's bytes travel one character time each and are heard by all drives
when they have arrived. A drive that was asked thinks, then speaks; its characters travel too.
Three queues hold what is under way, each ordered by time: `_incoming` (host to drives), `_events`
(a drive begins to speak, an adapter lets an answer through), `_outgoing` (bytes to the host).
`_run` works them off in the order of time: how often or how late it is called does not matter.

A good EOT drops what a drive is thinking about and cuts off what it is saying. The host speaking
while a drive speaks is a collision: counted, and what the drive says from then on is garbled.
Unpaced, characters take no time and answers come whole.

Must not live here: threads, clocks, file descriptors.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from heapq import heappop, heappush
from typing import Final

from lecombus.simulator.drive import Reply, SimDrive
from lecombus.simulator.faults import Faults, LateKind, flip_parity, make_noise
from lecombus.simulator.parameters import CommError
from lecombus.simulator.receiver import Heard, Listener
from lecombus.simulator.wire import PARITY_TABLE

__all__ = ["SimLine"]

_BITS: Final = 10
"""A character: start bit, 7 data bits, parity, stop bit. Source: EDB2102EN 3.2."""


class _Event(Enum):
    SPEAK = auto()
    LET_THROUGH = auto()


@dataclass(slots=True, eq=False)
class _Speech:
    """What one drive says once.

    Attributes:
        begin_s: When its first character starts on the wire.
        held_up_s: How long an adapter holds it back.
        stubborn: An EOT does not stop it.
        cut_at_s: When an EOT stopped it, if one did.
        garbled_from_s: When the host began to speak over it, if it did.
    """

    drive: SimDrive
    data: bytes
    begin_s: float
    held_up_s: float
    stubborn: bool
    cut_at_s: float | None = None
    garbled_from_s: float | None = None


class SimLine:
    """The line.

    Args:
        drives: The drives on it, each address once.
        baud: 1200..19200 bit/s.
        faults: Faults switched on; the object may be changed at any time.
        seed: Where all chance starts from.
        parity: Whether bytes in and out carry even parity in bit 7 (an 8N1 port).
        paced: Whether characters take their time.
        think_scale: Factor on the drives' processing times; 0 answers at once.

    Attributes:
        faults: The line's faults.
        drive_faults: Faults of single drives by address, instead of the line's.
        collisions: How often the host spoke while a drive was speaking.
        aborted: How often an EOT made a drive drop or cut off an answer.
        requests: Whole requests heard on the line.
        on_request: Called with time and request whenever one was heard; for benches and tests.
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
        self.drives = tuple(drives)
        self.baud = baud
        self.faults = faults if faults is not None else Faults()
        self.drive_faults: dict[int, Faults] = {}
        self.parity = parity
        self.paced = paced
        self.collisions = 0
        self.aborted = 0
        self.requests = 0
        self.on_request: Callable[[float, Heard], None] | None = None
        self._think_scale = think_scale
        self._char_s = _BITS / baud if paced else 0.0
        self._rng = random.Random(seed)
        self._listener = Listener(parity=parity)
        self._incoming: deque[tuple[float, int, int]] = deque()
        self._host_free_s = 0.0
        self._events: list[tuple[float, int, _Event, _Speech]] = []
        self._outgoing: list[tuple[float, int, bytes, _Speech | None]] = []
        self._count = 0
        self._thinking: list[_Speech] = []
        self._speaking: list[_Speech] = []
        self._to_host_free_s = 0.0

    def __getitem__(self, name: str | int) -> SimDrive:
        """Find a drive by its name or its present address."""
        for drive in self.drives:
            if name in (drive.name, drive.address):
                return drive
        raise KeyError(name)

    # The two directions

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes the host has handed to its port.

        Args:
            data: The bytes.
            now_s: When, monotonic seconds, never earlier than in an earlier call.
        """
        self._run(now_s)
        if self.faults.unplugged:
            return
        heard, echo = data, data
        faults, rng = self.faults, self._rng
        if faults.request_noise and rng.random() < faults.request_noise:
            heard = self._damage_one(data)
        if faults.bad_echo and rng.random() < faults.bad_echo:
            echo = self._damage_one(data)
        start_s = max(now_s, self._host_free_s)
        char_s = self._char_s
        for place, byte in enumerate(heard):
            self._incoming.append((start_s + (place + 1) * char_s, byte, echo[place]))
        self._host_free_s = start_s + len(data) * char_s
        if not self.paced:
            self._run(now_s)

    def next_event_s(self) -> float | None:
        """When `poll` is worth calling again; None when nothing is under way."""
        times = []
        if self._incoming:
            # Without echo nothing comes of a telegram before its last character has arrived.
            times.append(self._incoming[0 if self.faults.echo else -1][0])
        if self._events:
            times.append(self._events[0][0])
        if self._outgoing:
            times.append(self._outgoing[0][0])
        return min(times) if times else None

    def poll(self, now_s: float) -> bytes:
        """Give the bytes that have arrived at the host by now."""
        self._run(now_s)
        if not self._outgoing or self._outgoing[0][0] > now_s:
            return b""
        arrived = []
        while self._outgoing and self._outgoing[0][0] <= now_s:
            at_s, _, data, speech = heappop(self._outgoing)
            if speech is None:
                arrived.append(data)
                continue
            wire_s = at_s - speech.held_up_s
            if speech.cut_at_s is not None and wire_s > speech.cut_at_s:
                continue
            if speech.garbled_from_s is not None and wire_s > speech.garbled_from_s:
                data = bytes(byte ^ self._rng.randrange(1, 256) for byte in data)
            arrived.append(data)
        return b"" if self.faults.unplugged else b"".join(arrived)

    def advance(self, now_s: float) -> None:
        """Bring the line and every drive to a time, for looking at them."""
        self._run(now_s)
        for drive in self.drives:
            drive.advance(now_s)

    def drop_everything(self, now_s: float) -> None:
        """Forget all that is under way, as when the plug is pulled."""
        self._run(now_s)
        self._incoming.clear()
        self._events.clear()
        self._outgoing.clear()
        self._thinking.clear()
        self._speaking.clear()
        self._listener = Listener(parity=self.parity)
        self._host_free_s = self._to_host_free_s = now_s

    # Working off

    def _run(self, now_s: float) -> None:
        incoming, events = self._incoming, self._events
        while True:
            next_in = incoming[0][0] if incoming else None
            next_event = events[0][0] if events else None
            if next_in is not None and (next_event is None or next_in <= next_event):
                if next_in > now_s:
                    return
                at_s, byte, echo = incoming.popleft()
                self._character(at_s, byte, echo)
            elif next_event is not None and next_event <= now_s:
                at_s, _, kind, speech = heappop(events)
                if kind is _Event.SPEAK:
                    self._speak(speech, at_s)
                else:
                    self._let_through(speech, at_s)
            else:
                return

    def _character(self, at_s: float, byte: int, echo: int) -> None:
        if self.faults.echo:
            self._send(at_s, bytes((echo,)), None)
        if self._speaking:
            self._collide(at_s)
        listener = self._listener
        heard = listener.feed(byte)
        if listener.started:
            self._interrupt(at_s, listener.cut_short)
        elif heard is not None:
            self.requests += 1
            if self.on_request is not None:
                self.on_request(at_s, heard)
            self._dispatch(heard, at_s)

    def _collide(self, at_s: float) -> None:
        """The host's character overlaps with what drives are saying."""
        began_s = at_s - self._char_s
        self._speaking = [speech for speech in self._speaking if self._end_s(speech) > began_s]
        for speech in self._speaking:
            if speech.garbled_from_s is None:
                speech.garbled_from_s = max(began_s, speech.begin_s)
                self.collisions += 1

    def _end_s(self, speech: _Speech) -> float:
        return speech.begin_s + len(speech.data) * self._char_s

    def _interrupt(self, at_s: float, unfinished: int | None) -> None:
        """An EOT: drives drop what they were about to say, or stop saying it."""
        for speech in (*self._thinking, *self._speaking):
            if not speech.stubborn and speech.cut_at_s is None:
                speech.cut_at_s = at_s
                speech.drive.interrupted()
                self.aborted += 1
        self._thinking = [speech for speech in self._thinking if speech.stubborn]
        if unfinished is not None:
            for drive in self._reached(unfinished):
                drive.interrupted(CommError.FRAME)

    def _reached(self, address: int) -> list[SimDrive]:
        """The drives an address or group address reaches. Source: EDB2102EN 8.3.4."""
        if address % 10:
            found = [drive for drive in self.drives if drive.address == address]
        elif address == 0:
            found = list(self.drives)
        else:
            found = [drive for drive in self.drives if drive.address // 10 == address // 10]
        return [drive for drive in found if self._hears(drive)]

    def _hears(self, drive: SimDrive) -> bool:
        faults = self._faults_of(drive)
        return (
            drive.present
            and drive.address not in faults.absent
            and drive.baud(self.baud) == self.baud
        )

    def _faults_of(self, drive: SimDrive) -> Faults:
        return (
            self.drive_faults.get(drive.address, self.faults)
            if self.drive_faults
            else (self.faults)
        )

    def _dispatch(self, heard: Heard, at_s: float) -> None:
        for drive in self._reached(heard.address):
            faults = self._faults_of(drive)
            if self._happens(faults.unheard):
                continue
            if heard.address % 10 == 0:
                drive.hear_group(heard, at_s)
            elif self._happens(faults.power_cycle):
                drive.power_cycle(at_s, faults.power_off_s)
            else:
                self._ask(drive, heard, at_s, faults)

    def _ask(self, drive: SimDrive, heard: Heard, at_s: float, faults: Faults) -> None:
        if heard.text is not None and not heard.damaged and self._happens(faults.nak):
            reply: Reply | None = drive.refuse(at_s)
        else:
            reply = drive.hear(heard, at_s, self._rng)
        if reply is None or self._happens(faults.lost):
            return
        begin_s = at_s + reply.after_s * self._think_scale
        speech = _Speech(drive, self._spoil(reply.data, drive, faults), begin_s, 0.0, False)
        if self._happens(faults.late):
            extra_s = self._rng.uniform(*faults.late_s)
            if faults.late_kind is LateKind.ADAPTER:
                speech.held_up_s = extra_s
            else:
                speech.begin_s += extra_s
                speech.stubborn = faults.late_kind is LateKind.STUBBORN
        self._thinking.append(speech)
        self._schedule(speech.begin_s, _Event.SPEAK, speech)

    def _spoil(self, reply: bytes, drive: SimDrive, faults: Faults) -> bytes:
        """Put the answer on the wire, with whatever faults strike it."""
        rng = self._rng
        if len(reply) > 1 and self._happens(faults.bad_bcc):
            reply = reply[:-1] + bytes((reply[-1] ^ 1 << rng.randrange(7),))
        data = reply.translate(PARITY_TABLE) if self.parity else reply
        if self._happens(faults.parity):
            data = flip_parity(data, rng)
        if len(data) > 1 and self._happens(faults.half):
            data = data[: rng.randrange(1, len(data))]
        if self._happens(faults.noise):
            data = make_noise(data, rng, parity=self.parity)
        if drive.baud(self.baud) != self.baud:
            # Spoken at another baud rate: the host sees framing errors and nonsense.
            data = bytes(rng.randrange(256) for _ in data)
        return data

    def _speak(self, speech: _Speech, at_s: float) -> None:
        if speech in self._thinking:
            self._thinking.remove(speech)
        if speech.cut_at_s is not None:
            return
        self._speaking = [other for other in self._speaking if self._end_s(other) > at_s]
        self._speaking.append(speech)
        if speech.held_up_s:
            self._schedule(at_s + speech.held_up_s, _Event.LET_THROUGH, speech)
        else:
            self._let_through(speech, at_s)

    def _let_through(self, speech: _Speech, at_s: float) -> None:
        """Let an answer's bytes arrive at the host, not in the middle of another answer."""
        base_s = max(at_s, self._to_host_free_s)
        speech.held_up_s = base_s - speech.begin_s
        if not self.paced:
            self._send(base_s, speech.data, speech)
            return
        char_s = self._char_s
        for place in range(len(speech.data)):
            self._send(base_s + (place + 1) * char_s, speech.data[place : place + 1], speech)
        self._to_host_free_s = base_s + len(speech.data) * char_s

    def _send(self, at_s: float, data: bytes, speech: _Speech | None) -> None:
        self._count += 1
        heappush(self._outgoing, (at_s, self._count, data, speech))

    def _schedule(self, at_s: float, kind: _Event, speech: _Speech) -> None:
        self._count += 1
        heappush(self._events, (at_s, self._count, kind, speech))

    def _happens(self, chance: float) -> bool:
        return chance > 0.0 and self._rng.random() < chance

    def _damage_one(self, data: bytes) -> bytes:
        place = self._rng.randrange(len(data))
        flipped = data[place] ^ 1 << self._rng.randrange(7)
        return data[:place] + bytes((flipped,)) + data[place + 1 :]
