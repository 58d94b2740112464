"""Which address reaches a group, and only that group."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.protocol.addressing import multicast_address


@pytest.mark.parametrize(
    ("members", "drives", "address"),
    [
        ([11, 12], [11, 12, 21], 10),
        ([12, 11], [11, 12], 10),  # a decade goes before 0: it reaches no unknown drive
        ([91], [11, 91], 90),
        ([11], [11, 12, 21], None),  # 12 would hear it too
        ([11, 21], [11, 12, 21], None),
        ([11, 12, 21], [11, 12, 21], 0),
        ([1, 2], [1, 2], 0),  # 1 to 9 have no multicast of their own
        ([1, 2], [1, 2, 11], None),
        ([1], [1, 2], None),
        ([], [1, 2], None),
        ([], [], None),
        ([11, 12], [11], None),  # a member that is not a drive of the roster
    ],
)
def test_the_address_reaches_exactly_the_members(
    members: list[int], drives: list[int], address: int | None
) -> None:
    assert multicast_address(members, drives) == address
