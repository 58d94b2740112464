"""The roster a scan proposes: read by the roster's own reader, whatever was found."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.config import RosterError, WatchdogEntry, parse_roster
from lecombus.drives import FAMILY_NAMES, family
from lecombus.fieldbus.lecom.protocol.addressing import is_drive_address
from lecombus.fieldbus.lecom.scanning import (
    FoundDrive,
    FoundWatchdog,
    ProposedLine,
    Unclear,
    check_place,
    propose,
)
from lecombus.parameters import Code

PLACE = ProposedLine("hall-3", "/dev/serial/by-id/usb-x")


def finding(address: int, name: str = "822x", **more: object) -> FoundDrive:
    return FoundDrive(address, 9600, name, True, "why", **more)  # type: ignore[arg-type]


def test_drives_stand_in_the_order_of_their_addresses_with_what_they_said() -> None:
    found = [
        finding(12, "93xx", labels=((Code(1810), "33S2102I_10000"),), remarks=("C0005 is odd",)),
        finding(11, "smvector"),
    ]
    text, roster = propose(PLACE, 9600, found)
    assert [(one.name, one.address, one.family) for one in roster.drives] == [
        ("drive-11", 11, "smvector"),
        ("drive-12", 12, "93xx"),
    ]
    assert (roster.line.name, roster.line.port, roster.line.baud) == (
        "hall-3",
        "/dev/serial/by-id/usb-x",
        9600,
    )
    assert "  # C1810 33S2102I_10000\n" in text
    assert "  # note: C0005 is odd\n" in text


@pytest.mark.parametrize(
    ("found", "entry"),
    [
        (FoundWatchdog(2.0, "quick-stop"), WatchdogEntry(time_s=2.0, action="quick-stop")),
        (FoundWatchdog(65.535, "inhibit"), WatchdogEntry(time_s=65.535, action="inhibit")),
        (FoundWatchdog(0.4, "inhibit"), WatchdogEntry(time_s=0.4, action="inhibit")),
        (FoundWatchdog(3.0, "none"), None),
        (FoundWatchdog(0.0, "inhibit"), None),
        (FoundWatchdog(0.01, "inhibit"), None),
        (None, None),
    ],
)
def test_a_watchdog_that_acts_is_fed_as_found_and_any_other_only_told(
    found: FoundWatchdog | None, entry: WatchdogEntry | None
) -> None:
    text, roster = propose(PLACE, 9600, [finding(11, watchdog=found)])
    assert roster.drives[0].watchdog == entry
    assert ("# watchdog: {time: 3s, action: quick-stop, configure: true}" in text) == (not entry)


def test_a_watchdog_that_the_line_cannot_hold_is_told_and_not_proposed() -> None:
    """An SMVector comes with 50 ms, which two of them at 9600 baud cannot be given."""
    short = FoundWatchdog(0.05, "inhibit")
    found = [finding(11, watchdog=short), finding(12, watchdog=short),
             finding(13, watchdog=FoundWatchdog(2.0, "inhibit"))]  # fmt: skip
    text, roster = propose(PLACE, 9600, found)
    assert [one.watchdog is not None for one in roster.drives] == [False, False, True]
    assert text.count("The watchdog acts, and this line cannot hold it: a watchdog of 50ms") == 2


def test_the_suggested_watchdog_may_be_taken_as_it_stands() -> None:
    for name in FAMILY_NAMES:
        text, _ = propose(PLACE, 9600, [finding(11, name)])
        roster = parse_roster(text.replace("# watchdog:", "watchdog:"), "taken")
        if family(name).watchdog is not None:
            assert roster.drives[0].watchdog is not None


def test_what_cannot_be_in_this_roster_is_told_in_it() -> None:
    other = FoundDrive(21, 19200, "93xx", True, "why")
    text, roster = propose(PLACE, 9600, [finding(11), other], [Unclear(17, 9600, b"\x02")])
    assert [one.address for one in roster.drives] == [11]
    assert "# At 19200 baud, and so out of this line's reach: address 21, 93xx." in text
    assert "# Address 17 (9600 baud) never gave a whole answer" in text


def test_more_than_31_drives_need_repeaters() -> None:
    numbers = list(filter(is_drive_address, range(1, 99)))
    assert propose(PLACE, 9600, list(map(finding, numbers[:31])))[1].line.repeaters is False
    assert propose(PLACE, 9600, list(map(finding, numbers[:32])))[1].line.repeaters is True


def test_parity_direction_and_socket_are_kept_and_late_drives_given_time() -> None:
    place = ProposedLine(
        "x", "socket://192.0.2.7:4001", "port", "adapter", "/tmp/x.sock", "/tmp/x.json"
    )
    _, roster = propose(place, 1200, [FoundDrive(11, 1200, "822x", True, "", late=True)])
    assert (roster.line.parity, roster.api.socket) == ("port", "/tmp/x.sock")
    assert roster.state == "/tmp/x.json"
    assert roster.drives[0].answer_time_s == 0.3


@given(st.text(max_size=30), st.text(max_size=30), st.sampled_from(FAMILY_NAMES))
def test_whatever_a_drive_says_stays_in_its_comment(label: str, why: str, name: str) -> None:
    one = FoundDrive(11, 9600, name, False, why, ((Code(200), label),), None, (label,))
    _, roster = propose(PLACE, 9600, [one])
    assert [drive.family for drive in roster.drives] == [name]


@pytest.mark.parametrize(
    "place", [ProposedLine("hall 3", "/dev/x"), ProposedLine("x", "COM1"), ProposedLine("", "/x")]
)
def test_a_name_or_port_no_roster_takes_is_refused_beforehand(place: ProposedLine) -> None:
    with pytest.raises(RosterError):
        check_place(place)
