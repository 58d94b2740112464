"""Backups of drives: the file, what two of them differ in, and how one is put back.

`document` is a backup in memory, `writing` and `reading` its file. `compare` finds differences,
`plan` says what a restore would do. `access` is all that is asked of a drive, `taking` reads it
whole, `restoring` carries a plan out, `progress` remembers how far that came.

Pure: coroutines here await nothing but `access`, so that they run over HTTP and on a virtual
clock alike. Files, terminals and HTTP are the command line's.
"""

from __future__ import annotations

from lecombus.drives.access import ReadResult, WriteResult, is_passing

from .access import Listener, RestoreAccess
from .compare import Comparison, Difference, compare
from .document import Backup, BackupEntry, Head, Section, section_of, wanted_codes
from .plan import RestorePlan, RestoreStep, Skip, make_plan
from .progress import Progress, done_line, head_line, read_progress
from .reading import read_backup
from .restoring import Restored, is_inhibited, restore
from .taking import Taken, take
from .writing import write_backup

__all__ = [
    "Backup",
    "BackupEntry",
    "Comparison",
    "Difference",
    "Head",
    "Listener",
    "Progress",
    "ReadResult",
    "RestoreAccess",
    "RestorePlan",
    "RestoreStep",
    "Restored",
    "Section",
    "Skip",
    "Taken",
    "WriteResult",
    "compare",
    "done_line",
    "head_line",
    "is_inhibited",
    "is_passing",
    "make_plan",
    "read_backup",
    "read_progress",
    "restore",
    "section_of",
    "take",
    "wanted_codes",
    "write_backup",
]
