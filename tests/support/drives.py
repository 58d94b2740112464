"""Simulated drives as a roster wants them."""

from __future__ import annotations

from lecombus.config import DriveEntry
from lecombus.drives import family

__all__ = ["presets"]


def presets(entry: DriveEntry) -> dict[int | tuple[int, int], str]:
    """Return the codes of a drive's own watchdog as its roster entry wants them; may be empty."""
    traits = family(entry.family).watchdog
    if entry.watchdog is None or traits is None:
        return {}
    return {
        traits.time_code.number: str(round(entry.watchdog.time_s * 1000)),
        traits.action_code.number: str(traits.actions[entry.watchdog.action]),
    }
