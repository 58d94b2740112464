"""The three dashboards of lecombus, for Grafana: all lines, one line, one drive.

`make dashboards` writes them to `deploy/grafana/`. They ask for the series of
`deploy/prometheus/lecombus.rules.yml` too, so Prometheus must have those rules.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from math import inf
from pathlib import Path
from typing import Any, Final

from grafana_foundation_sdk.builders import dashboard as builders
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import dashboard

from dashboards.panels import (
    DRIVE_LINK,
    GREY,
    LINE_LINK,
    RED,
    SOURCE,
    YELLOW,
    Column,
    Limits,
    chart,
    columns,
    figure,
    states,
)

__all__ = ["BOARDS", "FOLDER", "text"]

FOLDER: Final = Path(__file__).parents[2] / "deploy" / "grafana"

BAD_FROM_1: Final[Limits] = {1: RED}
LOW_MARGIN: Final[Limits] = {-inf: YELLOW, 0.1: GREY}
LINE: Final = 'line="$line"'
DRIVE: Final = f'{LINE},drive="$drive"'
STATE: Final = {
    0: ("silent", YELLOW),
    1: ("answers", GREY),
    2: ("silent", YELLOW),
    3: ("tripped", RED),
}
BIT: Final = {0: ("0", "transparent"), 1: ("1", GREY)}


def drive_state(of: str) -> str:
    """Return the query of a drive's state: 0 silent, 1 answers, 3 tripped."""
    fault = f"drive:lecombus_drive_fault:max30s{{{of}}} or 0 * lecombus_drive_up{{{of}}}"
    return f"lecombus_drive_up{{{of}}} + 2 * ({fault})"


def margin_share(of: str) -> str:
    """Return the query of the part of a watchdog's time that was left."""
    lowest = f"lecombus_watchdog_margin_lowest_seconds{{{of}}}"
    return f"{lowest} / lecombus_watchdog_time_seconds{{{of}}}"


def failing(of: str) -> str:
    """Return the query of the part of a drive's exchanges that fail."""
    telegrams = f"drive:lecombus_telegrams:rate5m{{{of}}}"
    return f"drive:lecombus_telegrams_failed:rate5m{{{of}}} / {telegrams}"


def board(uid: str, title: str, about: str) -> builders.Dashboard:
    """Return an empty dashboard with the variable of the data source."""
    return (
        builders.Dashboard(title).uid(uid).description(about).tags(["lecombus"])
        .refresh("10s").time("now-1h", "now").timezone("browser").editable()
        .tooltip(dashboard.DashboardCursorSync.CROSSHAIR)
        .link(
            builders.DashboardLink("lecombus").type(dashboard.DashboardLinkType.DASHBOARDS)
            .tags(["lecombus"]).keep_time(True).include_vars(True)
        )
        .with_variable(
            builders.DatasourceVariable("datasource").label("Prometheus").type("prometheus")
        )
    )  # fmt: skip


def choice(name: str, label: str, query: str) -> builders.QueryVariable:
    """Return a variable whose values are those of a label."""
    return (
        builders.QueryVariable(name).label(label).datasource(SOURCE).query(query)
        .refresh(dashboard.VariableRefresh.ON_TIME_RANGE_CHANGED)
        .sort(dashboard.VariableSort.ALPHABETICAL_ASC)
    )  # fmt: skip


def fleet() -> builders.Dashboard:
    """Return the dashboard of all lines."""
    of = board("lecombus-fleet", "lecombus: all lines", "Which line needs somebody, worst first.")
    for panel in (
        figure("Lines", "count(lecombus_line_up)", "Lines whose daemon answers."),
        figure("Daemons silent", 'count(up{job=~"lecombus.*"} == 0) or vector(0)',
               "Daemons that Prometheus cannot read.", limits=BAD_FROM_1),
        figure("Ports lost", "count(lecombus_line_up == 0) or vector(0)",
               "Lines whose port is not open: nothing can be sent.", limits=BAD_FROM_1),
        figure("Drives", "sum(line:lecombus_drives:count)", "Drives of all rosters."),
        figure("Drives silent", "sum(line:lecombus_drives:count - line:lecombus_drives_up:sum)",
               "Drives that do not answer.", limits={1: YELLOW}),
        figure("Drives tripped", "sum(line:lecombus_drives_tripped:sum) or vector(0)",
               "Drives with a fault.", limits=BAD_FROM_1),
        columns("Lines, worst first", "One row for each line; a click opens it.", [
            Column("Need somebody", "line:lecombus_drives_needing_attention:count",
                   limits=BAD_FROM_1),
            Column("Port", "lecombus_line_up", words={0: ("lost", RED), 1: ("open", GREY)}),
            Column("Drives", "line:lecombus_drives:count"),
            Column("Answering", "line:lecombus_drives_up:sum"),
            Column("Tripped", "line:lecombus_drives_tripped:sum", limits=BAD_FROM_1),
            Column("Exchanges failing", "line:lecombus_telegrams_failed:ratio_rate5m",
                   unit="percentunit", limits={0.02: YELLOW}),
            Column("Line busy", "line:lecombus_line_busy:rate5m", unit="percentunit",
                   limits={0.9: YELLOW}),
        ], ["line"], worst="Need somebody", link=LINE_LINK, width=14),
        columns("Alerts", "What Prometheus has fired; docs/alarms.md says what to do.", [
            Column("Alert", 'ALERTS{alertname=~"Lecombus.*",alertstate="firing"}'),
        ], ["severity", "alertname", "line", "drive"], worst="severity", greatest_first=False,
            link=DRIVE_LINK, width=10),
        chart("Drives that need somebody", {
            "{{line}}": "line:lecombus_drives_needing_attention:count",
        }, "Silent, tripped, silenced or without controller, by line.", limits=BAD_FROM_1),
        chart("Exchanges failing", {
            "{{line}}": "line:lecombus_telegrams_failed:ratio_rate5m",
        }, "With drives that answer.", unit="percentunit", limits={0.02: YELLOW}),
    ):  # fmt: skip
        of.with_panel(panel)
    return of


def line() -> builders.Dashboard:
    """Return the dashboard of one line."""
    of = board("lecombus-line", "lecombus: line", "One line: its drives, its load, its quality.")
    of.with_variable(choice("line", "Line", "label_values(lecombus_line_up, line)"))
    head = (
        figure("Port", f"lecombus_line_up{{{LINE}}}", "Whether the port is open.",
               words={0: ("lost", RED), 1: ("open", GREY)}),
        figure("Drives silent",
               f"line:lecombus_drives:count{{{LINE}}} - line:lecombus_drives_up:sum{{{LINE}}}",
               "Drives that do not answer.", limits={1: YELLOW}),
        figure("Drives tripped", f"line:lecombus_drives_tripped:sum{{{LINE}}} or vector(0)",
               "Drives with a fault.", limits=BAD_FROM_1),
        figure("Lowest watchdog margin", f"min({margin_share(LINE)})",
               "The least part of a watchdog's time that was left in the last half minute.",
               unit="percentunit", limits=LOW_MARGIN),
        figure("Line busy", f"line:lecombus_line_busy:rate5m{{{LINE}}}",
               "Which part of the time the line is used.", unit="percentunit",
               limits={0.9: YELLOW}),
        figure("Without controller", f"sum(lecombus_drive_without_controller{{{LINE}}}) "
               "or vector(0)", "Drives that run on after their lease ended.", limits=BAD_FROM_1),
    )  # fmt: skip
    body = (
        states("Drives", drive_state(LINE), "{{drive}}", "Grey: the drive answers.", STATE),
        columns("Drives, worst first", "One row for each drive; a click opens it.", [
            Column("State", drive_state(LINE), words=STATE),
            Column("Values not good", f"lecombus_drive_values_not_good{{{LINE}}}",
                   limits={1: YELLOW}),
            Column("Exchanges failing", failing(LINE), unit="percentunit", limits={0.1: YELLOW}),
            Column("Watchdog margin", margin_share(LINE), unit="percentunit", limits=LOW_MARGIN),
            Column("Answer time / manual", f"lecombus_drive_answer_ratio{{{LINE}}}",
                   limits={1.25: YELLOW}),
            Column("Latched", f"lecombus_drive_latched{{{LINE}}}",
                   words={0: ("", GREY), 1: ("latched", YELLOW)}),
        ], ["line", "drive"], worst="Exchanges failing", link=DRIVE_LINK),
        chart("Line time by class", {
            "{{priority}}": f"rate(lecombus_line_seconds_total{{{LINE}}}[$__rate_interval])",
        }, "Which class of requests uses the line.", unit="percentunit"),
        chart("Exchanges failing", {
            "{{drive}}": failing(LINE),
        }, "By drive. One drive: its plug or module. All: the line.", unit="percentunit",
            limits={0.1: YELLOW}),
        chart("Lowest watchdog margin", {
            "{{drive}}": margin_share(LINE),
        }, "Part of each watchdog's time that was left; below a tenth something was late.",
            unit="percentunit"),
        chart("Waiting, 99 of 100", {
            "{{priority}}": f"priority:lecombus_queue_wait_seconds:p99_5m{{{LINE}}}",
        }, "How long requests wait, by class.", unit="s"),
        chart("Exchange time", {
            "{{kind}}, half":
                "histogram_quantile(0.5, sum by (kind, le) "
                f"(rate(lecombus_exchange_seconds_bucket{{{LINE}}}[$__rate_interval])))",
            "{{kind}}, 99 of 100":
                "histogram_quantile(0.99, sum by (kind, le) "
                f"(rate(lecombus_exchange_seconds_bucket{{{LINE}}}[$__rate_interval])))",
        }, "From the first byte to the end of the answer.", unit="s"),
        chart("Lateness", {
            "computer": f"lecombus_scheduler_lateness_seconds{{{LINE}}}",
            "cyclic reads": f"lecombus_cyclic_lateness_seconds{{{LINE}}}",
        }, "The computer's part should stay below 20 ms.", unit="s"),
        chart("Periods longer than asked", {
            "factor": f"lecombus_cyclic_stretch_ratio{{{LINE}}}",
        }, "1: every cyclic read keeps its period.", limits={1.05: YELLOW}),
        chart("Disturbance", {
            "late answers": f"rate(lecombus_late_answers_total{{{LINE}}}[$__rate_interval])",
            "echo mismatches": f"rate(lecombus_echo_mismatches_total{{{LINE}}}[$__rate_interval])",
            "stray bytes": f"rate(lecombus_stray_bytes_total{{{LINE}}}[$__rate_interval])",
        }, "A second; all should be 0.", unit="cps"),
        chart("Requests refused", {
            "{{priority}}": f"rate(lecombus_schedule_refusals_total{{{LINE}}}[$__rate_interval])",
        }, "Queue full, drive offline, line lost, no room beside the feeds.", unit="cps"),
        chart("Journal", {
            "size": f"lecombus_journal_size_bytes{{{LINE}}}",
        }, "Its file and log.", unit="bytes"),
    )  # fmt: skip
    for panel in (*head, *body):
        of.with_panel(panel)
    return of


def drive() -> builders.Dashboard:
    """Return the dashboard of one drive."""
    of = board("lecombus-drive", "lecombus: drive", "One drive: its state, values and quality.")
    of.with_variable(choice("line", "Line", "label_values(lecombus_line_up, line)"))
    of.with_variable(choice("drive", "Drive", f"label_values(lecombus_drive_up{{{LINE}}}, drive)"))
    head = (
        figure("State", drive_state(DRIVE), "As its line sees it.", words=STATE),
        figure("Fault", f"max(lecombus_drive_fault_number{{{DRIVE}}}) or vector(0)",
               "Number of the fault; lecombus why names it.",
               limits=BAD_FROM_1, words={0: ("none", GREY)}),
        figure("Values not good", f"lecombus_drive_values_not_good{{{DRIVE}}}",
               "Cyclic codes that are stale or bad, and so are shown nowhere.",
               limits={1: YELLOW}),
        figure("Watchdog margin", margin_share(DRIVE),
               "Part of the watchdog's time that was left in the last half minute.",
               unit="percentunit", limits=LOW_MARGIN),
        figure("Exchanges failing", failing(DRIVE), "In five minutes.", unit="percentunit",
               limits={0.1: YELLOW}),
        figure("Latched", f"max(lecombus_drive_latched{{{DRIVE}}}) or vector(0)",
               "It takes no setpoint until it is enabled under a lease.",
               words={0: ("no", GREY), 1: ("latched", YELLOW)}),
    )  # fmt: skip
    body = (
        chart("Frequency and speed", {
            "{{name}} {{code}} ({{unit}})":
                f'lecombus_drive_value{{{DRIVE},unit=~"Hz|rpm|%"}}',
        }, "Cyclic values while they are good; a gap means that they were not.", width=24),
        chart("Other values", {
            "{{name}} {{code}} ({{unit}})":
                f'lecombus_drive_value{{{DRIVE},unit!~"Hz|rpm|%"}}',
        }, "Cyclic values while they are good.", width=24),
        states("Status bits", f"lecombus_drive_status_bit{{{DRIVE}}}", "{{code}} {{bit}}",
               "Bits of its status words, as the manual names them.", BIT, height=12),
        chart("Exchanges", {
            "{{kind}} {{outcome}}":
                "sum by (kind, outcome) "
                f"(rate(lecombus_telegrams_total{{{DRIVE}}}[$__rate_interval])) > 0",
        }, "A second, by kind and how they ended.", unit="cps"),
        chart("Watchdog", {
            "lowest margin": f"lecombus_watchdog_margin_lowest_seconds{{{DRIVE}}}",
            "time": f"lecombus_watchdog_time_seconds{{{DRIVE}}}",
        }, "What was left before it would have acted.", unit="s"),
        chart("Watchdog missed", {
            "missed": f"increase(lecombus_watchdog_misses_total{{{DRIVE}}}[$__rate_interval])",
        }, "Feeds that came too late; the drive has probably acted.", limits=BAD_FROM_1),
        chart("Writes into its memory", {
            "in a day": f"drive:lecombus_parameter_writes:increase1d{{{DRIVE}}}",
            "{{code}}": f"lecombus_parameter_writes_total{{{DRIVE}}}",
        }, "100,000 writes of one parameter are near the end of the memory.",
            limits={80000: YELLOW}),
    )  # fmt: skip
    for panel in (*head, *body):
        of.with_panel(panel)
    return of


BOARDS: Final[Mapping[str, Callable[[], builders.Dashboard]]] = {
    "lecombus-fleet.json": fleet,
    "lecombus-line.json": line,
    "lecombus-drive.json": drive,
}
"""The dashboards by the names of their files."""


def text(make: Callable[[], builders.Dashboard]) -> str:
    """Return a dashboard as it stands in its file."""
    built: Any = make().build()
    for number, panel in enumerate(built.panels, start=1):
        panel.id_val = number
    return json.dumps(built, cls=JSONEncoder, indent=2, sort_keys=True) + "\n"


def main() -> None:
    """Write all dashboards."""
    for name, make in BOARDS.items():
        (FOLDER / name).write_text(text(make))


if __name__ == "__main__":
    main()
