"""After a command, and when a motor stops without one, what shows why is read soon."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from decimal import Decimal

import anyio
import pytest

from lecombus.drive_state.motion import Doing
from lecombus.drive_state.store import LineState, Store
from lecombus.drives import StopAction, Verb, family
from lecombus.fieldbus.requests import StepKind
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority
from lecombus.supervision.command_effects import ZERO_GAP_S, CommandEffects
from support.rosters import roster_text
from support.single_drives import AskedLine, drive_of, read_of
from support.site_host import Plant, until, with_plant
from support.virtual_loop import Paused

WORD, OUTPUT, OPERATING, INHIBIT, CONTROL = (Code(one) for one in (150, 50, 68, 40, 135))
TURNS, STANDS = "H0600", "H0640"


class Desk:
    """The effects of commands to two drives, and what is asked for."""

    def __init__(self, kind: str = "821x") -> None:
        self.now_s = 100.0
        self.store = Store(lambda: self.now_s, lambda: self.now_s)
        for name in "ab":
            self.store.add_drive(name, 1, family(kind))
        self.store.line_state(LineState.OPEN)
        self.drives = {name: drive_of(name, kind) for name in "ab"}
        self.line = AskedLine()
        self.effects = CommandEffects(self.store, self.line, lambda: self.now_s)

    @property
    def asked(self) -> list[tuple[str, Code, str]]:
        return self.line.asked

    def writes(self, drive: str, code: Code) -> None:
        self.now_s += 0.1
        self.store.value_written(drive, code, self.now_s)
        self.effects.written(self.drives[drive], code)

    def reads(self, drive: str, code: Code, raw: str) -> None:
        self.now_s += 0.1
        self.store.value_read(drive, code, Value.parse(raw), self.now_s)
        self.effects.exchange_ended(read_of(self.drives[drive], code, raw))

    def answers(self) -> None:
        self.line.settles.pop(0)(Outcome.DONE, "")


@pytest.mark.parametrize(
    ("kind", "code", "wanted"),
    [
        ("821x", CONTROL, [OPERATING, WORD]),
        ("8200vector", CONTROL, [CONTROL, WORD]),
        ("smvector", CONTROL, [OPERATING, WORD]),
        ("821x", INHIBIT, [WORD]),
        ("821x", Code(46), []),
        ("generic", CONTROL, []),
    ],
)
def test_a_command_has_what_shows_its_effect_read(
    kind: str, code: Code, wanted: list[Code]
) -> None:
    desk = Desk(kind)
    for word in (WORD, OPERATING, CONTROL):
        desk.reads("a", word, "H0000")
    desk.writes("a", code)
    while desk.line.settles:
        desk.answers()
    assert desk.asked == [("a", one, "soon") for one in wanted]


def test_one_read_is_asked_for_at_a_time_and_each_once() -> None:
    desk = Desk()
    for _ in range(5):
        desk.writes("a", INHIBIT)
        desk.writes("b", INHIBIT)
    assert desk.asked == [("a", WORD, "soon")]
    desk.answers()
    assert desk.asked[1:] == [("b", WORD, "soon")], "the other drive is not made to wait"
    desk.answers()
    assert desk.asked[2:] == [("a", WORD, "soon")], "the later commands want it read again"
    desk.reads("a", WORD, TURNS)
    desk.answers()
    assert len(desk.asked) == 3


def test_what_was_read_since_is_not_asked_for() -> None:
    desk = Desk()
    desk.writes("b", INHIBIT)
    desk.writes("a", INHIBIT)
    desk.reads("a", WORD, TURNS)
    desk.answers()
    assert desk.asked == [("b", WORD, "soon")]


def test_a_line_that_is_lost_leaves_nothing_pending() -> None:
    desk = Desk()
    desk.line.fails = True
    desk.writes("a", INHIBIT)
    desk.line.fails = False
    desk.writes("b", INHIBIT)
    assert desk.asked == [("b", WORD, "soon")]


@pytest.mark.parametrize(("kind", "looks"), [("821x", 1), ("8200vector", 0), ("93xx", 0)])
def test_a_motor_that_stops_without_a_command_has_the_slow_word_read(kind: str, looks: int) -> None:
    desk = Desk(kind)
    desk.reads("a", WORD, TURNS)
    desk.reads("a", WORD, STANDS)
    assert desk.asked == [("a", OPERATING, "later")] * looks


def test_it_is_not_read_for_a_stop_that_was_asked_for_nor_all_the_time() -> None:
    desk = Desk()
    desk.reads("a", OUTPUT, "20.0")
    desk.writes("a", CONTROL)
    before = len(desk.asked)
    desk.reads("a", OUTPUT, "0.0")
    assert len(desk.asked) == before
    for _ in range(10):
        desk.reads("a", WORD, TURNS)
        desk.reads("a", WORD, STANDS)
    assert [how for *_, how in desk.asked[before:]] == ["later"]
    desk.answers()
    while desk.line.settles:
        desk.answers()
    desk.now_s += ZERO_GAP_S
    desk.reads("a", OUTPUT, "20.0")
    desk.reads("a", OUTPUT, "0.0")
    assert [how for *_, how in desk.asked[before:]].count("later") == 2


LINE = [("a", 11, "821x"), ("v", 12, "8200vector"), ("m", 13, "smvector")]


@pytest.mark.parametrize(
    ("name", "after"), [("a", Doing.ENABLED), ("v", Doing.ENABLED), ("m", Doing.UNKNOWN)]
)
def test_the_motion_is_known_soon_after_a_plain_write(name: str, after: Doing) -> None:
    """It was unknown until the first status word's turn came, a second and more.

    No word of an SMVector says that it is enabled.
    """

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(10.0)  # the modules' own codes take half a second each
        operations, store = plant.site.operations, plant.site.store
        for word, expected in (("H0008", Doing.STOPPED), ("H0000", after)) * 3:
            await anyio.sleep(0.13)
            report = await operations.write(name, Code(135), word)
            assert report.outcome is Outcome.DONE
            seen = []
            for _ in range(25):
                await anyio.sleep(0.01)
                motion = store.motion(name)
                if motion.age_s is not None:
                    seen.append(motion.doing)
            assert set(seen) == {expected}, "known soon, and never shown as it is not"

    with_plant(test, roster_text(LINE, baud=9600))


def test_after_a_stop_of_all_every_motion_is_known_soon() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(10.0)
        await plant.site.operations.stop(StopAction.QUICK_STOP, "all")
        await anyio.sleep(0.3)
        doing = {plant.site.store.motion(name).doing for name, *_ in LINE}
        assert doing <= {Doing.STOPPED, Doing.STOPPING}

    with_plant(test, roster_text(LINE, baud=9600))


def test_a_quick_stop_by_a_terminal_is_known_when_the_motor_has_stopped() -> None:
    """Only C0068 shows it, which is read every 10 s."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(10.0)
        operations, store = plant.site.operations, plant.site.store
        await operations.verb("a", Verb.SET_SPEED, value=Decimal(20), unit="Hz")
        assert (await operations.verb("a", Verb.ENABLE)).outcome is Outcome.VERIFIED
        await anyio.sleep(8.0)
        assert store.motion("a").doing is Doing.RUNNING
        readers = plant.line["a"].model.readers
        shown, word = readers[68], readers[150]
        readers[68] = lambda code: f"H{int(shown(code)[1:], 16) | 0x1000:04X}"
        readers[150] = lambda code: f"H{int(word(code)[1:], 16) | 0x0040:04X}"
        readers[50] = lambda code: "0"
        await anyio.sleep(1.4)
        motion = store.motion("a")
        assert motion.doing in (Doing.STOPPING, Doing.STOPPED)  # C0050 has a slow turn, too
        assert motion.stops[0].name == "quick-stop"

    with_plant(test, roster_text(LINE, baud=9600))


SHARED = [(f"d{number}", 11 + number, "821x") for number in range(6)]
WATCHDOG = "{time: 2s, action: quick-stop, configure: true}"


@pytest.mark.parametrize("word_as_written", [False, True])
@pytest.mark.parametrize("lost", [False, True], ids=["pause", "line lost"])
def test_what_the_watchdogs_did_is_known_soon_after_their_lapse(
    *, word_as_written: bool, lost: bool
) -> None:
    """The drives were unknown until C0068 was read in its turn, up to 10 s later."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(20.0)
        store = plant.site.store
        for name, *_ in SHARED:
            await plant.site.operations.verb(name, Verb.ENABLE)
        await anyio.sleep(12.0)
        assert {store.motion(name).doing for name, *_ in SHARED} == {Doing.ENABLED}
        if lost:
            plant.end.unplug()
            await anyio.sleep(4.0)
            plant.end.replug()
            await until(lambda: store.line().state is LineState.OPEN)
        else:
            loop = asyncio.get_running_loop()
            loop.machine = Paused([(plant.now_s, plant.now_s + 4.0)])  # type: ignore[attr-defined]
            await anyio.sleep(0.1)
        await anyio.sleep(3.5 if lost else 1.0)  # behind an opening all are audited besides
        for name, *_ in SHARED:
            motion = store.motion(name)
            assert (motion.doing, [one.name for one in motion.stops]) == (
                Doing.STOPPED, ["quick-stop"],
            ), name  # fmt: skip

    text = roster_text(SHARED, baud=9600, watchdog=WATCHDOG)
    with_plant(test, text, word_as_written=word_as_written)


@pytest.mark.parametrize("kind", ["8200vector", "93xx"])
def test_a_drive_that_shows_no_quick_stop_stays_unknown_after_a_lapse(kind: str) -> None:
    """Its control word may give back what was last written to it: nothing else is sent for it."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(20.0)
        await plant.site.operations.verb("a", Verb.ENABLE)
        await anyio.sleep(12.0)
        assert plant.site.store.motion("a").doing is Doing.ENABLED
        loop, began_s = asyncio.get_running_loop(), plant.now_s
        loop.machine = Paused([(began_s, began_s + 4.0)])  # type: ignore[attr-defined]
        await anyio.sleep(10.0)
        assert plant.site.store.motion("a").doing is Doing.UNKNOWN
        after = [one for one in plant.reports if one.result.started_s > began_s + 4.0]
        assert {one.step.kind for one in after} == {StepKind.READ}
        assert len([one for one in after if one.priority is Priority.INTERACTIVE]) <= 3

    text = roster_text([("a", 11, kind)], baud=9600, watchdog=WATCHDOG)
    with_plant(test, text, word_as_written=True)


def test_the_first_answer_of_a_drive_calls_for_no_reads() -> None:
    desk = Desk()
    event = replace(read_of(desk.drives["a"], WORD, TURNS), lapsed=True)
    desk.effects.exchange_ended(event)
    assert desk.asked == []
    desk.effects.exchange_ended(event)
    assert desk.asked[0] == ("a", WORD, "soon")
