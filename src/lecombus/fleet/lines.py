"""What is known of many lines, and which need attention. Pure: time is an argument.

Strategy: a line is two retained messages. `state` says whether bridge, daemon and port are there;
it stands without end, because the broker sets it when a bridge is lost, so alone it proves nothing
of now. `summary` says all else; it expires, and is renewed before that. A line is fine only while
a summary stands that says so. Every message is read once, into a small record; what it means now is
calculated when it is asked for, because time alone makes a line that was fine unknown.

A message that has no expiry and stood at the broker already may be of any age: it is not believed.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any, Final

from lecombus.bridges.mqtt.summary import KINDS, Attention

__all__ = ["LINE_KINDS", "OK", "FleetLines", "LineView", "filters_of", "rank_of", "total"]

LINE_KINDS: Final = (
    "unknown", "missing", "name-clash", "bridge-offline", "no-news", "daemon-away", "line-lost",
    "line-closed",
)  # fmt: skip
"""What a whole line may need attention for, worst first; then come the kinds of its summary."""

OK: Final = "ok"

LINES_MOST: Final = 20_000
STANDS_MOST_S: Final = 300.0
NEEDS_MOST: Final = 100
TEXT_CHARS: Final = 300

CLASH_WITHIN_S: Final = 600.0
CLASH_STANDS_S: Final = 120.0

BACK_AFTER_S: Final = 3.0
"""A summary that comes so long after `offline` shows that the bridge is back."""

RANKS: Final = {kind: rank for rank, kind in enumerate((*LINE_KINDS, *KINDS))}
OTHER_RANK: Final = RANKS["degraded"]
"""Of a kind that only a newer bridge knows."""

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")

STATE_KINDS: Final[Mapping[str, str]] = {
    "online": OK, "offline": "bridge-offline", "daemon-away": "daemon-away", "lost": "line-lost",
    "closed": "line-closed",
}  # fmt: skip
"""By the word of `state` and of a summary."""

BROKER_AWAY: Final = "the broker is away: nothing is known of the line as it is now"

TEXTS: Final[Mapping[str, str]] = {
    "bridge-offline": "its bridge is not connected to the broker",
    "daemon-away": "the daemon does not answer the bridge",
    "line-lost": "the port is lost",
    "line-closed": "the port is closed",
}
"""Where no reason is given."""

NO_SUMMARY: Final = (
    "no summary of it stands at the broker: its bridge is lost, or older than this program"
)

NO_STATE: Final = "no state of it stands at the broker: it was removed, or is not passed on"

NOTHING_KNOWN: Final = frozenset(("unknown", "missing", "bridge-offline", "no-news", "daemon-away"))
"""With these nothing is known of the drives."""


@dataclass(frozen=True, slots=True)
class LineView:
    """A line as it is known at one moment.

    Args:
        root: Its topics' first levels, such as `lecombus/hall-3`.
        name: Its name.
        status: `ok`, or the worst kind of what needs attention.
        needs: What needs attention, worst first.
        more: How many more things its bridge left out.
        drives: How many drives are in which state; `unknown` where that is not known now.
        doing: How many drives do what: `running`, `stopped` ..
        age_s: How old the last news of it are, seconds; None: there were none.
        host: The computer of its bridge.
        version: Of its bridge.
    """

    root: str
    name: str
    status: str
    needs: tuple[Attention, ...]
    more: int
    drives: Mapping[str, int]
    doing: Mapping[str, int]
    age_s: float | None
    host: str
    version: str

    def document(self) -> dict[str, Any]:
        """Return it for programs."""
        return {
            "line": self.name, "topics": self.root, "status": self.status,
            "age_s": None if self.age_s is None else round(self.age_s, 1),
            "drives": self.drives, "doing": self.doing,
            "attention": [
                {"kind": one.kind, "drive": one.drive or None, "text": one.text,
                 "for_s": None if one.for_s is None else round(one.for_s, 1)}
                for one in self.needs
            ],
            "more": self.more, "host": self.host or None, "version": self.version or None,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class LineSummary:
    """A line's summary, as its bridge sent it.

    Args:
        bridge: Which run of which bridge sent it.
        host: The computer of the bridge.
        version: Of the bridge.
        state: As in the topic `state`.
        reason: Why.
        stands_s: How long it stands at the broker.
        drives: How many are in which state.
        doing: How many do what.
        needs: What needs attention.
        more: How many more the bridge left out.
    """

    bridge: str
    host: str
    version: str
    state: str
    reason: str
    stands_s: float
    drives: Mapping[str, int]
    doing: Mapping[str, int]
    needs: tuple[Attention, ...]
    more: int

    @classmethod
    def of(cls, payload: bytes) -> LineSummary:
        """Read a summary.

        Raises:
            ValueError: It is none.
        """
        try:
            found = json.loads(payload)
            stands_s = float(found["stands_s"])
            if not 1 <= stands_s <= STANDS_MOST_S:
                raise ValueError(f"stands_s is {stands_s}")
            return cls(
                text_of(found["bridge"]), text_of(found.get("host")),
                text_of(found.get("version")), text_of(found["state"]),
                text_of(found.get("reason")), stands_s,
                counts_of(found["drives"]), counts_of(found.get("doing") or {}),
                tuple(need_of(one) for one in found["attention"][:NEEDS_MOST]),
                int(found.get("more") or 0) + max(0, len(found["attention"]) - NEEDS_MOST),
            )  # fmt: skip
        except (KeyError, TypeError, AttributeError, OverflowError, RecursionError) as exc:
            raise ValueError(f"{type(exc).__name__}: {exc}") from exc


@dataclass(slots=True)
class KnownLine:
    """What is known of one line."""

    root: str
    name: str
    state: str | None = None
    reason: str = ""
    state_at_s: float | None = None
    """When the state came, if it did not stand at the broker already."""
    summary: LineSummary | None = None
    fault: str = ""
    """What is wrong with the last summary."""
    came_s: float = -inf
    made_s: float = -inf
    """When the last news was sent, at the latest."""
    good_until_s: float = -inf
    other: str = ""
    other_host: str = ""
    """The bridge before the last."""
    changed_s: float = -inf
    clash_s: float = -inf


@dataclass(slots=True)
class FleetLines:
    """The lines of a broker.

    Args:
        prefixes: The first levels of their topics.
        expected: Names of lines that must be there.

    Attributes:
        why_away: Why the broker is not there; empty: it is.
        is_settled: Whether all that stood at the broker has come.
        ignored: Messages that were none of a line.
        left_out: Lines beyond the most that are followed.
    """

    prefixes: tuple[str, ...]
    expected: frozenset[str] = frozenset()
    why_away: str = "not connected yet"
    lost_s: float | None = None
    is_settled: bool = False
    ignored: int = 0
    left_out: int = 0
    _lines: dict[str, KnownLine] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return how many lines there are."""
        return len(self._lines)

    def names(self, name: str) -> list[str]:
        """Return the first levels of the topics of all lines with a name, or with these levels."""
        return [one.root for one in self._lines.values() if name in (one.name, one.root)]

    def roots(self) -> list[str]:
        """Return the first levels of the topics of each line."""
        return list(self._lines)

    # -- the connection ---------------------------------------------------------------------------

    def began(self) -> None:
        """A connection begins: what was known must be shown again."""
        self.why_away, self.lost_s, self.is_settled = "", None, False
        for known in self._lines.values():
            known.state, known.state_at_s, known.good_until_s = None, None, -inf

    def settled(self) -> None:
        """All that stood at the broker has come."""
        self.is_settled = True

    def lost(self, why: str, now_s: float) -> None:
        """The connection is lost: nothing is known any more as it is now."""
        if self.lost_s is None:
            self.lost_s = now_s
        self.why_away, self.is_settled = why or "no reason given", False

    # -- messages ---------------------------------------------------------------------------------

    def take(
        self,
        topic: str,
        payload: bytes,
        now_s: float,
        *,
        is_retained: bool,
        expiry_s: int | None = None,
        reason: str = "",
    ) -> None:
        """Take a message.

        Args:
            topic: Its topic.
            payload: What it says.
            now_s: When it came.
            is_retained: It stood at the broker already.
            expiry_s: How long it still stands there; None: without end.
            reason: Its user property.
        """
        root, _, what = topic.rpartition("/")
        prefix, _, name = root.rpartition("/")
        if prefix not in self.prefixes or NAME.fullmatch(name) is None:
            self.ignored += 1
        elif what == "state":
            self._take_state(root, name, payload, reason, None if is_retained else now_s)
        elif what == "summary":
            self._take_summary(root, name, payload, now_s, expiry_s, is_retained=is_retained)
        else:
            self.ignored += 1

    def _take_state(
        self, root: str, name: str, payload: bytes, reason: str, at_s: float | None
    ) -> None:
        word = payload[:TEXT_CHARS].decode(errors="replace")
        if not word:  # taken away by a person: the line is no more
            self._lines.pop(root, None)
            return
        known = self._known(root, name, is_line=word in STATE_KINDS)
        if known is None:
            return
        if at_s is not None or known.state != word:
            known.state_at_s = at_s
        known.state, known.reason = word, reason[:TEXT_CHARS]
        if at_s is not None:
            known.came_s = known.made_s = at_s

    def _take_summary(
        self,
        root: str,
        name: str,
        payload: bytes,
        now_s: float,
        expiry_s: int | None,
        *,
        is_retained: bool,
    ) -> None:
        if not payload:
            if root in self._lines:
                self._lines[root].good_until_s = -inf
            return
        try:
            summary = LineSummary.of(payload)
        except ValueError as exc:
            if root in self._lines:
                self._lines[root].fault = f"its summary cannot be read: {str(exc)[:100]}"
                self._lines[root].good_until_s = -inf
            else:
                self.ignored += 1
            return
        known = self._known(root, name, is_line=True)
        if known is None:
            return
        look_for_clash(known, summary, now_s)
        if known.summary is None or summary.bridge != known.summary.bridge:
            known.fault = ""
        known.summary = summary
        left_s = summary.stands_s if expiry_s is None else min(float(expiry_s), summary.stands_s)
        if expiry_s is None and is_retained:
            known.fault = "what stands at the broker has no expiry: does it speak MQTT 5?"
            left_s = 0.0
        else:
            known.fault = ""
            known.came_s, known.made_s = now_s, now_s - (summary.stands_s - left_s)
        known.good_until_s = now_s + left_s if left_s > 0 else -inf
        is_back = known.state_at_s is None or now_s - known.state_at_s >= BACK_AFTER_S
        is_there = known.state is None or (known.state == "offline" and is_back)
        if is_there and not is_retained:  # that it is sent now shows a bridge
            known.state, known.state_at_s = summary.state, now_s

    def _known(self, root: str, name: str, *, is_line: bool) -> KnownLine | None:
        known = self._lines.get(root)
        if known is None and is_line and len(self._lines) < LINES_MOST:
            known = self._lines[root] = KnownLine(root, name)
        elif known is None and is_line:
            self.left_out += 1
        elif known is None:
            self.ignored += 1
        return known

    # -- what it means ----------------------------------------------------------------------------

    def views(self, now_s: float) -> list[LineView]:
        """Return every line as it is known now, worst first."""
        views = [self._view(known, now_s) for known in self._lines.values()]
        if self.is_settled or self.why_away:
            there = {known.name for known in self._lines.values()}
            kind, why = "unknown", BROKER_AWAY
            if not self.why_away:
                kind, why = "missing", "it is expected, and nothing of it stands at the broker"
            needs = (Attention(kind, "", why),)
            views += [
                LineView(f"{self.prefixes[0]}/{name}", name, kind, needs, 0, {}, {}, None, "", "")
                for name in self.expected - there
            ]
        views.sort(key=lambda one: (rank_of(one.status), -len(one.needs), one.name, one.root))
        return views

    def _view(self, known: KnownLine, now_s: float) -> LineView:
        summary, is_fresh = known.summary, now_s < known.good_until_s
        found = self._needs(known, now_s, is_fresh=is_fresh)
        drives: Mapping[str, int] = {} if summary is None else summary.drives
        doing: Mapping[str, int] = {} if summary is None else summary.doing
        if not is_fresh or (found and found[0].kind in NOTHING_KNOWN):
            drives, doing = all_unknown(drives), all_unknown(doing)
        elif summary is not None:
            found += [aged(one, now_s - known.made_s) for one in summary.needs]
        found.sort(key=lambda one: rank_of(one.kind))
        return LineView(
            known.root, known.name, found[0].kind if found else OK, tuple(found),
            summary.more if summary is not None and is_fresh else 0, drives, doing,
            None if known.made_s == -inf else max(0.0, now_s - known.made_s),
            "" if summary is None else summary.host, "" if summary is None else summary.version,
        )  # fmt: skip

    def _needs(self, known: KnownLine, now_s: float, *, is_fresh: bool) -> list[Attention]:
        """Return what needs attention of the line as a whole."""
        if self.why_away:
            for_s = None if self.lost_s is None else now_s - self.lost_s
            return [Attention("unknown", "", BROKER_AWAY, for_s)]
        found = []
        if now_s - known.clash_s < CLASH_STANDS_S and known.summary is not None:
            hosts = " and ".join(dict.fromkeys((known.summary.host, known.other_host)))
            found.append(Attention("name-clash", "", f"two bridges use this name, on {hosts}"))
        kind, reason = self._word(known, is_fresh=is_fresh)
        for_s = None if known.state_at_s is None else now_s - known.state_at_s
        if kind == OK and not is_fresh:
            kind, reason = "no-news", known.fault or NO_SUMMARY
            for_s = None if known.made_s == -inf else now_s - known.made_s
        if kind != OK:
            found.append(Attention(kind, "", reason or TEXTS.get(kind, ""), for_s))
        return found

    def _word(self, known: KnownLine, *, is_fresh: bool) -> tuple[str, str]:
        """Return the kind that the state's word stands for, or a worse one of the summary."""
        found = []
        if known.state is not None:
            found.append((known.state, known.reason))
        elif not self.is_settled:
            return "unknown", "nothing of it has come yet since the broker is back"
        else:
            return "no-news", NO_STATE
        if is_fresh and known.summary is not None:
            found.append((known.summary.state, known.summary.reason))
        kinds = [
            (STATE_KINDS[word], reason) if word in STATE_KINDS
            else ("no-news", f"its state is `{word[:30]}`, which this program does not know")
            for word, reason in found
        ]  # fmt: skip
        return min(kinds, key=lambda one: rank_of(one[0]), default=(OK, ""))


def look_for_clash(known: KnownLine, summary: LineSummary, now_s: float) -> None:
    """Notice that a bridge comes back that another one had followed: two use one name."""
    before = known.summary
    if before is None or before.bridge == summary.bridge:
        return
    if summary.bridge == known.other and now_s - known.changed_s < CLASH_WITHIN_S:
        known.clash_s = now_s
    known.other, known.other_host, known.changed_s = before.bridge, before.host, now_s


def rank_of(kind: str) -> int:
    """Return the place of a kind, the worst first; ok last."""
    return len(RANKS) if kind == OK else RANKS.get(kind, OTHER_RANK)


def filters_of(prefixes: Iterable[str], topics: Iterable[str] = ("state", "summary")) -> list[str]:
    """Return what to subscribe to."""
    return [f"{prefix}/+/{one}" for prefix in prefixes for one in topics]


def all_unknown(counts: Mapping[str, int]) -> Mapping[str, int]:
    """Return as many drives of which nothing is known."""
    return {"unknown": sum(counts.values())} if counts else {}


def aged(need: Attention, age_s: float) -> Attention:
    """Return what needs attention with the time that went by since it was said."""
    for_s = None if need.for_s is None else need.for_s + age_s
    return Attention(need.kind, need.drive, need.text, for_s)


def total(views: Iterable[LineView], of: Callable[[LineView], Mapping[str, int]]) -> dict[str, int]:
    """Return counts of many lines together."""
    found: Counter[str] = Counter()
    for one in views:
        found.update(of(one))
    return dict(found)


def text_of(found: object) -> str:
    """Return a text of bounded length; None is empty."""
    return "" if found is None else str(found)[:TEXT_CHARS]


def counts_of(found: Mapping[str, Any]) -> Mapping[str, int]:
    """Return counts by a word."""
    return {text_of(key)[:20]: max(0, int(count)) for key, count in list(found.items())[:12]}


def need_of(found: Mapping[str, Any]) -> Attention:
    """Return something that needs attention as a summary has it."""
    for_s = float(found.get("for_s") or 0)
    return Attention(
        text_of(found["kind"])[:40] or "remark", text_of(found.get("drive")),
        text_of(found.get("text")), for_s if 0 <= for_s < inf else None,
    )  # fmt: skip
