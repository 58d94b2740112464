"""How faults strike: chance, and the damage done to telegrams.

Damage is at most one character per answer (a flipped bit or another character) or stray characters
around it, so that parity and block check can always notice it: what gets past both is noticed by no
master, and a test that demands correct values could only be flaky. Never made, for the same reason:
an ACK out of a NAK, the reverse, or a stray one of the two. One trap is left open on purpose: the
character after the code may turn into EOT, which looks like "no such code" with something after it.
"""

from __future__ import annotations

import random

from lecombus.fieldbus.lecom.simulator.faults import ENDLESS_CHARS, Faults
from lecombus.fieldbus.lecom.simulator.wire import ACK, NAK, PARITY_TABLE

__all__ = ["Spoiler", "make_noise"]


class Spoiler:
    """Decides by chance what goes wrong, and does it to the bytes.

    Args:
        seed: Where all chance starts from.
        parity: Whether bytes carry even parity in bit 7.

    Attributes:
        rng: The one source of chance of a line.
    """

    def __init__(self, seed: int, *, parity: bool) -> None:
        self.rng = random.Random(seed)
        self._parity = parity

    def happens(self, chance: float) -> bool:
        """Decide whether something of a given probability happens now."""
        return chance > 0.0 and self.rng.random() < chance

    def answer(self, reply: bytes, faults: Faults) -> bytes:
        """Put an answer's characters on the wire, with the faults that occur."""
        rng = self.rng
        if faults.bad_bcc and len(reply) > 1 and self.happens(faults.bad_bcc):
            reply = reply[:-1] + bytes((reply[-1] ^ 1 << rng.randrange(7),))
        if faults.endless and len(reply) > 2 and self.happens(faults.endless):
            reply = reply[:-2] + b"0" * ENDLESS_CHARS + reply[-2:]
        data = reply.translate(PARITY_TABLE) if self._parity else reply
        if faults.parity and self.happens(faults.parity):
            data = _flip(data, rng.randrange(len(data)), 0x80)
        if faults.half and len(data) > 1 and self.happens(faults.half):
            data = data[: rng.randrange(1, len(data))]
        if faults.noise and self.happens(faults.noise):
            data = make_noise(data, rng, parity=self._parity)
        return data

    def one_character(self, data: bytes) -> bytes:
        """Flip one data bit of one character."""
        return _flip(data, self.rng.randrange(len(data)), 1 << self.rng.randrange(7))

    def nonsense(self, length: int) -> bytes:
        """Make what another baud rate looks like."""
        return bytes(self.rng.randrange(256) for _ in range(length))

    def garbled(self, data: bytes) -> bytes:
        """Return what two simultaneous senders look like: every byte is wrong."""
        return bytes(byte ^ self.rng.randrange(1, 256) for byte in data)


def _flip(data: bytes, place: int, bit: int) -> bytes:
    return data[:place] + bytes((data[place] ^ bit,)) + data[place + 1 :]


def make_noise(data: bytes, rng: random.Random, *, parity: bool) -> bytes:
    """Damage one byte of a telegram, or put stray bytes before or after it.

    Args:
        data: The bytes as on the wire, with parity where the line carries it.
        rng: Where chance comes from.
        parity: Whether stray and replaced bytes get a good parity bit.
    """
    kind = rng.randrange(4)
    if kind == 0:
        place = rng.randrange(len(data))
        return _flip(data, place, 1 << rng.randrange(8 if parity else 7))
    if kind == 1:
        place = rng.randrange(len(data))
        return data[:place] + _other(data[place], rng, parity=parity) + data[place + 1 :]
    stray = b"".join(_other(None, rng, parity=parity) for _ in range(rng.randint(1, 3)))
    return stray + data if kind == 2 else data + stray


def _other(instead_of: int | None, rng: random.Random, *, parity: bool) -> bytes:
    """Make a random character that is neither ACK, NAK nor the one it replaces."""
    avoid = {ACK, NAK, None if instead_of is None else instead_of & 0x7F}
    char = rng.choice([n for n in range(128) if n not in avoid])
    return bytes((PARITY_TABLE[char] if parity else char,))
