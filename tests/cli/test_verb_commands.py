"""The commands of the verbs: what they ask the daemon, and what they show."""

from __future__ import annotations

import json

import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.cli import daemon_access
from support.golden import Golden

pytestmark = pytest.mark.clock

ENABLED = (
    '{"drive": "feeder", "verb": "enable", "outcome": "verified", "reason": null, "cause": null, '
    '"remedy": null, "states": ["ready", "quick_stop", "ramp_done"], "written": [], '
    '"reading": null}'
)
PATH = "POST /v1/drives/feeder/verbs/"


@pytest.mark.parametrize("verb", ["enable", "reset-fault"])
def test_a_verb_is_asked_for_and_shown(run: Run, daemon: DaemonStub, verb: str) -> None:
    daemon.answers[PATH + verb] = (200, ENABLED)
    ran = run(verb, "feeder")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == "feeder\tenable\tverified\tready, quick stop\t\t\n"
    assert json.loads(daemon.asked[0][1]) == {}
    assert run(verb, "feeder", "--json").out == ENABLED + "\n"


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        (["35", "Hz"], {"value": 35, "unit": "Hz"}),
        (["35.4Hz"], {"value": 35.4, "unit": "Hz"}),
        (["70%"], {"value": 70, "unit": "%"}),
        (["-20", "%"], {"value": -20, "unit": "%"}),
        (["-20.5%"], {"value": -20.5, "unit": "%"}),
        (["1500", "rpm"], {"value": 1500, "unit": "rpm"}),
        (["35", "Hz", "--verify", "--expires", "2s"],
         {"value": 35, "unit": "Hz", "verify": True, "expires": "2000ms"}),
    ],
)  # fmt: skip
def test_a_speed_is_sent_with_its_unit(
    run: Run, daemon: DaemonStub, words: list[str], sent: dict[str, object]
) -> None:
    daemon.answers[PATH + "set-speed"] = (200, ENABLED)
    assert run("set-speed", "feeder", *words).status == 0
    assert json.loads(daemon.asked[0][1]) == sent


@pytest.mark.parametrize(
    "words",
    [
        ["35"],
        ["-35"],
        ["fast"],
        ["35,4", "Hz"],
        ["1.2.3", "Hz"],
        ["1e1", "Hz"],
        ["-3.5E1%"],
        ["1e99999", "Hz"],
        [],
        ["0x14", "Hz"],
    ],
)
def test_a_speed_that_is_none_is_refused_here(
    run: Run, daemon: DaemonStub, words: list[str], golden: Golden
) -> None:
    ran = run("set-speed", "feeder", *words)
    assert (ran.status, daemon.asked) == (2, [])
    golden(ran.err)
    assert "\0" not in ran.err


@pytest.mark.parametrize("action", ["inhibit", "quick-stop"])
@pytest.mark.parametrize("target", ["feeder", "all"])
def test_a_stop_by_its_own_name_is_the_same_stop(
    run: Run, daemon: DaemonStub, action: str, target: str
) -> None:
    member = '{"drive": "feeder", "code": "C0040", "outcome": "verified", "reason": "inhibited"}'
    report = f'{{"how": "one-by-one", "outcome": "verified", "members": [{member}]}}'
    daemon.answers["POST /v1/stop"] = (200, report)
    ran = run(action, target)
    assert (ran.status, ran.out) == (0, "feeder\tC0040\tverified\t\tinhibited\n")
    assert json.loads(daemon.asked[0][1]) == {"action": action, "target": target}
    assert run(action, target, "--json").out == report + "\n"


@pytest.mark.parametrize(
    ("kind", "status", "exit_status"),
    [("setting", 409, 1), ("no-such-drive", 404, 2), ("locked", 403, 4), ("bad-value", 422, 2)],
)
def test_a_refusal_is_one_line_with_its_remedy(
    run: Run, daemon: DaemonStub, kind: str, status: int, exit_status: int
) -> None:
    problem = f'{{"type": "urn:lecombus:problem:{kind}", "detail": "no", "remedy": "C0001 = 3"}}'
    daemon.answers[PATH + "enable"] = (status, problem)
    ran = run("enable", "feeder")
    assert (ran.status, ran.out, ran.err) == (exit_status, "", "no; C0001 = 3\n")


def test_a_verb_that_was_not_done_says_what_was_seen(run: Run, daemon: DaemonStub) -> None:
    problem = (
        '{"type": "urn:lecombus:problem:not-in-effect", "detail": "it does not show it", "drive":'
        ' "feeder", "verb": "enable", "outcome": "refused", "cause": "a terminal is open",'
        ' "remedy": "close it", "states": ["inhibited"], "written": []}'
    )
    daemon.answers[PATH + "enable"] = (409, problem)
    ran = run("enable", "feeder")
    assert ran.status == 1
    why = "it does not show it; a terminal is open; close it"
    assert ran.out == f"feeder\tenable\trefused\tinhibited\t\t{why}\n"


def test_what_a_daemon_that_was_ended_had_begun_is_named(run: Run, daemon: DaemonStub) -> None:
    """After a restart it knows the key of the request, and neither drive nor verb."""
    problem = '{"outcome": "unknown", "detail": "lecombus ended this", "remedy": "look at it"}'
    daemon.answers[PATH + "enable"] = (504, problem)
    said = "feeder may have taken the enable, and its motor may turn; `lecombus status feeder`"
    ran = run("enable", "feeder")
    assert ran.err.startswith(said)
    assert ran.status == 1
    assert run("enable", "feeder", "--json").err == ""
    daemon.answers[PATH + "enable"] = (504, problem.replace("{", '{"drive": "feeder", ', 1))
    assert run("enable", "feeder").err == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("enable", "feeder"), "feeder may have taken the enable, and its motor may turn; "),
        (("set-speed", "feeder", "5", "Hz"), "feeder may have taken the set-speed; "),
        (("write", "feeder", "C0046", "5"), "C0046 of feeder may have been written; "),
        (("group", "all", "C0046", "5"), "C0046 of some or all drives of all may have been "),
        (("readdress", "feeder", "12", "--yes"), "feeder may have address 12 now; "),
    ],
)
def test_a_ctrl_c_while_the_daemon_works_says_what_may_have_happened(
    run: Run, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    """The daemon goes on with what it has begun, and nobody hears how it ended."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(daemon_access, "work", interrupted)
    ran = run(*words)
    assert (ran.status, ran.out) == (130, "")
    assert ran.err.startswith(f"interrupted: {said}")
    assert run(*words, "--json").err == ""
