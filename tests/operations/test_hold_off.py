"""While one drive passes a write on, the others are spoken to: the line does not wait."""

from __future__ import annotations

from lecombus.line.station import StepKind
from lecombus.protocol.addressing import Code
from lecombus.schedule import Outcome
from support.site_host import Plant, roster_of, until, with_plant

NAMES = {f"d{address}": address for address in range(1, 33) if address % 10}
HOLD_S = 0.23
"""For so long an 820X module is left alone after a write. Source: EDB2102EN 6.3.2."""

ROSTER = roster_of(
    [(name, address, "820x") for name, address in NAMES.items()] + [("other", 99, "smvector")],
    drive=", cyclic: []",
    rest=f"groups: {{slow: {{members: [{', '.join(NAMES)}]}}}}",
)
"""The drive beside them keeps the group from being one multicast."""


def test_writes_to_many_820x_take_wire_time_and_not_their_processing_time() -> None:
    async def test(plant: Plant) -> None:
        for name in NAMES:
            plant.line[name].model.params.set(1921, "1")
        await plant.online(within_s=600.0)
        stations = plant.site.requests
        await until(lambda: all(stations.station(name).hold_s for name in NAMES), within_s=600.0)
        before = len(plant.reports)
        report = await plant.site.operations.write_group("slow", Code(46), 20)
        writes = [one for one in plant.reports[before:] if one.step.kind is StepKind.WRITE]
        results = [one.result for one in writes]
        took_s = results[-1].ended_s - results[0].started_s
        wire_s = sum(result.ended_s - result.started_s for result in results)
        assert {one.outcome for one in report.members} == {Outcome.DONE}
        assert len(results) == len(NAMES)
        assert took_s < wire_s + 0.01 * len(NAMES)
        assert took_s < 0.1 * HOLD_S * len(NAMES)

    with_plant(test, ROSTER)
