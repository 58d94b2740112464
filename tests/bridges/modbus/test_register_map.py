"""The register map: nothing overlaps, nothing moves, and the manual has what the program has."""

from __future__ import annotations

from pathlib import Path

import pytest

from lecombus.bridges.modbus.register_map import (
    BLOCK,
    DRIVE,
    LINE,
    REASONS,
    STATES,
    UNITS,
    Register,
    RegisterPart,
    map_markdown,
    place_of,
    roster_rows,
    sources_of,
)
from lecombus.drives import FAMILY_NAMES, OperatingState, family

ROOT = Path(__file__).parents[3]
BORDERS = {
    RegisterPart.ALWAYS: range(20),
    RegisterPart.FRESH: range(20, 40),
    RegisterPart.WRITTEN: range(40, BLOCK),
}


def test_the_manual_has_the_table_that_the_program_prints() -> None:
    assert (
        (ROOT / "docs" / "modbus.md")
        .read_text(encoding="utf-8")
        .endswith(map_markdown(FAMILY_NAMES))
    )


@pytest.mark.parametrize("block", [LINE, DRIVE])
def test_registers_do_not_overlap_and_stand_in_the_range_of_their_part(
    block: tuple[Register, ...],
) -> None:
    taken = [one.offset + word for one in block for word in range(one.words)]
    assert len(taken) == len(set(taken))
    assert all(one.offset in BORDERS[one.part] for one in block)
    assert len({one.name for one in block}) == len(block)


def test_what_is_always_read_has_no_gap_so_that_one_request_reads_it() -> None:
    always = [one for one in DRIVE if one.part is RegisterPart.ALWAYS]
    assert [one.offset for one in always] == list(range(len(always)))


def test_every_address_has_its_place_and_all_fit() -> None:
    assert place_of(0) == (0, 0)
    assert place_of(1142) == (11, 42)
    assert place_of(99 * BLOCK + 43) == (99, 43)


def test_a_further_drive_moves_no_other() -> None:
    few = roster_rows([("feeder", 11, "8200vector")])
    many = roster_rows([("new", 1, "93xx"), ("feeder", 11, "8200vector"), ("z", 99, "820x")])
    assert [one for one in many if one["drive"] == "feeder"] == [
        one for one in few if one["drive"] == "feeder"
    ]


def test_states_have_a_bit_each_that_never_changes() -> None:
    assert tuple(OperatingState) == STATES
    assert len(STATES) <= 32
    assert (STATES[0], STATES[5], STATES[25], STATES[26]) == (
        "ready", "enabled", "fault", "power_off"
    )  # fmt: skip


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_the_codes_behind_the_registers_are_described_with_their_unit(name: str) -> None:
    of = family(name)
    found = sources_of(of)
    assert found.speed_unit in UNITS
    assert found.setpoint_unit in UNITS
    for code, unit in [(found.speed, found.speed_unit),
                       *((one, found.setpoint_unit) for one in found.setpoints)]:  # fmt: skip
        if code is not None:
            info = of.info(code)
            assert info is not None
            assert info.unit == unit
    assert (found.status is None) == (name == "generic")


def test_every_word_of_the_http_api_that_a_write_can_end_with_has_a_reason() -> None:
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    words = "lease-required latched nak offline no-answer fault-active not-in-effect setting"
    for word in (*words.split(), "queue-full", "line-lost", "journal-failing"):
        assert f"`{word}`" in text
        assert word in REASONS
