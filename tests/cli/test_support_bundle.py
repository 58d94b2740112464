"""The support bundle: what a maintainer needs, and not one secret that was planted."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import pytest

from lecombus.cli.support_bundle import write_bundle
from support.daemon_host import Ran, lecombus, running, short_dir
from support.rosters import roster_text

pytestmark = pytest.mark.clock

SECRETS = ("hunter2-in-a-file", "hunter2-in-a-comment", "hunter2-in-a-command", "hunter2-in-mail",
           "lcb_planted", "hunter2-no-such-key", "4711471")  # fmt: skip


def unpacked(path: Path) -> dict[str, str]:
    with tarfile.open(path) as bundle:
        found = {}
        for member in bundle.getmembers():
            file = bundle.extractfile(member)
            assert file is not None
            found[member.name.partition("/")[2]] = file.read().decode()
    return found


def planted(folder: Path) -> str:
    (folder / "mail-password").write_text("hunter2-in-a-file\n")
    sections = f"""# hunter2-in-a-comment
notify:
  command: [/usr/bin/logger, --token=hunter2-in-a-command]
  mail: {{to: [a@example.org], from: b@example.org, host: localhost, user: hunter2-in-a-file,
         password_file: {folder / "mail-password"}}}
journal: {folder / "journal.sqlite"}
"""
    own = {"feeder": "identity: {C0094: '4711471'}"}
    return roster_text([("feeder", 11, "generic")], folder=folder, own=own, sections=sections)


def bundle(folder: Path, *words: str | Path) -> tuple[Ran, dict[str, str]]:
    target = folder / "bundle.tar.gz"
    target.unlink(missing_ok=True)
    done = lecombus("support-bundle", "-c", folder / "roster.yaml", "-o", target, *words,
                    within_s=60.0)  # fmt: skip
    assert done.status == 0, done.err
    assert target.stat().st_mode & 0o777 == 0o600
    found = unpacked(target)
    whole = "\n".join(found.values())
    assert [one for one in SECRETS if one in whole] == []
    return done, found


def test_a_bundle_of_a_running_daemon_has_everything_and_no_secret() -> None:
    with short_dir() as folder, running(planted(folder), folder) as daemon:
        daemon.client.put("/v1/drives/feeder/codes/C0094", json={"value": 4711471})
        daemon.client.put("/v1/leases/x", json={"targets": ["feeder"], "time": "2s", "counter": 1})
        daemon.client.post("/v1/stop", json={"action": "inhibit", "target": "lcb_planted"})
        done, found = bundle(folder, "--json")
        assert json.loads(done.out)["parts"] == sorted(found)
        assert json.loads(found["daemon/drives.json"])["drives"][0]["drive"] == "feeder"
        assert "lecombus_build_info" in found["daemon/metrics.txt"]
        assert json.loads(found["daemon/journal.json"])["rows"]
        assert json.loads(found["system/versions.json"])["lecombus"]
        assert "exit status 0" in found["check.txt"]
        assert "exit status" in found["plan.txt"]
        assert 'identity: {C0094: "***"}' in found["roster.yaml"]
        assert f"{folder / 'mail-password'}" in found["roster.yaml"]
        assert "journalctl -u lecombus@" in found["README.txt"]
        assert "port of the roster: sim:" in found["system/serial.txt"]


@pytest.mark.parametrize("wrong", [
    "mqtt: {password: hunter2-no-such-key, host: b}\n", "password: 'hunter2-no-such-key\n",
])  # fmt: skip
def test_a_bundle_is_made_with_the_daemon_down_and_a_wrong_roster_too(wrong: str) -> None:
    with short_dir() as folder:
        (folder / "roster.yaml").write_text(planted(folder) + wrong)
        _, found = bundle(folder)
        assert "no daemon" in found["daemon/away.txt"]
        assert not [name for name in found if name.startswith("daemon/") and "away" not in name]
        assert "exit status 2" in found["check.txt"]


def test_nothing_is_written_over_and_a_roster_must_be_named() -> None:
    with short_dir() as folder:
        (folder / "roster.yaml").write_text(planted(folder))
        (folder / "mine").write_text("mine")
        words = ("-c", folder / "roster.yaml", "-o", folder / "mine")
        done = lecombus("support-bundle", *words, within_s=60.0)
        assert done.status == 2
        assert "is there already" in done.err
        assert (folder / "mine").read_text() == "mine"
        done = lecombus("support-bundle", "-c", folder / "nowhere.yaml")
        assert done.status == 2


def test_a_bundle_that_could_not_be_written_whole_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tarfile.TarFile, "addfile", fail)
    with pytest.raises(OSError, match=r"No space left .*bundle\.tar\.gz"):
        write_bundle(tmp_path / "bundle.tar.gz", "bundle", {"a.txt": "a"})
    assert list(tmp_path.iterdir()) == []
