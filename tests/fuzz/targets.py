"""What is fed with random bytes, and what must hold for each of them.

A target takes bytes. It raises `EscapeError` where something got past what is documented; an
exception that is not the documented one leaves it as it is, a hang is seen from outside (`run`).
A value that was accepted must come out of its own writer as it went in. Everything here is
deterministic: the same bytes give the same result.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any, Final, cast

from starlette.requests import Request

from lecombus.api.answers import RefusedRequestError
from lecombus.api.decimal_json import NotJsonError, decode, encode
from lecombus.api.request_checks import code_of, read_body, read_stop
from lecombus.api.request_models import (
    AcceptBody,
    AddressBody,
    Body,
    DriveWriteBody,
    LeaseBody,
    NoKeysBody,
    SpeedBody,
    VerbBody,
    WriteBody,
)
from lecombus.backups.backup_file import read_backup, write_backup
from lecombus.bridges.mqtt import commands as mqtt_commands
from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.command_bodies import CommandRefusedError, body_of, expiry_of
from lecombus.bridges.mqtt.topics import Topics
from lecombus.config import RosterError, load_roster, parse_roster
from lecombus.config.describing import describe
from lecombus.errors import CodeValueError, ConfigError, OperationError
from lecombus.fieldbus.lecom.protocol.controls import ENQ, EOT, with_parity
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD, Ask, Exchange
from lecombus.fieldbus.lecom.protocol.host_parser import RequestParser
from lecombus.fieldbus.lecom.protocol.parser import TAIL_LIMIT, AnswerParser
from lecombus.fieldbus.lecom.protocol.telegrams import (
    MAX_ANSWER_CHARS,
    BadAnswer,
    BadRequest,
    HostRequest,
    ReadRequest,
    WriteRequest,
)
from lecombus.fieldbus.lecom.simulator import SimLine, build
from lecombus.fieldbus.lecom.simulator.receiver import ReceivedRequest, RequestReceiver
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code, Json, Value
from lecombus.saved_state.state import NewerStateError, State, StateFormatError
from lecombus.tokens.token_file import read_tokens, write_tokens
from support.answers import encode_answer, value_answer
from support.api_line import Line, make_line

__all__ = ["LONGEST", "TARGETS", "EscapeError", "Target"]

LONGEST: Final = 4096
"""Bytes of an input; more only takes time."""


class EscapeError(AssertionError):
    """Something was accepted, or said, that the documentation does not allow."""


@dataclass(frozen=True)
class Target:
    """One entry point.

    Args:
        check: Raises if the bytes got past it.
        what: What it is, for people.
        words: What inputs are made of, for the mutator.
    """

    check: Callable[[bytes], None]
    what: str
    words: tuple[bytes, ...] = ()


def _must(holds: bool, what: str) -> None:
    if not holds:
        raise EscapeError(what)


def _cut(data: bytes) -> tuple[int, bytes]:
    """Take the first byte, which decides how the rest is used."""
    return (data[0], data[1:]) if data else (0, b"")


def _pieces(data: bytes, seed: int) -> list[bytes]:
    """Cut data into pieces of 1 to 16 bytes."""
    found, at = [], 0
    while at < len(data):
        seed = (seed * 1103515245 + 12345) & 0x7FFFFFFF
        length = 1 + (seed >> 16) % 16
        found.append(data[at : at + length])
        at += length
    return found


# ---- the line ----------------------------------------------------------------------------------


def check_answers(data: bytes) -> None:
    """Feed the master's parser of answers, whole and in pieces."""
    how, data = _cut(data)
    parity = bool(how & 1)
    outcomes = []
    for pieces in ([data], [data[at : at + 1] for at in range(len(data))], _pieces(data, how)):
        parser, answer = AnswerParser(parity=parity), None
        for piece in pieces:
            came = parser.feed(piece)
            _must(answer is None or came is None, "two answers without a reset")
            answer = came or answer
        outcomes.append((answer, parser.tail, parser.pending))
    _must(outcomes[0] == outcomes[1] == outcomes[2], "it depends on how the bytes were cut")
    answer, tail, pending = outcomes[0]
    _must(len(tail) <= TAIL_LIMIT, "the tail is not bounded")
    _must(len(pending) <= MAX_ANSWER_CHARS, "what is pending is not bounded")
    if answer is None:
        _must(pending == data, "bytes were lost")
        return
    said = encode_answer(answer)
    if isinstance(answer, BadAnswer):
        _must(bool(answer.reason), "a bad answer does not say why")
    elif parity:
        said = with_parity(said)
    _must(data.startswith(said), "the answer is not what was received")
    _must(data[len(said) :][:TAIL_LIMIT] == tail, "the tail is not what followed")


def check_exchange(data: bytes) -> None:
    """Feed an exchange with bytes at any times; it must end, and only by its own answer."""
    how, data = _cut(data)
    field = (b"46", b"!002E00", ACK_FIELD, b"")[how & 3]
    echo = (None, True, False, False)[how >> 2 & 3]
    sent = b"\x040146\x05" if field != ACK_FIELD else b"\x0401\x024620\x03\x05"
    ask = Ask(sent, field, 0.006, 0.060, 0.080, 0.010, 0.001, 0.040)
    exchange = Exchange(parity=False, echo=echo)
    exchange.begin(ask, 0.0, takes_nak=bool(how & 16))
    now_s, result = 0.0, None
    rest = data
    while rest and result is None:
        pause, length, rest = rest[0], 1 + (rest[0] & 15), rest[1:]
        now_s += (pause >> 4) * 0.001
        result = exchange.expire(now_s)
        if result is None and rest:
            piece, rest = rest[:length], rest[length:]
            result = exchange.feed(piece, now_s)
        _must(result is not None or now_s <= 0.095, "it lasts longer than its deadlines")
    for _ in range(8):
        if result is not None:
            break
        now_s = max(now_s, exchange.deadline_s())
        _must(exchange.look_s() <= exchange.deadline_s(), "it looks after its deadline")
        result = exchange.expire(now_s)
    if result is None:
        raise EscapeError("its deadline moves for ever")
    _must(len(result.received) <= 64, "what is kept is not bounded")
    if result.kind is ResultKind.ANSWERED:
        _must(field != b"", "a multicast was answered")
        answer = result.answer
        _must(not isinstance(answer, BadAnswer) and answer is not None, "a bad answer was used")
        own = getattr(answer, "field", field)
        _must(own == field, "the answer to something else was used")
        value = getattr(answer, "value", None)
        if value is not None:
            _must(value_answer(own, value) in data_of(data), "the value was never received")
    else:
        _must(result.answer is None, "an exchange that failed has an answer")
    _must(result.older_by_s >= 0.0, "it ended before it could")


def data_of(data: bytes) -> bytes:
    """Return the bytes of an exchange's input without what says when they came."""
    found, rest = b"", data
    while rest:
        length, rest = 1 + (rest[0] & 15), rest[1:]
        found, rest = found + rest[:length], rest[length:]
    return found


def _telegram(request: HostRequest) -> bytes:
    match request:
        case ReadRequest(address, field):
            return b"%c%02d%b%c" % (EOT, address, field, ENQ)
        case WriteRequest(address, field, value):
            return b"%c%02d" % (EOT, address) + value_answer(field, value)
        case BadRequest():
            return request.received


def check_telegrams(data: bytes) -> None:
    """Feed the parser of telegrams and the simulator's own receiver; what both hear must agree."""
    how, data = _cut(data)
    parity = bool(how & 1)
    parsers = [RequestParser(parity=parity) for _ in range(2)]
    whole = parsers[0].feed(data)
    cut = [one for piece in _pieces(data, how) for one in parsers[1].feed(piece)]
    _must(whole == cut, "it depends on how the bytes were cut")
    _must(len(parsers[0].pending) <= MAX_ANSWER_CHARS + 3, "what is pending is not bounded")
    at = 0
    for one in whole:
        said = _telegram(one)
        said = with_parity(said) if parity and not isinstance(one, BadRequest) else said
        found = data.find(said, at)
        _must(found >= 0, "a request was read that was never received")
        at = found + (len(said) if not isinstance(one, BadRequest) else 0)
    for one in whole:
        if not isinstance(one, BadRequest):
            said = _telegram(one)
            receiver = RequestReceiver(parity=parity)
            heard = [receiver.feed(byte) for byte in (with_parity(said) if parity else said)]
            _must(heard[-1] == _as_heard(one), "the simulator does not hear a good telegram")
            _must(not any(heard[:-1]), "the simulator hears more than one")


def _as_heard(one: ReadRequest | WriteRequest) -> ReceivedRequest:
    text = one.value.raw if isinstance(one, WriteRequest) else None
    return ReceivedRequest(one.address, one.field, text, damaged=False)


FAMILIES: Final = ("820x", "8200vector", "93xx", "smvector", "generic")


@cache
def _simulated() -> Callable[[int], SimLine]:
    def line(how: int) -> SimLine:
        drives = [(f"d{number}", 11 + number, name) for number, name in enumerate(FAMILIES)]
        return build(drives, baud=19200, parity=bool(how & 1), paced=bool(how & 2))

    return line


def check_simulator(data: bytes) -> None:
    """Say anything to simulated drives: what they answer must be whole answers."""
    how, data = _cut(data)
    line, now_s = _simulated()(how), 0.0
    said = b""
    for piece in _pieces(data, how):
        line.receive(piece, now_s)
        now_s += (how >> 2 & 15) * 0.01
        said += line.poll(now_s)
    for _ in range(200):
        due_s = line.next_event_s()
        if due_s is None:
            break
        said += line.poll(max(now_s, due_s))
    else:
        raise EscapeError("the simulated line does not come to rest")
    _must(len(said) <= 300 * (1 + data.count(ENQ) + data.count(3)), "it says more than it is asked")


# ---- values and codes --------------------------------------------------------------------------


def check_values(data: bytes) -> None:
    """Read a value, a code and a number as users write them."""
    text = data.decode("latin-1")
    try:
        value = Value.parse(text)
    except CodeValueError:
        pass
    else:
        _must(value.raw == text, "a value is not what was received")
        number = value.number
        if isinstance(number, Decimal):
            _must(Value.decimal(number).number == number, "a decimal does not come back")
        elif isinstance(number, int):
            again = Value.hexadecimal(number, len(text) - 1)
            _must(again.raw == text.upper(), "a word does not come back")
        _must(value.means_same(Value.parse(value.raw)), "a value does not equal itself")
    try:
        code = Code.parse(text)
    except CodeValueError:
        pass
    else:
        _must(Code.parse(str(code)) == code, "a code does not come back")
    try:
        value = Value.decimal(text)
    except CodeValueError:
        pass
    else:
        _must(Value.parse(value.raw) == value, "what would be sent is not a value")
        _must(Decimal(text) == value.number, "another number would be sent")


# ---- files -------------------------------------------------------------------------------------


def check_roster(data: bytes) -> None:
    """Read a roster; one that is accepted can be described and says the same when read again."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = ""
        (_folder() / "roster.yaml").write_bytes(data)
    try:
        roster = parse_roster(text, "r") if text else load_roster(_folder() / "roster.yaml")
    except RosterError as exc:
        _must(bool(exc.mistakes), "a roster is refused without a mistake")
        _must(all(str(one) for one in exc.mistakes), "a mistake says nothing")
        return
    asdict(describe(roster))
    _must(parse_roster(text, "r") == roster, "the same text is another roster")
    for name, drive in ((one.name, one) for one in roster.drives):
        _must(1 <= drive.address <= 99 and drive.address % 10 != 0, f"{name} has no drive address")


def check_backup(data: bytes) -> None:
    """Read a backup; one that is accepted is written again and read as the same."""
    try:
        backup = read_backup(data.decode("utf-8"), "backup.yaml")
    except UnicodeDecodeError:
        return  # `cli.backup.read_text` refuses it
    except ConfigError as exc:
        _must(bool(str(exc)), "a backup is refused without a reason")
        return
    again = read_backup(write_backup(backup), "backup.yaml")
    _must(again.head == backup.head, "the head does not come back")
    for code, entry in backup.entries.items():
        other = again.entries.get(code)
        _must(other is not None and other.value == entry.value, f"{code} does not come back")
    _must(len(again.entries) == len(backup.entries), "codes were added")


def check_state(data: bytes) -> None:
    """Read what outlives the process."""
    try:
        state = State.parse(data)
    except (StateFormatError, NewerStateError):
        return
    text = state.text()
    _must(State.parse(text.encode()).text() == text, "the state does not come back")


@cache
def _folder() -> Path:
    keep = tempfile.TemporaryDirectory(prefix="lecombus-fuzz-")
    _KEPT.append(keep)
    return Path(keep.name)


_KEPT: Final[list[object]] = []


def check_tokens(data: bytes) -> None:
    """Read a file of tokens."""
    path, again = _folder() / "tokens", _folder() / "again"
    path.write_bytes(data)
    try:
        tokens = read_tokens(path)
    except OperationError as exc:
        _must(exc.kind == "tokens", "refused as something else")
        return
    write_tokens(again, tokens.entries)
    _must(read_tokens(again) == tokens, "tokens do not come back")
    for entry in tokens:
        entry.is_expired(0.0)


# ---- the API -----------------------------------------------------------------------------------

BODIES: Final[tuple[type[Body], ...]] = (
    WriteBody, DriveWriteBody, SpeedBody, VerbBody, LeaseBody, AcceptBody, AddressBody, NoKeysBody,
)  # fmt: skip


class _Request:
    """As much of a request as reading its body takes."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self.path_params = {"code": body[:300].decode("latin-1")}

    async def receive(self) -> dict[str, object]:
        return {"type": "http.request", "body": self._body, "more_body": False}


def _finished(coroutine: Any) -> Any:
    """Run a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration as exc:
        return exc.value
    raise EscapeError("it waits, though all is there")


def check_bodies(data: bytes) -> None:
    """Read a body as JSON, and as what every call that writes takes."""
    how, data = _cut(data)
    try:
        given = decode(data)
    except NotJsonError:
        pass
    else:
        again = json.loads(encode(cast(Json, given)), parse_float=Decimal)
        _must(again == given, "JSON does not come back exactly")
    model = BODIES[how % len(BODIES)]
    try:
        body, _ = _finished(read_body(cast(Request, _Request(data)), model))
    except RefusedRequestError as exc:
        _must(400 <= exc.problem.status < 500, "refused as a fault of the daemon")
    else:
        for name in ("expires_s", "time_s"):
            if getattr(body, name.removesuffix("_s"), None) is not None:
                _must(0 < getattr(body, name) <= 3600, "a time out of range was accepted")
        value = getattr(body, "value", None)
        if isinstance(value, int | Decimal):
            _must(len(f"{value:f}") < 300, "a number of a megabyte was accepted")
    with contextlib.suppress(RefusedRequestError):
        _finished(read_stop(cast(Request, _Request(data))))
    with contextlib.suppress(RefusedRequestError):
        code_of(cast(Request, _Request(data)))


CALLS: Final = (
    ("PUT", "/v1/drives/feeder/codes/C0046"),
    ("PUT", "/v1/groups/conveyors/codes/C0046"),
    ("POST", "/v1/drives/feeder/verbs/set-speed"),
    ("POST", "/v1/drives/feeder/verbs/enable"),
    ("POST", "/v1/drives/feeder/verbs/reset-fault"),
    ("POST", "/v1/drives/feeder/accept"),
    ("POST", "/v1/drives/feeder/address"),
    ("POST", "/v1/stop"),
    ("POST", "/v1/drives/feeder/verbs/inhibit"),
    ("PUT", "/v1/leases/shift"),
    ("DELETE", "/v1/leases/shift"),
    ("PUT", "/v1/drives/feeder/codes/C0046/"),
    ("GET", "/v1/drives/feeder/codes/"),
    ("GET", "/v1/drives/"),
    ("GET", "/"),
)


@cache
def _served() -> tuple[asyncio.AbstractEventLoop, Line]:
    return asyncio.new_event_loop(), make_line()


def check_calls(data: bytes) -> None:
    """Make a call of any kind: it is answered by what is documented, never by a fault."""
    how, rest = _cut(data)
    more, body = _cut(rest)
    method, path = CALLS[how % len(CALLS)]
    query = b""
    if method == "GET" or more & 1:
        end, _, body = body.partition(b"\n")
        target, _, query = end.partition(b"?")
        path += target.decode("utf-8", errors="replace")  # as uvicorn reads what is percent-encoded
        query = bytes(byte for byte in query if 0x20 < byte < 0x7F)  # httptools refuses all others
    loop, line = _served()
    line.now_s += 10.0
    status, answer = loop.run_until_complete(_asked(line, method, path, query, body))
    _must(status < 500 or status == 503, f"{method} {path} is answered by {status}")
    if answer:
        _must(answer[:1] not in b"{[" or decode(answer) is not None, "an answer is not JSON")
    line.ops.asked.clear()


async def _asked(
    line: Line, method: str, path: str, query: bytes, body: bytes
) -> tuple[int, bytes]:
    scope: dict[str, Any] = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method,
        "scheme": "http", "path": path, "raw_path": path.encode(), "query_string": query,
        "root_path": "", "client": None, "server": ("localhost", 80), "state": {},
        "headers": [(b"host", b"localhost"), (b"content-length", b"%d" % len(body))],
    }  # fmt: skip
    status, said, asked = 0, b"", False

    async def receive() -> dict[str, Any]:
        nonlocal asked
        if asked:
            return {"type": "http.disconnect"}
        asked = True
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Any) -> None:
        nonlocal status, said
        if message["type"] == "http.response.start":
            status = message["status"]
        else:
            said += message.get("body", b"")

    await line.app(scope, receive, send)
    return status, said


# ---- MQTT --------------------------------------------------------------------------------------

TOPICS: Final = Topics("lecombus", "t")


def check_mqtt(data: bytes) -> None:
    """Take a topic and a payload as a command: refused with a reason, or the body of a request."""
    how, rest = _cut(data)
    name, _, payload = rest.partition(b"\n")
    topic = f"lecombus/t/feeder/{'do' if how & 1 else 'set'}/{name.decode('utf-8', 'replace')}"
    command = TOPICS.command(topic)
    if command is None:
        return
    expiry_s = None if how & 2 else how >> 2
    incoming = Incoming(topic, payload, 1, False, 0.0, expiry_s)
    mqtt_commands.said_of(command, payload)
    try:
        if command.what == "set":
            code = mqtt_commands.code_of(command.name)
            with contextlib.suppress(CodeValueError):  # what is not a code the daemon refuses
                meant = Code.parse(code)
                _must(Code.parse(command.name) == meant, "another code is written")
        body = body_of(command, payload)
        wait_s = expiry_of(incoming, body)
    except CommandRefusedError as exc:
        _must(bool(exc.document["reason"]), "a command is refused without a reason")
        json.dumps(exc.document).encode("ascii")
        return
    _must(0.0 < wait_s <= 3600.0, "a time out of range was accepted")
    again = json.loads(encode(cast(Json, body)), parse_float=Decimal)
    _must(again == body, "another value would be sent")
    mqtt_commands.key_of(incoming)


LINE_WORDS: Final = (
    b"\x02", b"\x03", b"\x04", b"\x05", b"\x06", b"\x15", b"\x0411", b"46", b"?0", b"!002E00",
    b"\x024635.4\x03\x1d", b"\x0246\x04", b"\x0246?\x03>", b"H0900", b"S33S2102I", b"O0102",
    b"\x04112335", b"\x0411\x02!002E0035.4\x03",
)  # fmt: skip
ROSTER_WORDS: Final = tuple(
    word.encode()
    for word in (
        "line:", "name:", "port:", "baud:", "medium:", "drives:", "address:", "family:",
        "watchdog:", "{time: 2s, action: quick-stop}", "cyclic:", "code:", "every:", "groups:",
        "members:", "api:", "socket:", "http:", "tokens:", "mqtt:", "lease:", "on_shutdown:",
        "\n  - ", "\n", ": ", "&a", "*a", "<<", "!!python/object", "500ms", "C0150", "8200vector",
        "tolerate:", "retries:", "journal:", "turnaround:", "writable:", "[", "]", "{", "}",
        "lecombus-backup: 1", "taken:", "parameters:", "identity:", "process:", "not-read:",
        "undescribed:", "C0046: 35.4", "module:",
    )
)  # fmt: skip
JSON_WORDS: Final = tuple(
    word.encode()
    for word in (
        '{"value": 35.4}', '"expires"', '"verify"', "true", "null", '"unit"', '"Hz"', '"2s"',
        '"counter"', '"targets"', '"time"', '"token"', '"identity"', '"address"', '"action"',
        '"quick-stop"', '"target"', '"all"', "1e99", "1E-999999", "-0.0", "NaN", "[", "{", "]", "}",
        ",", ":", '"\\ud800"', '"priority"', '"restore"', '"stops"', '"version"', '"drives"',
        '"writes"', '"tokens"', '"sha256"', '"scopes"', '"created"', "2026-01-01T00:00:00Z",
    )
)  # fmt: skip

TARGETS: Final = {
    "answers": Target(check_answers, "the master's parser of answers", LINE_WORDS),
    "exchange": Target(check_exchange, "one exchange, bytes at any times", LINE_WORDS),
    "telegrams": Target(check_telegrams, "the parsers of telegrams, both of them", LINE_WORDS),
    "simulator": Target(check_simulator, "simulated drives of five families", LINE_WORDS),
    "values": Target(check_values, "values, codes, numbers", LINE_WORDS),
    "roster": Target(check_roster, "rosters", ROSTER_WORDS),
    "backup": Target(check_backup, "backups", ROSTER_WORDS),
    "bodies": Target(check_bodies, "bodies of calls", JSON_WORDS),
    "calls": Target(check_calls, "calls of the HTTP interface", JSON_WORDS),
    "mqtt": Target(check_mqtt, "commands over MQTT", JSON_WORDS),
    "state": Target(check_state, "the saved state", JSON_WORDS),
    "tokens": Target(check_tokens, "files of tokens", JSON_WORDS),
}
