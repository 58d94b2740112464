"""What to say of a line on which no drive was found.

Must not live here: what is said of a drive that was found (`identifying`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lecombus.protocol.parser import AnswerParser
from lecombus.protocol.telegrams import BadAnswer
from lecombus.scanning.finding import Unclear

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
        if _is_whole_without_parity(received):
            other = "port" if parity == "line" else "line"
            who = "the port frames 7E1 itself" if parity == "line" else "the port frames 8N1"
            return (
                f"address {address} answers, but no character has the parity expected: {who}",
                f"try --parity {other}, and write `parity: {other}` in the roster",
            )
    if heard:
        address, received = next(((one.address, one.received) for one in unclear), heard[-1])
        return (
            f"something came when address {address} was asked, but never a whole answer: "
            f"{received[:12].hex(' ').upper()}",
            "look for two drives with one address, a missing terminating resistor or bias, or "
            "drives at another baud rate (--all-bauds)",
        )
    return _silence(echo, bauds)


def _silence(echo: bool | None, bauds: Sequence[int]) -> tuple[str, str]:
    rates = ", ".join(map(str, bauds))
    if echo:
        what = (
            f"no drive answers at {rates} baud; what is sent comes back, so adapter and wire "
            "return it"
        )
    else:
        what = f"no drive answers at {rates} baud: not one byte came back"
    more = "" if len(bauds) > 1 else "try --all-bauds; "
    return what, (
        f"{more}check the drives' supply, A and B (swap them once), and that each has an address "
        "of 1 to 99 that does not end in 0; an SMVector wants P400 = 7"
    )


def _is_whole_without_parity(received: bytes) -> bool:
    """Whether bytes are an answer once bit 7 is left out, and none as they are."""
    parser = AnswerParser()
    answer = parser.feed(bytes(byte & 0x7F for byte in received))
    whole = answer is not None and not isinstance(answer, BadAnswer)
    return whole and len(received) > 1
