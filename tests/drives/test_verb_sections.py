"""A `verbs` table that cannot be meant is refused with its place and what would be right."""

from __future__ import annotations

import pytest

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.family_files import load_family
from lecombus.drives.verb_rules import Access, VerbRules
from lecombus.errors import DescriptionError
from lecombus.parameters import Code

GOOD = """\
family: test
title: a drive for tests
manual: TEST1
addressing: [standard]
codes:
  - {code: C0001, name: mode, format: VD, writable: true, source: "1"}
  - {code: C0011, name: highest, format: VD, source: "1"}
  - {code: C0040, name: inhibit, format: VD, writable: true, source: "1"}
  - {code: C0043, name: reset, format: VD, writable: true, source: "1"}
  - {code: C0046, name: setpoint, format: VD, writable: true, source: "1"}
  - {code: C0135, name: control word, format: VH, hex_digits: 4, writable: true, source: "1"}
  - {code: C0150, name: status, format: VH, hex_digits: 4, source: "1"}
  - {code: C0161, name: memory, format: VD, source: "1"}
answer_times: [{codes: others, read_ms: 20, write_ms: 20, source: "2"}]
hold_after_write_ms: 0
feed: C0150
identity: []
protocol: lecom
status: []
writable: [C0040]
control_words:
  - code: C0135
    bits:
      3: {name: quick_stop, off: [a, b], on: [c, d]}
      9: {name: controller_inhibit, off: [a, b], on: [c, d]}
    reserved: [0, 1, 2, 4, 5, 6, 7, 8, 10, 11, 12, 13, 14, 15]
    source: "3"
verbs:
  control: C0135
  demands:
    - {for: [setpoint, enable], code: C0001, values: [3], remedy: set C0001 = 3, source: "4"}
  enable: {code: C0040, value: 1, proofs: [{code: C0150, mask: 0x80, equals: 0}],
           otherwise: a terminal, source: "5"}
  reset: {code: C0043, value: 0, number: C0161, source: "6"}
  setpoints:
    - {code: C0046, unit: Hz, range: [0, 480], step: 0.1, full_scale: C0011,
       when: {code: C0001, digit: 10, values: [0]}, source: "7"}
"""


def load(text: str) -> VerbRules:
    rules = load_family("test", {"test.yaml": text}.__getitem__).verbs
    assert rules is not None
    return rules


def test_a_good_table_says_what_it_says() -> None:
    rules = load(GOOD)
    assert rules.control == Code(135)
    assert rules.demands[0].access == {Access.SETPOINT, Access.ENABLE}
    assert rules.demands[0].source == "TEST1 4"
    assert rules.setpoints[0].when is not None
    assert rules.setpoints[0].when.digit == 10
    assert rules.reset.number == Code(161)


@pytest.mark.parametrize(
    ("old", "new", "there", "message"),
    [
        ("control: C0135", "control: C0046", "C0046", "not a control word with bits quick_stop"),
        ("control: C0135", "control: C0136", "C0136", "C0136 is not described"),
        ("for: [setpoint,", "for: [setpiont,", "setpiont", "setpiont is not known here"),
        ("code: C0001, values: [3]", "code: C0002, values: [3]", "C0002", "not described"),
        ("values: [3], remedy", "values: [], remedy", "{for", "values must not be empty"),
        ("set C0001 = 3, source", "set C0001 = 3, sauce", "{for", "source is missing"),
        ("enable: {code: C0040", "enable: {code: C0150", "C0150", "C0150 cannot be written"),
        ("proofs: [{code: C0150", "proofs: [{code: C0151", "C0151", "C0151 is not desc"),
        ("reset: {code: C0043, value: 0,", "reset: {code: C0043,", "{code: C0043", "belong"),
        ("number: C0161", "number: C0162", "C0162", "C0162 is not described"),
        ("unit: Hz", "unit: rpm", "rpm", "rpm is not known here; Hz, % are"),
        ("range: [0, 480]", "range: [480, 0]", "[480", "range is the least and the"),
        ("range: [0, 480]", "range: [0]", "[0]", "range is the least and the"),
        ("step: 0.1", "step: 0", "0", "step is over 0"),
        ("full_scale: C0011", "full_scale: C0012", "C0012", "C0012 is not described"),
        ("digit: 10,", "digit: 7,", "7", "1, 10, 100, 1000, 10000 are right here"),
        ("values: [0]}", "values: [12]}", "[12", "from 0 to 9"),
        ("unit: Hz,", "unit: Hz, untie: Hz,", "untie", "untie is not known here"),
    ],
)
def test_a_bad_table_is_refused_with_its_place(
    old: str, new: str, there: str, message: str
) -> None:
    assert GOOD.count(old) == 1
    text = GOOD.replace(old, new)
    with pytest.raises(DescriptionError, match=message) as caught:
        load(text)
    line, column = map(int, caught.value.where.split(":"))
    assert text.splitlines()[line - 1][column - 1 :].startswith(there)


@pytest.mark.parametrize("name", [name for name in FAMILY_NAMES if name != "generic"])
def test_a_roster_without_a_list_lets_every_verb_write(name: str) -> None:
    kind = family(name)
    rules = kind.verbs
    assert rules is not None
    needed = {rules.control, rules.enable.code, *(rule.code for rule in rules.setpoints)}
    needed |= {rules.reset.code} if rules.reset.code is not None else set()
    assert needed <= kind.writable
