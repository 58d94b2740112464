"""What is known of many lines: nothing old, lost or not understood is ever shown as fine."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.fleet.lines import LINES_MOST, FleetLines, LineView, filters_of, rank_of, total

ROOT = "lecombus"


def summary(bridge: str = "a", **more: Any) -> bytes:
    said: dict[str, Any] = {
        "line": "x", "bridge": bridge, "host": f"host-{bridge}", "version": "1", "state": "online",
        "reason": None, "stands_s": 30, "drives": {"online": 4}, "doing": {"running": 4}, "more": 0,
        "attention": [],
    }  # fmt: skip
    return json.dumps({**said, **more}).encode()


def need(kind: str, drive: str | None = "feeder", for_s: float = 5.0) -> dict[str, Any]:
    return {"kind": kind, "drive": drive, "text": f"{kind} of {drive}", "for_s": for_s}


class Scene:
    """A fleet whose broker has shown all that stood there."""

    def __init__(self, *prefixes: str, expected: frozenset[str] = frozenset()) -> None:
        self.lines = FleetLines(prefixes or (ROOT,), expected)
        self.now_s = 1000.0
        self.lines.began()

    def well(self, name: str, **more: Any) -> None:
        self.state(name, "online")
        self.summary(name, **more)

    def state(self, name: str, word: str, *, retained: bool = False, reason: str = "") -> None:
        self.take(f"{ROOT}/{name}/state", word.encode(), retained=retained, reason=reason)

    def summary(
        self, name: str, *, retained: bool = False, expiry_s: int | None = 30, bridge: str = "a",
        **more: Any,
    ) -> None:  # fmt: skip
        payload = summary(bridge, **more)
        self.take(f"{ROOT}/{name}/summary", payload, retained=retained, expiry_s=expiry_s)

    def take(
        self, topic: str, payload: bytes, *, retained: bool = False, expiry_s: int | None = None,
        reason: str = "",
    ) -> None:  # fmt: skip
        self.lines.take(
            topic, payload, self.now_s, is_retained=retained, expiry_s=expiry_s, reason=reason
        )

    def views(self) -> list[LineView]:
        return self.lines.views(self.now_s)

    def view(self, name: str) -> LineView:
        return next(one for one in self.views() if one.name == name)

    def statuses(self) -> dict[str, str]:
        return {one.name: one.status for one in self.views()}


@pytest.fixture
def scene() -> Scene:
    made = Scene()
    made.lines.settled()
    return made


def test_a_line_is_ok_while_its_summary_stands_and_not_longer(scene: Scene) -> None:
    scene.well("hall-3")
    scene.now_s += 29.9
    view = scene.view("hall-3")
    assert (view.status, view.drives, view.host) == ("ok", {"online": 4}, "host-a")
    assert view.age_s == pytest.approx(29.9)
    scene.now_s += 0.2
    view = scene.view("hall-3")
    assert (view.status, view.drives, view.doing) == ("no-news", {"unknown": 4}, {"unknown": 4})
    assert view.needs[0].for_s == pytest.approx(30.1)
    scene.summary("hall-3")
    assert scene.view("hall-3").status == "ok"


def test_what_stood_at_the_broker_is_as_old_as_its_expiry_says(scene: Scene) -> None:
    scene.state("hall-3", "online", retained=True)
    trip = need("trip", for_s=5)
    scene.summary("hall-3", retained=True, expiry_s=12, attention=[trip])
    view = scene.view("hall-3")
    assert view.age_s == 18
    assert view.needs[0].for_s == 23
    scene.now_s += 12
    assert scene.view("hall-3").status == "no-news"


def test_what_stood_at_the_broker_without_an_expiry_is_not_believed(scene: Scene) -> None:
    scene.state("hall-3", "online", retained=True)
    scene.summary("hall-3", retained=True, expiry_s=None)
    view = scene.view("hall-3")
    assert view.status == "no-news"
    assert "MQTT 5" in view.needs[0].text
    scene.summary("hall-3", expiry_s=None)  # sent now
    assert scene.view("hall-3").status == "ok"
    scene.now_s += 30
    assert scene.view("hall-3").status == "no-news"


def test_an_expiry_longer_than_the_bridge_gives_does_not_make_it_last(scene: Scene) -> None:
    scene.well("hall-3", expiry_s=100_000)
    scene.now_s += 31
    assert scene.view("hall-3").status == "no-news"


def test_a_state_alone_proves_nothing(scene: Scene) -> None:
    scene.state("hall-3", "online", retained=True)
    assert scene.view("hall-3").status == "no-news"
    assert scene.view("hall-3").age_s is None


@pytest.mark.parametrize(
    ("word", "status", "drives"),
    [
        ("offline", "bridge-offline", {"unknown": 4}),
        ("daemon-away", "daemon-away", {"unknown": 4}),
        ("lost", "line-lost", {"online": 4}),
        ("closed", "line-closed", {"online": 4}),
        ("dancing", "no-news", {"unknown": 4}),
    ],
)
def test_a_state_that_is_not_online_counts_at_once(
    scene: Scene, word: str, status: str, drives: dict[str, int]
) -> None:
    scene.well("hall-3", attention=[need("trip")])
    scene.state("hall-3", word, reason="why")
    scene.now_s += 2
    view = scene.view("hall-3")
    assert (view.status, view.drives) == (status, drives)
    assert "why" in view.needs[0].text or word == "dancing"
    assert view.needs[0].for_s == 2
    assert ("trip" in [one.kind for one in view.needs]) is ("online" in drives)


def test_a_worse_state_in_the_summary_counts_too(scene: Scene) -> None:
    scene.well("hall-3", state="daemon-away", reason="gone")
    assert scene.view("hall-3").status == "daemon-away"


def test_a_bridge_whose_return_was_not_heard_is_back_when_it_sends_a_summary(scene: Scene) -> None:
    scene.well("hall-3")
    scene.state("hall-3", "offline")
    scene.now_s += 1
    scene.summary("hall-3")  # sent before it was lost
    assert scene.view("hall-3").status == "bridge-offline"
    scene.now_s += 20
    scene.summary("hall-3", retained=True)  # stood there
    assert scene.view("hall-3").status == "bridge-offline"
    scene.summary("hall-3")
    assert scene.view("hall-3").status == "ok"


def test_the_worst_stands_first_and_ok_last(scene: Scene) -> None:
    kinds = [
        "trip", "watchdog-missed", "drive-offline", "no-controller", "lease-lapsed", "stale-value",
        "bad-value", "degraded", "starting", "fault", "remark",
    ]  # fmt: skip
    for kind in ["ok", *reversed(kinds)]:
        scene.well(f"l-{kind}", attention=[] if kind == "ok" else [need(kind)])
    scene.well("l-future", attention=[need("from-a-newer-bridge")])
    for word in ("closed", "lost", "daemon-away", "offline"):
        scene.state(f"l-{word}", word)
    scene.state("l-quiet", "online")
    order = [one.name.removeprefix("l-") for one in scene.views()]
    assert order == [
        "offline", "quiet", "daemon-away", "lost", "closed", *kinds[:8], "future", *kinds[8:], "ok"
    ]  # fmt: skip
    assert rank_of("ok") > rank_of("remark") > rank_of("trip")


def test_the_worst_need_of_a_line_stands_first_in_it(scene: Scene) -> None:
    scene.well("a", attention=[need("remark", None), need("trip", "fan"), need("degraded")])
    view = scene.view("a")
    assert [one.kind for one in view.needs] == ["trip", "degraded", "remark"]
    assert view.document()["attention"][2] == {
        "kind": "remark", "drive": None, "text": "remark of None", "for_s": 5.0,
    }  # fmt: skip


def test_without_the_broker_nothing_is_known(scene: Scene) -> None:
    scene.well("a")
    scene.well("b", attention=[need("trip")])
    scene.lines.lost("Connection refused", scene.now_s)
    scene.now_s += 7
    assert set(scene.statuses().values()) == {"unknown"}
    view = scene.view("b")
    assert (view.drives, view.age_s, view.needs[0].for_s) == ({"unknown": 4}, 7, 7)
    scene.lines.lost("it does not answer", scene.now_s)
    assert scene.view("a").needs[0].for_s == 7  # since the first loss


def test_after_the_broker_is_back_every_line_must_be_shown_again(scene: Scene) -> None:
    for name in ("a", "b", "c"):
        scene.well(name)
    scene.lines.lost("gone", scene.now_s)
    scene.lines.began()
    scene.state("a", "online", retained=True)
    scene.summary("a", retained=True, expiry_s=20)
    scene.state("b", "online", retained=True)
    assert scene.statuses() == {"a": "ok", "b": "no-news", "c": "unknown"}
    scene.lines.settled()
    assert scene.statuses() == {"a": "ok", "b": "no-news", "c": "no-news"}


def test_a_line_that_is_expected_and_not_there_is_missing() -> None:
    scene = Scene(expected=frozenset(("a", "z")))
    scene.well("a")
    assert scene.statuses() == {"a": "ok"}  # not all that stands there has come yet
    scene.lines.settled()
    assert scene.statuses() == {"a": "ok", "z": "missing"}
    assert scene.views()[0].name == "z"
    scene.lines.lost("gone", scene.now_s)
    assert scene.statuses() == {"a": "unknown", "z": "unknown"}


def test_a_line_whose_state_is_removed_is_no_more(scene: Scene) -> None:
    scene.well("a")
    scene.take(f"{ROOT}/a/state", b"")
    assert scene.views() == []


def test_a_summary_that_stands_without_a_state_is_not_believed(scene: Scene) -> None:
    """A bridge was lost, and a person removed its state while its last summary still stood."""
    scene.summary("a", retained=True, expiry_s=20)
    scene.lines.settled()
    (view,) = scene.views()
    assert (view.status, set(view.drives)) == ("no-news", {"unknown"})
    assert view.needs[0].text.startswith("no state of it stands at the broker")
    scene.summary("a")  # that it is sent now shows that the bridge is there
    assert scene.view("a").status == "ok"


def test_a_bridge_that_ends_removes_its_summary(scene: Scene) -> None:
    scene.well("a")
    scene.take(f"{ROOT}/a/summary", b"")
    assert scene.statuses() == {"a": "no-news"}
    scene.take(f"{ROOT}/b/summary", b"")
    assert scene.statuses() == {"a": "no-news"}


def test_two_bridges_of_one_name_are_found(scene: Scene) -> None:
    scene.well("a", bridge="first")
    scene.now_s += 5
    scene.well("a", bridge="second")  # a bridge that was started again
    assert scene.view("a").status == "ok"
    scene.now_s += 5
    scene.well("a", bridge="first")
    view = scene.view("a")
    assert view.status == "name-clash"
    assert view.needs[0].text == "two bridges use this name, on host-first and host-second"
    for _ in range(12):
        scene.now_s += 20
        scene.well("a", bridge="first")
    assert scene.view("a").status == "ok"


def test_lines_of_one_name_under_two_prefixes_are_two() -> None:
    scene = Scene("lecombus", "plant/b/lecombus")
    scene.lines.settled()
    scene.well("a")
    scene.take("plant/b/lecombus/a/state", b"offline")
    scene.take("plant/c/lecombus/a/state", b"offline")
    assert {one.root: one.status for one in scene.views()} == {
        "lecombus/a": "ok", "plant/b/lecombus/a": "bridge-offline",
    }  # fmt: skip
    assert scene.lines.ignored == 1
    assert filters_of(("a", "b"), ["state"]) == ["a/+/state", "b/+/state"]
    assert total(scene.views(), lambda one: one.drives) == {"online": 4}


@pytest.mark.parametrize(
    "payload",
    [
        b"no json", b"[]", b"null", b"3", b'"a"', b"{}", b"\xff\xfe", b"[" * 5000,
        summary(stands_s="x"), summary(stands_s=0), summary(stands_s=1e9), summary(stands_s=None),
        summary(drives=[1]), summary(drives={"online": "many"}), summary(attention={"a": 1}),
        summary(attention=[1]), summary(attention=[{"drive": "a"}]), summary(attention=None),
        summary(more="x"), summary(drives={"online": float("inf")}),
        summary(attention=[{"kind": "trip", "for_s": "x"}]),
    ],
)  # fmt: skip
def test_a_summary_that_cannot_be_read_is_never_fine(scene: Scene, payload: bytes) -> None:
    scene.take(f"{ROOT}/new/summary", payload, expiry_s=30)
    assert (scene.views(), scene.lines.ignored) == ([], 1)
    scene.well("a")
    scene.take(f"{ROOT}/a/summary", payload, expiry_s=30)
    view = scene.view("a")
    assert (view.status, view.drives) == ("no-news", {"unknown": 4})
    assert "cannot be read" in view.needs[0].text
    json.dumps(view.document(), allow_nan=False)
    scene.summary("a")
    assert scene.view("a").status == "ok"


@pytest.mark.parametrize(
    "topic",
    [
        "lecombus/state", "lecombus//state", "lecombus/a b/state", "lecombus/\x1b[31m/state",
        "lecombus/a/b/state", "other/a/state", "lecombus/a/feeder/json", "", "/",
        "lecombus/a/other", f"lecombus/{'x' * 65}/state", "lecombus/.a/state",
    ],
)  # fmt: skip
def test_foreign_topics_are_no_lines(scene: Scene, topic: str) -> None:
    scene.take(topic, b"online")
    assert (scene.views(), scene.lines.ignored) == ([], 1)


def test_a_foreign_state_is_no_line(scene: Scene) -> None:
    scene.take("lecombus/lamp/state", b"ON")
    assert (scene.views(), scene.lines.ignored) == ([], 1)


def test_the_number_of_lines_is_bounded(scene: Scene) -> None:
    for number in range(LINES_MOST + 3):
        scene.state(f"l{number}", "online")
    assert (len(scene.lines), scene.lines.left_out) == (LINES_MOST, 3)


def test_texts_and_counts_are_bounded(scene: Scene) -> None:
    scene.well(
        "a", reason="x" * 10_000, attention=[need("k" * 500, "d" * 9000)] * 500,
        drives={f"s{n}": 1 for n in range(500)},
    )  # fmt: skip
    view = scene.view("a")
    assert len(json.dumps(view.document())) < 100_000
    assert (len(view.needs), view.more) == (100, 400)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_whatever_comes_nothing_is_fine_without_a_summary_that_says_so(data: st.DataObject) -> None:
    scene = Scene()
    for _ in range(data.draw(st.integers(1, 12))):
        scene.now_s += data.draw(st.sampled_from([0, 1, 29, 31]))
        what = data.draw(
            st.sampled_from(["summary", "state", "garbage", "lost", "began", "settled"])
        )
        if what == "summary":
            retained, expiry_s = data.draw(st.booleans()), data.draw(st.sampled_from([None, 1, 30]))
            scene.summary("a", retained=retained, expiry_s=expiry_s)
        elif what == "state":
            words = ["online", "offline", "lost", "", "x"]
            scene.state("a", data.draw(st.sampled_from(words)), retained=data.draw(st.booleans()))
        elif what == "garbage":
            scene.take(f"{ROOT}/a/summary", data.draw(st.binary(max_size=40)), expiry_s=30)
        elif what == "lost":
            scene.lines.lost("gone", scene.now_s)
        else:
            getattr(scene.lines, what)()
        for view in scene.views():
            json.dumps(view.document(), allow_nan=False)
            if view.status == "ok":
                assert not scene.lines.why_away
                assert view.age_s is not None
                assert view.age_s < 30
