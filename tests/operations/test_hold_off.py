"""While one drive passes a write on, the others are spoken to: the line does not wait."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from itertools import permutations

import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.errors import ExchangeError
from lecombus.fieldbus.requests import StepKind
from lecombus.operations.writes import Writes
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from lecombus.schedule.fan_out import least_order, took_s
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

NAMES = {f"d{address}": address for address in range(1, 33) if address % 10}
HOLD_S = 0.23
"""For so long an 820X module is left alone after a write. Source: EDB2102EN 6.3.2."""
LATER_HOLD_S = 0.05
"""The same for a 822X."""

SETPOINT = Code(46)

ROSTER = roster_text(
    [(name, address, "820x") for name, address in NAMES.items()] + [("other", 99, "smvector")],
    drive="cyclic: []",
    sections=f"groups: {{slow: {{members: [{', '.join(NAMES)}]}}}}",
)
"""The drive beside them keeps the group from being one multicast."""

MIXED = [("c", 13, "8200vector"), ("b", 12, "822x"), ("d", 14, "822x"), ("a", 11, "820x")]
MIXED_ROSTER = roster_text(
    [*MIXED, ("other", 19, "smvector")],
    drive="cyclic: [], writable: [C0011, C0046, C1921]",
    sections="groups: {mixed: {members: [c, b, d, a]}, two: {members: [c, a]}}",
)
TEENS_ROSTER = roster_text(
    MIXED, drive="cyclic: []", sections="groups: {teens: {members: [c, b, d, a], multicast: yes}}"
)


async def answer_early(plant: Plant, names: Sequence[str]) -> None:
    """Switch shortened response time on, and wait until it is known."""
    for name in names:
        plant.line[name].model.params.set(1921, "1")
    await plant.online(within_s=600.0)
    stations = plant.site.requests
    await until(lambda: all(stations.station(name).answers_early for name in names), within_s=600.0)


def test_writes_to_many_820x_take_wire_time_and_not_their_processing_time() -> None:
    async def test(plant: Plant) -> None:
        await answer_early(plant, list(NAMES))
        before = len(plant.reports)
        report = await plant.site.operations.write_group("slow", SETPOINT, 20)
        writes = [one for one in plant.reports[before:] if one.step.kind is StepKind.WRITE]
        results = [one.result for one in writes]
        took = results[-1].ended_s - results[0].started_s
        wire_s = sum(result.ended_s - result.started_s for result in results)
        assert {one.outcome for one in report.members} == {Outcome.DONE}
        assert len(results) == len(NAMES)
        assert took < wire_s + 0.01 * len(NAMES)
        assert took < 0.1 * HOLD_S * len(NAMES)

        # And asked for one by one, at once.
        await asyncio.sleep(1.0)
        write, began_s = plant.site.operations.write, plant.now_s
        reports = await asyncio.gather(*(write(name, SETPOINT, 20) for name in NAMES))
        assert {one.outcome for one in reports} == {Outcome.DONE}
        assert plant.now_s - began_s < 0.1 * HOLD_S * len(NAMES)

    with_plant(test, ROSTER)


def test_no_other_order_of_a_group_s_proven_writes_ends_sooner_than_the_one_it_takes() -> None:
    async def test(plant: Plant) -> None:
        await answer_early(plant, ["a", "b", "d"])
        writes = Writes(plant.site.operations.context)
        stations = [plant.site.requests.station(name) for name, _, _ in MIXED]

        async def take_s(order: Sequence[int], value: int) -> float:
            await asyncio.sleep(1.0)
            began_s = plant.now_s
            wire = Value.parse(str(value))
            endings = [
                writes.submit_write(stations[index], SETPOINT, wire, None, verify=True)
                for index in order
            ]
            outcomes = {(await ending.wait())[0] for ending in endings}
            assert outcomes == {Outcome.VERIFIED}
            return plant.now_s - began_s

        all_s = [await take_s(order, 5 + at) for at, order in enumerate(permutations(range(4)))]
        await asyncio.sleep(1.0)
        began_s = plant.now_s
        report = await plant.site.operations.write_group("mixed", SETPOINT, 40, verify=True)
        took = plant.now_s - began_s
        assert [one.drive for one in report.members] == ["c", "b", "d", "a"]
        assert {one.outcome for one in report.members} == {Outcome.VERIFIED}
        assert took < min(all_s) + 0.002
        assert took < max(all_s) - LATER_HOLD_S  # the order matters
        # What was reckoned is what happens.
        part_of = plant.site.requests.maker.part_of_write
        parts = [part_of(one, SETPOINT, Value.decimal(40)) for one in stations]
        assert abs(took_s(parts[index] for index in least_order(parts)) - took) < 0.02

    with_plant(test, MIXED_ROSTER)


def test_members_that_do_not_answer_are_written_to_last() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=600.0)
        plant.line["c"].present = False
        requests = plant.site.requests
        with pytest.raises(ExchangeError):
            await requests.read(requests.station("c"), SETPOINT, Priority.INTERACTIVE, retries=0)
        assert plant.site.store.drive("c").state is DriveState.DEGRADED
        said = len(plant.end.sent)
        await plant.site.operations.write_group("two", SETPOINT, 21)
        writes = [one.data[1:3] for one in plant.end.sent[said:] if b"\x02" in one.data]
        assert writes[0] == b"11"

    with_plant(test, MIXED_ROSTER)


def test_after_a_multicast_only_those_members_are_left_alone_that_need_it() -> None:
    async def test(plant: Plant) -> None:
        await answer_early(plant, ["a", "b", "d"])
        said = len(plant.end.sent)
        report = await plant.site.operations.write_group("teens", SETPOINT, 22)
        assert (report.how, report.outcome) == ("multicast", Outcome.VERIFIED)
        multicast, *proofs = plant.end.sent[said:]
        asked_s = {one.data[1:3]: one.at_s - multicast.at_s for one in proofs}
        assert asked_s[b"13"] < 0.1  # the line waited for the 8200 vector alone
        assert asked_s[b"12"] > LATER_HOLD_S
        assert HOLD_S < asked_s[b"11"] < HOLD_S + 0.1
        assert len(proofs) == len(MIXED)

    with_plant(test, TEENS_ROSTER)
