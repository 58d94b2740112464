"""The line over one hyperperiod as an SVG: who speaks when, and by when each had to be fed.

One row a drive, one box an exchange, one tick a deadline; readable in any browser and in print,
without scripts. Text is escaped; sizes follow from the number of drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Final

from lecombus.planning.preview import Preview, Span

__all__ = ["picture"]

WIDTH: Final = 1000
NAMES: Final = 150
ROW: Final = 18
TOP: Final = 60
BOX: Final = 12
COLOURS: Final = {"cyclic": "#3b6ea5", "watchdog": "#c2662d"}
STYLE: Final = (
    "text{font:11px sans-serif;fill:#222}.head{font-size:14px}.grid{stroke:#ddd}"
    ".due{stroke:#b00020;stroke-width:1.5}"
)


def picture(title: str, drives: tuple[str, ...], shown: Preview) -> str:
    """Draw a stretch of a line's time.

    Args:
        title: What stands above it.
        drives: The rows, from the top.
        shown: What happens.

    Returns:
        An SVG document.
    """
    height = TOP + ROW * len(drives) + 30
    rows = {name: TOP + ROW * number for number, name in enumerate(drives)}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>{escape(title)}</title><style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        f'<text class="head" x="10" y="22">{escape(title)}</text>',
        *_legend(),
        *_grid(shown.length_s, height),
        *(_name(name, y) for name, y in rows.items()),
        *(_box(span, rows[span.drive], shown.length_s) for span in shown.spans
          if span.start_s < shown.length_s),
        *_deadlines(shown, rows),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def _x(at_s: float, length_s: float) -> float:
    return NAMES + (WIDTH - NAMES - 20) * min(at_s, length_s) / length_s


def _legend() -> Iterator[str]:
    x = NAMES
    for word, colour in (("cyclic read", COLOURS["cyclic"]), ("feed", COLOURS["watchdog"])):
        yield f'<rect x="{x}" y="32" width="12" height="{BOX}" fill="{colour}"/>'
        yield f'<text x="{x + 17}" y="42">{word}</text>'
        x += 110
    yield f'<line class="due" x1="{x}" y1="32" x2="{x}" y2="44"/>'
    yield f'<text x="{x + 6}" y="42">by then it must have been fed again</text>'


def _grid(length_s: float, height: int) -> Iterator[str]:
    for tenth in range(11):
        at_s = length_s * tenth / 10
        x = _x(at_s, length_s)
        yield f'<line class="grid" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 24}"/>'
        yield f'<text x="{x - 10:.1f}" y="{height - 10}">{at_s:g} s</text>'


def _name(name: str, y: float) -> str:
    return f'<text x="10" y="{y + BOX - 2}">{escape(name[:24])}</text>'


def _box(span: Span, y: float, length_s: float) -> str:
    left, right = _x(span.start_s, length_s), _x(span.end_s, length_s)
    about = f"{span.drive}, {span.kind}: {span.start_s:.3f} s to {span.end_s:.3f} s"
    return (
        f'<rect x="{left:.2f}" y="{y}" width="{max(right - left, 0.4):.2f}" height="{BOX}" '
        f'fill="{COLOURS[span.kind]}"><title>{escape(about)}</title></rect>'
    )


def _deadlines(shown: Preview, rows: dict[str, int]) -> Iterator[str]:
    for name, times in shown.deadlines.items():
        for at_s in times:
            x = _x(at_s, shown.length_s)
            y = rows[name]
            yield f'<line class="due" x1="{x:.2f}" y1="{y}" x2="{x:.2f}" y2="{y + BOX}"/>'
