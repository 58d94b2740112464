"""What a verb comes to, given what is known of a drive: steps, or a refusal."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal

import pytest

from lecombus.drives import FAMILY_NAMES, Verb, family
from lecombus.drives.speeds import speed_step
from lecombus.drives.verb_facts import Known
from lecombus.drives.verb_rules import BitsStep, InhibitStep, RestartStep, WriteStep
from lecombus.drives.verbs import (
    enable_steps,
    fault_number,
    further_questions,
    has_fault,
    is_enabled,
    questions,
    reset_steps,
    states,
)
from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
LATER_82XX = ["821x", "822x", "824x", "8200vector"]
WORD, STATUS, ENABLE = Code(135), Code(150), Code(40)
UNSEEN = ["8200vector", "93xx"]
"""Families in which no status word shows a quick stop."""

SETTINGS = {
    "820x": {1: "3", 11: "50"},
    "821x": {1: "3", 11: "50", 127: "0"},
    "822x": {1: "3", 11: "50", 127: "0"},
    "824x": {1: "3", 11: "50", 127: "0"},
    "8200vector": {1: "3", 11: "50"},
    "93xx": {5: "1011"},
    "smvector": {1420: "3", 1103: "60"},
}
FAULT = {"820x": "H0180", "smvector": "H0180"}


def known(name: str, word: str = "H0000", status: str = "", **settings: str) -> Known:
    """A drive as its settings (`c1="0"` changes C0001) and words describe it; it runs."""
    status = status or ("H0000" if name in ("820x", "smvector") else "H0600")
    values = {Code(number): Value.parse(text) for number, text in SETTINGS.get(name, {}).items()}
    values |= {WORD: Value.parse(word), STATUS: Value.parse(status)}
    for key, text in settings.items():
        code = Code.parse(key[1:].replace("_", "/"))
        if text:
            values[code] = Value.parse(text)
        else:
            values.pop(code, None)
    return Known("belt", family(name), values)


def refused(given: Known, verb: Verb, number: str = "10", unit: str = "Hz") -> OperationError:
    acts: dict[Verb, Callable[[], object]] = {
        Verb.ENABLE: lambda: enable_steps(given),
        Verb.RESET_FAULT: lambda: reset_steps(given),
        Verb.SET_SPEED: lambda: speed_step(given, Decimal(number), unit),
    }
    with pytest.raises(OperationError) as caught:
        acts[verb]()
    assert caught.value.drive == "belt"
    assert caught.value.remedy
    return caught.value


def speed(given: Known, number: str, unit: str) -> tuple[int, str]:
    step = speed_step(given, Decimal(number), unit)
    return step.code.number, step.value.raw


# ---- enable ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DESCRIBED)
def test_enable_releases_quick_stop_and_inhibit_and_leaves_other_bits(name: str) -> None:
    steps = enable_steps(known(name, "H120C", "H0080"))
    release = BitsStep(WORD, clear_mask=0x0208, always=name in UNSEEN)
    assert steps == (release, WriteStep(ENABLE, Value.decimal(1)))
    assert isinstance(steps[0], BitsStep)
    assert steps[0].applied(0x120C) == 0x1004


@pytest.mark.parametrize("name", DESCRIBED)
def test_enable_writes_only_what_keeps_the_drive_still(name: str) -> None:
    release = BitsStep(WORD, clear_mask=0x0208, always=name in UNSEEN)
    # A quick stop of the watchdog that no word shows is released in any case.
    unseen = (release,) if name in UNSEEN else ()
    assert enable_steps(known(name)) == unseen
    quick_stopped = known(name, "H0008")
    assert enable_steps(quick_stopped) == (release,)
    # Only a change may lift it: it is set first, unless the motor may turn.
    changed = (BitsStep(WORD, set_mask=0x0008), release) if name in UNSEEN else ()
    at_zero = "H0040" if name in ("820x", "smvector") else "H0640"
    assert enable_steps(known(name, "H0000", at_zero)) == changed
    inhibited = known(name, "H0000", "H0080")
    assert enable_steps(inhibited) == (*changed, WriteStep(ENABLE, Value.decimal(1)))


@pytest.mark.parametrize("name", [one for one in DESCRIBED if one not in UNSEEN])
def test_a_quick_stop_that_only_the_status_shows_is_set_and_released_by_the_control_word(
    name: str,
) -> None:
    stopped = known(name, "H0004", c68="H1100")
    assert not is_enabled(stopped)
    first, second = enable_steps(stopped)
    assert (first, second) == (
        BitsStep(WORD, set_mask=0x0008), BitsStep(WORD, clear_mask=0x0208)
    )  # fmt: skip
    closed = {"smvector": {"c1420": "2"}}.get(name, {"c1": "0"})
    assert refused(known(name, "H0004", c68="H1100", **closed), Verb.ENABLE).kind == "setting"


@pytest.mark.parametrize("name", [one for one in DESCRIBED if one != "smvector"])
def test_every_word_that_shows_an_inhibit_counts(name: str) -> None:
    for more in ({"c68": "H0000"}, {"c40": "0"}):
        given = known(name, **more)
        assert not is_enabled(given), more
        assert enable_steps(given)[-1] == WriteStep(ENABLE, Value.decimal(1))
    assert is_enabled(known(name, c68="H0100", c40="1"))
    assert not is_enabled(known(name, "H0200"))


@pytest.mark.parametrize("status", ["H0000", "H0100", "H0300"])
@pytest.mark.parametrize("name", LATER_82XX)
def test_a_controller_status_that_keeps_it_still_is_not_enabled(name: str, status: str) -> None:
    assert not is_enabled(known(name, status=status))


@pytest.mark.parametrize("name", DESCRIBED)
def test_a_drive_with_a_fault_is_not_enabled(name: str) -> None:
    error = refused(known(name, "H0208", FAULT.get(name, "H0880")), Verb.ENABLE)
    assert error.kind == "fault-active"
    assert "reset-fault belt" in error.remedy
    assert "lecombus why belt" in error.remedy


@pytest.mark.parametrize(
    ("name", "setting", "code", "remedy"),
    [
        ("820x", {"c1": "0"}, "C0001", "C0001 = 3"),
        ("821x", {"c1": "1"}, "C0001", "C0001 = 3"),
        ("8200vector", {"c1": "2"}, "C0001", "C0001 = 3"),
        ("93xx", {"c5": "1000"}, "C0005", "1011"),
        ("smvector", {"c1420": "2"}, "C1420", "P420 = 3"),
        ("smvector", {"c1100": "5"}, "C1100", "remote keypad"),
        ("smvector", {"c1420": "0"}, "C1420", "P420 = 3"),
    ],
)
def test_a_quick_stop_the_settings_do_not_let_us_release_is_refused_with_the_setting(
    name: str, setting: dict[str, str], code: str, remedy: str
) -> None:
    error = refused(known(name, "H0008", **setting), Verb.ENABLE)
    assert (error.kind, error.code) == ("setting", code)
    assert remedy in error.remedy
    assert "nothing was sent" in str(error)


def test_82xx_is_enabled_by_c0040_whatever_c0001_is() -> None:
    given = known("821x", "H0200", "H0080", c1="0")
    assert enable_steps(given) == (WriteStep(ENABLE, Value.decimal(1)),)


def test_smvector_below_level_3_is_not_enabled_even_by_c0040() -> None:
    assert refused(known("smvector", "H0000", "H0080", c1420="2"), Verb.ENABLE).kind == "setting"


def test_a_control_word_that_is_none_is_not_changed() -> None:
    assert refused(known("821x", "Sabc"), Verb.ENABLE).kind == "no-control-word"
    assert refused(known("821x", c135=""), Verb.ENABLE).kind == "no-control-word"


@pytest.mark.parametrize("name", DESCRIBED)
def test_enabled_is_what_the_words_show(name: str) -> None:
    assert is_enabled(known(name))
    assert not is_enabled(known(name, "H0008"))
    assert not is_enabled(known(name, "H0000", "H0080"))
    assert not is_enabled(known(name, "H0000", FAULT.get(name, "H0800")))
    assert not is_enabled(known(name, c150=""))
    assert not is_enabled(known(name, c135=""))


def test_a_control_word_the_terminals_make_says_nothing_of_enabled() -> None:
    assert is_enabled(known("821x", "H0008", c1="0"))


# ---- reset-fault ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", DESCRIBED)
def test_without_a_fault_nothing_is_reset(name: str) -> None:
    assert reset_steps(known(name)) == ()


@pytest.mark.parametrize(
    ("name", "value"), [*((name, "0") for name in LATER_82XX), ("93xx", "0"), ("smvector", "1")]
)
def test_a_fault_is_reset_on_an_inhibited_drive(name: str, value: str) -> None:
    given = known(name, "H0000", FAULT.get(name, "H0800"), c43="1")
    assert reset_steps(given) == (InhibitStep(), WriteStep(Code(43), Value.parse(value)))


@pytest.mark.parametrize("name", [*LATER_82XX, "93xx", "smvector"])
def test_where_c0043_is_not_there_the_edge_of_bit_11_resets(name: str) -> None:
    steps = reset_steps(known(name, "H0804", FAULT.get(name, "H0800"), c43=""))
    word, words = 0x0804, []
    for step in steps[1:]:
        assert type(step) is BitsStep
        word = step.applied(word)
        words.append(word)
    assert steps[0] == InhibitStep()
    assert words == [0x0004, 0x0804, 0x0004], "an edge, and ready for the next one"


def test_820x_is_reset_by_an_enable_in_quick_stop_and_ends_inhibited() -> None:
    steps = reset_steps(known("820x", "H0004", "H0100"))
    assert [type(step) for step in steps] == [InhibitStep, BitsStep, RestartStep, InhibitStep]
    word = 0x0004
    for step in steps[1:3]:
        assert isinstance(step, BitsStep)
        word = step.applied(word)
    assert word == 0x000C, "enabled, and kept still by the quick stop"


def test_820x_under_its_terminals_is_not_reset_from_the_line() -> None:
    error = refused(known("820x", "H0000", "H0100", c1="0"), Verb.RESET_FAULT)
    assert (error.kind, error.code) == ("setting", "C0001")


def test_smvector_below_level_3_is_not_reset() -> None:
    error = refused(known("smvector", status="H0100", c1420="1"), Verb.RESET_FAULT)
    assert error.code == "C1420"


@pytest.mark.parametrize(
    ("name", "memory"),
    [("820x", "c161"), ("821x", "c161"), ("93xx", "c168_1"), ("smvector", "c1500")],
)
def test_the_fault_is_named_by_its_memory(name: str, memory: str) -> None:
    assert fault_number(known(name, **{memory: "11"})) == 11
    assert fault_number(known(name, **{memory: "0"})) is None
    assert Code.parse(memory[1:].replace("_", "/")) in questions(
        "belt", family(name), Verb.RESET_FAULT
    )


# ---- set-speed ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "number", "unit", "written"),
    [
        ("820x", "35.4", "Hz", (46, "35.4")),
        ("820x", "70.25", "%", (141, "70.25")),
        ("821x", "50", "Hz", (46, "50")),
        ("821x", "35", "%", (46, "17.5")),
        ("8200vector", "33.33", "%", (46, "16.7")),
        ("93xx", "-35.5", "%", (141, "-35.5")),
        ("smvector", "42.5", "Hz", (1061, "42.5")),
        ("smvector", "50", "%", (1061, "30")),
        ("smvector", "0", "Hz", (1061, "0")),
    ],
)
def test_a_speed_goes_to_the_familys_own_code(
    name: str, number: str, unit: str, written: tuple[int, str]
) -> None:
    assert speed(known(name), number, unit) == written


def test_p102_is_the_least_an_smvector_takes() -> None:
    limited = known("smvector", c1102="5")
    assert speed(limited, "5", "Hz") == (1061, "5")
    assert "5 to 60 Hz" in refused(limited, Verb.SET_SPEED, "4.9", "Hz").remedy


SET_2 = "H0001"
"""C0150 with the second parameter set in use."""


@pytest.mark.parametrize(
    ("name", "status", "settings", "percent", "raw"),
    [
        ("821x", "H0000", {"c2011": "25"}, "50", "25"),
        ("821x", SET_2, {"c2011": "25"}, "50", "12.5"),
        ("822x", SET_2, {"c2011": "25"}, "100", "25"),
        ("821x", SET_2, {}, "50", "25"),  # it has no C2011: C0011 is that of all sets
        ("821x", "", {"c2011": "50"}, "50", "25"),  # the set does not matter
        ("8200vector", SET_2, {"c2011": "50", "c4011": "50", "c6011": "50.0"}, "50", "25"),
    ],
)
def test_percent_is_of_the_highest_frequency_of_the_parameter_set_in_use(
    name: str, status: str, settings: dict[str, str], percent: str, raw: str
) -> None:
    given = known(name, c150=status, **settings)
    assert speed(given, percent, "%") == (46, raw)


@pytest.mark.parametrize(
    ("name", "status", "settings"),
    [
        ("8200vector", "H0000", {"c2011": "25"}),
        ("8200vector", SET_2, {"c6011": "100"}),
        ("8200vector", "H0000", {"c4011": "0"}),
        ("821x", "", {"c2011": "25"}),
    ],
)
def test_percent_is_refused_where_the_set_in_use_is_not_known_and_they_differ(
    name: str, status: str, settings: dict[str, str]
) -> None:
    error = refused(known(name, c150=status, **settings), Verb.SET_SPEED, "50", "%")
    assert (error.kind, error.code) == ("setting", "C0011")
    assert "does not show which parameter set is in use" in str(error)
    assert "give the speed in Hz, or set C0011 alike in all parameter sets" in error.remedy


@pytest.mark.parametrize(
    ("name", "status", "settings", "most"),
    [
        ("821x", "H0000", {"c2011": "25"}, "50"),
        ("821x", SET_2, {"c2011": "25"}, "25"),
        ("821x", SET_2, {"c2011": "80"}, "80"),
        ("8200vector", "H0000", {"c2011": "25", "c4011": "80"}, "80"),
        ("820x", "H0000", {"c2011": "80"}, "80"),
    ],
)
def test_hertz_are_bounded_by_the_parameter_set_in_use_or_by_the_widest(
    name: str, status: str, settings: dict[str, str], most: str
) -> None:
    given = known(name, c150=status, **settings)
    assert speed(given, most, "Hz") == (46, most)
    error = refused(given, Verb.SET_SPEED, f"{most}.1", "Hz")
    assert f"it takes 0 to {most} Hz (C" in error.remedy


def test_820x_refers_percent_to_set_1_whatever_set_is_in_use() -> None:
    assert speed(known("820x", c2011="25"), "50", "%") == (141, "50")


def test_c0127_counts_in_the_parameter_set_in_use_where_the_drive_has_it_there() -> None:
    in_set_2 = {"c150": SET_2, "c2011": "25"}
    assert speed(known("821x", c127="0", c2127="1", **in_set_2), "10", "Hz") == (141, "40")
    assert speed(known("821x", c127="1", c2127="0", **in_set_2), "40", "%") == (46, "10")
    assert speed(known("821x", c127="1", **in_set_2), "10", "Hz") == (141, "40")


@pytest.mark.parametrize(
    ("name", "status", "asked"),
    [
        ("821x", "H0000", ()),
        ("821x", SET_2, (2011, 2127)),
        ("8200vector", "H0000", (2011, 4011, 6011)),
        ("820x", "H0000", (2011,)),
        ("93xx", "H0000", ()),
        ("smvector", "H0000", ()),
    ],
)
def test_only_the_sets_that_may_be_in_use_are_asked_further(
    name: str, status: str, asked: tuple[int, ...]
) -> None:
    codes = further_questions(known(name, status=status))
    assert tuple(sorted(code.number for code in codes)) == asked


def test_c0127_decides_between_hertz_and_percent() -> None:
    normalized = known("822x", c127="1")
    assert speed(normalized, "-35", "%") == (141, "-35")
    assert speed(normalized, "20", "Hz") == (141, "40")
    assert refused(known("822x", c127="7"), Verb.SET_SPEED).code == "C0127"
    assert refused(known("822x", c127=""), Verb.SET_SPEED).remedy == "set C0127 = 0 or 1"


@pytest.mark.parametrize("name", ["820x", "821x", "822x", "824x", "8200vector"])
@pytest.mark.parametrize(
    ("number", "unit", "written"),
    [("35.43", "Hz", "35.43"), ("0.0001", "Hz", "0.0001"), ("33.33", "%", "16.7")],
)
def test_a_frequency_without_a_step_in_the_manual_is_taken_as_given(
    name: str, number: str, unit: str, written: str
) -> None:
    """Only a converted one is rounded, to the one decimal place of the manual's example."""
    step = speed_step(known(name), Decimal(number), unit)
    assert isinstance(step, WriteStep)
    assert "in steps of" not in refused(known(name), Verb.SET_SPEED, "9999", "Hz").remedy
    if (name, unit) != ("820x", "%"):  # which takes a percentage as it is, by C0141
        assert (step.code, step.value.raw) == (Code(46), written)


@pytest.mark.parametrize(
    ("name", "number", "unit", "told"),
    [
        ("821x", "50.1", "Hz", "0 to 50 Hz (C0011 = 50 Hz)"),
        ("821x", "101", "%", "0 to 50 Hz"),
        ("821x", "-1", "Hz", "direction of rotation is bit 2 of C0135"),
        ("821x", "35", "rpm", "0 to 50 Hz"),
        ("820x", "100.1", "%", "0 to 100 %"),
        ("93xx", "35", "Hz", "-100 to 100 %"),
        ("93xx", "-100.01", "%", "-100 to 100 %"),
        ("smvector", "60.1", "Hz", "0 to 60 Hz (P103 = 60 Hz)"),
        ("smvector", "30.05", "Hz", "in steps of 0.1"),
        ("8200vector", "30.00001", "Hz", "0 to 50 Hz"),
        ("821x", "30.00001", "Hz", "0 to 50 Hz"),
        ("smvector", "1E+29", "%", "0 to 60 Hz"),
    ],
)
def test_a_speed_of_the_wrong_unit_or_range_is_refused_with_the_range(
    name: str, number: str, unit: str, told: str
) -> None:
    error = refused(known(name), Verb.SET_SPEED, number, unit)
    assert error.kind == "bad-value"
    assert told in error.remedy


@pytest.mark.parametrize(
    ("name", "setting", "remedy"),
    [
        ("820x", {"c1": "0"}, "C0001 = 3"),
        ("8200vector", {"c1": "1"}, "C0001 = 3"),
        ("93xx", {"c5": "1000"}, "1011"),
        ("93xx", {"c5": "4001"}, "only there"),
        ("smvector", {"c1420": "1"}, "P420 = 2"),
    ],
)
def test_a_setpoint_the_drive_would_not_follow_is_refused_with_the_setting(
    name: str, setting: dict[str, str], remedy: str
) -> None:
    error = refused(known(name, **setting), Verb.SET_SPEED, "10", "%")
    assert error.kind == "setting"
    assert remedy in error.remedy


@pytest.mark.parametrize("name", DESCRIBED)
def test_a_setpoint_behind_a_jog_value_is_refused(name: str) -> None:
    error = refused(known(name, "H0002"), Verb.SET_SPEED, "10", "%")
    assert (error.kind, error.code) == ("setting", "C0135")
    assert "JOG value 2" in str(error)


def test_free_bits_of_93xx_are_no_jog_values() -> None:
    assert speed(known("93xx", "H0002", c5="6001"), "10", "%") == (141, "10")


# ---- all of them ----------------------------------------------------------------------------


def test_a_setting_the_drive_does_not_have_objects_to_nothing() -> None:
    assert speed(known("8200vector", c1="", c11=""), "480", "Hz") == (46, "480")


@pytest.mark.parametrize("verb", [Verb.ENABLE, Verb.SET_SPEED, Verb.RESET_FAULT])
def test_a_device_nobody_describes_has_no_verbs(verb: Verb) -> None:
    with pytest.raises(OperationError, match="family generic") as caught:
        questions("g", family("generic"), verb)
    assert caught.value.kind == "no-verb"


@pytest.mark.parametrize("name", DESCRIBED)
def test_states_are_what_the_words_show(name: str) -> None:
    assert "inhibited" in states(known(name, "H0000", "H0080"))
    assert "quick_stop" in states(known(name, "H0008", "H0000"))
    assert "quick_stop" not in states(known(name))
    fault = known(name, status=FAULT.get(name, "H0880"))
    assert {"fault", "inhibited"} <= set(states(fault))
    assert has_fault(fault)
    assert states(known(name, "H0008", c150="")) == (), "a command alone says nothing of a fault"


def test_the_signal_configuration_of_93xx_decides_what_its_words_show() -> None:
    assert "homed" in states(known("93xx", status="H0004", c5="5001"))
    assert "homed" not in states(known("93xx", status="H0004", c5="1001"))


@pytest.mark.parametrize("name", DESCRIBED)
@pytest.mark.parametrize("verb", [Verb.ENABLE, Verb.SET_SPEED, Verb.RESET_FAULT])
def test_what_a_verb_needs_to_know_is_asked_for_once(name: str, verb: Verb) -> None:
    asked = questions("belt", family(name), verb)
    assert len(set(asked)) == len(asked)
    assert WORD in asked
    assert set(map(Code, SETTINGS[name])) - {Code(11), Code(127), Code(1103)} <= set(asked)
