"""As many lost answers as the roster's hypothesis allows make no watchdog act; one more does."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import pytest

from proof import run
from proof.losses import tolerant_line
from proof.run import Asked, Record, asked_from
from proof.world import Finding, run_line

LENGTH_S = 40.0
ONE_MORE = {1: (1, 3, 16), 2: (1, 3, 16), 3: (3, 5, 17)}
"""By what is tolerated: lines on some of which one lost answer more makes a watchdog act.

With 0 that is rare (docs/proof.md)."""
SHOWN = (14, 16, 18, 57, 64, 73, 76, 143, 177, 309, 1287, 2038, 2098, 3024, 3102)
"""Lines on which a watchdog acted before the schedule thought of the drive that is spoken to."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [*range(10), *SHOWN])
def test_no_watchdog_acts_upon_as_many_lost_answers_as_are_tolerated(seed: int) -> None:
    line = tolerant_line(seed, tolerate=1, losses=1, length_s=LENGTH_S)
    assert run_line(line).broken == ()


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("tolerate", "seed"),
    [*itertools.product((0, 2, 3), (1, 18, 36)), (2, 875), (2, 3004), (2, 3072)],
)
def test_nor_upon_any_other_number_that_is_tolerated(tolerate: int, seed: int) -> None:
    line = tolerant_line(seed, tolerate=tolerate, losses=tolerate, length_s=LENGTH_S)
    assert run_line(line).broken == ()


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
