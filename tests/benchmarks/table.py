"""The one table: what was measured, against what, and whether that is what we promise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

__all__ = ["Row", "percentile", "ratios", "render", "spread"]


@dataclass(frozen=True)
class Row:
    """One figure.

    Args:
        figure: What was measured.
        ours: Our number, with its unit.
        peer: What it is compared with, and its number.
        result: The number that is promised.
        limit: What is promised of it; none: only shown.
        at_least: The promise is a lower bound.
        digits: Decimals shown.
        note: What else should be known.
    """

    figure: str
    ours: str
    peer: str
    result: float
    limit: float | None = None
    at_least: bool = False
    digits: int = 2
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the promise is kept."""
        if self.limit is None:
            return True
        return self.result >= self.limit if self.at_least else self.result <= self.limit

    def cells(self) -> tuple[str, ...]:
        """The row as text."""
        promise = "" if self.limit is None else f"{'≥' if self.at_least else '≤'} {self.limit:g}"
        verdict = "" if self.limit is None else "met" if self.met else "MISSED"
        result = f"{self.result:.{self.digits}f}"
        return (self.figure, self.ours, self.peer, result, promise, verdict, self.note)


HEAD = ("figure", "ours", "peer", "result", "promise", "", "note")


def render(rows: Sequence[Row]) -> str:
    """Lay the table out; it is Markdown as well."""
    cells = [HEAD, *(row.cells() for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(HEAD))]
    lines = ["| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def ratios(ours: Sequence[float], peers: Sequence[float]) -> float:
    """The median of the ratios of neighbours: both of a pair saw about the same machine."""
    return median(mine / theirs for mine, theirs in zip(ours, peers, strict=True))


def spread(numbers: Sequence[float], digits: int = 1) -> str:
    """Median, least and most."""
    low, middle, high = min(numbers), median(numbers), max(numbers)
    return f"{middle:.{digits}f} ({low:.{digits}f}..{high:.{digits}f})"


def percentile(numbers: Sequence[float], share: float) -> float:
    """The number that so large a share of all does not exceed."""
    ordered = sorted(numbers)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
