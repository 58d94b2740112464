"""The procedure on simulated drives: whatever is lost, nobody is said to be where he is not."""

from __future__ import annotations

import random

import pytest

from lecombus.fieldbus.lecom.rebaud import DrivePlace, RebaudEnd, ending_of, situation, what_to_do
from lecombus.fieldbus.lecom.simulator import SimDrive
from rebaud.test_checking import FAMILIES, standing
from support.golden import Golden
from support.rebauding import Read, RebaudLine, Step, Wait, Write, baud_of

THREE = ("822x", "8200vector", "smvector")


def told(line: RebaudLine) -> list[str]:
    return what_to_do(line.work, "bench.yaml", line.work.old)


def first_write_to(line: RebaudLine, name: str, step: Step) -> bool:
    """Whether this is it; the step stands in `steps` already."""
    return isinstance(step, Write) and step.drive == name and len(line.writes(name)) == 1


@pytest.mark.parametrize("new", [1200, 2400, 4800, 19200])
def test_drives_of_all_families_follow_and_are_confirmed(new: int) -> None:
    line = standing(*FAMILIES)
    line.work.new = new
    line.check().move()
    assert set(line.rates.values()) == {new}
    assert set(line.places.values()) == {DrivePlace.NEW}
    assert ending_of(line.work) is RebaudEnd.MOVED
    for name in FAMILIES:
        assert line.writes(name)[0].code == baud_of(name)
    assert told(line) == [
        f"in bench.yaml, under `line:`, write `baud: {new}`, then start the daemon"
    ]


def test_each_is_written_to_once_though_no_acknowledgement_is_understood() -> None:
    line = standing(*THREE).check().move()
    assert [len(line.writes(name)) for name in THREE] == [1, 1, 1]


def test_acknowledgements_at_the_old_rate_are_as_good(monkeypatch: pytest.MonkeyPatch) -> None:
    line = standing(*THREE).check()
    acknowledge_first(line, monkeypatch)
    line.move()
    assert set(line.places.values()) == {DrivePlace.NEW}
    assert [len(line.writes(name)) for name in THREE] == [1, 1, 1]
    last = max(place for place, one in enumerate(line.steps) if isinstance(one, Write))
    assert {one.baud for one in line.steps[last + 1 :]} == {19200}, "nobody is looked for in vain"


def acknowledge_first(line: RebaudLine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let drives change their rate only after they have answered, as some may."""
    real = SimDrive.baud.fget  # type: ignore[attr-defined]
    late: dict[int, int] = {}

    def baud(drive: SimDrive) -> int:
        return late.get(drive.address) or int(real(drive))

    monkeypatch.setattr(SimDrive, "baud", property(baud))

    def before(step: Step) -> None:
        late.clear()
        if isinstance(step, Write):
            late[line[step.drive].address] = step.baud

    line.before = before


def test_a_93xx_is_told_to_save_when_all_are_there_and_keeps_its_rate() -> None:
    line = standing("93xx", "822x").check().move()
    assert [one.code.number for one in line.writes("93xx")] == [125, 3]
    assert line.work.drives[0].saved is True
    line["93xx"].power_cycle(line.scanned.host.now_s)
    line.scanned.host.wait(30.0)
    assert line["93xx"].baud == 19200


def test_a_93xx_that_did_not_save_is_named_with_what_to_do() -> None:
    line = standing("93xx").check()
    line.before = lambda step: setattr(
        line, "lose_acks", isinstance(step, Write) and step.code.number == 3
    )
    line.move()
    assert ending_of(line.work) is RebaudEnd.MOVED
    assert "falls back to 9600 baud when it is switched off" in told(line)[1]
    assert situation(line.work.drives[0], line.work) == "at 19200 baud, not saved"


def test_a_93xx_that_an_attempt_before_has_moved_is_not_said_to_keep_its_rate() -> None:
    first = standing("93xx", "822x").check()
    first.before = lambda step: setattr(
        first.work.line, "interrupted", not isinstance(step, Wait) and step.drive == "822x"
    )
    first.move()
    assert first.rates == {"93xx": 19200, "822x": 9600}
    again = RebaudLine([], subjects=[one.subject for one in first.work.drives])
    again.drives, again.line, again.scanned = first.drives, first.line, first.scanned
    again.check()
    assert again.places == {"93xx": "new", "822x": "old"}
    again.before = lambda _: setattr(again.work.line, "interrupted", True)
    again.move()
    assert situation(again.work.drives[0], again.work) == "at 19200 baud, perhaps not saved"
    assert any("if it has not saved, it is at 9600 baud" in one for one in told(again))


# ---- what goes wrong ----------------------------------------------------------------------------


def test_a_write_that_never_arrived_is_repeated_after_both_rates_were_asked() -> None:
    line = standing(*THREE).check()
    before_moving = len(line.steps)

    def before(step: Step) -> None:
        line.line.faults.lost = 1.0 if first_write_to(line, "8200vector", step) else 0.0
        line["8200vector"].present = not first_write_to(line, "8200vector", step)

    line.before = before
    line.move()
    assert set(line.places.values()) == {DrivePlace.NEW}
    assert len(line.writes("8200vector")) == 2
    first, second = (
        place for place, one in enumerate(line.steps)
        if isinstance(one, Write) and one.drive == "8200vector"
    )  # fmt: skip
    asked = [one.baud for one in line.steps[first:second] if isinstance(one, Read)]
    assert first > before_moving
    assert 9600 in asked


def test_a_drive_that_refuses_ends_the_writing_and_the_others_are_left(golden: Golden) -> None:
    line = standing(*THREE).check()
    refuse(line, "8200vector")
    line.move()
    assert line.places == {"822x": "new", "8200vector": "old", "smvector": "old"}
    assert line.rates == {"822x": 19200, "8200vector": 9600, "smvector": 9600}
    assert (len(line.writes("8200vector")), len(line.writes("smvector"))) == (2, 0)
    golden(line.why("8200vector"), *told(line))
    assert ending_of(line.work) is RebaudEnd.MIXED


def test_a_write_that_is_acknowledged_and_not_taken_is_tried_twice(
    monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    line = standing("822x").check()
    monkeypatch.setattr(SimDrive, "_try_write", lambda *_: True)
    line.move()
    assert line.places == {"822x": "old"}
    assert len(line.writes("822x")) == 2
    golden(line.why("822x"))


def test_a_93xx_that_was_there_from_the_start_saves_when_it_is_brought_back() -> None:
    line = standing("93xx", "8200vector")
    line["93xx"].model.params.set(125, "4")
    line.check()
    refuse(line, "8200vector")
    line.move()
    assert line.places == {"93xx": "new", "8200vector": "old"}
    line.back()
    assert ending_of(line.work) is RebaudEnd.UNCHANGED
    assert [one.code.number for one in line.writes("93xx")] == [125, 3]
    line["93xx"].power_cycle(line.scanned.host.now_s)
    line.scanned.host.wait(30.0)
    assert line["93xx"].baud == 9600


def refuse(line: RebaudLine, name: str) -> None:
    def before(step: Step) -> None:
        line.line.faults.nak = (
            1.0 if isinstance(step, Write) and step.drive == name and step.baud == 9600 else 0.0
        )

    line.before = before


def test_the_way_back_after_a_refusal() -> None:
    line = standing("822x", "93xx", "8200vector").check()
    refuse(line, "8200vector")
    line.move()
    assert line.places == {"822x": "new", "93xx": "new", "8200vector": "old"}
    line.back()
    assert set(line.rates.values()) == {9600}
    assert ending_of(line.work) is RebaudEnd.UNCHANGED
    assert "every drive is at 9600 baud as before" in told(line)[-1]
    assert [one.code.number for one in line.writes("93xx")] == [125, 125], "nothing was saved"


def test_a_drive_that_goes_silent_is_said_to_be_lost_and_comes_back_when_it_answers() -> None:
    line = standing(*THREE).check()

    def before(step: Step) -> None:
        if first_write_to(line, "8200vector", step):
            line["8200vector"].present = False

    line.before = before
    line.move()
    assert line.places == {"822x": "new", "8200vector": "lost", "smvector": "old"}
    assert ending_of(line.work) is RebaudEnd.MIXED
    assert told(line)[0] == (
        "8200vector: switch it off and on; look at C0125 at its keypad (0 is 9600, 4 is 19200 baud)"
    )
    line.back()
    assert line.places == {"822x": "old", "8200vector": "lost", "smvector": "old"}
    line["8200vector"].present = True
    line.back()
    assert set(line.places.values()) == {DrivePlace.OLD}


def test_a_drive_that_took_it_and_then_went_silent_is_brought_back_from_the_new_rate() -> None:
    line = standing(*THREE).check()

    def before(step: Step) -> None:
        written = bool(line.writes("8200vector"))
        line["8200vector"].present = not (written and not isinstance(step, Write))

    line.before = before
    line.move()
    assert (line.places["8200vector"], line.rates["8200vector"]) == ("lost", 19200)
    line.before = lambda _: setattr(line["8200vector"], "present", True)
    line.back()
    assert set(line.rates.values()) == {9600}
    assert set(line.places.values()) == {DrivePlace.OLD}


def test_a_drive_that_changes_only_when_switched_on_again_is_pending(
    monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    line = standing("822x").check()
    monkeypatch.setattr(SimDrive, "baud", property(lambda _: 9600))
    line.move()
    assert line.places == {"822x": "pending"}
    golden(*told(line))
    line.back()
    assert (line.places, line["822x"].text(125)) == ({"822x": "old"}, "0")


def test_another_drive_at_the_new_rate_is_not_taken_for_it() -> None:
    line = standing("8200vector").check()

    def before(step: Step) -> None:
        if isinstance(step, Read) and step.baud == 19200:
            line["8200vector"].model.params.set(200, "SOTHER")

    line.before = before
    line.move()
    assert line.places == {"8200vector": "lost"}
    assert "something answers at 19200 baud, but C0200 reads OTHER" in line.why("8200vector")


def test_a_drive_that_was_enabled_meanwhile_is_not_written_to() -> None:
    line = standing(*THREE).check()
    line.scanned.host.write(line["8200vector"].address, 135, "H0000")
    line.scanned.host.write(line["8200vector"].address, 40, "1")
    line.move()
    assert line.places == {"822x": "new", "8200vector": "old", "smvector": "old"}
    assert not line.writes("8200vector")
    assert "is neither inhibited nor in quick stop" in line.why("8200vector")


@pytest.mark.parametrize("after", range(1, 14))
def test_an_interruption_ends_it_and_nothing_is_claimed_that_was_not_seen(after: int) -> None:
    line = standing("822x", "smvector").check()
    began = len(line.steps)

    def before(_: Step) -> None:
        line.work.line.interrupted = len(line.steps) >= began + after

    line.before = before
    line.move()
    assert len(line.steps) <= began + after
    for drive in line.work.drives:
        if drive.place in (DrivePlace.OLD, DrivePlace.NEW):
            assert drive.rate == line[drive.name].baud, after
        if drive.place is DrivePlace.WRITTEN:
            assert line.writes(drive.name), "nothing was sent to it"


def test_after_an_interruption_it_goes_on_or_back() -> None:
    line = standing(*THREE).check()
    line.before = lambda step: setattr(
        line.work.line, "interrupted", isinstance(step, Write) and step.drive == "8200vector"
    )
    line.move()
    assert line.places == {"822x": "new", "8200vector": "written", "smvector": "old"}
    assert "a write ended, and it was not looked for since" in situation(
        line.work.drives[1], line.work
    )
    again = RebaudLine([], subjects=[one.subject for one in line.work.drives])
    again.drives, again.line, again.scanned = line.drives, line.line, line.scanned
    again.check()
    assert again.work.obstacles == []
    assert again.places == {"822x": "new", "8200vector": "new", "smvector": "old"}
    again.move()
    assert set(again.rates.values()) == {19200}


@pytest.mark.parametrize("seed", range(6))
def test_on_a_bad_line_nobody_is_ever_said_to_be_where_he_is_not(seed: int) -> None:
    chance = random.Random(seed)
    line = standing(*THREE).check()
    faults = line.line.faults
    faults.lost = faults.half = faults.noise = 0.12 + 0.2 * chance.random()
    faults.nak = 0.1
    line.move()
    claimed = {one.name: one.rate for one in line.work.drives if one.place in ("old", "new")}
    assert claimed == {name: line.rates[name] for name in claimed}
    line.back()
    claimed = {one.name: one.rate for one in line.work.drives if one.place in ("old", "new")}
    assert claimed == {name: line.rates[name] for name in claimed}
    faults.lost = faults.half = faults.noise = faults.nak = 0.0
    line.back()
    assert set(line.rates.values()) == {9600}
