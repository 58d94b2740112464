"""The master's names for states and faults against what the simulated drives really do.

Whatever the words of a drive say through the master's description must be what the drive is doing,
whichever way it came there.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.drives import FAMILY_NAMES, family
from lecombus.drives.faults.fault_tables import FaultKind
from lecombus.drives.words import OperatingState
from lecombus.fieldbus.lecom.simulator import SimDrive
from lecombus.fieldbus.lecom.simulator.model import INHIBIT, QSP, Model
from lecombus.fieldbus.lecom.simulator.troubles import Kind
from lecombus.parameters import Code

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
KINDS = {
    Kind.TRIP: FaultKind.TRIP, Kind.MESSAGE: FaultKind.MESSAGE, Kind.WARNING: FaultKind.WARNING,
}  # fmt: skip
SETPOINT = {"93xx": 141, "smvector": 1061}
RAMP = {"93xx": (12, 13, 105), "smvector": (1104, 1105)}

OPERATING_STATUS = Code(68)

TRUTH: dict[OperatingState, Callable[[Model], bool]] = {
    OperatingState.READY: lambda model: not (model.fault or model.troubles.message),
    OperatingState.INHIBITED: lambda model: model.inhibited(),
    OperatingState.OPERATION_INHIBITED: lambda model: (
        model.inhibited() and not model.fault and not model.troubles.message
    ),
    OperatingState.ENABLED: lambda model: not model.pulses_off(),
    OperatingState.QUICK_STOP: lambda model: bool(model.control & QSP),
    OperatingState.PULSES_INHIBITED: lambda model: model.pulses_off(),
    OperatingState.FAULT: lambda model: bool(model.fault),
    OperatingState.MESSAGE: lambda model: bool(model.troubles.message),
    OperatingState.AT_SETPOINT: lambda model: (
        model.motor.powered and model.motor.speed == model.motor.target
    ),
    OperatingState.POWER_OFF: lambda model: False,
    OperatingState.INITIALISING: lambda model: False,
}
"""What some states mean in a simulated drive; the others have no single truth to hold against."""


def words_of(name: str, drive: SimDrive) -> list[tuple[Code, int]]:
    return [(code, int(drive.text(code.number)[1:], 16)) for code in family(name).words]


def check(name: str, drive: SimDrive) -> None:
    described = family(name)
    if described.configured_by is not None:
        described = described.configured(int(drive.text(described.configured_by.number)))
    for code, word in words_of(name, drive):
        info = described.words[code]
        told = {rule.state for rule in info.states} & set(TRUTH)
        if drive.model.fault:
            # Where only the controller status has it, the fault stands in its place.
            told.discard(OperatingState.MESSAGE)
        shown = set(info.shown_states(word)) & told
        true = {state for state in told if TRUTH[state](drive.model)}
        if code == OPERATING_STATUS and OperatingState.ENABLED in told and drive.model.pulses_off():
            # Bit 8 is the controller enable, which a fault does not take away.
            true |= set() if drive.model.inhibited() else {OperatingState.ENABLED}
        assert shown == true, (str(code), word)


@pytest.mark.parametrize("name", DESCRIBED)
def test_both_know_the_same_faults_and_their_kinds(name: str) -> None:
    table = family(name).fault_table
    assert table is not None
    kinds = SimDrive(11, name).model.fault_kinds
    found = {number: table.fault(number) for number in kinds}
    described = {number: one.kind for number, one in found.items() if one is not None}
    assert described == {number: KINDS[kind] for number, kind in kinds.items()}
    if not table.thousands:
        assert set(table.faults) == set(kinds)


@pytest.mark.parametrize("name", DESCRIBED)
def test_every_fault_shows_as_what_it_is(name: str) -> None:
    described = family(name)
    for number, kind in SimDrive(11, name).model.fault_kinds.items():
        drive = SimDrive(11, name)
        drive.trip(number)
        shown = {described.shown_fault(code, word) for code, word in words_of(name, drive)}
        assert (FaultKind.TRIP in shown) == (kind is Kind.TRIP), number
        check(name, drive)


@pytest.mark.parametrize("configuration", ["1001", "1011", "4001", "5001", "6001", "7001"])
def test_a_93xx_is_understood_in_every_configuration(configuration: str) -> None:
    drive = SimDrive(11, "93xx", overrides={5: configuration, 12: "0", 141: "50"})
    now_s = 0.0
    for control in (0x0008, 0x0000, 0x0200, 0x0000):
        drive.model.preset(135, f"H{control:04X}")
        now_s += 1.0
        drive.advance(now_s)
        check("93xx", drive)


ACTIONS = st.lists(
    st.one_of(
        st.tuples(st.just("control"), st.sampled_from([0, QSP, INHIBIT, QSP | INHIBIT, 0x0004])),
        st.tuples(st.just("terminal"), st.booleans()),
        st.tuples(st.just("fault"), st.integers(0, 99)),
        st.tuples(st.just("clear"), st.none()),
        st.tuples(st.just("reset"), st.none()),
        st.tuples(st.just("wait"), st.floats(0.0, 3.0)),
    ),
    max_size=12,
)


@pytest.mark.parametrize("name", DESCRIBED)
@settings(max_examples=40, deadline=None)
@given(actions=ACTIONS)
def test_words_tell_the_truth_however_a_drive_came_there(
    name: str, actions: list[tuple[str, object]]
) -> None:
    ramps = dict.fromkeys(RAMP.get(name, (12, 13, 105)), "1")
    drive = SimDrive(11, name, overrides={SETPOINT.get(name, 46): "30", **ramps})
    numbers = sorted(drive.model.fault_kinds)
    now_s = 0.0
    drive.advance(now_s)
    for action, value in actions:
        if action == "control":
            assert isinstance(value, int)
            drive.model.preset(135, f"H{value:04X}") if name != "820x" else _steer(drive, value)
        elif action == "terminal":
            drive.set_terminal(high=bool(value))
        elif action == "fault":
            assert isinstance(value, int)
            drive.trip(numbers[value % len(numbers)])
        elif action == "clear":
            drive.clear_fault()
        elif action == "reset":
            drive.model.reset_fault()
        else:
            assert isinstance(value, float)
            now_s += value
            drive.advance(now_s)
        check(name, drive)


def _steer(drive: SimDrive, control: int) -> None:
    """Set an 820X's control word without the restart that inhibit and enable are for it."""
    drive.model.control = control
    drive.model.steer()
