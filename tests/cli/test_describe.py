"""`lecombus describe`, as typed: no daemon, no drive."""

from __future__ import annotations

import json

import pytest

from cli.conftest import Run
from lecombus.drives import FAMILY_NAMES, family


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_code_of_a_family_has_a_line(name: str, run: Run) -> None:
    ran = run("describe", name)
    assert (ran.status, ran.err) == (0, "")
    lines = [line.split("\t") for line in ran.out.splitlines()]
    assert [line[0] for line in lines] == [str(one.code) for one in family(name).described()]
    assert {len(line) for line in lines} <= {7}


def test_names_and_ranges_come_in_german(run: Run) -> None:
    out = run("describe", "821x", "--lang", "de").out
    assert "C0046\tFrequenzsollwert\tVD\t0 bis 480 Hz\tread write\tvolatile\t" in out
    assert "C1922\tÜberwachungsreaktion\tVD\t0 (nicht aktiv), 1 (Reglersperre), " in out


def test_one_code_is_told_with_its_selection(run: Run) -> None:
    rows = dict(line.split("\t") for line in run("describe", "820x", "C2001").out.splitlines())
    assert rows["value 3"] == "control: LECOM, setpoint: LECOM"
    assert (rows["parameter set"], rows["default"]) == ("2", "0")
    assert rows["access"] == "read write while inhibited"
    assert rows["source"] == "EDB2102EN 6.2.1; 8.2"


def test_words_follow_the_signal_configuration_asked_for(run: Run) -> None:
    def bits(*words: str) -> dict[str, str]:
        ran = run("describe", "93xx", "C0150", *words)
        return dict(line.split("\t") for line in ran.out.splitlines())

    assert bits()["bit 3"] == "free: its meaning is set in the drive"
    assert bits("--configuration", "5001")["bit 3"] == "torque_limit"
    assert bits("--configuration", "7001")["bit 3"] == "below_torque_limit"
    assert bits()["bit 1"] == "pulse_inhibit"


def test_a_control_word_says_what_each_level_means(run: Run) -> None:
    out = run("describe", "821x", "C0135").out
    assert "bit 3\tquick_stop: 0 quick stop not active, 1 quick stop active" in out
    assert "bits 0 to 1\tjog: 0 C0046 active, 1 JOG1 (C0037) active" in out
    assert "bit 8\treserved" in out


def test_json_is_what_the_daemon_would_say(run: Run) -> None:
    whole = json.loads(run("describe", "93xx", "--configuration", "1011", "--json").out)
    assert (whole["configuration"], whole["saved_by"]) == ("1xx1", "C0003")
    one = json.loads(run("describe", "93xx", "C0039/4", "--json").out)
    assert one in whole["codes"]
    assert (one["name_de"], one["subcode"]) == ("JOG-Wert 4", 4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("821z",), "'821z' is not one of '820x'"),
        (("821x", "C0044"), "C0044 of 821x is not described; near it are C0040, C0043, C0046"),
        (("generic", "C0044"), "C0044 of generic is not described; any code may be read"),
        (("821x", "forty"), "is not a code"),
        (("93xx", "--configuration", "2001"), "configuration 2001 of 93xx; known are: 1xx1, 4xx1"),
        (("821x", "--configuration", "1001"), "configuration 1001 of 821x; known are: none"),
        (("821x", "--lang", "fr"), "'fr' is not one of 'en', 'de'"),
    ],
)
def test_what_is_not_there_is_refused_with_what_is(
    words: tuple[str, ...], message: str, run: Run
) -> None:
    ran = run("describe", *words)
    assert (ran.status, ran.out) == (2, "")
    assert message in ran.err
