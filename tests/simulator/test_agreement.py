"""Two readings of the same manuals, side by side: the master's descriptions, our tables.

Neither reads the other. Where they disagree, one of them has misread the manual.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from lecombus.drives import FAMILY_NAMES, CodeInfo, Family, family
from lecombus.drives.code_info import Storage
from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.simulator import MemoryEnd, SimDrive, SimLine, build
from lecombus.fieldbus.lecom.simulator.families import MODELS
from lecombus.fieldbus.lecom.simulator.parameters import Kept
from lecombus.fieldbus.port import PortOpener
from lecombus.parameters import Code, Value
from support.sim_host import Host, code_field, read_telegram, write_telegram


def drive_of(name: str) -> tuple[SimDrive, Host]:
    drive = SimDrive(11, name)
    return drive, Host(SimLine([drive], baud=19200))


def answers(drive: SimDrive, code: Code) -> Value:
    return Value.parse(drive.text(code.number, code.subcode))


def described_there(name: str) -> list[CodeInfo]:
    """What is described of the simulated drive, in every parameter set.

    The simulated 820X is of version 1.2, which has no C0120 (EDB2102EN 6.4.2). Of codes whose
    subcodes the manual does not count the first is looked at.
    """
    return [
        replace(info, code=Code(info.code.number, 1)) if info.array else info
        for info in family(name).codes.values()
        if (name, info.code) != ("820x", Code(120))
    ]


def test_both_know_the_same_families() -> None:
    assert set(MODELS) == set(FAMILY_NAMES)


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_described_code_answers_in_the_described_format(name: str) -> None:
    drive, _ = drive_of(name)
    wrong = []
    for info in described_there(name):
        value = answers(drive, info.code)
        digits = len(value.raw) - 1 if info.hex_digits else None
        if (value.format, digits) != (info.format, info.hex_digits):
            wrong.append((str(info.code), value.raw, info.format))
    assert wrong == []


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_both_agree_on_what_can_be_written_at_all(name: str) -> None:
    drive, _ = drive_of(name)
    differ = [
        str(info.code)
        for info in described_there(name)
        if info.writable
        and not drive.model.params.find(info.code.number, info.code.subcode).writable
    ]
    assert differ == []


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_both_agree_on_limits_defaults_and_where_values_live(name: str) -> None:
    drive, _ = drive_of(name)
    kept = {
        Kept.DRIVE: Storage.STORED, Kept.MEMORY: Storage.STORED,
        Kept.MODULE: Storage.MODULE, Kept.PROCESS: Storage.VOLATILE,
    }  # fmt: skip
    differ: list[tuple[object, ...]] = []
    for info in described_there(name):
        spec = drive.model.params.find(info.code.number, info.code.subcode)
        limits = (spec.low, spec.high)
        if info.default is not None and info.default != spec.default:
            differ.append((str(info.code), "default", info.default, spec.default))
        if not info.writable:
            continue
        if info.low is not None and (info.low, info.high) != limits:
            differ.append((str(info.code), "limits", info.low, info.high, *limits))
        # C0043 shows 1 for a fault, and is overwritten with 0 only (EDB2102EN 8.2).
        choices = [choice for choice in info.selection if (spec.number, choice) != (43, 1)]
        if not all(spec.low <= choice <= spec.high for choice in choices):
            differ.append((str(info.code), "selection", *info.selection))
        if kept[spec.kept] is not info.storage:
            differ.append((str(info.code), "storage", info.storage, spec.kept))
    assert differ == []


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_the_master_expects_the_answer_times_that_the_drive_takes(name: str) -> None:
    drive, host = drive_of(name)
    described: Family = family(name)
    char_s = 10 / 19200
    for code in (info.code for info in described_there(name)):
        if code.subcode or code.number > 6229:
            continue
        telegram = read_telegram(11, code.number)
        start_s = host.now_s
        host.say(telegram)
        host.hear()
        took_s = host.arrivals[0][0] - start_s - (len(telegram) + 1) * char_s
        assert took_s == pytest.approx(described.answer_time_s(code, write=False), abs=1e-6), code
    assert drive.model.extended_fault == 0


@pytest.mark.parametrize("number", [0, 9, 10, 46, 150, 789, 790, 1002, 1923, 6229])
def test_both_write_the_same_code_fields(number: int) -> None:
    assert encode_code(Code(number), Form.STANDARD) == code_field(number)
    extended = encode_code(Code(number, 3), Form.EXTENDED)
    assert extended == code_field(number, 3, extended=True)


def test_the_masters_telegrams_are_those_a_drive_hears() -> None:
    from lecombus.fieldbus.lecom.protocol import telegrams

    value = Value.parse("95.2")
    assert telegrams.read_telegram(34, Code(46), Form.STANDARD) == read_telegram(34, 46)
    assert telegrams.write_telegram(34, Code(11), value, Form.STANDARD) == write_telegram(
        34, 11, "95.2"
    )
    assert telegrams.write_telegram(34, Code(39, 1), value, Form.EXTENDED) == write_telegram(
        34, 39, "95.2", 1, extended=True
    )


def test_a_memory_end_opens_as_the_line_wants_it() -> None:
    opener: PortOpener = MemoryEnd(build([("a", 11, "822x")])).open
    assert callable(opener)
