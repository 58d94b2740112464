"""A roster with one drive at another address, as it is after a readdressing.

What must not live here: readdressing itself (`operations.readdress`).
"""

from __future__ import annotations

from lecombus.config.building import multicast_address
from lecombus.config.models import Roster

__all__ = ["with_address"]


def with_address(roster: Roster, name: str, address: int) -> Roster:
    """Return a roster in which one drive has another address.

    Groups are judged anew: a drive that has left its decade is no longer reached by that decade's
    multicast, and would be reached by another's.

    Args:
        roster: The roster.
        name: The drive.
        address: Its new address, free and valid.
    """
    drives = tuple(
        entry.model_copy(update={"address": address}) if entry.name == name else entry
        for entry in roster.drives
    )
    addresses = {entry.name: entry.address for entry in drives}
    groups = {
        title: group.model_copy(
            update={
                "multicast_address": multicast_address(
                    [addresses[member] for member in group.members], addresses.values()
                )
            }
        )
        for title, group in roster.groups.items()
    }
    return roster.model_copy(update={"drives": drives, "groups": groups})
