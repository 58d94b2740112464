"""How much is done for one exchange, counted in calls: what no busy machine can blur.

Processor time is measured by `make bench` (docs/adr/0029); this holds what it follows from, so that
nothing creeps into the path behind every exchange unseen. Whoever adds to it on purpose sets the
limit anew, and says why. Bytes come one by one here: eight calls' worth of parsing each.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

import anyio
import pytest

import lecombus
from support.rosters import roster_text
from support.site_host import Plant, with_plant

OURS = str(Path(lecombus.__file__).parent)
SIMULATED = str(Path(OURS) / "fieldbus" / "lecom" / "simulator")
DRIVES = [(f"d{number}", number, "smvector") for number in range(1, 8)]
SECONDS = 10.0


class Calls:
    """Counts the calls of lecombus' own functions, the simulator's left out."""

    def __init__(self) -> None:
        self.count = 0

    def __enter__(self) -> Calls:
        sys.setprofile(self._note)
        return self

    def __exit__(self, *exc: object) -> None:
        sys.setprofile(None)

    def _note(self, frame: FrameType, event: str, arg: object) -> None:
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(OURS) and not name.startswith(SIMULATED):
            self.count += 1


@pytest.mark.parametrize(
    ("every", "most"),
    [
        pytest.param("20ms", 200, id="a full line: one exchange follows the other"),
        # 292: three more than before, as three functions were split off to be used twice
        # (`_waited_for_s`, `left_s`, `need_s`); a few more, so that such a split is not a failure
        pytest.param("1s", 296, id="an idle line: each exchange is waited for"),
    ],
)
def test_an_exchange_takes_no_more_calls_than_it_did(every: str, most: int) -> None:
    cyclic = f"cyclic: [{{code: C0150, every: {every}}}, {{code: C0050, every: {every}}}]"

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(30.0)
        worker = plant.site.worker
        before = worker.exchanges
        with Calls() as calls:
            await anyio.sleep(SECONDS)
        exchanges = worker.exchanges - before
        assert exchanges > 100
        assert calls.count / exchanges <= most

    with_plant(test, roster_text(DRIVES, drive=cyclic))
