"""Whether a drive runs, from what is known of it: every word that shows a stop is looked at."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lecombus.drive_state.motion import Doing, Lapse, Motion, learnt_setpoint, motion_of
from lecombus.drive_state.readings import WRITTEN_SINCE, ActiveFault, Quality, Reading
from lecombus.drives import family
from lecombus.drives.faults.fault_tables import FaultKind
from lecombus.parameters import Code, Value

ENABLED = "H0600"


def read(text: str, value: str, *, age_s: float = 0.5, quality: Quality = Quality.GOOD) -> Reading:
    code = Code.parse(text)
    wire = Value.hexadecimal(int(value[1:], 16), 4) if value[0] == "H" else Value.decimal(value)
    return Reading("d", code, "", None, None, wire, quality, None, 0.0, age_s)


def motion(
    name: str, *readings: Reading, fault: ActiveFault | None = None, lapse: Lapse | None = None
) -> Motion:
    known = {one.code: one for one in readings}
    kind = family(name)
    if kind.configured_by is not None:
        kind = kind.configured(1011)
    return motion_of(kind, fault, known.get, (), lapse)


@pytest.mark.parametrize(
    ("name", "words", "doing", "stops"),
    [
        ("8200vector", {"C0150": ENABLED, "C0050": "35.4"}, Doing.RUNNING, []),
        ("8200vector", {"C0150": ENABLED, "C0050": "0"}, Doing.ENABLED, []),
        ("8200vector", {"C0150": "H0640"}, Doing.ENABLED, []),
        ("8200vector", {"C0150": ENABLED}, Doing.RUNNING, []),
        ("8200vector", {"C0150": "H0680", "C0050": "0"}, Doing.STOPPED, ["inhibited"]),
        # No quick stop shows in C0150 there: the control word shows it.
        (
            "8200vector",
            {"C0150": ENABLED, "C0050": "35.4", "C0135": "H0008"},
            Doing.STOPPING,
            ["quick-stop"],
        ),
        (
            "8200vector",
            {"C0150": ENABLED, "C0050": "0", "C0135": "H0008"},
            Doing.STOPPED,
            ["quick-stop"],
        ),
        ("820x", {"C0150": ENABLED, "C0050": "0", "C0068": "H1100"}, Doing.STOPPED, ["quick-stop"]),
        (
            "820x",
            {"C0150": "H0680", "C0050": "20", "C0068": "H1000"},
            Doing.STOPPED,
            ["quick-stop", "inhibited"],
        ),
        ("smvector", {"C0150": ENABLED, "C0050": "9"}, Doing.RUNNING, []),
        (
            "smvector",
            {"C0150": ENABLED, "C0050": "0", "C0068": "H1000"},
            Doing.STOPPED,
            ["quick-stop"],
        ),
        # Its manual names no code for its speed: the status word says n = 0.
        ("93xx", {"C0150": "H0640"}, Doing.ENABLED, []),
        ("93xx", {"C0150": ENABLED}, Doing.RUNNING, []),
        ("93xx", {"C0150": "H0640", "C0135": "H0008"}, Doing.STOPPED, ["quick-stop"]),
        ("8200vector", {"C0150": "H0800", "C0050": "0"}, Doing.STOPPED, ["fault"]),
        ("8200vector", {"C0050": "20"}, Doing.UNKNOWN, []),
        ("generic", {"C0150": ENABLED}, Doing.UNKNOWN, []),
    ],
)
def test_what_a_drive_does_is_told_from_all_its_words(
    name: str, words: dict[str, str], doing: Doing, stops: list[str]
) -> None:
    seen = motion(name, *(read(code, value) for code, value in words.items()))
    assert (seen.doing, [one.name for one in seen.stops]) == (doing, stops)


def test_a_93xx_whose_configuration_is_not_known_does_not_say_whether_it_turns() -> None:
    seen = motion_of(family("93xx"), None, {Code(150): read("C0150", "H0640")}.get, ())
    assert (seen.doing, seen.zero) == (Doing.ENABLED, None)


def test_each_stop_is_told_with_the_words_that_show_it() -> None:
    seen = motion("820x", read("C0150", ENABLED), read("C0068", "H1100"), read("C0135", "H0008"))
    assert seen.stops[0].shown_by == ("C0068 reads H1100", "C0135 reads H0008")


def test_an_old_word_does_not_contradict_a_fresh_one() -> None:
    old = read("C0068", "H1100", age_s=40.0, quality=Quality.STALE)
    fresh = read("C0150", ENABLED)
    running = read("C0050", "20")
    assert motion("820x", fresh, old, running).stops == ()
    denied = read("C0068", "H0100", age_s=50.0, quality=Quality.STALE)
    inhibit = read("C0040", "0", age_s=40.0, quality=Quality.STALE)
    assert motion("8200vector", read("C0150", "H0640"), denied, inhibit).doing is Doing.ENABLED
    written = replace(read("C0135", "H0008", quality=Quality.BAD), reason=WRITTEN_SINCE)
    silent = replace(fresh, quality=Quality.STALE, age_s=30.0)
    last = motion("820x", silent, old, written)
    assert (last.stale, last.age_s) == (True, 40.0)
    assert last.stops[0].shown_by == ("C0068 reads H1100",)


@pytest.mark.parametrize("quality", [Quality.STALE, Quality.BAD])
@pytest.mark.parametrize(
    ("name", "code", "value"),
    [
        ("8200vector", "C0135", "H0008"),
        ("93xx", "C0135", "H0008"),
        ("821x", "C0135", "H0008"),
        ("821x", "C0068", "H1140"),
    ],
)
def test_a_drive_is_not_called_enabled_when_the_word_that_showed_its_quick_stop_is_old(
    name: str, code: str, value: str, quality: Quality
) -> None:
    status = read("C0150", "H0640")
    seen = motion(name, status, read(code, value, age_s=31.0, quality=quality))
    assert (seen.doing, seen.stale, seen.age_s) == (Doing.UNKNOWN, True, 31.0)
    assert [one.shown_by for one in seen.stops] == [(f"{code} reads {value}",)]
    released = "H0000" if code == "C0135" else "H0140"
    told = motion(name, status, read(code, released, age_s=31.0, quality=quality))
    assert (told.doing, told.stops, told.stale) == (Doing.ENABLED, (), False)


def test_an_old_quick_stop_is_overtaken_by_a_fresh_word_that_would_show_it() -> None:
    command = read("C0135", "H0008", age_s=31.0, quality=Quality.STALE)
    for name, doing in (("821x", Doing.ENABLED), ("8200vector", Doing.UNKNOWN)):
        seen = motion(name, read("C0150", "H0640"), read("C0068", "H0140"), command)
        assert seen.doing is doing


@pytest.mark.parametrize(
    ("words", "doing", "shown"),
    [
        # C0150 is read every second, C0068 every ten: the newer one tells whether it is inhibited.
        ([("C0150", "H8600", 0.6), ("C0068", "H0040", 9.6)], Doing.RUNNING, ()),
        ([("C0150", "H8680", 0.6), ("C0068", "H0140", 9.6)], Doing.STOPPED, ("C0150",)),
        ([("C0150", "H8600", 0.6), ("C0068", "H0040", 0.1)], Doing.STOPPED, ("C0068",)),
        ([("C0150", "H8680", 0.6), ("C0068", "H0140", 0.1)], Doing.RUNNING, ()),
        # An old command does not outvote it either, and an open command denies no stop.
        ([("C0150", "H8600", 0.6), ("C0040", "0", 5.0)], Doing.RUNNING, ()),
        ([("C0150", "H8680", 0.6), ("C0040", "1", 0.1)], Doing.STOPPED, ("C0150",)),
        # C0150 says nothing of a quick stop, nor does the command of one by terminal.
        (
            [("C0150", "H8600", 0.6), ("C0068", "H1140", 9.6), ("C0135", "H0000", 0.1)],
            Doing.STOPPING,
            ("C0068",),
        ),
        (
            [("C0150", "H8600", 0.6), ("C0068", "H0140", 0.3), ("C0135", "H0008", 5.0)],
            Doing.RUNNING,
            (),
        ),
    ],
)
def test_the_newest_word_that_can_tell_of_a_stop_decides(
    words: list[tuple[str, str, float]], doing: Doing, shown: tuple[str, ...]
) -> None:
    readings = [read(code, value, age_s=age_s) for code, value, age_s in words]
    seen = motion("821x", *readings, read("C0050", "10", age_s=0.2))
    assert seen.doing is doing
    assert tuple(said[:5] for one in seen.stops for said in one.shown_by) == shown


def test_a_first_word_older_than_a_command_tells_nothing() -> None:
    before = replace(read("C0150", "H8680"), quality=Quality.BAD, reason=WRITTEN_SINCE)
    seen = motion("821x", before, read("C0050", "10"))
    assert (seen.doing, seen.stops, seen.stale) == (Doing.UNKNOWN, (), False)
    assert seen.speed is not None


def test_a_speed_that_is_old_does_not_say_that_the_motor_runs() -> None:
    old = read("C0050", "35.4", age_s=40.0, quality=Quality.STALE)
    seen = motion("8200vector", read("C0150", "H0640"), old)
    assert seen.doing is not Doing.RUNNING
    assert seen.speed is not None
    assert seen.speed.as_json()["stale"] is True


def test_a_trip_is_told_with_its_number_and_once() -> None:
    known = family("8200vector").fault(50)
    trip = ActiveFault(FaultKind.TRIP, 50, known, 0.0, "C0150 reads H0898")
    seen = motion("8200vector", read("C0150", "H0898"), fault=trip)
    assert [one.text for one in seen.stops] == ["trip OH (50): heat sink too hot", "inhibited"]
    warning = replace(trip, kind=FaultKind.WARNING)
    assert motion("8200vector", read("C0150", ENABLED), fault=warning).stops == ()


def test_the_setpoint_known_last_counts_whether_it_was_read_or_written() -> None:
    vector = family("8200vector")
    known = {Code(150): read("C0150", ENABLED), Code(46): read("C0046", "20", age_s=5.0)}
    newer, older = read("C0046", "35.4", age_s=1.0), read("C0046", "7", age_s=9.0)

    def setpoint(*written: Reading) -> tuple[object, ...]:
        found = motion_of(vector, None, known.get, written).setpoint
        assert found is not None
        told = found.as_json()
        return str(told["value"]), told["unit"], told["known_by"]

    assert setpoint() == ("20", "Hz", "read")
    assert setpoint(newer) == ("35.4", "Hz", "written")
    assert setpoint(older) == ("20", "Hz", "read")


@pytest.mark.parametrize(
    ("name", "code"),
    [("8200vector", "C0046"), ("820x", "C0046"), ("93xx", "C0141"), ("smvector", "C0046")],
)
def test_the_setpoint_of_every_family_can_be_learnt(name: str, code: str) -> None:
    assert learnt_setpoint(family(name)) == Code.parse(code)


def test_a_device_of_which_nothing_is_described_has_no_setpoint() -> None:
    assert learnt_setpoint(family("generic")) is None


RUNS, STANDS, QUICK_STOP = ("C0050", "35.4", 0.1), ("C0050", "0", 0.1), ("C0135", "H0008", 0.1)


@pytest.mark.parametrize(
    ("name", "words", "may_quick_stop", "doing", "stops"),
    [
        # No status word shows the quick stop that a watchdog may have set, whatever C0135 reads.
        ("8200vector", [("C0150", ENABLED, 0.1), STANDS], True, Doing.UNKNOWN, ["watchdog"]),
        (
            "8200vector",
            [("C0150", ENABLED, 0.1), STANDS, ("C0135", "H0000", 0.1)],
            True,
            Doing.UNKNOWN,
            ["watchdog"],
        ),
        ("93xx", [("C0150", "H0640", 0.1)], True, Doing.UNKNOWN, ["watchdog"]),
        ("8200vector", [("C0150", ENABLED, 0.1), STANDS, QUICK_STOP], True, Doing.STOPPED,
         ["quick-stop"]),
        ("8200vector", [("C0150", ENABLED, 0.1), STANDS], False, Doing.ENABLED, []),
        ("8200vector", [("C0150", ENABLED, 0.1), RUNS], True, Doing.RUNNING, []),
        # C0068 shows one, but only where it was read since.
        ("821x", [("C0150", ENABLED, 0.1), STANDS, ("C0068", "H0140", 9.0)], True, Doing.UNKNOWN,
         ["watchdog"]),
        ("821x", [("C0150", ENABLED, 0.1), STANDS, ("C0068", "H0140", 0.9)], True, Doing.ENABLED,
         []),
        # What was read before says nothing of an inhibit or a trip either.
        ("821x", [("C0150", ENABLED, 1.5), STANDS], False, Doing.UNKNOWN, ["watchdog"]),
        ("821x", [("C0150", ENABLED, 0.1), ("C0050", "35.4", 1.5)], False, Doing.UNKNOWN,
         ["watchdog"]),
        ("821x", [("C0150", "H0680", 1.5), STANDS], False, Doing.STOPPED, ["inhibited"]),
    ],
)  # fmt: skip
def test_after_a_lapse_only_words_that_were_read_since_show_an_enabled_drive(
    name: str,
    words: list[tuple[str, str, float]],
    may_quick_stop: bool,
    doing: Doing,
    stops: list[str],
) -> None:
    readings = [read(code, value, age_s=age_s) for code, value, age_s in words]
    seen = motion(name, *readings, lapse=Lapse(1.0, may_quick_stop=may_quick_stop))
    assert (seen.doing, [one.name for one in seen.stops]) == (doing, stops)


@pytest.mark.parametrize(
    ("settings", "shown"),
    [
        ({Code(127): "0"}, ("20", "Hz")),
        ({Code(127): "1"}, ("0", "%")),
        ({}, ("0", "%")),  # what the drive obeys is not known: the one that was read last
        ({Code(127): "0", Code(2127): "1"}, ("20", "Hz")),  # C0150 says that set 1 is in use
    ],
)
def test_only_the_setpoint_that_the_drive_obeys_is_shown(
    settings: dict[Code, str], shown: tuple[str, str]
) -> None:
    """A backup or a read of C0141 does not put it in the place of the setpoint in Hz."""
    known = {
        Code(150): read("C0150", "H8600"),
        Code(46): read("C0046", "20", age_s=5.0),
        Code(141): read("C0141", "0", age_s=1.0),
    } | {code: read(str(code), text) for code, text in settings.items()}
    setpoint = motion_of(family("821x"), None, known.get, ()).setpoint
    assert setpoint is not None
    told = setpoint.as_json()
    assert (str(told["value"]), told["unit"]) == shown


@pytest.mark.parametrize("name", ["820x", "821x"])
def test_a_read_of_another_setpoint_does_not_hide_the_one_that_was_written_last(name: str) -> None:
    """An 820X has no setting that decides between its two; of an 821X it may not be known."""
    known = {Code(141): read("C0141", "0", age_s=1.0)}
    written = [read("C0141", "50", age_s=60.0), read("C0046", "20", age_s=30.0)]
    setpoint = motion_of(family(name), None, known.get, written).setpoint
    assert setpoint is not None
    told = setpoint.as_json()
    assert (str(told["value"]), told["unit"]) == ("20", "Hz")
