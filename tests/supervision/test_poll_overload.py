"""A line that cannot hold its cyclic reads is remarked on, and nothing that only looks like it."""

from __future__ import annotations

from lecombus.drive_state.store import Store
from lecombus.schedule.polling import STRETCH_WINDOW_S
from lecombus.supervision.line_remarks import PollOverload

LONG = round(STRETCH_WINDOW_S) + 5


def remarks(
    overload: PollOverload, store: Store, seconds: list[float], stretch: float = 2.0
) -> list[bool]:
    found = []
    for now_s in seconds:
        overload.note(stretch, now_s, answers=True)
        found.append("cadence" in store.line().remarks)
    return found


def test_a_line_that_is_stretched_for_long_is_remarked_on() -> None:
    store = Store(lambda: 0.0, lambda: 0.0)
    assert remarks(PollOverload(store), store, [float(one) for one in range(LONG)])[-1]


def test_what_a_pause_of_the_daemon_stretched_is_no_remark() -> None:
    store = Store(lambda: 0.0, lambda: 0.0)
    overload = PollOverload(store)
    overload.note(1.0, 100.0, answers=True)
    after = [105.0 + one for one in range(LONG)]
    found = remarks(overload, store, after)
    assert not any(found[: round(STRETCH_WINDOW_S)])
    assert found[-1], "what lasts longer than the pause is said"


def test_what_the_stop_of_a_silent_drive_stretched_is_no_remark() -> None:
    store = Store(lambda: 0.0, lambda: 0.0)
    overload = PollOverload(store)
    for now_s in range(LONG):
        overload.note(2.0, float(now_s), answers=True, stopping=now_s >= LONG - 3)
    assert "cadence" not in store.line().remarks
