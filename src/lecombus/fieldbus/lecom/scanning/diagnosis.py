"""What to say of a line on which no drive was found."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lecombus.fieldbus.lecom.protocol.controls import STX

from .identifying import Unclear

__all__ = ["why_nothing"]

Sample = tuple[int, bytes]


def why_nothing(
    samples: Iterable[Sample],
    unclear: Sequence[Unclear],
    *,
    echo: bool | None,
    parity: str,
    bauds: Sequence[int],
) -> tuple[str, str]:
    """Say why no drive was found, and what to do about it.

    Args:
        samples: What was heard and no answer: the address asked, the bytes as they came.
        unclear: The addresses from which something came every time.
        echo: Whether the line returns what is sent; None where that is not known.
        parity: Who makes parity: `line` (8N1, bit 7) or `port` (7E1).
        bauds: The baud rates tried, bit/s.
    """
    heard = list(samples)
    for address, received in heard:
        if _begins_with_the_other_parity(received, parity):
            other = "port" if parity == "line" else "line"
            who = "the port frames 7E1 itself" if parity == "line" else "the port frames 8N1"
            return (
                f"address {address} answers, but no character has the parity expected: {who}",
                f"try --parity {other}; a roster then needs `parity: {other}`",
            )
    if heard:
        address, received = next(((one.address, one.received) for one in unclear), heard[-1])
        return (
            f"something came when address {address} was asked, but never a whole answer: "
            f"{received[:12].hex(' ').upper()}",
            "look for two drives with one address, a missing terminating resistor or bias, or "
            "drives at another baud rate (--all-bauds)",
        )
    return _silence(echo, parity, bauds)


def _silence(echo: bool | None, parity: str, bauds: Sequence[int]) -> tuple[str, str]:
    rates = ", ".join(map(str, bauds))
    if echo:
        what = (
            f"no drive answers at {rates} baud; what is sent comes back, so adapter and wire "
            "return it"
        )
    else:
        what = f"no drive answers at {rates} baud: not one byte came back"
    more = "" if len(bauds) > 1 else "try --all-bauds; "
    if parity == "port":
        more = f"leave out --parity port unless a device server frames 7E1; {more}"
    return what, (
        f"{more}check the drives' supply, A and B (swap them once), and that each has an address "
        "of 1 to 99 that does not end in 0; an SMVector wants P400 = 7"
    )


def _begins_with_the_other_parity(received: bytes, parity: str) -> bool:
    """Whether bytes begin as an answer does, but for bit 7: STX is 02, with even parity 82.

    The first character is all there is to go by: what follows a wrong one is not kept.
    """
    return received[0] == (STX if parity == "line" else STX | 0x80)
