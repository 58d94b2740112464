"""The proof's own checks: each sees the copy that breaks it, and a seed replays to the byte."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from proof.broken import BROKEN, broken
from proof.lines import line_of
from proof.wire import differ_by_a_bit, is_whole
from proof.world import Finding, run_line

LENGTH_S = 60.0
REPLAYED = (2, 3, 8)
"""One line with absences, one with noise, one quiet."""
REPLAY = """
import sys
from proof.lines import line_of
from proof.world import run_line
print(*(run_line(line_of(int(seed), 60.0)).digest for seed in sys.argv[1:]))
"""


def prove(seed: int) -> Finding:
    return run_line(line_of(seed, LENGTH_S))


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_copy_is_found_out_for_what_it_is(name: str) -> None:
    found = []
    for seed in BROKEN[name].seeds:
        with broken(name):
            found = [*prove(seed).broken]
        if any(BROKEN[name].words in text for text in found):
            return
    raise AssertionError(f"{name} was noticed on no line; the last one: {found}")


def test_the_lines_that_show_broken_copies_are_clean_without_them() -> None:
    for seed in sorted({seed for one in BROKEN.values() for seed in one.seeds}):
        assert prove(seed).broken == ()


def test_a_seed_replays_to_the_byte_in_every_process() -> None:
    here = [prove(seed).digest for seed in REPLAYED]
    for hash_seed in ("1", "4242"):
        there = subprocess.run(
            [sys.executable, "-c", REPLAY, *map(str, REPLAYED)],
            env=os.environ | {"PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert there.stdout.split() == here


def test_another_seed_is_another_line() -> None:
    assert len({prove(seed).digest for seed in REPLAYED}) == len(REPLAYED)


@pytest.mark.parametrize(
    ("heard", "whole"),
    [
        (b"\x06", True),
        (b"\x95", True),
        (b"\x0250H8070\x03\x4a", True),
        (b"\x8250\x84", True),
        (b"", False),
        (b"\x06\x06", False),
        (b"\x0250H8070\x03", False),
        (b"\x0250H8070", False),
        (b"\x0250H8070\x03\x4a\x00", False),
        (b"50H8070\x03\x4a", False),
    ],
)
def test_an_answer_is_whole_or_not(heard: bytes, whole: bool) -> None:
    assert is_whole(heard) is whole


@pytest.mark.parametrize(("said", "heard", "by_a_bit"), [
    ("H8678", "H8778", True), ("H8678", "H8678", False), ("H8678", "H8779", False),
    ("H8678", "H8978", False), ("H8678", "H867", False), ("0", "00", False), ("", "", False),
])  # fmt: skip
def test_noise_and_a_wrong_bcc_cancel_only_where_both_flip_one_bit(
    said: str, heard: str, by_a_bit: bool
) -> None:
    """Seed 175231: the BCC's bit 0 was flipped, and that of a digit."""
    assert differ_by_a_bit(said, heard) is by_a_bit


def test_a_line_whose_watchdogs_check_refuses_by_milliseconds_gets_longer_ones() -> None:
    """Seed 33360: the line's own estimate was 8 ms shorter than what `check` accepts."""
    line = line_of(33360, 60.0)
    times = {drive.watchdog.time_s for drive in line.roster.drives if drive.watchdog}
    assert min(times) > 0.792


def test_an_exchange_is_held_to_the_printed_plan_where_the_adapter_is_slow() -> None:
    """Seed 71336: with 8 ms more for each answer a plan refuses reads that the schedule begins."""
    assert run_line(line_of(71336, 120.0)).broken == ()


def test_more_proof_of_a_stop_is_held_to_the_plan_from_when_it_may_be_read() -> None:
    """Seed 130875: noise took a reading in both forms; the stop had been shown before."""
    assert run_line(line_of(130875, 60.0)).broken == ()
