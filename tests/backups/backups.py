"""Backups made by hand, for tests of what is done with them."""

from __future__ import annotations

from collections.abc import Mapping

from lecombus.backups import Backup, BackupEntry, BackupHead, ReadAttempt
from lecombus.drives import Family, family
from lecombus.drives.family_files import load_family
from lecombus.parameters import Code, Value

__all__ = ["DRIVE", "TEXT", "answers", "backup_of"]

TEXT = """\
family: test
title: a drive for tests
manual: M
addressing: [standard, extended]
set_offsets: [0, 2000]
codes:
  - {code: C0001, name: mode, name_de: x, format: VD, range: [0, 3], writable: true, sets: true,
     selection: {0: [keypad, x], 3: [LECOM, x]}, source: "1"}
  - {code: C0009, name: address, format: VD, writable: true, write_class: address, source: "1"}
  - {code: C0011, name: highest frequency, format: VD, range: [7.5, 480], unit: Hz, sets: true,
     writable: true, source: "1"}
  - {code: C0012, name: ramp, format: VD, unit: s, writable: true, sets: true, source: "1"}
  - {code: C0046, name: setpoint, format: VD, unit: Hz, writable: true, motion: true, source: "1"}
  - {code: C0094, name: password, format: VD, writable: true, secret: true, source: "1"}
  - {code: C0003, name: save, format: VD, writable: true, write_class: save, source: "1"}
  - {code: C0040, name: inhibit, format: VD, writable: true, motion: true, source: "1"}
  - {code: C0150, name: status, format: VH, hex_digits: 4, source: "1"}
  - {code: C0502, name: drive ID, format: VD, source: "1"}
  - {code: C1810, name: software, format: VS, source: "1"}
  - {code: C1921, name: early answer, format: VD, writable: true, storage: module, source: "1"}
protocol: lecom
answer_times: [{codes: others, read_ms: 20, write_ms: 20, source: "2"}]
hold_after_write_ms: 0
feed: C0150
identity: [C1810, C0502]
status: []
writable: [C0040]
stops:
  - {action: inhibit, code: C0040, value: 0, source: "5",
     proofs: [{code: C0150, mask: 0x80, equals: 0x80}, {code: C0040, equals: 0}]}
saved_by: C0003
restore:
  - {rule: same, codes: [C0502], because: another size, source: "6"}
  - {rule: first, codes: [C0001], because: others follow from it, source: "6"}
  - {rule: last, codes: [C1921], because: blind from then on, source: "6"}
  - {rule: save, codes: [C0003], value: 1, because: lost otherwise, source: "6"}
"""
DRIVE = load_family("test", {"test.yaml": TEXT}.__getitem__)
"""A family with one of each, whose data no manual changes."""


def backup_of(
    kind: str | Family, texts: Mapping[str, str], *, missing: Mapping[str, str] | None = None,
    name: str = "", address: int = 11,
) -> Backup:  # fmt: skip
    """A backup of a drive whose codes read these texts."""
    drive = family(kind) if isinstance(kind, str) else kind
    head = BackupHead("feeder", "hall-3", address, drive.name, "2026-11-22T01:54:43Z", "0.1.0")
    entries = [BackupEntry(Code.parse(code), Value.parse(raw)) for code, raw in texts.items()]
    entries += [BackupEntry(Code.parse(code), None, why) for code, why in (missing or {}).items()]
    entries.sort(key=lambda entry: entry.code)
    return Backup(head, drive, {entry.code: entry for entry in entries}, name)


def answers(texts: Mapping[str, str]) -> dict[Code, ReadAttempt]:
    """What a drive reads now."""
    return {
        Code.parse(code): ReadAttempt(Code.parse(code), Value.parse(raw))
        for code, raw in texts.items()
    }
