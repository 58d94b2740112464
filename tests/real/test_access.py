"""A daemon as it is run, asked at every door: tokens, TLS, what may be written, reload."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from lecombus.tokens.secret import new_secret
from support.certificates import Certificates, client_context, make_certificates
from support.daemon_host import (
    Daemon,
    Ran,
    free_port,
    lecombus,
    running,
    short_dir,
    started,
    until,
)
from support.real_parts import require

pytestmark = pytest.mark.real

SCRAPES = Path(__file__).parents[2] / "deploy" / "prometheus" / "prometheus.yml"
DRIVES = """
  - {name: feeder, address: 11, family: 8200vector, writable: [C0046, C0135, C0040]}
  - {name: belt, address: 12, family: 8200vector, writable: [C0046]}
"""


class Site:
    """A daemon with all doors open, and the ways to ask it."""

    def __init__(self, daemon: Daemon, made: Certificates, port: int) -> None:
        self.daemon = daemon
        self.made = made
        self.url = f"https://localhost:{port}"

    def token(self, name: str, *words: str) -> Path:
        path = self.daemon.folder / f"{name}.token"
        said = lecombus(
            "token", "new", name, *words, "-o", path, "-c", self.daemon.roster, within_s=30
        )
        assert said.status == 0, said.err
        # Not by asking: too many refusals from one address are answered with 429.
        until(lambda: self.tokens_read() == 1, "the new token")
        return path

    def tokens_read(self) -> int | None:
        """Return how many tokens the daemon has found in the file when it last read it."""
        found = re.findall(r"event=tokens-read .*tokens=(\d+)", self.daemon.log())
        return int(found[-1]) if found else None

    def cli(self, token: Path, name: str, *words: str) -> Ran:
        ca = self.made.path("ca.pem")
        where = ("--url", self.url, "--ca", ca, "--token-file", token)
        return lecombus(name, *where, *words, within_s=30)

    @contextlib.contextmanager
    def client(self, token: Path) -> Iterator[httpx2.Client]:
        headers = {"Authorization": f"Bearer {token.read_text().strip()}"}
        tls = client_context(self.made)
        with httpx2.Client(base_url=self.url, headers=headers, verify=tls, timeout=20) as client:
            yield client


@contextlib.contextmanager
def site(*, more: str = "") -> Iterator[Site]:
    with short_dir() as folder:
        made, port = make_certificates(folder), free_port()
        tls = f"{{certificate: {made.path('server.pem')}, key: {made.path('server.key')}}}"
        api = (
            f"{{socket: {folder}/api.sock, http: '127.0.0.1:{port}', tokens: {folder}/tokens, "
            f"tls: {tls}{more}}}"
        )
        text = (
            f'line: {{name: bench, port: "sim:", baud: 19200}}\ndrives:{DRIVES}'
            f"groups: {{both: {{members: [feeder, belt]}}}}\napi: {api}\n"
        )
        with running(text, folder) as daemon:
            yield Site(daemon, made, port)


def kind(answer: httpx2.Response) -> str:
    return str(answer.json()["type"]).removeprefix("urn:lecombus:problem:")


def test_no_door_writes_what_the_roster_does_not_allow() -> None:
    """One rule for all doors: every way to write ends in `Permissions`."""
    with site() as made:
        made.daemon.until_online()
        token = made.token("all", "--scope", "write", "--scope", "control")
        with made.client(token) as tcp:
            until(lambda: tcp.get("/v1/line").status_code == 200, "the token is valid")
            for door in (made.daemon.client, tcp):
                for method, path, body in (
                    ("PUT", "/v1/drives/feeder/codes/C0012", {"value": 5}),
                    ("PUT", "/v1/drives/feeder/codes/C0012/0", {"value": 5}),
                    ("PUT", "/v1/drives/belt/codes/C0135", {"value": "H0000"}),
                    ("PUT", "/v1/groups/both/codes/C0135", {"value": "H0000"}),
                    ("PUT", "/v1/groups/all/codes/C0012", {"value": 5}),
                    ("POST", "/v1/drives/belt/verbs/enable", {}),
                    ("PUT", "/v1/drives/feeder/codes/C0009", {"value": 13}),
                    ("PUT", "/v1/drives/feeder/codes/C0012", {"value": 5, "restore": True}),
                    ("POST", "/v1/drives/feeder/address", {"address": 13}),
                ):  # fmt: skip
                    answer = door.request(method, path, json=body)
                    assert answer.status_code in (403, 409), (path, answer.text)
                assert door.put("/v1/drives/feeder/codes/C0046", json={"value": 5}).is_success
        for words in (("write", "feeder", "C0012", "5"), ("group", "both", "C0135", "H0000")):
            assert made.daemon.cli(*words).status == 4
            assert made.cli(token, *words).status == 4


def test_tokens_and_certificates_change_without_a_restart() -> None:
    with site() as made:
        token = made.token("plc", "--scope", "control", "--for", "feeder")
        with made.client(token) as tcp:
            until(lambda: tcp.get("/v1/drives/feeder").status_code == 200, "the token is valid")
            assert kind(tcp.get("/v1/drives/belt")) == "not-permitted"
            assert [one["drive"] for one in tcp.get("/v1/drives").json()["drives"]] == ["feeder"]
        seen = made.cli(token, "status", "--json")
        assert seen.status == 0, seen.err
        assert lecombus("token", "revoke", "plc", "-c", made.daemon.roster).status == 0
        until(lambda: made.tokens_read() == 0, "the file without tokens")
        assert made.cli(token, "status").status == 4
        # A certificate of another authority is used after a reload; a wrong one is refused.
        other = made.daemon.folder / "other"
        other.mkdir()
        new = make_certificates(other)
        for name in ("server.pem", "server.key"):
            made.made.path(name).write_bytes(new.path(name).read_bytes())
        made.daemon.tell(signal.SIGHUP)
        until(lambda: "event=reloaded" in made.daemon.log(), "the reload")
        with httpx2.Client(verify=client_context(new), base_url=made.url) as tcp:
            assert tcp.get("/v1/line").status_code == 401
        made.made.path("server.pem").write_text("rubbish")
        refused = made.daemon.cli("reload")
        assert refused.status == 2
        assert f"{made.made.path('server.pem')}:1:1: it cannot be used" in refused.err
        remarks = made.daemon.get("/v1/line")["remarks"]
        assert "server.pem" in json.dumps(remarks)
        with httpx2.Client(verify=client_context(new), base_url=made.url) as tcp:
            assert tcp.get("/v1/line").status_code == 401
        secret = token.read_text().strip()
        assert secret not in made.daemon.log()
        assert "lcb_" not in made.daemon.log() + made.daemon.client.get("/metrics").text
        words = Path(f"/proc/{made.daemon.process.pid}/cmdline").read_bytes()
        assert b"lcb_" not in words


def test_a_read_only_daemon_stops_and_writes_nothing() -> None:
    with site(more=", read_only: yes") as made:
        made.daemon.until_online()
        token = made.token("all", "--scope", "write", "--scope", "control")
        with made.client(token) as tcp:
            until(lambda: tcp.get("/v1/line").status_code == 200, "the token is valid")
            for door in (made.daemon.client, tcp):
                answer = door.put("/v1/drives/feeder/codes/C0046", json={"value": 5})
                assert (answer.status_code, kind(answer)) == (403, "read-only")
                answer = door.post("/v1/drives/feeder/verbs/enable", json={})
                assert (answer.status_code, kind(answer)) == (403, "read-only")
                stop = {"action": "inhibit", "target": "feeder"}
                assert door.post("/v1/stop", json=stop).is_success
        assert made.daemon.cli("enable", "feeder").status == 4
        assert made.daemon.cli("stop").status == 0


def test_a_wrong_key_ends_the_start_with_its_reason() -> None:
    with short_dir() as folder:
        made = make_certificates(folder)
        made.path("server.key").chmod(0o644)
        tls = f"{{certificate: {made.path('server.pem')}, key: {made.path('server.key')}}}"
        roster = folder / "roster.yaml"
        roster.write_text(
            f'line: {{name: bench, port: "sim:"}}\ndrives:{DRIVES}'
            f"api: {{socket: {folder}/s, http: '127.0.0.1:0', tls: {tls}}}\n"
        )
        ended = lecombus("run", "-c", roster, within_s=30)
        assert ended.status == 1
        assert "others may read or write it: its mode is 0644" in ended.err


@pytest.mark.parametrize("group", ["no-such-group-here", "nogroup"])
def test_the_socket_belongs_to_the_group_of_the_roster(group: str) -> None:
    with short_dir() as folder:
        roster = f'line: {{name: bench, port: "sim:"}}\ndrives:{DRIVES}'
        api = f"api: {{socket: {folder}/api.sock, socket_group: {group}}}\n"
        if group == "nogroup":
            with running(roster + api, folder):
                found = (folder / "api.sock").stat()
                assert (folder / "api.sock").group() == "nogroup"
                assert found.st_mode & 0o777 == 0o660
            return
        (folder / "roster.yaml").write_text(roster + api)
        ended = lecombus("run", "-c", folder / "roster.yaml", within_s=30)
        assert ended.status == 1
        assert f"there is no group {group}" in ended.err
        assert not (folder / "api.sock").exists()


def test_a_certificate_that_soon_expires_is_said_until_another_is_read() -> None:
    metric = "lecombus_tls_certificate_expiry_timestamp_seconds"
    with site() as made:

        def remarks() -> list[str]:
            found = made.daemon.get("/v1/line").get("remarks", {})
            return [one for one in found.values() if "TLS" in one]

        assert remarks() == []
        (calm_s,) = made.daemon.metric(metric).values()
        made.made.sign("server", "/CN=localhost", 9)
        said = lecombus("check", "-c", made.daemon.roster)
        assert "server.pem: it expires on" in said.out
        assert made.daemon.cli("reload").status == 0
        # A page that is younger than a second is served again.
        until(lambda: (calm_s,) != (*made.daemon.metric(metric).values(),), "a new page")
        (soon_s,) = made.daemon.metric(metric).values()
        assert 80 * 86400 < calm_s - soon_s < 82 * 86400
        assert len(remarks()) == 1
        assert "in 8 days" in remarks()[0]
        assert "event=certificate-expires" in made.daemon.log()
        made.made.sign("server", "/CN=localhost")
        assert made.daemon.cli("reload").status == 0
        assert remarks() == []


def by_token(folder: Path, job: str, token: Path, made: Site) -> str:
    """Return the scrape job with a token that ships, with the names of this test."""
    text = SCRAPES.read_text().partition("  # - job_name: lecombus-by-token")
    rows = "".join(text[1:]).splitlines()
    shipped = "\n".join(row.replace("  # ", "  ", 1) for row in rows if "    # " not in row[5:])
    for what, here in (
        ("lecombus-by-token", job), ("/etc/prometheus/lecombus.token", token),
        ("/etc/prometheus/lecombus-ca.pem", made.made.path("ca.pem")),
        ("drives.example:9740", made.url.removeprefix("https://")),
    ):  # fmt: skip
        assert what in shipped
        shipped = shipped.replace(what, str(here))
    return shipped


def test_prometheus_scrapes_by_a_token_over_tls_and_not_by_a_wrong_one() -> None:
    with site() as made:
        folder, port = made.daemon.folder, free_port()
        token = made.token("prometheus", "--scope", "metrics")
        wrong = folder / "wrong.token"
        wrong.write_text(new_secret() + "\n")
        jobs = "\n".join(
            by_token(folder, job, file, made) for job, file in (("right", token), ("wrong", wrong))
        )
        config = folder / "prometheus.yml"
        config.write_text(f"global: {{scrape_interval: 250ms}}\nscrape_configs:\n{jobs}\n")
        words = [
            str(require("prometheus")), f"--config.file={config}",
            f"--storage.tsdb.path={folder / 'data'}", f"--web.listen-address=127.0.0.1:{port}",
        ]  # fmt: skip
        base = f"http://127.0.0.1:{port}/api/v1"
        with (
            httpx2.Client(base_url=base, trust_env=False) as api,
            started(words, folder / "prometheus.log", env=dict(os.environ)),
        ):

            def targets() -> dict[str, tuple[str, str]]:
                answer = api.get("/targets")
                found = answer.json()["data"]["activeTargets"] if answer.is_success else []
                return {one["scrapePool"]: (one["health"], one["lastError"]) for one in found}

            until(
                lambda: sorted(health for health, _ in targets().values()) == ["down", "up"],
                "one is scraped, the other not",
            )
            assert targets()["right"] == ("up", "")
            _, error = targets()["wrong"]
            assert re.search("401 Unauthorized|429 Too Many Requests", error)

            def up() -> dict[str, str]:
                found = api.get("/query", params={"query": "up"}).json()["data"]["result"]
                return {one["metric"]["job"]: one["value"][1] for one in found}

            until(lambda: up() == {"right": "1", "wrong": "0"}, "what Prometheus says of both")
        assert "lcb_" not in made.daemon.log()
