"""The roster: what a line consists of, as a person wrote it down, checked to the last key.

`load_roster` reads a file and gives a `Roster` with everything filled in, or raises one
`RosterError` with every mistake as `FILE:LINE:COLUMN: what is wrong, what would be right`.
`describe` says what a roster comes to, for `lecombus check`. `roster_json_schema` is what editors
check a roster with while it is written.
"""

from lecombus.capacity.exchange_costs import line_timing
from lecombus.config.describing import DescribedDrive, DescribedGroup, Description, describe
from lecombus.config.keys import roster_json_schema
from lecombus.config.loading import load_roster, parse_roster
from lecombus.config.mistakes import Mistake, RosterError
from lecombus.roster import (
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
    with_address,
)

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
