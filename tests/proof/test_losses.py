"""As many lost answers as the roster's hypothesis allows make no watchdog act; one more does."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import pytest

from lecombus.capacity.plan import make_promises
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.lecom.simulator.line import build
from lecombus.fieldbus.loop_interface import ExchangeReport, ResultKind
from lecombus.fieldbus.requests import JobStep, StepKind
from lecombus.parameters import Code
from lecombus.schedule import Priority
from proof import run
from proof.losses import tolerant_line
from proof.run import Asked, Record, asked_from
from proof.watchdogs import Watchdogs
from proof.world import Finding, run_line

LENGTH_S = 40.0
ONE_MORE = {1: (1, 3, 16), 2: (1, 3, 16), 3: (271, 325)}
"""By what is tolerated: lines on some of which one lost answer more makes a watchdog act.

With 0 that is rare (docs/proof.md)."""
SHOWN = (14, 16, 18, 57, 64, 73, 76, 143, 177, 309, 1287, 2038, 2098, 3024, 3102)
"""Lines on which a watchdog acted before the schedule thought of the drive that is spoken to."""
GROUP_WRITES = (150377, 150723, 151371, 152529)
"""With 0 lost answers: lines on which a watchdog acted while members of a multicast were left
alone."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [*range(10), *SHOWN])
def test_no_watchdog_acts_upon_as_many_lost_answers_as_are_tolerated(seed: int) -> None:
    line = tolerant_line(seed, tolerate=1, losses=1, length_s=LENGTH_S)
    assert run_line(line).broken == ()


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("tolerate", "seed"),
    [
        *itertools.product((0, 2, 3), (1, 18, 36)),
        (0, 130627),
        *((0, seed) for seed in GROUP_WRITES),
        (2, 875),
        (2, 3004),
        (2, 3072),
        (3, 56127),
        (3, 58479),
        (3, 70063),
        (3, 70214),
    ],
)
def test_nor_upon_any_other_number_that_is_tolerated(tolerate: int, seed: int) -> None:
    line = tolerant_line(seed, tolerate=tolerate, losses=tolerate, length_s=LENGTH_S)
    assert run_line(line).broken == ()


@pytest.mark.timeout(300)
def test_lost_answers_behind_a_long_read_end_with_a_stop_that_there_is_no_room_for() -> None:
    line = tolerant_line(200077, tolerate=3, losses=3, length_s=60.0)
    assert run_line(line).broken == ()


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [131159])
def test_every_stop_is_proven_while_proofs_of_it_are_lost(seed: int) -> None:
    line = tolerant_line(seed, tolerate=1, losses=1, length_s=LENGTH_S)
    assert run_line(line).broken == ()


def ended(drive: str, priority: Priority, *, answered: bool) -> ExchangeReport:
    step = JobStep(StepKind.READ, Code(150))
    kind = ResultKind.ANSWERED if answered else ResultKind.NO_REPLY
    return ExchangeReport(drive, step, Result(kind, 0.0, 0.1), priority, 0.0, 0.0)


@pytest.mark.parametrize(
    ("tolerate", "lost", "between", "whose", "excused"),
    [
        (3, 2, False, 0, True),
        (3, 1, False, 0, False),
        (3, 2, True, 0, False),
        (3, 2, False, 1, False),
        (1, 2, False, 0, False),
    ],
)
def test_only_a_stopped_drive_that_check_names_is_excused_and_only_for_its_own_lost_stops(
    *, tolerate: int, lost: int, between: bool, whose: int, excused: bool
) -> None:
    line = tolerant_line(58047, tolerate=tolerate, losses=tolerate, length_s=1.0)
    stopped = next(one.name for one in line.roster.drives if one.family == "820x")
    sim = build([(d.name, d.address, d.family) for d in line.roster.drives])
    said: list[str] = []
    watchdogs = Watchdogs(line, make_promises(line.roster), sim, said.append)
    for _ in range(lost):
        watchdogs.ended(ended(stopped, Priority.STOP, answered=False))
        if between:
            watchdogs.ended(ended(stopped, Priority.CYCLIC, answered=True))
    other = next(one.name for one in line.roster.drives if one.name != stopped)
    acted = sim[(stopped, other)[whose]]
    acted.model.watchdog_fired += 1
    watchdogs.look(1.0)
    assert said == ([] if excused else [f"the watchdog of {acted.name} acted"])


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("tolerate", "seeds"), ONE_MORE.items())
def test_one_more_makes_some_act(tolerate: int, seeds: tuple[int, ...]) -> None:
    lines = [
        tolerant_line(seed, tolerate=tolerate, losses=tolerate + 1, length_s=LENGTH_S)
        for seed in seeds
    ]
    assert any("acted" in text for line in lines for text in run_line(line).broken)


def test_what_was_run_is_noted_and_summed_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "RECORD", tmp_path / ".proof" / "done.jsonl")
    beyond = Asked(18, 1, 2)
    acted = "at 4.369 s: the watchdog of d64 acted"
    found = Finding(beyond.line(1.0), (acted, "at 5 s: another thing"), 10, 1800.0, 0.1, "", {})
    record = Record("program")
    assert record.note(beyond, found) == ("at 5 s: another thing",)
    assert record.note(Asked(18), dataclasses.replace(found, broken=())) == ()
    with run.RECORD.open("a") as file:
        file.write('{"program": "progr')
    again = Record("program")
    assert again.done.keys() == {beyond, Asked(18)}
    assert again.line_s == 3600.0
    assert not again.say(7200.0)
    said = capsys.readouterr().out
    assert "1.00 of 2 hours of line time, 2 lines" in said
    assert "line.tolerate 1: with so many lost answers a watchdog acted on 0 of 0 lines, " in said
    assert "with one more on 1 of 1" in said
    assert "make proof ARGS='--seed 18 --tolerate 1 --losses 2'" in said
    assert Record("another program").done == {}


def test_the_lines_of_make_proof_have_every_number_of_lost_answers() -> None:
    asked = list(itertools.islice(asked_from(0), 40))
    assert {(one.tolerate, one.losses) for one in asked if one.tolerate is not None} == {
        (tolerate, losses) for tolerate in range(4) for losses in (tolerate, tolerate + 1)
    }
