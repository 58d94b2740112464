"""What a person can tell a running simulator, and what is said to nonsense."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from lecombus.fieldbus.lecom.simulator import (
    Control,
    ControlError,
    ControlSocket,
    SimLine,
    build,
    send_to_simulator,
)
from support.golden import Golden

pytestmark = pytest.mark.clock

ROOT = Path(__file__).parent.parent.parent


class Plug:
    """An end that notes what happens to it."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def unplug(self) -> None:
        self.said.append("unplug")

    def replug(self) -> None:
        self.said.append("replug")


@pytest.fixture
def line() -> SimLine:
    drives = [("feeder", 11, "8200vector"), ("belt", 12, "smvector"), ("servo", 13, "93xx")]
    return build(drives, baud=9600)


@pytest.fixture
def plug() -> Plug:
    return Plug()


@pytest.fixture
def control(line: SimLine, plug: Plug) -> Control:
    return Control(line, threading.RLock(), plug)


def test_every_command_is_in_the_help(control: Control) -> None:
    lines = control.do("help").splitlines()
    assert len(lines) == 18
    assert control.do("help trip") == next(one for one in lines if one.startswith("trip"))


def test_the_documentation_has_every_command_and_no_other(control: Control) -> None:
    rows = (ROOT / "docs" / "simulator.md").read_text().partition("|---|---|")[2].splitlines()
    cells = [row.replace("\\|", "/").split("|")[1] for row in rows if row.startswith("|")]
    told = [form.split()[0] for cell in cells for form in cell.replace("`", "").split(", ")]
    assert sorted(set(told)) == sorted(
        {line.split()[0] for line in control.do("help").splitlines()}
    )


@pytest.mark.parametrize("drive", ["feeder", "11"])
def test_a_fault_occurs_and_its_cause_goes(control: Control, line: SimLine, drive: str) -> None:
    assert control.do(f"trip {drive} 50 stays").endswith("TRIP 50")
    model = line["feeder"].model
    model.reset_fault()
    assert model.fault == 50
    control.do(f"clear {drive}")
    model.reset_fault()
    assert model.fault == 0


def test_a_terminal_opens_and_closes(control: Control, line: SimLine) -> None:
    line["feeder"].model.preset(135, "H0000")
    assert "inhibited" in control.do("terminal feeder open")
    assert "enabled, at 0 Hz" in control.do("terminal feeder closed")
    assert "at 0 min-1" in control.do("drives").splitlines()[2]


def test_values_are_set_as_at_the_keypad(control: Control, line: SimLine) -> None:
    assert control.do("set belt P494 1.30") == "belt C1494: 1.30"
    assert control.do("set belt P420 0") == "belt C1420: 0"
    assert control.do("set feeder C0200 82S8212V_31000") == "feeder C0200: S82S8212V_31000"
    assert control.do("set servo C0039/2 12.5") == "servo C0039/2: 12.5"
    assert control.do("get servo 39/2") == "servo C0039/2: 12.5"
    assert line["feeder"].wear == 0


def test_a_swapped_drive_has_the_codes_given(control: Control, line: SimLine) -> None:
    before = line["feeder"]
    said = control.do("swap feeder family=821x C0200=33S8211E_21000 'C0201=17 March'")
    assert "821x" in said
    assert "answers in 10 s" in said
    silent_s = line["feeder"].model.deaf_until_s - time.monotonic()
    assert 5.0 < silent_s <= 10.0, "nobody changes drives faster"
    assert line["feeder"] is not before
    assert line["feeder"].text(200) == "S33S8211E_21000"
    assert line["feeder"].text(201) == "S17 March"


def test_a_swap_that_cannot_be_leaves_the_old_drive(control: Control, line: SimLine) -> None:
    before = line["feeder"]
    for words in ("family=822y", "C0200=x C0012=1301", "C4711=1", "C0200"):
        with pytest.raises(ControlError):
            control.do(f"swap feeder {words}")
    assert line["feeder"] is before
    assert before.text(200) == "S82S8212V_30000"


def test_a_drive_goes_and_comes_back(control: Control, line: SimLine) -> None:
    control.do("absent feeder")
    assert not line["feeder"].present
    assert "absent" in control.do("drives")
    control.do("present feeder")
    assert line["feeder"].present


def test_power_cycle_and_factory_reset(control: Control, line: SimLine) -> None:
    drive = line["feeder"]
    control.do("set feeder C0012 7")
    drive.model.preset(1923, "500")
    control.do("power-cycle feeder 100ms")
    assert (drive.text(12), drive.text(1923)) == ("7", "3000")
    control.do("factory-reset feeder")
    assert drive.text(12) == "5"


def test_the_plug_is_pulled_for_a_while_or_until_told(control: Control, plug: Plug) -> None:
    control.do("unplug 1ms")
    control.do("unplug")
    control.do("plug")
    assert plug.said == ["unplug", "replug", "unplug", "replug"]


def test_faults_of_the_line_are_switched(control: Control, line: SimLine) -> None:
    control.do("faults late=0.5,absent=12")
    assert (line.faults.late, line.faults.absent) == (0.5, {12})
    control.do("faults none")
    assert (line.faults.late, line.faults.absent) == (0.0, set())


def test_a_drive_is_looked_at(control: Control, line: SimLine) -> None:
    line["feeder"].model.params.keep(line["feeder"].model.params.find(12, 0), "7")
    assert control.do("wear feeder").splitlines()[1] == "C0012: 1"
    assert "fault memory        empty" in control.do("show feeder")
    assert "heard nothing" in control.do("log feeder")


@pytest.mark.parametrize(
    "text",
    [
        "jump",
        "help jump",
        "trip feeder",
        "trip feedr 50",
        "trip feeder 5x",
        "trip feeder 37",
        "trip feeder 50 always",
        "power-cycle feeder 3",
        "terminal feeder ajar",
        "set feeder X12 7",
        "set feeder C0012 1301",
        "set feeder C0050 7",
        "get feeder C4711",
        "faults late=2",
        "faults absent=77",
        "faults trip=11:50",
        "trip 'feeder 50",
        "log feeder x",
        "unplug x",
    ],
)
def test_nonsense_is_answered_with_what_would_be_right(
    control: Control, text: str, golden: Golden
) -> None:
    with pytest.raises(ControlError) as caught:
        control.do(text)
    golden(caught.value)


def test_an_empty_line_does_nothing(control: Control) -> None:
    assert control.do("  ") == ""


def test_a_simulator_is_told_through_its_socket(control: Control, tmp_path: Path) -> None:
    path = tmp_path / "s"
    with ControlSocket(path, control.do):
        assert path.stat().st_mode & 0o777 == 0o600
        assert send_to_simulator(path, "trip feeder 50").endswith("TRIP 50")
        with pytest.raises(ControlError, match="there is no `jump`"):
            send_to_simulator(path, "jump")
        with pytest.raises(OSError, match="in use"):
            ControlSocket(path, control.do)
        assert send_to_simulator(path, "drives"), "the first still serves"
    assert not path.exists()
    with pytest.raises(FileNotFoundError):
        send_to_simulator(path, "drives")


def test_what_a_dead_simulator_left_is_replaced(control: Control, tmp_path: Path) -> None:
    path = tmp_path / "s"
    with ControlSocket(path, control.do):
        path.rename(tmp_path / "left")
    with ControlSocket(tmp_path / "left", control.do):
        assert send_to_simulator(tmp_path / "left", "drives")
