"""Commands of the MQTT bridge: which are carried out, how often, what the daemon is asked."""

from __future__ import annotations

import asyncio
import json
import random
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from math import inf
from pathlib import Path
from typing import Any

import anyio
import anyio.lowlevel
import httpx2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from client.conftest import line_of
from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.commands import WAITING_MOST, Commands, Pulse, key_of
from lecombus.bridges.mqtt.retained import Message
from lecombus.bridges.mqtt.seen_commands import SeenCommands
from lecombus.bridges.mqtt.stop_lanes import AT_ONCE, LANES_MOST
from lecombus.bridges.mqtt.topics import Topics
from lecombus.client import Line, UnreachableError
from support.virtual_loop import run

ROOT = "lecombus/hall-3"


class Asked:
    """A daemon that remembers what was asked; answers `done`, or as `answers` says."""

    def __init__(self) -> None:
        self.requests: list[tuple[str, str, Any, dict[str, str]]] = []
        self.takes_s = 0.0
        self.answer: tuple[int, dict[str, Any]] = (200, {"outcome": "done"})
        self.is_gone = False

    async def __call__(self, request: httpx2.Request) -> httpx2.Response:
        body = json.loads(request.content) if request.content else None
        self.requests.append((request.method, request.url.path, body, dict(request.headers)))
        await anyio.sleep(self.takes_s)
        return httpx2.Response(self.answer[0], json=self.answer[1])

    @asynccontextmanager
    async def connect(self, socket: str) -> AsyncIterator[Line]:
        if self.is_gone:
            raise UnreachableError("no daemon answers")
        line = line_of(httpx2.MockTransport(self))
        async with line.connection.http:
            yield line

    @property
    def paths(self) -> list[str]:
        return [f"{method} {path}" for method, path, _, _ in self.requests]


class Bench:
    """Commands without a broker."""

    def __init__(self, file: Path | None = None, *, control: bool = True) -> None:
        self.daemon = Asked()
        self.answers: list[Message] = []
        self.pulse = Pulse()
        self.pulse.proven(1000.0, -inf)

        async def answer(message: Message) -> None:
            self.answers.append(message)

        self.commands = Commands(
            Topics("lecombus", "hall-3"), "/run/x.sock", control=control,
            home_assistant="homeassistant", seen=SeenCommands(file), pulse=self.pulse,
            answer=answer, is_drive=lambda name: name == "feeder", connect_to=self.daemon.connect,
        )  # fmt: skip

    def take(self, topic: str, payload: bytes | str = b"", **more: Any) -> None:
        given: dict[str, Any] = {
            "qos": 2, "is_retained": False, "came_s": anyio.current_time(),
            "response_topic": "answers/x",
        }  # fmt: skip
        data = payload.encode() if isinstance(payload, str) else payload
        incoming = Incoming(f"{ROOT}/{topic}", data, **given | more)
        # As the library does: outside of any task.
        asyncio.get_running_loop().call_soon(self.commands.take, incoming)

    @property
    def outcomes(self) -> list[str]:
        return [json.loads(one.payload)["outcome"] for one in self.answers]

    @property
    def kinds(self) -> list[str | None]:
        return [json.loads(one.payload).get("kind") for one in self.answers]


def with_bench(script: Callable[[Bench], Awaitable[None]], bench: Bench | None = None) -> None:
    async def work() -> None:
        used = bench or Bench()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(used.commands.run)
            await anyio.lowlevel.checkpoint()
            await script(used)
            tasks.cancel_scope.cancel()

    run(work())


def one(topic: str, payload: bytes | str = b"", *, control: bool = True, **more: Any) -> Bench:
    """Send one command, and wait for its end."""
    kept: list[Bench] = []

    async def script(bench: Bench) -> None:
        kept.append(bench)
        bench.take(topic, payload, **more)
        await anyio.sleep(1)

    with_bench(script, None if control else Bench(control=False))
    return kept[0]


@pytest.mark.parametrize(
    ("topic", "payload", "asked", "body"),
    [
        ("feeder/set/C0046", "35.40", "PUT /v1/drives/feeder/codes/C0046", {"value": "35.40"}),
        ("feeder/set/C0046", "520", "PUT /v1/drives/feeder/codes/C0046", {"value": "520"}),
        ("feeder/set/C0135", "H0008", "PUT /v1/drives/feeder/codes/C0135", {"value": "H0008"}),
        # Digits for a word are refused by the daemon, with both readings: they reach it as text.
        ("feeder/set/C0135", "208", "PUT /v1/drives/feeder/codes/C0135", {"value": "208"}),
        ("feeder/set/C0135", '{"value": 520}', "PUT /v1/drives/feeder/codes/C0135", {"value": 520}),
        ("feeder/set/C0135", "0208", "PUT /v1/drives/feeder/codes/C0135", {"value": "0208"}),
        ("feeder/set/C0046", "true", "PUT /v1/drives/feeder/codes/C0046", {"value": "true"}),
        ("feeder/set/c0039/1", '{"value": 1, "verify": true}',
         "PUT /v1/drives/feeder/codes/C0039/1", {"value": 1, "verify": True}),
        ("pumps/set/C0046", "20", "PUT /v1/groups/pumps/codes/C0046", {"value": "20"}),
        ("feeder/do/enable", "", "POST /v1/drives/feeder/verbs/enable", {}),
        ("feeder/do/reset-fault", "PRESS", "POST /v1/drives/feeder/verbs/reset-fault", {}),
        ("feeder/do/set-speed", "35.4 Hz", "POST /v1/drives/feeder/verbs/set-speed",
         {"value": 35.4, "unit": "Hz"}),
        ("feeder/do/set-speed", '{"value": 50, "unit": "%"}',
         "POST /v1/drives/feeder/verbs/set-speed", {"value": 50, "unit": "%"}),
    ],
)  # fmt: skip
def test_a_command_becomes_one_request(
    topic: str, payload: str, asked: str, body: dict[str, Any]
) -> None:
    bench = one(topic, payload)
    assert bench.daemon.paths == [asked]
    _, _, document, headers = bench.daemon.requests[0]
    assert document == {**body, "expires": "5000ms"}
    assert headers["lecombus-by"] == "mqtt"
    assert headers["idempotency-key"]
    assert float(headers["lecombus-asked"]) < 0.1
    assert bench.outcomes == ["done"]


@pytest.mark.parametrize(
    ("topic", "payload", "more", "kind"),
    [
        ("feeder/do/enable", "", {"is_retained": True}, "retained"),
        ("feeder/do/quick-stop", "", {"is_retained": True}, "retained"),
        ("feeder/do/enable", "", {"qos": 1}, "no-key"),
        ("feeder/do/enable", "0", {}, "bad-value"),
        ("feeder/do/enable", "OFF", {}, "bad-value"),
        ("feeder/do/dance", "", {}, "no-verb"),
        ("feeder/do/set-speed", "35.4", {}, "bad-value"),
        ("feeder/set/C0046", "", {}, "bad-value"),
        ("feeder/set/C0046", b"\xff", {}, "bad-value"),
        ("feeder/set/C0046", '{"value": 1, "value": 2}', {}, "bad-value"),
        ("feeder/set/C0046", '{"value": NaN}', {}, "bad-value"),
        ("feeder/set/C0046", '{"value": ' + "[" * 9000, {}, "bad-value"),
        ("feeder/set/C0046", '{"value": 1e99999999999999999999}', {}, "bad-value"),
        ("feeder/set/C0046", '{"value": 1, "expires": true}', {}, "bad-value"),
        ("feeder/set/C0046", '{"value": 1, "expires": "soon"}', {}, "bad-value"),
        ("feeder/set/C0046", '{"value": 1, "expires": "0s"}', {}, "expired"),
        ("feeder/set/C0046", "1", {"expiry_s": 0}, "expired"),
        ("feeder/set/frequency", "1", {}, "no-such-code"),
        ("../set/C0046", "1", {}, "no-such-drive"),
    ],
)
def test_what_is_not_carried_out_sends_nothing(
    topic: str, payload: bytes | str, more: dict[str, Any], kind: str
) -> None:
    bench = one(topic, payload, **more)
    assert bench.daemon.requests == []
    assert bench.kinds == [kind]
    assert bench.outcomes == ["expired" if kind == "expired" else "refused"]


def test_without_control_only_stops_are_carried_out() -> None:
    assert one("feeder/do/enable", control=False).kinds == ["not-permitted"]
    assert one("feeder/set/C0046", "1", control=False).kinds == ["not-permitted"]
    bench = one("all/do/inhibit", "any payload", control=False)
    assert bench.daemon.requests[0][:3] == (
        "POST", "/v1/stop", {"action": "inhibit", "target": "all"},
    )  # fmt: skip


def test_an_answer_carries_what_its_asker_knows_it_by() -> None:
    (answer,) = one("feeder/do/enable", correlation=b"\x00\x01").answers
    assert (answer.topic, answer.response, answer.is_retained) == ("answers/x", b"\x00\x01", False)
    assert answer.expiry_s == 60
    assert one("feeder/do/enable", response_topic="").answers == []
    bench = one("feeder/do/enable", response_topic=f"{ROOT}/feeder/do/enable")
    assert (len(bench.daemon.requests), bench.answers) == (1, [])


def test_a_command_that_comes_again_is_answered_again_and_not_carried_out_again() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 0.5
        for _ in range(3):  # the second comes while the first is under way
            bench.take("feeder/do/enable", correlation=b"a", qos=1)
        await anyio.sleep(3)
        bench.take("feeder/do/enable", correlation=b"b")
        bench.take("feeder/do/enable", correlation=b"a", response_topic="answers/y")
        await anyio.sleep(3)
        assert len(bench.daemon.requests) == 3
        assert bench.outcomes == ["done"] * 5
        assert ["repeated" in json.loads(one.payload) for one in bench.answers] == [
            False, True, True, False, False,
        ]  # fmt: skip

    with_bench(script)


def test_correlation_data_of_another_command_does_not_give_its_outcome() -> None:
    """`done` of the 20 would be taken for that of the 0, which is never sent."""

    async def script(bench: Bench) -> None:
        for payload in ("20", "0", '{"value": "20", "expires": "3s"}', '{"value": 20', "20"):
            bench.take("feeder/set/C0046", payload, correlation=b"a")
            await anyio.sleep(1)
        assert [body["value"] for _, _, body, _ in bench.daemon.requests] == ["20"]
        assert bench.outcomes == ["done", "refused", "done", "refused", "done"]
        assert bench.kinds == [None, "key-reused", None, "key-reused", None]

    with_bench(script)


def test_a_command_that_came_before_a_restart_is_not_carried_out_again(tmp_path: Path) -> None:
    file = tmp_path / "commands"

    SeenCommands(file).note(key_of_enable())

    async def second(bench: Bench) -> None:
        bench.take("feeder/do/enable", correlation=b"a")
        await anyio.sleep(1)
        assert bench.daemon.requests == []
        assert (bench.outcomes, bench.kinds) == (["unknown"], ["repeated"])

    with_bench(second, Bench(file))


def key_of_enable() -> str:
    return key_of(Incoming(f"{ROOT}/feeder/do/enable", b"", 2, False, 0, None, "answers/x", b"a"))


def test_a_stop_waits_for_nothing_and_is_carried_out_each_time() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 2.0
        bench.take("feeder/set/C0046", "1")
        await anyio.sleep(0.1)
        for _ in range(2):
            bench.take("feeder/do/quick-stop", correlation=b"s", qos=1)
        await anyio.sleep(0.1)
        assert bench.daemon.paths[1:] == ["POST /v1/stop"] * 2
        await anyio.sleep(5)

    with_bench(script)


def test_commands_of_a_drive_keep_their_order_and_their_time() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 2.0
        for number in range(4):
            bench.take("feeder/set/C0046", f"{number}")
        bench.take("belt/do/enable")
        await anyio.sleep(0.1)
        assert bench.daemon.paths == [
            "PUT /v1/drives/feeder/codes/C0046", "POST /v1/drives/belt/verbs/enable",
        ]  # fmt: skip
        await anyio.sleep(9)
        writes = [one for one in bench.daemon.requests if one[0] == "PUT"]
        assert [one[2]["value"] for one in writes] == ["0", "1", "2"], "the fourth was over"
        assert [round(float(one[3]["lecombus-asked"])) for one in writes] == [0, 2, 4]
        assert sorted(bench.outcomes) == ["done"] * 4 + ["expired"]

    with_bench(script)


@pytest.mark.parametrize(
    ("proven_ago_s", "expiry_s", "outcome"),
    [
        (1, None, "done"),
        (4, None, "done"),
        (6, None, "expired"),
        (6, 60, "done"),
        (90, 60, "expired"),
    ],
)
def test_a_command_that_may_have_been_late_counts_as_late(
    proven_ago_s: float, expiry_s: int | None, outcome: str
) -> None:
    async def script(bench: Bench) -> None:
        bench.pulse.proven(anyio.current_time() - proven_ago_s, anyio.current_time())
        bench.take("feeder/do/enable", expiry_s=expiry_s)
        bench.take("feeder/do/quick-stop")
        await anyio.sleep(1)
        assert sorted(bench.outcomes) == sorted([outcome, "done"])
        for method, path, _, headers in bench.daemon.requests:
            if path.endswith("enable") and proven_ago_s > 2.5:
                assert method == "POST"
                assert float(headers["lecombus-asked"]) >= proven_ago_s

    with_bench(script)


def test_how_late_a_command_was_is_what_was_known_when_it_came() -> None:
    """A bridge that stood finds old commands; a later pulse says nothing of those that wait."""

    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 2.0
        bench.take("feeder/set/C0046", "10")
        await anyio.sleep(0.5)
        bench.pulse.proven(anyio.current_time() - 60, anyio.current_time())  # it stood
        bench.take("feeder/do/enable")
        bench.take("feeder/do/enable", expiry_s=90)
        await anyio.lowlevel.checkpoint()
        bench.pulse.proven(anyio.current_time() + 0.1, anyio.current_time())
        await anyio.sleep(5)
        assert bench.outcomes == ["done", "expired", "done"]
        assert float(bench.daemon.requests[1][3]["lecombus-asked"]) >= 61

    with_bench(script)


def test_a_pulse_that_overtakes_the_handshake_of_a_command_does_not_make_it_new() -> None:
    """With QoS 2 a command is handed out after a further exchange with the broker."""

    async def script(bench: Bench) -> None:
        bench.pulse.proven(anyio.current_time() - 60, anyio.current_time())  # it stood
        read_s = anyio.current_time()
        await anyio.sleep(0.01)
        bench.pulse.proven(anyio.current_time() - 0.001, anyio.current_time())
        await anyio.sleep(0.01)
        bench.take("feeder/do/enable", came_s=read_s)
        bench.take("feeder/set/C0046", "10")
        await anyio.sleep(1)
        assert sorted(bench.outcomes) == ["done", "expired"]
        assert [one[0] for one in bench.daemon.requests] == ["PUT"]

    with_bench(script)


@pytest.mark.parametrize(("slept_s", "outcome"), [(0.0, "done"), (60.0, "expired")])
@pytest.mark.parametrize("waits", [False, True])
def test_a_computer_that_slept_finds_old_commands(
    monkeypatch: pytest.MonkeyPatch, slept_s: float, outcome: str, waits: bool
) -> None:
    """The clock of the event loop stands while the computer sleeps."""
    slept = [1000.0]  # before the bridge was started
    monkeypatch.setattr("lecombus.bridges.mqtt.commands.slept_s", lambda: slept[0])

    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 1.0
        bench.pulse.proven(bench.pulse.now_s(), anyio.current_time())
        bench.take("feeder/set/C0046", "10")
        await anyio.sleep(0.5)
        if waits:
            bench.take("feeder/do/enable")
            await anyio.lowlevel.checkpoint()
        slept[0] += slept_s
        if not waits:
            bench.take("feeder/do/enable")
        await anyio.sleep(5)
        assert bench.outcomes == ["done", outcome]

    with_bench(script)


def test_too_many_commands_are_refused_and_answered() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 60.0
        for _ in range(WAITING_MOST + 5):
            bench.take("feeder/do/enable")
        await anyio.sleep(1)
        assert bench.kinds == ["busy"] * 5

    with_bench(script)


def test_a_flood_of_one_stop_is_carried_out_as_few_and_holds_up_no_other() -> None:
    """Of each stop that came, one went out then or later; those that waited share its outcome."""

    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 1.0
        for number in range(1000):
            bench.take("feeder/do/quick-stop", correlation=f"{number}".encode())
        await anyio.sleep(0.5)
        assert bench.daemon.paths == ["POST /v1/stop"] * AT_ONCE
        bench.take("belt/do/quick-stop", correlation=b"belt")
        bench.take("feeder/do/inhibit", correlation=b"inhibit")
        await anyio.sleep(0.1)
        assert len(bench.daemon.requests) == AT_ONCE + 2, "at the same time"
        await anyio.sleep(1)
        assert len(bench.daemon.requests) == AT_ONCE + 3, "and one for all that came meanwhile"
        assert bench.daemon.requests[-1][2] == {"action": "quick-stop", "target": "feeder"}
        await anyio.sleep(5)
        assert len(bench.daemon.requests) == AT_ONCE + 3
        assert set(bench.outcomes) == {"done"}
        assert len(bench.answers) == AT_ONCE + 2 + WAITING_MOST, "a bounded memory"
        bench.take("feeder/do/quick-stop")
        await anyio.sleep(0.1)
        assert len(bench.daemon.requests) == AT_ONCE + 4

    with_bench(script)


def test_stops_of_what_there_is_not_take_no_room_from_those_of_drives() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.takes_s = 60.0
        for number in range(2000):
            bench.take(f"made-up-{number}/do/quick-stop")
        await anyio.sleep(1)
        assert len(bench.daemon.requests) == LANES_MOST
        assert set(bench.kinds) == {"busy"}
        for target in ("feeder", "all"):
            bench.take(f"{target}/do/quick-stop")
        await anyio.sleep(1)
        asked = {body["target"] for _, _, body, _ in bench.daemon.requests[LANES_MOST:]}
        assert asked == {"feeder", "all"}

    with_bench(script)


def test_answers_that_the_broker_does_not_take_are_bounded_and_a_stop_goes_out_all_the_same() -> (
    None
):
    waiting = most = 0

    async def script(bench: Bench) -> None:
        async def never(message: Message) -> None:
            nonlocal waiting, most
            waiting += 1
            most = max(most, waiting)
            await anyio.sleep_forever()

        bench.commands._answer = never
        bench.daemon.takes_s = 100.0
        for _ in range(50):
            for _ in range(100):
                bench.take("feeder/set/C0046", "5")
            await anyio.sleep(0.01)
        bench.take("feeder/do/quick-stop")
        await anyio.sleep(0.1)
        assert bench.daemon.paths[-1] == "POST /v1/stop"

    with_bench(script)
    assert most == WAITING_MOST


def test_a_daemon_that_is_away_or_does_not_answer_is_said() -> None:
    async def script(bench: Bench) -> None:
        bench.daemon.is_gone = True
        bench.take("feeder/do/enable")
        await anyio.sleep(1)
        assert (bench.outcomes, bench.kinds) == (["refused"], ["daemon-away"])

    with_bench(script)


class KeptHere(SeenCommands):
    """Kept in a file, without a thread, which no virtual time waits for."""

    is_kept = False


def test_of_a_thousand_commands_sent_twice_none_is_carried_out_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Across ends of the bridge and hours without a broker, with repeats under way."""
    monkeypatch.setattr("os.fdatasync", lambda descriptor: None)
    chance = random.Random(13)
    asked: Counter[str] = Counter()
    wanted = [f"{number}" for number in range(1000)]
    answered: set[bytes] = set()
    for _ in range(4):  # four runs of the bridge
        bench = Bench(tmp_path / "commands")
        bench.commands._seen = KeptHere(tmp_path / "commands")

        async def script(bench: Bench) -> None:
            await anyio.sleep(3600)  # nothing comes; then what was sent before comes again
            bench.pulse.proven(anyio.current_time() + 3600, anyio.current_time())
            for number in chance.sample(wanted, 700):
                for _ in range(2):
                    bench.take("feeder/set/C0046", number, correlation=number.encode(), qos=1,
                               expiry_s=3600)  # fmt: skip
                bench.daemon.takes_s = chance.choice([0.0, 0.05])
                if chance.random() < 0.05:
                    await anyio.sleep(chance.random())
                await anyio.sleep(0.02)
            # Cancelled here, with commands that wait and one that may be under way.

        with_bench(script, bench)
        asked.update(str(body["value"]) for _, _, body, _ in bench.daemon.requests)
        answered |= {one.response for one in bench.answers if one.response is not None}
    assert max(asked.values()) == 1
    assert len(asked) > 600
    assert len(answered) > len(asked) * 0.9


@given(
    st.sampled_from(["feeder/set/C0046", "feeder/do/set-speed", "feeder/do/enable", "x/set/P1"]),
    st.one_of(
        st.binary(max_size=60),
        st.text(max_size=60).map(lambda text: text.encode(errors="replace")),
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=9),
            lambda inner: st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["value", "unit", "expires", "verify", "\ud800"]),
                              inner, max_size=4),
            max_leaves=6,
        ).map(lambda found: json.dumps(found).encode()),
        st.sampled_from([b'{"value": 1e99999999}', b"9" * 5000, b'{"expires": 1e400}',
                         b'{"value": "\\ud800"}', b'{"\\ud800": 1}', b'{"expires": "9999999h"}',
                         b'{"expires": -1}', b"\x00", b'{"value": -0.0}']),
    ),
    st.one_of(st.none(), st.binary(max_size=9)),
    st.one_of(st.none(), st.integers(0, 2**32 - 1)),
)  # fmt: skip
@settings(max_examples=300, deadline=None)
def test_whatever_comes_is_answered_with_one_outcome(
    topic: str, payload: bytes, correlation: bytes | None, expiry_s: int | None
) -> None:
    bench = one(topic, payload, correlation=correlation, expiry_s=expiry_s)
    assert len(bench.answers) == 1
    assert bench.outcomes[0] in ("done", "refused", "expired")
    assert len(bench.daemon.requests) <= 1
