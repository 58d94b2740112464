"""As many lost answers as the roster's hypothesis allows make no watchdog act; one more does."""

from __future__ import annotations

import pytest

from proof.losses import tolerant_line
from proof.world import run_line

LENGTH_S = 40.0
SHOWN = (14, 16, 18, 64, 73, 76, 143)
"""Lines on which a watchdog acted before the schedule thought of the drive that is spoken to."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [*range(10), *SHOWN])
def test_no_watchdog_acts_upon_as_many_lost_answers_as_are_tolerated(seed: int) -> None:
    line = tolerant_line(seed, tolerate=1, losses=1, length_s=LENGTH_S)
    assert run_line(line).broken == ()


@pytest.mark.timeout(300)
def test_one_more_makes_some_act() -> None:
    lines = [
        tolerant_line(seed, tolerate=1, losses=2, length_s=LENGTH_S) for seed in (1, 3, 13, 16)
    ]
    acted = [line for line in lines if any("acted" in text for text in run_line(line).broken)]
    assert len(acted) >= 2
