"""A child: simulated drives on a pseudo terminal, whose faults and plug are switched by questions.

`python -m faults.line_child LINK --roster FILE`. Questions:

* `faults`: switch these on, as `lecombus simulate --faults` takes them, and all others off;
* `unplug`, `replug`: the adapter;
* `fired`: how often each drive's watchdog has acted; `turns`: which motors turn;
* `value`: what a drive's code holds now.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from lecombus.fieldbus.lecom.simulator import PtyEnd, SimLine
from lecombus.fieldbus.lecom.simulator.faults import parse_faults
from support.paced_line import rostered


def answer(line: SimLine, what: str, text: str = "", drive: str = "", code: int = 0) -> Any:
    """Answer one question."""
    line.advance(time.monotonic())
    if what == "faults":
        line.faults = parse_faults(text)
        return True
    if what == "fired":
        return {one.name: one.watchdog_fired for one in line.drives}
    if what == "turns":
        return [one.name for one in line.drives if abs(one.model.motor.output) > 0]
    assert what == "value"
    return line[drive].text(code)


def main() -> None:
    """Serve until the input ends."""
    link, _, roster = sys.argv[1:]
    line = rostered(Path(roster), "")
    line.watch()
    with PtyEnd(line, Path(link)) as end:
        for row in sys.stdin:
            asked = json.loads(row)
            if asked["what"] in ("unplug", "replug"):
                (end.unplug if asked["what"] == "unplug" else end.replug)()
                said: Any = True
            else:
                with end.lock:
                    said = answer(line, **asked)
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
