"""What the journal is given: operations with their ends, faults, losses, leases, rosters."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import anyio
import pytest

from lecombus.config import parse_roster
from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.journal.chain import Row
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.kept import NOT_KNOWN, Fact
from lecombus.operations.actions import ACTOR, Actor
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from lecombus.supervision.journal_record import LONGEST, JournalRecord
from lecombus.supervision.journal_record import ROSTER as KEPT
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

ROSTER = roster_text(
    [("a", 11, "8200vector"), ("b", 12, "8200vector")],
    drive="watchdog: {time: 2s, action: inhibit, configure: true}, also_writable: [C0001, C0012]",
)


class Kept:
    """A journal that keeps rows in memory; its disk works or fails as a test says."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, str, str, dict[str, str]]] = []
        self.facts: dict[str, str] = {}
        self.trouble = ""
        self.takes_s = 0.2

    def record(
        self, kind: str, drive: str = "", fields: Mapping[str, str] | None = None, *,
        outcome: str = "", is_vital: bool = False,
    ) -> None:  # fmt: skip
        self.rows.append((kind, drive, outcome, dict(fields or {})))

    def intend(
        self, kind: str, drive: str, fields: Mapping[str, str], *, is_vital: bool = False
    ) -> Row:
        assert is_vital or kind != "stop"
        self.rows.append((kind, drive, "asked", dict(fields)))
        return Row(kind, drive, fields, 0)

    async def committed(self, intent: Row) -> None:
        if self.trouble:
            raise JournalFileError(self.trouble)
        await anyio.sleep(self.takes_s)

    def withdraw(self, intent: Row) -> None:
        intent.is_withdrawn = True

    def conclude(self, intent: Row, outcome: str, fields: Mapping[str, str]) -> None:
        self.rows.append((intent.kind, intent.drive, outcome, dict(fields)))

    async def fact(self, name: str) -> str | None:
        return self.facts.get(name)

    def keep(self, fact: Fact) -> None:
        self.facts[fact.name] = fact.text

    def kinds(self, *but: str) -> list[str]:
        return [kind for kind, *_ in self.rows if kind not in but]


def with_record(
    test: Callable[[Plant, Kept, JournalRecord], Awaitable[None]], *, refuses: bool = True
) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        kept: Any = Kept()
        record = JournalRecord(kept, plant.site.store, refuses=refuses)
        record.follow(plant.site.operations)
        await test(plant, kept, record)

    with_plant(scenario, ROSTER)


def test_an_operation_is_recorded_before_it_is_sent_and_at_its_end() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        ACTOR.set(Actor("socket", uid=1000, pid=0))
        await plant.site.operations.write("a", Code(46), 20, verify=True)
        await plant.site.operations.write("a", Code(46), 30)
        first, end, second, _ = kept.rows
        who = {"who": "socket", "uid": "1000", "pid": "0", "process": "?"}
        assert first == ("write", "a", "asked", {"code": "C0046", "value": "20", "old": "0", **who})
        assert end == ("write", "a", "verified", {})
        assert second[3]["old"] == "20"
        with pytest.raises(OperationError):
            await plant.site.operations.write("a", Code(50), 1)
        assert kept.rows[-1][2] == "refused"
        assert "read only" in kept.rows[-1][3]["reason"]
        await plant.site.operations.verb("a", Verb.ENABLE)
        assert kept.rows[-1][:3] == ("verb", "a", "verified")
        assert "C0135:" in kept.rows[-1][3]["written"]

    with_record(test)


def test_a_stop_is_recorded_and_waits_for_nothing() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        kept.trouble = "full"
        report = await plant.site.operations.stop(StopAction.INHIBIT, "all")
        assert report.outcome is Outcome.VERIFIED
        assert [row[:3] for row in kept.rows] == [
            ("stop", "all", "asked"), ("stop", "all", "verified"),
        ]  # fmt: skip
        await plant.site.operations.stop(StopAction.QUICK_STOP, "all")
        assert [row[3].get("shows") for row in kept.rows[1::2]] == ["inhibited", "command_held"]

    with_record(test)


@pytest.mark.parametrize("keys_known", [True, False])
@pytest.mark.parametrize("refuses", [True, False])
def test_while_the_journal_fails_writes_are_refused_if_the_roster_says_so(
    refuses: bool, keys_known: bool
) -> None:
    """The same for a request whose key could not be looked up, though the journal works by now."""

    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        if keys_known:
            kept.trouble = "there is no room"
        else:
            NOT_KNOWN.set("there is no room")
        if not refuses:
            assert (await plant.site.operations.write("a", Code(46), 20)).outcome is Outcome.DONE
            return
        before = tuple(plant.line["a"].log)
        with pytest.raises(OperationError, match="there is no room") as found:
            await plant.site.operations.write("a", Code(46), 20)
        assert (found.value.kind, found.value.drive) == ("journal-failing", "a")
        assert kept.rows[-1][2] == "refused"
        later = set(map(id, plant.line["a"].log)) - set(map(id, before))
        assert not [one for one in plant.line["a"].log if one.kind == "write" and id(one) in later]
        for code, value in ((1, 3), (135, "H0000")):  # who controls it, and a control word
            with pytest.raises(OperationError, match="there is no room"):
                await plant.site.operations.write("a", Code(code), value)
        with pytest.raises(OperationError, match="there is no room"):
            await plant.site.operations.write_group("all", Code(46), 20)
        with pytest.raises(OperationError, match="there is no room"):
            await plant.site.operations.verb("a", Verb.ENABLE)
        # A setting moves nothing, and a plain write that stops is a stop.
        assert (await plant.site.operations.write("a", Code(12), 5)).outcome.is_good
        assert (await plant.site.operations.write_group("all", Code(12), 6)).outcome.is_good
        assert (await plant.site.operations.write("a", Code(135), "H0200")).outcome.is_good

    with_record(test, refuses=refuses)


def test_a_trip_its_number_and_its_end_are_recorded() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        plant.trip("a", 50)
        await until(lambda: any("OH" in row[3].get("fault", "") for row in kept.rows))
        await plant.site.operations.verb("a", Verb.RESET_FAULT)
        await until(lambda: "trip-ended" in kept.kinds())
        await anyio.sleep(10)
        trips = [row for row in kept.rows if row[0].startswith("trip")]
        assert {row[1] for row in trips} == {"a"}
        assert [row[0] for row in trips][-2:] == ["trip", "trip-ended"]
        assert trips[-1][3]["fault"] == trips[-2][3]["fault"]

    with_record(test)


def test_losses_of_drives_and_of_the_line_are_recorded_with_their_ends() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        plant.power_cycle("a", 20.0)
        await until(lambda: "drive-found" in kept.kinds())
        assert [row[:2] for row in kept.rows] == [("drive-lost", "a"), ("drive-found", "a")]
        assert "failed" in kept.rows[0][3]["reason"]
        plant.end.unplug()
        await until(lambda: "line-lost" in kept.kinds())
        plant.end.replug()
        await until(lambda: "line-opened" in kept.kinds())
        assert [row[0] for row in kept.rows if row[0].startswith("line")] == [
            "line-lost", "line-opened",
        ]  # fmt: skip

    with_record(test)


def test_a_lease_is_recorded_for_each_of_its_drives() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        plant.site.operations.leases.take("shift", ["all"], ["a", "b"], 2.0, 1)
        await anyio.sleep(5)
        ends = [row for row in kept.rows if row[0] == "lease-ended"]
        assert [row[1] for row in kept.rows if row[0] == "lease-taken"] == ["a", "b"]
        assert [(row[1], row[3]["end"]) for row in ends] == [("a", "lapsed"), ("b", "lapsed")]
        assert "token" not in str(kept.rows)

    with_record(test)


def test_rosters_are_recorded_by_what_differs_also_since_the_run_before() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        old = parse_roster(ROSTER, "r.yaml")
        new = parse_roster(ROSTER.replace("time: 2s", "time: 3s", 1), "r.yaml")
        await record.started(old, "1")
        assert kept.kinds() == ["start"]
        await record.started(new, "1")
        assert kept.kinds() == ["start", "start", "roster"]
        changed = kept.rows[-1][3]
        assert changed["drives.a.watchdog.time"] == "2.0 -> 3.0"
        await record.reloaded(new, old)
        assert kept.rows[-1][3]["drives.a.watchdog.time"] == "3.0 -> 2.0"
        await record.reloaded(old, old)
        assert kept.kinds("start") == ["roster", "roster"]
        assert "drives.a.address=11" in kept.facts[KEPT].splitlines()

    with_record(test)


def test_texts_of_clients_are_cut() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        with pytest.raises(OperationError):
            await plant.site.operations.write("x" * 5000, Code(46), "y" * 5000)
        assert max(len(text) for row in kept.rows for text in (row[1], *row[3].values())) == LONGEST

    with_record(test)


def test_what_lecombus_sets_in_a_drive_is_recorded() -> None:
    async def test(plant: Plant, kept: Kept, record: JournalRecord) -> None:
        plant.factory_reset("a")
        plant.power_cycle("a", 20.0)
        await until(lambda: "write" in kept.kinds())
        writes = [row for row in kept.rows if row[0] == "write"]
        assert {(row[1], row[2], row[3]["who"]) for row in writes} == {
            ("a", "verified", "lecombus")
        }
        assert "2000" in {row[3]["value"] for row in writes}

    with_record(test)
