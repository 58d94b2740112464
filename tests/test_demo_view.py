"""The demo's table fits a terminal of the usual width."""

from __future__ import annotations

import io

from rich.console import Console

from lecombus.demo import ROSTER, SETPOINTS, WATCHDOG, row, screen, table
from support.site_host import Plant, with_plant

WIDTH, HEIGHT = 80, 24


def test_the_table_of_the_demo_fits_80_columns() -> None:
    text = ROSTER.format(watchdog=WATCHDOG, socket="/tmp/demo.sock", http="127.0.0.1:0")

    async def test(plant: Plant) -> None:
        await plant.online()
        rows = [row(plant.site, name) for name in SETPOINTS]
        out = io.StringIO()
        Console(file=out, width=WIDTH, color_system=None).print(table("demo", rows, ""))
        lines = out.getvalue().splitlines()
        assert max(map(len, lines)) <= WIDTH
        assert all("…" not in line for line in lines)
        for cells in rows:
            assert any(line.startswith(f"{cells[0]} ") and f" {cells[1]} " in line
                       for line in lines), lines  # fmt: skip
        assert len(lines) + 4 <= HEIGHT  # the headline has four lines more

    with_plant(test, text)


def test_below_the_table_a_line_is_left_for_what_the_terminal_echoes() -> None:
    out = io.StringIO()
    console = Console(file=out, width=WIDTH, color_system=None)
    lines = console.render_lines(screen("demo", [["feeder"] * 6], ""), pad=False)
    assert "".join(part.text for part in lines[-1]) == ""
    assert "feeder" in "".join(part.text for part in lines[-2])
