"""Leases: which client may control which drives now, and which drives wait to be enabled again.

Pure: time is an argument, monotonic seconds. `lease_records` holds what is known of a lease and of
a drive's control, `lease_book` what changes it: take, renew, take over, release, lapse, enable.

What must not live here: what a lapse does to a drive (`supervision.lease_watch`), what a request is
refused for besides (`operations`), the HTTP form (`api.lease_routes`).
Source: docs/adr/0079-what-a-lease-promises.md.
"""

from lecombus.leases.lease_book import NEEDED_STOPS, LeaseBook
from lecombus.leases.lease_records import (
    DriveControl,
    EndedLease,
    EndOfLease,
    HeldLease,
    Latch,
    LeaseTerms,
    Use,
)

__all__ = [
    "NEEDED_STOPS",
    "DriveControl",
    "EndOfLease",
    "EndedLease",
    "HeldLease",
    "Latch",
    "LeaseBook",
    "LeaseTerms",
    "Use",
]
