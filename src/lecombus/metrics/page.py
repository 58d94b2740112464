"""The `/metrics` page: when it is rendered, and in which small pieces.

Strategy: a page of a full line takes milliseconds to render, longer than a telegram may be held
up. So it is rendered in pieces (one drive, one instrument), each far below a millisecond, at
most about once a second however many scrape, and preferably while a drive prepares its answer: a
scrape only requests a page, and the line calls `window` after each telegram. When
no window comes within `WINDOW_WAIT_S` (an idle or lost line), the scrape renders the pieces
itself and lets other tasks run between them. A scrape never touches the line.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import anyio
import anyio.lowlevel
from prometheus_client import ProcessCollector

from lecombus import __version__
from lecombus.drive_state.store import Store
from lecombus.metrics.counters import Counters
from lecombus.metrics.exposition import Block, escape, join_blocks, sample_lines
from lecombus.metrics.gauges import DriveGauges, JournalGauges, LineGauges, LineSnapshot
from lecombus.metrics.rolling_window import RollingWindow

__all__ = ["PAGE_KEEPS_S", "PIECE_BUDGET_S", "WINDOW_WAIT_S", "Metrics"]

PAGE_KEEPS_S: Final = 0.9
"""A page is served again for this long: a scrape each second always gets a new one."""

PIECE_BUDGET_S: Final = 0.00015
"""When a scrape renders itself, it lets others run after this; a piece may end a little later."""

WINDOW_WAIT_S: Final = 0.05
"""How long a scrape waits for a thinking drive: about one exchange at 9600 baud."""

WINDOW_MOST_S: Final = 0.003
"""Used of one window at most, so that a drive that answers early is not kept waiting long."""


class Metrics:
    """Instruments and page of one line.

    Args:
        line: The line's name.
        store: Where values and states come from.
        version: lecombus' version, for `build_info`.
        clock: A monotonic clock, seconds.
        snapshot: Called once per page for what schedule and supervisor say about themselves.
    """

    def __init__(
        self,
        line: str,
        store: Store,
        *,
        version: str = __version__,
        clock: Callable[[], float],
        snapshot: Callable[[], LineSnapshot] = LineSnapshot,
    ) -> None:
        self.counters = Counters(line)
        self.rolling_window = RollingWindow(clock())
        self.snapshot = snapshot
        self.certificates: Callable[[], Mapping[str, float]] = dict
        """Gives until when the TLS certificates in use are valid, by the roster's key."""
        self.wanted = False
        self._line = line
        self._store = store
        self._version = version
        self._clock = clock
        self._process = ProcessCollector(registry=None)
        self._work: Iterator[None] | None = None
        self._blocks: tuple[Block, ...] = ()
        self._pages: dict[bool, bytes] = {}
        self._asked_s: float | None = None
        self._rendered = anyio.Event()

    # -- for the line -----------------------------------------------------------------------------

    def window(self, for_s: float) -> None:
        """Use a moment in which nothing can arrive; costs nothing when no page is wanted.

        Args:
            for_s: How long nothing can arrive, seconds. At most half of it is used.
        """
        if self.wanted:
            self.render_step(min(for_s / 2, WINDOW_MOST_S))

    def render_step(self, budget_s: float) -> bool:
        """Render at least one piece of the wanted page.

        Args:
            budget_s: No further piece is begun after this, seconds.

        Returns:
            True when the page is complete (or none is wanted).
        """
        if not self.wanted:
            return True
        stop_s = self._clock() + budget_s
        if self._work is None:
            self._work = self._pieces()
        for _ in self._work:
            if self._clock() >= stop_s:
                return False
        self._work = None
        self.wanted = False
        self._rendered.set()
        return True

    # -- for the HTTP interface -------------------------------------------------------------------

    def ask(self) -> bool:
        """Ask for a page; return True when there is one that is new enough."""
        now_s = self._clock()
        if self.wanted:
            return False
        if self._asked_s is not None and now_s - self._asked_s < PAGE_KEEPS_S:
            return True
        self._asked_s = now_s
        self.wanted = True
        self._rendered = anyio.Event()
        return False

    async def fresh_page(self, *, openmetrics: bool) -> bytes:
        """Return a page no older than about a second, without holding anybody up."""
        if not self.ask():
            with anyio.move_on_after(WINDOW_WAIT_S):
                await self._rendered.wait()
            while not self.render_step(PIECE_BUDGET_S):
                await anyio.lowlevel.checkpoint()
        return self.page(openmetrics=openmetrics)

    def page(self, *, openmetrics: bool) -> bytes:
        """Return the last page rendered; empty before the first."""
        if openmetrics not in self._pages:
            self._pages[openmetrics] = join_blocks(self._blocks, openmetrics=openmetrics)
        return self._pages[openmetrics]

    # -- inside -----------------------------------------------------------------------------------

    def _pieces(self) -> Iterator[None]:
        """Render a page; everything between two `yield` runs without a break."""
        line, drives = LineGauges(self._line), DriveGauges(self._line)
        journal, snapshot = JournalGauges(self._line), self.snapshot()
        line.render(self._store, snapshot)
        journal.render(snapshot.journal)
        yield
        for name in self._store.names():
            drives.render(self._store, name)
            yield
        blocks = [
            self._build_info(),
            self._certificates(),
            *line.blocks,
            *journal.blocks,
            *drives.blocks,
        ]
        for family in self.counters.families():
            block = Block(family.name, family.kind, family.help)
            for part in list(family.parts.values()):
                for instrument in part:
                    block.lines += instrument.lines(family.name)
                yield
            blocks.append(block)
        for metric in self._process.collect():
            kind = str(metric.type)
            blocks.append(Block(metric.name, kind, metric.documentation, sample_lines(metric)))
        yield
        for block in blocks:
            block.close()
            yield
        self._blocks = tuple(blocks)
        self._pages = {}

    def _certificates(self) -> Block:
        name = "lecombus_tls_certificate_expiry_timestamp_seconds"
        block = Block(name, "gauge", "Until when a certificate in use is valid, Unix seconds.")
        for key, expires_s in self.certificates().items():
            block.add(f'line="{escape(self._line)}",file="{key}"', expires_s)
        return block

    def _build_info(self) -> Block:
        labels = (
            f'line="{escape(self._line)}",version="{escape(self._version)}",'
            f'python="{platform.python_version()}"'
        )
        block = Block("lecombus_build_info", "gauge", "Always 1; the labels say what is running.")
        block.add(labels, 1)
        return block
