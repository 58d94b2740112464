"""Causes are chosen by what supports them, and a rule that says something impossible is refused."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal

import pytest

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.faults.causes import (
    FailedExchange,
    Happened,
    Support,
    cause_rules,
    likely_causes,
)
from lecombus.errors import DescriptionError
from lecombus.parameters import Code, Value

VECTOR = family("8200vector")
SETPOINT, MODE = Code(46), Code(1)


def refused(**more: object) -> FailedExchange:
    known = FailedExchange(Happened.REFUSED, SETPOINT, VECTOR.info(SETPOINT), Value.decimal(20))
    return replace(known, **more)  # type: ignore[arg-type]


def names(known: FailedExchange, kind: str = "8200vector") -> list[str]:
    return [one.rule.name for one in likely_causes(kind, known)]


def test_every_family_has_causes() -> None:
    assert {name for rule in cause_rules() for name in rule.families} == set(FAMILY_NAMES)


def test_every_rule_names_families_there_are_and_codes_they_have() -> None:
    for rule in cause_rules():
        assert rule.families <= set(FAMILY_NAMES), rule.name
        described = [family(name) for name in rule.families if name != "generic"]
        for code in rule.codes:
            # C1071 is only known where the drive's torque mode is described.
            assert any(one.info(code) for one in described) or code == Code(1071), rule.name
        if rule.condition is not None:
            assert all(one.info(rule.condition.code) for one in described), rule.name
        assert rule.source.startswith(("EDB2102EN", "CMVLC401A"))
        assert rule.cause.de
        assert rule.remedy.de


def test_a_value_proves_a_cause_or_rules_it_out() -> None:
    (cause,) = likely_causes("8200vector", refused(values={MODE: Value.decimal(0)}))
    assert (cause.rule.name, cause.support) == ("operating-mode", Support.PROVEN)
    assert cause.shown_by == "C0001 reads 0"
    assert names(refused(values={MODE: Value.decimal(3)})) == []


def test_c1962_chooses_the_cause() -> None:
    assert names(refused(extended=8)) == ["operating-mode"]
    assert names(refused(extended=13)) == ["value-reported"]
    assert names(refused(extended=7)) == ["operating-state"]
    assert names(refused(extended=34)) == ["damaged-write"]


def test_a_c1962_from_an_earlier_exchange_is_not_believed() -> None:
    # C0068 says that the value was bad: number 8 (operating mode) is not of this exchange.
    assert names(refused(extended=8, communication=5)) == ["value-reported"]
    assert names(refused(extended=8, communication=6)) == ["operating-mode"]


def test_a_c1962_that_may_be_left_over_is_possible_and_rules_nothing_out() -> None:
    (cause,) = likely_causes("8200vector", refused(extended=13, left_over=True, communication=5))
    assert (cause.rule.name, cause.support) == ("value-reported", Support.SAID)
    (cause,) = likely_causes("8200vector", refused(extended=13, left_over=True, communication=15))
    assert (cause.rule.name, cause.support, cause.shown_by) == ("value-reported", Support.USUAL, "")
    assert names(refused(extended=13, left_over=True)) == ["operating-mode"]


def test_a_code_that_the_drive_has_answered_is_not_said_to_be_missing() -> None:
    assert names(refused(extended=5, communication=4)) == ["no-such-code"]
    assert names(refused(extended=5, communication=4, answered=True)) == []
    assert names(refused(communication=4, answered=True)) == []


def test_without_anything_said_the_usual_cause_is_named_and_called_no_more_than_that() -> None:
    (cause,) = likely_causes("8200vector", refused())
    assert (cause.rule.name, cause.support) == ("operating-mode", Support.USUAL)


def test_what_the_description_knows_needs_no_drive() -> None:
    known = FailedExchange(
        Happened.REFUSED, SETPOINT, VECTOR.info(SETPOINT), Value.decimal(Decimal("999.5"))
    )
    assert names(known) == ["out-of-range"]
    status = Code(150)
    known = FailedExchange(Happened.REFUSED, status, VECTOR.info(status), Value.hexadecimal(0, 4))
    assert names(known) == ["read-only"]


def test_a_family_without_a_description_names_no_cause_of_a_refused_write() -> None:
    assert (
        names(FailedExchange(Happened.REFUSED, SETPOINT, None, Value.decimal(1)), "generic") == []
    )


RULE = """\
families: {all: [generic]}
causes:
  - name: one
    families: [generic]
    happened: [refused]
    value: {code: C0001, in: [1]}
    cause: [a, b]
    remedy: [c, d]
    source: "M 1"
"""


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("happened: [refused]", "happened: [oops]", "causes.yaml:5:16: oops is not known here"),
        ("in: [1]", "is: [1]", "causes.yaml:6:26: is is not known here"),
        ("in: [1]", "in: [1], below: 3", "one of not_in, in, below"),
        ("in: [1]", "in: []", "at least one number"),
        ("cause: [a, b]", "cause: [a]", "causes.yaml:7:12: a text is given in two languages"),
        ('    source: "M 1"\n', "", "source is missing"),
        ("    remedy", "    when: [oops]\n    remedy", "oops is not known here"),
    ],
)
def test_a_wrong_rule_is_refused_with_its_place(old: str, new: str, why: str) -> None:
    assert len(cause_rules({"causes.yaml": RULE}.__getitem__)) == 1
    with pytest.raises(DescriptionError, match=why):
        cause_rules({"causes.yaml": RULE.replace(old, new, 1)}.__getitem__)


def test_a_rule_given_twice_is_refused() -> None:
    twice = RULE + RULE.partition("causes:\n")[2]
    with pytest.raises(DescriptionError, match="one stands here twice"):
        cause_rules({"causes.yaml": twice}.__getitem__)
