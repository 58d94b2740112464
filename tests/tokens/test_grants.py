"""What scopes and targets allow."""

from __future__ import annotations

import pytest

from lecombus.tokens.grants import EVERYTHING, NOTHING, Scope, granted

GROUPS = {"conveyors": ("feeder", "belt"), "all": ("feeder", "belt", "fan")}


@pytest.mark.parametrize(
    ("scopes", "allowed"),
    [
        (["metrics"], {"metrics"}),
        (["read"], {"metrics", "read"}),
        (["write"], {"metrics", "read", "write"}),
        (["control"], {"metrics", "read", "control"}),
        (["write", "control"], {"metrics", "read", "write", "control"}),
    ],
)
def test_a_scope_includes_what_it_cannot_do_without(scopes: list[str], allowed: set[str]) -> None:
    assert granted(map(Scope, scopes)).scopes == allowed


@pytest.mark.parametrize(
    ("targets", "drives", "reached"),
    [
        ([], ["fan", "whatever"], True),
        (["all"], ["whatever"], True),
        (["feeder"], ["feeder"], True),
        (["feeder"], ["feeder", "belt"], False),
        (["feeder"], ["fan"], False),
        (["conveyors"], ["feeder", "belt"], True),
        (["conveyors"], ["belt"], True),
        (["conveyors"], ["fan"], False),
        (["conveyors", "fan"], ["feeder", "belt", "fan"], True),
        (["gone"], ["feeder"], False),
    ],
)
def test_targets_are_drives_and_the_members_of_groups(
    targets: list[str], drives: list[str], reached: bool
) -> None:
    assert granted([Scope.READ], targets).reaches(drives, GROUPS) is reached


def test_nothing_is_allowed_unless_something_is() -> None:
    assert (NOTHING.scopes, NOTHING.reaches(["feeder"], GROUPS)) == (frozenset(), False)
    assert not NOTHING.is_whole
    assert EVERYTHING.scopes == frozenset(Scope)
    assert EVERYTHING.is_whole
