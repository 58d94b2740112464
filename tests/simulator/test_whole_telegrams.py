"""A request heard at once, and an answer that travels as one run, are what single bytes would be.

Two lines get the same traffic: one works as it is, the other is made to take every byte by itself.
The traffic is drawn to hit what tells them apart: telegrams in pieces, said over answers, back to
back, damaged, groups, late and stubborn drives, echo, faults switched while a telegram travels.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

import pytest

from lecombus.fieldbus.lecom.simulator.line import SimLine, build
from lecombus.fieldbus.lecom.simulator.outbox import Speech
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest
from lecombus.fieldbus.lecom.simulator.wire import EOT, ETX, PARITY_TABLE, STX, bcc
from support.sim_host import code_field

DRIVES = [("a", 1, "8200vector"), ("b", 2, "820x"), ("c", 12, "93xx"), ("d", 13, "smvector")]
FAULTS = (
    "",
    "",
    "late=0.3:0.05s:drive",
    "late=0.3:0.2s:stubborn",
    "late=0.3:0.2s:adapter",
    "lost=0.2,unheard=0.2",
    "noise=0.3,half=0.2,parity=0.2,request-noise=0.2",
    "echo,bad-echo=0.2",
    "power-cycle=0.05:50ms",
)
TELEGRAMS = 150
Turn = Callable[[SimLine, float], None]


@dataclass
class Seen:
    """What can be seen of a line from outside."""

    arrived: list[tuple[float, bytes]] = field(default_factory=list)
    due: list[float | None] = field(default_factory=list)
    requests: list[tuple[float, ReceivedRequest]] = field(default_factory=list)


def line_with(faults: str, seed: int, *, paced: bool) -> tuple[SimLine, Seen]:
    line = build(
        DRIVES, baud=9600, faults=faults, seed=seed, spread=0.5, paced=paced,
        overrides={"a": {1923: "300", 1922: "2"}},
    )  # fmt: skip
    seen = Seen()
    line.on_request = lambda at_s, heard: seen.requests.append((at_s, heard))
    return line, seen


def byte_by_byte(line: SimLine) -> None:
    """Let a line take every byte by itself, both ways."""
    line._is_calm = lambda start_s: False  # type: ignore[method-assign]
    put = line._outbox.put

    def put_each(base_s: float, data: bytes, speech: Speech | None, char_s: float = 0.0) -> None:
        for place in range(len(data)):
            put(base_s + (place + 1) * char_s, data[place : place + 1], speech)

    if line.paced:
        line._outbox.put = put_each  # type: ignore[method-assign]


def telegram(random: Random) -> bytes:
    address = random.choice((1, 1, 2, 12, 13, 10, 0, 45))
    head = bytes((EOT,)) + b"%02d" % address
    code = random.choice((46, 50, 9, 135, 150, 1410, 9999))
    field_ = code_field(code if code < 6230 else 6229, extended=random.random() < 0.2)
    if random.random() < 0.5:
        text = head + field_ + b"\x05"
    else:
        body = field_ + random.choice((b"1", b"12.5", b"H0008", b"7")) + bytes((ETX,))
        text = head + bytes((STX,)) + body + bytes((bcc(body),))
    data = text.translate(PARITY_TABLE)
    if random.random() < 0.05:
        place = random.randrange(len(data))
        data = data[:place] + bytes((data[place] ^ 1,)) + data[place + 1 :]
    return data


def steps(seed: int) -> list[tuple[float, Turn | bytes | None]]:
    """Draw what happens: bytes said, faults turned, or a mere look, each after a time."""
    random = Random(seed)
    found: list[tuple[float, Turn | bytes | None]] = []
    for _ in range(TELEGRAMS):
        data = telegram(random)
        pause_s = random.choice((0.0, 0.002, 0.012, 0.026, 0.03, 0.045, 0.1, 0.4))
        if random.random() < 0.15:
            cut = random.randrange(1, len(data))
            found += [(pause_s, data[:cut]), (random.choice((0.0, 0.003, 0.02)), data[cut:])]
        else:
            found.append((pause_s, data))
        for _ in range(random.randrange(4)):
            found.append((random.uniform(0.0, 0.06), None))
        if random.random() < 0.05:
            found.append((random.uniform(0.0, 0.01), turn(random)))
    return found


def turn(random: Random) -> Turn:
    kind, address = random.randrange(3), random.choice((1, 2, 12))
    if kind == 0:
        return lambda line, now_s: line.faults.absent.symmetric_difference_update({address})
    if kind == 1:
        return lambda line, now_s: line.drop_everything(now_s)
    return lambda line, now_s: line["c"].model.params.set(9, str(address))


def run(line: SimLine, seen: Seen, seed: int) -> None:
    now_s = 5.0
    for pause_s, what in steps(seed):
        now_s += pause_s
        if isinstance(what, bytes):
            line.receive(what, now_s)
        elif what is not None:
            line.advance(now_s)
            what(line, now_s)
        seen.due.append(line.next_event_s())
        if random_look(now_s):
            seen.arrived.append((now_s, line.poll(now_s)))
    seen.arrived.append((now_s + 9.0, line.poll(now_s + 9.0)))
    line.advance(now_s + 9.0)


def random_look(now_s: float) -> bool:
    """Look often, but not at every step: how often is to make no difference."""
    return int(now_s * 1e6) % 3 > 0


def inside(line: SimLine) -> list[object]:
    """Everything that is counted or remembered."""
    drives = [
        (drive.heard, list(drive.log), drive.watchdog_fired, drive.text(68), drive.wear)
        for drive in line.drives
    ]
    return [line.requests, line.aborted, line.collisions, line.clashes, *drives]


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("faults", sorted(set(FAULTS)))
def test_whole_telegrams_are_what_single_bytes_would_be(faults: str, paced: bool) -> None:
    for seed in range(12):
        whole, seen = line_with(faults, seed, paced=paced)
        single, seen_single = line_with(faults, seed, paced=paced)
        byte_by_byte(single)
        run(whole, seen, seed)
        run(single, seen_single, seed)
        assert seen.requests == seen_single.requests
        assert seen.arrived == seen_single.arrived
        assert seen.due == seen_single.due
        assert inside(whole) == inside(single)
        assert whole._spoiler.rng.getstate() == single._spoiler.rng.getstate()


def test_the_traffic_takes_both_ways() -> None:
    ways: Counter[bool] = Counter()
    aborted = collisions = 0
    for seed in range(12):
        line, seen = line_with("", seed, paced=True)
        calm = line._is_calm

        def watched(start_s: float, calm: Callable[[float], bool] = calm) -> bool:
            found = calm(start_s)
            ways[found] += 1
            return found

        line._is_calm = watched  # type: ignore[method-assign]
        run(line, seen, seed)
        aborted += line.aborted
        collisions += line.collisions
    assert min(ways[True], ways[False], aborted) > 100
    assert collisions > 20
