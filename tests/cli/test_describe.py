"""`lecombus describe`, as typed: no daemon, no drive."""

from __future__ import annotations

import json

import pytest

from cli.conftest import Run
from lecombus.backups.backup_file import wanted_codes
from lecombus.cli import describe
from lecombus.cli.describe import GERMAN
from lecombus.drives import FAMILY_NAMES, family
from lecombus.parameters import Code
from support.golden import Golden

ENGLISH = {english for english, german in GERMAN.items() if english != german}


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_code_of_a_family_has_a_line(name: str, run: Run) -> None:
    ran = run("describe", name)
    assert (ran.status, ran.err) == (0, "")
    lines = [line.split("\t") for line in ran.out.splitlines()]
    assert [line[0] for line in lines] == [str(one.code) for one in family(name).described()]
    assert {len(line) for line in lines} <= {7}


def test_names_and_ranges_come_in_german(run: Run) -> None:
    out = run("describe", "821x", "--lang", "de").out
    assert "C0046\tFrequenzsollwert\tVD\t0 bis 480 Hz\tlesen schreiben\tflüchtig\t" in out
    assert "C1922\tÜberwachungsreaktion\tVD\t0 (nicht aktiv), 1 (Reglersperre), " in out


def test_in_german_nothing_is_left_in_english(run: Run) -> None:
    out = run("describe", "8200vector", "C0150", "--lang", "de").out
    rows = dict(line.split("\t") for line in out.splitlines())
    assert (rows["Bit 1"], rows["Bit 7"]) == ("Impulssperre", "Reglersperre")
    assert rows["Bit 0"] == "frei: die Bedeutung wird im Antrieb eingestellt"
    assert rows["Bits 8 bis 11"].startswith("Gerätezustand: 0 Geräteinitialisierung, 1 Einschaltsp")
    assert (rows["Zugriff"], rows["Speicherort"]) == ("lesen", "flüchtig")
    assert rows["Format"] == "VH, 4 Hexadezimalziffern"
    out = run("describe", "821x", "C0135", "--lang", "de").out
    assert "Bit 3\tQuickstop: 0 Quickstop nicht aktiv, 1 Quickstop aktiv" in out
    assert "Bit 8\treserviert" in out


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_every_code_of_a_family_is_told_in_german(name: str, run: Run) -> None:
    """A word without German would be an error, not English."""
    assert run("describe", name, "--lang", "de").status == 0
    for info in family(name).described():
        ran = run("describe", name, str(info.code), "--lang", "de")
        assert (ran.status, ran.err) == (0, "")
        assert not ENGLISH & {line.split("\t")[0] for line in ran.out.splitlines()}


def test_headings_on_a_terminal_are_german(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []
    monkeypatch.setattr(describe, "show_rows", lambda headings, rows: seen.append([*headings]))
    assert run("describe", "generic", "--lang", "de").status == 0
    assert seen == [["Code", "Name", "Format", "Werte", "Zugriff", "Speicherort", "Quelle"]]


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
    "words",
    [
        ("821z",),
        ("821x", "C0044"),
        ("generic", "C0044"),
        ("821x", "forty"),
        ("93xx", "--configuration", "2001"),
        ("821x", "--configuration", "1001"),
        ("821x", "--lang", "fr"),
    ],
)
def test_what_is_not_there_is_refused_with_what_is(
    words: tuple[str, ...], run: Run, golden: Golden
) -> None:
    ran = run("describe", *words)
    assert (ran.status, ran.out) == (2, "")
    golden(ran.err)


@pytest.mark.parametrize(
    ("family", "said"),
    [
        ("821x", "value 0\tno fault; writing 0 resets a fault"),
        ("8200vector", "value 0\tno fault; writing 0 resets a fault"),
        ("93xx", "value 0\tno fault; writing 0 resets a fault"),
        ("smvector", "value 1\treset fault"),
    ],
)
def test_c0043_says_which_value_resets_a_fault(run: Run, family: str, said: str) -> None:
    assert said in run("describe", family, "C0043").out.splitlines()


def test_an_820x_has_no_c0043_and_what_resets_a_fault_there_is_said(run: Run) -> None:
    ran = run("describe", "820x", "C0043")
    assert ran.status == 2
    assert "820x has no C0043: inhibit followed by enable resets a fault" in ran.err


def test_a_parameter_is_named_as_at_the_keypad(run: Run) -> None:
    rows = run("describe", "smvector", "P411").out.splitlines()
    assert rows[:2] == ["code\tC1411", "keypad\tP411"]
    assert run("describe", "smvector", "P412").err.startswith("P412 of smvector is not described")
    assert "keypad" not in run("describe", "8200vector", "C0012").out


def test_on_a_terminal_the_list_names_parameters_as_at_the_keypad(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "\nC1425\t" in run("describe", "smvector").out
    monkeypatch.setattr(describe, "on_terminal", lambda: True)
    assert "\nP425\t" in run("describe", "smvector").out
    assert "\nC0150\t" in run("describe", "smvector").out


@pytest.mark.parametrize("code", ["C0012", "C0013"])
@pytest.mark.parametrize("family", ["820x", "821x", "8200vector", "93xx"])
def test_ramps_are_in_seconds(run: Run, family: str, code: str) -> None:
    assert "unit\ts" in run("describe", family, code).out.splitlines()


def test_a_code_with_subcodes_that_the_manual_does_not_count_says_so(run: Run) -> None:
    shown = run("describe", "8200vector", "C0417").out
    assert "subcodes\tby the drive's own manual" in shown.splitlines()
    assert Code(417) not in wanted_codes(family("8200vector"))
