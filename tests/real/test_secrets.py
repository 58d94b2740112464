"""The password of a drive is shown at no door but to those who ask for it."""

from __future__ import annotations

import pytest

from support.daemon_host import lecombus, running, short_dir, until

pytestmark = pytest.mark.real

PASSWORD = "4711"


def test_a_password_of_a_drive_stands_nowhere() -> None:
    """No family describes P194; its number is enough."""
    with short_dir() as folder:
        roster = (
            'line: {name: bench, port: "sim:", baud: 19200}\n'
            "drives: [{name: belt, address: 12, family: smvector, also_writable: [P194]}]\n"
            f"api: {{socket: {folder}/api.sock}}\njournal: {{file: {folder}/journal.db}}\n"
        )
        with running(roster, folder) as daemon:
            daemon.until_online()
            with daemon.client.stream("GET", "/v1/events") as events:
                for door in ("drives/belt", "groups/all"):
                    path = f"/v1/{door}/codes/P194"
                    answer = daemon.client.put(path, json={"value": int(PASSWORD)})
                    assert answer.status_code != 403, answer.text
                assert daemon.client.get("/v1/drives/belt/codes/P194?fresh=true").is_success
                until(lambda: daemon.log().count('value="***"') == 2, "both writes in the log")
                said = ""
                for part in events.iter_text():
                    said += part
                    if said.count("event: write") >= 2:
                        break
            backup = folder / "belt.backup"
            assert daemon.cli("backup", "belt", "-o", backup, within_s=60).status == 0
            shown = {
                "events": said,
                "log": daemon.log(),
                "journal": daemon.cli("journal", "--json").out,
                "metrics": daemon.client.get("/metrics").text,
                "backup": backup.read_text(),
                "status": daemon.cli("status", "belt").out,
                "all drives": daemon.client.get("/v1/drives").text,
                "the drive": daemon.client.get("/v1/drives/belt").text,
            }
            assert [door for door, text in shown.items() if PASSWORD in text] == []
            assert '"***"' in shown["journal"]
            lists = ("metrics", "backup", "all drives", "the drive")
            assert [door for door in lists if "1194" in shown[door]] == []
            assert daemon.end() == 0
        roster = roster.replace("also_writable: [P194]", "cyclic: [{code: P194, every: 1s}]")
        (folder / "roster.yaml").write_text(roster)
        refused = lecombus("check", "-c", folder / "roster.yaml")
        assert refused.status == 2
        assert "P194 is a password, so it is not read unasked" in refused.err
