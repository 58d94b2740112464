"""Which mutants are run, and by which tests."""

from __future__ import annotations

import pytest

from mutation.run import PROTOCOL, ROOT, TESTED_BY, drawn, files_for

ROOMS = ("schedule", "protocol")
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


@pytest.fixture(autouse=True)
def tree(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tree as it is stands for the copy with the mutants."""
    monkeypatch.setattr("mutation.run.TREE", ROOT)


def test_each_room_is_tested_by_its_own_tests() -> None:
    for room, name in (("schedule", NAMES[0]), ("protocol", NAMES[-1])):
        files = {str(file.relative_to(ROOT)) for file in (ROOT / "tests" / room).glob("test_*.py")}
        assert set(files_for(name)) == files


@pytest.mark.parametrize(
    ("module", "first"),
    [
        ("schedule.silent_stops", "schedule/test_silent_stops"),
        ("schedule.watchdog_deadline", "schedule/test_watchdog_set"),
        ("fieldbus.lecom.protocol.parser", "protocol/test_parser"),
        ("fieldbus.lecom.protocol.addressing", "protocol/test_codes"),
    ],
)
def test_the_tests_of_a_module_are_run_first(module: str, first: str) -> None:
    assert files_for(f"lecombus.{module}.x_1")[0] == f"tests/{first}.py"


def test_what_is_said_to_test_a_module_is_there() -> None:
    for one in TESTED_BY.values():
        assert any((ROOT / "tests" / room / f"test_{one}.py").exists() for room in ROOMS)
