"""Classes of faults in a running daemon: three of them, and all of them in `make test-long`."""

from __future__ import annotations

import pytest

from faults.classes import CLASSES
from faults.run import chosen, main, put_in

pytestmark = [pytest.mark.real]

QUICK = ("clients say rubbish", "the clock jumps back")


def test_there_are_enough_classes_of_every_kind() -> None:
    assert len(CLASSES) >= 20
    areas = {one.area for one in CLASSES.values()}
    assert areas >= {
        "line", "adapter", "disk", "clock", "memory", "processor", "broker", "client"
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_what_is_promised_holds_under_some_faults() -> None:
    seen = list(put_in(CLASSES[name] for name in QUICK))
    assert [(one.name, result.broken) for one, _, result in seen] == [(name, []) for name in QUICK]


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_what_is_promised_holds_under_every_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["make faults"])
    assert main() == 0


def test_parts_of_names_and_areas_choose() -> None:
    assert {one.area for one in chosen(["clock"])} == {"clock"}
    assert [one.name for one in chosen(["clients leave"])] == ["clients leave in the middle"]
