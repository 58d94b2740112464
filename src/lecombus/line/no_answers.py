"""What to say of a port on which no drive is heard, the same words wherever that shows.

Another program that reads the port takes the bytes of the drives: it is named where it can be
found. Else it is what a person can check: baud rate, A and B, supply.
"""

from __future__ import annotations

from collections.abc import Sequence

from . import devices

__all__ = ["others_at", "shared", "unheard_remedy"]

END_IT = "end it, for only one program can speak on a line"


def others_at(port: str) -> tuple[str, ...]:
    """Name the other programs that have a port open; none where it is no device.

    Takes some tens of milliseconds: not for the event loop.
    """
    return devices.others(port) if port.startswith("/") else ()


def shared(port: str, others: Sequence[str]) -> str:
    """Say that other programs have the port open."""
    have = "has" if len(others) == 1 else "have"
    takes = "takes" if len(others) == 1 else "take"
    return f"{' and '.join(others)} {have} {port} open too and {takes} bytes from the drives"


def unheard_remedy(port: str, baud: int) -> str:
    """Say what to check where nothing is heard and no other program was found."""
    if port.startswith("socket:"):
        return (
            f"check the device server's baud rate and framing ({baud}, 8N1), A and B (swap them "
            "once), and the drives' supply"
        )
    return (
        f"check the baud rate ({baud} here; C0125 or P411 in the drives), A and B (swap them "
        "once), and the drives' supply"
    )
