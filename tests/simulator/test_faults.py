"""Each fault does what it says, and can be turned on and off while the line runs."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.fieldbus.lecom.simulator import (
    Faults,
    LateKind,
    SimDrive,
    SimLine,
    build,
    parse_faults,
)
from lecombus.fieldbus.lecom.simulator.faults import make_noise
from lecombus.fieldbus.lecom.simulator.wire import PARITY_TABLE
from support.sim_host import Host, read_telegram, write_telegram

CHAR_S = 10 / 19200
READ = read_telegram(11, 46)
GOOD = bytes.fromhex("02 34 36 33 35 2E 34 03 1D")


def faulty(faults: Faults, *, seed: int = 1, parity: bool = True) -> Host:
    drives = [SimDrive(n, "822x", overrides={46: "35.4"}) for n in (11, 12)]
    return Host(SimLine(drives, baud=19200, faults=faults, seed=seed, parity=parity))


def test_no_faults_by_default() -> None:
    assert faulty(Faults()).ask(READ) == GOOD


def test_a_lost_answer_was_a_done_write() -> None:
    host = faulty(Faults(lost=1))
    assert host.write(11, 46, "10") == ""
    assert host.line[11].text(46) == "10"


def test_an_unheard_write_was_not_done() -> None:
    host = faulty(Faults(unheard=1))
    assert host.write(11, 46, "10") == ""
    assert host.line[11].text(46) == "35.4"


def test_a_damaged_request_is_never_done() -> None:
    host = faulty(Faults(request_noise=1))
    for _ in range(60):
        assert host.ask(write_telegram(11, 46, "10")) in (b"", b"\x15")
        host.say(b"\x04")
    assert host.line[11].text(46) == "35.4"


def test_an_answer_late_at_the_drive_is_dropped_by_an_eot() -> None:
    host = faulty(Faults(late=1, late_s=(0.2, 0.2), late_kind=LateKind.DRIVE))
    start_s = host.now_s
    assert host.ask(READ) == GOOD
    assert host.now_s - start_s == pytest.approx(0.220 + (6 + 9) * CHAR_S)
    host.say(READ)
    host.wait(0.1)
    host.line.faults.late = 0
    assert host.read(12, 4) == "50"
    assert host.hear() == b""


def test_an_answer_late_at_the_adapter_comes_after_another_drives() -> None:
    host = faulty(Faults(late=1, late_s=(0.3, 0.3)))
    start_s = host.now_s
    host.say(READ)
    host.wait(0.1)
    host.line.faults.late = 0
    host.say(read_telegram(12, 4))
    first = bytes(byte & 0x7F for byte in host.hear(until_s=start_s + 0.25))
    assert first == b"\x0204" + b"50\x03" + first[-1:]
    assert bytes(byte & 0x7F for byte in host.hear()) == GOOD
    assert host.now_s - start_s == pytest.approx(0.320 + (6 + 9) * CHAR_S)
    assert host.line.collisions == 0


def test_a_stubborn_late_drive_speaks_in_spite_of_an_eot() -> None:
    host = faulty(Faults(late=1, late_s=(0.1, 0.1), late_kind=LateKind.STUBBORN))
    host.say(READ)
    host.wait(0.05)
    host.say(b"\x04")
    assert bytes(byte & 0x7F for byte in host.hear()) == GOOD
    host.say(READ)
    host.hear(until_s=host.now_s + 0.120 + 8 * CHAR_S)
    host.say(b"\x04\x04")
    host.hear()
    assert host.line.collisions == 1


def test_two_drives_at_once_cannot_be_understood() -> None:
    host = faulty(Faults(late=1, late_s=(0.1, 0.1), late_kind=LateKind.STUBBORN))
    start_s = host.now_s
    host.say(READ)
    host.hear(until_s=start_s + 0.098)
    host.line.faults.late = 0
    host.say(read_telegram(12, 200))
    heard = bytes(byte & 0x7F for byte in host.hear())
    assert host.line.clashes == 1
    assert host.line.collisions == 0
    assert GOOD not in heard


def test_late_answers_never_stand_inside_one_another() -> None:
    host = faulty(Faults(late=1, late_s=(0.2, 0.2)))
    host.say(READ)
    host.wait(0.1995)
    host.line.faults.late = 0
    host.say(read_telegram(12, 46))
    assert bytes(byte & 0x7F for byte in host.hear()) == GOOD + GOOD


def test_it_is_told_when_a_drive_speaks_and_not_when_its_answer_is_delivered_again() -> None:
    host = faulty(Faults(double=1, double_s=(0.1, 0.1), noise=1))
    spoken: list[float] = []
    host.line.on_answer = lambda _, begin_s, end_s: spoken.append(end_s - begin_s)
    host.say(READ)
    host.hear()
    assert spoken == [pytest.approx(len(GOOD) * CHAR_S)]  # its own characters, without stray ones


def test_wrong_bcc_touches_the_bcc_only() -> None:
    answer = faulty(Faults(bad_bcc=1)).ask(READ)
    assert answer[:-1] == GOOD[:-1]
    assert answer[-1] != GOOD[-1]


def test_a_parity_error_is_one_odd_byte() -> None:
    host = faulty(Faults(parity=1))
    host.say(READ)
    answer = host.hear()
    assert bytes(byte & 0x7F for byte in answer) == GOOD
    assert sum(byte.bit_count() % 2 for byte in answer) == 1


def test_half_an_answer_is_a_beginning_of_it() -> None:
    host = faulty(Faults(half=1))
    lengths = set()
    for _ in range(40):
        answer = host.ask(READ)
        assert GOOD.startswith(answer)
        lengths.add(len(answer))
    assert lengths == set(range(1, len(GOOD)))


def test_nak_refuses_good_writes_and_leaves_reads_alone() -> None:
    host = faulty(Faults(nak=1))
    assert host.write(11, 46, "10") == "NAK"
    assert host.line[11].text(46) == "35.4"
    assert host.read(11, 46) == "35.4"


def test_a_power_cycle_silences_the_drive_and_clears_the_module() -> None:
    host = faulty(Faults())
    host.write(11, 1923, "400")
    host.line.faults.power_cycle = 1
    host.line.faults.power_off_s = 0.5
    assert host.ask(READ) == b""
    host.line.faults.power_cycle = 0
    assert host.ask(READ) == b""
    host.wait(0.6)
    assert host.read(11, 1923) == "3000"
    assert host.read(12, 46) == "35.4"


def test_absent_drives_hear_not_even_groups() -> None:
    host = faulty(Faults(absent={11}))
    assert host.read(11, 46) == ""
    host.write(0, 46, "5")
    host.line.faults.absent.clear()
    assert host.read(11, 46) == "35.4"
    assert host.read(12, 46) == "5"


def test_an_unplugged_line_passes_nothing_either_way() -> None:
    host = faulty(Faults())
    host.say(READ)
    host.line.faults.unplugged = True
    assert host.hear() == b""
    host.write(11, 46, "10")
    host.line.faults.unplugged = False
    assert host.ask(READ) == GOOD


def test_echo_comes_character_by_character_before_the_answer() -> None:
    host = faulty(Faults(echo=True))
    start_s = host.now_s
    assert host.ask(READ) == READ + GOOD
    assert host.arrivals[0][0] == pytest.approx(start_s + CHAR_S)
    assert host.arrivals[5][0] == pytest.approx(start_s + 6 * CHAR_S)


def test_the_echo_is_there_for_groups_and_absent_drives_too() -> None:
    host = faulty(Faults(echo=True, absent={11}))
    assert host.ask(READ) == READ
    group = write_telegram(0, 40, "0")
    assert host.ask(group) == group


def test_a_bad_echo_differs_in_one_character_and_drives_hear_the_right_one() -> None:
    host = faulty(Faults(echo=True, bad_echo=1))
    host.say(READ)
    heard = host.hear()
    echo = heard[: len(READ)]
    sent = READ.translate(PARITY_TABLE)
    assert sum(a != b for a, b in zip(echo, sent, strict=True)) == 1
    assert bytes(byte & 0x7F for byte in heard[len(READ) :]) == GOOD


def test_a_drive_may_have_its_own_faults() -> None:
    host = faulty(Faults(lost=1))
    host.line.drive_faults[12] = Faults()
    assert host.read(11, 46) == ""
    assert host.read(12, 46) == "35.4"


@pytest.mark.parametrize("kind", [LateKind.ADAPTER, LateKind.STUBBORN])
def test_late_answers_fool_a_host_that_takes_what_comes(kind: LateKind) -> None:
    drives = [SimDrive(n, "822x", overrides={4: str(n)}) for n in range(11, 20)]
    faults = Faults(late=0.1, late_s=(0.05, 0.5), late_kind=kind)
    host = Host(SimLine(drives, baud=19200, faults=faults, seed=3))
    wrong = 0
    for n in range(900):
        address = 11 + n % 9
        host.say(read_telegram(address, 4))
        end_s = host.now_s + 0.060
        answer = bytes(byte & 0x7F for byte in host.hear(until_s=end_s))
        wrong += len(answer) == 7 and answer[3:5] != b"%d" % address
    assert wrong > 5


def test_late_drives_that_obey_an_eot_fool_nobody() -> None:
    drives = [SimDrive(n, "822x", overrides={4: str(n)}) for n in range(11, 20)]
    faults = Faults(late=0.1, late_s=(0.05, 0.5), late_kind=LateKind.DRIVE)
    host = Host(SimLine(drives, baud=19200, faults=faults, seed=3))
    for n in range(900):
        address = 11 + n % 9
        host.say(read_telegram(address, 4))
        answer = bytes(byte & 0x7F for byte in host.hear(until_s=host.now_s + 0.060))
        assert answer[3:5] in (b"", b"%d" % address)


def test_faults_strike_about_as_often_as_asked_and_the_same_way_each_time() -> None:
    def losses(seed: int) -> list[bool]:
        host = faulty(Faults(lost=0.2), seed=seed)
        return [host.ask(READ) == b"" for _ in range(1000)]

    first = losses(7)
    assert 150 < sum(first) < 250
    assert losses(7) == first
    assert losses(8) != first


@given(st.randoms(use_true_random=False), st.booleans(), st.sampled_from([GOOD, b"\x06", b"\x15"]))
def test_noise_never_passes_for_another_good_answer(
    rng: object, parity: bool, answer: bytes
) -> None:
    data = answer.translate(PARITY_TABLE) if parity else answer
    noisy = make_noise(data, rng, parity=parity)  # type: ignore[arg-type]
    assert noisy != data
    assert len(noisy) - len(data) in (0, 1, 2, 3)
    if len(answer) == 1:
        good = [b for b in noisy if b == PARITY_TABLE[b & 0x7F]] if parity else list(noisy)
        acks = {b & 0x7F for b in good} & {0x06, 0x15}
        assert acks <= {answer[0]}


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("", Faults()),
        (
            "late=0.05:0.5s,noise=0.05,lost=0.02,absent=11+12",
            Faults(late=0.05, late_s=(0.05, 0.5), noise=0.05, lost=0.02, absent={11, 12}),
        ),
        (
            "late=1:20ms-30ms:drive, echo",
            Faults(late=1, late_s=(0.02, 0.03), late_kind=LateKind.DRIVE, echo=True),
        ),
        ("late=0.1:10ms", Faults(late=0.1, late_s=(0.01, 0.01))),
        ("bad-bcc=0.5,power_cycle=0.1:2s", Faults(bad_bcc=0.5, power_cycle=0.1, power_off_s=2.0)),
        ("unplugged", Faults(unplugged=True)),
    ],
)
def test_fault_texts(text: str, faults: Faults) -> None:
    assert parse_faults(text) == faults


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("los=0.1", "lost"),
        ("lost", "0 to 1"),
        ("lost=2", "0 to 1"),
        ("lost=x", "0 to 1"),
        ("lost=0.1:3s", "too many"),
        ("late=0.1:5", "500ms"),
        ("late=0.1:5s:moon", "adapter"),
        ("late=0.1:0.5s-0.1s", "least"),
        ("absent=11,12", "one of"),
        ("absent=100", "99"),
    ],
)
def test_wrong_fault_texts_say_what_is_right(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_faults(text)


def test_a_world_is_built_with_its_faults() -> None:
    line = build([("feeder", 11, "820x"), ("belt", 12, "smvector")], baud=19200, faults="lost=1")
    assert line["belt"].family == "smvector"
    assert line.faults.lost == 1
    assert Host(line).read(11, 46) == ""
