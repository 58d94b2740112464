"""Backups of drives: the file, what two of them differ in, and how one is put back.

`backup_file` is a backup in memory and its file. `compare` finds differences, `restore_plan` says
what a restore would do. `taking` reads a drive whole, and has what is asked of it, `restoring`
carries a plan out and remembers how far it came.

Pure: coroutines here await nothing but `RestoreAccess`, so that they run over HTTP and on a virtual
clock alike. Files, terminals and HTTP are the command line's.
"""

from __future__ import annotations

from lecombus.drives.procedures import ReadAttempt, WriteAttempt, is_passing

from .backup_file import (
    Backup,
    BackupEntry,
    BackupHead,
    Section,
    read_backup,
    section_of,
    wanted_codes,
    write_backup,
)
from .compare import Comparison, Difference, compare
from .restore_plan import RestorePlan, RestoreStep, Skip, make_plan
from .restoring import (
    SUPERSEDED,
    Progress,
    Restored,
    done_line,
    head_line,
    is_inhibited,
    read_progress,
    restore,
    stops_line,
)
from .taking import Listener, NotUsable, RestoreAccess, Taken, take

__all__ = [
    "SUPERSEDED",
    "Backup",
    "BackupEntry",
    "BackupHead",
    "Comparison",
    "Difference",
    "Listener",
    "NotUsable",
    "Progress",
    "ReadAttempt",
    "RestoreAccess",
    "RestorePlan",
    "RestoreStep",
    "Restored",
    "Section",
    "Skip",
    "Taken",
    "WriteAttempt",
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
    "stops_line",
    "take",
    "wanted_codes",
    "write_backup",
]
