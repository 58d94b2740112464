"""What can go wrong on a line, as switches that may be turned at any time.

Strategy: `Faults` is a plain record of probabilities (0..1, per telegram) and settings. A line has
one; a drive may have its own, which then replaces the line's for that drive. `parse_faults` reads
the short text of the command line, such as `late=0.05:0.5s,noise=0.05,lost=0.02,absent=11+12`.

`Spoiler` does the damage: at most one character per answer (a flipped bit or another character) or
stray characters around it, so that parity and block check can always notice it: what gets past both
is noticed by no master, and a test that demands correct values could only be flaky. Never made, for
the same reason: an ACK out of a NAK, the reverse, or a stray one of the two. One trap is left open
on purpose: the character after the code may turn into EOT, which looks like "no such code" with
something after it.
"""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Final

from .wire import ACK, NAK, PARITY_TABLE

__all__ = ["ENDLESS_CHARS", "Faults", "LateKind", "Spoiler", "make_noise", "parse_faults"]

ENDLESS_CHARS: Final = 5000


class LateKind(StrEnum):
    """Where a late answer is held up.

    `DRIVE`: the drive thinks longer, and a new EOT still makes it drop the answer. `ADAPTER`: it
    was on the wire in time and reaches the host late, also after other telegrams. `STUBBORN`: the
    drive speaks late and an EOT does not stop it, so it may speak over others.
    """

    DRIVE = "drive"
    ADAPTER = "adapter"
    STUBBORN = "stubborn"


@dataclass(slots=True)
class Faults:
    """Faults switched on; everything off by default. Probabilities are per telegram, 0..1.

    Attributes:
        lost: The drive does what was asked, its answer never arrives.
        unheard: The drive does not hear the request at all.
        request_noise: One character of the request is damaged on its way to the drives.
        late: The answer comes late.
        late_s: By how much, seconds, least and most.
        late_kind: Where late answers are held up.
        double: The answer is delivered twice, the second time later.
        double_s: By how much, seconds, least and most.
        twins: Addresses that two drives have: the second one's answer comes after the first one's.
        noise: The answer is damaged, or stray characters stand before or after it.
        bad_bcc: The answer's block check is wrong.
        parity: One character of the answer has bad parity.
        half: The answer breaks off.
        endless: The answer goes on and on, for `ENDLESS_CHARS` characters.
        nak: A write is refused for no reason.
        damaged: The request is damaged on its way to the drive, which notices: NAK to a write, and
            to a read `?` or NAK (see `nak_reads`).
        nak_reads: A drive says NAK to a read that it cannot carry out: damaged, or no such code.
        eot_drops_writes: A drive takes a write to its own address at the end of its processing
            time, and a new EOT before that makes it drop the write; else it takes a write when it
            has heard it. The manual says neither (EDB2102EN 8.3.5).
        power_cycle: The drive loses its power when asked.
        power_off_s: How long it is then away, seconds.
        echo: The host hears itself.
        bad_echo: One character of the echo of a telegram is wrong.
        absent: Addresses that do not answer.
        unplugged: Nothing passes either way.
        trips: Drive faults there from the start: address, LECOM number, whether the cause stays.
    """

    lost: float = 0.0
    unheard: float = 0.0
    request_noise: float = 0.0
    late: float = 0.0
    late_s: tuple[float, float] = (0.05, 0.5)
    late_kind: LateKind = LateKind.ADAPTER
    double: float = 0.0
    double_s: tuple[float, float] = (0.05, 0.5)
    twins: set[int] = field(default_factory=set)
    noise: float = 0.0
    bad_bcc: float = 0.0
    parity: float = 0.0
    half: float = 0.0
    endless: float = 0.0
    nak: float = 0.0
    damaged: float = 0.0
    nak_reads: bool = False
    eot_drops_writes: bool = False
    power_cycle: float = 0.0
    power_off_s: float = 1.0
    echo: bool = False
    bad_echo: float = 0.0
    absent: set[int] = field(default_factory=set)
    unplugged: bool = False
    trips: tuple[tuple[int, int, bool], ...] = ()


TWIN_S: Final = (0.06, 0.2)
"""How much later than the first the second of two drives at one address answers, seconds."""

_CHANCES: Final = tuple(
    one.name for one in fields(Faults) if one.type == "float" and one.name != "power_off_s"
)
_SWITCHES: Final = ("echo", "unplugged", "nak_reads", "eot_drops_writes")
_TRIP: Final = re.compile(r"(\d{1,2}):(\d{1,4})(:stays)?\Z")
_DURATION: Final = re.compile(r"(\d+(?:\.\d+)?)(ms|s)\Z")


def parse_faults(text: str) -> Faults:
    """Read the command line's short form.

    Args:
        text: `NAME=CHANCE` items with commas between; `late=CHANCE[:[LEAST-]MOST[:KIND]]`,
            `double=CHANCE[:[LEAST-]MOST]`, `twins=11+12`, `power_cycle=CHANCE[:DURATION]`,
            `absent=11+12`, `trip=11:50+12:15:stays`, `echo`, `unplugged`, `nak-reads`,
            `eot-drops-writes`. Empty: no faults.

    Raises:
        ValueError: An item is not understood; says which and what is right.
    """
    faults = Faults()
    for item in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = item.partition("=")
        name = name.strip().replace("-", "_")
        if name in _SWITCHES and not value:
            setattr(faults, name, True)
        elif name in ("absent", "twins"):
            setattr(faults, name, {_address(part, item) for part in value.split("+")})
        elif name == "trip":
            faults.trips = tuple(_trip(part, item) for part in value.split("+"))
        elif name in _CHANCES:
            _read_chance(faults, name, value, item)
        else:
            names = ", ".join((*_CHANCES, *_SWITCHES, "absent", "trip", "twins")).replace("_", "-")
            raise ValueError(f"fault {item!r}: one of {names}")
    return faults


def _read_chance(faults: Faults, name: str, value: str, item: str) -> None:
    chance, *rest = value.split(":")
    setattr(faults, name, _chance(chance, item))
    if name in ("late", "double") and rest:
        setattr(faults, f"{name}_s", _delays(rest.pop(0), item))
        if rest and name == "late":
            faults.late_kind = _kind(rest.pop(0), item)
    elif name == "power_cycle" and rest:
        faults.power_off_s = _duration(rest.pop(0), item)
    if rest:
        raise ValueError(f"fault {item!r}: too many parts")


def _delays(text: str, item: str) -> tuple[float, float]:
    least, dash, most = text.partition("-")
    end_s = _duration(most if dash else least, item)
    start_s = _duration(least, item) if dash else min(0.05, end_s)
    if start_s > end_s:
        raise ValueError(f"fault {item!r}: the least delay comes first, then the most")
    return start_s, end_s


def _chance(text: str, item: str) -> float:
    try:
        chance = float(text)
    except ValueError:
        chance = -1.0
    if not 0.0 <= chance <= 1.0:
        raise ValueError(f"fault {item!r}: the chance is a number from 0 to 1")
    return chance


def _duration(text: str, item: str) -> float:
    match = _DURATION.match(text)
    if match is None:
        raise ValueError(f"fault {item!r}: a duration looks like 500ms or 0.5s")
    return float(match[1]) * (0.001 if match[2] == "ms" else 1.0)


def _kind(text: str, item: str) -> LateKind:
    try:
        return LateKind(text)
    except ValueError:
        kinds = ", ".join(LateKind)
        raise ValueError(f"fault {item!r}: held up where? one of {kinds}") from None


def _address(text: str, item: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 99:
        raise ValueError(f"fault {item!r}: addresses from 1 to 99 with + between")
    return int(text)


def _trip(text: str, item: str) -> tuple[int, int, bool]:
    match = _TRIP.match(text)
    if match is None:
        raise ValueError(f"fault {item!r}: write trip=ADDRESS:NUMBER[:stays] with + between")
    return int(match[1]), int(match[2]), bool(match[3])


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
