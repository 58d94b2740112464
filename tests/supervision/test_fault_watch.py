"""Status words show a fault, the fault memory names it, and nothing else makes one active."""

from __future__ import annotations

import logging

import anyio
import pytest

from lecombus.drive_state.readings import ActiveFault
from lecombus.drive_state.store import Store
from lecombus.drives import family
from lecombus.drives.faults.fault_tables import FaultKind
from lecombus.fieldbus.lecom.simulator.families.smvector import SMVector
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome
from lecombus.supervision.fault_watch import TRIES, FaultWatch
from support.golden import Golden
from support.rosters import roster_text
from support.single_drives import AskedLine, drive_of
from support.site_host import Plant, until, with_plant

C0068, C0150, C0161 = Code(68), Code(150), Code(161)
FINE, TRIPPED, WARNS, MESSAGE = "H0670", "H0870", "H1670", "H0770"


class Post:
    """A watch over one drive, and what it asks for."""

    def __init__(self, kind: str = "8200vector") -> None:
        self.now_s = 1000.0
        self.store = Store(lambda: self.now_s, lambda: self.now_s)
        self.store.add_drive("a", 1, family(kind))
        self.drive = drive_of("a", kind)
        self.line = AskedLine()
        self.watch = FaultWatch(self.store, self.line, lambda: self.now_s)

    @property
    def asked(self) -> list[Code]:
        return [code for _, code, _ in self.line.asked]

    def sees(self, code: Code, raw: str) -> None:
        self.watch.seen(self.drive, code, Value.parse(raw))

    def answers(self) -> None:
        """Every read asked for ended; their values are told by `sees`."""
        settles, self.line.settles = self.line.settles, []
        for settle in settles:
            settle(Outcome.DONE, "")

    def fault(self) -> ActiveFault | None:
        return self.store.drive("a").fault

    def kind(self) -> str:
        fault = self.fault()
        assert fault is not None
        return fault.kind

    def number(self) -> int | None:
        fault = self.fault()
        assert fault is not None
        return fault.number


def test_a_fault_memory_alone_shows_no_fault() -> None:
    post = Post()
    post.sees(C0161, "50")
    post.sees(C0150, FINE)
    post.sees(C0161, "50")
    assert post.fault() is None
    assert post.asked == []


def test_a_rising_fault_has_its_memory_read_at_once(golden: Golden) -> None:
    post = Post()
    post.sees(C0161, "53")
    post.sees(C0150, FINE)
    post.sees(C0150, TRIPPED)
    assert post.asked == [C0161, C0068]
    assert post.number() is None  # what was read before the rise names an older fault
    post.answers()
    post.sees(C0161, "50")
    golden(post.fault())
    assert post.store.drive("a").remarks["fault"] == str(post.fault())


def test_a_number_that_does_not_fit_the_tens_digit_is_not_believed_and_asked_for_again() -> None:
    post = Post()
    post.sees(C0150, TRIPPED)
    post.answers()
    post.sees(C0161, "91")
    assert post.number() == 91
    post.sees(C0068, "H8005")
    assert post.number() is None
    assert post.asked.count(C0161) == 2
    post.answers()
    post.sees(C0161, "50")
    assert post.number() == 50


def test_a_memory_that_stays_empty_is_asked_a_few_times_and_logged_as_unknown(
    caplog: pytest.LogCaptureFixture,
) -> None:
    post = Post()
    with caplog.at_level(logging.INFO):
        post.sees(C0150, TRIPPED)
        for _ in range(10):
            post.answers()
            post.sees(C0161, "0")
            post.sees(C0150, TRIPPED)
    assert post.asked.count(C0161) == TRIES
    assert post.number() is None
    assert "C0150 reads H0870" in str(post.fault())
    assert [one.getMessage() for one in caplog.records] == [
        "drive=a event=trip number=unknown keypad= meaning=not known"
    ]


def test_a_fault_and_its_end_are_logged_once_each(caplog: pytest.LogCaptureFixture) -> None:
    post = Post()
    with caplog.at_level(logging.INFO):
        post.sees(C0150, TRIPPED)
        post.sees(C0161, "11")
        post.sees(C0161, "11")
        post.sees(C0150, FINE)
    assert [one.getMessage() for one in caplog.records] == [
        "drive=a event=trip number=11 keypad=OC1 meaning=short circuit",
        "drive=a event=trip-gone number=11",
    ]
    assert post.fault() is None
    assert "fault" not in post.store.drive("a").remarks


def test_the_same_fault_again_is_a_new_one() -> None:
    post = Post()
    for since_s in (1000.0, 1060.0):
        post.now_s = since_s
        post.sees(C0150, TRIPPED)
        assert post.number() is None
        post.answers()
        post.sees(C0161, "50")
        fault = post.fault()
        assert fault is not None
        assert (fault.number, fault.since_s) == (50, since_s)
        post.sees(C0150, FINE)


def test_a_word_that_showed_a_fault_is_read_again_when_another_shows_it_gone() -> None:
    post = Post()
    post.sees(C0150, TRIPPED)
    post.sees(C0068, "H8005")
    post.line.asked.clear()
    post.sees(C0150, FINE)
    assert post.fault() is not None  # C0068 has not said so yet
    assert post.asked == [C0068]
    post.sees(C0068, "H0100")
    assert post.fault() is None


def test_words_that_contradict_each_other_are_read_again_a_few_times_only() -> None:
    post = Post()
    post.sees(C0068, "H8005")
    post.sees(C0161, "50")
    post.line.asked.clear()
    for _ in range(20):
        post.sees(C0150, FINE)
        post.sees(C0068, "H8005")
    assert post.fault() is not None
    assert post.asked == [C0068] * TRIES


def test_a_warning_is_shown_as_one_and_an_old_trip_in_the_memory_does_not_name_it(
    golden: Golden,
) -> None:
    post = Post()
    post.sees(C0150, WARNS)
    post.answers()
    post.sees(C0161, "50")
    assert (post.kind(), post.number()) == ("warning", None)
    post.sees(C0161, "203")
    golden(post.fault())
    post.sees(C0150, TRIPPED)
    assert (post.kind(), post.number()) == ("trip", None)


def test_a_message_is_named_too_and_a_number_not_listed_is_shown_as_a_number(
    golden: Golden,
) -> None:
    post = Post("93xx")
    post.sees(C0150, MESSAGE)
    post.sees(Code(168, 1), "1030")
    golden(post.fault())
    post = Post("93xx")
    post.sees(C0150, TRIPPED)
    post.sees(Code(168, 1), "499")
    golden(post.fault())


def test_without_a_line_nothing_is_asked_and_the_next_word_asks_again() -> None:
    post = Post()
    post.line.fails = True
    post.sees(C0150, TRIPPED)
    assert post.asked == []
    post.line.fails = False
    post.sees(C0150, TRIPPED)
    assert post.asked == [C0161]


def test_a_drive_that_left_the_roster_begins_anew(golden: Golden) -> None:
    post = Post()
    post.sees(C0150, TRIPPED)
    post.drive = drive_of("a", "smvector")
    post.store.remove_drive("a")
    post.store.add_drive("a", 1, family("smvector"))
    post.sees(C0150, "H0100")
    post.sees(Code(1500), "20")
    golden(post.fault())


@pytest.mark.parametrize("digit", ["5", "9", "3"])
def test_an_smvectors_number_is_taken_from_the_list_of_p500_alone(
    digit: str, golden: Golden
) -> None:
    """Its C0068 shows a digit of LECOM numbers (OH = 50), P500 has numbers from 1 to 36."""
    post = Post("smvector")
    post.sees(C0150, "H0100")
    post.answers()
    post.sees(Code(1500), "4")
    post.sees(C0068, f"H800{digit}")
    golden(post.fault())
    assert post.asked.count(Code(1500)) == 1
    post.sees(C0068, "H8001")  # another digit: perhaps another fault, so the memory is read again
    assert post.number() is None
    assert post.asked.count(Code(1500)) == 2
    post.answers()
    post.sees(Code(1500), "8")
    golden(post.fault())


def test_a_memory_that_holds_no_whole_number_names_nothing() -> None:
    """A display shows place and fault, such as 1.36: nothing says that the line never does."""
    post = Post("smvector")
    post.sees(C0150, "H0100")
    post.answers()
    post.sees(Code(1500), "1.36")
    assert post.number() is None


FAMILIES = [
    ("a", 11, "8200vector"), ("b", 12, "821x"), ("c", 13, "820x"),
    ("d", 21, "93xx"), ("e", 22, "smvector"),
]  # fmt: skip
TRIPS = {"a": 50, "b": 12, "c": 14, "d": 82, "e": 36}


@pytest.mark.parametrize("digit_of", ["lecom", "p500", "none"])
def test_every_trip_of_an_smvector_is_named(digit_of: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        model, store = plant.line["e"].model, plant.site.store
        model.digit_of = digit_of
        for number in range(1, 37):
            model.trip(number)

            def named(expected: int = number) -> bool:
                fault = store.drive("e").fault
                return fault is not None and fault.number == expected

            await until(named, within_s=4.0)
            await anyio.sleep(1.0)  # C0068 has been read too
            assert named()
            model.reset_fault()
            await until(lambda: store.drive("e").fault is None, within_s=14.0)

    with_plant(test, roster_text(FAMILIES[-1:]))


def test_a_trip_of_an_smvector_whose_history_reads_otherwise_is_shown_and_never_misnamed() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        model, store = plant.line["e"].model, plant.site.store
        assert isinstance(model, SMVector)
        model.history_form = "place"
        for number in range(1, 37):
            model.trip(number)
            await until(lambda: store.drive("e").fault is not None, within_s=4.0)
            await anyio.sleep(2.0)  # the memory has been read
            fault = store.drive("e").fault
            assert fault is not None
            assert (fault.kind, fault.number) == (FaultKind.TRIP, None)
            model.reset_fault()
            await until(lambda: store.drive("e").fault is None, within_s=14.0)

    with_plant(test, roster_text(FAMILIES[-1:]))


def test_a_trip_of_every_family_is_named_soon_and_gone_after_its_reset() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        store = plant.site.store
        for name, number in TRIPS.items():
            plant.line[name].trip(number)
        started_s = plant.now_s

        def named() -> bool:
            faults = [store.drive(name).fault for name in TRIPS]
            return [one and one.number for one in faults] == list(TRIPS.values())

        await until(named, within_s=4.0)
        assert plant.now_s - started_s < 4.0
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        assert 'lecombus_drive_fault{line="test",drive="d"} 1' in page
        assert 'lecombus_drive_fault_number{line="test",drive="d",kind="trip"} 82' in page
        document = store.drive("c").as_json()["fault"]
        assert isinstance(document, dict)
        assert (document["keypad"], document["stale"]) == ("OC4", False)
        for name in TRIPS:
            plant.line[name].model.reset_fault()
        await until(lambda: all(store.drive(name).fault is None for name in TRIPS), within_s=4.0)
        await anyio.sleep(1.0)  # a page is served again for so long
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        assert "lecombus_drive_fault_number" not in page

    with_plant(test, roster_text(FAMILIES))


def test_a_fault_of_a_drive_that_is_silent_since_is_shown_as_stale() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["a"].trip(50)
        await until(lambda: plant.site.store.drive("a").fault is not None)
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a").value == "offline", within_s=30.0)
        document = plant.site.store.drive("a").as_json()["fault"]
        assert isinstance(document, dict)
        assert document["stale"] is True

    with_plant(test, roster_text(FAMILIES[:1]))


ONLY_C0150 = "cyclic: [{code: C0150, every: 100ms}]"


def test_a_trip_ends_also_where_its_other_word_follows_late_and_nothing_else_reads_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.trip("a", 50)
        await until(lambda: plant.site.store.drive("a").fault is not None)
        await anyio.sleep(5.0)
        readers = plant.line["a"].model.readers
        read = readers[68]
        tripped = read(0)
        plant.clear_fault("a")
        plant.power_cycle("a", 0.0)
        readers[68] = lambda subcode: tripped
        await anyio.sleep(1.0)
        readers[68] = read
        await until(lambda: plant.site.store.drive("a").fault is None)

    with_plant(test, roster_text(FAMILIES[:1], drive=ONLY_C0150))


def test_a_number_that_stands_in_the_memory_late_is_found_where_nothing_else_reads_it() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        readers = plant.line["a"].model.readers
        read = readers.get(161)
        readers[161] = lambda subcode: "0"
        plant.trip("a", 50)
        await anyio.sleep(1.0)
        found = plant.site.store.drive("a").fault
        assert found is not None
        assert found.number is None
        if read is None:
            del readers[161]
        else:
            readers[161] = read

        def named() -> bool:
            fault = plant.site.store.drive("a").fault
            return fault is not None and fault.number == 50

        await until(named)

    with_plant(test, roster_text(FAMILIES[:1], drive=ONLY_C0150))
