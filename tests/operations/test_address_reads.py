"""Asking addresses that the roster does not have, on a line that goes on with its work."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import pytest

from lecombus.errors import LineLostError, OperationError
from lecombus.fieldbus.lecom.protocol.addressing import Form, is_drive_address
from lecombus.fieldbus.lecom.scanning import Question, Scan, ScanPlan
from lecombus.operations.address_reads import Heard, HeardKind
from lecombus.parameters import Code
from lecombus.schedule import Priority
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

FED = [("a", 11, "8200vector"), ("b", 12, "smvector"), ("c", 13, "822x")]
NEW = [("x", 21, "93xx"), ("y", 34, "generic"), ("z", 99, "smvector"), ("w", 35, "820x")]
WATCHED = "{time: 1s, action: inhibit, configure: true}"
EVERY = tuple(filter(is_drive_address, range(1, 100)))


async def ask(plant: Plant, step: Question) -> Heard:
    return await plant.site.operations.read_address(
        step.address,
        step.code,
        addressing=step.form.value,
        family_name=step.family,
        patient=step.patient,
    )


@dataclass
class ByOperations:
    """What a scan through the daemon asks."""

    plant: Plant

    async def ask(self, step: Question) -> Heard:
        return await ask(self.plant, step)

    async def listen(self, baud: int, for_s: float) -> Heard:
        raise AssertionError("the line is the daemon's")


def test_a_form_that_the_protocol_does_not_know_is_refused() -> None:
    async def test(plant: Plant) -> None:
        with pytest.raises(OperationError, match="addressing takes standard or extended") as found:
            await plant.site.operations.read_address(
                23, Code(9), addressing="both", family_name="generic", patient=False
            )
        assert found.value.kind == "bad-request"

    with_plant(test, roster_text(FED))


def test_a_scan_beside_fed_drives_finds_the_others_and_no_feed_is_late() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        since_s = plant.now_s
        search = Scan(ScanPlan(tuple({*EVERY} - {11, 12, 13}), (19200,), listen_s=0.0))
        await search.run(ByOperations(plant))
        assert sorted((one.address, one.family) for one in search.found) == [
            (21, "93xx"),
            (34, "generic"),
            (35, "820x"),
            (99, "smvector"),
        ]
        for name, address, _ in FED:
            assert plant.line[name].watchdog_fired == 0
            asked = [one.at_s for one in plant.sent_to(address, since_s)]
            pauses = [later - one for one, later in itertools.pairwise(asked)]
            assert max(pauses) < 0.9
        asked_of_unknown = [one for one in plant.reports if one.drive.startswith("address ")]
        assert {one.priority for one in asked_of_unknown} == {Priority.BACKGROUND}

    with_plant(test, roster_text(FED, watchdog=WATCHED), also=NEW)


@pytest.mark.parametrize("seed", range(3))
def test_late_answers_of_the_rosters_drives_make_none_elsewhere(seed: int) -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: plant.site.worker.is_open)
        search = Scan(ScanPlan(EVERY[20:50], (19200,), listen_s=0.0))
        await search.run(ByOperations(plant))
        assert search.found == []

    faults = "late=0.3:0.05s-0.5s:adapter"
    with_plant(test, roster_text(FED), faults=faults, seed=seed)


def test_what_comes_back_is_told_apart() -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: plant.site.worker.is_open)
        value = await ask(plant, Question(0, 21, Code(9), Form.EXTENDED))
        assert (value.kind, value.text, value.exists) == (HeardKind.VALUE, "21", True)
        none = await ask(plant, Question(0, 21, Code(6000)))
        assert (none.kind, none.exists, none.is_answer) == (HeardKind.NO_SUCH_CODE, False, True)
        silence = await ask(plant, Question(0, 22, Code(9)))
        assert (silence.kind, silence.exists, silence.is_answer) == (
            HeardKind.SILENCE,
            None,
            False,
        )
        before = silence.disturbances
        plant.line.faults.bad_bcc = 1.0
        garbled = await ask(plant, Question(0, 21, Code(9)))
        assert garbled.kind is HeardKind.GARBLED
        assert garbled.received
        assert garbled.disturbances > before

    with_plant(test, roster_text([("a", 11, "generic")], drive="cyclic: []"), also=NEW)


@pytest.mark.parametrize(
    ("address", "family", "kind"),
    [(11, "generic", "in-roster"), (20, "generic", "no-such-address"),
     (100, "generic", "no-such-address"), (21, "8200", "bad-request")],
)  # fmt: skip
def test_what_may_not_be_asked_is_refused_before_anything_is_sent(
    address: int, family: str, kind: str
) -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: plant.site.worker.is_open)
        with pytest.raises(OperationError) as refused:
            await ask(plant, Question(0, address, Code(9), family=family))
        assert refused.value.kind == kind
        assert not [one for one in plant.reports if one.drive.startswith("address ")]

    with_plant(test, roster_text(FED))


def test_without_a_line_nothing_is_asked() -> None:
    async def test(plant: Plant) -> None:
        await until(lambda: plant.site.worker.is_open)
        plant.end.unplug()
        await until(lambda: not plant.site.worker.is_open)
        with pytest.raises(LineLostError):
            await ask(plant, Question(0, 21, Code(9)))

    with_plant(test, roster_text(FED))
