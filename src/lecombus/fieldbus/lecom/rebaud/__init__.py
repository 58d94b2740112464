"""Another baud rate for a whole line: checked, written drive by drive, confirmed, or taken back.

`checking` holds the conditions before the first write, `moving` the procedure and its way back,
`drives` what is known of each drive, `report` the end. Why it is done so: docs/adr/0024.

Pure: coroutines here await nothing but `access`, which the command carries out on a port of its own
and tests on a simulated line. No daemon may be on the line: all drives share one rate, and drives
at another rate cannot be fed.
"""

from __future__ import annotations

from .drives import DrivePlace, LineAccess, RebaudDrive, Subject
from .moving import Rebaud
from .report import RebaudEnd, ending_of, situation, what_to_do

__all__ = [
    "DrivePlace",
    "LineAccess",
    "Rebaud",
    "RebaudDrive",
    "RebaudEnd",
    "Subject",
    "ending_of",
    "situation",
    "what_to_do",
]
