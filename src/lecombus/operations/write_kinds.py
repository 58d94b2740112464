"""What a plain write is before it is made: a stop, a setting, a command, or of a password."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal

from lecombus.drive_state.drive_runtime import Drive, LineDrives
from lecombus.drive_state.store import Store
from lecombus.drives import asks_to_stop, encode_for
from lecombus.errors import CodeValueError
from lecombus.leases import Use
from lecombus.operations.lease_operations import use_of
from lecombus.parameters import Code, Value

__all__ = ["WriteKinds"]


class WriteKinds:
    """Says what a write to a drive or a group is, as far as that is known before it is made.

    Args:
        drives: The drives of the line.
        store: What was read last: a value may be encoded by its format.
        drive_names: Gives the names of a target's drives, as `OperationContext.drive_names`.
    """

    def __init__(
        self, drives: LineDrives, store: Store, drive_names: Callable[[str], Sequence[str]]
    ) -> None:
        self.drive_names = drive_names
        self._drives = drives
        self._store = store

    def is_secret(self, target: str, code: Code) -> bool:
        """Whether a code of a drive, or of one of a group, is a password."""
        drives = filter(None, map(self._drives.find, self.drive_names(target)))
        return any(drive.family.is_secret(code) for drive in drives)

    def is_stop(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a plain write would stop a drive, or each of a group."""
        wires = self._wires(target, code, value)
        return wires is not None and all(
            asks_to_stop(drive.family, code, wire) for drive, wire in wires
        )

    def is_setting(self, target: str, code: Code, value: Decimal | int | str) -> bool:
        """Whether a write changes a setting of a drive, or of each of a group, and no more."""
        wires = self._wires(target, code, value)
        return wires is not None and all(
            use_of(drive.family, code, wire) is Use.SETTING for drive, wire in wires
        )

    def is_command(self, drive: str, code: Code) -> bool:
        """Whether writing a code of a drive can move it; also if nothing is known of it."""
        found = self._drives.find(drive)
        return found is None or found.family.is_command(code)

    def on_the_wire(self, target: str, code: Code, value: Decimal | int | str) -> str:
        """Return what a write sends, for people; as given where drives differ or refuse it."""
        wires = self._wires(target, code, value)
        texts = {wire.raw for _, wire in wires or ()}
        return texts.pop() if len(texts) == 1 else str(value)

    def _wires(
        self, target: str, code: Code, value: Decimal | int | str
    ) -> list[tuple[Drive, Value]] | None:
        """Encode a value for a drive, or for each of a group; None: a write of it is refused."""
        found: list[tuple[Drive, Value]] = []
        for name in self.drive_names(target):
            drive = self._drives.find(name)
            if drive is None:
                return None
            reading = self._store.reading(name, code)
            last_read = None if reading is None else reading.value
            try:
                wire = encode_for(drive.family, code, value, last_read=last_read)
            except CodeValueError:
                return None  # with the reason
            found.append((drive, wire))
        return found
