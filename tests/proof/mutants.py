"""Schedulers that are wrong on purpose: the proof must find each of them out.

Each breaks one thought of `schedule.feeds`. `SEEDS` names lines on which it shows; the tests run
them with and without the mutant.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from lecombus.schedule import Priority, feeds
from lecombus.schedule.choice import Choice
from lecombus.schedule.feeds import Feed, Feeds
from lecombus.schedule.request import Request
from lecombus.schedule.silent_stops import SilentStops

__all__ = ["MUTANTS", "SEEDS", "mutated"]

_fits = Feeds.fits
_with_control = Choice._with_control


def _no_slack_check(self: Feeds, now_s: float, worst_s: float, drive: str) -> bool:
    """Anything may start whenever it likes."""
    return True


def _fed_at(feed: Feed) -> float:
    """Feeds go in the order in which their drives were fed last, whatever their deadlines."""
    return feed.fed_at_s


def _no_blocking(self: Feeds, now_s: float, worst_s: float, drive: str) -> bool:
    """An exchange that is begun is reckoned to take no time."""
    return _fits(self, now_s, 0.0, drive)


def _at_once(self: SilentStops, stop: Request, now_s: float) -> bool:
    """A stop is said again and again to whom nobody answers, whatever becomes of the others."""
    return True


def _feeds_before_shares(
    self: Choice, control: Request, entitled: Request | None, now_s: float
) -> tuple[Request, bool]:
    """What feeds and control leave is all that the lower classes get."""
    if self._shares.had_its_turn(Priority.CONTROL) and self._feed_choice.urgent(now_s) is not None:
        entitled = None
    return _with_control(self, control, entitled, now_s)


MUTANTS = {
    "no slack check": (Feeds, "fits", _no_slack_check),
    "first come instead of deadlines": (feeds, "_hard", _fed_at),
    "no blocking": (Feeds, "fits", _no_blocking),
    "silent drives stopped at any cost": (SilentStops, "goes", _at_once),
    "feeds before shares": (Choice, "_with_control", _feeds_before_shares),
}

SEEDS: dict[str, tuple[int, ...]] = {
    "no slack check": (5, 53),
    "first come instead of deadlines": (40,),
    "no blocking": (69, 101),
    "silent drives stopped at any cost": (50, 58),
    "feeds before shares": (17,),
}
"""Lines that show each mutant; without it they are clean."""


@contextlib.contextmanager
def mutated(name: str) -> Iterator[None]:
    """Let every schedule be wrong in one way."""
    where, what, wrong = MUTANTS[name]
    right = getattr(where, what)
    setattr(where, what, wrong)
    try:
        yield
    finally:
        setattr(where, what, right)
