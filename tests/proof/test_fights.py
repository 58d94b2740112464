"""Two controllers fight over a drive over HTTP: the history fits, and planted faults show in it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from proof.fights import SETPOINT, fight, judge
from proof.lease_mutants import LEASE_MUTANTS
from proof.mutants import applied

SEEDS = (0, 1, 2)
FOUND = {
    "the lease is not asked again directly before a telegram": (2, 3),
    "any token of the same length counts": (0,),
    "taking a lease ends the latch": (0,),
    "a latched drive is written to as any other": (0,),
    "a setpoint is taken while latched and not stopped": (0,),
    "a lapse is forgotten": (0, 1),
    "a take-over leaves the former token": (0,),
}


@pytest.mark.parametrize("seed", SEEDS)
def test_only_the_holder_of_the_newest_token_moves_the_drive(seed: int) -> None:
    history, received = fight(seed)
    assert judge(history, received) == []
    answers = {(one.what, one.answer) for one in history}
    for word in ("lease-lost", "latched", "lease-required", "done"):
        assert ("setpoint", word) in answers
    assert ("enable", "verified") in answers
    assert sum(one.code == SETPOINT for one in received) > 20


@pytest.mark.parametrize("name", FOUND)
def test_a_planted_fault_shows_in_the_history(name: str) -> None:
    with applied(LEASE_MUTANTS[name]):
        found = [text for seed in FOUND[name] for text in judge(*fight(seed))]
    assert found


def test_a_write_that_was_refused_and_arrived_all_the_same_is_found() -> None:
    history, received = fight(0)
    refused = next(one for one in history if one.value and one.answer == "lease-lost")
    at = next(at for at, one in enumerate(received) if one.code == SETPOINT)
    received[at] = replace(received[at], text=refused.value)
    assert any(f"{refused.value} of {refused.who}" in text for text in judge(history, received))
