"""A whole scan in computed time: what is found, in which order, and what never happens."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lecombus.fieldbus.lecom.protocol.addressing import is_drive_address
from lecombus.fieldbus.lecom.scanning import ForeignTalkError, Heard, Question, Scan, ScanPlan
from lecombus.fieldbus.lecom.simulator import SimLine, build
from lecombus.fieldbus.lecom.simulator.wire import PARITY_TABLE
from support.scanning import ScannedLine
from support.sim_host import read_telegram

EVERY = tuple(filter(is_drive_address, range(1, 100)))
ALL_BAUDS = (9600, 19200, 4800, 2400, 1200)
NINE = [
    ("a", 1, "820x"),
    ("b", 11, "8200vector"),
    ("c", 12, "8200vector"),
    ("d", 13, "93xx"),
    ("e", 14, "smvector"),
    ("f", 21, "822x"),
    ("g", 57, "generic"),
    ("h", 58, "smvector"),
    ("i", 99, "93xx"),
]


def scan(
    line: SimLine,
    bauds: tuple[int, ...] = (9600,),
    addresses: tuple[int, ...] = EVERY,
    *,
    thorough: bool = False,
) -> tuple[Scan, ScannedLine]:
    scanned = ScannedLine(line)
    search = Scan(ScanPlan(addresses, bauds, thorough))
    scanned.run(search.run(scanned))
    assert scanned.writes == 0
    return search, scanned


def shape(search: Scan) -> list[tuple[int, str]]:
    return sorted((one.address, one.family) for one in search.found)


WANTED = sorted((address, family) for _, address, family in NINE)


@pytest.mark.parametrize("baud", ALL_BAUDS)
def test_nine_drives_of_six_families_are_found_at_any_rate(baud: int) -> None:
    search, _ = scan(build(NINE, baud=baud), ALL_BAUDS)
    assert shape(search) == WANTED
    assert {one.baud for one in search.found} == {baud}
    assert search.looks_left == 0


def test_the_rate_is_found_before_all_addresses_are_asked_at_another() -> None:
    _, scanned = scan(build([("a", 1, "822x")], baud=19200), ALL_BAUDS)
    elsewhere = [ask for ask in scanned.asked if ask.baud != 19200]
    assert 0 < len(elsewhere) < 10


def test_a_rate_at_which_only_unlikely_addresses_are_is_found_too() -> None:
    search, scanned = scan(build([("a", 77, "822x")], baud=4800), ALL_BAUDS)
    assert shape(search) == [(77, "822x")]
    assert 1200 not in {ask.baud for ask in scanned.asked[100:]}


def two_rates() -> SimLine:
    """A line at 9600 baud with one drive that is set to 19200."""
    line = build([("a", 11, "822x"), ("b", 12, "822x")], baud=9600)
    params = line[12].model.params
    params.set(125, "4")
    params.wear[125, 0] = 1
    return line


def test_only_a_thorough_scan_finds_drives_at_a_second_rate_and_asks_twice() -> None:
    search, _ = scan(two_rates(), (9600, 19200))
    assert [(one.address, one.baud) for one in search.found] == [(11, 9600)]
    search, scanned = scan(two_rates(), (9600, 19200), (11, 12, 13), thorough=True)
    assert [(one.address, one.baud) for one in search.found] == [(11, 9600), (12, 19200)]
    assert len([ask for ask in scanned.asked if (ask.baud, ask.address) == (9600, 13)]) == 2


def test_no_code_comes_round_again_while_an_old_answer_may_come() -> None:
    _, scanned = scan(build([], baud=9600))
    probes = [ask.code for ask in scanned.asked]
    assert len(probes) == len(EVERY)
    assert all(len(set(probes[at : at + 4])) == 4 for at in range(len(probes) - 4))


@pytest.mark.parametrize("kind", ["adapter", "stubborn", "drive"])
@pytest.mark.parametrize("seed", range(3))
def test_late_answers_make_no_drive_where_there_is_none(kind: str, seed: int) -> None:
    line = build(NINE, baud=9600, seed=seed, faults=f"late=0.3:0.1s-0.5s:{kind}")
    search, _ = scan(line)
    there = {address: family for _, address, family in NINE}
    for one in search.found:
        assert one.address in there
        alike = (
            one.family in ("821x", "822x", "824x")
            and there[one.address] == "822x"
            and not one.certain
        )
        assert one.family in (there[one.address], "generic") or alike


def test_a_drive_that_always_answers_late_is_found_and_said_to_be_late() -> None:
    line = build([("a", 11, "822x"), ("b", 34, "822x")], baud=9600, faults="")
    line.drive_faults[34] = build([], baud=9600, faults="late=1:0.15s-0.2s:adapter").faults
    search, _ = scan(line)
    assert [(one.address, one.late) for one in search.found] == [(11, False), (34, True)]


@pytest.mark.parametrize("seed", range(4))
def test_on_a_noisy_line_silent_addresses_are_asked_twice_and_all_drives_found(seed: int) -> None:
    line = build(NINE, baud=9600, seed=seed, faults="noise=0.2,bad-bcc=0.05")
    search, scanned = scan(line)
    assert [address for address, _ in shape(search)] == [address for address, _ in WANTED]
    assert len([ask for ask in scanned.asked if ask.address == 45]) >= 2


def test_an_address_that_never_answers_whole_is_unclear_and_not_a_drive() -> None:
    search, _ = scan(build([("a", 11, "822x")], baud=9600, faults="bad-bcc=1"))
    assert search.found == []
    assert [(one.address, one.baud) for one in search.unclear] == [(11, 9600)]


def test_an_empty_line_has_nothing() -> None:
    search, _ = scan(build([], baud=9600))
    assert (search.found, search.unclear, list(search.samples)) == ([], [], [])


def test_a_line_on_which_somebody_speaks_already_is_not_spoken_on() -> None:
    line = build([("a", 11, "822x")], baud=9600)
    scanned = ScannedLine(line)
    scanned.host.say(read_telegram(11, 150))  # the other master; the drive answers it
    with pytest.raises(ForeignTalkError, match="bytes arrive though nothing was asked"):
        scanned.run(Scan(ScanPlan(EVERY, (9600,))).run(scanned))
    assert scanned.asked == []


def test_another_masters_question_ends_the_scan() -> None:
    talk = read_telegram(77, 150).translate(PARITY_TABLE)

    class Overheard(ScannedLine):
        async def ask(self, ask: Question) -> Heard:
            heard = await super().ask(ask)
            return heard if len(self.asked) < 20 else replace(heard, received=talk)

    scanned = Overheard(build([], baud=9600))
    with pytest.raises(ForeignTalkError, match="asks for address 77"):
        scanned.run(Scan(ScanPlan(EVERY, (9600,))).run(scanned))
    assert len(scanned.asked) == 20
