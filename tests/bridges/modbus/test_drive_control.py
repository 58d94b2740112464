"""What a PLC writes, and what goes out because of it: nothing moves unasked, a stop always goes."""

from __future__ import annotations

import anyio
import pytest

from bridges.modbus.fake_daemon import LEASE_S, OTHER_PLC, PLC, Bench, on_a_bench
from lecombus.bridges.modbus.drive_control import LONGEST_RETRY_S, STOP_AGAIN_S
from lecombus.bridges.modbus.register_map import OUTCOMES, Command, WriteReason

PENDING, DONE, VERIFIED, REFUSED, EXPIRED, SUPERSEDED, UNKNOWN = (
    OUTCOMES.index(word)
    for word in ("pending", "done", "verified", "refused", "expired", "superseded", "unknown")
)
NO_HEARTBEAT, COUNTS, HELD = 1, 2, 3


def control_state(bench: Bench) -> int:
    return bench.registers("control state")[0]


async def enabled(bench: Bench, setpoint: int | None = None) -> None:
    """Take the lease and enable the drive."""
    await bench.cycle(0.5, setpoint=setpoint)
    await bench.cycle(0.5, Command.ENABLE, setpoint)
    assert bench.command[1] == VERIFIED


def test_a_lease_is_taken_when_the_heartbeat_counts_and_held_while_it_does() -> None:
    async def test(bench: Bench) -> None:
        assert control_state(bench) == NO_HEARTBEAT
        bench.beat()
        await anyio.sleep(0.1)
        assert (control_state(bench), bench.daemon.leased()) == (NO_HEARTBEAT, False)
        await bench.cycle(5 * LEASE_S)
        assert (control_state(bench), bench.daemon.leased()) == (HELD, True)
        assert 3 * 5 <= len(bench.daemon.renewals) <= 8 * 5

    on_a_bench(test)


@pytest.mark.parametrize("every_s", [0.01, 0.1, 0.24, 0.26, 1.0, 1.9])
def test_a_heartbeat_of_any_pace_within_the_lease_time_holds_it(every_s: float) -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(20.0, every_s=every_s)
        assert control_state(bench) == HELD
        await anyio.sleep(LEASE_S + 0.01)
        assert not bench.daemon.leased()

    on_a_bench(test)


def test_no_renewal_is_sent_without_a_further_count() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(3.0)
        last_s = anyio.current_time()
        await bench.cycle(1.0, counts=False)
        await anyio.sleep(2.0)
        assert max(bench.daemon.renewals) <= last_s
        assert not bench.daemon.leased()

    on_a_bench(test)


def test_a_plc_that_writes_the_same_count_for_ever_gets_no_lease() -> None:
    async def test(bench: Bench) -> None:
        bench.count = 7
        await bench.cycle(5.0, counts=False)
        assert (control_state(bench), bench.daemon.leased()) == (NO_HEARTBEAT, False)

    on_a_bench(test)


@pytest.mark.parametrize("count", [500, 40_000, 61_000])
def test_a_plc_that_counts_from_0_again_renews_nothing_until_the_lapse(count: int) -> None:
    async def test(bench: Bench) -> None:
        bench.count = count
        await enabled(bench)
        bench.count, begun_s = 0, anyio.current_time()
        await bench.cycle(LEASE_S + 0.1, Command.ENABLE)
        assert max(bench.daemon.renewals) <= begun_s
        assert not bench.daemon.leased()
        await bench.cycle(3.0, Command.ENABLE)
        assert bench.daemon.leased()
        assert bench.daemon.sent == ["enable"]

    on_a_bench(test)


def test_a_count_passes_from_65535_to_0() -> None:
    async def test(bench: Bench) -> None:
        bench.count = 0xFFFF - 5
        await bench.cycle(5.0)
        assert bench.daemon.leased()
        assert bench.count < 100

    on_a_bench(test)


def test_a_command_register_that_was_set_before_the_lease_starts_nothing() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(5.0, Command.ENABLE, 354000)
        assert bench.daemon.sent == ["set-speed 35.4 Hz"]
        assert bench.command == (1, REFUSED, WriteReason.NO_LEASE)
        assert control_state(bench) == HELD

    on_a_bench(test)


def test_an_enable_goes_out_once_when_the_register_changes_from_0() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(0.5)
        await bench.cycle(5.0, Command.ENABLE)
        assert bench.daemon.sent == ["enable"]
        first = bench.command
        await bench.cycle(0.2)
        await bench.cycle(1.0, Command.ENABLE)
        assert bench.daemon.sent == ["enable", "enable"]
        assert (first, bench.command) == ((1, VERIFIED, 0), (2, VERIFIED, 0))

    on_a_bench(test)


def test_a_command_that_was_another_one_before_is_refused() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        await bench.cycle(0.5, Command.RESET_FAULT)
        assert bench.command == (2, REFUSED, WriteReason.NOT_FROM_0)
        await bench.cycle(0.5, Command.QUICK_STOP)
        await bench.cycle(0.5, Command.ENABLE)
        assert bench.command == (4, REFUSED, WriteReason.NOT_FROM_0)
        assert bench.daemon.sent == ["enable", "quick-stop feeder"]

    on_a_bench(test)


def test_after_a_lapse_the_register_must_be_0_under_the_new_lease() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 354000)
        await bench.cycle(LEASE_S + 1.0, counts=False)  # 0, without a lease
        sent = list(bench.daemon.sent)
        await bench.cycle(3.0, Command.ENABLE, 354000)
        assert bench.daemon.leased()
        assert bench.daemon.sent == [*sent, "set-speed 35.4 Hz"]
        await bench.cycle(0.3, Command.NONE, 354000)
        await bench.cycle(1.0, Command.ENABLE, 354000)
        assert bench.daemon.sent == [*sent, "set-speed 35.4 Hz", "enable"]

    on_a_bench(test)


async def beats(bench: Bench, for_s: float) -> None:
    """Write the heartbeat and nothing else."""
    for _ in range(round(10 * for_s)):
        bench.beat()
        await anyio.sleep(0.1)


def test_a_0_that_was_written_before_the_lease_does_not_count() -> None:
    async def test(bench: Bench) -> None:
        bench.control.write_command(PLC, Command.NONE)
        await beats(bench, 1.0)
        assert control_state(bench) == HELD
        bench.control.write_command(PLC, Command.ENABLE)
        await anyio.sleep(0.1)
        assert bench.command == (1, REFUSED, WriteReason.NOT_FROM_0)
        bench.control.write_command(PLC, Command.NONE)
        await beats(bench, LEASE_S)
        await anyio.sleep(LEASE_S + 0.1)
        assert not bench.daemon.leased()
        await beats(bench, 2.0)
        bench.control.write_command(PLC, Command.ENABLE)
        await anyio.sleep(0.1)
        assert bench.command == (2, REFUSED, WriteReason.NOT_FROM_0)
        assert bench.daemon.sent == []

    on_a_bench(test)


def test_after_a_stop_the_register_must_be_0_again() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(1.0)
        bench.control.write_stop(Command.QUICK_STOP)
        bench.control.write_command(PLC, Command.ENABLE)
        await anyio.sleep(0.1)
        assert bench.command == (2, REFUSED, WriteReason.NOT_FROM_0)
        assert bench.daemon.sent == ["quick-stop feeder"]

    on_a_bench(test)


def test_another_plc_gives_no_setpoint_and_no_command_under_the_lease_of_the_first() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        bench.control.write_setpoint(OTHER_PLC, 10_000)
        bench.control.write_command(OTHER_PLC, Command.NONE)
        bench.control.write_command(OTHER_PLC, Command.ENABLE)
        await anyio.sleep(0.1)
        assert bench.daemon.sent == ["enable"]
        assert bench.setpoint == (1, REFUSED, WriteReason.NO_LEASE)
        assert bench.command == (2, REFUSED, WriteReason.NO_LEASE)

    on_a_bench(test)


def test_a_stop_needs_no_lease_and_goes_out_once() -> None:
    async def test(bench: Bench) -> None:
        for _ in range(50):
            bench.control.write_stop(Command.QUICK_STOP)
            await anyio.sleep(0.1)
        bench.control.write_stop(Command.INHIBIT)
        await anyio.sleep(0.1)
        assert bench.daemon.sent == ["quick-stop feeder", "inhibit feeder"]
        assert bench.command == (2, VERIFIED, WriteReason.NONE)

    on_a_bench(test)


def test_a_stop_that_is_written_again_later_is_a_new_one() -> None:
    """A button of an operator panel writes 1 each time, and never 0."""

    async def test(bench: Bench) -> None:
        for press in (1, 2, 3):
            bench.control.write_stop(Command.QUICK_STOP, PLC)
            await anyio.sleep(60)
            assert bench.daemon.sent == press * ["quick-stop feeder"]
            assert bench.command == (press, VERIFIED, WriteReason.NONE)

    on_a_bench(test)


def test_a_stop_of_one_client_is_not_lost_in_that_which_another_holds() -> None:
    async def test(bench: Bench) -> None:
        for cycle in range(100):
            bench.control.write_stop(Command.QUICK_STOP, PLC)
            if cycle == 50:
                bench.control.write_stop(Command.QUICK_STOP, OTHER_PLC)
            await anyio.sleep(0.1)
        assert bench.daemon.sent == 2 * ["quick-stop feeder"]

    on_a_bench(test)


def test_a_stop_that_did_not_end_well_is_sent_again_while_it_is_written() -> None:
    async def test(bench: Bench) -> None:
        bench.daemon.outcome, bench.daemon.kind = "unknown", "no-answer"
        for _ in range(100):
            bench.control.write_stop(Command.QUICK_STOP)
            await anyio.sleep(0.1)
        assert len(bench.daemon.sent) == 10.0 / STOP_AGAIN_S
        assert bench.command[1:] == (UNKNOWN, WriteReason.NO_ANSWER)
        bench.daemon.outcome, bench.daemon.kind = "verified", ""
        for _ in range(100):
            bench.control.write_stop(Command.QUICK_STOP)
            await anyio.sleep(0.1)
        assert len(bench.daemon.sent) == 10.0 / STOP_AGAIN_S + 1

    on_a_bench(test)


def test_a_stop_that_the_family_does_not_have_is_not_repeated() -> None:
    async def test(bench: Bench) -> None:
        bench.daemon.outcome, bench.daemon.kind = "refused", "no-stop"
        for _ in range(100):
            bench.control.write_stop(Command.QUICK_STOP)
            await anyio.sleep(0.1)
        assert len(bench.daemon.sent) == 1
        assert bench.command[1:] == (REFUSED, WriteReason.NOT_PERMITTED)
        bench.control.write_stop(Command.INHIBIT)
        await anyio.sleep(0.1)
        assert len(bench.daemon.sent) == 2

    on_a_bench(test)


def test_a_stop_under_way_is_not_sent_again() -> None:
    async def test(bench: Bench) -> None:
        bench.daemon.takes_s = 5.0
        for _ in range(40):
            bench.control.write_stop(Command.QUICK_STOP)
            await anyio.sleep(0.1)
        assert len(bench.daemon.asked_at_s) == 1
        assert bench.command[1] == PENDING

    on_a_bench(test)


def test_a_stop_from_another_plc_is_taken_and_the_controller_must_begin_from_0() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        assert bench.control.is_busy_for(OTHER_PLC)
        bench.control.write_stop(Command.QUICK_STOP)
        await bench.cycle(1.0, Command.ENABLE)
        assert bench.daemon.sent == ["enable", "quick-stop feeder"]
        assert bench.command[1:] == (REFUSED, WriteReason.NOT_FROM_0)

    on_a_bench(test)


def test_a_stop_prevents_an_enable_that_waits_behind_its_setpoint() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 100000)
        await bench.cycle(0.3, Command.NONE, 100000)
        bench.daemon.takes_s = 0.5
        bench.control.write_setpoint(PLC, 200000)
        bench.control.write_command(PLC, Command.ENABLE)
        await anyio.sleep(0.2)
        bench.beat()
        bench.control.stopped_with_all()
        await anyio.sleep(0.7)
        assert bench.daemon.sent == ["set-speed 10 Hz", "enable", "set-speed 20 Hz"]
        assert bench.command == (2, SUPERSEDED, WriteReason.STOPPED)

    on_a_bench(test)


@pytest.mark.parametrize(
    ("takes_s", "sent", "outcome", "reason"),
    [(0.4, True, VERIFIED, WriteReason.NONE), (1.1, False, EXPIRED, WriteReason.OVERLOADED)],
)
def test_an_enable_that_waits_behind_setpoints_counts_as_asked_for_when_it_was_written(
    takes_s: float, sent: bool, outcome: int, reason: WriteReason
) -> None:
    """A stop from elsewhere ends it then, and it expires."""

    async def test(bench: Bench) -> None:
        await enabled(bench, 100000)
        await bench.cycle(0.3, Command.NONE, 100000)
        asked, bench.daemon.takes_s = len(bench.daemon.asked_ago_s), takes_s
        bench.control.write_setpoint(PLC, 150000)
        await anyio.sleep(0.05)
        await bench.cycle(3.5 * takes_s, Command.ENABLE, 200000)
        assert bench.daemon.sent[-1] == ("enable" if sent else "set-speed 20 Hz")
        assert bench.command == (2, outcome, reason)
        assert [round(one, 2) for one in bench.daemon.asked_ago_s[asked:]] == (
            [2 * takes_s - 0.05] if sent else []
        )

    on_a_bench(test)


def test_a_setpoint_goes_out_when_it_changes_and_not_in_every_cycle() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 354000)
        await bench.cycle(10.0, setpoint=354000)
        await bench.cycle(10.0, setpoint=-5000)
        assert bench.daemon.sent == ["set-speed 35.4 Hz", "enable", "set-speed -0.5 Hz"]
        assert bench.setpoint[1:] == (VERIFIED, WriteReason.NONE)

    on_a_bench(test)


def test_of_setpoints_that_change_faster_than_the_line_the_newest_counts() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        bench.daemon.takes_s = 0.5
        for number in range(40):
            await bench.cycle(0.1, setpoint=10_000 * number)
        await bench.cycle(1.0, setpoint=390_000)
        speeds = [float(one.split()[1]) for one in bench.daemon.sent[1:]]
        assert len(speeds) <= 11
        assert (speeds[-1], speeds) == (39.0, sorted(speeds))

    on_a_bench(test)


def test_a_setpoint_that_failed_is_tried_again_ever_more_seldom() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        bench.daemon.asked_at_s.clear()
        bench.daemon.outcome, bench.daemon.kind = "refused", "nak"
        await bench.cycle(300.0, setpoint=500_000)
        assert bench.setpoint[1:] == (REFUSED, WriteReason.NAK)
        assert 6 <= len(bench.daemon.asked_at_s) <= 6 + 300.0 / LONGEST_RETRY_S
        bench.daemon.outcome, bench.daemon.kind = "done", ""
        await bench.cycle(0.5, setpoint=400_000)
        assert bench.setpoint[1:] == (DONE, WriteReason.NONE)

    on_a_bench(test)


def test_a_drive_that_was_away_is_given_its_setpoint_again() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 354000)
        bench.facts.online = False
        await bench.cycle(1.0, setpoint=354000)
        assert bench.setpoint[1:] == (REFUSED, WriteReason.NO_ANSWER)
        bench.facts.online = True
        await bench.cycle(1.0, setpoint=354000)
        assert bench.daemon.sent == ["set-speed 35.4 Hz", "enable", "set-speed 35.4 Hz"]
        assert bench.setpoint[1:] == (VERIFIED, WriteReason.NONE)

    on_a_bench(test)


def test_an_enabled_drive_is_given_its_new_setpoint_before_it_is_enabled_again() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 354000)
        await bench.cycle(0.5, Command.QUICK_STOP, 354000)
        await bench.cycle(0.2, Command.NONE, 354000)
        bench.control.write_setpoint(PLC, 100000)
        bench.control.write_command(PLC, Command.ENABLE)
        await bench.cycle(0.5, Command.ENABLE, 100000)
        assert bench.daemon.sent[-3:] == ["quick-stop feeder", "set-speed 10 Hz", "enable"]

    on_a_bench(test)


def test_a_setpoint_that_the_drive_refuses_prevents_the_enable() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench, 354000)
        await bench.cycle(0.3, Command.NONE, 354000)
        bench.daemon.outcome, bench.daemon.kind = "refused", "bad-value"
        await bench.cycle(1.0, Command.ENABLE, 9_990_000)
        assert bench.daemon.sent.count("enable") == 1
        assert bench.command[1:] == (REFUSED, WriteReason.BAD_VALUE)

    on_a_bench(test)


def test_a_latched_drive_that_shows_no_stop_is_not_enabled_at_its_old_setpoint() -> None:
    async def test(bench: Bench) -> None:
        bench.daemon.is_stopped = False
        await bench.cycle(0.5, setpoint=354000)
        await bench.cycle(1.0, Command.ENABLE, 354000)
        assert bench.daemon.sent == []
        assert bench.command == (1, REFUSED, WriteReason.LATCHED)
        assert bench.setpoint[1:] == (REFUSED, WriteReason.LATCHED)
        await bench.cycle(0.5, Command.QUICK_STOP, 354000)
        await bench.cycle(0.5, Command.NONE, 354000)
        await bench.cycle(0.5, Command.ENABLE, 354000)
        assert bench.daemon.sent == ["quick-stop feeder", "set-speed 35.4 Hz", "enable"]

    on_a_bench(test)


def test_setpoints_of_a_plc_without_the_lease_are_never_sent() -> None:
    async def test(bench: Bench) -> None:
        bench.control.write_setpoint(OTHER_PLC, 999)
        assert bench.setpoint == (1, REFUSED, WriteReason.NO_LEASE)
        await bench.cycle(1.0)
        await bench.cycle(1.0, Command.ENABLE)
        assert bench.daemon.sent == ["enable"]

    on_a_bench(test)


def test_what_is_under_way_when_the_lease_ends_is_unknown() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(0.5)
        bench.daemon.takes_s = 30.0
        bench.control.write_command(PLC, Command.ENABLE)
        await anyio.sleep(LEASE_S + 0.5)
        assert bench.command == (1, UNKNOWN, WriteReason.NO_LEASE)

    on_a_bench(test)


def test_another_plc_waits_until_the_lease_of_the_first_has_ended() -> None:
    async def test(bench: Bench) -> None:
        await bench.cycle(1.0)
        assert bench.control.is_busy_for(OTHER_PLC)
        assert not bench.control.is_busy_for(PLC)
        await anyio.sleep(LEASE_S + 0.1)
        assert not bench.control.is_busy_for(OTHER_PLC)
        for _ in range(30):
            bench.beat(OTHER_PLC)
            await anyio.sleep(0.1)
        assert bench.control.is_busy_for(PLC)
        assert bench.daemon.leased()

    on_a_bench(test)


def test_a_lease_of_another_client_is_said_and_asked_for_again_each_second() -> None:
    async def test(bench: Bench) -> None:
        bench.daemon.is_held_by_other = True
        await bench.cycle(3.0)
        assert bench.registers("control state", "lease reason") == (
            COUNTS,
            WriteReason.HELD_BY_OTHER,
        )
        bench.daemon.is_held_by_other = False
        await bench.cycle(1.5)
        assert bench.registers("control state", "lease reason") == (HELD, WriteReason.NONE)

    on_a_bench(test)


def test_a_daemon_that_is_gone_ends_the_lease_and_refuses_what_is_asked() -> None:
    async def test(bench: Bench) -> None:
        await enabled(bench)
        bench.daemon.is_gone = True
        bench.control.write_stop(Command.QUICK_STOP)
        await bench.cycle(LEASE_S + 0.5, Command.NONE)
        assert bench.command[1:] == (REFUSED, WriteReason.DAEMON_AWAY)
        assert control_state(bench) != HELD
        await bench.cycle(2.0)
        assert bench.registers("lease reason")[0] == WriteReason.DAEMON_AWAY

    on_a_bench(test)
