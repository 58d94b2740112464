"""What decides how a drive is to be taken is followed: signal configuration, early answers."""

from __future__ import annotations

from decimal import Decimal

import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from lecombus.supervision.configurations import Configurations
from support.rosters import roster_text
from support.single_drives import AskedLine, drive_of, read_of
from support.site_host import Plant, until, with_plant

C0005, C0135, C0150, C1921 = Code(5), Code(135), Code(150), Code(1921)


class Post:
    """Follows one drive."""

    def __init__(self, kind: str = "93xx") -> None:
        self.drive = drive_of("a", kind)
        self.line = AskedLine()
        self.following = Configurations(self.line)

    @property
    def taken(self) -> list[str]:
        return self.line.families

    @property
    def early(self) -> list[bool | None]:
        return self.line.early

    @property
    def asked(self) -> list[Code]:
        return [code for _, code, how in self.line.asked if how == "soon"]

    @property
    def asked_later(self) -> list[Code]:
        return [code for _, code, how in self.line.asked if how == "later"]

    def reads(self, raw: str, code: Code = C0005) -> None:
        self.following.exchange_ended(read_of(self.drive, code, raw))


def test_a_change_is_told_once() -> None:
    post = Post()
    for raw in ("1001", "1001", "1011", "5001", "72000", "72000", "1001"):
        post.reads(raw)
    assert post.taken == ["1xx1", "5xx1", "", "1xx1"]


@pytest.mark.parametrize("raw", ["1001.5", "S1001", "O01"])
def test_what_is_no_number_is_no_configuration(raw: str) -> None:
    post = Post()
    post.reads("1001")
    post.reads(raw)
    assert post.taken == ["1xx1", ""]


def test_after_a_write_nothing_is_known_until_it_is_read() -> None:
    post = Post()
    post.reads("1001")
    post.following.written(post.drive, C0135)
    assert (post.taken, post.asked) == (["1xx1"], [])
    post.following.written(post.drive, C0005)
    assert (post.taken, post.asked) == (["1xx1", ""], [C0005])
    post.line.fails = True
    post.following.written(post.drive, C0005)
    assert post.taken == ["1xx1", ""]


def test_other_codes_families_and_drives_say_nothing() -> None:
    post = Post()
    post.reads("1001", C0135)
    post.following.exchange_ended(read_of(drive_of("b"), C0135, "1001"))
    inverter = Post("8200vector")
    inverter.reads("1001")
    inverter.following.written(inverter.drive, C0005)
    assert (post.taken, inverter.taken, inverter.asked) == ([], [], [])


ROSTER = roster_text([("a", 11, "93xx"), ("b", 12, "8200vector")], drive="writable: [C0005, C0040]")


def configuration(plant: Plant, drive: str = "a") -> str:
    known = plant.site.store.family(drive).configuration
    assert plant.site.requests.station(drive).family.configuration == known
    return known


def states(plant: Plant, drive: str = "a") -> tuple[str, ...] | None:
    found = plant.site.store.drive(drive).states
    return None if found is None else tuple(state.value for state in found)


def test_it_is_read_at_the_audit_and_kept_until_the_next() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.params.set(5, "5001")
        await plant.online()
        assert configuration(plant) == "5xx1"
        assert configuration(plant, "b") == ""
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        assert configuration(plant) == "5xx1"
        assert states(plant) is None
        plant.line["a"].model.params.set(5, "4001")
        plant.line.faults.absent = set()
        await plant.online()
        assert configuration(plant) == "4xx1"

    with_plant(test, ROSTER)


def test_a_write_of_it_is_followed() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        assert configuration(plant) == "1xx1"
        operations = plant.site.operations
        await operations.write("a", Code(40), Decimal(0))
        report = await operations.write("a", C0005, Decimal(4001))
        assert report.outcome is Outcome.DONE
        await until(lambda: configuration(plant) == "4xx1", within_s=1.0)

    with_plant(test, ROSTER)


def test_a_reload_that_changes_the_drive_reads_it_anew() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.apply(ROSTER.replace("93xx,", "93xx, answer_time: 70ms,"))
        assert configuration(plant) == ""
        await plant.online()
        assert configuration(plant) == "1xx1"

    with_plant(test, ROSTER)


def test_states_and_status_bits_follow_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await until(lambda: states(plant) is not None)
        shown = states(plant)
        assert shown is not None
        assert "ready" in shown
        assert "inhibited" in shown or "enabled" in shown
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        assert 'drive="a",code="C0150",bit="ready"} 1' in page
        assert 'drive="b",code="C0150",bit="ready"}' not in page
        plant.site.store.value_failed("a", C0150, "no answer")
        assert states(plant) is None
        await until(lambda: states(plant) is not None)

    with_plant(test, ROSTER)


def test_states_are_shown_only_from_good_values() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await until(lambda: states(plant, "c") is not None)
        store = plant.site.store
        await plant.site.operations.write("c", Code(40), Decimal(1))
        await plant.site.operations.write("c", Code(135), "H0008")
        await until(lambda: "quick_stop" in (states(plant, "c") or ()), within_s=30.0)
        store.value_failed("c", Code(68), "no answer")
        shown = states(plant, "c")
        assert shown is not None
        assert "quick_stop" not in shown
        plant.line.faults.absent = {13}
        await until(lambda: states(plant, "c") is None, within_s=30.0)
        assert store.drive("c").as_json()["states"] is None

    with_plant(test, roster_text([("c", 13, "821x")]))


def test_shortened_response_time_is_followed_and_not_known_after_a_write() -> None:
    post = Post("820x")
    for raw in ("0", "1", "S1"):
        post.reads(raw, C1921)
    post.following.written(post.drive, C1921)
    assert post.early == [False, True, None, None]
    assert (post.asked_later, post.asked, post.taken) == ([C1921], [], [])


def test_a_drive_told_to_acknowledge_early_is_left_alone_after_its_next_write() -> None:
    async def test(plant: Plant) -> None:
        station = plant.site.requests.station
        await plant.online(within_s=60.0)
        await until(lambda: station("a").hold_s == 0.0, within_s=60.0)
        write = plant.site.operations.write
        assert (await write("a", C1921, 1)).outcome is Outcome.DONE
        assert (station("a").hold_s, station("a").answers_early) == (0.23, False)
        # The proof waits until the module has passed the value on, and is answered.
        report = await write("a", Code(46), 20, verify=True)
        assert report.outcome is Outcome.VERIFIED
        await until(lambda: station("a").answers_early, within_s=10.0)
        assert plant.reports[-1].result.kind is ResultKind.ANSWERED
        assert (await write("a", C1921, 0)).outcome is Outcome.DONE
        await until(lambda: station("a").hold_s == 0.0, within_s=10.0)
        assert all(one.result.kind is ResultKind.ANSWERED for one in plant.reports)

    roster = roster_text([("a", 1, "820x")], drive="cyclic: [], writable: [C0046, C1921]")
    with_plant(test, roster)
