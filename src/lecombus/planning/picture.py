"""The line over one hyperperiod as an SVG: who speaks when, and by when each had to be fed.

One row for the line and one for each drive, one box an exchange, one tick a deadline, one dashed
line an end of the hyperperiod; readable in any browser and in print, without scripts. Text is
escaped; sizes follow from the number of drives.
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
TOP: Final = 86
BOX: Final = 12
ROOM: Final = NAMES - 18
SIZE: Final = 11
USUAL, WIDE = 6.2, 9.5  # of a character at that size, about
COLOURS: Final = {"cyclic": "#3b6ea5", "watchdog": "#c2662d"}
STYLE: Final = (
    "text{font:11px sans-serif;fill:#222}.head{font-size:14px}.grid{stroke:#ddd}"
    ".due{stroke:#b00020;stroke-width:1.5}.round{stroke:#222;stroke-dasharray:4 3}"
)
MOST_ROUNDS: Final = 50
"""More ends of a hyperperiod than this are a grey curtain, and are not drawn."""


def picture(title: str, drives: tuple[str, ...], shown: Preview) -> str:
    """Draw a stretch of a line's time.

    Args:
        title: What stands above it.
        drives: The rows, from the top.
        shown: What happens.

    Returns:
        An SVG document.
    """
    height = TOP + ROW * (len(drives) + 1) + 30
    rows = {name: TOP + ROW * number for number, name in enumerate(drives, 1)}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>{escape(title)}</title><style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        f'<text class="head" x="10" y="22">{escape(title)}</text>',
        f'<text x="10" y="40">{escape(_about(shown))}</text>',
        *_legend(),
        *_grid(shown.length_s, height),
        *_rounds(shown, height),
        _name("the line", TOP),
        *(_box(span, TOP, shown.length_s, "") for span in shown.spans),
        *(_name(name, y) for name, y in rows.items()),
        *(_box(span, rows[span.drive], shown.length_s, _told(span)) for span in shown.spans),
        *_deadlines(shown, rows),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def _about(shown: Preview) -> str:
    """Say how much of the hyperperiod is shown, and how full it is."""
    taken = (
        f"{shown.total:.0%} of the time is taken: reads {shown.cyclic:.0%}, feeds "
        f"{shown.feeding:.0%}"
    )
    if not shown.whole_s:
        return f"no cyclic reads; {shown.length_s:g} s are shown; {taken}"
    whole = f"{shown.whole_s:g} s"
    if shown.stretch > 1.0:
        whole = f"{shown.whole_s:.2f} s, stretched by {shown.stretch:.2f}"
    if shown.whole_s > shown.length_s:
        part = f"its first {shown.length_s:g} s are shown"
    elif shown.whole_s < shown.length_s:
        part = f"{shown.length_s:g} s are shown"
    else:
        part = "all of it is shown"
    return f"hyperperiod of the cyclic reads: {whole}, {part}; {taken}"


def _x(at_s: float, length_s: float) -> float:
    return NAMES + (WIDTH - NAMES - 20) * min(at_s, length_s) / length_s


def _legend() -> Iterator[str]:
    x = NAMES
    for word, colour in (("cyclic read", COLOURS["cyclic"]), ("feed", COLOURS["watchdog"])):
        yield f'<rect x="{x}" y="52" width="12" height="{BOX}" fill="{colour}"/>'
        yield f'<text x="{x + 17}" y="62">{word}</text>'
        x += 110
    for kind, word in (
        ("due", "by then it must have been fed again"), ("round", "end of a hyperperiod"),
    ):  # fmt: skip
        yield f'<line class="{kind}" x1="{x}" y1="52" x2="{x}" y2="64"/>'
        yield f'<text x="{x + 6}" y="62">{word}</text>'
        x += 230


def _grid(length_s: float, height: int) -> Iterator[str]:
    for tenth in range(11):
        at_s = length_s * tenth / 10
        x = _x(at_s, length_s)
        yield f'<line class="grid" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 24}"/>'
        yield f'<text x="{x - 10:.1f}" y="{height - 10}">{at_s:g} s</text>'


def _rounds(shown: Preview, height: int) -> Iterator[str]:
    """Mark where the cyclic reads begin again."""
    count = int(shown.length_s / shown.whole_s + 1e-9) if shown.whole_s else 0
    for number in range(1, count + 1) if count <= MOST_ROUNDS else ():
        x = _x(shown.whole_s * number, shown.length_s)
        yield f'<line class="round" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 24}"/>'


def _name(name: str, y: float) -> str:
    """Write a row's name, smaller where it would reach into the picture."""
    wide = sum(WIDE if one in "mwMW" else USUAL for one in name)
    fitted = "" if wide <= ROOM else f' style="font-size:{SIZE * ROOM / wide:.1f}px"'
    return f'<text x="10" y="{y + BOX - 2}"{fitted}>{escape(name)}</text>'


def _told(span: Span) -> str:
    return f"{span.drive}, {span.what}: {span.start_s:.3f} s to {span.end_s:.3f} s"


def _box(span: Span, y: float, length_s: float, about: str) -> str:
    left, right = _x(span.start_s, length_s), _x(span.end_s, length_s)
    shape = (
        f'<rect x="{left:.2f}" y="{y}" width="{max(right - left, 0.4):.2f}" height="{BOX}" '
        f'fill="{COLOURS[span.kind]}"'
    )
    return f"{shape}><title>{escape(about)}</title></rect>" if about else f"{shape}/>"


def _deadlines(shown: Preview, rows: dict[str, int]) -> Iterator[str]:
    for name, times in shown.deadlines.items():
        for at_s in times:
            x = _x(at_s, shown.length_s)
            y = rows[name]
            yield f'<line class="due" x1="{x:.2f}" y1="{y}" x2="{x:.2f}" y2="{y + BOX}"/>'
