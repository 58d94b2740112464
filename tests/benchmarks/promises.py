"""What `plan` promises against what ten lines show at their worst, on the real clock.

Each line is a child on a pseudo terminal of its own, paced byte by byte, under attack for a minute
(`agreement.adversary`); as many run at once as there are processors. How late this machine was is
measured beside, taken off, and shown; the figures with everything in them go to standard error as
a table. Two rows a line: no promise may be broken, with the answer times that the line measured (a
machine that makes answers late makes drives look slow); and tight ones, by the roster alone, must
be used to three quarters.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

from agreement.cases import CASES, Case
from agreement.running import Agreed
from support.children import CORES, child

from .table import Row

__all__ = ["measure"]

LENGTH_S = 60.0
LEAST_RATIO = 0.75
MOST_RATIO = 1.01
"""A hundredth for what of the machine's lateness cannot be seen: between the threads of a child."""
HEAD = "| line | promise of | promised | measured | of it the machine's lateness | ratio | tight |"


def measure(folder: Path, rounds: int) -> list[Row]:
    """Attack all lines; `rounds` makes no difference, as a worst case is not a median."""
    found: list[tuple[Case, dict[str, Any]]] = []
    for first in range(0, len(CASES), len(CORES)):
        numbers = range(first, min(first + len(CORES), len(CASES)))
        with contextlib.ExitStack() as stack:
            children = [
                stack.enter_context(
                    child(
                        "benchmarks.promises_child",
                        str(number),
                        folder / f"line-{number}",
                        core=core,
                    )
                )
                for number, core in zip(numbers, CORES, strict=False)
            ]
            for one in children:
                one.tell("attack", for_s=LENGTH_S)
            found += [
                (CASES[number], one.hear()) for number, one in zip(numbers, children, strict=True)
            ]
    agreed = [(case, [Agreed(**one) for one in answer["agreed"]]) for case, answer in found]
    print(details(agreed), file=sys.stderr)
    return [
        row
        for (case, rows), (_, answer) in zip(agreed, found, strict=True)
        for row in both(case, rows, answer)
    ]


def both(case: Case, agreed: list[Agreed], answer: dict[str, Any]) -> list[Row]:
    """Make the two rows of a line."""
    worst = max(agreed, key=_ratio)
    by_manual = [Agreed(**one) for one in answer["by_manual"]]
    tight = [one for one in by_manual if one.what in case.tight]
    least = min(tight, key=_ratio)
    late_ms = max(one.late_s for one in agreed) * 1000
    return [
        Row(
            f"{case.name}: the worst against its promise ({worst.what})",
            _ms(worst.measured_s), f"promised {_ms(worst.promised_s)}", worst.ratio, MOST_RATIO,
            note=f"{len(agreed)} promises, {answer['exchanges']} exchanges, {answer['lost']} "
            f"answers lost; machine late by up to {late_ms:.1f} ms in one, taken off",
        ),
        Row(
            f"{case.name}: the least of {len(tight)} tight promises ({least.what})",
            _ms(least.measured_s), f"promised {_ms(least.promised_s)}", least.ratio, LEAST_RATIO,
            at_least=True,
        ),
    ]  # fmt: skip


def details(agreed: list[tuple[Case, list[Agreed]]]) -> str:
    """Lay out every promise; it is Markdown."""
    lines = [HEAD, "|---" * HEAD.count(" | ") + "|---|"]
    lines += [
        f"| {case.name} | {one.what} | {_ms(one.promised_s)} | {_ms(one.measured_s)} "
        f"| {_ms(one.late_s)} | {one.ratio:.2f} | {'yes' if one.what in case.tight else ''} |"
        for case, rows in agreed
        for one in rows
    ]
    return "\n".join(lines)


def _ratio(one: Agreed) -> float:
    return one.ratio


def _ms(seconds: float) -> str:
    return f"{seconds * 1000:.1f} ms"
