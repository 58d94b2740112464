"""Reads a roster, the YAML file that describes a line, and checks all of it.

`load_roster` reads a file and returns a `Roster` with all defaults filled in, or raises one
`RosterError` with every mistake as `FILE:LINE:COLUMN: what is wrong, what would be right`.
`describe` gives what `lecombus check` shows. `roster_json_schema` is for editors.
"""

from lecombus.capacity.exchange_costs import line_timing
from lecombus.config.changes import (
    FIXED,
    RosterChanges,
    roster_changes,
    roster_values,
    value_changes,
)
from lecombus.config.describing import describe
from lecombus.config.keys import roster_json_schema
from lecombus.config.loading import load_roster, parse_roster
from lecombus.config.mistakes import Mistake, RosterError
from lecombus.roster import (
    ApiEntry,
    DriveEntry,
    GroupEntry,
    LeaseEntry,
    LineEntry,
    Roster,
    WatchdogEntry,
    with_address,
)

__all__ = [
    "FIXED",
    "ApiEntry",
    "DriveEntry",
    "GroupEntry",
    "LeaseEntry",
    "LineEntry",
    "Mistake",
    "Roster",
    "RosterChanges",
    "RosterError",
    "WatchdogEntry",
    "describe",
    "line_timing",
    "load_roster",
    "parse_roster",
    "roster_changes",
    "roster_json_schema",
    "roster_values",
    "value_changes",
    "with_address",
]
