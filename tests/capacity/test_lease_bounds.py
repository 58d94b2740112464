"""How soon drives that need a lease are stopped: by the plan, and on lines in virtual time."""

from __future__ import annotations

import json
import math

import anyio
import pytest

from lecombus.capacity.facts import facts_of, roster_of
from lecombus.capacity.lease_bounds import LeaseBound
from lecombus.capacity.plan import make_plan
from support.rosters import make_roster, roster_text
from support.site_host import Plant, with_plant

WATCHDOG = "{time: 3s, action: inhibit, configure: true}"
NAMES = "abcdef"


def keys(policy: str, more: str = "") -> dict[str, str]:
    lease = f"lease: {{required: true, time: 1s, on_lapse: {policy}}}"
    return {"drive": f"{lease}{more and ', '}{more}", "watchdog": WATCHDOG}


def bounds(policy: str, count: int = 3, more: str = "") -> list[LeaseBound]:
    drives = [(name, 11 + place, "8200vector") for place, name in enumerate(NAMES[:count])]
    return list(make_plan(make_roster(drives, **keys(policy, more))).leases)


def test_a_stop_waits_for_those_of_all_other_drives_with_leases() -> None:
    [one], three = bounds("quick-stop", 1), bounds("quick-stop", 3)
    assert 1.0 < one.stop_s < three[0].stop_s < one.stop_s + 0.5
    assert {bound.stop_s for bound in three} == {three[0].stop_s}
    assert bounds("inhibit", 1)[0].stop_s < one.stop_s, "it needs no control word"


def test_the_watchdog_counts_from_the_lapse_or_from_the_end_of_the_stop() -> None:
    [silence], [stop] = bounds("silence", 1), bounds("inhibit", 1)
    assert silence.stop_s == math.inf
    assert silence.watchdog_s == pytest.approx(4.0, abs=0.01)
    assert 9.0 < stop.watchdog_s < 10.0
    [hoist] = bounds("quick-stop", 1, "stop_fallback: none")
    assert hoist.watchdog_s == math.inf
    [hold] = bounds("hold", 1)
    assert (hold.stop_s, hold.watchdog_s) == (math.inf, math.inf)


def test_json_has_them_only_where_a_lease_is_needed() -> None:
    plain = make_plan(make_roster([("a", 11, "8200vector")])).as_json()
    assert "leases" not in plain
    found = make_plan(make_roster([("a", 11, "8200vector")], **keys("hold"))).as_json()["leases"]
    assert [(one["drive"], one["stop_s"]) for one in found] == [("a", None)]


def test_a_running_daemon_gives_what_the_bounds_need() -> None:
    roster = make_roster([("a", 11, "8200vector")], **keys("silence"))
    facts = json.loads(json.dumps(facts_of(roster), default=float))
    assert make_plan(roster_of(facts)).leases == make_plan(roster).leases


@pytest.mark.parametrize("kind", ["8200vector", "821x", "93xx", "smvector", "820x"])
@pytest.mark.parametrize("policy", ["quick-stop", "inhibit"])
def test_all_drives_of_clients_that_die_together_are_told_in_time(kind: str, policy: str) -> None:
    """The line is full, and the control words are not known; each client has one drive."""
    text = roster_text(
        [(name, 11 + place, kind) for place, name in enumerate(NAMES)],
        drive="lease: {required: true, time: 1s, on_lapse: " + policy + "}, "
        "cyclic: [{code: C0150, every: 50ms}, {code: C0050, every: 50ms}]",
    )

    async def test(plant: Plant) -> None:
        bound = {one.drive: one.stop_s for one in make_plan(plant.roster).leases}
        await plant.online()
        await anyio.sleep(10.0)
        ops = plant.site.operations
        taken_s = {}
        for name in NAMES:
            ops.leases.take(name, (name,), (name,), 1.0, 1)
            taken_s[name] = plant.now_s
            plant.site.drives.get(name).control_word.forget()
            await anyio.sleep(0.003)
        await anyio.sleep(6.0)
        for place, name in enumerate(NAMES):
            sent = plant.sent_to(11 + place, taken_s[name])
            written_s = min(one.at_s for one in sent if b"\x02" in one.data)
            assert written_s <= taken_s[name] + bound[name], name

    with_plant(test, text)
