"""Two controllers fight over a drive, over HTTP: a recorded history, and what is checked of it.

The history has what each asked, when, with the token of which grant, and what it was answered; the
drive has what it received, and when. The checker knows nothing else, above all nothing of the
daemon: answers bound from both sides when a grant, a renewal or an enable counted, and only what
holds for all moments between is held against the line:

* A setpoint or a control word that lets the drive run comes from the newest grant, before its end.
* After a lapse a setpoint comes only behind an enable under a later grant, or while the line's
  last word to the drive is a stop.
* A lapse is followed by a stop, once.
* Numbers of grants grow; a write that is refused was not received, one that is done was.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import Any

import anyio
import httpx2

from lecombus.fieldbus.lecom.simulator.drive import LogEntry
from lecombus.fieldbus.lecom.simulator.line import build
from support.api_line import app_of
from support.rosters import roster_text
from support.site_host import Plant, plainly

__all__ = ["Event", "fight", "judge"]

BAUD = 4800
TIME_S = 1.5
LENGTH_S = 60.0
SAID_S = 0.06
"""From the check before a write to its arrival: its telegram at 4800 baud, and an exchange of the
adapter."""
STOPS_S = 1.5
"""A stop arrives so long after a lapse, on this line."""
SETPOINT, CONTROL = 46, (40, 135)
DRIVES = [(name, 11 + place, "8200vector") for place, name in enumerate("abcde")]
"""They fight over the first; the others are written to, so that writes wait."""


@dataclass(frozen=True)
class Event:
    """Something that a controller asked, and how it was answered.

    Args:
        who: The controller.
        what: `grant`, `renewal`, `enable`, `setpoint` or `release`.
        number: The number of the grant whose token came with it, or of that given; 0: none.
        asked_s: When it was asked.
        answered_s: When the answer came.
        answer: `done`, or the word of the problem.
        value: The setpoint.
        time_s: Of a grant: how long it lasts.
    """

    who: str
    what: str
    number: int
    asked_s: float
    answered_s: float
    answer: str
    value: str = ""
    time_s: float = 0.0


class _Controller:
    """One of the two."""

    def __init__(self, name: str, client: httpx2.AsyncClient, seed: int, values: list[int]) -> None:
        self.events: list[Event] = []
        self._name = name
        self._client = client
        self._random = Random(f"{seed} {name}")
        self._values = values
        self._token = ""
        self._number = 0
        self._counter = 1

    async def run(self) -> None:
        """Take the drive, move it, and lose it, again and again."""
        end_s = _now() + LENGTH_S
        async with anyio.create_task_group() as tasks:
            while _now() < end_s:
                await self._take()
                tasks.start_soon(self._enable)
                for _ in range(self._random.randrange(2, 14)):
                    for _ in range(self._random.randrange(4)):  # some wait, some are under way
                        tasks.start_soon(self._set)
                    if self._random.random() < 0.1:
                        tasks.start_soon(self._set, "")
                    await anyio.sleep(self._random.uniform(0.0, 0.4))
                    await self._renew()
                await anyio.sleep(self._random.choice((0.0, 0.3, 2.5)))  # it stalls, or not
                await self._set()

    async def _take(self) -> None:
        asked: dict[str, Any] = {"targets": ["a"], "time": f"{TIME_S}s", "counter": 1}
        for over in ({}, {"take_over": "left"}, {"take_over": "right"}):
            asked_s = _now()
            answer = await self._client.put(f"/v1/leases/{self._name}", json=asked | over)
            if answer.status_code == 200:
                document = answer.json()
                self._token, self._number, self._counter = document["token"], document["number"], 1
                self._note("grant", self._number, asked_s, "done", time_s=TIME_S)
                return

    async def _renew(self) -> None:
        self._counter += 1
        asked_s, number = _now(), self._number
        answer = await self._client.put(
            f"/v1/leases/{self._name}", json={"token": self._token, "counter": self._counter}
        )
        self._note("renewal", number, asked_s, _word(answer))

    async def _enable(self) -> None:
        asked_s, number = _now(), self._number
        answer = await self._client.post("/v1/drives/a/verbs/enable", headers=self._headers())
        self._note("enable", number, asked_s, _word(answer))

    async def _set(self, token: str | None = None) -> None:
        self._values[0] += 1
        value = f"{self._values[0] / 10:.1f}"
        asked_s, number = _now(), 0 if token == "" else self._number
        answer = await self._client.put(
            f"/v1/drives/a/codes/C{SETPOINT:04d}", json={"value": value, "expires": "20s"},
            headers={} if token == "" else self._headers(),
        )  # fmt: skip
        self._note("setpoint", number, asked_s, _word(answer), value=value)

    def _headers(self) -> dict[str, str]:
        return {"Lecombus-Lease": self._token}

    def _note(self, what: str, number: int, asked_s: float, answer: str, **more: Any) -> None:
        self.events.append(Event(self._name, what, number, asked_s, _now(), answer, **more))


async def _write_to_others(client: httpx2.AsyncClient) -> None:
    """Write a setpoint to each of the other drives, and again after a while."""
    end_s, document = _now() + LENGTH_S, {"value": 5, "verify": True}
    while _now() < end_s:
        async with anyio.create_task_group() as tasks:
            for name, _, _ in DRIVES[1:]:
                path = f"/v1/drives/{name}/codes/C{SETPOINT:04d}"
                tasks.start_soon(partial(client.put, path, json=document))
        await anyio.sleep(1.5)


def _now() -> float:
    return asyncio.get_running_loop().time()


def _word(answer: httpx2.Response) -> str:
    if answer.status_code == 200:
        return str(answer.json().get("outcome", "done"))
    return str(answer.json()["type"]).rpartition(":")[2]


def fight(seed: int) -> tuple[list[Event], list[LogEntry]]:
    """Let two controllers fight; give what they asked, and what the drive received."""
    roster = roster_text(
        DRIVES, baud=BAUD, own={"a": "lease: {required: true, time: 2s}"},
        drive="cyclic: [{code: C0150, every: 300ms}]",
    )  # fmt: skip
    found: list[Event] = []
    received: list[LogEntry] = []

    async def main() -> None:
        line = build(DRIVES, baud=BAUD, seed=seed, log_size=20_000)
        async with Plant(roster, line=line) as plant:
            await plant.online()
            transport = httpx2.ASGITransport(app=app_of(plant))
            values = [0]
            async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as http:
                both = [_Controller(name, http, seed, values) for name in ("left", "right")]
                async with anyio.create_task_group() as tasks:
                    for one in both:
                        tasks.start_soon(one.run)
                    tasks.start_soon(_write_to_others, http)
                await anyio.sleep(5.0)
            found.extend(event for one in both for event in one.events)
            received.extend(one for one in plant.line["a"].log if one.kind != "read")

    plainly(main())
    return sorted(found, key=lambda one: one.answered_s), received


def judge(history: Sequence[Event], received: Sequence[LogEntry]) -> list[str]:
    """Say what in a history does not fit what leases promise; empty: it fits."""
    grants = [one for one in history if one.what == "grant"]
    ends_s = {one.number: _end_s(one, history) for one in grants}
    return [
        *_judge_numbers(grants),
        *_judge_answers(history, received),
        *(
            text
            for one in received
            for text in _judge_received(one, history, grants, ends_s, stands=_stands(one, received))
        ),
        *_judge_lapses(history, received, grants, ends_s),
    ]


def _end_s(grant: Event, history: Sequence[Event]) -> float:
    """Give the latest time at which a grant may still have counted."""
    lives = [
        one.answered_s for one in history
        if one.number == grant.number and one.what in ("grant", "renewal") and one.answer == "done"
    ]  # fmt: skip
    return max(lives) + grant.time_s


def _judge_numbers(grants: Sequence[Event]) -> list[str]:
    return [
        f"grant {later.number} of {later.who} came after {one.number}"
        for one in grants for later in grants
        if one.answered_s < later.asked_s and later.number <= one.number
    ]  # fmt: skip


def _judge_answers(history: Sequence[Event], received: Sequence[LogEntry]) -> list[str]:
    texts = {float(one.text) for one in received if one.code == SETPOINT and one.accepted}
    found = []
    for one in history:
        if one.what != "setpoint":
            continue
        arrived = float(one.value) in texts
        if arrived and one.answer in ("lease-lost", "lease-required", "latched", "refused"):
            found.append(f"{one.value} of {one.who} was answered {one.answer}, and arrived")
        if not arrived and one.answer in ("done", "verified"):
            found.append(f"{one.value} of {one.who} was answered {one.answer}, and never arrived")
    return found


def _judge_received(
    entry: LogEntry,
    history: Sequence[Event],
    grants: Sequence[Event],
    ends_s: dict[int, float],
    *,
    stands: bool,
) -> list[str]:
    """Judge one write that the drive received: whose it is, and whether that one might."""
    said_s = entry.time_s - SAID_S
    newest = max((one.number for one in grants if one.answered_s < said_s), default=0)
    if entry.code == SETPOINT:
        asked = [one for one in history if one.value and float(one.value) == float(entry.text)]
        if len(asked) != 1:
            return [f"{entry.text} arrived, and {len(asked)} asked for it"]
        mine, what = asked[0].number, f"the setpoint {entry.text} of {asked[0].who}"
        found = []
        if mine < newest:
            found.append(f"{what} arrived under grant {mine}, and {newest} was given")
        elif said_s > ends_s.get(mine, 0.0):
            found.append(f"{what} arrived under grant {mine}, which had lapsed")
        if not stands and not _is_enabled(mine, entry.time_s, history, grants, ends_s):
            found.append(f"{what} arrived under grant {mine}, and nothing enabled the drive since")
        return found
    if entry.code in CONTROL and _lets_run(entry):
        asking = [
            one for one in history
            if one.what == "enable" and one.asked_s <= entry.time_s <= one.answered_s + SAID_S
            and one.number >= newest and said_s <= ends_s.get(one.number, 0.0)
        ]  # fmt: skip
        if not asking:
            text = f"{entry.text} arrived in C{entry.code:04d} at {entry.time_s - 1000:.3f} s"
            return [f"{text}, and no holder was enabling the drive"]
    return []


def _stands(entry: LogEntry, received: Sequence[LogEntry]) -> bool:
    """Whether the last control that the drive received before a write stops it."""
    before = [
        one for one in received
        if one.time_s < entry.time_s and one.code in CONTROL and one.accepted
    ]  # fmt: skip
    return bool(before) and not _lets_run(before[-1])


def _lets_run(entry: LogEntry) -> bool:
    if entry.code == 40:
        return entry.text == "1"
    return not int(entry.text.lstrip("H"), 16) & 0x0208


def _is_enabled(
    number: int,
    at_s: float,
    history: Sequence[Event],
    grants: Sequence[Event],
    ends_s: dict[int, float],
) -> bool:
    """Whether an enable may have ended the latch under this grant, or one it goes back to."""
    chain = {number}
    for one in sorted(grants, key=lambda grant: -grant.number):
        later = min(chain)
        if one.number < later:
            successor = next(grant for grant in grants if grant.number == later)
            if ends_s[one.number] < successor.asked_s:
                break  # it had lapsed before: the drive was latched
            chain.add(one.number)
    return any(
        one.what == "enable" and one.number in chain and one.asked_s <= at_s for one in history
        if one.answer in ("done", "verified")
    )  # fmt: skip


def _judge_lapses(
    history: Sequence[Event],
    received: Sequence[LogEntry],
    grants: Sequence[Event],
    ends_s: dict[int, float],
) -> list[str]:
    """See that the drive was stopped after each grant that surely lapsed."""
    last_s = max(one.answered_s for one in history)
    found = []
    for one in grants:
        end_s = ends_s[one.number]
        later = [grant for grant in grants if grant.number > one.number]
        lapsed = all(grant.asked_s > end_s for grant in later)
        stops = [
            entry for entry in received
            if entry.code in CONTROL and not _lets_run(entry)
            and end_s - one.time_s <= entry.time_s <= end_s + STOPS_S
        ]  # fmt: skip
        if lapsed and end_s + STOPS_S < last_s and not stops:
            found.append(f"grant {one.number} lapsed at {end_s - 1000:.3f} s, and no stop arrived")
    return found
