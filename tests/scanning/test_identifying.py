"""What a drive is, by what it answers: every family, and everything that is odd about one."""

from __future__ import annotations

import pytest

from lecombus.drives import FAMILY_NAMES
from lecombus.fieldbus.lecom.scanning import FoundDrive, FoundWatchdog
from lecombus.fieldbus.lecom.scanning.identifying import identify
from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine, build
from lecombus.parameters import Code
from support.golden import Golden
from support.scanning import ScannedLine

ADDRESS = 23


def identified(family: str, overrides: dict[int, str] | None = None, **late: bool) -> FoundDrive:
    line = build([("x", ADDRESS, family)], baud=9600, overrides={"x": overrides or {}})
    return look(line, **late)


def look(line: SimLine, **late: bool) -> FoundDrive:
    scanned = ScannedLine(line)
    found = scanned.run(identify(scanned, 9600, ADDRESS, **late))
    assert scanned.writes == 0
    return found


def without(family: str, *numbers: int) -> SimLine:
    """A drive that lacks some codes."""
    drive = SimDrive(ADDRESS, family)
    specs = drive.model.params.specs
    assert isinstance(specs, dict)
    for key in [key for key in specs if key[0] in numbers]:
        del specs[key]
    return SimLine([drive], baud=9600)


@pytest.mark.parametrize("family", [name for name in FAMILY_NAMES if name != "generic"])
def test_every_family_is_told_from_the_others(family: str) -> None:
    found = identified(family)
    assert (found.family, found.certain) == (family, True)
    assert found.remarks == ()


def test_another_makers_device_is_generic_and_shows_its_label() -> None:
    found = identified("generic")
    assert (found.family, found.certain, found.watchdog) == ("generic", False, None)
    assert found.labels == ((Code(200), "COUNTER 1.0"),)
    assert "standard addressing only" in found.why


def test_module_and_drive_say_what_software_they_have() -> None:
    assert dict(identified("93xx").labels) == {
        Code(1810): "33S2102I_10000",
        Code(1811): "2000-05-02",
        Code(200): "33S9300I_20000",
        Code(201): "Mar 17 1999 10:31",
    }
    labels = dict(identified("smvector", {1099: "4.2"}).labels)
    assert (labels[Code(1494)], labels[Code(1099)]) == ("1.20", "4.2")
    assert labels[Code(1502)] == "25 (240 VAC three-phase, 2 HP (1.5 kW))"


@pytest.mark.parametrize(
    ("family", "overrides", "watchdog"),
    [
        ("822x", {1922: "2", 1923: "2000"}, FoundWatchdog(2.0, "quick-stop")),
        ("820x", {}, FoundWatchdog(3.0, "none")),
        ("smvector", {1425: "65000", 1426: "3"}, FoundWatchdog(65.0, "trip")),
    ],
)
def test_the_watchdog_is_read_as_it_is(
    family: str, overrides: dict[int, str], watchdog: FoundWatchdog
) -> None:
    assert identified(family, overrides).watchdog == watchdog


@pytest.mark.parametrize("code", [248, 249])
def test_redirected_standard_addressing_does_not_mislead_and_is_remarked(code: int) -> None:
    found = identified("8200vector", {code: "4"})
    assert found.family == "8200vector"
    assert any(remark.startswith(f"C0{code} is 4: every access") for remark in found.remarks)


@pytest.mark.parametrize(
    ("family", "overrides"),
    [
        ("820x", {1: "0"}),
        ("8200vector", {1: "1"}),
        ("93xx", {5: "1000"}),
        ("smvector", {1420: "1"}),
        ("smvector", {1494: "1.30"}),
    ],
)
def test_settings_that_would_surprise_are_remarked(
    family: str, overrides: dict[int, str], golden: Golden
) -> None:
    found = identified(family, overrides)
    assert found.family == family
    golden(*found.remarks)


def test_a_later_82xx_whose_label_says_nothing_is_only_likely_an_821x() -> None:
    found = identified("824x", {200: "S33SX_20000"})
    assert (found.family, found.certain) == ("821x", False)
    assert "correct it by the nameplate" in found.why


def test_a_label_never_overrules_the_codes() -> None:
    assert identified("8200vector", {200: "S33S8221E_11000"}).family == "8200vector"
    assert identified("93xx", {200: "S33S8221E_11000"}).family == "93xx"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (without("93xx", 168), "has no C0168/1"),
        (without("8200vector", 43), "has no C0043"),
        (without("822x", 9), "C0009 reads nothing at 23"),
        (without("smvector", 1410), "C1410 is not there"),
        (without("smvector", 1400), "C1400 is not there"),
    ],
    ids=lambda one: one if isinstance(one, str) else "",
)
def test_what_does_not_fit_whole_is_generic(line: SimLine, why: str) -> None:
    found = look(line)
    assert (found.family, found.certain) == ("generic", False)
    assert why in found.why


def test_another_fieldbus_module_is_generic() -> None:
    found = identified("822x", {1810: "S33S2103I_10000"})
    assert found.family == "generic"
    assert "calls itself '33S2103I_10000', which is no 2102" in found.why


@pytest.mark.parametrize("family", ["820x", "822x", "8200vector", "93xx", "smvector"])
@pytest.mark.parametrize("seed", range(4))
def test_damaged_answers_make_it_generic_or_right_and_never_another(family: str, seed: int) -> None:
    line = build([("x", ADDRESS, family)], baud=9600, seed=seed)
    line.faults.noise = line.faults.bad_bcc = 0.15
    line.faults.half = line.faults.lost = line.faults.request_noise = 0.1
    assert look(line).family in (family, "generic")
