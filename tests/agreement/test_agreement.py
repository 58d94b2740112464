"""Measured worst cases of ten lines stay within what the plan promised, and come close to it.

In virtual time; `make bench` runs the same on the paced pseudo terminal and the real clock.
"""

from __future__ import annotations

import pytest

from agreement.cases import CASES, CROWDED, Case
from agreement.running import Agreed, agree, attack_in_virtual_time

LEAST_RATIO = 0.75
LENGTH_S = 60.0
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def agreed() -> dict[str, list[Agreed]]:
    """Attack all lines once."""
    return {
        case.name: agree(case.roster(), attack_in_virtual_time(case, LENGTH_S)) for case in CASES
    }


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_nothing_is_worse_than_promised(case: Case, agreed: dict[str, list[Agreed]]) -> None:
    beyond = [one for one in agreed[case.name] if one.ratio > 1.0 + ROUNDING]
    assert beyond == []
    watched = any(drive.watchdog for drive in case.roster().drives)
    assert ("feed distance" in {one.what for one in agreed[case.name]}) == watched


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_promises_are_no_idle_talk(case: Case, agreed: dict[str, list[Agreed]]) -> None:
    ratios = {one.what: one.ratio for one in agreed[case.name]}
    assert case.tight <= ratios.keys()
    loose = {what: ratios[what] for what in case.tight if ratios[what] < LEAST_RATIO}
    assert loose == {}


def test_each_promise_is_tight_on_several_lines() -> None:
    kinds = {what for case in CASES for what in case.tight}
    assert kinds == {
        "failed exchange", "stop", "stop, loaded", "control", "control, loaded", "interactive",
        "interactive, loaded", "cyclic", "background", "feed distance",
    }  # fmt: skip
    for what in kinds:
        assert sum(what in case.tight for case in CASES) >= 3, what


@pytest.mark.parametrize("case", [*CROWDED, *CASES[-2:]], ids=lambda case: case.name)
def test_nothing_starves_among_clients_that_ask_without_a_pause(case: Case) -> None:
    found = agree(case.roster(), attack_in_virtual_time(case, LENGTH_S / 2, crowd=True))
    waits = {one.what: one for one in found if one.what.endswith(", crowded")}
    assert waits.keys() == {"interactive, crowded", "background, crowded"}
    assert [one for one in waits.values() if one.ratio > 1.0 + ROUNDING] == []
