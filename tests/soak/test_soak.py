"""What the soak looks at would be seen if it grew; and a soak of some minutes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from soak.run import JOURNAL_BYTES, Sample, grown, judged, lost_by, soak


def samples(**at_the_end: Any) -> list[Sample]:
    """An hour of a daemon that takes as much as ever, but for what is said at its end."""
    usual: dict[str, Any] = {
        "rss_kb": 70_000, "descriptors": 100, "threads": 4, "journal_bytes": 2_000_000,
        "bridges_kb": {"mqtt": 40_000},
    }  # fmt: skip
    early = [Sample(at_s * 5.0, **(usual | {"rss_kb": 60_000})) for at_s in range(100)]
    late = [Sample(500.0 + at_s * 5.0, **usual) for at_s in range(400)]
    return [*early, *late, *(Sample(2500.0 + s, **(usual | at_the_end)) for s in range(200))]


@pytest.mark.parametrize(
    ("at_the_end", "said"),
    [
        ({}, ""),
        ({"rss_kb": 70_600}, ""),
        ({"rss_kb": 70_800}, "memory of daemon: grew by 1.14%"),
        ({"bridges_kb": {"mqtt": 40_700}}, ""),
        ({"bridges_kb": {"mqtt": 40_900}}, "memory of mqtt: grew by 2.25%"),
        (
            {"rss_kb": 70_600, "bridges_kb": {"mqtt": 40_700}},
            "memory of daemon and bridges: grew by 1.18%",
        ),
        ({"descriptors": 400}, ""),  # clients; when they have gone is looked at after them
        ({"threads": 16}, ""),
        ({"threads": 17}, "threads grew to 17"),
        ({"journal_bytes": 2 * JOURNAL_BYTES + 1}, "the journal grew to 64000001 bytes"),
    ],
)
def test_what_grows_is_seen(at_the_end: dict[str, Any], said: str) -> None:
    assert judged(samples(**at_the_end), 600.0) == ([said] if said else [])


def test_memory_of_a_short_run_is_only_shown() -> None:
    short = [one for one in samples(rss_kb=90_000) if one.at_s < 560.0]
    assert judged(short, 600.0) == []


def test_the_first_minutes_do_not_count() -> None:
    assert grown(samples(), 0.0) > 0.1
    assert grown(samples(), 600.0) == 0.0


def test_a_bridge_that_lost_something_or_never_had_it_is_seen(tmp_path: Path) -> None:
    log = tmp_path / "bridge.log"
    log.write_text("event=daemon-connected line=x\nevent=mqtt-connected broker=x\n")
    assert lost_by(log, "mqtt") == []
    log.write_text("event=daemon-connected line=x\nevent=mqtt-lost broker=x\n")
    assert lost_by(log, "mqtt") == ["event=mqtt-lost broker=x", "no mqtt-connected"]
    log.write_text("event=daemon-connected line=x\nevent=daemon-away reason=x\n")
    assert lost_by(log, "modbus") == ["event=daemon-away reason=x"]


@pytest.mark.real
@pytest.mark.long
@pytest.mark.timeout(900)
def test_some_minutes_of_soak_break_nothing() -> None:
    _, broken = soak(240.0, idle=False)
    assert broken == []
