"""Random lines whose drives have leases, and the mutants that they find out (docs/proof.md).

The long form is `make proof ARGS=--leases`.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import pytest

from proof.lease_lines import leased_line
from proof.lease_mutants import LEASE_MUTANTS
from proof.mutants import applied
from proof.world import FELL, Finding, run_line

LINES = (*(seed for seed in range(39) if seed not in (6, 24)), 45, 49, 99, 164)
"""Lines that are run each time: of all kinds, and those that have shown a defect."""
LENGTH_S = 60.0
JOBS = 2
LATEST = 1.0


def prove(seed: int) -> Finding:
    return run_line(leased_line(seed, LENGTH_S))


@pytest.fixture(scope="module")
def findings() -> list[Finding]:
    with ProcessPoolExecutor(JOBS) as pool:
        return list(pool.map(prove, LINES))


@pytest.mark.timeout(300)
def test_nothing_breaks_on_lines_with_leases(findings: list[Finding]) -> None:
    broken = [f"{found.line}: {text}" for found in findings for text in found.broken]
    again = "again: PYTHONPATH=src:tests python -m proof.run --leases --length 60 --seed N"
    assert not broken, "\n".join([*broken[:20], again])


@pytest.mark.timeout(300)
def test_lines_of_every_kind_show_all_that_becomes_of_leases(findings: list[Finding]) -> None:
    kinds = {found.line.kind for found in findings}
    assert kinds == {"quiet", "loaded", "absent", "faulty", "tolerant"}
    for what in findings[0].leases:
        assert sum(found.leases[what] for found in findings) > 0, what
    assert sum(found.leases["lapsed"] for found in findings) > 500
    assert max(found.leases["latest"] for found in findings) <= LATEST


@pytest.mark.parametrize("name", LEASE_MUTANTS)
@pytest.mark.timeout(120)
def test_a_slip_in_leases_is_found_out(name: str) -> None:
    mutant = LEASE_MUTANTS[name]
    broken: tuple[str, ...] = ()
    for seed in mutant.seeds:
        with applied(mutant):
            broken = run_line(mutant.line(seed, LENGTH_S)).broken
        if broken:
            break
    assert broken, f"{name} was noticed on none of the lines {mutant.seeds}"
    assert FELL not in broken[0], f"{name} fell over instead: {broken[0]}"


def test_the_lines_that_show_mutants_of_leases_are_clean_without_them() -> None:
    assert {seed for one in LEASE_MUTANTS.values() for seed in one.seeds} <= set(LINES)


def test_a_line_with_leases_replays_to_the_byte() -> None:
    assert prove(8).digest == prove(8).digest
