"""Two remarks on a whole line that follow from its figures.

`PollOverload` remarks cyclic reads that the line cannot hold. `remark_second_answers` remarks
answers that were not asked for; the exchange loop counts them.
"""

from __future__ import annotations

import math
from typing import Final

from lecombus.drive_state.drive_runtime import LineDrives
from lecombus.drive_state.store import Store
from lecombus.fieldbus.loop_interface import SecondAnswerCount
from lecombus.schedule.polling import STRETCH_WINDOW_S

__all__ = ["PollOverload", "remark_second_answers"]

OVERLOAD_REMARK: Final = "cadence"
SAID_FROM: Final = 1.05
"""A cadence stretched by less than this is not worth a remark."""

STARTING_MOST_S: Final = 600.0
"""A full line's first start takes minutes; a drive that is starting for longer than this, seconds,
has another trouble and hides nothing."""

PAUSED_FROM_S: Final = 1.5
"""The figure comes once a second; where it comes so much later, seconds, the daemon did not run."""

SECOND_ANSWERS_REMARK: Final = "second-answers"


class PollOverload:
    """The remark on a line that cannot hold the cyclic reads it was asked for.

    What a line could not do while it was closed, while no drive was online, while drives were being
    started or stopped, or while the daemon did not run, is not what it cannot hold: the periods of
    that time are given as they were (`cyclic_stretch_ratio`), and no remark is made of them.

    Args:
        store: Gets the factor, and the remark.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._closed_at_s = -math.inf  # last closed, silent, starting, stopping or paused
        self._starting_from_s: float | None = None
        self._noted_s = math.inf

    def note(
        self,
        stretch: float,
        now_s: float,
        *,
        answers: bool,
        starting: bool = False,
        stopping: bool = False,
    ) -> None:
        """Take the figure of the moment; about once a second.

        Args:
            stretch: The factor by which cyclic periods grew in the last seconds, 1 or more.
            now_s: Monotonic seconds.
            answers: Whether the line is open, and a drive is online.
            starting: Whether drives are being started.
            stopping: Whether stops wait, such as that of a drive that does not answer.
        """
        if not starting:
            self._starting_from_s = None
        elif self._starting_from_s is None:
            self._starting_from_s = now_s
        begun_s = self._starting_from_s
        paused = now_s - self._noted_s >= PAUSED_FROM_S
        self._noted_s = now_s
        begins = begun_s is not None and now_s - begun_s < STARTING_MOST_S
        if paused or stopping or begins or not answers:
            self._closed_at_s = now_s
        self._store.set_stretch(stretch)
        text = None
        if stretch > SAID_FROM and now_s - self._closed_at_s > STRETCH_WINDOW_S:
            text = (
                f"the line cannot hold the cyclic reads asked for: every period is {stretch:.2f} "
                "times as long; ask for fewer, more seldom, or at a higher baud rate"
            )
        self._store.note_line(OVERLOAD_REMARK, text)


def remark_second_answers(found: SecondAnswerCount, drives: LineDrives, store: Store) -> None:
    """Remark answers that were not asked for: two drives at one address, or every answer twice.

    Args:
        found: How many came within the last minute, and behind whose answers.
        drives: The drives.
        store: Gets the remarks.
    """
    suspected = False
    for drive in drives:
        text, name, address = None, drive.name, drive.entry.address
        if found.may_be_two(name):
            suspected = True
            text = (
                f"two drives at address {address}? second answers came after its own, "
                f"{found.alone[name]} in the last minute: no stop of it is verified; give one of "
                "the two another address"
            )
        store.note(name, SECOND_ANSWERS_REMARK, text)
    text = None
    if found.is_remarkable and not suspected:
        text = (
            f"{found.total} answers came in the last minute that nobody asked for: two drives at "
            "one address, an adapter or device server that delivers twice, answers later than "
            "line.late_answer, or another master; until they end a stop takes more readings to be "
            "shown"
        )
    store.note_line(SECOND_ANSWERS_REMARK, text)
