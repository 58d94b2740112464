"""Rosters for the tests of this room, and how to ask what is wrong with one."""

from __future__ import annotations

from pathlib import Path

import pytest

from lecombus.config import Mistake, Roster, RosterError, parse_roster

CONFIG = Path(__file__).parents[2] / "config"

GOOD = """\
line:
  name: hall-3
  port: /dev/serial/by-id/usb-1
drives:
  - name: feeder
    address: 11
    family: 8200vector
  - name: belt
    address: 12
    family: smvector
"""


def mistakes_in(text: str) -> list[Mistake]:
    """Return all mistakes of a roster that must have some."""
    with pytest.raises(RosterError) as caught:
        parse_roster(text, "r.yaml")
    return list(caught.value.mistakes)


def said(text: str) -> list[str]:
    """Return the mistakes of a roster as users see them, without the file."""
    return [str(mistake).removeprefix("r.yaml:") for mistake in mistakes_in(text)]


def only(text: str) -> str:
    """Return the one mistake of a roster."""
    found = said(text)
    assert len(found) == 1, found
    return found[0]


def line_with(*more: str) -> str:
    """Return a good roster with more keys in its line; the first of them is in line 4."""
    return GOOD.replace("drives:", "".join(f"  {key}\n" for key in more) + "drives:")


def drive_with(*more: str, family: str = "8200vector") -> str:
    """Return a good roster with more keys in its only drive; the first of them is in line 8."""
    head = GOOD.split("  - name: belt")[0].replace("8200vector", family)
    return head + "".join(f"    {key}\n" for key in more)


def roster_with(*more: str) -> str:
    """Return a good roster with more keys at its top; the first of them is in line 11."""
    return GOOD + "".join(f"{key}\n" for key in more)


def parsed(text: str) -> Roster:
    """Read a roster that must be right."""
    return parse_roster(text, "r.yaml")
