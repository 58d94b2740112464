"""A real Prometheus over a running line: alerts fire, dashboards find what they ask for.

The rules are those that ship, with a `for` that suits the interval of this test. The line is a
pseudo terminal of simulated drives, one of which is absent, with a journal and a lease.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest
import yaml

from dashboards.boards import BOARDS, FOLDER
from support.daemon_host import Daemon, free_port, on_a_pty, short_dir, started, until
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.slow, pytest.mark.timeout(150)]

DEPLOY = Path(__file__).parents[2] / "deploy" / "prometheus"
RULES = DEPLOY / "lecombus.rules.yml"
FEDERATION = DEPLOY / "federation.yml"
DRIVES = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"), ("winder", 21, "93xx"),
          ("ghost", 31, "smvector"))  # fmt: skip
THERE = ("feeder", "belt", "winder")
CONFIG = """\
global: {{scrape_interval: 250ms, evaluation_interval: 250ms}}
rule_files: [rules.yml]
scrape_configs: [{{job_name: lecombus, static_configs: [{{targets: ['127.0.0.1:{target}']}}]}}]
"""


@dataclass(frozen=True)
class Watched:
    """A line that a Prometheus scrapes.

    Args:
        api: Speaks with Prometheus.
        daemon: The line's daemon.
    """

    api: httpx2.Client
    daemon: Daemon

    def federate(self, matches: list[str]) -> str:
        """What another Prometheus takes of it."""
        answer = self.api.get(self.api.base_url.join("/federate"), params={"match[]": matches})
        assert answer.status_code == 200, answer.text
        return str(answer.text)

    def ask(self, query: str) -> list[dict[str, Any]]:
        """What a query gives now."""
        answer = self.api.get("/query", params={"query": query})
        if answer.status_code == 503:  # it is still starting
            return []
        assert answer.status_code == 200, f"{query}: {answer.text}"
        found: list[dict[str, Any]] = answer.json()["data"]["result"]
        return found

    def numbers(self, query: str) -> list[float]:
        """The values that a query gives now, without those that are none."""
        values = [float(one["value"][1]) for one in self.ask(query)]
        return [value for value in values if not math.isnan(value)]

    def firing(self) -> set[tuple[str, str]]:
        """The alerts that fire, each with its drive."""
        found = self.ask('ALERTS{alertstate="firing"}')
        return {(one["metric"]["alertname"], one["metric"].get("drive", "")) for one in found}


@pytest.fixture(scope="module")
def watched() -> Iterator[Watched]:
    """A line whose feeder trips as soon as Prometheus has seen all drives."""
    target, port = free_port(), free_port()
    with short_dir() as folder:
        own = {"winder": "lease: {required: true}"}
        watchdog = "{time: 2s, action: inhibit, configure: true}"
        journal = f"journal: {folder / 'journal.sqlite'}"
        with on_a_pty(
            folder, DRIVES, faults="absent=31", watchdog=watchdog, own=own, sections=journal,
            http=target,
        ) as (daemon, end):  # fmt: skip
            rules = re.sub(r"\bfor: \w+", "for: 500ms", RULES.read_text())
            (folder / "rules.yml").write_text(rules)
            (folder / "prometheus.yml").write_text(CONFIG.format(target=target))
            words = [
                str(require("prometheus")),
                f"--config.file={folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={folder / 'data'}",
                f"--web.listen-address=127.0.0.1:{port}",
            ]
            base = f"http://127.0.0.1:{port}/api/v1"
            with (
                httpx2.Client(base_url=base, trust_env=False) as api,
                started(words, folder / "prometheus.log", env=dict(os.environ)),
            ):
                watched = Watched(api, daemon)
                daemon.until_online(*THERE)
                until(lambda: watched.ask("lecombus_drive_fault == 0"), "drives without a fault")
                assert ("LecombusDriveTripped", "feeder") not in watched.firing()
                with end.lock:
                    end.line["feeder"].trip(50)
                yield watched


def test_a_trip_of_a_drive_fires_its_alert_with_its_number_and_what_to_do(
    watched: Watched,
) -> None:
    until(lambda: ("LecombusDriveTripped", "feeder") in watched.firing(), "the alert of the trip")

    def texts() -> dict[str, str]:
        alerts = watched.api.get("/alerts").json()["data"]["alerts"]
        found = [one for one in alerts if one["labels"]["alertname"] == "LecombusDriveTripped"]
        return dict(found[0]["annotations"])

    until(lambda: "50" in texts()["description"], "the number in the alert")
    assert texts()["summary"] == "drive feeder on line test has tripped"
    assert texts()["description"] == "LECOM fault number: 50."
    assert "lecombus why" in texts()["action"]
    assert texts()["runbook"] == "docs/alarms.md#drive-tripped"


def test_other_alerts_are_those_of_what_is_not_right(watched: Watched) -> None:
    """The ghost is silent, the feeder has tripped; everything else works."""
    wanted = {("LecombusDriveTripped", "feeder"), ("LecombusDriveSilent", "ghost")}
    until(lambda: wanted <= watched.firing(), "both alerts")
    # What a busy computer adds, and codes that are read a minute after a start for the first time.
    also = {"LecombusSchedulerLate", "LecombusLineOverloaded", "LecombusValuesStale"}
    assert {one for one in watched.firing() if one[0] not in also} == wanted


def test_prometheus_takes_every_page_and_sees_which_drives_are_up(watched: Watched) -> None:
    until(lambda: watched.ask("count_over_time(lecombus_drive_up[1m]) >= 5"), "five scrapes")
    assert until(lambda: watched.ask("rate(lecombus_telegrams_total[1m]) > 0"), "telegrams between")
    up = {one["metric"]["drive"]: one["value"][1] for one in watched.ask("lecombus_drive_up")}
    assert up == {**dict.fromkeys(THERE, "1"), "ghost": "0"}
    scraped = watched.api.get("/targets").json()["data"]["activeTargets"][0]
    assert (scraped["health"], scraped["lastError"]) == ("up", "")


def test_promtool_finds_nothing_wrong_with_a_page_that_has_all_kinds_of_metrics(
    watched: Watched,
) -> None:
    page = watched.daemon.client.get("/metrics").text
    for metric in ("drive_fault_number", "journal_up", "drive_latched", "watchdog_time_seconds"):
        assert f"\nlecombus_{metric}{{" in page
    done = subprocess.run(
        [require("promtool"), "check", "metrics"],
        input=page, capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")


def test_rules_have_no_error_in_a_real_prometheus(watched: Watched) -> None:
    until(lambda: watched.ask("line:lecombus_drives:count"), "the rules were evaluated")
    groups = watched.api.get("/rules").json()["data"]["groups"]
    found = {rule["name"]: rule["health"] for group in groups for rule in group["rules"]}
    assert set(found.values()) == {"ok"}
    assert watched.numbers("line:lecombus_drives_needing_attention:count") == [2]


QUERIES = [
    pytest.param(query["expr"], id=f"{name} {panel['title']} {query['refId']}")
    for name in BOARDS
    for panel in json.loads((FOLDER / name).read_text())["panels"]
    for query in panel["targets"]
]


@pytest.mark.parametrize("query", QUERIES)
def test_every_query_of_the_dashboards_finds_something(watched: Watched, query: str) -> None:
    for variable, value in (("$__rate_interval", "1m"), ("$line", "test"), ("$drive", "feeder")):
        query = query.replace(variable, value)
    assert "$" not in query
    until(lambda: watched.numbers(query), query)


@pytest.mark.parametrize(
    ("metric", "label", "values"),
    [("lecombus_line_up", "line", {"test"}), ("lecombus_drive_up", "drive", {*THERE, "ghost"})],
)
def test_the_choices_of_the_dashboards_are_the_lines_and_drives(
    watched: Watched, metric: str, label: str, values: set[str]
) -> None:
    until(lambda: watched.ask(metric), metric)
    answer = watched.api.get(f"/label/{label}/values", params={"match[]": metric})
    assert set(answer.json()["data"]) == values


def test_a_server_of_the_site_takes_the_recorded_series_of_lines_and_the_alerts(
    watched: Watched,
) -> None:
    subprocess.run([require("promtool"), "check", "config", FEDERATION], check=True)
    until(lambda: ("LecombusDriveTripped", "feeder") in watched.firing(), "the alert of the trip")
    (job,) = yaml.safe_load(FEDERATION.read_text())["scrape_configs"]
    page = watched.federate(job["params"]["match[]"])
    names = {row.partition("{")[0] for row in page.splitlines() if not row.startswith("#")}
    recorded = {name for name in names if name.startswith("line:lecombus_")}
    assert {"line:lecombus_drives_up:sum", "line:lecombus_drives_needing_attention:count"} <= names
    assert names - recorded == {"up", "ALERTS"}
