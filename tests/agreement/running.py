"""One line under attack on the virtual clock, and what was promised beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import anyio

from agreement.adversary import Adversary, Measured
from agreement.cases import Case
from agreement.hostile import hostile_line
from lecombus.capacity.exchange_costs import watched_s
from lecombus.capacity.plan import make_plan
from lecombus.config import Roster
from lecombus.drive_state.readings import DriveState
from lecombus.drives import family
from lecombus.line_runtime import LineRuntime
from lecombus.schedule.watchdog_deadline import HARD_PART
from support.site_host import Plant, until
from support.taps import running
from support.virtual_loop import run

__all__ = ["Agreed", "agree", "as_measured", "attack_in_virtual_time", "attacked"]

START_S = 900.0
NEVER = (0.0, 0.0)


@dataclass(frozen=True)
class Agreed:
    """One promise and its measure.

    Args:
        what: Of what.
        promised_s: The bound, seconds.
        measured_s: The worst that was seen, seconds.
        late_s: The part of that which was the machine's lateness, seconds.
    """

    what: str
    promised_s: float
    measured_s: float
    late_s: float = 0.0

    @property
    def ratio(self) -> float:
        """How much of the promise was used, the machine's lateness taken off."""
        return (self.measured_s - self.late_s) / self.promised_s


def agree(roster: Roster, measured: Measured) -> list[Agreed]:
    """Lay promise and measure side by side."""
    plan = make_plan(roster)
    found = []
    feed_codes = {drive.name: str(family(drive.family).feed_code) for drive in roster.drives}
    codes = {
        one: feed_codes[one.drive] if one.what == "feed" else one.what for one in plan.exchanges
    }
    longest = max(
        ((one, measured.failed.get((one.drive, codes[one]), NEVER)) for one in plan.exchanges),
        key=lambda pair: (pair[1][0] - pair[1][1]) / pair[0].times.worst_s,
    )
    found.append(Agreed("failed exchange", longest[0].times.worst_s, *longest[1]))
    for what, (wait_s, late_s) in measured.waits.items():
        name, _, how = what.partition(", ")
        wait = plan.wait(name)
        promised_s = {"": wait.quiet_s, "loaded": wait.loaded_s, "crowded": wait.crowded_s}[how]
        assert promised_s is not None
        found.append(Agreed(what, promised_s, wait_s, late_s))
    fed = [
        Agreed("feed distance", HARD_PART * time_s, measured.fed[drive.name])
        for drive in roster.drives
        if (time_s := watched_s(drive)) and drive.name in measured.fed
    ]
    if fed:
        found.append(max(fed, key=lambda one: one.ratio))
    return found


def as_measured(site: LineRuntime) -> Roster:
    """Give a line's roster with the answer times that it measured, as `plan --from-daemon` does."""
    roster = site.roster
    drives = tuple(
        drive.model_copy(update={"slow": site.requests.station(drive.name).measured.slow})
        for drive in roster.drives
    )
    return roster.model_copy(update={"drives": drives})


async def attacked(
    site: LineRuntime,
    adversary: Adversary,
    length_s: float,
    *,
    real: bool = False,
    crowd: bool = False,
) -> Measured:
    """Run a line, wait until all its drives are there, and attack it.

    Args:
        site: The line.
        adversary: Who attacks it.
        length_s: For how long, seconds.
        real: On the real clock: how late this machine is is looked at too.
        crowd: Not by one attack after the other, but by clients of all classes at once.
    """
    async with running(site), anyio.create_task_group() as tasks:
        await until(lambda: _all_there(site), within_s=START_S)
        await adversary.quiet()
        if real:
            tasks.start_soon(adversary.note_lateness)
        measured = await (adversary.crowd(length_s) if crowd else adversary.run(length_s))
        tasks.cancel_scope.cancel()
    return measured


def _all_there(site: LineRuntime) -> bool:
    names = [drive.name for drive in site.roster.drives]
    return all(site.store.drive(name).state is DriveState.ONLINE for name in names)


def attack_in_virtual_time(case: Case, length_s: float = 60.0, *, crowd: bool = False) -> Measured:
    """Attack a line on the virtual clock."""
    roster = case.roster()

    async def main() -> Measured:
        sim = hostile_line(roster)
        plant = Plant(roster, line=sim, latency_s=0.001)
        adversary = Adversary(plant.site, sim, lambda act: act())
        return await attacked(plant.site, adversary, length_s, crowd=crowd)

    return run(main())
