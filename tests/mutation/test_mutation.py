"""Which mutants are run, and by which tests."""

from __future__ import annotations

from mutation.run import PROTOCOL, drawn, files_for

NAMES = [f"lecombus.schedule.queues.x_{number}" for number in range(50)] + [
    f"{PROTOCOL}.parser.x_{number}" for number in range(50)
]


def test_a_sample_is_the_same_for_a_seed_and_another_for_another() -> None:
    assert drawn(NAMES, 20, 1, []) == drawn(NAMES, 20, 1, [])
    assert drawn(NAMES, 20, 1, []) != drawn(NAMES, 20, 2, [])
    assert len(set(drawn(NAMES, 20, 1, []))) == 20
    assert drawn(NAMES, 0, 1, []) == NAMES


def test_modules_may_be_chosen() -> None:
    assert drawn(NAMES, 0, 1, ["parser"]) == NAMES[50:]


def test_each_room_is_tested_by_its_own_tests() -> None:
    assert files_for(NAMES[-1]) == ["tests/protocol"]
