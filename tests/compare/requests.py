"""The requests of the HTTP part, good and hostile, as bytes.

They are sent one after the other in the order of `corpus`, each on its own connection, over the
Unix socket and over TCP. The line has the drives of `ROSTER`; what is written and stopped stands
behind what is only read, so that a repeat of the run finds the same values.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

ROSTER = """\
line: {{name: compare, port: '{port}', baud: 19200, turnaround: 2ms, repeaters: true}}
drives:
  - {{name: feeder, address: 11, family: 8200vector, cyclic: [{{code: C0150, every: 500ms}}],
     also_writable: [C0012, C0013, C0039/1], restore: true}}
  - {{name: belt, address: 12, family: smvector}}
  - {{name: winder, address: 21, family: 93xx, cyclic: [{{code: C0150, every: 500ms}}]}}
  - {{name: pump, address: 22, family: 820x, cyclic: [{{code: C0150, every: 500ms}}]}}
  - {{name: fan, address: 23, family: 821x, allow_address_change: true}}
  - {{name: mixer, address: 31, family: 822x, writable: []}}
  - {{name: press, address: 32, family: 824x}}
  - {{name: counter, address: 41, family: generic, addressing: standard, cyclic: []}}
groups:
  pair: {{members: [feeder, belt], multicast: true}}
  mixed: {{members: [winder, mixer]}}
api: {{socket: {folder}/api.sock, http: '127.0.0.1:{http}'}}
state: {folder}/state.json
lease: {{time: 1min}}
"""

DRIVES = ("feeder", "belt", "winder", "pump", "fan", "mixer", "press", "counter")
BODY = 9000
"""Octets of a body that is too long."""


@dataclass(frozen=True)
class Request:
    """What is sent on one connection.

    Args:
        name: Its name in the record.
        data: The octets.
        several: More than one answer may come.
    """

    name: str
    data: bytes
    several: bool = False


def get(
    path: str, method: str = "GET", *, version: str = "1.1", name: str = "", **headers: str
) -> Request:
    """Return a request without a body."""
    head = _head(method, path, {"Host": "localhost", **headers}, version)
    title = f"{method} {path} {name or headers or ''} {version}"
    return Request(title, head, "Expect" in headers)


def send(method: str, path: str, body: Any, *, name: str = "", **headers: str) -> Request:
    """Return a request with a body: octets, text, or a document."""
    if isinstance(body, str):
        body = body.encode()
    data: bytes = body if isinstance(body, bytes) else json.dumps(body).encode()
    said = {"Host": "localhost", "Content-Type": "application/json",
            "Content-Length": str(len(data)), **headers}  # fmt: skip
    title = name or f"{data[:200]!r} {headers or ''}"
    return Request(
        f"{method} {path} {title}", _head(method, path, said, "1.1") + data, "Expect" in headers
    )


def _head(method: str, path: str, headers: dict[str, str], version: str) -> bytes:
    """Write a head; `_` in a header's name stands for `-`, an empty value leaves it out."""
    rows = [f"{key.replace('_', '-')}: {text}" for key, text in headers.items() if text]
    return "\r\n".join([f"{method} {path} HTTP/{version}", *rows, "", ""]).encode("latin-1")


def corpus() -> Iterator[Request]:
    """Give all requests in their order."""
    yield from known()
    yield from wrong_paths()
    yield from heads()
    yield from bytes_that_are_no_request()
    yield from reads()
    yield from wrong_bodies()
    yield from writes()
    yield from verbs()
    yield from stops()
    yield from rows_and_events()
    yield from leases()


def known() -> Iterator[Request]:
    """Ask for what is known."""
    plain = ("/v1/line", "/v1/drives", "/v1/groups", "/v1/plan", "/healthz", "/readyz", "/metrics",
             "/openapi.json")  # fmt: skip
    for path in plain:
        for method in ("GET", "HEAD", "OPTIONS", "POST", "DELETE"):
            yield get(path, method)
    yield get("/metrics", Accept="application/openmetrics-text; version=1.0.0")
    for drive in DRIVES:
        for what in ("", "/identity", "/wear", "/restore", "/why"):
            yield get(f"/v1/drives/{drive}{what}")
        yield get(f"/v1/drives/{drive}/described")
    yield get("/v1/drives/feeder/why?lang=de")
    yield get("/v1/drives/feeder/why?lang=fr")
    yield get("/v1/drives/feeder/why?fresh=maybe")
    for code in ("C0150", "c150", "150", "C0050", "C9999", "C0039/1", "P500", "C99999", "x", "-1",
                 "C0150/0", "C0150/300", "C0150/x", "%43150", "C0150%00"):  # fmt: skip
        yield get(f"/v1/drives/feeder/codes/{code}")


def wrong_paths() -> Iterator[Request]:
    """Ask for what there is not, or in a wrong way."""
    for path in ("/", "/v1", "/v1/", "/v2/line", "//v1/line", "/v1/line/", "/v1/line?x=1",
                 "/V1/line",
                 "/v1/../v1/line", "/v1/drives/", "/v1/drives/nobody", "/v1/drives/Feeder",
                 "/v1/drives/feede", "/v1/drives/feeder/x", "/v1/drives/feeder/codes",
                 "/v1/drives/nobody/codes/C0150", "/v1/drives/%2e%2e/codes/C0150",
                 "/v1/drives/f%C3%A4/codes/1", "/v1/drives/feeder?a=1&a=2", "/v1/groups/pair",
                 "/docs", "/redoc", "/favicon.ico", "/v1/line#x", "/v1/line?",
                 "/v1/drives/feeder/codes/C0150?fresh=1", "/v1/drives/feeder/codes/C0150?frsh=true",
                 "/v1/drives/feeder/codes/C0150?priority=background",
                 "/v1/drives/feeder/codes/C0150?fresh=true&fresh=true",
                 "/v1/drives/feeder/codes/C0150?fresh=true&priority=stop",
                 "/v1/line?" + "&".join(f"a{n}=1" for n in range(20)),
                 "/v1/" + "x" * 3000):  # fmt: skip
        yield get(path)
    for method in ("PUT", "POST", "PATCH", "DELETE", "TRACE", "CONNECT", "get", "FOO"):
        yield get("/v1/drives/feeder/codes/C0150", method)
    for path in ("/v1/stop", "/v1/drives/feeder/verbs/enable", "/v1/drives/feeder/accept",
                 "/v1/groups/pair/codes/C0046"):  # fmt: skip
        for method in ("GET", "HEAD", "PUT", "OPTIONS", "DELETE"):
            yield get(path, method)


def heads() -> Iterator[Request]:
    """Ask rightly with heads that are unusual or wrong."""
    for host in ("localhost", "localhost:9740", "127.0.0.1", "127.0.0.1:9740", "[::1]", "[::1]:1",
                 "example.com", "evil.example:80", "a b", "LOCALHOST", "localhost.",
                 ""):  # fmt: skip
        yield get("/v1/line", Host=host)
    for origin in ("http://localhost", "http://example.com", "null", "http://127.0.0.1:9740"):
        yield get("/v1/line", Origin=origin)
        yield send("POST", "/v1/stop", {"action": "x"}, Origin=origin)
    yield get("/v1/line", version="1.0")
    yield get("/v1/line", version="1.0", Connection="keep-alive")
    yield get("/v1/line", version="0.9")
    yield get("/v1/line", version="2.0")
    yield get("/v1/line", version="1.0", Host="")
    yield get("/v1/line", Connection="close")
    yield get("/v1/line", Connection="Upgrade", Upgrade="websocket")
    yield get("/v1/line", Expect="100-continue")
    yield get("/v1/line", Expect="more")
    yield get("/v1/line", Accept="text/html")
    yield get("/v1/line", Accept_Encoding="gzip")
    yield get("/v1/line", Range="bytes=0-3")
    yield get("/v1/line", If_None_Match="*")
    yield get("/v1/line", Cookie="a=b", Authorization="Bearer x")
    yield get("/v1/line", **{f"X_{n}": "1" for n in range(62)})
    yield get("/v1/line", **{f"X_{n}": "1" for n in range(70)})
    yield get("/v1/line", X="y" * 17000)
    yield get("/v1/line", X="y" * 15000)


def bytes_that_are_no_request() -> Iterator[Request]:
    """Send what is not a request, or several at a time."""
    one = get("/v1/groups").data
    raw = {
        "two pipelined": one + one,
        "five pipelined": one * 5,
        "pipelined behind a wrong one": b"FOO\r\n\r\n" + one,
        "pipelined before a wrong one": one + b"\x00\x01\r\n\r\n",
        "pipelined behind close": get("/v1/groups", Connection="close").data + one,
        "nothing but line ends": b"\r\n\r\n\r\n",
        "line ends before": b"\r\n\r\n" + one,
        "bare line feeds": one.replace(b"\r\n", b"\n"),
        "no method": b"/v1/line HTTP/1.1\r\n\r\n",
        "no version": b"GET /v1/line\r\nHost: localhost\r\n\r\n",
        "no host": b"GET /v1/line HTTP/1.1\r\n\r\n",
        "two hosts": b"GET /v1/line HTTP/1.1\r\nHost: a\r\nHost: localhost\r\n\r\n",
        "absolute": b"GET http://localhost/v1/groups HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "asterisk": b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "space before the colon": b"GET /v1/groups HTTP/1.1\r\nHost : localhost\r\n\r\n",
        "folded header": b"GET /v1/groups HTTP/1.1\r\nHost: localhost\r\nX: a\r\n b\r\n\r\n",
        "a header without colon": b"GET /v1/groups HTTP/1.1\r\nHost: localhost\r\nX\r\n\r\n",
        "nul in a header": b"GET /v1/groups HTTP/1.1\r\nHost: localhost\r\nX: a\0b\r\n\r\n",
        "octets in the path": b"GET /v1/\xff\xfe HTTP/1.1\r\nHost: localhost\r\n\r\n",
        "TLS": bytes.fromhex("160301020001000001fc0303"),
        "length and chunks": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        "two lengths": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}x",
        "negative length": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Length: -2\r\n\r\n{}",
        "chunks": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n",
        "wrong chunks": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Transfer-Encoding: chunked\r\n\r\nzz\r\n{}\r\n0\r\n\r\n",
        "unknown coding": b"PUT /v1/drives/feeder/codes/C0046 HTTP/1.1\r\nHost: localhost\r\n"
        b"Transfer-Encoding: gzip\r\n\r\n{}",
        "a body with GET": b"GET /v1/groups HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Length: 2\r\n\r\n{}",
    }
    for name, data in raw.items():
        yield Request(name, data, several=True)


def reads() -> Iterator[Request]:
    """Read from the drives now."""
    for drive in DRIVES:
        yield get(f"/v1/drives/{drive}/codes/C0135?fresh=true")
        yield get(f"/v1/drives/{drive}/codes/C0012?fresh=true")
    yield get("/v1/drives/belt/codes/P140?fresh=true")
    yield get("/v1/drives/feeder/codes/C0039/1?fresh=true&priority=background")
    yield get("/v1/drives/counter/codes/C0039/1?fresh=true")
    yield get("/v1/drives/feeder/codes/C7777?fresh=true")
    for address, more in (("11", ""), ("25", ""), ("25", "&family=smvector"), ("20", ""), ("0", ""),
                          ("100", ""), ("x", ""), ("25", "&family=x"), ("25", "&patient=2"),
                          ("011", "")):  # fmt: skip
        yield get(f"/v1/line/addresses/{address}/codes/C1810?addressing=extended{more}")
    yield get("/v1/line/addresses/25/codes/C1810")
    yield get("/v1/line/addresses/25/codes/C0068?addressing=standard")


def wrong_bodies() -> Iterator[Request]:
    """Write with bodies that are wrong; nothing of it reaches a drive."""
    path = "/v1/drives/feeder/codes/C0046"
    for body in (b"", b"{", b"[]", b"null", b"1", b'"x"', b"{}", b'{"value": }', b"{'value': 1}",
                 b'{"value": 1, "value": 2}', b'{"value": 1, "colour": "red"}', b'{"valeu": 1}',
                 b'{"value": null}', b'{"value": true}', b'{"value": [1]}', b'{"value": {}}',
                 b'{"value": NaN}', b'{"value": Infinity}', b'{"value": 1e999}', b'{"value": 1e5}',
                 b'{"value": ""}', b'{"value": "x"}', b'{"value": "0208"}', b'{"value": "H00"}',
                 b'{"value": 99999}', b'{"value": -1}', b'{"value": 1.23456}',
                 b'{"value": 1' + b"0" * 400 + b"}", b'{"value": 1, "verify": 1}',
                 b'{"value": 1, "verify": "yes"}', b'{"value": 1, "expires": "2"}',
                 b'{"value": 1, "expires": "2h"}', b'{"value": 1, "expires": 0}',
                 b'{"value": 1, "expires": -1}', b'{"value": 1, "expires": null}',
                 b'{"value": 1, "priority": "stop"}', b'{"value": 1, "priority": 1}',
                 b'{"value": 1, "restore": 1}', b'{"value": 1, "stops": 1}',
                 b'{"value": 1} x', b"\xef\xbb\xbf" + b'{"value": "x"}', b'{"value": "\xff"}',
                 b'{"value": "\\ud800"}', b'{"value": "a\x00"}', '{"value": "é"}'.encode("latin-1"),
                 b"[" * 3000, b'{"a":' * 1000):  # fmt: skip
        yield send("PUT", path, body, name=f"{body[:60]!r} of {len(body)}")
    yield send("PUT", path, b" " * BODY, name="huge")
    yield send("PUT", path, b"{" + b" " * BODY, name="huge, Expect", Expect="100-continue")
    yield send("PUT", path, b"", name="huge by its length alone", Content_Length="999999999")
    yield send("PUT", path, {"value": "x"}, Content_Type="text/plain")
    yield send("PUT", path, {"value": "x"}, Content_Type="")
    yield send("PUT", path, {"value": "x"}, Content_Encoding="gzip")
    for key in ("a b", "x" * 256, "\xe4", ",", '"q"'):
        yield send("PUT", path, {"value": "x"}, Idempotency_Key=key)
    for target in ("drives/nobody/codes/C0046", "drives/feeder/codes/C0009",
                   "drives/feeder/codes/x",
                   "drives/mixer/codes/C0046", "drives/feeder/codes/C0150",
                   "drives/counter/codes/C0046", "drives/feeder/codes/C0046/1",
                   "groups/nobody/codes/C0046", "groups/all/codes/C0009",
                   "drives/belt/codes/C0046", "groups/pair/codes/C0012"):  # fmt: skip
        yield send("PUT", f"/v1/{target}", {"value": 20})


def writes() -> Iterator[Request]:
    """Write, with and without keys; the motors are inhibited."""
    feeder = "/v1/drives/feeder/codes"
    yield send("PUT", f"{feeder}/C0046", {"value": 20.5})
    yield send("PUT", f"{feeder}/C0046", {"value": 20.5, "verify": True, "expires": "5s"})
    yield send("PUT", f"{feeder}/C0046", {"value": "21.5", "priority": "background"})
    yield send("PUT", f"{feeder}/C0012", {"value": 7.5, "verify": True})
    yield send("PUT", f"{feeder}/C0012", {"value": 7.5, "verify": True})
    yield send("PUT", f"{feeder}/C0013", {"value": 99999})
    yield send("PUT", f"{feeder}/C0013", {"value": 4, "restore": True})
    yield send("PUT", f"{feeder}/C0039/1", {"value": 12})
    for value in (22, 22, 23):
        yield send("PUT", f"{feeder}/C0046", {"value": value}, Idempotency_Key="shift-7")
    yield send("PUT", "/v1/drives/winder/codes/C0046", {"value": 10})
    yield send("PUT", "/v1/drives/winder/codes/C0141", {"value": 10, "verify": True})
    yield send("PUT", "/v1/drives/belt/codes/P140", {"value": 10, "verify": True})
    yield send("PUT", "/v1/drives/pump/codes/C0046", {"value": 10, "verify": True})
    yield send("PUT", "/v1/groups/pair/codes/C0046", {"value": 15, "verify": True})
    yield send("PUT", "/v1/groups/mixed/codes/C0046", {"value": 15})
    yield send("PUT", "/v1/groups/all/codes/C0046", {"value": 15, "verify": False})
    for drive in ("feeder", "belt", "counter"):
        yield send("POST", f"/v1/drives/{drive}/forget-times", b"")
        yield send("POST", f"/v1/drives/{drive}/accept", {"identity": {"C0200": "x"}})
        yield get(f"/v1/drives/{drive}/wear")
    yield send("POST", "/v1/drives/feeder/accept", {"identity": {}})
    yield send("POST", "/v1/drives/feeder/forget-times", {"x": 1})
    for address in (11, 20, 100, "x", None, 24.5):
        yield send("POST", "/v1/drives/fan/address", {"address": address})
    yield send("POST", "/v1/drives/feeder/address", {"address": 15})


def verbs() -> Iterator[Request]:
    """Ask for verbs."""
    for drive in DRIVES:
        yield send("POST", f"/v1/drives/{drive}/verbs/set-speed", {"value": 20, "unit": "%"})
        yield send("POST", f"/v1/drives/{drive}/verbs/inhibit", b"")
    for body in ({"value": 99, "unit": "Hz"}, {"value": 20, "unit": "rpm"},
                 {"value": -5, "unit": "Hz"},
                 {"unit": "Hz"}, {"value": 20}, {"value": "20", "unit": "Hz", "verify": True},
                 {"value": 20, "unit": "Hz", "x": 1},
                 {"value": 20, "unit": "Hz", "expires": "x"}):  # fmt: skip
        yield send("POST", "/v1/drives/feeder/verbs/set-speed", body)
    yield send("POST", "/v1/drives/feeder/verbs/dance", b"")
    yield send("POST", "/v1/drives/nobody/verbs/enable", b"")
    yield send("POST", "/v1/drives/feeder/verbs/enable", {"value": 1})
    yield send("POST", "/v1/drives/feeder/verbs/reset-fault", b"")
    yield send("POST", "/v1/drives/feeder/verbs/inhibit", {"x": 1}, Idempotency_Key="")
    yield send("POST", "/v1/drives/feeder/verbs/quick-stop?x=1", b"{")


def stops() -> Iterator[Request]:
    """Stop, rightly and wrongly."""
    for body in (b"", b"{", b"[]", b"{}", {"action": "inhibit"}, {"target": "all"},
                 {"action": "halt", "target": "all"}, {"action": "inhibit", "target": "nobody"},
                 {"action": "inhibit", "target": 1}, b'{"action": "inhibit", "action": "inhibit"}',
                 b"[" * 900, b" " * BODY, b'{"action": "\xff"}'):  # fmt: skip
        title = f"{body[:60]!r} of {len(body)}" if isinstance(body, bytes) else ""
        yield send("POST", "/v1/stop", body, name=title)
    good = {"action": "quick-stop", "target": "feeder"}
    yield send("POST", "/v1/stop", good)
    yield send(
        "POST", "/v1/stop", {**good, "more": [1], "verify": False}, Idempotency_Key="x" * 256
    )
    yield send("POST", "//v1/stop/?a=b", b"\xef\xbb\xbf" + json.dumps(good).encode())
    yield send("POST", "/v1/stop", good, Idempotency_Key="one")
    yield send("POST", "/v1/stop", good, Idempotency_Key="one")
    for target in ("belt", "winder", "pump", "counter", "pair", "mixed", "all"):
        for action in ("quick-stop", "inhibit"):
            yield send("POST", "/v1/stop", {"action": action, "target": target})
    yield get("/v1/drives/feeder/codes/C0135?fresh=true")


def rows_and_events() -> Iterator[Request]:
    """Ask for the journal, which this roster has not, for events in a wrong way, and to reload."""
    for path in ("/v1/journal", "/v1/journal?limit=0", "/v1/journal?limit=x",
                 "/v1/journal?after=-1", "/v1/journal?since=yesterday",
                 "/v1/journal?last=true&after=1", "/v1/journal?frm=1",
                 "/v1/journal/verify", "/v1/journal/verify?head=1:x",
                 "/v1/events?kind=nonsense", "/v1/events?drive=nobody",
                 "/v1/events?colour=red"):  # fmt: skip
        yield get(path)
    for method in ("POST", "PUT", "DELETE"):
        yield get("/v1/journal", method)
        yield get("/v1/events", method)
    yield get("/v1/reload")
    yield send("POST", "/v1/reload", {"x": 1})
    yield send("POST", "/v1/reload", b"")


def leases() -> Iterator[Request]:
    """Ask for leases, take one, and ask without its token for what needs it."""
    path = "/v1/leases/plc"
    yield get("/v1/leases")
    yield get("/v1/leases?x=1")
    yield get("/v1/leases", "POST")
    yield get(path)
    for body in (b"", b"{", b"[]", b"{}", {"counter": 1}, {"token": "x", "counter": 2},
                 {"token": "x", "time": "2s", "counter": 2}, {"targets": ["press"], "counter": 1},
                 {"targets": ["press"], "time": "2s"}, {"targets": [], "time": "2s", "counter": 1},
                 {"targets": "press", "time": "2s", "counter": 1},
                 {"targets": ["nobody"], "time": "2s", "counter": 1},
                 {"targets": ["press"], "time": "1ms", "counter": 1},
                 {"targets": ["press"], "time": "2h", "counter": 1},
                 {"targets": ["nobody"], "time": 2, "counter": 1},
                 {"targets": ["press"], "time": "2s", "counter": -1},
                 {"targets": ["press"], "time": "2s", "counter": "1"},
                 {"targets": ["counter"], "time": "2s", "counter": 1},
                 {"targets": ["press"], "time": "2s", "counter": 1, "x": 1},
                 {"targets": ["press"], "time": "2s", "counter": 1,
                  "take_over": "nobody"}):  # fmt: skip
        yield send("PUT", path, body)
    for name in ("a%20b", "x" * 61, "%C3%A4", "a/b"):
        yield send("PUT", f"/v1/leases/{name}", {"targets": ["press"], "time": "2s", "counter": 1})
    yield get(path, "DELETE")
    yield get(path, "DELETE", Lecombus_Lease="x")
    good = {"targets": ["press", "pair"], "time": "1min", "counter": 1}
    yield send("PUT", path, good, name="taken")
    yield send("PUT", path, good, name="taken again")
    yield send("PUT", "/v1/leases/other", good, name="taken by another")
    yield get("/v1/leases", name="held")
    for lease in ("", "x"):
        head = {"Lecombus_Lease": lease}
        yield send("PUT", "/v1/drives/press/codes/C0046", {"value": 5}, **head)
        yield send("PUT", "/v1/drives/press/codes/C0012", {"value": 5}, **head)
        yield send("PUT", "/v1/groups/pair/codes/C0046", {"value": 5}, **head)
        yield send("POST", "/v1/drives/feeder/verbs/enable", b"", **head)
        yield send("POST", "/v1/drives/feeder/verbs/quick-stop", b"", **head)
    yield send(
        "POST", "/v1/stop", {"action": "inhibit", "target": "press"}, name="with a lease held"
    )
    yield send("PUT", "/v1/leases/other", {**good, "take_over": "plc"}, name="taken over")
    yield get("/v1/leases", name="held by another")
