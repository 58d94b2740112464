"""A child: one line on a paced pseudo terminal, driven to its worst cases on the real clock.

`python -m benchmarks.promises_child NUMBER LINK`: the line is that of `agreement.cases`; asked to
`attack` for so many seconds, it says what was promised, what was measured, and how late this
machine was in it. A machine that makes answers late makes drives look slow, so what was promised is
told twice: with the answer times that the line measured, as `plan --from-daemon` gives it, and by
the manual alone. Drives and daemon's line are in this one process, each in a thread of its own.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from dataclasses import asdict
from pathlib import Path

from agreement.adversary import Adversary
from agreement.cases import CASES
from agreement.hostile import hostile_line
from agreement.running import agree, as_measured, attacked
from lecombus.daemon import SWITCH_INTERVAL_S, opener_for
from lecombus.fieldbus.lecom.simulator import PtyEnd
from lecombus.line.event_loop import run as run_loop
from lecombus.line_runtime import LineRuntime

__all__ = ["main"]

MARGIN_S = 0.006
"""An answer that is to be lost begins so much before it would be given up: the machine's part."""


async def attack(number: int, link: Path, for_s: float) -> None:
    """Attack a line, and print what came of it as one JSON document."""
    roster = CASES[number].roster(str(link))
    sim = hostile_line(roster)
    with PtyEnd(sim, link) as end:

        def tell(act: object) -> None:
            with end.lock:
                act()  # type: ignore[operator]

        clock = asyncio.get_running_loop().time
        site = LineRuntime(roster, opener_for(roster), clock, time.time)
        adversary = Adversary(site, sim, tell, MARGIN_S)
        measured = await attacked(site, adversary, for_s, real=True)
    found = {
        "agreed": [asdict(one) for one in agree(as_measured(site), measured)],
        "by_manual": [asdict(one) for one in agree(roster, measured)],
        "lost": measured.lost,
        "exchanges": measured.exchanges,
        "woken_late_s": site.worker.lateness.take_s(),
    }
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()


def main(number: str, link: str) -> None:
    """Serve one question."""
    logging.disable(logging.CRITICAL)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    asked = json.loads(sys.stdin.readline())
    run_loop(attack, int(number), Path(link), float(asked["for_s"]))


if __name__ == "__main__":
    main(*sys.argv[1:])
