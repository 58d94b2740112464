"""What the packaged descriptions promise the daemon, family by family."""

from __future__ import annotations

import time

import pytest

from lecombus.drives import FAMILY_NAMES, PASSWORDS, WriteClass, family
from lecombus.drives.family_files import load_family
from lecombus.errors import ConfigError
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import Code, Format, Value

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
MODULE = [name for name in DESCRIBED if name != "smvector"]
CUTS_OFF = {Code(9), Code(125), Code(3), Code(1410), Code(1411)}


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_entry_names_its_source(name: str) -> None:
    drive = family(name)
    assert drive.name == name
    manual = {"smvector": "CMVLC401A", "generic": ""}.get(name, "EDB2102EN")
    sources = [info.source for info in drive.codes.values()]
    sources += [word.source for word in drive.words.values()]
    sources += [rule.source for rule in drive.stops.values()]
    sources += [time.source for time in drive.answer_times.values()]
    assert all(source.startswith(f"{manual} ") for source in sources)
    assert drive.other_answer_time.source


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_default_writable_codes_never_cut_a_drive_off(name: str) -> None:
    assert not family(name).writable & CUTS_OFF


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("820x", "C0040 C0046 C0135 C0141 C1922 C1923"),
        *[(n, "C0040 C0043 C0046 C0135 C0141 C1922 C1923") for n in ("821x", "822x", "824x")],
        ("8200vector", "C0040 C0043 C0046 C0135 C1922 C1923"),
        ("93xx", "C0040 C0043 C0135 C0141 C1922 C1923"),
        ("smvector", "C0040 C0043 C0135 C0140 C1061 P425 P426"),
        ("generic", ""),
    ],
)
def test_default_writable_codes_are_setpoints_control_and_watchdog(name: str, codes: str) -> None:
    assert family(name).writable == {Code.parse(code) for code in codes.split()}


@pytest.mark.parametrize("name", DESCRIBED)
def test_what_moves_a_drive_is_marked_as_motion(name: str) -> None:
    moving = {code for code, info in family(name).codes.items() if info.motion}
    assert {Code(40), Code(135), Code(46)} - moving <= ({Code(46)} if name == "93xx" else set())
    assert not moving & {Code(150), Code(68), Code(1923), Code(1425), Code(1)}
    writable = family(name).writable
    watchdog = {Code(1922), Code(1923), Code(1425), Code(1426)}
    assert writable - watchdog <= moving


@pytest.mark.parametrize("name", DESCRIBED)
def test_default_status_set_reads_described_codes_at_a_modest_pace(name: str) -> None:
    status = dict(family(name).status)
    frequency = set() if name == "93xx" else {Code(50)}
    assert {Code(150), Code(68)} | frequency <= status.keys() <= family(name).codes.keys()
    reads_per_s = sum(1 / period_s for period_s in status.values())
    assert 1 <= reads_per_s < 2
    assert family(name).feed_code == Code(150)


@pytest.mark.parametrize(
    ("name", "code", "spoken"),
    [
        ("smvector", "C1411", "P411"),
        ("smvector", "C1500/2", "P500/2"),
        ("smvector", "C0046", "C0046"),
        ("smvector", "C2000", "C2000"),
        ("smvector", "C1061", "C1061"),
        ("smvector", "C1100", "P100"),
        ("8200vector", "C1411", "C1411"),
        ("generic", "C1411", "C1411"),
    ],
)
def test_people_are_told_a_code_as_the_keypad_names_it(name: str, code: str, spoken: str) -> None:
    assert family(name).spoken(Code.parse(code)) == spoken
    assert Code.parse(spoken) == Code.parse(code)


@pytest.mark.parametrize("name", MODULE)
def test_2102_watchdog(name: str) -> None:
    traits = family(name).watchdog
    assert traits is not None
    assert (traits.time_code, traits.action_code) == (Code(1923), Code(1922))
    assert traits.actions == {"none": 0, "inhibit": 1, "quick-stop": 2}
    assert (traits.low_s, traits.high_s, traits.volatile) == (0.050, 65.535, True)


def test_smvector_watchdog() -> None:
    traits = family("smvector").watchdog
    assert traits is not None
    assert (traits.time_code, traits.action_code) == (Code.parse("P425"), Code.parse("P426"))
    assert traits.actions == {"none": 0, "inhibit": 1, "quick-stop": 2, "trip": 3}
    assert (traits.low_s, traits.high_s, traits.volatile) == (0, 65.0, False)


def test_generic_device_is_read_in_standard_form_and_promises_nothing() -> None:
    generic = family("generic")
    assert generic.forms == (Form.STANDARD,)
    assert generic.watchdog is None
    assert (generic.status, generic.codes, generic.stops) == ((), {}, {})
    assert generic.info(Code(40)) is None


@pytest.mark.parametrize("name", DESCRIBED)
def test_described_drives_know_both_addressing_forms(name: str) -> None:
    assert family(name).forms == (Form.STANDARD, Form.EXTENDED)


@pytest.mark.parametrize("name", DESCRIBED)
def test_words_are_hexadecimal_and_have_four_digits(name: str) -> None:
    for number in (68, 135, 150):
        info = family(name).info(Code(number))
        assert info is not None
        assert (info.format, info.hex_digits, info.chars) == (Format.VH, 4, 5)


@pytest.mark.parametrize(
    ("name", "code", "value", "expected"),
    [
        ("8200vector", "C0046", None, WriteClass.PLAIN),
        ("8200vector", "C0135", None, WriteClass.EDGE),
        ("8200vector", "C0135", "H0208", WriteClass.PLAIN),
        ("8200vector", "C0135", "H0800", WriteClass.EDGE),
        ("8200vector", "C0135", "H0040", WriteClass.EDGE),
        ("8200vector", "C0043", "0", WriteClass.EDGE),
        ("8200vector", "C0009", "5", WriteClass.ADDRESS),
        ("8200vector", "C0125", "4", WriteClass.ADDRESS),
        ("8200vector", "C0700", "5", WriteClass.EDGE),
        ("820x", "C0040", None, WriteClass.RESET),
        ("820x", "C0040", "1", WriteClass.RESET),
        ("820x", "C0040", "0", WriteClass.PLAIN),
        ("820x", "C0135", "H0008", WriteClass.RESET),
        ("820x", "C0135", "H0200", WriteClass.PLAIN),
        ("821x", "C0040", "1", WriteClass.PLAIN),
        ("93xx", "C0003", "1", WriteClass.SAVE),
        ("93xx", "C0135", "H0208", WriteClass.PLAIN),
        ("93xx", "C0135", "H0001", WriteClass.EDGE),
        ("smvector", "C1411", "4", WriteClass.ADDRESS),
        ("smvector", "C0135", "H4207", WriteClass.PLAIN),
        ("generic", "C0011", "1", WriteClass.EDGE),
    ],
)
def test_write_class_says_what_repeating_could_do(
    name: str, code: str, value: str | None, expected: WriteClass
) -> None:
    given = Value.parse(value) if value is not None else None
    assert family(name).write_class(Code.parse(code), given) is expected


@pytest.mark.parametrize(
    ("name", "code"),
    [("93xx", "C0046"), ("smvector", "C0046"), ("8200vector", "C0150"), ("8200vector", "C0248")],
)
def test_read_only_codes_are_marked(name: str, code: str) -> None:
    info = family(name).info(Code.parse(code))
    assert info is not None
    assert not info.writable


def test_unknown_family_is_refused_with_those_there_are() -> None:
    with pytest.raises(
        ConfigError, match=r"there is no family 8300; the families are: 820x, 821x, .*generic"
    ):
        family("8300")


def test_families_are_kept() -> None:
    assert all(family(name) is family(name) for name in FAMILY_NAMES)


def test_all_families_load_in_a_fraction_of_a_second() -> None:
    started_s = time.process_time()
    for name in FAMILY_NAMES:
        load_family(name)
    assert time.process_time() - started_s < 1.0


def test_no_family_has_a_secret_code_that_is_not_known_without_its_family() -> None:
    secret = {
        info.code.number
        for name in FAMILY_NAMES
        for info in family(name).codes.values()
        if info.secret
    }
    assert secret <= PASSWORDS
