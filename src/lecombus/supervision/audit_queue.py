"""The audits that were asked for and have not begun.

They are asked for by events of the line, which are no tasks and cannot start one; the drive
supervisor's task starts them.
"""

from __future__ import annotations

import asyncio

from lecombus.drive_runtime import Drive, RunningAudit

__all__ = ["AuditQueue"]


class AuditQueue:
    """Takes audits of one line's drives."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Drive, RunningAudit]] = []
        self._wanted = asyncio.Event()

    def ask(self, drive: Drive) -> None:
        """Have a drive audited; one under audit is audited once more when that has ended.

        Its control word is not known any more: it may have restarted.
        """
        drive.control_word.forget()
        if drive.audit.running is not None:
            drive.audit.again = True
            drive.audit.running.asked_again.set()
            return
        drive.audit.running = RunningAudit()
        self._waiting.append((drive, drive.audit.running))
        self._wanted.set()

    def withdraw(self, drive: Drive) -> None:
        """Cancel the audit of a drive, whether it has begun or not."""
        if drive.audit.running is not None:
            drive.audit.running.cancel()

    async def next(self) -> list[tuple[Drive, RunningAudit]]:
        """Wait for audits that were asked for."""
        await self._wanted.wait()
        self._wanted.clear()
        waiting, self._waiting = self._waiting, []
        return waiting
