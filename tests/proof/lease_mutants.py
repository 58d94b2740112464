"""Copies of the daemon that break one promise of leases each: the proof must find every one.

They are made and used like those of `mutants`. The lines are those of `lease_lines`.
"""

from __future__ import annotations

import sys

from lecombus.leases.lease_book import LeaseBook
from lecombus.schedule.request import Request
from lecombus.schedule.waiting import Waiting
from lecombus.schedule.watchdog_set import WatchdogSet
from lecombus.supervision.health import Health
from lecombus.supervision.lease_watch import LeaseWatch
from proof.mutants import Mutant

__all__ = ["LEASE_MUTANTS"]

LEASE_MUTANTS: dict[str, Mutant] = {
    "the lease is not asked again directly before a telegram": Mutant(
        Request,
        "why_unwanted",
        "writes and self.lease_ended is not None and self.lease_ended()",
        "False",
        (8, 1),
        leased=True,
    ),
    "any token of the same length counts": Mutant(
        sys.modules[LeaseBook.__module__],
        "is_same_token",
        "hmac.compare_digest(*encoded)",
        "len({len(text) for text in encoded}) == 1",
        (2, 1),
        leased=True,
    ),
    "a token that counts no more is taken as none": Mutant(
        LeaseBook,
        "objection",
        "return self._lost(drive, control, now_s)",
        "return None if is_free else self._lost(drive, control, now_s)",
        (8, 5),
        leased=True,
    ),
    "a write without a token is taken where a lease is held": Mutant(
        LeaseBook,
        "objection",
        "lease is None and not control.terms.required",
        "not control.terms.required",
        (8, 9),
        leased=True,
    ),
    "a lapse latches nothing": Mutant(
        LeaseBook,
        "_end",
        "control.latch = Latch.LAPSED if lapsed else Latch.RELEASED",
        "pass",
        (2, 1),
        leased=True,
    ),
    "taking a lease ends the latch": Mutant(
        LeaseBook,
        "take",
        "if not control.terms.has_enable:",
        "if True:",
        (2, 1),
        leased=True,
    ),
    "a latched drive is written to as any other": Mutant(
        LeaseBook,
        "objection",
        "control.latch is None or use in (Use.SETTING, Use.ENABLE)",
        "True",
        (0, 4),
        leased=True,
    ),
    "a setpoint is taken while latched and not stopped": Mutant(
        LeaseBook,
        "objection",
        "or holds_stop(use)",
        "or use is Use.SETPOINT",
        (0, 4),
        leased=True,
    ),
    "a lapse is forgotten": Mutant(
        LeaseWatch,
        "_carry_out",
        "by_action.setdefault(drive.entry.lease.on_lapse, []).append(drive)",
        "self._rounds[drive.name] % 2 or by_action.setdefault("
        "drive.entry.lease.on_lapse, []).append(drive)",
        (2, 1),
        leased=True,
    ),
    "a lapse is handed out twice": Mutant(
        LeaseBook,
        "take_ended",
        "ended, self._ended = self._ended, []",
        "ended, self._ended = [*self._ended, *self._ended], []",
        (2, 1),
        leased=True,
    ),
    "the watch sleeps too long": Mutant(
        LeaseWatch,
        "_sleep_s",
        "max(0.0, next_s - now_s)",
        "max(0.0, next_s - now_s) + 5.0",
        (2, 1),
        leased=True,
    ),
    "a renewal comes to nothing": Mutant(
        LeaseBook,
        "renew",
        "lease.ends_at_s = now_s + lease.time_s",
        "lease.ends_at_s = lease.ends_at_s + 0.0 * now_s",
        (2, 1),
        leased=True,
    ),
    "an old counter renews": Mutant(
        LeaseBook,
        "renew",
        "if counter <= lease.counter:",
        "if False:",
        (2, 1),
        leased=True,
    ),
    "a take-over leaves the former token": Mutant(
        LeaseBook,
        "take",
        "control.lease, control.due_s = lease, None",
        "control.lease, control.due_s = control.lease or lease, None",
        (2, 1),
        leased=True,
    ),
    "a silenced drive is still fed": Mutant(
        Health,
        "silence",
        'self._schedule.park(drive.name, now, f"{drive.name} is offline: {reason}")',
        "pass",
        (9, 1),
        leased=True,
    ),
    "a silence ends before the watchdog's time": Mutant(
        LeaseWatch,
        "_end_silence",
        "control.lease is not None and self._health.is_silence_over(drive)",
        "control.lease is not None",
        (1, 7),
        leased=True,
    ),
    "a drive that runs without a lease after the start is left alone": Mutant(
        LeaseWatch,
        "_look",
        "if not self._is_shown_stopped(name):",
        "if False:",
        (0, 16),
        leased=True,
    ),
    "more proof of a stop goes before other stops": Mutant(
        Waiting,
        "place",
        "self.yields(request)",
        "request.drive in self.silent",
        (35,),
        leased=True,
    ),
    "its own drive's watchdog is left out of the check of a long exchange": Mutant(
        WatchdogSet,
        "_own_beside",
        "if own is None or not own.active or request.members:",
        "if True:",
        (49, 164),
        leased=True,
    ),
}
