"""What the restore of a backup may write: the roster's word, the family's rules, and who owns what.

A restore writes far more than the `writable` list of a roster allows, so it has a permission of
its own (`restore: true`), which opens no more than a backup holds: parameters that the family
describes as settings, and the code that saves them. Commands, setpoints, addresses and what
lecombus itself sets from the roster stay shut.

What must not live here: plans and order (`backups`), and whether the drive is there.
"""

from __future__ import annotations

from decimal import Decimal

from lecombus.config import DriveEntry
from lecombus.drives import Family, not_restored, saving_rule
from lecombus.errors import OperationError
from lecombus.operations.reports import RestoreRights
from lecombus.protocol.addressing import Code

__all__ = ["check_restored", "rights_of"]


def rights_of(entry: DriveEntry, family: Family, locked: str | None) -> RestoreRights:
    """Say whether a backup may be restored into a drive, and what the roster sets itself.

    Args:
        entry: What the roster says of the drive.
        family: Its family.
        locked: Why nothing at all is written to it; None where something is.
    """
    owned: tuple[Code, ...] = ()
    traits = family.watchdog
    if entry.watchdog is not None and entry.watchdog.configure and traits is not None:
        owned = (traits.action_code, traits.time_code)
    reason, remedy = "", ""
    if not entry.restore:
        reason = f"the roster does not let {entry.name} be restored"
        remedy = "write `restore: true` for this drive into the roster and reload it (SIGHUP)"
    elif locked is not None:
        reason = f"nothing is written to {entry.name}: {locked}"
        remedy = "see `lecombus status`"
    return RestoreRights(entry.name, not reason, owned, reason, remedy)


def check_restored(
    rights: RestoreRights, family: Family, code: Code, value: Decimal | int | str
) -> None:
    """Refuse what a restore does not write.

    Raises:
        OperationError: `not-writable`.
    """
    why, remedy = rights.reason, rights.remedy
    saving = saving_rule(family)
    saves = saving is not None and code in saving.codes and str(value) == str(saving.value)
    if not why and not saves:
        why = not_restored(family, code, rights.owned) or ""
        remedy = "write it by itself, without `restore`, if it is meant"
    if why:
        raise OperationError(
            f"{code} of {rights.drive} is not restored: {why}",
            kind="not-writable",
            drive=rights.drive,
            code=str(code),
            remedy=remedy,
        )
