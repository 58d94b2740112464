"""Every alert fires when it should, and stays quiet when it should not: promtool's rule tests.

A case gives made-up series as promtool writes them: `0x11 1x20` is 0 for twelve samples and 1 for
twenty-one. The texts of the alerts are compared too, so no label in them can be missing.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from support.real_parts import require

pytestmark = pytest.mark.real

ROOT = Path(__file__).parents[2]
RULES = ROOT / "deploy" / "prometheus" / "lecombus.rules.yml"
ALARMS = ROOT / "docs" / "alarms.md"

Series = Mapping[str, str]

TARGET = 'job="lecombus",instance="hall:9740"'
LINE = f'{TARGET},line="hall-3"'
FEEDER = f'{LINE},drive="feeder"'
BELT = f'{LINE},drive="belt"'
OF_LINE = {"job": "lecombus", "instance": "hall:9740", "line": "hall-3"}
OF_FEEDER = {**OF_LINE, "drive": "feeder"}


@dataclass(frozen=True)
class Case:
    """When one alert fires, and when it does not.

    Args:
        alert: Its name.
        series: Series with which it fires.
        firing: When it does, as promtool writes a time.
        not_yet: When it does not, with the same series.
        quiet: Other series, with which it does not fire at the times given.
        labels: Its labels without the severity.
        shown: What stands for its value in its texts.
        texts: Texts that have more than labels and one value in them.
        interval: The time between two samples.
    """

    alert: str
    series: Series
    firing: tuple[str, ...]
    not_yet: tuple[str, ...] = ()
    quiet: tuple[tuple[Series, tuple[str, ...]], ...] = ()
    labels: Mapping[str, str] = field(default_factory=lambda: OF_FEEDER)
    shown: str = ""
    texts: Mapping[str, str] = field(default_factory=dict)
    interval: str = "5s"

    def __post_init__(self) -> None:
        assert self.firing
        assert self.not_yet or self.quiet


def sent(answered: str, failed: str, of: str = FEEDER) -> dict[str, str]:
    """Telegrams of one drive, by two outcomes."""
    name = f'lecombus_telegrams_total{{{of},kind="read",outcome='
    return {f'{name}"answered"}}': answered, f'{name}"garbled"}}': failed}


def up(of: str = FEEDER, values: str = "1x200") -> dict[str, str]:
    return {f"lecombus_drive_up{{{of}}}": values}


def silenced(of: str = FEEDER) -> dict[str, str]:
    """On purpose, after the end of its lease."""
    return {f"lecombus_drive_silenced{{{of}}}": "1x200"}


LINE_UP = {f"lecombus_line_up{{{LINE}}}": "1x200"}
BELT_UP = up(BELT)
TRIPS = {
    f"lecombus_drive_fault{{{FEEDER}}}": "0x11 1x11 0x20",
    f"lecombus_drive_fault{{{BELT}}}": "0x60",
}
NUMBER = f'lecombus_drive_fault_number{{{FEEDER},kind="trip"}}'
MARGIN = f"lecombus_watchdog_margin_lowest_seconds{{{FEEDER}}}"
TIME_SET = f"lecombus_watchdog_time_seconds{{{FEEDER}}}"
TIME = {TIME_SET: "2x200"}
LATE = f"lecombus_late_answers_total{{{LINE}}}"
EXPIRY = "2678400x40"  # 31 days after the beginning of time
C0012 = f'lecombus_parameter_writes_total{{{FEEDER},code="C0012"}}'

CASES = (
    Case(
        "LecombusDown",
        {f"up{{{TARGET}}}": "1x11 0x48"},
        firing=("80s", "200s"),
        not_yet=("55s", "65s"),
        quiet=(
            ({f"up{{{TARGET}}}": "1x11 0x1 1x48"}, ("65s", "90s")),
            ({'up{job="node",instance="hall:9100"}': "0x60"}, ("200s",)),
        ),
        labels={"job": "lecombus", "instance": "hall:9740"},
    ),
    Case(
        "LecombusDown",
        {'up{job="lecombus-by-token",instance="hall:9740"}': "0x60"},
        firing=("200s",),
        not_yet=("5s",),
        labels={"job": "lecombus-by-token", "instance": "hall:9740"},
    ),
    Case(
        "LecombusRestarts",
        {f"process_start_time_seconds{{{TARGET}}}": "100x11 200x11 300x11"},
        firing=("150s",),
        not_yet=("50s", "100s"),
        labels={"job": "lecombus", "instance": "hall:9740"},
        shown="2",
    ),
    Case(
        "LecombusLineLost",
        {f"lecombus_line_up{{{LINE}}}": "1x11 0x48"},
        firing=("80s", "200s"),
        not_yet=("55s", "65s"),
        quiet=((LINE_UP, ("200s",)),),
        labels=OF_LINE,
    ),
    Case(
        "LecombusLineSilent",
        {**up(values="0x60"), **up(BELT, "1x11 0x48"), **LINE_UP},
        firing=("100s",),
        not_yet=("55s", "80s"),
        quiet=(
            ({**up(values="0x60"), **BELT_UP, **LINE_UP}, ("100s",)),
            ({**up(values="0x60"), f"lecombus_line_up{{{LINE}}}": "0x60"}, ("100s",)),
            ({**up(values="0x60"), **up(BELT, "0x60"), **LINE_UP, **silenced(), **silenced(BELT)},
             ("100s",)),
        ),
        labels=OF_LINE,
    ),
    Case(
        "LecombusLineSilent",
        {**up(values="0x60"), **up(BELT, "1x11 0x48"), **LINE_UP, **silenced()},
        firing=("100s",),
        not_yet=("55s", "80s"),
        labels=OF_LINE,
    ),
    Case(
        "LecombusDriveSilent",
        {**up(values="1x11 0x48"), **BELT_UP, **LINE_UP},
        firing=("130s",),
        not_yet=("55s", "110s"),
        quiet=(
            ({**up(), **BELT_UP, **LINE_UP}, ("200s",)),
            ({**up(values="0x60"), **up(BELT, "0x60"), **LINE_UP}, ("200s",)),
            ({**up(values="0x60"), **BELT_UP, **LINE_UP, **silenced()}, ("200s",)),
        ),
    ),
    *(
        Case(
            "LecombusDriveTripped",
            {**TRIPS, **number},
            firing=("65s", "110s"),
            not_yet=("50s", "200s"),
            texts={"description": f"LECOM fault number: {shown}."},
        )
        for shown, number in (("50", {NUMBER: "_x11 50x11 _x20"}), ("not known yet", {}))
    ),
    Case(
        "LecombusValuesStale",
        {f"lecombus_drive_values_not_good{{{FEEDER}}}": "0x5 3x60", **up()},
        firing=("160s",),
        not_yet=("20s", "100s"),
        quiet=(
            ({f"lecombus_drive_values_not_good{{{FEEDER}}}": "0x60", **up()}, ("200s",)),
            (
                {f"lecombus_drive_values_not_good{{{FEEDER}}}": "3x60", **up(values="0x60")},
                ("200s",),
            ),
        ),
        shown="3",
    ),
    Case(
        "LecombusWatchdogMissed",
        {f"lecombus_watchdog_misses_total{{{FEEDER}}}": "0x2 1x100"},
        firing=("80s", "340s"),
        not_yet=("40s", "400s"),
        quiet=(({f"lecombus_watchdog_misses_total{{{FEEDER}}}": "4x60"}, ("200s",)),),
        interval="20s",
    ),
    Case(
        "LecombusWatchdogMarginLow",
        {MARGIN: "0.9x2 0.15 0.9x100", **TIME},
        firing=("140s", "340s"),
        not_yet=("40s", "100s", "400s"),
        quiet=(
            ({MARGIN: "0.25x60", **TIME}, ("200s",)),
            # A short time is not a low margin.
            ({MARGIN: "0.09x60", TIME_SET: "0.3x60"}, ("200s",)),
        ),
        shown="150ms",
        interval="20s",
    ),
    Case(
        "LecombusLineDisturbed",
        {**sent("0+96x200", "0+4x200"), **up()},
        firing=("400s",),
        not_yet=("200s",),
        quiet=(
            ({**sent("0+99x200", "0+1x200"), **up()}, ("600s",)),
            # The one that fails is switched off, the other answers.
            (
                {
                    **sent("0x200", "0+50x200"),
                    **up(values="0x200"),
                    **sent("0+100x200", "0x200", BELT),
                    **BELT_UP,
                },
                ("600s",),
            ),
        ),
        labels=OF_LINE,
        shown="4%",
        interval="20s",
    ),
    Case(
        "LecombusDriveDisturbed",
        {**sent("0+3x200", "0+1x200"), **up(), **sent("0+500x200", "0x200", BELT), **BELT_UP},
        firing=("400s",),
        not_yet=("200s",),
        quiet=(
            ({**sent("0+95x200", "0+5x200"), **up()}, ("600s",)),
            ({**sent("0x200", "0+5x200"), **up(values="0x200")}, ("600s",)),
        ),
        shown="25%",
        interval="20s",
    ),
    Case(
        "LecombusAnswersLate",
        {**sent("0+100x200", "0x200"), LATE: "0+1x200"},
        firing=("400s",),
        not_yet=("200s",),
        quiet=(
            ({**sent("0+250x200", "0x200"), LATE: "0+1x200"}, ("600s",)),
            ({**sent("0+100x200", "0x200"), LATE: "7x200"}, ("600s",)),
        ),
        labels=OF_LINE,
        shown="1%",
        interval="20s",
    ),
    Case(
        "LecombusLineOverloaded",
        {f"lecombus_cyclic_stretch_ratio{{{LINE}}}": "1x2 1.5x100"},
        firing=("400s",),
        not_yet=("40s", "300s"),
        quiet=(({f"lecombus_cyclic_stretch_ratio{{{LINE}}}": "1.02x200"}, ("600s",)),),
        labels=OF_LINE,
        shown="1.5",
        interval="20s",
    ),
    Case(
        "LecombusSchedulerLate",
        {f"lecombus_scheduler_lateness_seconds{{{LINE}}}": "0.001x2 0.04x100"},
        firing=("200s",),
        not_yet=("40s", "160s"),
        quiet=(({f"lecombus_scheduler_lateness_seconds{{{LINE}}}": "0.01x200"}, ("600s",)),),
        labels=OF_LINE,
        shown="40ms",
        interval="20s",
    ),
    Case(
        "LecombusLeaseLapsed",
        {f"lecombus_lease_lapses_total{{{FEEDER}}}": "0x2 1x200"},
        firing=("80s", "600s"),
        not_yet=("40s", "700s"),
        quiet=(({f"lecombus_lease_lapses_total{{{FEEDER}}}": "2x200"}, ("600s",)),),
        interval="20s",
    ),
    Case(
        "LecombusLeaseLapsed",  # of a drive that needs none, before a scrape has seen the lease
        {f"lecombus_lease_lapses_total{{{FEEDER}}}": "_x2 1x200"},
        firing=("60s", "600s"),
        not_yet=("20s", "700s"),
        # Prometheus was away for a quarter of an hour, and the lapse was before that.
        quiet=(
            ({f"lecombus_lease_lapses_total{{{FEEDER}}}": "1x100 _x45 1x200"}, ("3000s",)),
            ({f"lecombus_lease_lapses_total{{{FEEDER}}}": "_x2 0x200"}, ("60s", "600s")),
        ),
        interval="20s",
    ),
    Case(
        "LecombusDriveWithoutController",
        {f"lecombus_drive_without_controller{{{FEEDER}}}": "0x11 1x20 0x20"},
        firing=("65s", "150s"),
        not_yet=("50s", "200s"),
    ),
    Case(
        "LecombusDriveSilenced",
        {f"lecombus_drive_silenced{{{FEEDER}}}": "0x11 1x20 0x20"},
        firing=("65s", "150s"),
        not_yet=("50s", "200s"),
    ),
    Case(
        "LecombusJournalFails",
        {f"lecombus_journal_up{{{LINE}}}": "1x11 0x48"},
        firing=("95s",),
        not_yet=("55s", "85s"),
        labels=OF_LINE,
    ),
    Case(
        "LecombusJournalRowsLost",
        {f"lecombus_journal_missed_rows_total{{{LINE}}}": "0x11 5x48"},
        firing=("65s",),
        not_yet=("55s",),
        quiet=(({f"lecombus_journal_missed_rows_total{{{LINE}}}": "5x60"}, ("200s",)),),
        labels=OF_LINE,
    ),
    Case(
        "LecombusWearHigh",
        {C0012: "79999x11 80001x20"},
        firing=("65s",),
        not_yet=("55s",),
        labels={**OF_FEEDER, "code": "C0012"},
        shown="80001",
    ),
    Case(
        "LecombusWearFast",
        {C0012: "0+36x40"},
        firing=("8d",),
        not_yet=("3d",),
        quiet=(({C0012: "0+24x40"}, ("8d",)), ({C0012: "70000x40"}, ("8d",))),
        labels={**OF_FEEDER, "code": "C0012"},
        shown="504",
        interval="12h",
    ),
    Case(
        "LecombusCertificateExpires",
        {f'lecombus_tls_certificate_expiry_timestamp_seconds{{{LINE},file="certificate"}}': EXPIRY},
        firing=("3d",),
        not_yet=("12h",),
        labels={**OF_LINE, "file": "certificate"},
        shown="28d 0h 0m 0s",
        interval="12h",
    ),
)  # fmt: skip


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load(RULES.read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


ALERTS: dict[str, dict[str, Any]] = {
    rule["alert"]: rule for rule in rules() if "alert" in rule
}  # fmt: skip


def expected(case: Case) -> dict[str, Any]:
    """The alert of a case, its texts with labels and value in them."""
    rule = ALERTS[case.alert]

    def text(name: str, template: str) -> str:
        if name in case.texts:
            return case.texts[name]
        put = re.sub(r"\{\{ \$labels\.(\w+) \}\}", lambda of: case.labels[of[1]], template)
        put = re.sub(r"\{\{ \$value( \| \w+)? \}\}", case.shown or "?", put)
        assert "{{" not in put
        return put

    return {
        "exp_labels": {**rule["labels"], **case.labels},
        "exp_annotations": {name: text(name, one) for name, one in rule["annotations"].items()},
    }


def rule_test(case: Case, series: Series, at: Mapping[str, bool]) -> dict[str, Any]:
    """One test of promtool: with some series, whether the alert fires at some times."""
    return {
        "interval": case.interval,
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "alert_rule_test": [
            {
                "eval_time": time,
                "alertname": case.alert,
                "exp_alerts": [expected(case)] if fires else [],
            }
            for time, fires in at.items()
        ],
    }


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.alert)
def test_an_alert_fires_when_it_should_and_not_otherwise(case: Case, tmp_path: Path) -> None:
    times = {**dict.fromkeys(case.firing, True), **dict.fromkeys(case.not_yet, False)}
    tests = [rule_test(case, case.series, times)]
    tests += [rule_test(case, series, dict.fromkeys(at, False)) for series, at in case.quiet]
    cases = {
        "rule_files": [str(RULES)],
        "evaluation_interval": case.interval,
        "tests": tests,
    }
    path = tmp_path / "alerts.yml"
    path.write_text(json.dumps(cases))
    done = subprocess.run(
        [require("promtool"), "test", "rules", path],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_alert_has_a_case() -> None:
    assert {case.alert for case in CASES} == set(ALERTS)


def test_every_alert_says_what_it_is_what_to_do_and_where_more_stands() -> None:
    headings = re.findall(r"^### (.+)$", ALARMS.read_text(), re.MULTILINE)
    anchors = {heading.lower().replace(" ", "-") for heading in headings}
    for name, rule in ALERTS.items():
        texts = rule["annotations"]
        assert set(texts) == {"summary", "description", "action", "runbook"}, name
        page, _, anchor = texts["runbook"].partition("#")
        assert page == "docs/alarms.md"
        assert anchor in anchors, name
        assert rule["labels"]["severity"] in ("critical", "warning")


def test_every_alert_and_record_is_documented() -> None:
    named = set(re.findall(r"`(Lecombus\w+|\w+:lecombus_\w+(?::\w+)?)`", ALARMS.read_text()))
    assert named == set(ALERTS) | {rule["record"] for rule in rules() if "record" in rule}
