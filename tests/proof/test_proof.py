"""Four hours and more of random lines, ten with the long tests, and the mutants they find out.

The same as `make proof` (docs/proof.md), which goes on where it stopped, for a thousand hours.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor

import pytest

from proof.lines import KINDS, line_of
from proof.mutants import MUTANTS, mutated
from proof.world import FELL, Finding, run_line

LINES = range(200)
QUICK = (
    *range(80), 87, 146, 189, 215, 500, 548, 567, 4076,
    54388, 55360, 55904, 63000, 63180, 65280,
)  # fmt: skip
"""Lines that are run each time: of all kinds, and those that have shown a defect."""
LENGTH_S = 60.0
HOURS = 3.5
CHUNKS = 5
OPEN: dict[int, str] = {}
"""Lines that show a defect which is not mended yet, and which (docs/proof.md)."""
JOBS = 2


def prove(seed: int) -> Finding:
    return run_line(line_of(seed, LENGTH_S))


def prove_all(seeds: Sequence[int]) -> list[Finding]:
    """Run lines, on both cores."""
    with ProcessPoolExecutor(JOBS) as pool:
        return list(pool.map(prove, seeds, chunksize=len(seeds) // CHUNKS // JOBS))


@pytest.fixture(scope="module")
def findings() -> list[Finding]:
    """Run the lines of each time once."""
    return prove_all(QUICK)


@pytest.mark.timeout(900)
def test_nothing_breaks_on_the_lines_of_each_time(findings: list[Finding]) -> None:
    judge(findings)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_nothing_breaks_on_two_hundred_lines() -> None:
    judge(prove_all([seed for seed in LINES if seed not in QUICK]))


def judge(findings: list[Finding]) -> None:
    sound = [found for found in findings if found.line.seed not in OPEN]
    broken = [f"{found.line}: {text}" for found in sound for text in found.broken]
    assert not broken, "\n".join(
        [*broken[:20], "again: PYTHONPATH=src:tests python -m proof.run --seed N --length 60"]
    )


@pytest.mark.timeout(900)
def test_what_is_said_to_be_open_still_is(findings: list[Finding]) -> None:
    mended = [found.line.seed for found in findings if found.line.seed in OPEN and not found.broken]
    assert not mended, f"take these out of OPEN and out of docs/proof.md: {mended}"


@pytest.mark.timeout(900)
def test_the_lines_are_many_and_long_enough_and_of_every_kind(findings: list[Finding]) -> None:
    assert sum(found.line_s for found in findings) >= HOURS * 3600.0
    assert {found.line.kind for found in findings} == set(KINDS)
    assert {len(found.line.roster.drives) for found in findings} >= {1, 2, 3}
    assert max(len(found.line.roster.drives) for found in findings) > 50
    assert all(found.exchanges for found in findings)


@pytest.mark.parametrize("name", [name for name, one in MUTANTS.items() if one.quick])
@pytest.mark.timeout(300)
def test_a_slip_is_found_out(name: str) -> None:
    check_mutant(name)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name, one in MUTANTS.items() if not one.quick])
@pytest.mark.timeout(300)
def test_a_slip_that_takes_longer_to_find_is_found_out(name: str) -> None:
    check_mutant(name)


def check_mutant(name: str) -> None:
    mutant = MUTANTS[name]
    assert mutant.seeds, f"{name} is shown by no line"
    for seed in mutant.seeds:
        with mutated(name):
            broken = run_line(mutant.line(seed, LENGTH_S)).broken
        if broken:
            break
    assert broken, f"{name} was noticed on none of the lines {mutant.seeds}"
    assert FELL not in broken[0], f"{name} fell over instead: {broken[0]}"


@pytest.mark.timeout(600)
def test_the_lines_that_show_quick_mutants_are_clean_without_them() -> None:
    quick = [one for one in MUTANTS.values() if one.quick]
    for one in quick:
        assert one.tolerate is None
    for seed in sorted({seed for one in quick for seed in one.seeds}.difference(QUICK)):
        assert prove(seed).broken == ()


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_lines_that_show_mutants_are_clean_without_them() -> None:
    lines = {(one.tolerate, seed): one for one in MUTANTS.values() for seed in one.seeds}
    for (_, seed), one in lines.items():
        assert run_line(one.line(seed, LENGTH_S)).broken == ()


def test_there_are_enough_mutants() -> None:
    assert len(MUTANTS) >= 25


def test_every_mutant_still_fits_the_program() -> None:
    for name in MUTANTS:
        with mutated(name):
            pass


def test_a_mutant_that_no_longer_fits_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    name, mutant = next(iter(MUTANTS.items()))
    gone = dataclasses.replace(mutant, right="what stands there no more")
    monkeypatch.setitem(MUTANTS, name, gone)
    with pytest.raises(AssertionError, match="no longer fits"), mutated(name):
        pass
