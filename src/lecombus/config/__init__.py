"""The roster: what a line consists of, as a person wrote it down, checked to the last key.

`load_roster` reads a file and gives a `Roster` with everything filled in, or raises one
`RosterError` with every mistake as `FILE:LINE:COLUMN: what is wrong, what would be right`.
`describe` says what a roster comes to, for `lecombus check`. `roster_json_schema` is what editors
check a roster with while it is written.
"""

from lecombus.config.describing import DescribedDrive, DescribedGroup, Description, describe
from lecombus.config.loading import load_roster, parse_roster
from lecombus.config.mistakes import Mistake, RosterError
from lecombus.config.models import (
    ApiEntry,
    CyclicEntry,
    DriveEntry,
    GroupEntry,
    HttpAddress,
    LeaseEntry,
    LineEntry,
    MqttEntry,
    Roster,
    WatchdogEntry,
)
from lecombus.config.moving import with_address
from lecombus.config.schema import roster_json_schema
from lecombus.config.timing import line_timing

__all__ = [
    "ApiEntry",
    "CyclicEntry",
    "DescribedDrive",
    "DescribedGroup",
    "Description",
    "DriveEntry",
    "GroupEntry",
    "HttpAddress",
    "LeaseEntry",
    "LineEntry",
    "Mistake",
    "MqttEntry",
    "Roster",
    "RosterError",
    "WatchdogEntry",
    "describe",
    "line_timing",
    "load_roster",
    "parse_roster",
    "roster_json_schema",
    "with_address",
]
