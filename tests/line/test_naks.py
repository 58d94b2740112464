"""NAK: to a plain write it may be a damaged telegram, to a read it is an answer."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.exchanges.late_answers import PendingLateAnswers
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD
from lecombus.fieldbus.lecom.protocol.telegrams import NakAnswer
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import StepKind
from lecombus.schedule import Outcome
from support.site_host import Ended, Rig, until, with_rig

DEVICES = (("a", 1, "generic"), ("b", 2, "8200vector"))
FIELD = b"<6"


def writes(rig: Rig) -> list[bytes]:
    return [one.data for one in rig.sent if b"\x02" in one.data]


def damaged_once(rig: Rig, address: int) -> None:
    """Damage the next telegram to a drive, and none after it."""
    rig.line.drive_faults[address] = Faults(damaged=1.0)
    heard = rig.line[address].hear

    def hear(*args: object, **keys: object) -> object:
        rig.line.drive_faults.pop(address, None)
        return heard(*args, **keys)  # type: ignore[arg-type]

    rig.line[address].hear = hear  # type: ignore[method-assign,assignment]


async def ends(ended: Ended) -> Outcome:
    await ended.done.wait()
    assert ended.outcome is not None
    return ended.outcome


def test_a_plain_write_that_was_damaged_on_its_way_is_written_once_more() -> None:
    async def test(rig: Rig) -> None:
        damaged_once(rig, 1)
        assert await ends(rig.write("a", 12, "7.5")) is Outcome.DONE
        assert len(writes(rig)) == 2
        assert rig.line[1].text(12) == "7.5"

    with_rig(test)


def test_a_fault_reset_that_was_damaged_on_its_way_is_not_repeated() -> None:
    async def test(rig: Rig) -> None:
        damaged_once(rig, 1)
        ended = rig.write("a", 43, "0")
        assert await ends(ended) is Outcome.REFUSED
        assert len(writes(rig)) == 1
        assert "NAK" in ended.reason

    with_rig(test)


@pytest.mark.parametrize(("retries", "said"), [(0, 1), (1, 2), (2, 2), (5, 2)])
def test_what_is_refused_for_good_is_said_twice_at_most(retries: int, said: int) -> None:
    async def test(rig: Rig) -> None:
        rig.line.faults.nak = 1.0
        assert await ends(rig.write("a", 12, "7.5")) is Outcome.REFUSED
        assert len(writes(rig)) == said

    with_rig(test, retries=retries)


def test_a_nak_to_a_read_is_an_answer_and_no_time_out() -> None:
    async def test(rig: Rig) -> None:
        rig.line.faults.nak_reads = True
        started_s = rig.now_s
        refused, other = rig.read("a", 6000), rig.read("b", 150)
        assert await ends(refused) is Outcome.REFUSED
        assert "refused the read (NAK)" in refused.reason
        assert await ends(other) is Outcome.DONE
        # Nothing is quarantined: the other drive is asked as soon as the NAK stands alone.
        assert other.at_s - started_s < 0.25
        kinds = [one.result.kind for one in rig.seen.reports if one.drive == "a"]
        assert kinds == [ResultKind.ANSWERED] * 2, "asked twice: the question may have been damaged"

    with_rig(test, DEVICES)


def test_a_question_that_was_damaged_once_is_asked_again() -> None:
    async def test(rig: Rig) -> None:
        rig.line.faults.nak_reads = True
        damaged_once(rig, 2)
        rig.line.drive_faults[2] = Faults(damaged=1.0, nak_reads=True)
        assert await ends(rig.read("b", 150)) is Outcome.DONE
        assert [one.result.kind for one in rig.seen.reports] == [ResultKind.ANSWERED] * 2

    with_rig(test, DEVICES)


def test_a_late_nak_to_a_write_is_no_answer_to_the_next_read() -> None:
    async def test(rig: Rig) -> None:
        rig.line.drive_faults[1] = Faults(nak=1.0, late=1.0, late_s=(0.2, 0.2))
        written = rig.write("a", 12, "7.5")
        await until(lambda: bool(writes(rig)))
        await ends(written)  # it is read back meanwhile, and that is when its NAK comes
        reads = [one.result for one in rig.seen.reports if one.step.kind is StepKind.READ]
        assert sum(one.late for one in reads) == 1
        assert not [one for one in reads if isinstance(one.answer, NakAnswer)]

    with_rig(test, retries=0)


def test_after_a_nak_its_value_may_still_come_but_no_further_nak() -> None:
    late_answers = PendingLateAnswers(0.5)
    late_answers.refused(FIELD, 10.0)
    assert late_answers.blocked_until_s(FIELD, 10.1) == 10.5
    assert not late_answers.nak_may_come(10.1)
    late_answers.refused(ACK_FIELD, 10.0)
    assert late_answers.blocked_until_s(ACK_FIELD, 10.1) == 10.1
    late_answers.add(b"56", 11.0)
    assert late_answers.nak_may_come(11.4)
    assert not late_answers.nak_may_come(11.5)
