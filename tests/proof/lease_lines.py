"""Random lines whose drives have leases: those of the others, and a lease entry for each drive.

Two of three drives need a lease. Times and policies are drawn for each drive, and every policy its
family knows comes up. Every fifth line is one of `losses`, with as many lost answers as it
tolerates.
"""

from __future__ import annotations

import dataclasses
from random import Random

from lecombus.config import DriveEntry
from lecombus.drives import StopAction, family, knows_stop
from lecombus.roster import LeaseEntry
from proof.lines import RandomLine, line_of
from proof.losses import tolerant_line

__all__ = ["leased_line"]

TOLERANT_EVERY = 5
MOST_TOLERATED = 2
LEASED = 2_000_003
"""What is drawn of leases is drawn by itself: the line stays that of its seed."""
TIMES_S = (0.3, 1.0, 2.0, 5.0)
POLICIES = ("quick-stop", "quick-stop", "inhibit", "silence", "hold")


def leased_line(seed: int, length_s: float) -> RandomLine:
    """Draw the line of a seed, with leases."""
    if seed % TOLERANT_EVERY == TOLERANT_EVERY - 1:
        tolerate = seed // TOLERANT_EVERY % (MOST_TOLERATED + 1)
        line: RandomLine = tolerant_line(
            seed, tolerate=tolerate, losses=tolerate, length_s=length_s
        )
    else:
        line = line_of(seed, length_s)
    random = Random(seed + LEASED)
    drives = tuple(_leased(drive, random) for drive in line.roster.drives)
    roster = line.roster.model_copy(update={"drives": drives})
    return dataclasses.replace(line, roster=roster, leased=True)


def _leased(drive: DriveEntry, random: Random) -> DriveEntry:
    known = [
        policy for policy in POLICIES
        if policy not in set(StopAction) or knows_stop(family(drive.family), StopAction(policy))
    ]  # fmt: skip
    lease = LeaseEntry(
        required=random.random() < 2 / 3,
        time_s=random.choice(TIMES_S),
        on_lapse=random.choice(known),  # type: ignore[arg-type]
    )
    return drive.model_copy(update={"lease": lease})
