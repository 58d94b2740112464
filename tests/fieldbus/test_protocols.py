"""How a line protocol is found by its name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import lecombus.fieldbus
from lecombus.backups import read_backup, write_backup
from lecombus.backups.backup_file import Backup, BackupHead
from lecombus.config import parse_roster
from lecombus.drives import FAMILY_NAMES, family, family_files
from lecombus.errors import ConfigError
from lecombus.fieldbus import protocols
from lecombus.fieldbus.protocols import (
    family_names,
    family_of_any_protocol,
    find,
    names,
    protocol_of,
)
from lecombus.parameters import rules_of
from support.known_protocols import known_protocols_kept


def test_lecom_is_found_once_and_has_the_packaged_families() -> None:
    assert "lecom" in names()
    assert find("lecom") is find("lecom")
    assert find("lecom").rules is rules_of("lecom")
    assert find("lecom").families == FAMILY_NAMES
    assert {family(name).protocol for name in FAMILY_NAMES} == {"lecom"}


@pytest.mark.parametrize("name", ["profibus", "", "lecom.protocol", "protocols"])
def test_a_protocol_that_there_is_not_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"there is no line protocol {name}"):
        find(name)
    with pytest.raises(ConfigError, match=f"there is no line protocol {name}"):
        rules_of(name)


@pytest.mark.parametrize(
    ("address", "what"),
    [(1, None), (99, None), (0, "all drives"), (40, "the group 41..49"), (100, "out of range")],
)
def test_what_is_wrong_with_an_address_is_said_by_the_protocol(
    address: int, what: str | None
) -> None:
    fieldbus = find("lecom")
    wrong = fieldbus.wrong_address(address)
    assert fieldbus.is_address(address) is (wrong is None)
    assert (wrong is None) if what is None else (wrong is not None and what in wrong[0])


BOXED = """\
from pathlib import Path
from toy_fieldbus.toy import Toy
from lecombus.fieldbus.boxed.parameter_rules import RULES


class Boxed(Toy):
    name = "boxed"
    rules = RULES
    families = ("boxedmotor",)

    def read_family_file(self, name):
        return (Path(__file__).parent / "families" / name).read_text(encoding="utf-8")


FIELDBUS = Boxed()
"""
BOXED_RULES = """\
from dataclasses import replace
from toy_fieldbus import toy

RULES = replace(toy.RULES, protocol="boxed")
"""
BOXED_ROSTER = """\
line: {name: boxes, port: "sim:", protocol: boxed}
drives:
  - {name: fan, address: 6, family: boxedmotor}
"""


@pytest.fixture
def boxed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A second protocol in this package, as the toy is made: a room of `fieldbus/`."""
    room = tmp_path / "boxed"
    (room / "families").mkdir(parents=True)
    (room / "__init__.py").touch()
    (room / "fieldbus.py").write_text(BOXED)
    (room / "parameter_rules.py").write_text(BOXED_RULES)
    motor = Path(__file__).parents[1] / "toy_fieldbus" / "toymotor.yaml"
    text = motor.read_text().replace("toymotor", "boxedmotor")
    text = text.replace("protocol: toy", "protocol: boxed")
    (room / "families" / "boxedmotor.yaml").write_text(text)
    known_protocols_kept(monkeypatch)
    monkeypatch.setattr(lecombus.fieldbus, "__path__", [*lecombus.fieldbus.__path__, str(tmp_path)])
    monkeypatch.setattr(protocols, "PACKAGED", (*protocols.PACKAGED, "boxed"))
    for module in ("boxed", "boxed.fieldbus", "boxed.parameter_rules"):
        monkeypatch.delitem(sys.modules, f"lecombus.fieldbus.{module}", raising=False)
    return "boxed"


def test_a_second_packaged_protocol_brings_its_families_to_rosters(boxed: str) -> None:
    roster = parse_roster(BOXED_ROSTER, "boxes.yaml")
    assert (roster.line.protocol, roster.drives[0].family) == (boxed, "boxedmotor")
    assert family("boxedmotor").protocol == boxed


def test_families_of_all_protocols_are_known_without_a_roster(boxed: str) -> None:
    assert protocol_of("boxedmotor") == boxed
    assert family_names() == (*FAMILY_NAMES, "boxedmotor")
    assert protocol_of("boxed") is None
    head = BackupHead("fan", "boxes", 6, "boxedmotor", "2026-11-23T02:00:00Z", "1")
    text = write_backup(Backup(head, family("boxedmotor")))
    assert read_backup(text, "fan.yaml").head.family == "boxedmotor"


def test_a_family_that_a_daemon_names_is_found_without_its_roster(boxed: str) -> None:
    assert "boxedmotor" not in family_files._ADDED
    assert family_of_any_protocol("boxedmotor").protocol == boxed
    assert "boxedmotor" in family_files._ADDED  # loaded here, and not kept of another test
    with pytest.raises(ConfigError, match="there is no family boxed;"):
        family_of_any_protocol("boxed")


def test_a_family_is_found_without_loading_more_protocols(boxed: str) -> None:
    find("lecom")
    assert protocol_of("820x") == "lecom"
    assert "lecombus.fieldbus.boxed" not in sys.modules
